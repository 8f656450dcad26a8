"""Flight from one turn to the next, as times and camera poses for a video."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError, UsageError, check_type
from carina.navigate import FlightPath
from carina.navigate.rotation import orthonormal, rotation_from_vector, vector_from_rotation
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.turns.fork_view import Operator, levelled
from carina.plan.turns.turn_list import TurnList
from carina.scopes import Pose
from carina.track import AirwayTree

Points = NDArray[np.float64]

SPEEDS_MM_S = (1.0, 200.0)
RATES_HZ = (1.0, 120.0)
TURN_DEG_S = 60.0
"""Maximum mean rotation of the picture in degrees/s that a viewer can follow."""
SHORTEST_S = 1.0
SHORT_MM = 1e-3


def turn_flight(
    tree: AirwayTree,
    planned: PlannedRoute,
    turns: TurnList,
    index: int,
    *,
    operator: Operator = "head",
    speed_mm_s: float = 20.0,
    rate_hz: float = 25.0,
) -> tuple[NDArray[np.float64], tuple[Pose, ...]]:
    """Return the flight from the previous turn to a turn; the flight begins and ends with the pictures of both turns.

    Parameters
    ----------
    tree, planned
        Tree and route of the list of turns.
    turns
        List of turns (`carina.plan.turn_list`); `examples/05_turns` shows a complete example.
    index
        Index of the turn. The flight to turn 0 begins at the beginning of the route; ``len(turns.turns)`` is the flight
        to the final position of the scope.
    operator
        Position of the operator, which determines the orientation of the picture.
    speed_mm_s
        Speed of the fastest part, 1 to 200; the flight is slower where the picture would turn too fast.
    rate_hz
        Frames per second, 1 to 120.

    Returns
    -------
    times_s, poses
        (n,) times from 0, and n camera poses.

    Raises
    ------
    UsageError
        If there is no such turn, or a number is out of range.
    NoResultError
        If the flight to the turn has no length, or a turn has no camera position.
    """
    check_type("turn_flight", "tree", tree, AirwayTree, "it is the tree of carina.find_airways")
    check_type("turn_flight", "planned", planned, PlannedRoute, "it is one of the routes of carina.plan_route")
    check_type("turn_flight", "turns", turns, TurnList, "make it with carina.plan.turn_list")
    if not 0 <= index <= len(turns.turns):
        raise UsageError(f"index: expected 0 to {len(turns.turns)}; found {index}", code="plan.range")
    for name, value, (least, most) in (("speed_mm_s", speed_mm_s, SPEEDS_MM_S), ("rate_hz", rate_hz, RATES_HZ)):
        if not least <= value <= most:
            raise UsageError(f"{name}: expected {least:g} to {most:g}; found {value}", code="plan.range")
    way = _RouteLine(tree, planned, turns)
    begin_mm, ahead_mm, first = way.before(index - 1, operator)
    end_mm, beyond_mm, last = way.before(index, operator)
    if end_mm - begin_mm < SHORT_MM:
        raise NoResultError("the stretch to this turn has no length, so there is nothing to fly", code="plan.no-way")
    # The camera path ends at the fork, so that the camera finally looks along the branch and not into the next one.
    points = way.between(begin_mm, max(beyond_mm, ahead_mm))
    path = FlightPath(points, up_lps=None if first is None else _tuple(-first.down_lps))
    length_mm = end_mm - begin_mm
    base = np.diag([-1.0, -1.0, 1.0]) if operator == "facing" and first is None else np.eye(3)
    off = [_off(_posed(path, at, base), wanted, operator) for at, wanted in ((0.0, first), (length_mm, last))]
    steps = np.linspace(0.0, length_mm, max(2, math.ceil(length_mm / 0.5) + 1))
    rough = [_eased(path, base, off, float(s), length_mm) for s in steps]
    turned = sum(_angle_rad(a, b) for a, b in itertools.pairwise(rough))
    # With smooth acceleration the largest speed is 1.5 times the mean speed.
    duration_s = max(SHORTEST_S, 1.5 * length_mm / speed_mm_s, math.degrees(turned) / TURN_DEG_S)
    times = np.linspace(0.0, duration_s, max(2, round(duration_s * rate_hz) + 1))
    share = times / duration_s
    places = length_mm * share * share * (3.0 - 2.0 * share)
    return times, tuple(_eased(path, base, off, float(place), length_mm) for place in places)


class _RouteLine:
    """Centreline of a route, with the positions of its turns and their cameras."""

    def __init__(self, tree: AirwayTree, planned: PlannedRoute, turns: TurnList) -> None:
        points = np.concatenate([branch.points for branch in tree.lineage(planned.branch_id)])
        step = np.linalg.norm(np.diff(points, axis=0), axis=1)
        self._points = points[np.concatenate([[True], step > 0.0])]
        self._along = np.concatenate([[0.0], np.cumsum(step[step > 0.0])])
        self._planned, self._turns = planned, turns
        self._forks_mm = np.cumsum([turn.from_fork_mm for turn in turns.turns])

    def before(self, index: int, operator: Operator) -> tuple[float, float, Pose | None]:
        """Return the camera's position along the route, the position of the fork in mm, and the camera, for one turn.

        Both ends of the route have no camera.
        """
        if index < 0:
            return 0.0, 0.0, None
        if index == len(self._turns.turns):
            park_mm = min(self._planned.along_mm, float(self._along[-1]))
            return park_mm, park_mm, None
        turn = self._turns.turns[index]
        camera = turn.camera(operator)
        fork_mm = float(self._forks_mm[index])
        return self._nearest_mm(camera.position_lps, fork_mm), fork_mm, camera

    def between(self, begin_mm: float, end_mm: float) -> Points:
        """Return the points (n, 3), LPS mm, of the route's centreline between two positions in mm."""
        inner = self._along[(self._along > begin_mm + SHORT_MM) & (self._along < end_mm - SHORT_MM)]
        at = np.concatenate([[begin_mm], inner, [end_mm]])
        return np.stack([np.interp(at, self._along, self._points[:, axis]) for axis in range(3)], axis=1)

    def _nearest_mm(self, point: Points, before_mm: float) -> float:
        """Return the position in mm along the route nearest to a point, but not beyond a fork."""
        best = (math.inf, 0.0)
        for n in range(len(self._points) - 1):
            if self._along[n] > before_mm:
                break
            a, b = self._points[n], self._points[n + 1]
            along = b - a
            share = float(np.clip((point - a) @ along / float(along @ along), 0.0, 1.0))
            away = float(np.linalg.norm(point - a - share * along))
            # Of two equally near positions the later one counts, because the route may touch itself.
            if away <= best[0] + 1e-9:
                best = (away, float(self._along[n] + share * (self._along[n + 1] - self._along[n])))
        return min(best[1], before_mm)


def _posed(path: FlightPath, at_mm: float, base: Points) -> Pose:
    matrix = path.pose_at(at_mm).lps_from_camera.copy()
    matrix[:3, :3] = matrix[:3, :3] @ base
    return Pose(matrix)


def _off(pose: Pose, wanted: Pose | None, operator: Operator) -> tuple[Points, Points]:
    """Return the rotation and shift from a pose of the path to ``wanted``, or to a level pose if ``wanted`` is None."""
    there = levelled(pose.position_lps, pose.forward_lps, operator) if wanted is None else wanted
    turn = vector_from_rotation(orthonormal(pose.lps_from_camera[:3, :3].T @ there.lps_from_camera[:3, :3]))
    return turn, there.position_lps - pose.position_lps


def _eased(path: FlightPath, base: Points, off: list[tuple[Points, Points]], at_mm: float, length_mm: float) -> Pose:
    """Return the pose at a position of the flight to a turn: that of the path, blended into the poses of both ends."""
    share = at_mm / length_mm
    late = share * share * (3.0 - 2.0 * share)
    pose = _posed(path, at_mm, base).lps_from_camera.copy()
    (turn_a, shift_a), (turn_b, shift_b) = off
    pose[:3, :3] = orthonormal(
        pose[:3, :3] @ rotation_from_vector((1.0 - late) * turn_a) @ rotation_from_vector(late * turn_b)
    )
    pose[:3, 3] += (1.0 - late) * shift_a + late * shift_b
    return Pose(pose)


def _angle_rad(one: Pose, other: Pose) -> float:
    return float(np.linalg.norm(vector_from_rotation(one.lps_from_camera[:3, :3].T @ other.lps_from_camera[:3, :3])))


def _tuple(vector: Points) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])
