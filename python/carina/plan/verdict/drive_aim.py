"""Last moves of a drive, which point the tip of a scope at the target without an advance."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carina.plan.hand_moves import Move
from carina.plan.verdict.drive import STEP_DEG, DrivenRoute, MoveRecorder
from carina.plan.verdict.drive_route import DriveWay
from carina.plan.verdict.drive_search import place_at_start
from carina.scopes import ScopePreset, WallField

Points = NDArray[np.float64]
HitShare = Callable[[Points, Points], float]
_Judged = tuple[float, float, MoveRecorder]
"""Share of needles that hit, angle in degrees to the target, and the recorder of the moves with this result."""

SEARCHED_MM = 5.5
"""Distance in mm before the end of the route from which, if the tip is farther off, its last part is driven again."""
GAIN, MAX_CHANGE_DEG, MAX_MOVES = 0.8, 30.0, 12
FLEXION_MAX_DEG = 210.0
GOOD, ENOUGH = 0.95, 0.5
"""Share of simulated needles that hit at which the aiming stops, and share below which a grid of holds is tried.

A hold is a pair of roll and lever setting.
"""
WITHDRAWALS_MM = (3.0, 6.0, 10.0, 15.0)
"""Distances in mm by which the scope is withdrawn before it is aimed again, if fewer than half of the needles hit."""
NUM_ROLLS, NUM_LEVERS = 12, 6
"""Number of rolls and of lever settings in the grid of holds.

The lever goes up only, because the rolls cover the full circle.
"""
NUM_THREADS = 2
"""Number of rolls of the grid that are tried at the same time; the result does not depend on the number."""
BEST_HOLDS = 4
"""Maximum number of holds (roll and lever positions) of the grid that are executed as moves: those with most hits."""
GRIDS_BACK_MM = (0.0, 3.0)
"""Distances in mm by which the scope is withdrawn before a grid of holds is tried."""
REFINED_FROM, MAX_ROUNDS, NUM_REFINED = 0.1, 6, 3
"""Limits of the refinement: least share of hits of a refined hold, number of rounds, number of refined holds."""
SMALL_CHANGES = (
    *((turn_deg, 0.0, 0.0) for turn_deg in (-30.0, -10.0, 10.0, 30.0)),
    *((0.0, lever_deg, 0.0) for lever_deg in (-30.0, -10.0, 10.0, 30.0)),
    *((0.0, 0.0, advance_mm) for advance_mm in (-3.0, -1.0, 1.0, 2.0)),
)
"""Small changes of a hold that are tried in each round: turn and lever in degrees, advance in mm."""


@dataclass(frozen=True, slots=True)
class AimedDrive:
    """Drive that ends with the tip pointed at the target as well as possible."""

    driven: DrivenRoute
    share: float
    """Share of the needles from the tip's final pose that hit the target, 0 to 1."""
    off_deg: float
    """Angle in degrees between the tip's direction and the direction to the middle of the target."""
    before_mm: float
    """Distance in mm along the route from the tip to the end of the route; 0 or less at or beyond the end."""
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
        for back_mm in GRIDS_BACK_MM:
            withdrawn = arrived.copy()
            if back_mm > 0.0:
                withdrawn.repeat((Move(0.0, arrived.flexion_deg, -back_mm),))
            for hold in _holds(withdrawn, way.aim, hit_share):
                recorder = withdrawn.copy()
                recorder.repeat(hold)
                found.append((*_judged(recorder, way.aim, hit_share), recorder))
    found.sort(key=_worth, reverse=True)
    for one in found[:NUM_REFINED]:
        if max(found, key=_worth)[0] >= ENOUGH:
            break
        found.append(_refined(one, way, hit_share))
    share, off_deg, recorder = max(found, key=_worth)
    aimed = recorder.driven(way, stopped_mm=way.park_mm, why=None)
    tip = recorder.state.pose.lps_from_camera
    before_mm = way.park_mm - way.nearest(tip[:3, 3], way.park_mm)[0]
    if before_mm > SEARCHED_MM:
        before_mm = way.park_mm - way.nearest(tip[:3, 3], way.park_mm - 2.0 * SEARCHED_MM)[0]
    return AimedDrive(replace(aimed, stopped_mm=driven.stopped_mm), share, off_deg, before_mm, tip)


def _turned_to_aim(recorder: MoveRecorder, way: DriveWay, hit_share: HitShare) -> list[_Judged]:
    """Turn the tip step by step to the target, and return the result of each step.

    A step that points farther off is undone, and the next step is smaller.
    """
    found = [(*_judged(recorder, way.aim, hit_share), recorder)]
    best, best_deg, gain = recorder, found[0][1], GAIN
    for _ in range(MAX_MOVES):
        if found[-1][0] >= GOOD:
            break
        tried = best.copy()
        to = tried.seen_from_tip(way.aim)
        angle = math.degrees(math.atan2(math.hypot(to[0], to[1]), to[2]))
        if not tried.bend_by(to, min(gain * angle, MAX_CHANGE_DEG), FLEXION_MAX_DEG):
            break
        found.append((*_judged(tried, way.aim, hit_share), tried))
        if found[-1][1] < best_deg:
            best, best_deg = tried, found[-1][1]
        else:
            gain *= 0.5
    return found


def _refined(best: _Judged, way: DriveWay, hit_share: HitShare) -> _Judged:
    """Return the best hold after small changes of roll, lever and advance that increase the share of hits.

    Only a hold from which some, but fewer than half, of the needles hit is changed.
    """
    if not REFINED_FROM <= best[0] < ENOUGH:
        return best
    for _ in range(MAX_ROUNDS):
        recorder = best[2]
        tried = []
        for turn_deg, lever_deg, advance_mm in SMALL_CHANGES:
            changed = recorder.copy()
            down_deg, up_deg = (math.degrees(rad) for rad in changed.drive.flexion_range_rad)
            flexion_deg = min(max(changed.flexion_deg + lever_deg, down_deg), up_deg)
            changed.repeat((Move(turn_deg, flexion_deg, advance_mm),))
            if advance_mm > 0.0 and changed.state.insertion_mm < recorder.state.insertion_mm + 0.5 * advance_mm:
                continue
            tried.append((*_judged(changed, way.aim, hit_share), changed))
        better = max(tried, key=_worth, default=best)
        if better[0] <= best[0]:
            break
        best = better
        if best[0] >= GOOD:
            break
    return best


def _worth(one: _Judged) -> tuple[float, float]:
    return one[0], -one[1]


def _judged(recorder: MoveRecorder, aim: Points, hit_share: HitShare) -> tuple[float, float]:
    tip = recorder.state.pose.lps_from_camera
    off = aim - tip[:3, 3]
    cosine = float(np.clip(tip[:3, 2] @ off / max(float(np.linalg.norm(off)), 1e-9), -1.0, 1.0))
    return hit_share(tip[:3, 3], tip[:3, 2]), math.degrees(math.acos(cosine))


def _holds(arrived: MoveRecorder, aim: Points, hit_share: HitShare) -> list[tuple[Move, ...]]:
    """Return the best holds of a grid of rolls and lever settings, as moves from the present state.

    The pose depends on the order of turn and flexion, so the moves have the order of the grid: turn, straighten, flex.
    """
    up_deg = math.degrees(arrived.drive.flexion_range_rad[1])

    def at_roll(turn: float) -> list[tuple[tuple[float, float], tuple[Move, ...]]]:
        turned = Move((turn + 180.0) % 360.0 - 180.0, 0.0, 0.0)
        recorder = arrived.copy()
        recorder.repeat((turned,))
        found: list[tuple[tuple[float, float], tuple[Move, ...]]] = []
        for lever in np.linspace(0.0, up_deg, NUM_LEVERS + 1)[1:]:
            flexed = Move(0.0, STEP_DEG * math.trunc(float(lever) / STEP_DEG), 0.0)
            recorder.repeat((flexed,))
            share, off_deg = _judged(recorder, aim, hit_share)
            found.append(((-share, off_deg), (turned, flexed)))
        return found

    rolls = STEP_DEG * np.round(360.0 * np.arange(NUM_ROLLS) / NUM_ROLLS / STEP_DEG)
    # The grid takes most of the time of a drive that does not point, and its rolls are independent of each other.
    with ThreadPoolExecutor(NUM_THREADS) as pool:
        held = [hold for found in pool.map(at_roll, rolls.tolist()) for hold in found]
    held.sort(key=lambda one: one[0])
    return [moves for _, moves in held[:BEST_HOLDS]]
