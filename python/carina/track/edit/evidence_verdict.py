"""Which sections of a way show an airway: a few measures of what lies across it, weighed.

The weights are a logistic regression's, fitted to the worst 5 mm of ways to branches that were removed from a tree,
to branches that the search missed, and into plain lung: phantoms, painted patients and patients of which others were
kept back. docs/decisions/0119.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.levels import AirScale

__all__ = ["STEP_MM", "Lung", "Sections", "Start", "along_mm", "doubtful_sections", "gains", "turns_back"]

Points = NDArray[np.float64]
Values = NDArray[np.float64]

STEP_MM = 0.5
"""From one section to the next."""
WINDOW_MM = 5.0
SURE = 1.0
"""Of a window that fails, the sections before its first that gains less than this stay evident."""

# What a section gains: the sum of these, each a weight and, where it is clipped, its least and most.
BASE = 1.45
RISE, RISE_LIMITS = 0.9, (-0.5, 1.5)
FAR_RISE, FAR_LIMITS = 1.2, (-0.5, 2.0)
CLOSED, FAR_CLOSED, CLOSED_LIMITS = 1.0, 1.4, (0.0, 1.5)
"""Walls in units of what plain lung shows: one bright wall must not pay for a long way without."""
LEAST_WALLS = 0.6
"""What the four above must give on average over a window, whatever else speaks for an airway: where there is no wall
at all there is none. Fewer than one of 100 ways to removed branches gives less."""
DROP, DROP_HU, MOST_DROP = -2.0, 100.0, 3.0
"""A way that rises and falls has probably stepped over a wall."""
WIDER, AS_WIDE, MOST_WIDER = -1.6, 0.8, 1.0
"""An airway is narrower than the branch that it leaves: 0.8 of it costs nothing, twice as much costs all."""
BEND = -2.6
"""An airway does not turn within some millimetres; a way between vessels does."""
UNEVEN = -3.9
"""Nor does its radius change: per mm of standard deviation over 5 mm."""
UNEVEN_OVER = 5
"""Sections before and after."""
GAP, THREAD_MM, AIR_HU, GAP_HU, MOST_GAP = -1.1, 1.0, -980.0, 100.0, 3.0
"""What is wide is dark: a place 2 mm from its walls that is as bright as the lung lies between vessels."""

WALL_DROP_HU = 350.0
"""A way that rises and falls by more has stepped over a wall: whatever lies beyond, it is not connected so."""
NEAR_MM = 3.0
"""How far the nearer walls are looked for, and the radius with them."""
WIDE_HU = -930.0
"""A middle darker than this, with walls all round but none so near, is a lumen too wide for that: what rises within
``NEAR_MM`` is noise, and so would a radius be that is measured from it."""
NO_LUMEN_HU, NO_LUMEN = -450.0, -100.0
"""A middle that is brighter over 2.5 mm is no lumen, whatever lies before and after."""
MOUTH_MM = 4.0
"""The lumen that a way leaves is as wide as the widest of its sections so far inside."""
MOST_TURN_DEG = 130.0
"""A branch that leaves the tree turns less than this against the direction of its parent."""
TURN_OVER_MM = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Sections:
    """What lies across a way, every half millimetre; values in the volume's numbers."""

    at_mm: Values
    """(n,) along the way."""
    own: Values
    """(n,) value in the middle."""
    rise: Values
    """(n,) how far four fifths of the sides rise above the middle within 3 mm."""
    far_rise: Values
    """(n,) the same within 8 mm."""
    closed: Values
    """(n,) how far all sides but one rise within 3 mm."""
    far_closed: Values
    """(n,) the same within 8 mm."""
    around: Values
    """(n,) value of what lies farther out."""
    radius_mm: Values
    """(n,) median distance of the sides to half of their rise within 3 mm."""
    bend: Values
    """(n,) 1 less the cosine between the directions of the 3 mm before and after."""


@dataclass(frozen=True, slots=True)
class Lung:
    """What the best ways through plain lung of the same CT show, in the volume's numbers."""

    rise: float
    """A tenth of their sections rise by more within 3 mm."""
    far_rise: float
    """And within 8 mm."""
    bright: float
    """A quarter of their middles is brighter than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a way leaves the tree."""

    inside_mm: float
    """How far its beginning lies in the lumen: a section there cuts both, and is not asked for a wall."""
    branch_radius_mm: float
    """Of the branch that it leaves."""
    branch_direction: NDArray[np.float64]
    """(3,) LPS, of that branch, from the root outwards."""


def doubtful_sections(sections: Sections, lung: Lung, scale: AirScale, start: Start | None = None) -> NDArray[np.bool_]:
    """(n,) for each section, whether it lies in a window of 5 mm that gains too little on average.

    Of a window that fails, what is evident before its end stays so.
    """
    found = np.zeros(len(sections.at_mm), dtype=bool)
    mine = np.flatnonzero(_beyond(sections, start))
    gain, wall = gains(sections, lung, scale, start)[mine], _walls(sections, lung)[mine]
    num = min(round(WINDOW_MM / STEP_MM), len(mine))
    mean_gain, mean_wall = (np.convolve(one, np.full(num, 1.0 / num), mode="valid") for one in (gain, wall))
    for first in np.flatnonzero((mean_gain < 0.0) | (mean_wall < LEAST_WALLS)):
        found[mine[first : first + num]] = True
    sure = np.logical_and.accumulate(((gain >= SURE) & (wall >= LEAST_WALLS)) | ~found[mine])
    found[mine] &= ~sure
    own = sections.own[mine]
    crossed = np.maximum.accumulate(own) - own > scale.span(WALL_DROP_HU)
    if crossed.any():
        # Doubtful from the top of the wall.
        found[mine[int(np.argmax(own[: int(np.argmax(crossed)) + 1])) :]] = True
    return found


def gains(sections: Sections, lung: Lung, scale: AirScale, start: Start | None = None) -> Values:
    """(n,) how much each section speaks for an airway: above 0 for, below against; log odds, moved by ``BASE``."""
    gain = BASE + _walls(sections, lung)
    mine = _beyond(sections, start)
    radius_mm = _radii(sections, lung, scale)
    own = np.where(mine, sections.own, -np.inf)
    drop = np.where(mine, np.maximum.accumulate(own) - sections.own, 0.0)
    gain += DROP * np.clip(drop / scale.span(DROP_HU), 0.0, MOST_DROP)
    if start is not None:
        mouth = ~mine & (sections.at_mm > start.inside_mm - MOUTH_MM)
        left_mm = max(start.branch_radius_mm, float(radius_mm[mouth].max(initial=0.0)), STEP_MM)
        gain += WIDER * np.clip(radius_mm / left_mm - AS_WIDE, 0.0, MOST_WIDER)
    gain += BEND * sections.bend
    gain += UNEVEN * _spread(radius_mm, UNEVEN_OVER)
    too_bright = (sections.own - scale.level(AIR_HU)) / scale.span(GAP_HU)
    gain += GAP * np.clip((radius_mm - THREAD_MM) * too_bright, 0.0, MOST_GAP)
    return np.asarray(np.where(sections.own > scale.level(NO_LUMEN_HU), NO_LUMEN, gain))


def turns_back(points: Points, along: Values, start: Start) -> bool:
    """Whether a line, once it has left the lumen, runs back along the branch that it leaves."""
    reach_mm = min(start.inside_mm + TURN_OVER_MM, float(along[-1]))
    goes = points[min(int(np.searchsorted(along, reach_mm)), len(points) - 1)] - points[0]
    length = float(np.linalg.norm(goes) * np.linalg.norm(start.branch_direction))
    return length > 0.0 and float(goes @ start.branch_direction) < np.cos(np.radians(MOST_TURN_DEG)) * length


def along_mm(points: Points) -> Values:
    """(n,) how far along a line of (n, 3) points each lies."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _walls(sections: Sections, lung: Lung) -> Values:
    """(n,) what the walls of each section give."""
    # A wall is brighter than the lung round it, not only than a dark middle.
    over = np.minimum(sections.own - np.minimum(sections.around, lung.bright), 0.0)
    gain = RISE * np.clip((sections.rise + over) / lung.rise, *RISE_LIMITS)
    gain += FAR_RISE * np.clip((sections.far_rise + over) / lung.far_rise, *FAR_LIMITS)
    gain += CLOSED * np.clip((sections.closed + over) / lung.rise, *CLOSED_LIMITS)
    gain += FAR_CLOSED * np.clip((sections.far_closed + over) / lung.far_rise, *CLOSED_LIMITS)
    return np.asarray(gain)


def _radii(sections: Sections, lung: Lung, scale: AirScale) -> Values:
    """(n,) the radius of each section, ``NEAR_MM`` where the lumen is wider."""
    wide = (sections.rise < lung.rise) & (sections.far_closed > lung.far_rise) & (sections.own < scale.level(WIDE_HU))
    return np.where(wide, np.maximum(sections.radius_mm, NEAR_MM), sections.radius_mm)


def _beyond(sections: Sections, start: Start | None) -> NDArray[np.bool_]:
    inside_mm = 0.0 if start is None else start.inside_mm
    return np.asarray(sections.at_mm >= min(inside_mm, sections.at_mm[-1] - STEP_MM))


def _spread(values: Values, over: int) -> Values:
    """(n,) standard deviation of so many values before and after each, as many as there are."""
    ones, n = np.ones(2 * over + 1), len(values)
    num, total, square = (np.convolve(one, ones)[over : over + n] for one in (np.ones(n), values, np.square(values)))
    return np.asarray(np.sqrt(np.maximum(square / num - np.square(total / num), 0.0)))
