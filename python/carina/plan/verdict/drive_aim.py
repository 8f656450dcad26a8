"""Last moves of a drive, which point the tip of a scope at the target without an advance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carina.plan.hand_moves import Move
from carina.plan.verdict.drive import STEP_DEG, DrivenRoute, MoveRecorder
from carina.plan.verdict.drive_route import DriveWay
from carina.plan.verdict.drive_search import place_at_start
from carina.scopes import ScopePreset, WallField

__all__ = ["AimedDrive", "aim_drive"]

Points = NDArray[np.float64]
HitShare = Callable[[Points, Points], float]
_Judged = tuple[float, float, MoveRecorder]
"""Share of hits, angle in degrees from the target, and the recorder of the moves that led there."""

GAIN, MOST_CHANGE_DEG, MOST_MOVES = 0.8, 30.0, 12
FLEXION_MOST_DEG = 210.0
GOOD, ENOUGH = 0.95, 0.5
"""Shares of needles that hit the target.

Above the first share no more moves are tried. Below the second share a grid of rolls and lever settings is tried.
"""
WITHDRAWALS_MM = (3.0, 6.0, 10.0, 15.0)
"""Distances in mm by which the scope is withdrawn before it is aimed again, if fewer than half of the needles hit."""
NUM_ROLLS, NUM_LEVERS = 12, 4
BEST_HOLDS = 3
"""Number of grid entries that are simulated: those that point nearest to the target."""


@dataclass(frozen=True, slots=True)
class AimedDrive:
    """Drive that ends with the tip pointed at the target as well as possible."""

    driven: DrivenRoute
    share: float
    """Share of the needles from the tip's final pose that hit the target, 0 to 1."""
    off_deg: float
    """Angle in degrees between the tip's direction and the direction to the middle of the target."""
    lps_from_tip: NDArray[np.float64]
    """(4, 4) final pose of the tip."""


def aim_drive(
    way: DriveWay, wall: WallField, scope: ScopePreset, driven: DrivenRoute, hit_share: HitShare
) -> AimedDrive:
    """Add moves to a drive that point the tip at the target.

    Parameters
    ----------
    way, wall, scope, driven
        A drive that has arrived, and the route, wall and scope that it was found with.
    hit_share
        Function of a tip's position and direction, (3,) each, that returns the share of needles that hit.

    Returns
    -------
    AimedDrive
        The drive with the best share of hits; with equal shares, the one that points nearest to the target.
    """
    # A copy of a scope responds like the original, so the moves of the drive are executed only once.
    arrived = MoveRecorder(place_at_start(way, wall, scope))
    arrived.repeat(driven.moves)
    found: list[_Judged] = []
    for back_mm in (0.0, *WITHDRAWALS_MM):
        if found and max(found, key=_worth)[0] >= ENOUGH:
            break
        recorder = arrived.copy()
        if back_mm > 0.0:
            recorder.repeat((Move(0.0, recorder.flexion_deg, -back_mm),))
        found += _turned_to_aim(recorder, way, hit_share)
    if max(found, key=_worth)[0] < ENOUGH:
        for hold in _holds(arrived.copy(), way.aim):
            recorder = arrived.copy()
            recorder.repeat((hold,))
            found.append((*_judged(recorder, way.aim, hit_share), recorder))
    share, off_deg, recorder = max(found, key=_worth)
    aimed = recorder.driven(way, stopped_mm=way.park_mm, why=None)
    tip = recorder.state.pose.lps_from_camera
    return AimedDrive(replace(aimed, stopped_mm=driven.stopped_mm), share, off_deg, tip)


def _turned_to_aim(recorder: MoveRecorder, way: DriveWay, hit_share: HitShare) -> list[_Judged]:
    """Turn the tip step by step to the target, and return the result of each step.

    A step that points farther off is taken back, and the next one is smaller.
    """
    found = [(*_judged(recorder, way.aim, hit_share), recorder)]
    best, best_deg, gain = recorder, found[0][1], GAIN
    for _ in range(MOST_MOVES):
        if found[-1][0] >= GOOD:
            break
        tried = best.copy()
        to = tried.seen_from_tip(way.aim)
        angle = math.degrees(math.atan2(math.hypot(to[0], to[1]), to[2]))
        if not tried.bend_by(to, min(gain * angle, MOST_CHANGE_DEG), FLEXION_MOST_DEG):
            break
        found.append((*_judged(tried, way.aim, hit_share), tried))
        if found[-1][1] < best_deg:
            best, best_deg = tried, found[-1][1]
        else:
            gain *= 0.5
    return found


def _worth(one: _Judged) -> tuple[float, float]:
    return one[0], -one[1]


def _judged(recorder: MoveRecorder, aim: Points, hit_share: HitShare) -> tuple[float, float]:
    tip = recorder.state.pose.lps_from_camera
    off = aim - tip[:3, 3]
    cosine = float(np.clip(tip[:3, 2] @ off / max(float(np.linalg.norm(off)), 1e-9), -1.0, 1.0))
    return hit_share(tip[:3, 3], tip[:3, 2]), math.degrees(math.acos(cosine))


def _holds(recorder: MoveRecorder, aim: Points) -> list[Move]:
    """Return the rolls and lever settings that point the tip nearest to the target, as moves from the present state."""
    drive, roll_deg = recorder.drive, recorder.roll_deg
    down, up = (math.degrees(rad) for rad in drive.flexion_range_rad)
    levers = [*np.linspace(0.0, up, NUM_LEVERS + 1)[1:], 0.0, *np.linspace(0.0, down, NUM_LEVERS + 1)[1:]]
    held: list[tuple[float, Move]] = []
    insertion_mm = drive.state.insertion_mm
    for turn in STEP_DEG * np.round(360.0 * np.arange(NUM_ROLLS) / NUM_ROLLS / STEP_DEG):
        roll = math.radians(roll_deg + float(turn))
        drive.drive(insertion_mm, roll, 0.0, 0.1)
        for lever in levers:
            flexion_deg = STEP_DEG * math.trunc(float(lever) / STEP_DEG)
            state = drive.drive(insertion_mm, roll, math.radians(flexion_deg), 0.1)
            tip = state.pose.lps_from_camera
            off = aim - tip[:3, 3]
            cosine = float(tip[:3, 2] @ off) / max(float(np.linalg.norm(off)), 1e-9)
            back = (float(turn) + 180.0) % 360.0 - 180.0
            held.append((-cosine, Move(back, flexion_deg, 0.0)))
    held.sort(key=lambda one: one[0])
    return [move for _, move in held[:BEST_HOLDS]]
