"""Phantoms with a neck and a leaning trachea, with air in the oesophagus beside it, and parts of such scans."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.phantom import Phantom, generate_phantom
from carina.volume import Volume

BOX_LPS = ((-130.0, -105.0, -110.0), (130.0, 105.0, 195.0))
"""Box that contains the neck and the chest down to the lower lobe bronchi, LPS mm."""
GULLET_RADIUS_MM = 3.6
"""Radius of the air in the oesophagus, mm."""
GULLET_WALL_MM = 2.0
"""Thickness of the wall around the air in the oesophagus, mm."""
BESIDE_MM = 16.0
"""Distance of the oesophagus from the top of the trachea to the side, mm."""
BEHIND_MM = 13.0
"""Distance of the oesophagus behind the trachea, mm."""


@dataclass(frozen=True, slots=True, eq=False)
class LeaningNeck:
    """CT with a neck and a leaning trachea, and the true tree of the phantom."""

    made: Phantom
    volume: Volume
    """The phantom's volume, scaled to the patient's size, with air in the oesophagus."""
    scale: float

    @property
    def cricoid_lps(self) -> NDArray[np.float64]:
        return self.scale * np.array(self.made.truth["cricoid_lps"])

    def trachea_at(self, above_carina_mm: float) -> NDArray[np.float64]:
        """Return the point of the trachea's centreline at a height above the carina, in mm of the unscaled phantom."""
        points = np.array(self.made.truth["branches"][0]["points"])
        return self.scale * points[int(np.argmin(np.abs(points[:, 2] - above_carina_mm)))]

    @property
    def in_larynx(self) -> NDArray[np.float64]:
        return self.scale * (np.array(self.made.truth["cricoid_lps"]) + np.array([0.0, -1.0, 12.0]))

    def in_gullet(self, above_carina_mm: float) -> NDArray[np.float64]:
        return self.scale * gullet_at(self.made, above_carina_mm)

    def cropped(self, *, above_mm: float | None = None, below_mm: float | None = None) -> Volume:
        """Return the slices above the height ``above_mm`` or below the height ``below_mm``.

        Heights are above the carina, in mm of the unscaled phantom.
        """
        z0, step = float(self.volume.lps_from_ijk[2, 3]), self.volume.spacing_mm[2]
        first = 0 if above_mm is None else int(np.ceil((self.scale * above_mm - z0) / step))
        stop = None if below_mm is None else int(np.floor((self.scale * below_mm - z0) / step)) + 1
        matrix = np.array(self.volume.lps_from_ijk)
        matrix[2, 3] += first * step
        return Volume(self.volume.hu_zyx[first:stop].copy(), matrix, source=self.volume.source)


GULLET_MM = (45.0, 80.0)
"""Heights above the carina between which the oesophagus contains air, mm of the unscaled phantom."""


def gullet_at(made: Phantom, above_carina_mm: float) -> NDArray[np.float64]:
    """Return the point of the oesophagus's axis at a height above the carina, LPS mm.

    The axis is vertical, on the side to which the trachea leans.
    """
    points = np.array(made.truth["branches"][0]["points"])
    top = points[int(np.argmin(np.abs(points[:, 2] - GULLET_MM[1])))]
    side = 1.0 if made.truth["lean_deg"][0] >= 0.0 else -1.0
    here = points[int(np.argmin(np.abs(points[:, 2] - above_carina_mm)))]
    return np.array([top[0] + side * BESIDE_MM, here[1] + BEHIND_MM, above_carina_mm])


def with_air_in_the_gullet(made: Phantom) -> Volume:
    """Return the volume with air in a vertical part of the oesophagus, from which the leaning trachea diverges."""
    volume = made.volume
    matrix = volume.lps_from_ijk
    nk, nj, ni = volume.shape_zyx
    x = matrix[0, 3] + matrix[0, 0] * np.arange(ni)
    y = matrix[1, 3] + matrix[1, 1] * np.arange(nj)
    values = volume.hu_zyx.copy()
    for k in range(nk):
        z = float(matrix[2, 3] + matrix[2, 2] * k)
        if not GULLET_MM[0] <= z <= GULLET_MM[1]:
            continue
        at = gullet_at(made, z)
        inward = GULLET_RADIUS_MM - np.hypot(x[None, :] - at[0], y[:, None] - at[1])
        air = np.clip(0.5 + inward, 0.0, 1.0)
        outer = np.clip(0.5 + inward + GULLET_WALL_MM, 0.0, 1.0)
        slice_yx = values[k] * (1.0 - outer) + 40.0 * (outer - air) - 1000.0 * air
        values[k] = np.rint(slice_yx)
    return dataclasses.replace(volume, hu_zyx=values)


def leaning_neck(
    seed: int,
    lean_deg: tuple[float, float],
    *,
    scale: float = 1.0,
    spacing_mm: float = 1.3,
    gullet: bool = True,
    noise_hu: float = 20.0,
) -> LeaningNeck:
    """Return a CT with a leaning trachea.

    ``scale`` is the patient's size relative to an adult; ``spacing_mm`` is the spacing of the scan.
    """
    made = generate_phantom(
        seed=seed,
        spacing_mm=spacing_mm / scale,
        generations=4,
        noise_hu=noise_hu,
        neck=True,
        lean_deg=lean_deg,
        box_lps=BOX_LPS,
    )
    volume = with_air_in_the_gullet(made) if gullet else made.volume
    matrix = np.array(volume.lps_from_ijk)
    matrix[:3] *= scale
    return LeaningNeck(made, Volume(volume.hu_zyx, matrix, source=volume.source), scale)
