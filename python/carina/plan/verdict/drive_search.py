"""Search for a drive: the turns, flexions and advances that bring a scope along a route.

Each attempt steers by one rule. The tip is turned towards a point of the route ahead, in steps of 5 degrees and only if
the tip points too far off. At a fork some rules pull the lever towards the opening while the tip passes the fork. An
attempt that enters a wrong branch or is blocked is cut back to its last part on the route, and the next attempt starts
there with another, randomly drawn rule, until an attempt arrives or the effort is spent. The result is the moves of one
attempt from its beginning; the elastic model executed each of them (docs/decisions/0142).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carina.errors import CancelledError, UsageError
from carina.plan.hand_moves import Move
from carina.plan.verdict.drive import DrivenRoute, MoveRecorder
from carina.plan.verdict.drive_route import DriveWay
from carina.scopes import ScopeDrive, ScopePreset, WallField

Points = NDArray[np.float64]

EFFORT = 50_000.0
"""Maximum effort of a search for a drive, in small steps of the model (about 0.1 ms each)."""
ARRIVED_MM = 1.0
START_MM, START_BEFORE_FORK_MM = 30.0, 20.0
"""Start of the scope in the upper trachea: distance along the route, and least distance before the first fork."""
BLOCKED_STEPS = 7
"""Number of consecutive advances blocked by the wall after which an attempt ends."""
ASTRAY_MM = 2.5
SLACK_MM = 25.0
"""Maximum difference in mm between insertion and progress along the route; beyond it the scope buckles or strays."""
MAX_STEPS = 700
ON_COURSE_COSINE = 0.64
"""Cosine of 50 degrees, the largest angle between the tip and the route for a tip that points along the route."""
BEND_BEHIND_MM, BEND_AHEAD_MM = 45.0, 8.0
"""Distances behind and ahead of the tip in mm between which the bend of the route is measured."""
AT_FORK_MM = 12.0
"""Distance from a fork in mm within which a stop of the drive is reported as a stop at this fork."""
HOOKING = 0.5
"""Probability with which a randomly drawn steering rule pulls the lever at each fork (`_Rule.hook`)."""
HOOK_BLOCKED_STEPS = 4
PAST_FORK_MM = 6.0
"""Distance in mm beyond a fork up to which the fork still counts as the next one."""
CONDENSING = 60
"""Maximum number of shorter drives that are tried after a drive has arrived (`condense_drive`)."""
STATION_MM = 2.0
"""Distance in mm along the route between stored copies of an attempt from which other attempts can start."""
MAX_STORED = 3
"""Maximum number of stored attempts (the best ones), from which later attempts start."""


@dataclass(frozen=True, slots=True)
class _Rule:
    """Steering rule of one attempt; angles in degrees."""

    mode: str = "opening"
    """Choice of the point that the tip turns to.

    ``visible`` is the farthest visible point of the route, ``ahead`` a point at a fixed distance ahead. ``opening`` is
    the opening of the branch to be entered if a fork is near, else the visible point.
    """
    far_mm: float = 25.0
    clear_mm: float = 1.0
    ahead_mm: float = 10.0
    fork_within_mm: float = 20.0
    beyond_fork_mm: float = 6.0
    gain: float = 0.8
    """Change of flexion as a share of the angle between the tip's direction and the steering point."""
    dead_deg: float = 8.0
    """Angle in degrees between the tip's direction and the steering point below which roll and lever stay unchanged."""
    hold_mm: float = 2.0
    """Insertion in mm during which roll and lever do not change after a change."""
    rate_deg: float = 15.0
    """Largest change of flexion in one step, degrees."""
    slack_deg: float = 60.0
    """Largest excess of the flexion over the bend of the route, degrees."""
    hook: bool = False
    """Whether the lever is pulled towards the opening at each fork, millimetre by millimetre, and held."""
    hook_before_mm: float = 0.0
    hook_until_mm: float = 8.0
    hook_flexion_deg: float = 120.0
    hook_rate_deg: float = 10.0
    """Change of flexion in degrees per millimetre of advance while the lever is pulled towards an opening."""
    hook_off_deg: float = 0.0
    """Offset of the roll from the direction of the opening, degrees."""

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> _Rule:
        """Return a steering rule with randomly drawn values."""
        return cls(
            mode=("visible", "ahead", "opening", "opening")[int(rng.integers(4))],
            far_mm=rng.uniform(12.0, 30.0),
            clear_mm=rng.uniform(0.5, 1.8),
            ahead_mm=rng.uniform(5.0, 16.0),
            fork_within_mm=rng.uniform(8.0, 25.0),
            beyond_fork_mm=rng.uniform(2.0, 12.0),
            gain=rng.uniform(0.3, 1.2),
            dead_deg=rng.uniform(5.0, 22.0),
            hold_mm=rng.uniform(1.0, 5.0),
            rate_deg=rng.uniform(5.0, 30.0),
            slack_deg=rng.uniform(20.0, 120.0),
            hook=bool(rng.random() < HOOKING),
            hook_before_mm=rng.uniform(-5.0, 8.0),
            hook_until_mm=rng.uniform(4.0, 14.0),
            hook_flexion_deg=(45.0, 90.0, 120.0, 160.0, 200.0)[int(rng.integers(5))],
            hook_rate_deg=(5.0, 10.0, 15.0, 20.0, 30.0)[int(rng.integers(5))],
            hook_off_deg=rng.normal(0.0, 30.0),
        )


@dataclass(frozen=True, slots=True)
class _StoredAttempt:
    """Stored attempt, up to the last point at which the tip was on the route."""

    along_mm: float
    stations: tuple[_Attempt, ...]
    """Copies of the attempt at earlier points of the route, from its start; other attempts start from them."""

    def before(self, along_mm: float) -> _Attempt:
        """Return the last stored copy of the attempt before a distance along the route."""
        return next((one for one in reversed(self.stations) if one.along_mm <= along_mm), self.stations[0])


def place_at_start(way: DriveWay, wall: WallField, scope: ScopePreset) -> ScopeDrive:
    """Place a new scope in the upper trachea, where a drive begins.

    Parameters
    ----------
    way, wall, scope
        The route, the wall of the airways and the instrument.

    Raises
    ------
    UsageError
        If the scope does not fit into the airway (code ``scope.drive``).
    """
    drive = ScopeDrive(wall, scope, way.points)
    drive.place(way.points, start_mm(way, drive))
    return drive


def start_mm(way: DriveWay, drive: ScopeDrive) -> float:
    """Return the distance along the route in mm at which the scope is placed.

    Parameters
    ----------
    way, drive
        The route, and the scope that has not been placed.
    """
    before_fork = float(way.forks_mm[0]) - START_BEFORE_FORK_MM if len(way.forks_mm) else START_MM
    return max(min(START_MM, before_fork, 0.5 * way.park_mm), drive.entry_mm)


def search_drive(
    way: DriveWay,
    wall: WallField,
    scope: ScopePreset,
    *,
    effort: float = EFFORT,
    seed: int = 0,
    cancel: Callable[[], bool] | None = None,
) -> DrivenRoute:
    """Search a drive along a route; return the one that got farthest if none arrives.

    Parameters
    ----------
    way, wall, scope
        The route, the wall of the airways and the instrument.
    effort
        Limit of the search, in small steps of the model. The result depends only on the arguments, not on the time.
    seed
        Seed of the random rules.
    cancel
        Called between attempts; the search stops when it returns True.

    Returns
    -------
    DrivenRoute
        The drive, with the reason for its stop if it did not arrive.

    Raises
    ------
    UsageError
        If the scope does not fit into the airway (code ``scope.drive``), or the effort is not above 0.
    CancelledError
        If ``cancel()`` returned True.
    """
    if not (math.isfinite(effort) and effort > 0.0):
        raise UsageError(f"effort: expected above 0; found {effort}", code="plan.range")
    rng = np.random.default_rng(seed)
    start = _Attempt(way, place_at_start(way, wall, scope))
    stored: list[_StoredAttempt] = []
    in_vain, spent, num = 0, 0.0, 0
    farthest: _Attempt | None = None
    while spent < effort:
        if cancel is not None and cancel():
            raise CancelledError("the search for a drive was cancelled")
        rule = _Rule() if num == 0 else _Rule.drawn(rng)
        begin = start
        known: tuple[_Attempt, ...] = ()
        if stored and num > 1:
            # Attempts that got farther are chosen more often. The start moves back as attempts without progress
            # accumulate.
            from_one = stored[min(int(rng.integers(len(stored))), int(rng.integers(len(stored))))]
            back_mm = rng.uniform(2.0, 10.0 + 4.0 * min(in_vain, 15))
            begin = from_one.before(from_one.along_mm - back_mm)
            known = from_one.stations[: from_one.stations.index(begin)]
        attempt = begin.copy()
        attempt.go(rule)
        spent += attempt.recorder.effort - begin.recorder.effort
        num += 1
        if farthest is None or attempt.good_mm > farthest.good_mm or attempt.arrived:
            farthest = attempt
        if attempt.arrived:
            break
        best_mm = stored[0].along_mm if stored else 0.0
        in_vain = 0 if attempt.good_mm > best_mm + 1.0 else in_vain + 1
        stored.append(_StoredAttempt(attempt.good_mm, (*known, begin, *attempt.stations)))
        stored.sort(key=lambda one: -one.along_mm)
        del stored[MAX_STORED:]
    assert farthest is not None
    stopped_mm = farthest.along_mm if farthest.arrived else farthest.good_mm
    return farthest.recorder.driven(way, stopped_mm=stopped_mm, why=None if farthest.arrived else farthest.why())


def condense_drive(
    way: DriveWay,
    wall: WallField,
    scope: ScopePreset,
    driven: DrivenRoute,
    *,
    tries: int = CONDENSING,
    cancel: Callable[[], bool] | None = None,
) -> DrivenRoute:
    """Return a drive with fewer moves that still arrives.

    Moves are left out, last ones first, and the move before them advances farther instead. Each shorter drive is
    simulated again. A drive that did not arrive is returned unchanged.

    Parameters
    ----------
    way, wall, scope, driven
        The route, the wall of the airways, the instrument and its drive.
    tries
        Largest number of shorter drives that are simulated.
    cancel
        Called between attempts; the search stops when it returns True.

    Raises
    ------
    CancelledError
        If ``cancel()`` returned True.
    """
    if not driven.arrived:
        return driven
    moves, best = list(driven.moves), driven
    # A shorter drive begins like the best one, so it starts from a copy of the scope before its first other move.
    # There are fewer copies than moves if the repeated drive leaves the route, as each shorter drive would.
    earlier: list[_Attempt] = []
    _Attempt(way, place_at_start(way, wall, scope)).arrives_by(moves, earlier)
    for num in (4, 2, 1):
        n = len(moves) - num
        while n >= 1 and tries > 0:
            if cancel is not None and cancel():
                raise CancelledError("the search for a shorter drive was cancelled")
            left_out = sum(move.advance_mm for move in moves[n : n + num])
            turned = sum(move.turn_deg for move in moves[n : n + num])
            shorter = [*moves[: n - 1], replace(moves[n - 1], advance_mm=moves[n - 1].advance_mm + left_out)]
            rest = moves[n + num :]
            if rest:
                # The turn of the first remaining move is changed so that the roll after it stays the same.
                rest = [replace(rest[0], turn_deg=(rest[0].turn_deg + turned + 180.0) % 360.0 - 180.0), *rest[1:]]
            tries -= 1
            if n <= len(earlier):
                attempt = earlier[n - 1].copy()
                passed: list[_Attempt] = []
                if attempt.arrives_by((shorter[-1], *rest), passed):
                    moves = [*shorter, *rest]
                    earlier = [*earlier[: n - 1], *passed]
                    best = attempt.recorder.driven(way, stopped_mm=attempt.along_mm, why=None)
            n -= num
    return best


def arrives_by(way: DriveWay, wall: WallField, scope: ScopePreset, moves: tuple[Move, ...]) -> bool:
    """Return whether a scope arrives at the end of the route by these moves; the lever stops at its limits."""
    return _Attempt(way, place_at_start(way, wall, scope)).arrives_by(moves)


class _Attempt:
    """Simulated drive of a scope along the route with one set of parameters, until it arrives or gets stuck."""

    def __init__(self, way: DriveWay, drive: ScopeDrive) -> None:
        self.way, self.recorder = way, MoveRecorder(drive)
        self.along_mm, self.off_mm = way.nearest(drive.state.pose.position_lps, drive.state.insertion_mm)
        self.good_mm = self.along_mm
        self.stations: list[_Attempt] = []
        """Copies of this attempt every few millimetres of the route, from which other attempts can start."""
        self.arrived = False
        self._blocked = 0
        self._changed_mm = 0.0
        self._hooked_fork: float | None = None
        self._done_fork: float | None = None
        self._hooked_deg = self._hook_towards_deg = 0.0

    def copy(self) -> _Attempt:
        """Return an independent copy of the attempt, without ``stations``, from which a search can restart."""
        other = copy(self)
        other.recorder, other.stations = self.recorder.copy(), []
        return other

    def arrives_by(self, moves: Sequence[Move], earlier: list[_Attempt] | None = None) -> bool:
        """Return whether the tip arrives at the end of the route by these moves and never leaves the route.

        Parameters
        ----------
        moves
            Moves from the present state.
        earlier
            Receives a copy of the attempt before each move; None stores none.
        """
        for move in moves:
            if earlier is not None:
                earlier.append(self.copy())
            self.recorder.set(move.turn_deg, move.flexion_deg)
            for _ in range(round(move.advance_mm)):
                self._advance()
                if self._is_lost():
                    return False
        return self._is_on_course() and abs(self.along_mm - self.way.park_mm) <= 2.0 * ARRIVED_MM

    def go(self, rule: _Rule) -> None:
        """Advance the scope by a steering rule until the tip arrives or leaves the route."""
        self._forget()
        for _ in range(MAX_STEPS):
            self._steer(rule)
            self._advance()
            if self._is_lost():
                return
            if self._is_on_course():
                self.good_mm = self.along_mm
                last_mm = self.stations[-1].along_mm if self.stations else -math.inf
                if self.along_mm >= last_mm + STATION_MM:
                    self.stations.append(self.copy())
                if self.along_mm >= self.way.park_mm - ARRIVED_MM:
                    self.arrived = True
                    return

    def _forget(self) -> None:
        """Reset the state that the previous steering rule left."""
        self._changed_mm = 0.0
        self._blocked = 0
        self._hooked_fork = self._done_fork = None

    def why(self) -> str:
        """Return the reason why the attempt stopped, as text."""
        state = self.recorder.state
        before = self.way.forks_mm[self.way.forks_mm < self.good_mm + AT_FORK_MM]
        if len(before) and before[-1] > self.good_mm - AT_FORK_MM:
            fork = float(before[-1])
            cosine = float(np.clip(self.way.direction(fork - 8.0) @ self.way.direction(fork + 8.0), -1.0, 1.0))
            place = f" at fork {len(before)}, which turns {math.degrees(math.acos(cosine)):.0f} degrees"
        else:
            place = ""
        if state.limit == "length":
            return f"its working length ends{place}"
        if self._blocked >= BLOCKED_STEPS and state.passable_mm is not None:
            return f"its tip would have to be {state.passable_mm:.1f} mm wide to go on{place}"
        if self._blocked >= BLOCKED_STEPS:
            return f"its tip is pressed against the wall{place}"
        return f"its tip does not turn into the next branch{place}"

    def _advance(self) -> None:
        got_mm = self.recorder.advance()
        self.along_mm, self.off_mm = self.way.nearest(self._tip()[:3, 3], self.along_mm)
        self._blocked = self._blocked + 1 if got_mm < 0.5 else 0

    def _tip(self) -> Points:
        return self.recorder.state.pose.lps_from_camera

    def _is_lost(self) -> bool:
        radius = self.way.radius_mm(self.along_mm)
        return (
            self._blocked >= BLOCKED_STEPS
            or self.off_mm > max(radius + ASTRAY_MM, 2.0 * radius)
            or self.recorder.state.insertion_mm > self.along_mm + SLACK_MM
        )

    def _is_on_course(self) -> bool:
        if self.off_mm > max(0.8 * self.way.radius_mm(self.along_mm), 0.7):
            return False
        tip = self._tip()
        ahead_mm, behind_mm = min(self.along_mm + 5.0, self.way.length_mm), max(self.along_mm - 1.0, 0.0)
        along = self.way.point(ahead_mm) - self.way.point(behind_mm)
        cosine = float(along @ tip[:3, 2]) / max(float(np.linalg.norm(along)), 1e-9)
        return cosine > ON_COURSE_COSINE and self.way.holds(tip[:3, 3], self.along_mm)

    def _steer(self, rule: _Rule) -> None:
        forks = self.way.forks_mm[self.way.forks_mm > self.along_mm - PAST_FORK_MM]
        fork = float(forks[0]) if len(forks) else None
        if rule.hook and fork is not None and self._hook(fork, rule):
            return
        to = self.recorder.seen_from_tip(self._place(fork, rule))
        angle = math.degrees(math.atan2(math.hypot(to[0], to[1]), to[2]))
        rested = self.recorder.state.insertion_mm - self._changed_mm >= rule.hold_mm
        if not ((angle > rule.dead_deg and rested) or self._blocked):
            return
        change = min(rule.gain * angle * (1.0 + 0.5 * self._blocked), rule.rate_deg)
        if self.recorder.bend_by(to, change, self._bend_deg() + rule.slack_deg):
            self._changed_mm = self.recorder.state.insertion_mm

    def _hook(self, fork: float, rule: _Rule) -> bool:
        """Pull the lever towards the branch beyond a fork; return whether the lever is pulled or held now."""
        if self._hooked_fork is not None:
            if self.along_mm < self._hooked_fork + rule.hook_until_mm and self._blocked < HOOK_BLOCKED_STEPS:
                if self._hooked_deg < rule.hook_flexion_deg:
                    self._hooked_deg = min(self._hooked_deg + rule.hook_rate_deg, rule.hook_flexion_deg)
                    self.recorder.bend_to(self._hook_towards_deg, self._hooked_deg)
                return True
            self._done_fork, self._hooked_fork = self._hooked_fork, None
            return False
        if self.along_mm < fork - rule.hook_before_mm or self._done_fork == fork or self._blocked:
            return False
        to = self.recorder.seen_from_tip(self.way.at(min(fork + rule.beyond_fork_mm, self.way.length_mm)))
        towards_deg = self.recorder.roll_deg + math.degrees(math.atan2(to[0], -to[1])) + rule.hook_off_deg
        self._hooked_fork, self._hook_towards_deg = fork, towards_deg
        self._hooked_deg = min(rule.hook_rate_deg, rule.hook_flexion_deg)
        self.recorder.bend_to(towards_deg, self._hooked_deg)
        return True

    def _place(self, fork: float | None, rule: _Rule) -> Points:
        if rule.mode == "ahead":
            return self.way.at(min(self.along_mm + rule.ahead_mm, self.way.length_mm))
        if rule.mode == "opening" and fork is not None and fork - self.along_mm < rule.fork_within_mm:
            return self.way.at(min(fork + rule.beyond_fork_mm, self.way.length_mm))
        return self.way.visible(self._tip()[:3, 3], self.along_mm, rule.far_mm, rule.clear_mm)

    def _bend_deg(self) -> float:
        """Return the bend of the route in degrees over the length of the bending section at the tip."""
        behind, ahead = max(self.along_mm - BEND_BEHIND_MM, 0.0), self.along_mm + BEND_AHEAD_MM
        cosine = float(np.clip(self.way.direction(behind) @ self.way.direction(ahead), -1.0, 1.0))
        return math.degrees(math.acos(cosine))
