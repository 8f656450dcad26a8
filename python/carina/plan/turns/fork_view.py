"""View of a fork from in front of it: the position of the camera and the clock hour of each opening.

The rules are the same as in the window (`waysOn`, `clockHour` and the look-outs of a route), so that the list of turns
gives the same hour as the airway view at the same place.
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
"""Limits in mm for the distance into a branch at which its opening is located; the distance is one diameter."""
MIDDLE_TANGENT = 0.12
MIDDLE_TIMES = 4.0
"""Largest tangent of an opening straight ahead (7 degrees), and least ratio of the other openings' tangents to it.

An opening straight ahead has no clock hour.
"""
LEAST_DEPTH_MM = 1.0
"""Least depth in mm used for an opening; an opening beside or behind the lens counts as at this depth."""
LEAST_STAND_MM = 3.0
"""Least distance in mm of the camera from a fork; nearer, single points would determine the line of sight."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """Opening of a branch at a fork, as seen by a camera."""

    branch: Branch
    place_lps: Points
    """Point in the middle of the branch, about one diameter beyond the fork, LPS mm."""
    hours: float
    """Clock hour in the picture, 12 at the top, clockwise; 0 < hours <= 12."""
    tangent: float
    """Tangent of the angle between the line of sight and the opening."""
    straight_ahead: bool
    """Whether the opening is in the middle of the picture and so has no clock hour."""


def levelled(eye_lps: Points, look_lps: Points, operator: Operator) -> Pose:
    """Return the camera at a place with a level horizon.

    Anterior is up (`carina.scopes.upright`) for an operator at the head; the picture is turned by 180 degrees for an
    operator who faces the patient.

    Parameters
    ----------
    eye_lps, look_lps
        (3,) position in LPS mm and direction of the view.
    operator
        Position of the operator.
    """
    pose = Pose.looking(eye_lps, look_lps)
    if operator == "head":
        return pose
    turned = pose.lps_from_camera.copy()
    turned[:3, :2] *= -1.0
    return Pose(turned)


def whole_hour(hours: float) -> int:
    """Return the whole clock hour nearest to a clock hour, 1 to 12."""
    return (math.floor(hours + 0.5) + 11) % 12 + 1


def turned_hours(hours: float) -> float:
    """Return the clock hour of the same place in a picture that is turned by 180 degrees."""
    return hours - 6.0 if hours > 6.0 else hours + 6.0


def stand_mm(branch: Branch) -> float:
    """Return the distance in mm before a branch's end at which the camera looks at the fork.

    The distance is one diameter, at most half the branch and at least `LEAST_STAND_MM`, as in
    `carina.case.routes.lookouts_mm`.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    # The tolerance includes a point exactly in the middle, whatever its rounding.
    first_half = along <= 0.5 * along[-1] + 1e-9
    diameter = 2.0 * float(np.median(branch.radius[first_half]))
    return max(min(diameter, 0.5 * float(along[-1])), LEAST_STAND_MM)


def opening_index(branch: Branch) -> int:
    """Return the index of the point of a branch at which its opening is located."""
    # With an even number of radii the upper median is used, as in the window.
    diameter = 2.0 * float(np.sort(branch.radius)[len(branch.radius) // 2])
    far = min(max(diameter, OPENING_MM[0]), OPENING_MM[1])
    beyond = np.flatnonzero(np.linalg.norm(branch.points - branch.points[0], axis=1) >= far)
    return int(beyond[0]) if beyond.size else len(branch.points) - 1


def openings_seen(camera: Pose, branches: Sequence[Branch]) -> tuple[Opening, ...]:
    """Return the openings of branches that leave at one place, in the given order.

    Parameters
    ----------
    camera
        Camera before the fork.
    branches
        Branches that begin at the fork.
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
    # Two openings at the same hour are on the same side; the one nearer to the middle counts as straight ahead.
    shared = any(whole_hour(hours[n]) == whole_hour(hours[middle]) for n in others)
    return tuple(
        Opening(branch, places[n], hours[n], tangents[n], straight_ahead=n == middle and (in_middle or shared))
        for n, branch in enumerate(branches)
    )


def hours_of(right: float, down: float) -> float:
    """Return the clock hour of a direction from its components to the right and down, 0 < hours <= 12."""
    hours = (math.atan2(right, -down) / math.tau * 12.0) % 12.0
    return 12.0 if hours == 0.0 else hours
