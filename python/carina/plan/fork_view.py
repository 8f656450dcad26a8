"""How a fork is seen from in front of it: where an eye stands, and at which hour each opening lies.

The rules are the window's (`waysOn`, `clockHour` and the look-outs of a route), so that the list of turns tells the
number that the airway view shows from the same place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.scopes import Pose
from carina.track import Branch

__all__ = ["Opening", "Operator", "hours_of", "levelled", "openings_seen", "stand_mm", "turned_hours", "whole_hour"]

Points = NDArray[np.float64]
Operator = Literal["head", "facing"]

OPENING_MM = (4.0, 10.0)
"""How far into a branch its opening is looked for: one of its diameters, within these."""
MIDDLE_TANGENT = 0.12
MIDDLE_TIMES = 4.0
"""An opening nearer than this to the line of sight (tan 7 degrees), with the others at least so many times farther out,
has no hour: it is straight ahead."""
LEAST_DEPTH_MM = 1.0
"""An opening beside or behind the lens is only a direction, as far out as can be."""
LEAST_STAND_MM = 3.0
"""Nearer than this to a fork the line of sight along the branch is that of single points."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """An opening at a fork, as one eye sees it."""

    branch: Branch
    place_lps: Points
    """In the middle of the branch, about a diameter past the fork."""
    hours: float
    """Where it lies in the picture, from 12 at the top, clockwise; above 0, at most 12."""
    tangent: float
    """Of its angle to the line of sight."""
    straight_ahead: bool
    """In the middle of the picture: it has no hour."""


def levelled(eye_lps: Points, look_lps: Points, operator: Operator) -> Pose:
    """The camera at a place with the picture's horizon level: anterior up (`carina.scopes.upright`), or turned by 180
    degrees for an operator who faces the patient.
    """
    pose = Pose.looking(eye_lps, look_lps)
    if operator == "head":
        return pose
    turned = pose.lps_from_camera.copy()
    turned[:3, :2] *= -1.0
    return Pose(turned)


def whole_hour(hours: float) -> int:
    """The hour that is told, 1 to 12."""
    return (math.floor(hours + 0.5) + 11) % 12 + 1


def turned_hours(hours: float) -> float:
    """The same place in a picture that is turned by 180 degrees."""
    return hours - 6.0 if hours > 6.0 else hours + 6.0


def stand_mm(branch: Branch) -> float:
    """How far before a branch's end a flight stops to look: a diameter, at most to the middle of the branch.

    As `carina.case.routes.lookouts_mm`; never so near that there is no line of sight.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    # A point in the very middle counts, whichever way its place was rounded.
    first_half = along <= 0.5 * along[-1] + 1e-9
    diameter = 2.0 * float(np.median(branch.radius[first_half]))
    return max(min(diameter, 0.5 * float(along[-1])), LEAST_STAND_MM)


def opening_index(branch: Branch) -> int:
    """The point of a branch at which its opening is looked for."""
    # The upper one of two middle radii, as the window takes it.
    diameter = 2.0 * float(np.sort(branch.radius)[len(branch.radius) // 2])
    far = min(max(diameter, OPENING_MM[0]), OPENING_MM[1])
    beyond = np.flatnonzero(np.linalg.norm(branch.points - branch.points[0], axis=1) >= far)
    return int(beyond[0]) if beyond.size else len(branch.points) - 1


def openings_seen(camera: Pose, branches: Sequence[Branch]) -> tuple[Opening, ...]:
    """The openings of branches that leave at one place, in their order.

    Parameters
    ----------
    camera
        Before the fork.
    branches
        Each begins at a fork.
    """
    places = [branch.points[opening_index(branch)] for branch in branches]
    seen: list[tuple[float, float]] = []
    for place in places:
        right, down, forward = (float(v) for v in camera.lps_from_camera[:3, :3].T @ (place - camera.position_lps))
        depth = max(forward, LEAST_DEPTH_MM)
        seen.append((right / depth, down / depth))
    hours = [hours_of(right, down) for right, down in seen]
    tangents = [math.hypot(right, down) for right, down in seen]
    middle = int(np.argmin(tangents)) if tangents else -1
    others = [n for n in range(len(seen)) if n != middle]
    in_middle = bool(others) and (
        tangents[middle] < MIDDLE_TANGENT and min(tangents[n] for n in others) > MIDDLE_TIMES * tangents[middle]
    )
    # Two openings at one hour lie on the same side: the nearer to the middle is the one straight ahead.
    shared = any(whole_hour(hours[n]) == whole_hour(hours[middle]) for n in others)
    return tuple(
        Opening(branch, places[n], hours[n], tangents[n], straight_ahead=n == middle and (in_middle or shared))
        for n, branch in enumerate(branches)
    )


def hours_of(right: float, down: float) -> float:
    """Where a direction points in a picture, by its parts to the right and down; 0 < hours <= 12."""
    hours = (math.atan2(right, -down) / math.tau * 12.0) % 12.0
    return 12.0 if hours == 0.0 else hours
