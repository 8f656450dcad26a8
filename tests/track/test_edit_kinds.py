"""Tests of edits as values: refused values, text and JSON."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carina.errors import TrackingError, UsageError
from carina.track import (
    AddBranch,
    AirwayTree,
    Branch,
    Bridge,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    RenameBranch,
    SmoothBranch,
    edit_words,
    edits_from_json,
    edits_to_json,
)

mm = st.floats(-500, 500)
points = st.tuples(mm, mm, mm)
ids = st.integers(0, 10_000)
edits = st.one_of(
    points.map(AddBranch),
    st.builds(CutBranch, ids, st.floats(0, 100)),
    points.map(Bridge),
    points.map(MoveRoot),
    st.builds(MoveFork, ids, points),
    st.builds(
        PaintLumen,
        st.lists(points, min_size=1, max_size=5).map(tuple),
        st.floats(0, 30),
        st.sampled_from(["axial", "coronal", "sagittal", "ball"]),
        st.booleans(),
    ),
    ids.map(SmoothBranch),
    st.builds(RenameBranch, ids, st.sampled_from([None, "RB3", "a side branch"])),
)


@given(st.lists(edits, max_size=6))
def test_edits_are_restored_from_their_json(many):
    assert list(edits_from_json(edits_to_json(many))) == many


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: AddBranch((0.0, 1.0)), "the end of the branch: expected a point"),
        (lambda: Bridge((0.0, float("nan"), 1.0)), "expected finite numbers"),
        (lambda: CutBranch(-1), "branch_id: expected a whole number"),
        (lambda: CutBranch(2, -0.5), "at_mm: expected a number of at least 0"),
        (lambda: PaintLumen((), 2.0), "stroke: expected 1 to"),
        (lambda: PaintLumen(((0, 0, 0),), 31.0), "between 0 and 30"),
        (
            lambda: PaintLumen(((0, 0, 0),), 2.0, "oblique"),
            "brush plane: expected one of axial, coronal, sagittal, ball",
        ),
        (lambda: RenameBranch(1, "  "), "branch name: expected 1 to 80 characters"),
    ],
)
def test_edit_with_an_invalid_value_is_refused_with_the_expected_value(make, text):
    with pytest.raises(UsageError, match=text):
        make()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"version": 2}, "version must be 1, found 2"),
        ({"edits": [{"kind": "explode"}]}, "edit 0: kind must be one of add-branch"),
        ({"edits": [{"kind": "cut-branch"}]}, "edit 0: .*branch_id"),
        ({"edits": [{"kind": "bridge", "lps": [0, 1]}]}, "edit 0: the point beyond the obstruction"),
        ({"edits": "cut"}, "edits must be a list"),
    ],
)
def test_invalid_list_of_edits_is_refused_with_the_position_of_the_invalid_edit(change, text):
    with pytest.raises(TrackingError, match=text):
        edits_from_json(edits_to_json([CutBranch(1)]) | change)


def test_text_of_an_edit_contains_the_name_of_the_branch():
    trunk = Branch(0, None, (7,), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -9]]), np.array([8.0, 8]))
    child = Branch(7, 0, (), 1, None, "tracked", np.array([[0.0, 0, -9], [9, 0, -9]]), np.array([8.0, 8]))
    airways = SimpleNamespace(tree=AirwayTree((trunk, child)))
    assert edit_words(CutBranch(7), airways) == "cut branch 7"
    assert edit_words(CutBranch(0, 3.0), airways) == "shorten Trachea"
    assert edit_words(Bridge((12.0, 0, -9)), airways) == "add a bridge beyond branch 7"
    assert edit_words(AddBranch((0.0, 0, 3)), airways) == "add a branch beyond Trachea"
    assert edit_words(RenameBranch(7, "RB3"), airways) == "rename branch 7 to RB3"
    assert edit_words(PaintLumen(((0, 0, 0),), 2.0, erase=True), airways) == "erase lumen"
