"""Phantoms with fluid or mucus over a known stretch of one bronchus: a fluid level, or a plug that fills the lumen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.phantom import Phantom
from carina.phantom.airway_lesions import fill, stretch_of
from carina.volume import Volume

__all__ = ["Secretions", "with_secretions"]

FLUID_HU = 15.0
"""CT value of fluid and mucus in a bronchus, HU."""


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
    length_mm_of_branch = float(np.linalg.norm(np.diff(np.array(branch["points"]), axis=0), axis=1).sum())
    if length_mm_of_branch <= from_mm + length_mm:
        raise ValueError(
            f"{name} is {length_mm_of_branch:.1f} mm long: fluid to {from_mm + length_mm:.1f} mm does not fit"
        )
    stretch = stretch_of(branch, from_mm, from_mm + length_mm)
    axis, radii = stretch.axis_lps, stretch.radius_mm

    def is_fluid(sections: NDArray[np.intp], offsets: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(stretch.heights(sections, offsets) >= radii[sections] * (1.0 - 2.0 * share))

    volume = phantom.volume
    hu = volume.hu_zyx.copy()
    fill(hu, volume.lps_from_ijk, stretch, is_fluid, FLUID_HU)
    filled = Volume(hu, volume.lps_from_ijk)
    # The air above the fluid is the segment of a circle above a chord.
    angle = 2.0 * np.arccos(1.0 - 2.0 * (1.0 - share))
    middle = len(axis) // 2
    air_mm = 2.0 * float(radii[middle]) * float(np.sqrt((angle - np.sin(angle)) / (2.0 * np.pi)))
    return Secretions(filled, axis, 2.0 * float(radii[middle]), air_mm)
