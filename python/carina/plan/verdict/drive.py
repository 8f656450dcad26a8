"""Simulated drive of a scope along a route: the moves of the hand and the resulting poses in the airways.

The moves define a drive: the same scope, placed at the same position, reaches the same poses by the same moves, because
`carina.ScopeDrive` depends on nothing but its samples (docs/decisions/0142).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import UsageError
from carina.plan.hand_moves import Move
from carina.plan.verdict.drive_route import DriveWay
from carina.scopes import Pose, ScopeDrive, ScopeState

Points = NDArray[np.float64]

STEP_DEG = 5.0
"""Step in degrees in which the hand turns the scope and sets the lever."""
ADVANCE_MM = 1.0
"""Step in mm in which a move advances the scope; a step that the wall blocks is not repeated."""
TURN_DEG_PER_S, FLEX_DEG_PER_S, ADVANCE_MM_PER_S = 60.0, 60.0, 10.0
"""Speeds at which a drive is displayed: turn and flexion in degrees/s, advance in mm/s (common knowledge)."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class DrivenRoute:
    """Completed drive of a scope along a route, from the upper trachea to the place where the scope stopped."""

    scope_name: str
    start_mm: float
    """Insertion in mm at which the scope was placed (`carina.ScopeDrive.place`)."""
    moves: tuple[Move, ...]
    ends_mm: tuple[float, ...]
    """Insertion in mm of the scope at the end of each move: the length of the scope inside the patient."""
    ends_along_mm: tuple[float, ...]
    """Distance of the tip from the origin of the route (`PlannedRoute.origin`) at the end of each move, mm."""
    samples: Points
    """(n, 3) insertion in mm, roll and flexion in radians that the scope reached.

    The first row is the start. One row follows for each turn, each setting of the lever and each millimetre.
    """
    lps_from_camera: NDArray[np.float64]
    """(n, 4, 4) transform of the camera at each sample."""
    time_s: NDArray[np.float64]
    """(n,) time of each sample in seconds, at 60 degrees/s and 10 mm/s."""
    arrived: bool
    """Whether the simulated tip reached the end of the route."""
    stopped_mm: float
    """Distance of the tip from the origin of the route at the end of the drive, mm."""
    why: str | None
    """Reason why the scope stopped early; None if it arrived."""

    def to_json(self, *, poses: bool = True) -> dict[str, Any]:
        """Return the drive as plain JSON types; without ``poses``, samples and cameras are left out."""
        short: dict[str, Any] = {
            "scope": self.scope_name,
            "start_mm": self.start_mm,
            "moves": [
                {**move.to_json(), "ends_mm": end, "ends_along_mm": along}
                for move, end, along in zip(self.moves, self.ends_mm, self.ends_along_mm, strict=True)
            ],
            "arrived": self.arrived,
            "stopped_mm": self.stopped_mm,
            "why": self.why,
        }
        if not poses:
            return short
        return {
            **short,
            "samples": [
                {"time_s": time, "insertion_mm": insertion, "roll_rad": roll, "flexion_rad": flexion}
                for time, (insertion, roll, flexion) in zip(self.time_s.tolist(), self.samples.tolist(), strict=True)
            ],
            "lps_from_camera": self.lps_from_camera.tolist(),
        }


class MoveRecorder:
    """Recorder that executes moves one by one and stores the resulting states.

    A move turns the scope in one sample, sets the lever in the next, then advances 1 mm per sample.

    Parameters
    ----------
    drive
        A placed scope. No other object may drive it.
    """

    def __init__(self, drive: ScopeDrive) -> None:
        self.drive = drive
        self.roll_deg = math.degrees(drive.state.roll_rad)
        self.flexion_deg = math.degrees(drive.state.flexion_rad)
        self.moves: list[Move] = []
        self._ends_mm: list[float] = []
        self._end_states: list[int] = []
        self._start_mm = drive.state.insertion_mm
        self._states: list[ScopeState] = [drive.state]
        self._time_s = [0.0]
        self.effort = 0.0
        """Approximate number of small steps of the model so far; a search limits this number instead of its time."""

    def copy(self) -> MoveRecorder:
        """Return an independent copy with the same history."""
        other = copy(self)
        other.drive = self.drive.copy()
        other.moves, other._ends_mm = self.moves.copy(), self._ends_mm.copy()
        other._end_states, other._states = self._end_states.copy(), self._states.copy()
        other._time_s = self._time_s.copy()
        return other

    @property
    def state(self) -> ScopeState:
        """State of the scope after the last move."""
        return self.drive.state

    def set(self, turn_deg: float, flexion_deg: float) -> None:
        """Begin a move: turn the scope, then set the lever.

        Parameters
        ----------
        turn_deg
            Change of roll, degrees.
        flexion_deg
            New flexion, degrees.
        """
        took = abs(turn_deg) / TURN_DEG_PER_S
        self.roll_deg += turn_deg
        roll = math.radians(self.roll_deg)
        self._sample(self.drive.drive(self.state.insertion_mm, roll, self.state.flexion_rad, took), took)
        change = abs(flexion_deg - self.flexion_deg)
        took = change / FLEX_DEG_PER_S
        self.flexion_deg = flexion_deg
        self._sample(self.drive.drive(self.state.insertion_mm, roll, math.radians(flexion_deg), took), took)
        self.effort += 0.9 * (abs(turn_deg) + change)
        self.moves.append(Move(turn_deg, flexion_deg, 0.0))
        self._ends_mm.append(self.state.insertion_mm)
        self._end_states.append(len(self._states) - 1)

    def advance(self, step_mm: float = ADVANCE_MM) -> float:
        """Advance the current move by one step; a negative step withdraws the scope.

        Returns
        -------
        float
            Change of the insertion that was reached, mm.
        """
        if not self.moves:
            self.set(0.0, self.flexion_deg)
        before = self.state.insertion_mm
        took = ADVANCE_MM / ADVANCE_MM_PER_S
        roll, flexion = math.radians(self.roll_deg), math.radians(self.flexion_deg)
        self._sample(self.drive.drive(before + step_mm, roll, flexion, took), took)
        self.effort += 1.0
        self.moves[-1] = replace(self.moves[-1], advance_mm=self.moves[-1].advance_mm + step_mm)
        self._ends_mm[-1] = self.state.insertion_mm
        self._end_states[-1] = len(self._states) - 1
        return self.state.insertion_mm - before

    def seen_from_tip(self, place: Points) -> Points:
        """Return the position of a point in the axes of the tip, (3,) mm: right, down, forward."""
        tip = self.state.pose.lps_from_camera
        found: Points = tip[:3, :3].T @ (place - tip[:3, 3])
        return found

    def bend_by(self, to: Points, change_deg: float, most_deg: float) -> bool:
        """Bend the tip towards a point by a change of the flexion; return whether the roll or the lever changed.

        Flexion and its change are added as vectors across the shaft, in axes that do not turn with the hand.

        Parameters
        ----------
        to
            (3,) point in the axes of the tip (`seen_from_tip`).
        change_deg
            Change of the flexion.
        most_deg
            Largest flexion.
        """
        across = max(math.hypot(to[0], to[1]), 1e-9)
        right, up = change_deg * to[0] / across, -change_deg * to[1] / across
        roll = math.radians(self.roll_deg)
        bent_up = (self.flexion_deg + up) * math.cos(roll) - right * math.sin(roll)
        bent_right = (self.flexion_deg + up) * math.sin(roll) + right * math.cos(roll)
        flexion_deg = min(math.hypot(bent_up, bent_right), most_deg)
        return self.bend_to(math.degrees(math.atan2(bent_right, bent_up)), flexion_deg)

    def bend_to(self, towards_deg: float, flexion_deg: float) -> bool:
        """Begin a move that bends the tip in a direction; return whether the roll or the lever changed.

        The lever bends the tip up or down, whichever needs less roll and keeps the bend in the range of the lever. Roll
        and lever change in steps of 5 degrees.

        Parameters
        ----------
        towards_deg
            Direction of the bend in degrees, clockwise from up in the picture of the unrolled scope.
        flexion_deg
            Size of the bend.
        """
        down_deg, up_deg = (math.degrees(rad) for rad in self.drive.flexion_range_rad)
        down_deg, up_deg = STEP_DEG * math.ceil(down_deg / STEP_DEG), STEP_DEG * math.floor(up_deg / STEP_DEG)
        turn_deg, set_deg = 0.0, 0.0
        if flexion_deg > 0.5 * STEP_DEG:
            ways = []
            for half_turn, most, sign in ((0.0, up_deg, 1.0), (180.0, -down_deg, -1.0)):
                turn = (towards_deg + half_turn - self.roll_deg + 180.0) % 360.0 - 180.0
                ways.append((abs(turn) + 10.0 * max(flexion_deg - most, 0.0), turn, sign * flexion_deg))
            _, turn_deg, set_deg = min(ways)
        turn_deg = STEP_DEG * round(turn_deg / STEP_DEG)
        set_deg = min(max(STEP_DEG * round(set_deg / STEP_DEG), down_deg), up_deg)
        if turn_deg == 0.0 and set_deg == self.flexion_deg:
            return False
        self.set(turn_deg, set_deg)
        return True

    def repeat(self, moves: Iterable[Move]) -> None:
        """Execute a sequence of moves.

        Raises
        ------
        UsageError
            If a move does not advance by a whole number of millimetres.
        """
        for move in moves:
            steps = move.advance_mm / ADVANCE_MM
            if not (math.isfinite(steps) and steps == round(steps)):
                raise UsageError(
                    f"a drive's moves advance by whole millimetres; found {move.advance_mm}", code="plan.moves"
                )
            self.set(move.turn_deg, move.flexion_deg)
            for _ in range(abs(round(steps))):
                self.advance(math.copysign(ADVANCE_MM, steps))

    def driven(self, way: DriveWay, *, stopped_mm: float, why: str | None) -> DrivenRoute:
        """Return the recorded moves and states as a `DrivenRoute`.

        Parameters
        ----------
        way
            Route of the drive.
        stopped_mm
            Distance of the tip along the smooth route.
        why
            Reason why the scope stopped early; None if it arrived.
        """
        scope = self.drive.scope
        along_mm = self._start_mm
        farthest: list[float] = []
        for state in self._states:
            along_mm = way.nearest(state.pose.position_lps, along_mm)[0]
            farthest.append(max(along_mm, farthest[-1] if farthest else 0.0))
        cameras = [scope.camera_pose(state.pose).lps_from_camera for state in self._states]
        return DrivenRoute(
            scope_name=scope.name,
            start_mm=self._start_mm,
            moves=tuple(self.moves),
            ends_mm=tuple(self._ends_mm),
            ends_along_mm=tuple(way.from_origin_mm(farthest[n]) for n in self._end_states),
            samples=np.array([[s.insertion_mm, s.roll_rad, s.flexion_rad] for s in self._states]),
            lps_from_camera=np.array(cameras),
            time_s=np.array(self._time_s),
            arrived=why is None,
            stopped_mm=way.from_origin_mm(stopped_mm),
            why=why,
        )

    def _sample(self, state: ScopeState, took_s: float) -> None:
        self._states.append(state)
        self._time_s.append(self._time_s[-1] + took_s)


def replay_moves(drive: ScopeDrive, moves: Iterable[Move]) -> tuple[Pose, ...]:
    """Execute the moves of a drive with a scope that was placed at the start of the drive.

    Parameters
    ----------
    drive
        Scope that was placed and not moved since.
    moves
        Moves of a `DrivenRoute`.

    Returns
    -------
    tuple[Pose, ...]
        Pose of the tip after each move.

    Raises
    ------
    UsageError
        If a move is not a number or advances by part of a millimetre.
    """
    recorder = MoveRecorder(drive)
    poses = []
    for move in moves:
        recorder.repeat((move,))
        poses.append(recorder.state.pose)
    return tuple(poses)


def moves_between(driven: DrivenRoute, from_mm: float, to_mm: float) -> tuple[Move, ...]:
    """Return the moves of a drive between two insertions, for one step of a list of turns.

    A move that extends beyond an end is cut there: its second part has the same flexion and no turn. Turns and lever
    settings at ``from_mm`` are included; those at ``to_mm`` are not, except for a last move that only aims.

    Parameters
    ----------
    driven
        Drive of a verdict.
    from_mm, to_mm
        Insertions, as in ``ends_mm``.
    """
    found: list[Move] = []
    begins = driven.start_mm
    for n, (move, ends) in enumerate(zip(driven.moves, driven.ends_mm, strict=True)):
        low, high = max(begins, from_mm), min(ends, to_mm)
        is_last = n + 1 == len(driven.moves)
        if high > low or (ends <= begins and from_mm <= begins and (begins < to_mm or (is_last and begins <= to_mm))):
            starts_here = begins >= from_mm
            advance_mm = high - low if high > low else ends - begins
            found.append(Move(move.turn_deg if starts_here else 0.0, move.flexion_deg, round(advance_mm, 1)))
        begins = ends
    return tuple(found)
