"""Handling of the scope in a flight: path, smoothness, contacts, red-out, view along the lumen.

No threshold of these measures is published, so they are shown without a mark.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.turns.fork_view import hours_of, whole_hour
from carina.scopes import Pose, WallField
from carina.track import AirwayTree
from carina.training.flight_frames import FRAME_HZ, FlightFrames
from carina.training.openings_in_sight import MAX_RED_OUT, red_out

TOUCH_MM = 0.1
"""Distance in mm between the tip and the wall up to which the tip touches the wall."""
CONTACT_GAP_S = 0.5
"""Time in s without touch after which the next touch is a new contact."""
AHEAD_MM = 10.0
"""Distance in mm, ahead of the tip along the airway, of the point that should be in the middle of the picture."""
MIDDLE_SHARE = 0.25
"""Maximum angle between the line of sight and the point `AHEAD_MM` ahead, as a share of the field of view.

The share is half the radius of the picture.
"""
OUTSIDE_MM = -0.5
"""Distance to the wall in mm below which the tip has left the airways."""
JUMP_MM_S = 1000.0
"""Limit of Carina in mm/s: above this speed the tip has jumped instead of moved.

A quick withdrawal of 100 mm in 0.4 s is well below this speed.
"""
PLACES_MM = 1.0
"""Distance in mm between the points of the centrelines in which the position of the tip is looked up."""

Points = NDArray[np.float64]


@one_line
@dataclass(frozen=True, slots=True)
class WallContact:
    """Contact of the tip with the wall."""

    first_frame: int
    last_frame: int
    place_lps: tuple[float, float, float]
    """Position of the tip when it first touches the wall, LPS mm."""
    branch_id: int
    """Branch in which the tip was at the first touch."""
    clock_hour: float
    """Clock hour in the picture of the wall that the tip touched first, 12 at the top; 0 < hour <= 12."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TipPlaces:
    """Branch of the tip at each frame, and whether the lumen is in the middle of the picture."""

    branch_ids: NDArray[np.int64] = field(repr=False)
    lumen_in_middle: NDArray[np.bool_] = field(repr=False)


class CentrelineIndex:
    """Points of all centrelines at even spacing, with the branch, position along it and radius of each."""

    def __init__(self, tree: AirwayTree) -> None:
        self.tree = tree
        self._lines: dict[int, tuple[Points, Points]] = {}
        points, radii, ids, along = [], [], [], []
        for branch in tree.branches:
            run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
            self._lines[branch.id] = (branch.points, run)
            at = np.linspace(0.0, run[-1], max(2, int(np.ceil(run[-1] / PLACES_MM)) + 1))
            points.append(np.stack([np.interp(at, run, branch.points[:, axis]) for axis in range(3)], axis=1))
            radii.append(np.interp(at, run, branch.radius))
            ids.append(np.full(len(at), branch.id))
            along.append(at)
        self._points, self._radii = np.concatenate(points), np.concatenate(radii)
        self._ids, self._along = np.concatenate(ids), np.concatenate(along)
        self._children = {branch.id: branch.children for branch in tree.branches}

    def locate(self, tips: Points) -> tuple[NDArray[np.int64], Points]:
        """Return the branch (n,) of each point (n, 3), and the position (n,) along it in mm.

        The branch is that with the nearest surface: least distance from the centreline, less the radius.
        """
        best = np.empty(len(tips), dtype=np.int64)
        for start in range(0, len(tips), 256):
            part = tips[start : start + 256]
            gaps = np.linalg.norm(part[:, None] - self._points, axis=2) - self._radii
            best[start : start + 256] = np.argmin(gaps, axis=1)
        return self._ids[best], self._along[best]

    def ahead(self, branch_id: int, along_mm: float, distance_mm: float) -> list[Points]:
        """Return the points (3,) at a distance ahead of a position: one on each branch that leads on.

        A branch without children ends at its last point.
        """
        points, run = self._lines[branch_id]
        at = along_mm + distance_mm
        children = self._children[branch_id]
        if at <= run[-1] or not children:
            return [np.array([np.interp(at, run, points[:, axis]) for axis in range(3)])]
        return [one for child in children for one in self.ahead(child, 0.0, at - float(run[-1]))]


def tip_places(frames: FlightFrames, index: CentrelineIndex, known: TipPlaces | None = None) -> TipPlaces:
    """Return the branch of the tip, and whether the lumen is in the middle of the picture, at each frame.

    The lumen is in the middle if the centreline :data:`AHEAD_MM` ahead of the tip is within :data:`MIDDLE_SHARE` of
    the field of view from the line of sight; at a fork the centreline of one of the branches ahead.

    Parameters
    ----------
    frames
        Frames of the flight.
    index
        Centrelines of the airways.
    known
        Result for the first frames of the same flight, which are not computed again.
    """
    begin = 0 if known is None else len(known.branch_ids)
    ids, along = index.locate(frames.lps_from_tip[begin:, :3, 3])
    if known is not None:
        ids = np.concatenate([known.branch_ids, ids])
        along = np.concatenate([np.zeros(begin), along])
    middle = np.zeros(len(ids), dtype=bool)
    if known is not None:
        middle[:begin] = known.lumen_in_middle
    for n, camera in enumerate(frames.cameras()[begin:], start=begin):
        fov_rad = np.radians(frames.optics[frames.optics_number[n]].scope.usual_fov_deg)
        least = np.cos(MIDDLE_SHARE * fov_rad)
        deformation = frames.deformation(n)
        for point in index.ahead(int(ids[n]), float(along[n]), AHEAD_MM):
            way = (point if deformation is None else deformation.points(point)[0]) - camera[:3, 3]
            size = float(np.linalg.norm(way))
            # Beyond the end of the last branch the direction ahead is unknown.
            if size >= 1.0 and float(way @ camera[:3, 2]) >= least * size:
                middle[n] = True
    return TipPlaces(ids, middle)


def wall_contacts(
    frames: FlightFrames, wall: WallField, places: TipPlaces, *, first: int, last: int
) -> tuple[list[WallContact], NDArray[np.bool_]]:
    """Return the contacts of the tip with the wall, and whether the view is lost by red-out at each frame (n,).

    The tip touches where the largest ball around the middle of its face that fits into the lumen is at most
    :data:`TOUCH_MM` larger than the tip. With a simulated breathing, this holds in the moved patient. A touch that
    begins while the trainee does not move the tip is caused by the breathing alone, and counts only from the frame in
    which the tip is moved.
    """
    at = frames.lps_from_tip[:, :3, 3]
    tip_mm = np.array([one.scope.tip_mm / 2.0 for one in frames.optics])[frames.optics_number]
    red = red_out(frames.tips_to_wall_mm(wall), tip_mm) >= MAX_RED_OUT
    touches = frames.tips_to_wall_mm(wall, ball=True) <= tip_mm + TOUCH_MM
    touches &= _by_movement(touches, at, tip_mm)
    touches[:first] = touches[last + 1 :] = False
    contacts: list[WallContact] = []
    gap = int(CONTACT_GAP_S * FRAME_HZ)
    for n in np.flatnonzero(touches):
        if contacts and n - contacts[-1].last_frame <= gap:
            before = contacts[-1]
            contacts[-1] = WallContact(
                before.first_frame, int(n), before.place_lps, before.branch_id, before.clock_hour
            )
            continue
        place = (float(at[n, 0]), float(at[n, 1]), float(at[n, 2]))
        deformation = frames.deformation(int(n))
        if deformation is None:
            hour = _hour_of_wall(frames.lps_from_tip[n], wall)
        else:
            moved = Pose(frames.lps_from_tip[n]).carried_by(deformation)
            hour = _hour_of_wall(moved.lps_from_camera, wall.deformed(deformation))
        contacts.append(WallContact(int(n), int(n), place, int(places.branch_ids[n]), hour))
    return contacts, red


def _by_movement(touches: NDArray[np.bool_], at: Points, tip_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return, for each frame (n,), whether the tip was moved since the last frame without a touch.

    The positions (n, 3) are those in the CT at rest, which a breathing does not change. Another instrument has another
    tip, so it counts as a movement.
    """
    moved = np.ones(len(touches), dtype=bool)
    moved[1:] = (at[1:] != at[:-1]).any(axis=1) | (tip_mm[1:] != tip_mm[:-1])
    numbers = np.arange(len(touches))
    last_moved, last_free = (np.maximum.accumulate(np.where(where, numbers, -1)) for where in (moved, ~touches))
    return np.asarray(last_moved > last_free)


def _hour_of_wall(pose: Points, wall: WallField) -> float:
    """Return the clock hour of the nearest wall in the picture, from the change of the distance to the wall."""
    steps = 0.5 * np.concatenate([np.eye(3), -np.eye(3)])
    found = wall.distance_mm(pose[:3, 3] + steps)
    towards = -(found[:3] - found[3:]) @ pose[:3, :3]
    return hours_of(float(towards[0]), float(towards[1]))


def hour_text(hours: float) -> str:
    """Return the whole clock hour nearest to a clock hour as text."""
    return f"{whole_hour(hours)} o'clock"


def path_length_mm(tips: Points) -> float:
    """Return the length in mm of the path through the tip's positions (n, 3)."""
    return float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())


def smoothness(tips: Points) -> float | None:
    """Return the smoothness of the path of the tip: minus the logarithm of the dimensionless jerk; larger is smoother.

    The value is None for a path without movement or with fewer than four points.

    References
    ----------
    Hogan and Sternad 2009, log dimensionless jerk (general knowledge, not checked).
    """
    if len(tips) < 4:
        return None
    velocity = np.diff(tips, axis=0) * FRAME_HZ
    jerk = np.diff(velocity, n=2, axis=0) * FRAME_HZ**2
    peak = float(np.linalg.norm(velocity, axis=1).max())
    duration = (len(tips) - 1) / FRAME_HZ
    squared = float((jerk**2).sum()) / FRAME_HZ
    if peak <= 0.0 or squared <= 0.0:
        return None
    return -float(np.log(squared * duration**3 / peak**2))
