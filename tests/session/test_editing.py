"""Tests of edits of the airway tree in a session: undo and redo, and effects on targets, routes and messages."""

from __future__ import annotations

import numpy as np
import pytest
from edit_case import assert_same, edit_case, in_plain_lung, open_ended_airways, open_ended_volume

from carina.case.history import History
from carina.commands import AddTarget, Cancel, ChooseRoute, CloseCase, EditTree, GoTo, OpenPath, PreviewOf, Undo
from carina.errors import CancelledError, NoEvidenceError, NoResultError, UsageError
from carina.session import ErrorEvent, EvidenceMissing, JobEnded, UserMessage
from carina.session.airways.editing import NUM_EDITS_WHOLE
from carina.track import (
    AddBranch,
    Airways,
    Bridge,
    CutBranch,
    FoldedAirways,
    MoveFork,
    MoveRoot,
    PaintLumen,
    RenameBranch,
    SmoothBranch,
    edit_airways,
    find_airways,
    rebuild_airways,
)
from small_case import edit_session_fixture, session_fixture


def point(values):
    return tuple(float(v) for v in values)


@pytest.fixture
def case():
    return edit_case()


@pytest.fixture
def fixture(case):
    """Return a session with the small drawn tree, real airways and real edits, whose background the test runs."""
    made = edit_session_fixture(case.volume, case.airways)
    made.events.clear()
    return made


def edit(fixture, *edits):
    for one in edits:
        fixture.session.do(EditTree(one))
        fixture.background.run_all()


def document(fixture):
    return fixture.session.snapshot().document


def test_edit_of_the_tree_is_one_labelled_undo_step(fixture, case):
    edit(fixture, CutBranch(2))
    assert 2 not in {b.id for b in document(fixture).airways.tree.branches}
    assert fixture.session.snapshot().undo_label == "cut branch 2"
    assert next(e.outcome for e in fixture.of_type(JobEnded)) == "done"
    fixture.session.undo()
    assert document(fixture).airways is case.airways
    assert fixture.session.snapshot().redo_label == "cut branch 2"
    fixture.session.redo()
    assert 2 not in {b.id for b in document(fixture).airways.tree.branches}
    fixture.background.run_all()
    np.testing.assert_array_equal(fixture.renderers[-1].lumen, document(fixture).airways.lumen_zyx)


def names_of(airways):
    return {branch.id: (branch.name, branch.name_from, branch.name_confidence) for branch in airways.tree.branches}


@pytest.mark.parametrize("is_mask", [False, True])
@pytest.mark.parametrize("kind", ["add branch", "bridge", "move fork"])
def test_one_undo_of_a_repair_restores_tree_and_names(case, kind, is_mask):
    airways = case.airways
    if is_mask:
        airways = find_airways(case.volume, root_lps=airways.root_lps, lumen_zyx=airways.lumen_zyx)
    leaf = airways.tree.nearest_branch(case.tips[3])[0]
    fork = airways.tree.branch(leaf.parent)
    if kind == "add branch":
        airways = edit_airways(case.volume, airways, CutBranch(leaf.id))
    airways = edit_airways(case.volume, airways, RenameBranch(fork.id, "LLL"))
    made = session_fixture(
        open_volume=lambda _path, _progress, _cancel: case.volume,
        find_airways=lambda _volume, **_options: airways,
        edit_airways=edit_airways,
    )
    made.open()
    before = names_of(airways)
    edit(
        made,
        {
            "add branch": AddBranch(point(leaf.points[-2])),
            "bridge": Bridge(point(case.hidden)),
            "move fork": MoveFork(fork.id, point(fork.points[-1] + np.array([0.0, 0.0, 1.2]))),
        }[kind],
    )
    edited = document(made).airways
    assert edited is not airways
    assert names_of(edited)[fork.id] == before[fork.id]
    if kind == "move fork":
        assert names_of(edited) == before
    made.session.undo()
    assert document(made).airways is airways
    assert names_of(airways) == before


def test_opening_another_case_stops_edits_and_target_searches_of_the_first(fixture, case):
    edit_job = fixture.session.do(EditTree(CutBranch(2)))
    target_job = fixture.session.do(AddTarget(point(case.airways.tree.branch(5).points[-2])))
    left = tuple(fixture.background.waiting)
    fixture.background.waiting.clear()
    fixture.open("other")
    fixture.events.clear()
    for work in left:
        work()
    assert [(e.job_id, e.outcome) for e in fixture.of_type(JobEnded)] == [
        (edit_job, "cancelled"),
        (target_job, "cancelled"),
    ]
    assert not fixture.of_type(UserMessage)
    assert fixture.session.snapshot().undo_label is None


def test_route_to_a_cut_branch_is_removed_with_a_message_and_restored_by_undo(fixture, case):
    removed = case.airways.tree.branch(2)
    fixture.session.do(ChooseRoute(branch_id=2))
    edit(fixture, CutBranch(2))
    assert document(fixture).route is None
    messages = [e.message for e in fixture.of_type(UserMessage)]
    assert messages == ["the edit removed the route to branch 2, generation 2; choose another one, or undo"]
    fixture.session.undo()
    assert document(fixture).route.branch_id == removed.id


def test_paths_to_targets_are_searched_again_in_the_edited_tree(fixture, case):
    fixture.session.do(AddTarget(point(case.airways.tree.branch(2).points[-2])))
    fixture.session.do(AddTarget(point(case.airways.tree.branch(5).points[-2])))
    fixture.background.run_all()
    assert all(target.route is not None for target in document(fixture).targets)
    edit(fixture, CutBranch(2))
    lost, remaining = document(fixture).targets
    assert lost.route is None
    assert "mm from the segmented lumen" in lost.problem
    assert remaining.route is not None
    assert any(e.message.startswith("there is no longer a path to Target 1") for e in fixture.of_type(UserMessage))
    edit(fixture, AddBranch(point(case.tips[0])))
    assert all(target.route is not None for target in document(fixture).targets)


def test_route_that_an_edit_does_not_touch_stays_active(fixture):
    fixture.session.do(ChooseRoute(branch_id=5))
    fixture.session.do(GoTo(9.0))
    before = document(fixture).route
    edit(fixture, RenameBranch(5, "LB6"))
    after = document(fixture).route
    assert after.path is before.path
    assert [s.name for s in after.spans][-1] == "LB6"
    pose = fixture.session.pose_info()
    assert pose.path_mm == pytest.approx(9.0)
    assert pose.pose is not None


def test_edit_that_leaves_the_lumen_unchanged_does_not_prepare_the_renderer_again(fixture):
    prepared = fixture.renderers[-1].prepared
    edit(fixture, RenameBranch(5, "LB6"), SmoothBranch(5))
    assert fixture.renderers[-1].prepared == prepared
    assert fixture.session.pose_info() is not None
    edit(fixture, CutBranch(5))
    assert fixture.renderers[-1].prepared > prepared


def test_renderer_is_prepared_again_for_a_lumen_whose_preparation_was_stopped(fixture):
    renderer = fixture.renderers[-1]
    prepared = renderer.prepared

    def stopped():
        renderer.on_prepare = lambda: None
        raise CancelledError("stopped")

    renderer.on_prepare = stopped
    edit(fixture, CutBranch(5))
    assert renderer.prepared == prepared
    fixture.session.do(Undo())
    fixture.background.run_all()
    assert renderer.prepared > prepared, "the earlier maps are deleted after a change of the lumen"


def test_impossible_edits_leave_the_tree_unchanged_and_state_the_reason(fixture, case):
    before = document(fixture)
    with pytest.raises(UsageError, match="lies outside the scan"):
        fixture.session.do(EditTree(AddBranch((900.0, 0.0, 0.0))))
    edit(fixture, CutBranch(0), CutBranch(77), Bridge(point(case.plug)))
    assert document(fixture) is before
    assert [e.outcome for e in fixture.of_type(JobEnded)] == ["failed"] * 3
    messages = [e.message for e in fixture.of_type(ErrorEvent)]
    assert "contains the start" in messages[0]
    assert "branch 77 is not in the tree" in messages[1]
    assert "this point is not in air" in messages[2]
    assert fixture.session.snapshot().undo_label is None


def test_edit_of_the_tree_without_airways_is_refused():
    fixture = session_fixture()
    with pytest.raises(UsageError, match="no case is open"):
        fixture.session.do(EditTree(CutBranch(1)))
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    with pytest.raises(NoResultError, match="no airway tree to edit yet"):
        fixture.session.do(EditTree(CutBranch(1)))


def test_stopped_edit_leaves_the_tree_unchanged(fixture):
    before = document(fixture)
    job_id = fixture.session.do(EditTree(CutBranch(2)))
    fixture.session.do(Cancel(job_id))
    fixture.background.run_all()
    assert document(fixture) is before
    assert [e.outcome for e in fixture.of_type(JobEnded)] == ["cancelled"]


def test_edit_requested_before_an_undo_applies_to_the_tree_after_it(fixture):
    edit(fixture, CutBranch(2))
    fixture.session.do(EditTree(SmoothBranch(5)))
    fixture.session.undo()
    fixture.background.run_all()
    assert [type(e) for e in document(fixture).airways.edits] == [SmoothBranch]


def test_long_series_of_edits_is_undone_and_redone_bit_for_bit(fixture, case):
    trunk = case.airways.tree.root.points
    edits = [PaintLumen((point(trunk[3 + n // 2]),), 3.6 + 0.2 * n, "ball") for n in range(NUM_EDITS_WHOLE + 4)]
    edit(fixture, *edits)
    history: History = fixture.session._core.case.history
    snapshots = [d.airways for d in history.documents()]
    assert sum(isinstance(a, FoldedAirways) for a in snapshots) > 0
    assert len({id(a) for a in snapshots if isinstance(a, Airways) and a.edits}) <= NUM_EDITS_WHOLE
    last = document(fixture).airways
    assert last.edits == tuple(edits)
    for num_left in range(len(edits) - 1, -1, -1):
        fixture.session.undo()
        airways = document(fixture).airways
        assert isinstance(airways, Airways)
        assert airways.edits == tuple(edits[:num_left])
        if num_left in {1, 4}:
            assert_same(airways, rebuild_airways(case.volume, case.airways, edits[:num_left]))
    assert document(fixture).airways is case.airways
    for _ in edits:
        fixture.session.redo()
    assert_same(document(fixture).airways, last)


def test_undo_history_compresses_states_far_from_the_present_one():
    history = History(0)
    for n in range(1, 9):
        history.change(f"to {n}", n, now_s=float(n))
    for _ in range(4):
        history.undo()
    history.fold_far(lambda d: d, 3, lambda d: -d)
    assert sorted(history.documents()) == [-8, -7, -6, -2, -1, 0, 3, 4, 5]


@pytest.fixture
def lung_fixture():
    """Return a session fixture whose volume allows paths through plain lung."""
    made = session_fixture(
        open_volume=lambda _path, _progress, _cancel: open_ended_volume(),
        find_airways=lambda _volume, **_options: open_ended_airways(),
        edit_airways=edit_airways,
    )
    made.open()
    made.events.clear()
    return made


def test_branch_without_evidence_is_added_only_after_the_user_confirms_it(lung_fixture):
    edit(lung_fixture, AddBranch(in_plain_lung()))
    (question,) = lung_fixture.of_type(EvidenceMissing)
    assert lung_fixture.of_type(ErrorEvent) == []
    (ended,) = lung_fixture.of_type(JobEnded)
    assert (ended.job_id, ended.outcome) == (question.job_id, "failed")
    assert isinstance(ended.error, NoEvidenceError)
    assert lung_fixture.events.index(question) < lung_fixture.events.index(ended)
    assert question.lps == in_plain_lung()
    assert question.error.doubtful_mm > 2.0
    assert document(lung_fixture).airways is open_ended_airways()
    assert lung_fixture.session.snapshot().undo_label is None

    edit(lung_fixture, AddBranch(question.lps, even_without_evidence=True))
    drawn = [b for b in document(lung_fixture).airways.tree.branches if b.kind == "manual"]
    assert sum(b.doubtful_mm for b in drawn) == pytest.approx(question.error.doubtful_mm)
    assert np.array_equal(drawn[-1].points[-1], question.error.way_lps[-1])
    assert all(b.name is None and b.confidence is None for b in drawn)
    lung_fixture.session.undo()
    assert document(lung_fixture).airways is open_ended_airways()


def test_route_along_a_drawn_branch_states_its_drawn_length(lung_fixture):
    edit(lung_fixture, AddBranch(in_plain_lung(), even_without_evidence=True))
    drawn = next(b for b in document(lung_fixture).airways.tree.branches if b.kind == "manual")
    lung_fixture.session.do(ChooseRoute(branch_id=drawn.id))
    route = document(lung_fixture).route
    assert route.drawn.drawn_mm == pytest.approx(drawn.length_mm, rel=0.1)
    assert route.drawn.words.endswith("mm drawn by hand")


def test_preview_of_an_edit_equals_the_edit(lung_fixture):
    preview = lung_fixture.session.ask(PreviewOf(AddBranch(in_plain_lung())))
    assert not preview.has_evidence
    edit(lung_fixture, AddBranch(in_plain_lung()))
    (question,) = lung_fixture.of_type(EvidenceMissing)
    (line,) = preview.lines
    assert line.points_lps.tobytes() == question.error.way_lps.tobytes()
    lung_fixture.session.do(CloseCase())
    with pytest.raises(UsageError):
        lung_fixture.session.ask(PreviewOf(AddBranch(in_plain_lung())))


def test_bridge_without_an_airway_beyond_its_end_is_refused_and_confirmation_is_not_offered():
    doubt = NoEvidenceError(
        "the CT shows too little airway wall beyond the bridge",
        doubtful_mm=9.0,
        way_lps=np.zeros((2, 3)),
        doubtful=np.ones(1, dtype=bool),
    )

    def refuse(*_arguments, **_options):
        raise doubt

    fixture = session_fixture(
        open_volume=lambda _path, _progress, _cancel: open_ended_volume(),
        find_airways=lambda _volume, **_options: edit_case().airways,
        edit_airways=refuse,
    )
    fixture.open()
    edit(fixture, Bridge(in_plain_lung()))
    assert fixture.of_type(EvidenceMissing) == []
    assert [(error.code, error.message) for error in fixture.of_type(ErrorEvent)] == [(doubt.code, str(doubt))]


def test_target_at_the_new_root_stays_in_the_list_and_states_why_it_has_no_path(fixture, case):
    there = MoveRoot(point(case.airways.tree.branch(5).points[-2]))
    tracker = edit_airways(case.volume, case.airways, there).tracker
    place = point(case.volume.to_lps(np.array(tracker.root_ijk, dtype=float)))
    fixture.session.do(AddTarget(place))
    fixture.background.run_all()
    assert document(fixture).targets[0].route is not None
    edit(fixture, there)
    assert len(document(fixture).airways.edits) == 1
    (target,) = document(fixture).targets
    assert (target.lps, target.route) == (place, None)
    assert "lies at the tracheal entry" in target.problem
