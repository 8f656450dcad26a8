"""Tests of the questions of quizzes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina.errors import NoResultError, UsageError
from carina.track import AirwayTree
from carina.training import quiz_questions, segments_of_case
from carina.training.openings_in_sight import branch_openings


def branch_named(tree, name):
    (segment,) = [one for one in segments_of_case(tree) if one.name == name]
    return tree.branch(segment.branch_ids[0])


def test_tip_looks_at_the_opening_of_the_right_answer_and_is_not_inside_its_segment(chest):
    questions = quiz_questions(chest.tree, chest.wall, "name-opening", num=18)
    assert len(questions) >= 15
    assert len({one.answer for one in questions}) == len(questions), "each segment once"
    for one in questions:
        branch = branch_named(chest.tree, one.answer)
        (opening,) = branch_openings(chest.tree, [branch.id], chest.wall)
        way = opening.middle_lps - one.pose.position_lps
        assert one.pose.forward_lps @ way / np.linalg.norm(way) > 0.9999
        assert chest.wall.distance_mm([one.pose.position_lps])[0] > 0.0
        assert (one.pose.position_lps - opening.middle_lps) @ opening.dir_lps < 0.0, "before the opening"


def test_tip_is_in_the_segment_of_the_right_answer(chest):
    for one in quiz_questions(chest.tree, chest.wall, "where-are-you", num=18):
        inside, _, _ = chest.tree.nearest_branch(one.pose.position_lps)
        assert inside.id == branch_named(chest.tree, one.answer).id


def test_choices_are_the_answer_and_the_three_nearest_segments(chest):
    segments = {one.name: chest.tree.branch(one.branch_ids[0]).points[0] for one in segments_of_case(chest.tree)}
    for one in quiz_questions(chest.tree, chest.wall, "where-are-you", num=18, seed=3):
        at = segments[one.answer]
        nearest = sorted(segments, key=lambda name: np.linalg.norm(segments[name] - at))[:4]
        assert sorted(one.choices) == sorted(nearest)


def test_one_seed_gives_the_same_questions_and_another_seed_other_ones(chest):
    def drawn(seed):
        return [(one.answer, one.choices) for one in quiz_questions(chest.tree, chest.wall, "where-are-you", seed=seed)]

    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)


def test_right_answer_is_at_any_position_among_the_choices(chest):
    at = {one.choices.index(one.answer) for one in quiz_questions(chest.tree, chest.wall, "where-are-you", num=18)}
    assert len(at) > 1


def test_segments_with_uncertain_names_occur_in_no_question(chest):
    answers = {one.answer for one in quiz_questions(chest.tree, chest.wall, "where-are-you", num=18)}
    doubtful = min(answers)
    branches = [
        dataclasses.replace(one, name_confidence=0.79) if one.name == doubtful else one for one in chest.tree.branches
    ]
    tree = AirwayTree(tuple(branches))
    again = {one.answer for one in quiz_questions(tree, chest.wall, "where-are-you", num=18)}
    assert again == answers - {doubtful}


def test_case_without_named_segments_is_refused(chest):
    bare = AirwayTree(tuple(dataclasses.replace(one, name=None) for one in chest.tree.branches))
    with pytest.raises(NoResultError, match="expected two segments or more"):
        quiz_questions(bare, chest.wall, "name-opening")
    with pytest.raises(UsageError, match="kind"):
        quiz_questions(chest.tree, chest.wall, "spelling")
