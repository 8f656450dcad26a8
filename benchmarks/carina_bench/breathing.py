"""CT of the same chest in another breath, made from a CT by a known smooth deformation.

From inspiration to expiration the bases of the lungs move up by 10 to 20 mm, the apices by 2 to 5 mm, and the front of
the chest moves back. The mean movement of a nodule between two such CTs is 17.6 mm (Chen et al., Chest 2015;147:1275).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.plan.cubic_box import trilinear
from carina.volume import Volume

__all__ = ["Breath", "breathed", "random_breath"]

Points = NDArray[np.float64]

NUM_ITERATIONS = 12


@dataclass(frozen=True, slots=True)
class Breath:
    """Smooth deformation from the first CT to the second."""

    apex_mm: float
    """Upward shift of the lungs' apices, mm."""
    base_mm: float
    """Upward shift of the lungs' bases, mm."""
    back_mm: float
    """Backward shift of the front of the lungs' bases, mm."""
    apex_z: float
    base_z: float
    """Heights of the apices and of the bases of the lungs, LPS mm."""
    front_y: float
    back_y: float
    """Front and back of the chest, LPS mm."""
    waves: Points
    """Waves (n, 7) that vary the deformation smoothly: amplitude in mm on each axis, wave vector in 1/mm, phase."""
    table_lps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Shift of the whole patient on the table, mm."""
    denser: float = 1.25
    """Density of the lung at expiration as a multiple of its density at inspiration; air and other tissue keep
    their density."""

    def shifts(self, places: Points) -> Points:
        """Return the shifts (n, 3) in mm of places (n, 3) of the first CT, LPS mm."""
        down = np.clip((self.apex_z - places[:, 2]) / (self.apex_z - self.base_z), 0.0, 1.1)
        front = np.clip((self.back_y - places[:, 1]) / (self.back_y - self.front_y), 0.0, 1.0)
        found = np.zeros(places.shape)
        found[:, 2] = self.apex_mm + (self.base_mm - self.apex_mm) * down**1.4
        found[:, 1] = self.back_mm * down * front
        for wave in self.waves:
            found += wave[:3] * np.sin(places @ wave[3:6] + wave[6])[:, None]
        found += np.array(self.table_lps)
        return found


def random_breath(carina_lps: Points, seed: int) -> Breath:
    """Return a random deformation with published amplitudes for a chest with a known main carina."""
    rng = np.random.default_rng(seed)
    waves = np.empty((6, 7))
    waves[:, :3] = rng.normal(0.0, 0.7, (6, 3))
    ways = rng.normal(size=(6, 3))
    lengths = rng.uniform(110.0, 220.0, (6, 1))
    waves[:, 3:6] = 2.0 * np.pi / lengths * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    waves[:, 6] = rng.uniform(0.0, 2.0 * np.pi, 6)
    _, y, z = (float(v) for v in carina_lps)
    return Breath(
        apex_mm=rng.uniform(2.0, 5.0),
        base_mm=rng.uniform(10.0, 20.0),
        back_mm=rng.uniform(2.0, 7.0),
        apex_z=z + 110.0,
        base_z=z - 130.0,
        front_y=y - 100.0,
        back_y=y + 90.0,
        waves=waves,
    )


def breathed(volume: Volume, breath: Breath, *, noise_hu: float = 15.0, seed: int = 0) -> Volume:
    """Return the deformed CT on the same grid; the lung is denser, and noise is added."""
    rng = np.random.default_rng(seed)
    made = np.empty(volume.hu_zyx.shape, dtype=np.int16)
    top = (np.array(volume.shape_zyx[::-1]) - 1.0)[:, None]
    rows, columns = volume.shape_zyx[1:]
    y, x = np.mgrid[0:rows, 0:columns].reshape(2, -1).astype(np.float64)
    off: Points | None = None
    for z in range(len(made)):
        there = volume.lps_from_ijk[:3, :3] @ np.stack([x, y, np.full(len(x), float(z))]) + volume.lps_from_ijk[:3, 3:]
        goal = there.T
        off = breath.shifts(goal) if off is None else off
        # The neighbouring slice has nearly the same shifts, so that few steps are needed.
        for _ in range(NUM_ITERATIONS):
            former, off = off, breath.shifts(goal - off)
            if float(np.abs(off - former).max()) < 0.02:
                break
        ijk = volume.ijk_from_lps[:3, :3] @ (goal - off).T + volume.ijk_from_lps[:3, 3:]
        values = trilinear(volume.hu_zyx, np.clip(ijk, 0.0, top))
        density = np.clip(values + 1000.0, 0.0, None)
        # From 500 to 1000 HU above air the factor falls to 1, so that the order of the values stays the same.
        factor = 1.0 + (breath.denser - 1.0) * np.clip((1000.0 - density) / 500.0, 0.0, 1.0)
        values = np.where(density > 0.0, density * factor - 1000.0, values)
        values += rng.normal(0.0, noise_hu, values.shape)
        made[z] = np.clip(np.round(values), -1024, 3071).reshape(made.shape[1:])
    return Volume(made, volume.lps_from_ijk)
