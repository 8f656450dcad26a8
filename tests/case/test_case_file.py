"""Tests of saving and opening a case: the content is equal bit for bit, and further edits have equal results."""

from __future__ import annotations

import numpy as np
import pytest
from edit_case import edit_case
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sample_case import ACTS, ActiveCase, act, assert_same_airways, assert_same_moment, source_of, whole

from carina.case import CaseFile, CaseFileError
from carina.track import AddBranch, edit_airways
from carina.track.paths.path_grid import PathGrid

sequences = st.lists(st.tuples(st.sampled_from(ACTS), st.integers(0, 2**32 - 1)), min_size=6, max_size=14)


def worked_on(acts, path, case=None):
    """Perform actions on two equal cases and compare them after each action.

    One is only in memory, the other is saved and reopened before each action.
    """
    active_case = again = ActiveCase(case)
    with CaseFile.create(path, source_of(active_case.case)) as file:
        file.save(active_case.moment())
    for place, (name, seed) in enumerate(acts):
        with CaseFile.open(path) as file:
            found = file.load(active_case.case.volume)
            assert_same_moment(found, active_case.moment(), active_case.case, deep=False)
            again = ActiveCase.of(found, active_case.case)
            again.at_s = active_case.at_s
            for one in (active_case, again):
                rng = np.random.default_rng(seed)
                act(one, name, lambda n, rng=rng: int(rng.integers(n)))
            file.save(again.moment())
            if place % 3 == 0:
                file.save(again.moment())  # The second save has no change.
    assert_same_moment(again.moment(), active_case.moment(), active_case.case)
    with CaseFile.open(path, read_only=True) as file:
        assert_same_moment(file.load(active_case.case.volume), active_case.moment(), active_case.case)


@pytest.fixture
def active_case():
    return ActiveCase()


def test_case_without_any_edit_is_restored(active_case, tmp_path):
    moment = active_case.moment()
    with CaseFile.create(tmp_path / "one.carina", source_of(active_case.case)) as file:
        assert file.digest == source_of(active_case.case).digest
        with pytest.raises(CaseFileError, match="nothing has been saved"):
            file.load(active_case.case.volume)
        file.save(moment)
    with CaseFile.open(tmp_path / "one.carina") as file:
        assert_same_moment(file.load(active_case.case.volume), moment, active_case.case)


@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(acts=sequences)
def test_case_reopened_before_each_action_equals_a_case_that_stayed_open(acts, tmp_path_factory):
    worked_on(acts, tmp_path_factory.mktemp("case") / "one.carina")


def test_compressed_tree_with_a_renamed_branch_keeps_its_branch_paths(tmp_path):
    worked_on([("rename", 3401), ("add", 1974794), ("root", 0), ("fold", 0)], tmp_path / "one.carina")


@pytest.fixture(scope="module")
def divided_case():
    """Return a case whose path grid divides each slice in two."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PathGrid, "of", classmethod(lambda cls, ct: cls(ct, 2)))
        case = edit_case.__wrapped__()
    assert case.airways.tracker.grid.parts == 2
    assert case.airways.tracker.lumen_zyx.shape[0] == 2 * case.volume.shape_zyx[0]
    return case


@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(acts=sequences)
def test_case_with_divided_slices_reopened_before_each_action_equals_one_that_stayed_open(
    acts, divided_case, tmp_path_factory
):
    worked_on(acts, tmp_path_factory.mktemp("case") / "one.carina", divided_case)


def test_lumen_searched_in_divided_slices_is_restored_from_the_case_file(divided_case, tmp_path):
    with CaseFile.create(tmp_path / "one.carina", source_of(divided_case)) as file:
        file.save(ActiveCase(divided_case).moment())
    with CaseFile.open(tmp_path / "one.carina") as file:
        airways = whole(file.load(divided_case.volume).first.airways, divided_case)
    assert airways.tracker.grid.parts == 2
    np.testing.assert_array_equal(airways.tracker.lumen_zyx, divided_case.airways.tracker.lumen_zyx)
    np.testing.assert_array_equal(airways.lumen_zyx, divided_case.airways.lumen_zyx)
    assert airways.lumen_zyx.shape == divided_case.volume.shape_zyx


@pytest.mark.soak
@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(acts=sequences)
def test_case_reopened_before_each_action_equals_one_that_stayed_open_in_300_sequences(acts, tmp_path_factory):
    worked_on(acts, tmp_path_factory.mktemp("case") / "one.carina")


def test_reopened_airways_give_the_live_path_and_the_edit_of_the_original(active_case, tmp_path):
    with CaseFile.create(tmp_path / "one.carina", source_of(active_case.case)) as file:
        file.save(active_case.moment())
    with CaseFile.open(tmp_path / "one.carina") as file:
        airways = whole(file.load(active_case.case.volume).first.airways, active_case.case)
    assert "not built yet" in repr(airways.tracker)
    point = tuple(float(v) for v in active_case.case.tips[0])
    one, other = (a.tracker.live_path(point) for a in (airways, active_case.case.airways))
    np.testing.assert_array_equal(one.points_lps, other.points_lps)
    assert (one.confidence, one.joins_branch_id) == (other.confidence, other.joins_branch_id)
    edit = AddBranch(tuple(float(v) for v in active_case.case.hidden), even_without_evidence=True)
    assert_same_airways(*(edit_airways(active_case.case.volume, a, edit) for a in (airways, active_case.case.airways)))
