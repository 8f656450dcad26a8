"""Wide airways that end in a wall while a much narrower airway leaves sideways, as after a lobectomy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.find.end_evidence import closed_level, is_closed
from carina.track.find.wall_profile import CrossSampler
from carina.track.tree.airway_tree import Branch

Points = NDArray[np.float64]

# The stump is too short to be a separate branch, so the wide and the narrow airway form one branch.
MIN_WIDE_MM = 8.0
"""Minimum width in mm of the wide part of an airway that ends in a wall."""
MAX_NARROWED = 0.65
"""Maximum ratio of the narrow to the wide radius of a branch that counts as narrowed."""
MIN_TURN_DEG = 25.0
"""Minimum angle in degrees between the narrow part and the wide part. An airway that tapers continues straight on."""
FROM_START_MM = 10.0
"""Minimum distance in mm from the start of the branch, whose first part is inside its parent."""
BEFORE_MM, AFTER_MM, FADE_MM = 6.0, 8.0, 3.0
"""Lengths in mm of the parts before and after a step in radius over which radii are compared, and of the step."""
AXIS_FROM_MM, AXIS_TO_MM = 12.0, 4.0
"""Distances in mm before the step between which the axis of the wide part is measured."""
STEP_MM = 0.5
MARGIN_MM = 1.0
"""Distance in mm from the lumen of the narrow airway within which a direction is not judged."""
FARTHEST_RADII = 3.0
"""Maximum distance from the end of the wide part's axis to the closing wall, as a multiple of the radius."""


@dataclass(frozen=True, slots=True)
class StraightEnd:
    """Closed end straight ahead of a wide airway."""

    lps: Points
    """Middle of the wide airway's lumen, just before its closed end, LPS in mm."""
    width_mm: float
    """Diameter of the wide airway, mm."""
    axis: Points
    """Unit direction (3,) of the wide airway, LPS."""


def find_straight_end(look: CrossSampler, branch: Branch) -> StraightEnd | None:
    """Return the closed end at which a branch turns into a much narrower airway; None without such evidence.

    Parameters
    ----------
    look
        Sampler of the CT.
    branch
        Branch of the airway tree.
    """
    step = _strongest_narrowing(branch)
    if step is None:
        return None
    index, radius_mm, axis = step
    at = _along_mm(branch)
    first = int(np.searchsorted(at, at[index] - AXIS_TO_MM))
    origin = branch.points[first]
    away = np.arange(0.0, AXIS_TO_MM + FARTHEST_RADII * radius_mm, STEP_MM)
    ahead = origin + away[:, None] * axis
    values = look.along(ahead, axis)
    peak = float(values.max())
    if peak < closed_level(look, branch.points[index], 2.0 * radius_mm):
        return None
    # A thin wall across thick slices does not reach the half-way value, so the peak gives its position.
    wall = int(np.flatnonzero(values >= min(look.half, peak))[0])
    if _off_tubes_mm(branch, ahead[wall]) < 0.0:
        return None
    tip = ahead[max(wall - round(radius_mm / STEP_MM), 0)]
    narrow = at >= at[index] + FADE_MM
    beside = (branch.points[narrow], branch.radius[narrow] + MARGIN_MM)
    if not is_closed(look, tip, axis, 2.0 * radius_mm, beside=beside):
        return None
    return StraightEnd(tip, 2.0 * radius_mm, axis)


def _along_mm(branch: Branch) -> NDArray[np.float64]:
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _strongest_narrowing(branch: Branch) -> tuple[int, float, Points] | None:
    """Return the index of the strongest step to a narrow part that turns, and radius and axis of the wide part."""
    at = _along_mm(branch)
    best: tuple[float, int, float, Points] | None = None
    for index in np.flatnonzero((at >= FROM_START_MM) & (at <= at[-1] - FADE_MM - AFTER_MM)):
        wide = branch.radius[(at >= at[index] - BEFORE_MM) & (at < at[index])]
        narrow = branch.radius[(at >= at[index] + FADE_MM) & (at <= at[index] + FADE_MM + AFTER_MM)]
        radius_mm, share = float(np.median(wide)), float(np.median(narrow) / np.median(wide))
        if 2.0 * radius_mm < MIN_WIDE_MM or share > MAX_NARROWED or (best is not None and share >= best[0]):
            continue
        axis = _direction(branch.points[(at >= at[index] - AXIS_FROM_MM) & (at <= at[index] - AXIS_TO_MM)])
        turned = _direction(branch.points[(at >= at[index]) & (at <= at[index] + AFTER_MM)])
        if axis is None or turned is None or axis @ turned > np.cos(np.radians(MIN_TURN_DEG)):
            continue
        best = (share, int(index), radius_mm, axis)
    return None if best is None else best[1:]


def _direction(points: Points) -> Points | None:
    if len(points) < 2:
        return None
    direction = points[-1] - points[0]
    length_mm = float(np.linalg.norm(direction))
    return direction / length_mm if length_mm >= 1.0 else None


def _off_tubes_mm(branch: Branch, point: Points) -> float:
    """Return the distance in mm of a point from the surface of a branch's lumen; negative inside the lumen."""
    return float((np.linalg.norm(branch.points - point, axis=1) - branch.radius).min())
