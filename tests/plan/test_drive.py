"""Tests of driven routes: an independent script executes the listed moves again and must arrive."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from phantom_plan import CHEST
from phantom_plan import wall as chest_wall
from test_verdict import plan_in, tube

from cached_test_data import cached_airways
from carina.errors import CancelledError, UsageError
from carina.plan import Move
from carina.plan.routes.last_leg import LastLeg
from carina.plan.routes.main_carina import ROOT, DistanceOrigin
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.routes.ranking import bending_mm
from carina.plan.routes.route_width import RouteWidth
from carina.plan.routes.standing_points import CentrelinePoints
from carina.plan.verdict import drive_aim
from carina.plan.verdict.checks import bend_check, length_check
from carina.plan.verdict.drive import DrivenRoute, MoveRecorder, moves_between, replay_moves
from carina.plan.verdict.drive_aim import aim_drive
from carina.plan.verdict.drive_route import DriveWay
from carina.plan.verdict.drive_search import arrives_by, condense_drive, place_at_start, search_drive
from carina.scopes import ScopeDrive, ScopePreset, WallField, scope_preset
from carina.track import AirwayTree

BRANCHES = (100, 24, 139)
"""IDs of branches without children that are 4 to 6 forks from the root."""


def thin() -> ScopePreset:
    return scope_preset("ultrathin")


@cache
def chest_way(branch_id: int) -> DriveWay:
    """Return the route to a branch, up to the point where the airway is less than 0.5 mm wider than the scope."""
    tree, wall = cached_airways(**CHEST).tree, chest_wall()
    route = tree.route_to(branch_id)
    at = np.arange(20.0, route.length_mm - 4.0, 0.5)
    points = np.stack([np.interp(at, route.cumulative_mm, route.points_lps[:, a]) for a in range(3)], axis=1)
    narrow = np.flatnonzero(2.0 * wall.distance_mm(points) < thin().fit_mm + 0.5)
    n = int(narrow[0]) - 1 if len(narrow) else len(at) - 1
    place = (float(points[n][0]), float(points[n][1]), float(points[n][2]))
    leg = LastLeg(place, place, place, 0.0, 0.0, 0.0, (), 0.0, 0.0, None, None, None, 1.0, reaches=True)
    width = RouteWidth(3.0, 0.1, 50.0)
    planned = PlannedRoute(branch_id, "", float(at[n]), ROOT, (0.0, 0.0, -1.0), width, "fits", leg, {}, 1.0, ())
    return DriveWay(tree, planned, wall)


@cache
def chest_drive(branch_id: int) -> DrivenRoute:
    return search_drive(chest_way(branch_id), chest_wall(), thin(), effort=30_000.0)


def carried_out(way: DriveWay, wall: WallField, document: dict[str, Any]) -> ScopeDrive:
    """Return a new scope after the listed moves: rotations, flexions, and advances in steps of 1 mm."""
    drive = ScopeDrive(wall, thin(), way.points)
    state = drive.place(way.points, document["start_mm"])
    roll_deg = 0.0
    for move in document["moves"]:
        roll_deg += move["turn_deg"]
        state = drive.drive(state.insertion_mm, math.radians(roll_deg), state.flexion_rad, 0.1)
        flexion_rad = math.radians(move["flexion_deg"])
        state = drive.drive(state.insertion_mm, math.radians(roll_deg), flexion_rad, 0.1)
        for _ in range(round(move["advance_mm"])):
            state = drive.drive(state.insertion_mm + 1.0, math.radians(roll_deg), flexion_rad, 0.1)
    return drive


@pytest.mark.parametrize("branch_id", BRANCHES)
def test_replayed_hand_moves_of_a_drive_end_in_the_planned_branch(branch_id: int) -> None:
    way, driven = chest_way(branch_id), chest_drive(branch_id)
    assert driven.arrived, driven.why
    drive = carried_out(way, chest_wall(), json.loads(json.dumps(driven.to_json(poses=False))))
    tip = drive.state.pose.position_lps
    assert np.array_equal(drive.state.pose.lps_from_camera, driven.lps_from_camera[-1])
    assert np.linalg.norm(tip - way.at(way.park_mm)) <= 1.5 + way.radius_mm(way.park_mm)
    tree = cached_airways(**CHEST).tree
    found, _, _ = tree.nearest_branch(tip)
    assert found.id in {branch.id for branch in tree.lineage(branch_id)}
    # The scope has passed the last fork that is more than 6 mm before its final position.
    passed = way.forks_mm[way.forks_mm < way.park_mm - 6.0]
    assert found.generation >= len(passed)


def test_drive_in_a_chest_has_few_hand_moves_in_multiples_of_the_move_step() -> None:
    driven = chest_drive(BRANCHES[0])
    assert len(driven.moves) <= 80
    for move in driven.moves:
        assert move.turn_deg % 5.0 == 0.0 and move.flexion_deg % 5.0 == 0.0 and move.advance_mm % 1.0 == 0.0
        assert abs(move.turn_deg) <= 180.0 and -130.0 <= move.flexion_deg <= 210.0
    assert list(driven.ends_mm) == sorted(driven.ends_mm)
    assert len(driven.samples) == len(driven.lps_from_camera) == len(driven.time_s)
    assert (np.diff(driven.time_s) >= 0.0).all()
    # Between two samples of an advance the tip moves at most one millimetre, so a flight can show the drive.
    steps = np.linalg.norm(np.diff(driven.lps_from_camera[:, :3, 3], axis=0), axis=1)
    advanced = np.diff(driven.samples[:, 0]) > 0.01
    assert np.median(steps[advanced]) < 1.5
    assert np.isin(np.round(driven.lps_from_camera[:, 3], 9), [0.0, 1.0]).all()


def test_condensed_drive_has_fewer_hand_moves_and_still_arrives() -> None:
    way = chest_way(BRANCHES[0])
    condensed = condense_drive(way, chest_wall(), thin(), chest_drive(BRANCHES[0]), tries=25)
    assert condensed.arrived and len(condensed.moves) < len(chest_drive(BRANCHES[0]).moves)
    tip = carried_out(way, chest_wall(), condensed.to_json(poses=False)).state.pose
    assert np.array_equal(tip.lps_from_camera, condensed.lps_from_camera[-1])
    assert np.linalg.norm(tip.position_lps - way.at(way.park_mm)) <= 2.0 + way.radius_mm(way.park_mm)


def condensed_slowly(way: DriveWay, wall: WallField, driven: DrivenRoute, tries: int) -> tuple[Move, ...]:
    """Return the moves of the shorter drive, with every drive simulated from its beginning."""
    moves = list(driven.moves)
    for num in (4, 2, 1):
        n = len(moves) - num
        while n >= 1 and tries > 0:
            left_out = moves[n : n + num]
            advance_mm = moves[n - 1].advance_mm + sum(move.advance_mm for move in left_out)
            rest = moves[n + num :]
            if rest:
                turn_deg = rest[0].turn_deg + sum(move.turn_deg for move in left_out)
                rest[0] = dataclasses.replace(rest[0], turn_deg=(turn_deg + 180.0) % 360.0 - 180.0)
            shorter = [*moves[: n - 1], dataclasses.replace(moves[n - 1], advance_mm=advance_mm), *rest]
            tries -= 1
            if arrives_by(way, wall, thin(), tuple(shorter)):
                moves = shorter
            n -= num
    return tuple(moves)


@pytest.mark.parametrize("branch_id", [BRANCHES[0], pytest.param(BRANCHES[1], marks=pytest.mark.soak)])
def test_drive_condensed_from_copied_scope_states_equals_one_simulated_from_the_beginning(branch_id: int) -> None:
    way, wall, driven = chest_way(branch_id), chest_wall(), chest_drive(branch_id)
    condensed = condense_drive(way, wall, thin(), driven, tries=12)
    assert condensed.moves == condensed_slowly(way, wall, driven, 12) != driven.moves


def test_drive_aimed_from_copied_scope_states_equals_one_simulated_from_the_beginning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # About 300 drives are simulated from the beginning, so the tube is short.
    tree, field, points = tube(60.0, straight_mm=10.0)
    scope = dataclasses.replace(thin(), tip_mm=2.6)
    way = DriveWay(tree, plan_in(points).routes[0], field)
    driven = search_drive(way, field, scope)
    # Too few needles hit from the route's end and after withdrawals, so that rolls and lever settings are tried too.
    way.aim = way.at(way.park_mm) + np.array([2.0, 9.0, 0.0])

    def share(tip: np.ndarray, forward: np.ndarray) -> float:
        off = way.aim - tip
        return max(0.4 * float(forward @ off / np.linalg.norm(off)), 0.0)

    def repeated(recorder: MoveRecorder) -> MoveRecorder:
        other = MoveRecorder(place_at_start(way, field, scope))
        other.repeat(recorder.moves)
        return other

    fast = aim_drive(way, field, scope, driven, share)
    monkeypatch.setattr(MoveRecorder, "copy", repeated)
    monkeypatch.setattr(drive_aim, "NUM_THREADS", 1)
    slow = aim_drive(way, field, scope, driven, share)
    assert fast.driven.moves == slow.driven.moves != driven.moves
    assert (fast.share, fast.off_deg) == (slow.share, slow.off_deg)
    assert np.array_equal(fast.lps_from_tip, slow.lps_from_tip)
    assert np.array_equal(fast.driven.samples, slow.driven.samples)


def test_repeated_search_for_a_drive_gives_equal_moves() -> None:
    again = search_drive(chest_way(BRANCHES[0]), chest_wall(), thin(), effort=30_000.0)
    assert again.moves == chest_drive(BRANCHES[0]).moves


def test_hand_moves_between_consecutive_positions_are_together_all_moves_of_the_drive() -> None:
    driven = chest_drive(BRANCHES[0])
    last = driven.ends_mm[-1]
    cuts = [driven.start_mm, 100.0, 150.5, 180.0, last]
    parts = [moves_between(driven, low, high) for low, high in itertools.pairwise(cuts)]
    assert sum(move.turn_deg for part in parts for move in part) == sum(move.turn_deg for move in driven.moves)
    for part, low, high in zip(parts, cuts[:-1], cuts[1:], strict=True):
        assert sum(move.advance_mm for move in part) == pytest.approx(high - low, abs=0.1 * len(part))
    assert parts[-1][-1].flexion_deg == driven.moves[-1].flexion_deg


def zigzag() -> tuple[AirwayTree, WallField, PlannedRoute]:
    """Return a bent tube whose centreline alternates between both sides of its middle.

    The smoothed route is shorter.
    """
    straight, field, points = tube(60.0)
    beside = np.zeros_like(points)
    beside[1:-1:2, 1] = 0.15
    rough = tuple(
        dataclasses.replace(branch, points=branch.points + beside[first : first + len(branch.points)])
        for branch, first in zip(straight.branches, (0, len(points) // 2), strict=True)
    )
    tree = AirwayTree(rough, _smooth=lambda _: (points, np.zeros(len(points))))
    planned = plan_in(points).routes[0]
    way = np.concatenate([rough[0].points, rough[1].points[1:]])[: len(points) - 7]
    along_mm = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    return tree, field, dataclasses.replace(planned, along_mm=along_mm)


def test_drive_and_plan_measure_the_same_distance_along_centrelines() -> None:
    """Assert that plan, verdict checks, drive and list of turns state the same distance for one position."""
    tree, wall, planned = zigzag()
    slim = dataclasses.replace(thin(), tip_mm=2.6)
    way = DriveWay(tree, planned, wall)
    # The smoothed route and the centreline must differ in length, or the test would pass without need.
    assert planned.along_mm - way.park_mm > 3.0
    assert way.from_origin_mm(way.park_mm) == pytest.approx(planned.along_mm)
    assert [way.from_origin_mm(mm) for mm in way.forks_mm] == pytest.approx([tree.root.length_mm])
    assert way.from_origin_mm(way.length_mm) == pytest.approx(sum(branch.length_mm for branch in tree.branches))
    text = length_check(way, slim, 150.0).words
    assert text.startswith(f"needs a working length of {planned.along_mm + 150.0:.0f} mm")
    text = length_check(way, slim, None).words
    assert text.startswith(f"the tip stops {planned.along_mm:.0f} mm from the start of the airway tree")
    # Past a main carina, distances and depths are measured from the carina.
    past = dataclasses.replace(planned, origin=DistanceOrigin("ridge", along_mm=30.0, axes_mm=21.0))
    from_carina = DriveWay(tree, past, wall)
    assert from_carina.from_origin_mm(way.park_mm) == pytest.approx(past.from_carina_mm)
    text = length_check(from_carina, slim, 270.0).words
    assert text.startswith(f"needs a working length of {past.from_carina_mm + 270.0:.0f} mm")
    text = length_check(from_carina, slim, None).words
    assert text.startswith(f"the tip stops {past.from_carina_mm:.0f} mm past the main carina; a working length of ")
    assert text.endswith(f"leaves {slim.length_mm - past.from_carina_mm:.0f} mm from nose or mouth to the main carina")
    bend_mm = float(re.findall(r"the bend (\d+) mm", bend_check(way, slim, errors=True).words)[0])
    limit = CentrelinePoints(tree).requirements_at(_place_of(tree, planned), bending_mm(slim)).bend_deg
    assert bend_mm == pytest.approx(limit.at_mm, abs=2.0)
    driven = search_drive(way, wall, slim, effort=10_000.0)
    assert driven.arrived and driven.stopped_mm == pytest.approx(planned.along_mm, abs=1.2)
    assert list(driven.ends_along_mm) == sorted(driven.ends_along_mm)
    assert driven.ends_along_mm[-1] == pytest.approx(driven.stopped_mm, abs=0.5)
    assert driven.to_json(poses=False)["moves"][-1]["ends_along_mm"] == driven.ends_along_mm[-1]


def _place_of(tree: AirwayTree, planned: PlannedRoute) -> int:
    centreline = CentrelinePoints(tree)
    mine = np.flatnonzero(centreline.branch == planned.branch_id)
    return int(mine[np.argmin(np.abs(centreline.along_mm[mine] - planned.along_mm))])


def test_simulated_scope_arrives_in_a_bent_tube_and_points_at_a_target_beside_it() -> None:
    tree, field, points = tube(60.0)
    plan = plan_in(points)
    scope = dataclasses.replace(thin(), tip_mm=2.6)
    way = DriveWay(tree, plan.routes[0], field)
    driven = search_drive(way, field, scope)
    assert driven.arrived and driven.stopped_mm == pytest.approx(way.park_mm, abs=1.1)
    # The direction of the needle is 15 degrees from the axis of the tube.
    beside = way.at(way.park_mm) + 12.0 * way.direction(way.park_mm) + np.array([0.0, 3.0, 0.0])
    way.aim = beside

    def share(tip: np.ndarray, forward: np.ndarray) -> float:
        off = beside - tip
        return max(1.0 - 0.05 * math.degrees(math.acos(min(float(forward @ off / np.linalg.norm(off)), 1.0))), 0.0)

    aimed = aim_drive(way, field, scope, driven, share)
    start = place_at_start(way, field, scope)
    before = replay_moves(place_at_start(way, field, scope), driven.moves)[-1].lps_from_camera
    assert aimed.share >= share(before[:3, 3], before[:3, 2])
    assert aimed.driven.moves[: len(driven.moves)] == driven.moves
    assert all(move.advance_mm == 0.0 for move in aimed.driven.moves[len(driven.moves) :])
    tip = replay_moves(start, aimed.driven.moves)[-1].lps_from_camera
    assert share(tip[:3, 3], tip[:3, 2]) == aimed.share


def test_scope_too_thick_for_a_narrowing_stops_before_it_with_the_reason() -> None:
    tree, _, points = tube(30.0)
    # From 60 mm on, the tube is 2.4 mm wide instead of 4 mm.
    step = 0.5
    lo, hi = points.min(axis=0) - 4.0, points.max(axis=0) + 4.0
    z, y, x = (np.arange(lo[a], hi[a] + step, step) for a in (2, 1, 0))
    grid = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1)[..., ::-1]
    values = np.full(grid.shape[:3], -9.0, dtype=np.float32)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for point, mm in zip(points, along, strict=True):
        values = np.maximum(values, (2.0 if mm < 60.0 else 1.2) - np.linalg.norm(grid - point, axis=-1))
    place = np.diag([step, step, step, 1.0])
    place[:3, 3] = lo
    field = WallField.from_distances(values.astype(np.float32), place)
    way = DriveWay(tree, plan_in(points).routes[0], field)
    driven = search_drive(way, field, dataclasses.replace(thin(), tip_mm=2.8), effort=400.0)
    assert not driven.arrived and driven.stopped_mm == pytest.approx(60.0, abs=3.0)
    assert driven.why is not None and driven.why.startswith("its tip ")
    assert json.loads(json.dumps(driven.to_json()))["why"] == driven.why


def test_search_for_a_drive_can_be_cancelled_and_moves_of_half_a_millimetre_are_refused() -> None:
    tree, field, points = tube(60.0)
    way = DriveWay(tree, plan_in(points).routes[0], field)
    slim = dataclasses.replace(thin(), tip_mm=2.6)
    with pytest.raises(CancelledError):
        search_drive(way, field, slim, cancel=lambda: True)
    with pytest.raises(UsageError, match=r"whole millimetres; found 0\.5"):
        replay_moves(place_at_start(way, field, slim), [Move(0.0, 0.0, 0.5)])
    with pytest.raises(UsageError, match="effort: expected above 0"):
        search_drive(way, field, slim, effort=0.0)
