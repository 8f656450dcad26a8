"""Tests of lymph node stations for EBUS: levels, clock hours, and messages where the airways do not show a station."""

from __future__ import annotations

import dataclasses
import json
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import carina
from carina.errors import UsageError
from carina.plan import Landmark, clock_hours, ebus_landmarks
from carina.scopes import Pose, upright
from carina.track import AirwayTree, Branch


@cache
def tree(seed: int = 2) -> AirwayTree:
    return AirwayTree.from_json(carina.generate_phantom(seed=seed, spacing_mm=5.0, generations=5).truth)


def changed(one: AirwayTree, *, drop: str | None = None, **names: str | None) -> AirwayTree:
    """Return the tree with other names of branches, and without the branch ``drop`` and its descendants."""
    gone = set()
    branches: list[Branch] = []
    for branch in one.branches:
        if (branch.name == drop and drop is not None) or branch.parent in gone:
            gone.add(branch.id)
            continue
        branches.append(dataclasses.replace(branch, name=names.get(branch.name or "", branch.name)))
    ids = {branch.id for branch in branches}
    return AirwayTree(
        tuple(dataclasses.replace(b, children=tuple(child for child in b.children if child in ids)) for b in branches)
    )


def mirrored(one: AirwayTree) -> AirwayTree:
    """Return the mirrored tree with the names that `name_tree` gives."""
    swap = str.maketrans("RL", "LR")
    branches = []
    for branch in one.branches:
        name = branch.name
        if name is not None and name not in {"Trachea", "BI", "Upper division", "Lingula"}:
            name = name.replace("Right", "_").replace("Left", "Right").replace("_", "Left")
            name = name if " " in name else name[0].translate(swap) + name[1:]
        branches.append(dataclasses.replace(branch, name=name, points=branch.points * [-1.0, 1.0, 1.0]))
    return AirwayTree(tuple(branches))


def landmarks_of(one: AirwayTree, station: str) -> list[Landmark]:
    return [mark for mark in ebus_landmarks(one) if mark.station == station]


@pytest.mark.parametrize("seed", range(4))
def test_clock_hours_and_levels_of_lymph_node_stations_match_the_textbook(seed: int) -> None:
    marks = {(mark.station, mark.seen_from): mark for mark in ebus_landmarks(tree(seed))}
    expected = {
        ("4R", "trachea"): (1.0, 2.0),
        ("4L", "trachea"): (8.5, 9.5),
        ("7", "right main bronchus"): (8.0, 10.0),
        ("7", "left main bronchus"): (2.0, 4.0),
        ("10R", "right main bronchus"): (0.5, 3.0),
        ("10L", "left main bronchus"): (9.0, 11.5),
        ("11Rs", "bronchus intermedius"): (2.0, 4.0),
        ("11Ri", "right lower lobe bronchus"): (0.2, 3.0),
        ("11L", "left lower lobe bronchus"): (8.5, 11.0),
    }
    assert set(marks) == set(expected)
    for key, (low, high) in expected.items():
        mark = marks[key]
        assert mark.clock_head is not None
        assert low <= mark.clock_head <= high, mark.words
        assert mark.from_carina_mm is not None
        assert (mark.from_carina_mm < 0.0) == key[0].startswith("4"), mark.words


def test_station_7_is_seen_from_each_main_bronchus_in_the_direction_of_the_other() -> None:
    right, left = landmarks_of(tree(), "7")
    assert right.point_lps is not None
    assert left.point_lps is not None
    assert right.direction_lps is not None
    assert left.direction_lps is not None
    apart = np.array(left.point_lps) - np.array(right.point_lps)
    assert apart @ np.array(right.direction_lps) > 0.0
    assert apart @ np.array(left.direction_lps) < 0.0
    # The distance from the carina is equal on both sides, because needles from both sides meet.
    assert right.from_carina_mm == pytest.approx(left.from_carina_mm)


def test_lymph_node_station_is_on_its_branch_and_its_distance_is_along_the_tree() -> None:
    for mark in ebus_landmarks(tree()):
        assert mark.branch_id is not None
        assert mark.point_lps is not None
        assert mark.from_carina_mm is not None
        assert mark.direction_lps is not None
        branch = tree().branch(mark.branch_id)
        at = np.array(mark.point_lps)
        ends = branch.points[:-1], branch.points[1:]
        share = np.clip(((at - ends[0]) * (ends[1] - ends[0])).sum(1) / ((ends[1] - ends[0]) ** 2).sum(1), 0.0, 1.0)
        nearest = ends[0] + share[:, None] * (ends[1] - ends[0])
        away = np.linalg.norm(nearest - at, axis=1)
        piece = int(np.argmin(away))
        assert away[piece] < 1e-6
        along = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)[:piece].sum()
        along += np.linalg.norm(at - branch.points[piece])
        before = sum(one.length_mm for one in tree().lineage(branch.id)[:-1])
        assert mark.from_carina_mm == pytest.approx(before + along - tree().root.length_mm)
        assert np.linalg.norm(mark.direction_lps) == pytest.approx(1.0)


def test_lymph_node_stations_of_a_mirrored_chest_are_on_the_opposite_side_with_a_note() -> None:
    plain, other = ebus_landmarks(tree()), ebus_landmarks(mirrored(tree()))
    mirrored_names = {"4R": "4L", "4L": "4R", "10R": "10L", "10L": "10R", "11Rs": "11Ls", "11Ri": "11Li", "11L": "11R"}
    by_place = {(mark.station, mark.point_lps): mark for mark in other}
    for mark in plain:
        assert mark.point_lps is not None
        assert mark.clock_head is not None
        x, y, z = mark.point_lps
        twin = by_place[mirrored_names.get(mark.station, mark.station), (-x, y, z)]
        assert twin.clock_head is not None
        assert twin.clock_head % 12.0 == pytest.approx(-mark.clock_head % 12.0, abs=1e-6)
        assert any("mirrored" in doubt for doubt in twin.doubts)
        assert not mark.doubts


def test_lymph_node_station_without_its_bronchus_in_the_tree_has_no_position() -> None:
    (lost,) = landmarks_of(changed(tree(), drop="RUL"), "11Rs")
    assert lost.point_lps is None
    assert lost.clock_head is None
    assert "no bronchus of the upper lobe" in lost.words
    without = ebus_landmarks(changed(tree(), drop="LMB"))
    assert [mark.station for mark in without if mark.point_lps is not None] == ["4R", "4L", "10R", "11Rs", "11Ri"]
    nameless = ebus_landmarks(changed(tree(), RMB=None, LMB=None))
    assert {mark.station for mark in nameless if mark.point_lps is not None} == {"11Rs", "11Ri", "11L"}
    # Without a known carina, no distance from the carina is stated.
    assert all(mark.from_carina_mm is None for mark in nameless)
    assert "not on the tree" in landmarks_of(changed(tree(), drop="RML"), "11Ri")[0].words or (
        "no bronchus of the middle lobe" in landmarks_of(changed(tree(), drop="RML"), "11Ri")[0].words
    )


def test_short_trachea_has_no_paratracheal_lymph_node_station() -> None:
    short = dataclasses.replace(tree().root, points=np.array([[0.0, 0, 8.0], [0, 0, 0]]), radius=np.full(2, 8.0))
    cut = AirwayTree((short, *tree().branches[1:]))
    assert landmarks_of(cut, "4R")[0].point_lps is None
    assert landmarks_of(cut, "4L")[0].point_lps is not None


def test_lymph_node_station_at_a_bronchus_drawn_by_hand_has_a_doubt() -> None:
    drawn = AirwayTree(tuple(dataclasses.replace(b, kind="manual") if b.name == "RUL" else b for b in tree().branches))
    assert landmarks_of(drawn, "11Rs")[0].doubts == ("RUL was drawn by hand",)
    assert landmarks_of(drawn, "11L")[0].doubts == ()


@settings(deadline=None, max_examples=60)
@given(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(0.0, 6.28))
def test_clock_hour_of_a_direction_is_its_angle_in_the_levelled_picture(
    turn: float, tilt: float, around: float
) -> None:
    forward = np.array([np.cos(tilt) * np.sin(turn), np.cos(tilt) * np.cos(turn), np.sin(tilt)])
    pose = Pose.looking(np.zeros(3), forward, upright(forward))
    axes = np.asarray(pose.lps_from_camera)[:3, :3]
    direction = axes @ np.array([np.sin(around), -np.cos(around), 0.3])
    head, facing = clock_hours(forward, direction)
    assert 0.0 < head <= 12.0
    off = (head - around * 12.0 / (2.0 * np.pi) + 6.0) % 12.0 - 6.0
    assert abs(off) < 1e-6
    assert (facing - head) % 12.0 == pytest.approx(6.0)


def test_lymph_node_stations_are_plain_json_and_an_argument_that_is_not_a_tree_is_refused() -> None:
    written = json.loads(json.dumps([mark.to_json() for mark in ebus_landmarks(tree())], allow_nan=False))
    assert written[0]["station"] == "4R"
    assert "IASLC" in written[0]["source"]
    with pytest.raises(UsageError):
        ebus_landmarks("tree")  # type: ignore[arg-type]
