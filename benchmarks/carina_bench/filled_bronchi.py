"""Phantoms with fluid or mucus over a known stretch of one bronchus: a fluid level, or a plug that fills the lumen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.phantom import Phantom
from carina.volume import Volume

__all__ = ["Secretions", "with_secretions"]

FLUID_HU = 15.0
"""CT value of fluid and mucus in a bronchus, HU."""
AIR_HU = -1000.0
"""CT value of the air in a bronchus, HU."""
WALL_HU = 150
"""Maximum CT value to which a voxel at the border of lumen and wall may rise, HU."""
FINE = 4
"""Number of subcells along each edge of a voxel, so that a fluid level may be inside a voxel."""
STEP_MM = 0.1
"""Distance in mm between two samples along the axis of a bronchus that is painted as filled."""


@dataclass(frozen=True, slots=True, eq=False)
class Secretions:
    """Volume with fluid in one bronchus, and the true position and extent of the fluid."""

    volume: Volume
    axis_lps: NDArray[np.float64]
    """(n, 3) axis of the bronchus from the first to the last section with fluid, LPS mm."""
    calibre_mm: float
    """Diameter of the lumen, between inner walls, in the middle of the stretch with fluid, mm."""
    air_mm: float
    """Diameter in mm of the circle that has the area of the air above the fluid in the middle of the stretch."""


def with_secretions(phantom: Phantom, name: str, *, share: float, from_mm: float, length_mm: float) -> Secretions:
    """Return the phantom with fluid in the lowest (posterior) ``share`` of the height of each section of a bronchus.

    Parameters
    ----------
    phantom
        Phantom whose truth contains the name of the bronchus.
    name
        Name of the bronchus, such as ``RB6``.
    share
        Share of the height of a section that is filled, above 0 and at most 1; 1 is a plug.
    from_mm, length_mm
        Start of the fluid, as a distance along the axis from the origin of the bronchus, and length of the stretch. The
        stretch must end within the bronchus.
    """
    branch = next(one for one in phantom.truth["branches"] if one["name"] == name)
    points, radius = np.array(branch["points"]), np.array(branch["radius"])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if along[-1] <= from_mm + length_mm:
        raise ValueError(f"{name} is {along[-1]:.1f} mm long: fluid to {from_mm + length_mm:.1f} mm does not fit")
    at = np.arange(from_mm, from_mm + length_mm, STEP_MM)
    axis = np.stack([np.interp(at, along, points[:, n]) for n in range(3)], axis=1)
    radii = np.interp(at, along, radius)
    volume = phantom.volume
    values = volume.hu_zyx.astype(np.float64)
    ijk = volume.to_ijk(axis)
    reach = np.ceil(radii.max() / np.array(volume.spacing_mm)) + 2
    low = np.floor(ijk.min(axis=0) - reach).astype(int)
    high = np.ceil(ijk.max(axis=0) + reach).astype(int)
    cells = (np.arange(FINE) + 0.5) / FINE - 0.5
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    for k in range(low[2], high[2] + 1):
        fine = np.stack(
            np.meshgrid(
                np.add.outer(np.arange(low[0], high[0] + 1), cells).ravel(),
                np.add.outer(np.arange(low[1], high[1] + 1), cells).ravel(),
                k + cells,
                indexing="ij",
            ),
            axis=-1,
        )
        places = volume.to_lps(fine.reshape(-1, 3))
        wet = np.zeros(len(places), dtype=bool)
        close = np.flatnonzero(np.abs(axis[:, 2] - places[:, 2].mean()) < radii.max() + 2.0)
        for n in close:
            off = places - axis[n]
            ahead = off @ tangent[n]
            inside = (np.abs(ahead) < 0.3) & ((off * off).sum(axis=1) <= radii[n] ** 2 + ahead**2)
            # In an axial plane the section of an airway that runs backwards is not a circle, so its height is
            # corrected.
            height = (off[:, 1] - ahead * tangent[n, 1]) / max(np.sqrt(1.0 - tangent[n, 1] ** 2), 1e-3)
            wet |= inside & (height >= radii[n] * (1.0 - 2.0 * share))
        num_x, num_y = high[0] - low[0] + 1, high[1] - low[1] + 1
        part = wet.reshape(num_x, FINE, num_y, FINE, FINE).mean(axis=(1, 3, 4)).T
        values[k, low[1] : high[1] + 1, low[0] : high[0] + 1] += part * (FLUID_HU - AIR_HU)
    brightest = np.maximum(volume.hu_zyx, WALL_HU)
    filled = Volume(np.round(np.minimum(values, brightest)).astype(np.int16), volume.lps_from_ijk)
    # The air above the fluid is the segment of a circle above a chord.
    angle = 2.0 * np.arccos(1.0 - 2.0 * (1.0 - share))
    middle = len(axis) // 2
    air_mm = 2.0 * float(radii[middle]) * float(np.sqrt((angle - np.sin(angle)) / (2.0 * np.pi)))
    return Secretions(filled, axis, 2.0 * float(radii[middle]), air_mm)
