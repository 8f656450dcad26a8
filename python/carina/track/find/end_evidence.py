"""Evidence in the CT beyond an airway's end: soft tissue that fills the bronchus, or a wall that closes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina.track.find.wall_profile import CrossSampler
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Volume

Points = NDArray[np.float64]
Floats = NDArray[np.float64]

# Distances in mm from the tip of a branch between which its direction is measured, before the blunt end.
BLUNT_MM, AXIS_MM = 2.0, 10.0
# Distance in mm between the samples on a line from a tip onwards.
STEP_MM = 0.5
# Length in mm of the line from a tip onwards on which wall, lung and tissue are searched.
FARTHEST_MM = 20.0
BEYOND_END_MM = 3.0
"""Maximum distance in mm from the last centreline point, beyond the radius, to the wall that closes an end."""

# Range in HU of the soft tissue, such as mucus or tumour, that fills a bronchus beyond its visible end.
TISSUE_HU = (-150.0, 200.0)
BLUR_MM = 3.0
"""Maximum distance in mm, caused by blur, between the end of the air and the first sample of soft tissue beyond it."""
MIN_TISSUE_MM, MIN_TISSUE_WIDTHS, MIN_TISSUE_SLICES = 6.0, 1.2, 3.0
"""Minimum length of soft tissue that fills a bronchus: in mm, in lumen widths and in slices.

Beyond a fork that the search missed, an artery continues in the direction of the bronchus for a shorter length.
"""
TISSUE_CONE_DEG = (0.0, 10.0)
USUAL_WALL_MM = 1.2
MIN_WIDTH, MAX_WIDTH = 0.75, 1.35
"""Range of the outer width of a filled bronchus, relative to the outer width of its open part."""
SECTIONS = (0.2, 0.4, 0.6, 0.8)
MIN_SECTIONS = 3

MIN_STUMP_MM = 5.0
"""Minimum width in mm of a stump; a narrower end may have branches that are too thin for the CT."""
CLOSED_HU = -600.0
WIDE_MM, CLOSED_WIDE_HU = 7.0, -700.0
"""Minimum width in mm of an end that counts as wide, and minimum HU of a wall that closes a wide end.

An airway that continues a wide end would show in slices of 3 mm. A faint wall therefore proves that there is none.
"""
MIN_RISE_HU = 120.0
"""Minimum rise in HU from the lung to the wall of a wide end, unless the wall reaches ``CLOSED_HU``."""
LUNG_FROM_MM = 4.0
"""Distance in mm from the wall of an end at which the lung beside the end is measured."""
CLOSED_CONE_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
CLOSED_STEP_DEG = 15.0
MIN_JUDGED = 0.6
CLIP_HU = 2000.0
"""Minimum value in HU of surgical clips: brighter than bone, calcified cartilage and calcified lymph nodes."""
CLIP_REACH_MM = 12.0
MIN_CLIP_MM3 = 3.0


@dataclass(frozen=True, slots=True)
class EndEvidence:
    """Evidence in the CT beyond the end of an airway."""

    kind: Literal["tissue", "closed"]
    """Kind of evidence: filling by soft tissue, or closed wall.

    ``tissue``: soft tissue continues the bronchus with its outer width. ``closed``: a wall closes the end in every
    direction.
    """
    length_mm: float
    """Length of the visible soft tissue in mm for kind ``tissue``; 0 for ``closed``."""
    has_clips: bool
    """Whether surgical clips are near the airway's end, which then is a stump after an operation."""


def find_end_evidence(volume: Volume, look: CrossSampler, branch: Branch, width_mm: float) -> EndEvidence | None:
    """Return the evidence in the CT beyond a branch's end; None if it shows neither a filling nor a closed wall.

    Parameters
    ----------
    volume, look
        The CT, and a sampler of it.
    branch
        Branch without children.
    width_mm
        Diameter of the branch before its end.
    """
    axis = _axis(branch)
    if axis is None:
        return None
    tissue_mm = _filled_mm(volume, look, branch.tip_lps, axis, width_mm)
    if tissue_mm is not None:
        return EndEvidence("tissue", tissue_mm, has_clips=False)
    if width_mm < MIN_STUMP_MM:
        return None
    if not is_closed(look, branch.tip_lps, axis, width_mm):
        return None
    return EndEvidence("closed", 0.0, has_clips=has_clips(volume, branch.tip_lps + 0.5 * width_mm * axis))


def _axis(branch: Branch) -> Points | None:
    """Return the unit direction (3,) of the last part of a branch; None if the part has no length."""
    to_tip = np.linalg.norm(branch.points - branch.tip_lps, axis=1)
    part = branch.points[(to_tip >= BLUNT_MM) & (to_tip <= AXIS_MM)]
    if len(part) < 2:
        part = branch.points
    direction = part[-1] - part[0]
    length = float(np.linalg.norm(direction))
    return None if length < 1.0 else direction / length


def _cone(axis: Points, degrees: tuple[float, ...]) -> Points:
    """Return unit vectors (n, 3) at each of the given angles to an axis, in degrees."""
    one = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    one /= np.linalg.norm(one)
    two = np.cross(axis, one)
    found = []
    for angle in np.radians(degrees):
        num = max(round(360.0 * float(np.sin(angle)) / CLOSED_STEP_DEG), 1 if angle == 0.0 else 8)
        turns = 2.0 * np.pi * np.arange(num) / num
        ring = np.cos(turns)[:, None] * one + np.sin(turns)[:, None] * two
        found.append(np.cos(angle) * axis + np.sin(angle) * ring)
    return np.concatenate(found)


def _wall_at(values: Floats, half: float, width_mm: float) -> int | None:
    """Return the index of the sample at which the air of the end meets its wall; None if no wall is near."""
    wall = np.flatnonzero(values >= half)
    most = 0.5 * width_mm + BEYOND_END_MM
    return int(wall[0]) if len(wall) and wall[0] * STEP_MM <= most else None


def _filled_mm(volume: Volume, look: CrossSampler, tip: Points, axis: Points, width_mm: float) -> float | None:
    """Return the length (mm) of soft tissue that continues a bronchus with its outer width; None without evidence."""
    low, high = (float(look.scale.level(hu)) for hu in TISSUE_HU)
    at = np.arange(0.0, FARTHEST_MM, STEP_MM)
    outer_mm = width_mm + 2.0 * USUAL_WALL_MM
    least_mm = max(MIN_TISSUE_MM, MIN_TISSUE_WIDTHS * width_mm, MIN_TISSUE_SLICES * max(volume.spacing_mm))
    best: float | None = None
    for direction in _cone(axis, TISSUE_CONE_DEG):
        places = tip + at[:, None] * direction
        values = look.along(places, direction)
        wall = _wall_at(values, look.half, width_mm)
        if wall is None:
            continue
        solid = np.flatnonzero((values[wall:] >= low) & (values[wall:] <= high)) + wall
        if not len(solid) or (solid[0] - wall) * STEP_MM > BLUR_MM:
            continue
        after = np.flatnonzero((values < low) | (values > high))
        stop = int(after[after > solid[0]][0]) if (after > solid[0]).any() else len(values)
        length_mm = (stop - int(solid[0])) * STEP_MM
        if length_mm < least_mm or (best is not None and length_mm <= best):
            continue
        seen = 0
        for share in SECTIONS:
            middle = look.middle(places[int(solid[0])] + share * length_mm * direction, direction, outer_mm + 4.0)
            seen += middle is not None and MIN_WIDTH * outer_mm <= middle[1] <= MAX_WIDTH * outer_mm
        if seen >= MIN_SECTIONS:
            best = length_mm
    return best


def _lung_level(look: CrossSampler, tip: Points, width_mm: float) -> float:
    """Return the median value of the lung beside an end, in the units of the volume; NaN if there is no lung."""
    offsets = np.array([o for o in np.ndindex(3, 3, 3) if o != (1, 1, 1)], dtype=np.float64) - 1.0
    directions = offsets / np.linalg.norm(offsets, axis=1)[:, None]
    away = np.arange(0.5 * width_mm + LUNG_FROM_MM, FARTHEST_MM, STEP_MM)
    values = look.values_at(tip + away[:, None, None] * directions)
    lung = values[values < look.half]
    return float(np.median(lung)) if len(lung) else float("nan")


def closed_level(look: CrossSampler, tip: Points, width_mm: float) -> float:
    """Return the minimum value of a wall that closes an end of this width, in the units of the volume."""
    usual = float(look.scale.level(CLOSED_HU))
    if width_mm < WIDE_MM:
        return usual
    rise = float(look.scale.level(MIN_RISE_HU) - look.scale.level(0.0))
    lung = _lung_level(look, tip, width_mm)
    least = float(look.scale.level(CLOSED_WIDE_HU))
    return least if np.isnan(lung) else min(max(least, lung + rise), usual)


def is_closed(
    look: CrossSampler, tip: Points, axis: Points, width_mm: float, *, beside: tuple[Points, Floats] | None = None
) -> bool:
    """Return whether there is a wall in every direction beyond an end, so that no open airway leaves it.

    Parameters
    ----------
    look
        Sampler of the CT.
    tip, axis, width_mm
        End of the airway, direction of the airway, and its diameter.
    beside
        Centreline and radii of an airway that leaves at the end: directions that meet this airway are not judged. At
        least ``MIN_JUDGED`` of all directions must be left.
    """
    level = closed_level(look, tip, width_mm)
    at = np.arange(0.0, 0.65 * width_mm + BEYOND_END_MM, STEP_MM)
    directions = _cone(axis, CLOSED_CONE_DEG)
    judged = directions
    if beside is not None:
        places = tip + at[None, at >= 0.5 * width_mm, None] * directions[:, None, :]
        off_mm = np.linalg.norm(places[:, :, None, :] - beside[0], axis=-1) - beside[1]
        judged = directions[off_mm.min(axis=(1, 2)) > 0.0]
        if len(judged) < MIN_JUDGED * len(directions):
            return False
    return all(float(look.along(tip + at[:, None] * way, way).max()) >= level for way in judged)


def has_clips(volume: Volume, point: Points) -> bool:
    """Return whether values as bright as surgical clips are near a point."""
    if not volume.is_hu:
        return False
    spacing = np.array(volume.spacing_mm)
    reach = np.ceil(CLIP_REACH_MM / spacing).astype(int)
    middle = np.rint(volume.to_ijk(point)).astype(int)
    low = np.maximum(middle - reach, 0)
    high = np.minimum(middle + reach + 1, np.array(volume.shape_zyx[::-1]))
    box = volume.hu_zyx[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
    return bool((box >= CLIP_HU).sum() * float(np.prod(spacing)) >= MIN_CLIP_MM3)
