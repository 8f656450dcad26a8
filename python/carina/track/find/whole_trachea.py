"""Whole trachea in a scan: its air, followed down to the carina and up to its top, without the air beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.find.air_upwards import AirSection, connected_to, dilate, disc, follow_up
from carina.track.find.chest_size import longest_trachea_mm
from carina.track.intensity_levels import AirScale
from carina.track.progress import Stages
from carina.volume.model import Volume

AIR_END_HU = -800.0
WALL_HU = 40.0
# Area in mm2 below which a piece of air is not a main bronchus.
MIN_PART_MM2 = 12.0
# Distance in mm from side to side below which two pieces of air are not the two main bronchi.
MIN_APART_MM = 7.0
# Distance in mm below a division over which both parts are followed to measure how they diverge.
FOLLOWED_MM = 6.0
# Increase in mm of the parts' distance over `FOLLOWED_MM`, below which a division is not the carina.
DIVERGE_MM = 2.0
# Share of the trachea's area above which a section is still the trachea and not one main bronchus.
MIN_AREA = 0.7
# Maximum error in mm of the ends of the trachea in the search by anatomy.
MISSED_MM = 10.0
# Minimum and maximum area of a section that counts as a section of the trachea, as shares of the trachea's area.
SIMILAR_AREA = (0.6, 1.5)
# Minimum share of similar sections above the found trachea that shows that the trachea continues there.
SIMILAR_SHARE = 0.65
# Thickness in mm of the trachea's wall, in which values are not changed; air in oesophagus and lung is farther away.
OWN_WALL_MM = 2.0


@dataclass(frozen=True, slots=True)
class DownToCarina:
    """Cross-sections of the trachea's air from a given voxel down to the carina."""

    sections: list[AirSection]
    """Sections of the trachea's air from the given voxel down to the last section above the carina."""
    divides: bool
    """Whether two main bronchi follow below; False if the air ends, narrows or leaves the scan first."""


def down_to_the_carina(
    volume: Volume, scale: AirScale, start: tuple[int, int, int], stage: Stages, *, area_mm2: float | None = None
) -> DownToCarina | None:
    """Follow the trachea's air from a voxel (i, j, k) down to the carina.

    Air in the oesophagus or in the top of a lung is not followed, so it cannot be mistaken for a main bronchus.

    Parameters
    ----------
    area_mm2
        Area of the trachea's section, if it is known: a much smaller section is a bronchus and ends the trachea.

    Returns
    -------
    DownToCarina or None
        None if there is no air at ``start``.
    """
    sections = follow_up(volume, scale, scale.level(AIR_END_HU), start, stage, down=True)
    if not sections:
        return None
    heights = np.array([section.centre_lps[2] for section in sections])
    end, divides = len(sections), False
    if area_mm2 is not None:
        small = np.array([section.area_mm2 < MIN_AREA * area_mm2 for section in sections])
        for n in range(end):
            if small[n : n + 1 + int(np.sum(heights[n] - heights[n:] < FOLLOWED_MM))].all():
                end = n
                break
    for n in range(end):
        below = np.flatnonzero(heights[n] - heights >= FOLLOWED_MM)
        now = _parts_apart_mm(volume, sections[n]) if len(below) else None
        if now is None or now < MIN_APART_MM:
            continue
        then = _parts_apart_mm(volume, sections[int(below[0])])
        if then is not None and then - now >= DIVERGE_MM:
            end, divides = n, True
            break
    return DownToCarina(sections[: max(end, 1)], divides)


def _parts_apart_mm(volume: Volume, section: AirSection) -> float | None:
    """Return the distance in mm from side to side of the two largest parts of a section's air.

    None for a single part.
    """
    dx, dy, _ = volume.spacing_mm
    left = section.air.copy()
    parts: list[tuple[float, float]] = []
    while left.any():
        first = np.zeros_like(left)
        first[np.unravel_index(int(left.argmax()), left.shape)] = True
        part = connected_to(first, left)
        left &= ~part
        area = float(part.sum() * dx * dy)
        if area >= MIN_PART_MM2:
            parts.append((area, float(np.argwhere(part)[:, 1].mean() * dx)))
    if len(parts) < 2:
        return None
    (_, one), (_, other) = sorted(parts)[-2:]
    return abs(one - other)


def _longest_mm(area_mm2: float) -> float:
    return longest_trachea_mm(2.0 * float(np.sqrt(area_mm2 / np.pi)))


def begins_below_top(sections: list[AirSection], top_k: int, area_mm2: float) -> bool:
    """Return whether sections like the trachea's continue above the slice in which the trachea was found to begin.

    Parameters
    ----------
    sections
        Sections from the carina up.
    top_k
        Slice of the upper end that the search found.
    area_mm2
        Area of the trachea's section.
    """
    z = next((s.centre_lps[2] for s in sections if s.k >= top_k), None)
    if z is None or z - sections[0].centre_lps[2] > _longest_mm(area_mm2) - MISSED_MM:
        return False
    above = [s for s in sections if s.k > top_k and s.centre_lps[2] - z <= 3.0 * MISSED_MM]
    if not above or above[-1].centre_lps[2] - z < MISSED_MM:
        return False
    # A short stenosis, at which the search by anatomy stops, may be in between.
    low, high = SIMILAR_AREA[0] * area_mm2, SIMILAR_AREA[1] * area_mm2
    return sum(low <= section.area_mm2 <= high for section in above) >= SIMILAR_SHARE * len(above)


def trachea_sections(sections: list[AirSection], top_k: int, area_mm2: float) -> list[AirSection]:
    """Return the sections up to a slice and those above it, up to a long part that is unlike the trachea."""
    low, high = SIMILAR_AREA[0] * area_mm2, SIMILAR_AREA[1] * area_mm2
    last = 0
    for n, section in enumerate(sections):
        if section.centre_lps[2] - sections[0].centre_lps[2] > _longest_mm(area_mm2):
            break
        if section.k <= top_k or low <= section.area_mm2 <= high:
            last = n
        elif section.centre_lps[2] - sections[last].centre_lps[2] > MISSED_MM:
            break
    return sections[: last + 1]


def with_tissue_beside(volume: Volume, scale: AirScale, sections: list[AirSection]) -> NDArray[np.int16]:
    """Return the values (nz, ny, nx) with soft tissue in place of all air beside the sections.

    Air in the oesophagus, in the top of a lung or outside the body then cannot be mistaken for a part of the
    trachea.
    """
    values = volume.hu_zyx.copy()
    dx, dy, _ = volume.spacing_mm
    own_wall = disc(OWN_WALL_MM + 0.5 * max(dx, dy), (dy, dx))
    wall = round(scale.level(WALL_HU))
    for section in sections:
        inside = dilate(section.whole, own_wall)
        selected = section.window_of(values)[inside]
        values[section.k] = wall
        section.window_of(values)[inside] = selected
    return values
