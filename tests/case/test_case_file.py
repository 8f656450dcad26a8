"""A case that is saved and opened again is the case that was saved, bit for bit, and is worked on as before."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kept_case import ACTS, Doing, act, assert_same_airways, assert_same_moment, source_of, whole

from carina.case import CaseFile, CaseFileError
from carina.track import AddBranch, edit_airways


@pytest.fixture
def doing():
    return Doing()


def test_a_case_without_a_step_comes_back(doing, tmp_path):
    moment = doing.moment()
    with CaseFile.create(tmp_path / "one.carina", source_of(doing.case)) as file:
        assert file.digest == source_of(doing.case).digest
        with pytest.raises(CaseFileError, match="nothing was saved"):
            file.load(doing.case.volume)
        file.save(moment)
    with CaseFile.open(tmp_path / "one.carina") as file:
        assert_same_moment(file.load(doing.case.volume), moment, doing.case)


@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(acts=st.lists(st.tuples(st.sampled_from(ACTS), st.integers(0, 2**32 - 1)), min_size=4, max_size=9))
def test_any_sequence_saved_after_each_of_its_steps_comes_back_bit_for_bit(acts, tmp_path_factory):
    path = tmp_path_factory.mktemp("case") / "one.carina"
    doing = Doing()
    with CaseFile.create(path, source_of(doing.case)) as file:
        for name, seed in acts:
            rng = np.random.default_rng(seed)
            act(doing, name, lambda n, rng=rng: int(rng.integers(n)))
            file.save(doing.moment())
    with CaseFile.open(path) as file:
        found = file.load(doing.case.volume)
        assert_same_moment(found, doing.moment(), doing.case)
        # What is done now is what would have been done without the file.
        again = Doing()
        again.history, again.numbers, again.sight = found.history(), dict(found.numbers), found.sight
        for other in (doing, again):
            rng = np.random.default_rng(len(acts))
            for name in ("cut", "add", "paint", "target", "undo", "undo", "root", "redo"):
                act(other, name, lambda n, rng=rng: int(rng.integers(n)))
        assert_same_moment(again.moment(), _at(doing.moment(), found, again), doing.case)
        file.save(again.moment())
    with CaseFile.open(path, read_only=True) as file:
        assert_same_moment(file.load(doing.case.volume), again.moment(), doing.case)


def _at(moment, _found, again):
    """The other's clock began anew."""
    import dataclasses

    steps = tuple(
        dataclasses.replace(one, at_s=other.at_s) for one, other in zip(moment.steps, again.history.steps, strict=True)
    )
    return dataclasses.replace(moment, steps=steps)


def test_a_live_path_and_an_edit_after_opening_are_those_of_the_case_that_was_not_saved(doing, tmp_path):
    with CaseFile.create(tmp_path / "one.carina", source_of(doing.case)) as file:
        file.save(doing.moment())
    with CaseFile.open(tmp_path / "one.carina") as file:
        airways = whole(file.load(doing.case.volume).first.airways, doing.case)
    assert "not made yet" in repr(airways.tracker)
    point = tuple(float(v) for v in doing.case.tips[0])
    one, other = (a.tracker.live_path(point) for a in (airways, doing.case.airways))
    np.testing.assert_array_equal(one.points_lps, other.points_lps)
    assert (one.confidence, one.joins_branch_id) == (other.confidence, other.joins_branch_id)
    edit = AddBranch(tuple(float(v) for v in doing.case.hidden), even_without_evidence=True)
    assert_same_airways(*(edit_airways(doing.case.volume, a, edit) for a in (airways, doing.case.airways)))
