"""Tests of hours, sides and distances in the list of turns, for both operators, in random trees."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fork_trees import bent, made_tree, moved, random_tree, route_in, turn_list_with_small_views, unit
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cached_test_data import cached_airways, cached_phantom
from carina.case.routes import route_to_branch
from carina.errors import UsageError
from carina.navigate import Navigator
from carina.plan import Turn, TurnList, distance_origin, turn_list
from carina.plan.hand_moves import Move
from carina.plan.turns.fork_view import Opening, levelled, openings_seen, stand_mm
from carina.plan.turns.opening_walls import ForkWalls, TubeWall, first_walls
from carina.plan.turns.texts import moves_words
from carina.scopes import Pose
from carina.track import AirwayTree

FILE = Path(__file__).resolve().parents[1] / "golden" / "fork-hours.json"
SEEDS = st.integers(0, 7)
quick = settings(max_examples=6, deadline=None)
PIXEL_HOURS = 0.1
"""Maximum change of a clock hour, in hours, by rounding at the edge pixels of an opening."""


@cache
def lists(seed: int) -> list[tuple[AirwayTree, TurnList]]:
    """Return two lists of turns in a random tree; the lists are computed once for all tests."""
    tree = random_tree(seed)
    return [(tree, turn_list(tree, route_in(tree, tip.id))) for tip in tree.tips()[::7]]


def hours_apart(one: float, other: float) -> float:
    gap = abs(one - other) % 12.0
    return min(gap, 12.0 - gap)


def oracle_hours(turn: Turn) -> float:
    """Return the hours as the angle between two planes through the line of sight.

    One plane contains the anterior direction, the other the opening.
    """
    eye, fork, place = (np.array(p) for p in (turn.seen_from_lps, turn.fork_lps, turn.opening_lps))
    sight = unit(fork - eye)
    up = np.array([0.0, -1.0, 0.0])
    if abs(sight[1]) >= 0.99:
        up = np.array([0.0, 0.0, 1.0])
    of_up, of_place = unit(np.cross(sight, up)), unit(np.cross(sight, place - eye))
    angle = math.acos(float(np.clip(of_up @ of_place, -1.0, 1.0)))
    # A right-handed rotation about the line of sight appears clockwise along this line.
    if float(np.cross(of_up, of_place) @ sight) < 0.0:
        angle = -angle
    return (angle / math.tau * 12.0) % 12.0


@quick
@given(SEEDS)
def test_clock_hour_of_an_opening_is_the_angle_between_two_planes_through_the_line_of_sight(seed: int) -> None:
    for _, found in lists(seed):
        for turn in found.turns:
            if turn.clock_head is None or turn.clock_facing is None:
                assert turn.straight_ahead or turn.hour_doubt is not None
                continue
            assert 0.0 < turn.clock_head <= 12.0 and 0.0 < turn.clock_facing <= 12.0
            assert hours_apart(turn.clock_head, oracle_hours(turn)) < 1e-6
            assert hours_apart(turn.clock_facing, turn.clock_head + 6.0) < 1e-9


def seen_in_tubes(tree: AirwayTree, turn: Turn, operator: Any) -> tuple[Opening, ...]:
    """Return the openings of a turn in the picture of an operator, in which the branches are tubes."""
    fork = np.array(turn.fork_lps)
    ways = [tree.branch(turn.to_branch_id), *(tree.branch(one.branch_id) for one in turn.others)]
    camera = turn.camera(operator)
    walls = ForkWalls(tree, fork, [branch.id for branch in ways])
    return openings_seen(camera, walls, ways, first_walls(camera, 32, TubeWall(tree, fork)))


@quick
@given(SEEDS)
def test_clock_hours_for_an_operator_facing_the_patient_differ_by_six_hours(seed: int) -> None:
    for tree, found in lists(seed):
        for turn in found.turns:
            seen = seen_in_tubes(tree, turn, "facing")
            if turn.clock_facing is not None:
                assert hours_apart(seen[0].hours, turn.clock_facing) < PIXEL_HOURS
            for other, one in zip(turn.others, seen[1:], strict=True):
                assert hours_apart(one.hours, other.hour("facing") or one.hours) < 0.5 + PIXEL_HOURS


@quick
@given(SEEDS)
def test_distances_between_turns_add_up_to_the_final_tip_position(seed: int) -> None:
    tree = random_tree(seed)
    for tip in tree.tips()[::3]:
        route = route_in(tree, tip.id)
        found = turn_list_with_small_views(tree, route, carina_depth_mm=250.0)
        total = sum(turn.from_fork_mm for turn in found.turns) + found.park_from_fork_mm
        assert total == pytest.approx(route.along_mm, abs=1e-9)
        assert found.park_from_carina_mm == pytest.approx(route.from_carina_mm, abs=1e-9)
        assert found.turns[0].at_main_carina and found.turns[0].from_carina_mm == pytest.approx(0.0, abs=1e-9)
        for before, turn in zip(found.turns, found.turns[1:], strict=False):
            assert turn.from_carina_mm - before.from_carina_mm == pytest.approx(turn.from_fork_mm, abs=1e-9)
            assert found.depth_mm(turn.from_carina_mm) == pytest.approx(250.0 + turn.from_carina_mm)
        # The distances are compared with the polyline, point by point.
        way = np.concatenate([branch.points for branch in tree.lineage(tip.id)])
        last = np.array(found.turns[-1].fork_lps)
        index = int(np.argmin(np.linalg.norm(way - last, axis=1)))
        length = sum(math.dist(a, b) for a, b in itertools.pairwise(way[: index + 1]))
        assert sum(turn.from_fork_mm for turn in found.turns) == pytest.approx(length, abs=1e-6)


@quick
@given(SEEDS)
def test_mirrored_patient_has_mirrored_clock_hours_and_sides(seed: int) -> None:
    swapped = {"right": "left", "left": "right"}
    for tree, found in lists(seed):
        mirror = moved(tree, np.diag([-1.0, 1.0, 1.0]), np.zeros(3))
        other = turn_list(mirror, route_in(mirror, found.turns[-1].to_branch_id))
        for one, two in zip(found.turns, other.turns, strict=True):
            if one.clock_head is None or two.clock_head is None:
                continue
            assert hours_apart(two.clock_head, 12.0 - one.clock_head) < PIXEL_HOURS
            assert hours_apart(two.clock_facing, 12.0 - one.clock_facing) < PIXEL_HOURS
            assert two.sides == tuple(swapped.get(side, side) for side in one.sides)
            assert two.angle_deg == pytest.approx(one.angle_deg, abs=1e-6)


@quick
@given(SEEDS, st.floats(-math.pi, math.pi), st.floats(-200.0, 200.0))
def test_clock_hours_are_unchanged_by_a_rotation_of_the_patient_about_the_anterior_axis(
    seed: int, angle: float, shift: float
) -> None:
    c, s = math.cos(angle), math.sin(angle)
    turned = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    for tree, found in lists(seed):
        # A view along the anterior axis has superior up, and this up direction turns with the patient.
        sights = [unit(np.array(t.fork_lps) - np.array(t.seen_from_lps)) for t in found.turns]
        assume(all(abs(sight[1]) < 0.98 for sight in sights))
        there = moved(tree, turned, np.array([shift, -shift, 3.0]))
        other = turn_list(there, route_in(there, found.turns[-1].to_branch_id))
        for one, two in zip(found.turns, other.turns, strict=True):
            if one.clock_head is not None and two.clock_head is not None:
                assert hours_apart(one.clock_head, two.clock_head) < PIXEL_HOURS
            assert two.from_fork_mm == pytest.approx(one.from_fork_mm, abs=1e-9)
            assert two.diameter_mm == one.diameter_mm


@quick
@given(SEEDS, st.integers(0, 10_000))
def test_clock_hour_changes_by_the_camera_roll_when_the_patient_is_rotated(seed: int, other: int) -> None:
    """Assert that after any rotation the hour is that of the opening minus the roll to the new up direction."""
    rng = np.random.default_rng(other)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    tree, found = lists(seed)[0]
    there = moved(tree, q, np.zeros(3))
    turned = turn_list(there, route_in(there, found.turns[-1].to_branch_id))
    for one, two in zip(found.turns, turned.turns, strict=True):
        # One camera is rotated with the patient, the other is levelled after the rotation.
        carried, level = q @ one.camera("head").lps_from_camera[:3, :3], two.camera("head").lps_from_camera[:3, :3]
        if one.clock_head is None or two.clock_head is None:
            continue
        roll = math.atan2(float(carried[:, 0] @ -level[:, 1]), float(carried[:, 0] @ level[:, 0]))
        # The grid of pixels is rolled, too, so more pixels at the edge of an opening differ.
        assert hours_apart(two.clock_head, one.clock_head - roll / math.tau * 12.0) < 3.0 * PIXEL_HOURS
        assert hours_apart(two.clock_head, oracle_hours(two)) < 1e-6


@quick
@given(SEEDS)
def test_stated_side_is_the_side_of_the_opening_in_the_patient(seed: int) -> None:
    axis = {"right": (0, -1), "left": (0, 1), "anterior": (1, -1), "posterior": (1, 1), "inferior": (2, -1)}
    axis["superior"] = (2, 1)
    for _, found in lists(seed):
        for turn in found.turns:
            eye, fork, place = (np.array(p) for p in (turn.seen_from_lps, turn.fork_lps, turn.opening_lps))
            sight = unit(fork - eye)
            off = place - fork
            across = unit(off - float(off @ sight) * sight)
            assert bool(turn.sides) == (turn.clock_head is not None)
            sizes = [across[axis[side][0]] * axis[side][1] for side in turn.sides]
            assert all(size >= 0.199 for size in sizes)
            assert not sizes or sizes[0] == pytest.approx(np.abs(across).max())


@quick
@given(SEEDS)
def test_camera_of_a_turn_is_at_the_position_where_a_flight_pauses(seed: int) -> None:
    tree = random_tree(seed, lengths_mm=(60.0, 30.0, 20.0, 15.0))
    tip = tree.tips()[seed % len(tree.tips())]
    found = turn_list(tree, route_in(tree, tip.id))
    flown = route_to_branch(tree, tip.id)
    for turn, stop, fork in zip(found.turns, flown.lookouts_mm, flown.forks_mm, strict=True):
        eye = np.array(turn.seen_from_lps)
        on_route = np.linalg.norm(flown.points_lps - eye, axis=1)
        assert on_route.min() < 2.0, "the camera is on the centreline"
        # The camera is nearer to the fork only where the opening is in the middle of the picture of the stop.
        away = math.dist(turn.seen_from_lps, turn.fork_lps)
        assert 0.5 * (fork - stop) < away < 1.6 * (fork - stop) + 1.0


def test_camera_of_a_turn_has_the_same_up_direction_as_the_view_in_the_window() -> None:
    rng = np.random.default_rng(5)
    for _ in range(60):
        eye, look = rng.normal(size=3), unit(rng.normal(size=3))
        tip = Navigator(Pose.looking(eye, look, rng.normal(size=3)))
        tip.level_horizon()
        assert np.allclose(tip.pose.lps_from_camera, levelled(eye, look, "head").lps_from_camera, atol=1e-9)
        tip.set_operator("facing")
        tip.level_horizon()
        assert np.allclose(tip.pose.lps_from_camera, levelled(eye, look, "facing").lps_from_camera, atol=1e-9)


def golden_cases() -> list[dict[str, Any]]:
    """Return turns of random trees for both operators, whose hours the window must compute from the camera."""
    made = []
    for seed in range(8):
        tree = random_tree(seed, num_children=(2, 3 if seed % 2 else 2), lengths_mm=(40.0, 15.0, 12.0), curl=0.4)
        for tip in tree.tips()[seed % 3 :: 5]:
            for turn in turn_list(tree, route_in(tree, tip.id)).turns:
                made += golden_rows(f"tree {seed}, into {turn.to_branch_id} of {tip.id}", tree, turn)
    return made


def golden_rows(name: str, tree: AirwayTree, turn: Turn) -> list[dict[str, Any]]:
    daughter = tree.branch(turn.to_branch_id)
    mother = tree.branch(daughter.parent or 0)
    rows = [
        {
            "id": branch.id,
            "points": branch.points[:: max(len(branch.points) - 1, 1)].round(4).tolist(),
            "radius": branch.radius[:: max(len(branch.radius) - 1, 1)].round(4).tolist(),
            "parent": None if branch is mother else mother.id,
            "children": list(mother.children) if branch is mother else [],
        }
        for branch in (mother, *(tree.branch(child) for child in mother.children))
    ]
    taken = {
        "middle_lps": turn.opening_lps,
        "in_view": turn.in_view,
        "straight_ahead": turn.straight_ahead,
        "ahead_deg": turn.ahead_deg,
    }
    openings = [
        {"branch_id": turn.to_branch_id, **taken},
        *(
            {
                "branch_id": one.branch_id,
                "middle_lps": one.opening_lps,
                "in_view": one.in_view,
                "straight_ahead": one.straight_ahead,
                "ahead_deg": one.ahead_deg,
            }
            for one in turn.others
        ),
    ]
    return [
        {
            "name": f"{name}, {operator}",
            "lps_from_camera": turn.camera(operator).lps_from_camera.ravel().tolist(),
            "branches": rows,
            "openings": openings,
            "doubtful": turn.hour_doubt is not None,
            "hours": {
                str(turn.to_branch_id): turn.hour(operator),
                **{str(one.branch_id): one.hour(operator) for one in turn.others},
            },
        }
        for operator in ("head", "facing")
    ]


def test_clock_hours_of_the_golden_file_equal_those_computed_by_python() -> None:
    """Compare with the file that ``web/src/state/fork-hours.test.ts`` also reads.

    Only ``make golden`` rewrites the file.
    """
    made = json.loads(json.dumps(golden_cases()))
    if os.environ.get("CARINA_GOLDEN") == "rewrite":
        FILE.write_text(json.dumps(made) + "\n", encoding="utf-8")
    golden = json.loads(FILE.read_text(encoding="utf-8"))
    assert [case["name"] for case in golden] == [case["name"] for case in made]
    for found, expected in zip(made, golden, strict=True):
        assert found["hours"] == expected["hours"]
        assert found["lps_from_camera"] == pytest.approx(expected["lps_from_camera"], abs=1e-9)
    hours = [hour for case in golden for hour in case["hours"].values()]
    assert None in hours and len(set(hours)) == 13, "all hours and straight ahead are among them"


def straight(number: int, parent: int | None, children: list[int], a: Any, b: Any, **more: Any) -> dict[str, Any]:
    points = np.linspace(np.asarray(a, dtype=float), np.asarray(b, dtype=float), 9)
    return {
        "id": number,
        "parent": parent,
        "children": children,
        "points": points,
        "radius": np.full(9, 2.0),
        **more,
    }


def test_forks_two_millimetres_apart_are_one_turn_that_names_the_branch_between_them() -> None:
    tree = made_tree(
        [
            straight(0, None, [1, 2], [0, 0, 0], [0, 0, -40], name="RMB"),
            straight(1, 0, [3, 4], [0, 0, -40], [0, 0, -41.5], name="RUL"),
            straight(2, 0, [], [0, 0, -40], [10, 0, -50], name="BI"),
            straight(3, 1, [], [0, 0, -41.5], [-10, 0, -50], name="RB3"),
            straight(4, 1, [], [0, 0, -41.5], [0, -10, -50], name="RB1"),
        ]
    )
    found = turn_list(tree, route_in(tree, 3, carina=False))
    (turn,) = found.turns
    assert (turn.from_branch, turn.to_branch, turn.through) == ("RMB", "RB3", ("RUL",))
    assert turn.hour("head") == 3 and turn.sides == ("right",)
    assert {one.name: one.hour("head") for one in turn.others} == {"BI": 9, "RB1": 12}
    assert [one.name for one in turn.others] == ["BI", "RB1"], "clockwise from the selected opening"
    assert turn.from_fork_mm == pytest.approx(40.0)
    assert turn.words("head").startswith(
        "At 40 mm past the previous fork, enter RB3 just past RUL (3 o\u2019clock, right, 4.0 ± 2.2 mm wide, "
    )
    # Forks that are farther apart than 2 mm are two turns.
    rows = [straight(1, 0, [3, 4], [0, 0, -40], [0, 0, -43.0], name="RUL")]
    apart = {branch.id: branch for branch in tree.branches}
    shifted = [
        straight(n, 1, [], apart[n].points[0] - [0, 0, 1.5], apart[n].points[-1] - [0, 0, 1.5], name=apart[n].name)
        for n in (3, 4)
    ]
    rows = [
        straight(0, None, [1, 2], [0, 0, 0], [0, 0, -40], name="RMB"),
        *rows,
        straight(2, 0, [], [0, 0, -40], [10, 0, -50], name="BI"),
        *shifted,
    ]
    assert len(turn_list(made_tree(rows), route_in(made_tree(rows), 3, carina=False)).turns) == 2


def forked(*ends: Any, stub: Any = None, radius: float = 1.0) -> AirwayTree:
    """Return a branch of 40 mm and 3 mm radius with branches from its end, or from the end of a stub after it."""
    fork = [0, 0, -40] if stub is None else stub
    wide = {"radius": np.full(9, 3.0)}
    ids = list(range(2, 2 + len(ends)))
    rows = [straight(0, None, ids if stub is None else [1, 9], [0, 0, 0], [0, 0, -40], **wide)]
    if stub is not None:
        rows += [
            straight(1, 0, ids, [0, 0, -40], stub, **wide),
            straight(9, 0, [], [0, 0, -40], [20, 0, -55], radius=np.full(9, radius)),
        ]
    parent = 0 if stub is None else 1
    rows += [straight(n, parent, [], fork, end, radius=np.full(9, radius)) for n, end in zip(ids, ends, strict=True)]
    return made_tree(rows)


def test_forks_at_both_ends_of_a_branch_no_longer_than_its_radius_are_one_turn() -> None:
    short = forked([-20, 0, -58], [0, -20, -58], stub=[-1.0, 0, -42.7])
    (turn,) = turn_list(short, route_in(short, 2, carina=False)).turns
    assert turn.through == ("branch 1",) and {one.branch_id for one in turn.others} == {3, 9}
    long = forked([-20, 0, -60], [0, -20, -60], stub=[-1.0, 0, -44.0])
    assert len(turn_list(long, route_in(long, 2, carina=False)).turns) == 2


def test_opening_in_the_same_direction_as_another_has_a_doubt_instead_of_a_clock_hour() -> None:
    tree = forked([-20, 0, -62], [20, -2, -66], [12, 5, -70], radius=1.5)
    clear = turn_list(tree, route_in(tree, 2, carina=False)).turns[0]
    assert clear.hour("head") == 3 and clear.hour_doubt is None
    unsure = turn_list(tree, route_in(tree, 3, carina=False)).turns[0]
    assert unsure.clock_head is None and unsure.clock_facing is None and unsure.sides == ()
    assert not unsure.straight_ahead and unsure.hour_doubt is not None
    assert unsure.hour_doubt.code == "turns.neighbour" and "branch 4" in unsure.hour_doubt.words


def test_turn_without_a_clock_hour_states_the_reason_in_text_json_and_table() -> None:
    tree = forked([-20, 0, -62], [20, -2, -66], [12, 5, -70], radius=1.5)
    found = turn_list(tree, route_in(tree, 3, carina=False))
    line = found.words("facing")[0]
    assert "enter branch 3 (no clock hour, 3.0 ± 1.9 mm wide" in line
    assert "Caution: no clock hour: branch 4 opens in nearly the same direction" in line
    row = found.to_json()["turns"][0]
    assert row["clock_head"] is None and row["hour_facing"] is None
    assert row["hour_doubt"]["code"] == "turns.neighbour" and row["hour_doubt"]["words"] in line
    assert found.to_columns()["hour_head"][0] is None


def test_distances_without_a_main_carina_are_stated_from_fork_to_fork_with_a_note() -> None:
    tree = random_tree(3)
    bare = dataclasses.replace(tree, branches=tuple(dataclasses.replace(b, name=None) for b in tree.branches))
    found = turn_list(bare, route_in(bare, bare.tips()[0].id, carina=False), carina_depth_mm=250.0)
    assert found.zero is None and found.park_from_carina_mm is None
    assert all(turn.from_carina_mm is None and not turn.at_main_carina for turn in found.turns)
    assert "no main carina" in found.notes[0] and "no depth" in found.notes[0]
    lines = found.words("head")
    assert "from the start of the route, enter branch" in lines[0]
    assert all("past the previous fork" in line for line in lines[1:])
    assert not any("estimate" in line for line in lines)


def test_route_that_ends_before_the_first_fork_has_no_turns() -> None:
    tree = random_tree(1)
    found = turn_list(tree, route_in(tree, 0))
    assert found.turns == () and found.park_from_fork_mm == pytest.approx(0.58 * tree.root.length_mm, rel=0.1)
    (line,) = found.words("facing")
    assert line.endswith("from the start of the route, stop")


def test_branch_with_a_single_child_is_not_listed_as_a_turn() -> None:
    tree = made_tree(
        [
            straight(0, None, [1], [0, 0, 0], [0, 0, -40]),
            straight(1, 0, [2, 3], [0, 0, -40], [0, 0, -60]),
            straight(2, 1, [], [0, 0, -60], [-10, 0, -70]),
            straight(3, 1, [], [0, 0, -60], [10, 0, -70]),
        ]
    )
    (turn,) = turn_list(tree, route_in(tree, 2, carina=False)).turns
    assert turn.from_fork_mm == pytest.approx(60.0) and turn.from_branch == "branch 1"


def test_text_of_a_turn_contains_its_doubts_and_depths() -> None:
    tree = random_tree(2)
    tip = tree.tips()[0]
    drawn = dataclasses.replace(
        tree,
        branches=tuple(
            dataclasses.replace(b, kind="manual", name=None) if b.id == tip.id else b for b in tree.branches
        ),
    )
    found = turn_list(drawn, route_in(drawn, tip.id, ridge_mm=9.0), carina_depth_mm=270.0)
    lines = found.words("head")
    assert lines[-2].endswith(f"Caution: branch {tip.id} was drawn by hand")
    assert lines[0].startswith("At the main carina (about 27 cm on the scope, an estimate), enter RMB")
    assert found.zero == "ridge" and found.turns[0].from_carina_mm == 0.0
    assert "estimate" in lines[-1] and "estimates" in found.notes[-1]
    json.dumps(found.to_json(), allow_nan=False)


def test_direction_of_an_opening_is_measured_outside_the_lumen_of_the_previous_branch() -> None:
    tree = made_tree(
        [
            straight(0, None, [1, 2], [0, 0, 0], [0, 0, -40]),
            straight(1, 0, [], [0, 0, -40], [-20, 0, -40]),
            straight(2, 0, [], [0, 0, -40], [0, 0, -70]),
        ]
    )
    narrow = dataclasses.replace(tree.branch(1), radius=np.array([6.0, 6.0, 3.0, 1.7, 1.6, 1.6, 1.6, 1.6, 1.6]))
    wide = dataclasses.replace(tree.branch(0), radius=np.full(9, 6.0))
    made = dataclasses.replace(tree, branches=(wide, narrow, tree.branch(2)))
    (turn,) = turn_list(made, route_in(made, 1, carina=False)).turns
    assert turn.diameter_mm == pytest.approx(3.4, abs=0.21)
    assert turn.angle_deg == pytest.approx(90.0)


@quick
@given(SEEDS, st.lists(st.floats(-3.0, 15.0), min_size=0, max_size=30))
def test_each_hand_move_of_a_drive_is_listed_once_and_in_order(seed: int, advances: list[float]) -> None:
    tree = random_tree(seed)
    route = route_in(tree, tree.tips()[0].id)
    moves = [Move(float(n), 1.0, mm) for n, mm in enumerate(advances)]
    ends = list(np.cumsum(advances)) if advances else []
    found = turn_list_with_small_views(
        tree, route, moves=moves, ends_along_mm=[route.origin.past_mm(mm) for mm in ends]
    )
    listed = [move for turn in found.turns for move in turn.moves or ()]
    assert [*listed, *(found.park_moves or ())] == moves
    # A move that begins before a fork is listed with this fork.
    places = np.cumsum([turn.from_fork_mm for turn in found.turns])
    for turn, place, before in zip(found.turns, places, [-1.0, *places], strict=False):
        for move in turn.moves or ():
            furthest = max([0.0, *ends[: int(move.turn_deg)]])
            assert before - 1e-6 <= furthest < place
    assert turn_list_with_small_views(tree, route).turns[0].moves is None


def test_hand_move_that_begins_past_a_fork_is_listed_with_the_next_turn() -> None:
    tree = random_tree(4)
    route = route_in(tree, tree.tips()[0].id)
    num = int(route.along_mm)
    moves = [Move(float(n), 0.0, 1.0) for n in range(num)]
    found = turn_list(tree, route, moves=moves, ends_along_mm=[route.origin.past_mm(n + 1.0) for n in range(num)])
    places = np.cumsum([turn.from_fork_mm for turn in found.turns])
    first = 0
    for turn, place in zip(found.turns, places, strict=True):
        last = math.ceil(place)
        assert [move.turn_deg for move in turn.moves or ()] == list(range(first, last))
        first = last


def test_text_of_hand_moves_matches_their_values() -> None:
    moves = [Move(40.2, 35.0, 12.0), Move(0.0, 35.0, 3.0), Move(-90.0, 0.0, 0.0), Move(0.0, -20.0, -4.0)]
    assert moves_words(moves) == (
        "rotate 40° clockwise, flex up 35°, advance 15 mm; then rotate 90° counterclockwise, tip straight; "
        "then flex down 20°, withdraw 4 mm"
    )
    assert moves_words([]) == ""


def test_small_steps_in_one_direction_are_one_gradual_move() -> None:
    turning = [Move(5.0, 150.0, 2.0) for _ in range(4)]
    bending = [Move(0.0, 150.0 + 10.0 * n, 1.0) for n in range(1, 4)]
    assert moves_words([Move(50.0, 150.0, 2.0), *turning, *bending]) == (
        "rotate 50\u00b0 clockwise, flex up 150\u00b0, advance 2 mm; "
        "then gradually rotate 20\u00b0 clockwise, flex up 180\u00b0, advance 11 mm"
    )
    # A step that is large, or in the other direction, is a separate move.
    other = [*turning, Move(-5.0, 150.0, 2.0), Move(-40.0, 150.0, 2.0)]
    assert moves_words(other) == (
        "rotate 5\u00b0 clockwise, flex up 150\u00b0, advance 2 mm; then gradually rotate 15\u00b0 clockwise, "
        "advance 6 mm; then rotate 5\u00b0 counterclockwise, advance 2 mm; then rotate 40\u00b0 counterclockwise, "
        "advance 2 mm"
    )


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"carina_depth_mm": -1.0}, "plan.range"),
        ({"carina_depth_mm": math.nan}, "plan.range"),
        ({"moves": [Move(0.0, 0.0, 1.0)]}, "plan.moves"),
        ({"moves": [Move(0.0, 0.0, 1.0)], "ends_along_mm": [1.0, 2.0]}, "plan.moves"),
        ({"moves": [Move(0.0, 0.0, 1.0)], "ends_along_mm": [math.inf]}, "plan.moves"),
    ],
)
def test_turn_list_with_invalid_arguments_is_refused(change: dict[str, Any], code: str) -> None:
    tree = random_tree(0)
    with pytest.raises(UsageError) as refused:
        turn_list(tree, route_in(tree, tree.tips()[0].id), **change)
    assert refused.value.code == code


def test_branches_of_length_zero_are_accepted_in_the_turn_list() -> None:
    tree = made_tree(
        [
            {**straight(0, None, [1, 2], [0, 0, 0], [0, 0, 0])},
            straight(1, 0, [3, 4], [0, 0, 0], [-5, 0, -5]),
            straight(2, 0, [], [0, 0, 0], [5, 0, -5]),
            {**straight(3, 1, [], [-5, 0, -5], [-5, 0, -5])},
            straight(4, 1, [], [-5, 0, -5], [-9, 0, -5]),
        ]
    )
    found = turn_list(tree, route_in(tree, 3, carina=False))
    doubt = found.turns[0].hour_doubt
    assert doubt is not None and doubt.code == "turns.hidden", "a camera outside the lumen sees no opening"
    assert all(math.isfinite(turn.angle_deg) for turn in found.turns)
    json.dumps(found.to_json(), allow_nan=False)


def test_origin_of_distances_is_the_visible_ridge_of_the_main_carina() -> None:
    options: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 4}
    airways, volume = cached_airways(**options), cached_phantom(**options).volume
    origin = distance_origin(volume, airways)
    assert origin.kind == "ridge"
    ridge = origin.ridge_beyond_axes_mm
    # The line straight down the trachea from the fork of the axes leaves the air at the ridge, within about a voxel.
    trachea = airways.tree.root
    ahead = unit(trachea.points[-1] - trachea.points[-8])
    steps = trachea.points[-1] + np.arange(0.0, 30.0, 0.2)[:, None] * ahead
    i, j, k = np.rint(volume.to_ijk(steps)).astype(int).T
    ends_mm = 0.2 * int(np.argmax(airways.lumen_zyx[k, j, i] == 0))
    assert ridge == pytest.approx(ends_mm, abs=3.0)
    assert origin.axes_mm == pytest.approx(trachea.length_mm)


def test_camera_distance_from_the_fork_is_three_to_four_millimetres_in_a_short_or_bent_branch() -> None:
    short = made_tree([straight(0, None, [], [0, 0, 0], [0, 0, -2])]).root
    assert stand_mm(short) == 3.0
    long = dataclasses.replace(short, points=bent(np.zeros(3), unit(np.ones(3)), unit(np.ones(3)), 60.0, 8))
    assert stand_mm(long) == pytest.approx(4.0)


@pytest.mark.parametrize("seed", range(4))
def test_direction_in_a_picture_follows_the_roll_of_its_camera(seed):
    num = 0
    for _, found in lists(seed):
        for turn in found.turns:
            if turn.clock_head is None or turn.opening_lps is None:
                assert turn.hour_doubt is None or turn.direction_in(turn.camera("head")) == "no clock hour"
                continue
            for roll_hours in (0.0, 3.0, 6.0, 10.0):
                camera = turn.camera("head").lps_from_camera.copy()
                angle = math.tau * roll_hours / 12.0
                # A camera that turns clockwise sees the opening turn anticlockwise.
                right, down = camera[:3, 0].copy(), camera[:3, 1].copy()
                camera[:3, 0] = math.cos(angle) * right + math.sin(angle) * down
                camera[:3, 1] = math.cos(angle) * down - math.sin(angle) * right
                for is_turned in (False, True):
                    words = turn.direction_in(Pose(camera), picture_turned=is_turned)
                    assert words is not None
                    expected = (turn.clock_head - roll_hours + 6.0 * is_turned) % 12.0
                    assert hours_apart(float(words.split()[0]), expected) <= 0.5 + 1e-6
                num += 1
    assert num > 10


def test_opening_behind_the_camera_has_no_direction():
    turn = next(t for _, found in lists(0) for t in found.turns if t.clock_head is not None)
    camera = turn.camera("head").lps_from_camera.copy()
    camera[:3, 0], camera[:3, 2] = -camera[:3, 0], -camera[:3, 2]
    assert turn.direction_in(Pose(camera)) is None
