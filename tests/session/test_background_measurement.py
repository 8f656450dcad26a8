"""Tests of the background measurement of the airways: for the present tree, and again after an edit."""

from __future__ import annotations

from types import SimpleNamespace

from carina.commands import EditTree, OpenPath
from carina.errors import CancelledError
from carina.session import Changed
from carina.track import CutBranch
from small_case import session_fixture


class Measures:
    """Replacement of the measurement that records its calls."""

    def __init__(self, airways, previous):
        self.airways, self.previous = airways, previous


def measure(volume, airways, *, previous, progress, cancel):
    progress("measuring the airways", 0.5)
    return Measures(airways, previous)


def test_airways_are_measured_after_each_change_and_a_tree_event_is_sent():
    fixture = session_fixture(measure_tree=measure)
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    assert fixture.session.snapshot().measures is None
    fixture.background.run_all()
    snapshot = fixture.session.snapshot()
    assert snapshot.measures.airways is snapshot.document.airways
    assert snapshot.measures.previous is None
    assert "tree" in fixture.of_type(Changed)[-1].topics


def test_lumen_diameter_at_the_tip_is_known_after_the_airways_are_measured():
    class Sections:
        @staticmethod
        def of(branch_id):
            return SimpleNamespace(diameter_near=lambda lps: 10.0 + branch_id)

    fixture = session_fixture(measure_tree=lambda volume, airways, **options: Sections)
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    assert fixture.session.pose_info().lumen_mm is None
    fixture.background.run_all()
    pose = fixture.session.pose_info()
    assert pose.lumen_mm == 10.0 + pose.branch.id
    assert "pose" in fixture.of_type(Changed)[-1].topics


def test_edit_reuses_earlier_measurements_and_undo_shows_no_measurements_of_another_tree():
    def edit_airways(volume, airways, edit, **options):
        return SimpleNamespace(**vars(airways))

    fixture = session_fixture(measure_tree=measure, edit_airways=edit_airways)
    fixture.open()
    first = fixture.session.snapshot()
    fixture.session.do(EditTree(CutBranch(first.document.airways.tree.tips()[0].id)))
    fixture.background.run_next()
    edited = fixture.session.snapshot()
    assert edited.document.airways is not first.document.airways
    # The measures of the earlier tree are not shown, because its branches may no longer exist.
    assert edited.measures is None
    fixture.background.run_all()
    edited = fixture.session.snapshot()
    assert edited.measures.airways is edited.document.airways
    assert edited.measures.previous is first.measures
    fixture.session.undo()
    assert fixture.session.snapshot().measures is None
    fixture.background.run_all()
    assert fixture.session.snapshot().measures.airways is first.document.airways


def test_case_stays_open_without_measurements_if_measuring_is_stopped_or_unavailable():
    def stopped(volume, airways, *, previous, progress, cancel):
        raise CancelledError("stopped")

    for part in (stopped, None):
        fixture = session_fixture(measure_tree=part)
        fixture.open()
        snapshot = fixture.session.snapshot()
        assert (snapshot.airways, snapshot.measures) == ("found", None)
