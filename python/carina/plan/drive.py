"""A scope driven along a route: moves of the hand, and what became of them in the airways' wall.

A drive is its moves: whoever places the same scope in the same place and carries them out gets the same poses, for
`carina.ScopeDrive` is a function of its samples (docs/decisions/0122).
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
from carina.plan.drive_way import DriveWay
from carina.plan.moves import Move
from carina.scopes import Pose, ScopeDrive, ScopeState

__all__ = ["DrivenRoute", "MoveRecorder", "moves_between", "replay_moves"]

Points = NDArray[np.float64]

STEP_DEG = 5.0
"""A hand turns and sets the lever in steps of this."""
ADVANCE_MM = 1.0
"""A move advances in steps of this; a step that the wall holds up is not made up for."""
TURN_DEG_PER_S, FLEX_DEG_PER_S, ADVANCE_MM_PER_S = 60.0, 60.0, 10.0
"""How fast a drive is shown (k)."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class DrivenRoute:
    """A drive that was carried out: from the upper trachea to where it stopped."""

    scope_name: str
    start_mm: float
    """The insertion at which the scope was placed (`carina.ScopeDrive.place`)."""
    moves: tuple[Move, ...]
    ends_mm: tuple[float, ...]
    """The insertion at which each move ends: the length of the scope that is in."""
    ends_along_mm: tuple[float, ...]
    """How far along the route the tip has come when each move ends, from the root along the branches' centrelines."""
    samples: Points
    """(n, 3) insertion in mm, roll and flexion in radians that the scope had reached; the first as it was placed, then
    after each turn, each setting of the lever, and each millimetre."""
    lps_from_camera: NDArray[np.float64]
    """(n, 4, 4) its camera at each sample."""
    time_s: NDArray[np.float64]
    """(n,) when, for whoever flies it: at 60 degrees and 10 mm a second."""
    arrived: bool
    """It stands where the route ends."""
    stopped_mm: float
    """How far along the route the tip is in the end, in the measure of ``ends_along_mm``."""
    why: str | None
    """Why it did not get farther; None where it arrived."""

    def to_json(self, *, poses: bool = True) -> dict[str, Any]:
        """Plain JSON types; without ``poses`` what can be made again from the moves is left out."""
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
    """Carries out moves one by one and keeps what became of them.

    A move turns the scope in one sample, sets the lever in one, then advances 1 mm a sample from where the scope is.

    Parameters
    ----------
    drive
        A scope that was placed; nobody else drives it.
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
        """Small steps of the model, about: what a search counts instead of seconds."""

    def copy(self) -> MoveRecorder:
        """Another of the same beginning; what is done with one does not move the other."""
        other = copy(self)
        other.drive = self.drive.copy()
        other.moves, other._ends_mm = self.moves.copy(), self._ends_mm.copy()
        other._end_states, other._states = self._end_states.copy(), self._states.copy()
        other._time_s = self._time_s.copy()
        return other

    @property
    def state(self) -> ScopeState:
        """The scope now."""
        return self.drive.state

    def set(self, turn_deg: float, flexion_deg: float) -> None:
        """Begin a move: turn, then set the lever."""
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
        """One step of the move that was begun, or one back; how far it got, mm."""
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
        """(3,) right, down and forward of the tip, mm."""
        tip = self.state.pose.lps_from_camera
        found: Points = tip[:3, :3].T @ (place - tip[:3, 3])
        return found

    def bend_by(self, to: Points, change_deg: float, most_deg: float) -> bool:
        """Bend the tip by so much more towards a place that `seen_from_tip` gave; whether anything was set.

        Flexion is taken as a vector across the shaft, in axes that do not turn with the hand.
        """
        across = max(math.hypot(to[0], to[1]), 1e-9)
        right, up = change_deg * to[0] / across, -change_deg * to[1] / across
        roll = math.radians(self.roll_deg)
        bent_up = (self.flexion_deg + up) * math.cos(roll) - right * math.sin(roll)
        bent_right = (self.flexion_deg + up) * math.sin(roll) + right * math.cos(roll)
        flexion_deg = min(math.hypot(bent_up, bent_right), most_deg)
        return self.bend_to(math.degrees(math.atan2(bent_right, bent_up)), flexion_deg)

    def bend_to(self, towards_deg: float, flexion_deg: float) -> bool:
        """Begin a move that bends the tip to a clock hand of the unrolled scope; whether anything had to be set.

        By the lever's up or down, whichever needs less turning, in steps of 5 degrees.
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
        """Carry out moves.

        Raises
        ------
        UsageError
            If one advances by part of a millimetre.
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
        """All of it as a value; ``stopped_mm`` along the smooth route, ``why`` None where it arrived."""
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
            ends_along_mm=tuple(way.told_mm(farthest[n]) for n in self._end_states),
            samples=np.array([[s.insertion_mm, s.roll_rad, s.flexion_rad] for s in self._states]),
            lps_from_camera=np.array(cameras),
            time_s=np.array(self._time_s),
            arrived=why is None,
            stopped_mm=way.told_mm(stopped_mm),
            why=why,
        )

    def _sample(self, state: ScopeState, took_s: float) -> None:
        self._states.append(state)
        self._time_s.append(self._time_s[-1] + took_s)


def replay_moves(drive: ScopeDrive, moves: Iterable[Move]) -> tuple[Pose, ...]:
    """Carry out moves with a scope that was placed where they begin, and nothing else.

    Parameters
    ----------
    drive
        Placed, not moved since.
    moves
        Of a `DrivenRoute`.

    Returns
    -------
    tuple[Pose, ...]
        The tip after each move.

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
    """What the hand does between two insertions, for a list of turns.

    A move that goes on beyond one of them is cut there: the rest of it keeps its lever and has no turn. Turns and
    settings at ``from_mm`` belong to what is told, those at ``to_mm`` to what comes after; a last move that only aims
    is told with what comes before it.
    """
    found: list[Move] = []
    begins = driven.start_mm
    for n, (move, ends) in enumerate(zip(driven.moves, driven.ends_mm, strict=True)):
        low, high = max(begins, from_mm), min(ends, to_mm)
        is_last = n + 1 == len(driven.moves)
        if high > low or (ends == begins and from_mm <= begins and (begins < to_mm or (is_last and begins <= to_mm))):
            starts_here = begins >= from_mm
            found.append(Move(move.turn_deg if starts_here else 0.0, move.flexion_deg, round(high - low, 1)))
        begins = ends
    return tuple(found)
