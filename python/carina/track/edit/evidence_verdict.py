"""Decision whether cross-sections of a path show an airway: a weighted sum of measures of each section.

The weights are from a logistic regression on the worst 5 mm of paths to branches that were removed from a tree, to
branches that the search missed, and into plain lung, in phantoms, painted patients and patients; other data were
reserved for verification. docs/decisions/0140.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.intensity_levels import AirScale

Points = NDArray[np.float64]
Values = NDArray[np.float64]

STEP_MM = 0.5
"""Distance in mm between two cross-sections at which the evidence for a path is measured."""
WINDOW_MM = 5.0
SURE = 1.0
"""Minimum gain (log odds) of a section that counts as evident; evident first sections pass even in a failed window.

The window is 5 mm long; its sections pass up to the first weaker one.
"""

# Constant term of the gain of a section (a sum of weighted terms, in log odds).
BASE = 1.45
RISE, RISE_LIMITS = 0.9, (-0.5, 1.5)
FAR_RISE, FAR_LIMITS = 1.2, (-0.5, 2.0)
CLOSED, FAR_CLOSED, CLOSED_LIMITS = 1.0, 1.4, (0.0, 1.5)
"""Weights of closed walls within 3 mm and 8 mm, and limits of these walls relative to those in lung without airways.

The limits prevent one bright wall from compensating a long path without walls.
"""
MIN_WALLS = 0.6
"""Minimum mean, over 5 mm of path, of the sum of the four wall terms, whatever the other terms are.

Fewer than one in 100 paths to removed branches have a smaller average.
"""
DROP, DROP_HU, MAX_DROP = -2.0, 100.0, 3.0
"""Weight, unit in HU and upper limit of the penalty for values that rise and fall along a path, as across a wall."""
WIDER, AS_WIDE, MAX_WIDER = -1.6, 0.8, 1.0
"""Weight, permitted ratio and upper limit of the penalty for a path wider than the branch that it leaves.

A radius of up to 0.8 of the branch's radius has no penalty; a radius of 1.8 has the full penalty.
"""
BEND = -2.6
"""Weight of the penalty for bends: a path between vessels turns within some millimetres, an airway does not."""
UNEVEN = -3.9
"""Weight of the penalty for a changing radius, per mm of the radius's standard deviation over 5 mm."""
UNEVEN_OVER = 5
"""Number of sections before, and after, a section over which the radius's deviation is computed."""
GAP, THREAD_MM, AIR_HU, GAP_HU, MAX_GAP = -1.1, 1.0, -980.0, 100.0, 3.0
"""Parameters of the penalty for gaps between vessels, which are wide and as bright as lung.

The values are the weight, the least radius in mm, the HU without penalty, the unit in HU and the upper limit.
"""

WALL_DROP_HU = 350.0
"""Rise and subsequent fall in HU along a path above which the path crosses a wall, so that its end is not connected."""
NEAR_MM = 3.0
"""Distance in mm from the middle of a section within which near walls, and the radius, are measured."""
WIDE_HU = -930.0
"""Maximum HU in the middle of a lumen that is wider than ``NEAR_MM``.

A darker middle with walls all round, but none within ``NEAR_MM``, is such a lumen. A rise within ``NEAR_MM`` is then
noise, and so is the radius that follows from it.
"""
NO_LUMEN_HU, NO_LUMEN = -450.0, -100.0
"""HU, as a mean over 2.5 mm, above which the middle of a section is not lumen, and gain (log odds) of such a
section."""
MOUTH_MM = 4.0
"""Length in mm of path inside the lumen of its parent over which the widest section gives the parent's width."""
MAX_TURN_DEG = 130.0
"""Maximum angle in degrees between a branch that leaves the tree and the direction of its parent."""
TURN_OVER_MM = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Sections:
    """Measures of the sections across a path, one every half millimetre; values in the units of the volume."""

    at_mm: Values
    """Distance (n,) of each section from the start of the path, mm."""
    middle: Values
    """Smoothed voxel value (n,) in the middle of each section, on the path."""
    rise: Values
    """Rise (n,) above the middle that four fifths of the sides of a section reach within 3 mm."""
    far_rise: Values
    """Rise (n,) above the middle that four fifths of the sides of a section reach within 8 mm."""
    closed: Values
    """Rise (n,) above the middle that all sides of a section but one reach within 3 mm."""
    far_closed: Values
    """Rise (n,) above the middle that all sides of a section but one reach within 8 mm."""
    around: Values
    """Voxel value (n,) of the lung farther out round each section."""
    radius_mm: Values
    """Radius (n,) of each section, mm: median distance of the sides to half of their rise within 3 mm."""
    bend: Values
    """Bend (n,) of the path at each section: 1 less the cosine between its directions over 3 mm before and after."""


@dataclass(frozen=True, slots=True)
class LungBaseline:
    """Comparison values from the best paths through lung without airways in the same CT, in the units of the volume."""

    rise: float
    """Rise within 3 mm that a tenth of the sections through lung without airways exceed, in units of the volume."""
    far_rise: float
    """Rise within 8 mm that a tenth of the sections through lung without airways exceed, in units of the volume."""
    bright: float
    """Value that the middles of a quarter of the sections through lung without airways exceed, in units of the
    volume."""


@dataclass(frozen=True, slots=True, eq=False)
class PathStart:
    """Start of a path at a branch of the tree."""

    inside_mm: float
    """Length in mm of the path's first part, inside the parent's lumen; sections there need no wall."""
    branch_radius_mm: float
    """Radius of the branch from which the path starts, mm."""
    branch_direction: NDArray[np.float64]
    """Direction (3,) of the branch that the path leaves, from the root outwards, LPS."""


def doubtful_sections(
    sections: Sections, lung: LungBaseline, scale: AirScale, start: PathStart | None = None
) -> NDArray[np.bool_]:
    """Return (n,) flags: True for each section in a window of 5 mm whose mean gain (log odds) is too small.

    In a window that fails, the evident sections before its first weak one are not flagged.

    Parameters
    ----------
    sections
        Sections of the path.
    lung
        Comparison values of plain lung.
    scale
        Conversion from HU to the values of the volume.
    start
        Start at a branch of the tree, if any.
    """
    found = np.zeros(len(sections.at_mm), dtype=bool)
    mine = np.flatnonzero(_beyond(sections, start))
    gain, wall = gains(sections, lung, scale, start)[mine], _walls(sections, lung)[mine]
    num = min(round(WINDOW_MM / STEP_MM), len(mine))
    mean_gain, mean_wall = (np.convolve(one, np.full(num, 1.0 / num), mode="valid") for one in (gain, wall))
    for first in np.flatnonzero((mean_gain < 0.0) | (mean_wall < MIN_WALLS)):
        found[mine[first : first + num]] = True
    sure = np.logical_and.accumulate(((gain >= SURE) & (wall >= MIN_WALLS)) | ~found[mine])
    found[mine] &= ~sure
    middle = sections.middle[mine]
    crossed = np.maximum.accumulate(middle) - middle > scale.span(WALL_DROP_HU)
    if crossed.any():
        # Flag all sections from the top of the crossed wall on.
        found[mine[int(np.argmax(middle[: int(np.argmax(crossed)) + 1])) :]] = True
    return found


def gains(sections: Sections, lung: LungBaseline, scale: AirScale, start: PathStart | None = None) -> Values:
    """Return the (n,) gain of each section, in log odds plus ``BASE``: positive for an airway, negative against it."""
    gain = BASE + _walls(sections, lung)
    mine = _beyond(sections, start)
    radius_mm = _radii(sections, lung, scale)
    middle = np.where(mine, sections.middle, -np.inf)
    drop = np.where(mine, np.maximum.accumulate(middle) - sections.middle, 0.0)
    gain += DROP * np.clip(drop / scale.span(DROP_HU), 0.0, MAX_DROP)
    if start is not None:
        mouth = ~mine & (sections.at_mm > start.inside_mm - MOUTH_MM)
        left_mm = max(start.branch_radius_mm, float(radius_mm[mouth].max(initial=0.0)), STEP_MM)
        gain += WIDER * np.clip(radius_mm / left_mm - AS_WIDE, 0.0, MAX_WIDER)
    gain += BEND * sections.bend
    gain += UNEVEN * _spread(radius_mm, UNEVEN_OVER)
    too_bright = (sections.middle - scale.level(AIR_HU)) / scale.span(GAP_HU)
    gain += GAP * np.clip((radius_mm - THREAD_MM) * too_bright, 0.0, MAX_GAP)
    return np.asarray(np.where(sections.middle > scale.level(NO_LUMEN_HU), NO_LUMEN, gain))


def turns_back(points: Points, along: Values, start: PathStart) -> bool:
    """Return whether a line, after it has left the lumen, runs back along the branch of the tree that it leaves."""
    reach_mm = min(start.inside_mm + TURN_OVER_MM, float(along[-1]))
    goes = points[min(int(np.searchsorted(along, reach_mm)), len(points) - 1)] - points[0]
    length = float(np.linalg.norm(goes) * np.linalg.norm(start.branch_direction))
    return length > 0.0 and float(goes @ start.branch_direction) < np.cos(np.radians(MAX_TURN_DEG)) * length


def along_mm(points: Points) -> Values:
    """Return the (n,) distance in mm of each of (n, 3) points along their line."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _walls(sections: Sections, lung: LungBaseline) -> Values:
    """Return the (n,) sum of the wall terms of each section."""
    # A wall must be brighter than the surrounding lung, not only than a dark middle.
    over = np.minimum(sections.middle - np.minimum(sections.around, lung.bright), 0.0)
    gain = RISE * np.clip((sections.rise + over) / lung.rise, *RISE_LIMITS)
    gain += FAR_RISE * np.clip((sections.far_rise + over) / lung.far_rise, *FAR_LIMITS)
    gain += CLOSED * np.clip((sections.closed + over) / lung.rise, *CLOSED_LIMITS)
    gain += FAR_CLOSED * np.clip((sections.far_closed + over) / lung.far_rise, *CLOSED_LIMITS)
    return np.asarray(gain)


def _radii(sections: Sections, lung: LungBaseline, scale: AirScale) -> Values:
    """Return the (n,) radius of each section; ``NEAR_MM`` if the lumen is wider."""
    wide = (
        (sections.rise < lung.rise) & (sections.far_closed > lung.far_rise) & (sections.middle < scale.level(WIDE_HU))
    )
    return np.where(wide, np.maximum(sections.radius_mm, NEAR_MM), sections.radius_mm)


def _beyond(sections: Sections, start: PathStart | None) -> NDArray[np.bool_]:
    inside_mm = 0.0 if start is None else start.inside_mm
    return np.asarray(sections.at_mm >= min(inside_mm, sections.at_mm[-1] - STEP_MM))


def _spread(values: Values, over: int) -> Values:
    """Return the (n,) standard deviation over the given number of values before and after each value."""
    ones, n = np.ones(2 * over + 1), len(values)
    num, total, square = (np.convolve(one, ones)[over : over + n] for one in (np.ones(n), values, np.square(values)))
    return np.asarray(np.sqrt(np.maximum(square / num - np.square(total / num), 0.0)))
