"""Tests of tasks: built-in files, errors of invalid files, and cases that lack a branch."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carina.errors import NoResultError, UsageError
from carina.phantom import generate_phantom
from carina.track import AirwayTree, Branch, name_tree
from carina.training import SEGMENTS, Task, find_task, segments_of_case, task_from_file, task_names, task_to_json
from carina.training.handling import TipPlaces
from carina.training.openings_in_sight import OpeningSights
from carina.training.segments import doubtful_names
from carina.training.task_steps import task_result
from carina.training.visits import Visit

GOOD = {"format": "carina-task", "version": 1, "name": "own", "title": "Own task", "kind": "inspect"}


@pytest.mark.parametrize("name", task_names())
def test_built_in_task_has_the_name_of_its_file_and_survives_a_round_trip(name, tmp_path):
    task = find_task(name)
    assert task.name == name
    file = tmp_path / "task.json"
    file.write_text(json.dumps(task_to_json(task)))
    assert task_from_file(file) == task


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"kind": "fly"},
            "kind: expected one of inspect, find, sequence, turns, pass, hold, reach, stations; found 'fly'",
        ),
        ({"kind": "find"}, "segments: expected one segment; found ()"),
        ({"kind": "find", "segments": ["RB11"]}, "segments[0]: expected one of RB1, RB2"),
        ({"kind": "find", "segments": "RB1"}, "segments: expected a list of texts; found 'RB1'"),
        ({"kind": "sequence", "segments": ["RB1"]}, "segments: expected two segments or more"),
        ({"kind": "sequence", "segments": ["RB1", "RB1"]}, "segments: expected each segment once"),
        ({"kind": "turns"}, "branches: expected one branch or more; found ()"),
        ({"kind": "hold", "structure": "RUL"}, "hold_s: expected a value; found None"),
        ({"hold_s": 3.0}, "hold_s: expected null for the kind inspect; found 3.0"),
        ({"time_limit_s": -1}, "time_limit_s: expected a number from 1 to 7200 s or None; found -1"),
        ({"hints": ["map"]}, "hints[0]: expected one of tree, arrow, ghost; found 'map'"),
        ({"scope": "telescope"}, "scope: expected one of generic"),
        ({"version": 2}, 'format and version: expected "carina-task" and 1'),
        ({"pass_mark": 80}, "names: expected only"),
        ({"title": ""}, "title: expected words"),
    ],
)
def test_invalid_file_states_file_field_expected_and_found_value(changed, message, tmp_path):
    file = tmp_path / "own.json"
    file.write_text(json.dumps(GOOD | changed))
    with pytest.raises(UsageError) as refused:
        task_from_file(file)
    assert refused.value.code == "training.task"
    assert str(refused.value).startswith("own.json: ")
    assert message in str(refused.value)
    assert str(refused.value).endswith("correct the file; docs/training.md describes its fields")


@pytest.mark.parametrize("text", ["", "{", "[]", "3"])
def test_file_that_is_not_a_task_is_refused(text, tmp_path):
    file = tmp_path / "own.json"
    file.write_text(text)
    with pytest.raises(UsageError, match=r"own\.json"):
        task_from_file(file)


def test_example_of_the_guide_is_a_valid_task(tmp_path):
    guide = (Path(__file__).parents[2] / "docs" / "training.md").read_text()
    file = tmp_path / "own.json"
    file.write_text(guide.split("```json")[1].split("```")[0])
    assert task_from_file(file).segments == ("RB6", "RB8", "LB6")


def inspection(order, landmark_frame, *frames):
    """Return the result of an inspection of two segments, with a landmark in sight up to a frame."""
    in_sight = np.zeros((100, 1), dtype=bool)
    in_sight[landmark_frame - 5 : landmark_frame + 1] = True
    sights = OpeningSights(in_sight, np.full((100, 1), np.inf))
    visits = [Visit(frame, place) for place, frame in enumerate(frames)]
    places = TipPlaces(np.zeros(100, dtype=np.int64), np.zeros(100, dtype=bool))
    return task_result(
        replace(find_task("inspect-all"), order=order), tree_of("RB1", "RB2"), sights=sights,
        task_openings=[("main carina", [0])] if order == "landmarks" else [], visits=visits,
        segments=segments_of_case(tree_of("RB1", "RB2")), places=places, contacts=(), first=0, last=99,
    )  # fmt: skip


def test_inspection_is_not_completed_if_the_landmark_is_seen_after_the_first_segment():
    assert inspection("landmarks", 10, 30, 50).completed
    late = inspection("landmarks", 40, 30, 50)
    assert not late.completed
    assert late.steps_done == ("main carina", "RB2")


def test_inspection_is_completed_in_any_order_as_its_title_states():
    assert inspection("ascending", 90, 50, 30).completed
    assert "in ascending order" not in find_task("inspect-all").title


def test_case_without_a_landmark_is_refused():
    with pytest.raises(NoResultError, match="expected a branch named RMB"):
        find_task("inspect-landmarks").check_case(tree_of("RB1"))


def test_unknown_task_lists_the_built_in_tasks():
    with pytest.raises(UsageError, match=r"expected one of ebus-landmarks, .*; found 'inspect'"):
        find_task("inspect")


def tree_of(*names, confidence=0.95):
    ids = tuple(range(1, len(names) + 1))
    root_points = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    branches = [Branch(0, None, ids, 0, "Trachea", "tracked", root_points, np.ones(2))]
    for n, name in zip(ids, names, strict=True):
        points = np.array([[1.0, 1.0, 1.0], [2.0, n, 3.0]])
        branch = Branch(n, 0, (), 1, name, "tracked", points, np.ones(2))
        branches.append(replace(branch, name_confidence=confidence, name_from="anatomy"))
    return AirwayTree(tuple(branches))


def test_case_without_the_segment_is_refused_with_its_names():
    with pytest.raises(NoResultError) as refused:
        find_task("find-rb6").check_case(tree_of("RB1", "RB2"))
    assert refused.value.code == "training.no-branch"
    assert str(refused.value) == (
        "task find-rb6: the airways of this case: expected a branch named RB6; found the names Trachea, RB1, RB2; "
        "choose another case or task, or name the branch in the window"
    )


def test_case_denominator_counts_the_segments_of_the_tree():
    assert len(SEGMENTS) == 18
    assert [one.name for one in segments_of_case(tree_of("RB2", "LB3", "RB1", "RB9+10"))] == ["RB1", "RB2", "LB3"]


def test_separate_lb1_and_lb2_are_one_segment():
    assert segments_of_case(tree_of("LB1", "LB2"))[0].branch_ids == (1, 2)
    assert segments_of_case(tree_of("LB1")) == ()


def true_tree(seed):
    """Return the exact tree of a phantom that has almost no voxels."""
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    return AirwayTree.from_json(generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box).truth)


def without_stem(tree, name):
    """Return a tree in which the children of a branch arise where the branch arose, without names."""
    stem = tree.named(name)
    made = []
    for one in tree.branches:
        branch = replace(one, name=None)
        if one.id == stem.parent:
            others = tuple(child for child in one.children if child != stem.id)
            branch = replace(branch, children=others + stem.children)
        if one.parent == stem.id:
            points = np.concatenate([stem.points, one.points[1:]])
            radius = np.concatenate([np.full(len(stem.points) - 1, one.radius[0]), one.radius])
            branch = replace(branch, parent=stem.parent, points=points, radius=radius)
        if one.id != stem.id:
            made.append(branch)
    return AirwayTree(tuple(made))


@pytest.mark.parametrize(("name", "parts"), [("LB1+2", {"LB1+2a", "LB1+2b"}), ("RB4", {"RB4a", "RB4b"})])
def test_parts_that_arise_separately_are_one_segment_of_a_named_tree(name, parts):
    tree = name_tree(without_stem(true_tree(2), name))
    assert name not in tree.names
    found = {one.name: one for one in segments_of_case(tree)}
    assert tuple(found) == SEGMENTS
    assert {tree.branch(number).name for number in found[name].branch_ids} == parts


def test_mirrored_chest_has_the_mirrored_list_of_18_segments():
    tree = true_tree(1)
    branches = tuple(replace(one, points=one.points * [-1.0, 1.0, 1.0]) for one in tree.branches)
    found = [one.name for one in segments_of_case(name_tree(AirwayTree(branches)))]
    assert found == [f"LB{n}" for n in range(1, 11)] + ["RB1+2"] + [f"RB{n}" for n in (3, 4, 5, 6, 8, 9, 10)]


@pytest.mark.parametrize(("given", "segment"), [("LB7+8", "LB8"), ("rb6", "RB6"), ("LB 9", "LB9"), ("RB7a", "RB7")])
def test_spelling_of_a_person_is_recognised(given, segment):
    assert [one.name for one in segments_of_case(tree_of(given))] == [segment]


def test_part_below_a_branch_of_another_segment_does_not_count():
    tree = tree_of("RB2", "LB6a")
    parts = (replace(tree.branches[0], children=(1,)), replace(tree.branches[1], children=(2,)))
    points = np.concatenate([tree.branches[1].points[-1:], tree.branches[2].points[-1:]])
    below = AirwayTree((*parts, replace(tree.branches[2], parent=1, generation=2, points=points)))
    assert [one.name for one in segments_of_case(tree)] == ["RB2", "LB6"]
    assert [one.name for one in segments_of_case(below)] == ["RB2"]


@pytest.mark.parametrize(("confidence", "expected"), [(0.79, 1), (0.8, 0)])
def test_name_below_a_confidence_of_080_is_doubtful(confidence, expected):
    assert len(doubtful_names(tree_of("RB1", confidence=confidence), [1])) == expected


def test_name_of_a_person_is_certain():
    tree = tree_of("RB1", confidence=0.1)
    given = replace(tree.branches[1], name_confidence=None, name_from="person")
    assert doubtful_names(AirwayTree((tree.branches[0], given)), [1]) == ()


def test_task_in_python_is_checked_as_a_file_is():
    with pytest.raises(UsageError, match="Task: segments: expected one segment"):
        Task("own", "Own", "find")
