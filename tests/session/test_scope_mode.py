"""Tests of scope mode: keys and a handle drive a scope in the lumen, with wall contact and exact replay."""

from __future__ import annotations

import numpy as np
import pytest

from carina.commands import (
    Cancel,
    ChooseRoute,
    CurrentMoment,
    GoTo,
    LevelHorizon,
    OpenVolume,
    RecordFlight,
    SetMode,
    SetOperator,
    SetRoot,
    SetScope,
    Steer,
    StopRecording,
    ToggleMode,
)
from carina.errors import NoResultError
from carina.navigate import HandleSample, open_recording
from carina.render.picture_text import letters_of
from carina.scopes import WallField
from carina.session import JobEnded
from small_case import SHAPE_ZYX, session_fixture, small_airways

RADIUS_MM = 5.0


def wall_field(volume, airways, *, progress, cancel):
    """Return a wall field of round tubes about the centrelines of the tree, computed by simple geometry."""
    progress("measuring", 0.5)
    nz, ny, nx = SHAPE_ZYX
    k, j, i = np.mgrid[0:nz, 0:ny, 0:nx]
    grid = np.stack([i, j, k], axis=-1).reshape(-1, 3) @ volume.lps_from_ijk[:3, :3].T + volume.lps_from_ijk[:3, 3]
    away = np.full(len(grid), np.inf)
    for branch in airways.tree.branches:
        a, b = branch.points[0], branch.points[-1]
        along = np.clip(((grid - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
        away = np.minimum(away, np.linalg.norm(grid - a - along[:, None] * (b - a), axis=1))
    return WallField.from_distances((RADIUS_MM - away).reshape(SHAPE_ZYX).astype(np.float32), volume.lps_from_ijk)


@pytest.fixture
def fixture():
    made = session_fixture(wall_field=wall_field)
    made.open()
    made.session.do(SetScope("ultrathin"))
    yield made
    made.session.close()


def enter(fixture) -> None:
    fixture.session.do(SetMode("scope"))
    fixture.background.run_all()
    assert fixture.session.snapshot().mode == "scope"


def test_scope_mode_starts_at_the_tip_and_keys_drive_its_three_controls(fixture):
    session = fixture.session
    session.do(GoTo(20.0))
    before = session.pose_info().pose
    enter(fixture)
    info = session.pose_info()
    assert info.scope is not None
    assert info.scope.insertion_mm == pytest.approx(20.0, abs=0.5)
    assert np.linalg.norm(info.pose.position_lps - before.position_lps) < 2.0
    session.do(Steer(3.0, 0.0, 0.0, 0.0))
    assert session.pose_info().scope.insertion_mm == pytest.approx(23.0, abs=0.5)
    forward = session.pose_info().pose.forward_lps
    session.do(Steer(0.0, 0.0, 0.4, 0.0))
    state = session.pose_info().scope
    assert state.flexion_rad == pytest.approx(0.4)
    assert session.pose_info().pose.forward_lps[1] < forward[1], "up is anterior"
    session.do(Steer(0.0, 0.0, 0.0, 0.3))
    assert session.pose_info().scope.roll_rad == pytest.approx(state.roll_rad + 0.3)
    session.do(Steer(0.0, 0.2, 0.0, 0.0))
    assert session.pose_info().scope.roll_rad == pytest.approx(state.roll_rad + 0.5), "sideways is a roll"


def test_tip_in_scope_mode_stays_inside_the_lumen_and_wall_contacts_are_counted(fixture):
    session = fixture.session
    session.do(GoTo(15.0))
    enter(fixture)
    session.do(Steer(0.0, 0.0, 1.5, 0.0))
    for _ in range(60):
        fixture.clock.advance(0.05)
        session.do(Steer(1.0, 0.0, 0.0, 0.0))
    info = session.pose_info()
    assert info.scope.record.count >= 1
    assert info.scope.record.time_s > 0.1
    assert info.scope.contact is not None or info.scope.limit != "none"
    wall = fixture.session._core.case.pilot.wall
    # The flat face of the tip may be on the wall, so that the middle of the tip is at the wall.
    assert wall.distance_mm([info.pose.position_lps])[0] > -0.1


def test_scope_too_thick_for_the_airway_reports_the_diameter_that_would_pass(fixture):
    session = fixture.session
    session.do(SetScope("therapeutic"))
    session.do(GoTo(5.0))
    enter(fixture)
    for _ in range(120):
        session.do(Steer(1.0, 0.0, 0.0, 0.0))
    state = session.pose_info().scope
    assert state.limit == "narrow"
    assert 0.0 < state.passable_mm < session.pose_info().scope_tip_mm


def test_scope_handle_sets_insertion_directly_and_its_lever_sets_the_flexion(fixture):
    session = fixture.session
    session.do(GoTo(15.0))
    enter(fixture)
    insertion = session.pose_info().scope.insertion_mm
    for n in range(40):
        fixture.clock.advance(0.01)
        session.devices.receive_sample("handle", HandleSample(n * 0.01, 100.0 + 0.1 * n, 0.0, 0.25))
        session.devices.frame()
    state = session.pose_info().scope
    assert state.insertion_mm == pytest.approx(insertion + 3.9, abs=0.5)
    assert state.flexion_rad > 0.5


def test_scope_mode_continues_after_a_change_of_scope_and_ends_with_another_mode(fixture):
    session = fixture.session
    session.do(GoTo(20.0))
    enter(fixture)
    session.do(SetScope("standard"))
    assert session.snapshot().mode == "scope"
    assert session.pose_info().scope_tip_mm == pytest.approx(4.9)
    pose = session.pose_info().pose
    session.do(SetMode("free"))
    np.testing.assert_array_equal(session.pose_info().pose.lps_from_camera, pose.lps_from_camera)
    enter(fixture)
    session.do(ToggleMode())
    assert session.snapshot().mode == "path"


def letters(matrix) -> tuple[str, str]:
    """Return the orientation letters at the right and at the top edge of the picture."""
    return letters_of(matrix[:3, 0])[0], letters_of(-matrix[:3, 1])[0]


@pytest.mark.parametrize("scope", ["ultrathin", "ebus"])
def test_picture_for_an_operator_facing_the_patient_is_rotated_and_the_simulated_scope_is_not(fixture, scope):
    session = fixture.session
    session.do(SetScope(scope))
    session.do(GoTo(20.0))
    enter(fixture)
    straight = session.pose_info().pose.lps_from_camera
    session.do(Steer(0.0, 0.0, 0.5, 0.3))
    before = session.pose_info()
    looked = session.scene().spec("airway", 32, 32, 1.0).pose.lps_from_camera
    session.do(SetOperator("facing"))
    after = session.pose_info()
    tip, turned = before.pose.lps_from_camera, after.pose.lps_from_camera
    np.testing.assert_array_equal(turned[:3, 2:], tip[:3, 2:], "place and direction")
    np.testing.assert_array_equal(turned[:3, :2], -tip[:3, :2])
    held, turned_held = before.scope, after.scope
    for name in ("insertion_mm", "roll_rad", "flexion_rad", "contact", "red_out", "limit", "record"):
        assert getattr(turned_held, name) == getattr(held, name), name
    # The lens, which may look up, is part of the instrument, so it shows the same scene upside down.
    seen = session.scene().spec("airway", 32, 32, 1.0).pose.lps_from_camera
    np.testing.assert_allclose(seen[:3, 2:], looked[:3, 2:], atol=1e-12)
    np.testing.assert_allclose(seen[:3, :2], -looked[:3, :2], atol=1e-12)
    # The scope, steered up, moves towards the top of the picture.
    session.do(Steer(0.0, 0.0, 0.2, 0.0))
    raised = session.pose_info()
    assert raised.scope.flexion_rad == pytest.approx(held.flexion_rad - 0.2)
    # The wall prevents a part of the 11 degrees.
    assert raised.pose.forward_lps @ -turned[:3, 1] > 0.02
    session.do(Steer(0.0, 0.0, -0.2, 0.0))
    before_undo = session.pose_info().pose.lps_from_camera
    session.undo()
    undone = session.pose_info().pose.lps_from_camera
    np.testing.assert_array_equal(undone[:3, 2:], before_undo[:3, 2:])
    np.testing.assert_array_equal(undone[:3, :2], -before_undo[:3, :2])
    assert letters(straight)[1] == "A"


def test_scope_mode_starts_with_an_equal_scope_pose_for_both_operator_positions(fixture):
    session = fixture.session
    seen = {}
    for operator in ("head", "facing"):
        session.do(SetMode("free"))
        session.do(SetOperator(operator))
        session.do(GoTo(20.0))
        enter(fixture)
        seen[operator] = session.pose_info()
    head, facing = (seen[operator].pose.lps_from_camera for operator in ("head", "facing"))
    np.testing.assert_array_equal(facing[:3, 2:], head[:3, 2:])
    np.testing.assert_array_equal(facing[:3, :2], -head[:3, :2])
    assert seen["facing"].scope.roll_rad == seen["head"].scope.roll_rad == 0.0
    # For an operator at the head, the patient's right is on the right and anterior is on top; for a facing operator
    # both are opposite.
    assert letters(head) == ("R", "A")
    assert letters(facing) == ("L", "P")
    session.do(LevelHorizon())
    np.testing.assert_allclose(session.pose_info().pose.lps_from_camera, facing, atol=1e-6)
    session.do(SetMode("free"))
    np.testing.assert_allclose(session.pose_info().pose.lps_from_camera, facing, atol=1e-6)


def wanted_wall(session) -> str:
    """Request the wall of the present airways, and return the state of its computation."""
    case = session._core.case
    with session._core.lock:
        case.wall.want(case.document.airways)
        return case.wall.standing(case.document.airways)


def test_wall_field_is_computed_again_when_its_airways_are_restored_by_undo(fixture):
    session = fixture.session
    session.do(SetRoot(tuple(float(v) for v in session.snapshot().document.airways.root_lps)))
    fixture.background.run_all()
    assert wanted_wall(session) == "making"
    session.undo()
    # The wall of the other airways is requested; the job for it replaces the first job.
    assert wanted_wall(session) == "making"
    fixture.background.run_all()
    assert wanted_wall(session) == "had"
    session.redo()
    assert wanted_wall(session) == "making"
    fixture.background.run_all()
    assert wanted_wall(session) == "had"


@pytest.mark.parametrize("begun", [False, True])
def test_wall_field_is_computed_once_if_its_airways_are_undone_and_redone_during_the_job(begun):
    """One job computes the wall of the newest airways, whether it has begun or waits.

    A stale computation is cancelled.
    """
    measured, steps = [], []

    def measure(volume, airways, **options):
        measured.append(airways)
        while steps:
            steps.pop(0)()
            assert wanted_wall(fixture.session) == "making"
        return wall_field(volume, airways, **options)

    fixture = session_fixture(wall_field=measure)
    fixture.open()
    session = fixture.session
    session.do(SetRoot(tuple(float(v) for v in session.snapshot().document.airways.root_lps)))
    fixture.background.run_all()
    newest = session.snapshot().document.airways
    assert wanted_wall(session) == "making"
    (job,) = session.jobs.running
    for step in (session.undo, session.redo):
        if begun:
            steps.append(step)
        else:
            step()
            assert wanted_wall(session) == "making"
    fixture.events.clear()
    fixture.background.run_all()
    assert wanted_wall(session) == "had"
    assert [airways is newest for airways in measured] == [True]
    ends = [(e.job_id, e.outcome) for e in fixture.of_type(JobEnded) if e.title == job.title]
    assert ends == [(job.job_id, "done")]
    session.close()


def test_wall_field_whose_job_the_user_stopped_is_computed_only_on_request(fixture):
    session = fixture.session
    assert wanted_wall(session) == "making"
    (job,) = session.jobs.running
    session.do(Cancel(job.job_id))
    fixture.background.run_all()
    assert wanted_wall(session) == "stopped"
    session._core.case.wall.again()
    assert wanted_wall(session) == "making"


def test_scope_mode_without_a_route_is_refused(fixture):
    fixture.session.do(ChooseRoute())
    with pytest.raises(NoResultError, match="a scope needs a route"):
        fixture.session.do(SetMode("scope"))


def test_recording_in_scope_mode_replays_bit_for_bit(fixture, tmp_path):
    session = fixture.session
    session.do(GoTo(12.0))
    enter(fixture)
    session.do(Steer(4.0, 0.0, 0.6, 0.2))
    session.do(RecordFlight(tmp_path / "s.jsonl"))
    rng = np.random.default_rng(5)
    for n in range(80):
        fixture.clock.advance(0.02)
        session.do(Steer(float(rng.uniform(-0.3, 1.0)), 0.0, float(rng.normal(0, 0.1)), float(rng.normal(0, 0.1))))
        session.devices.receive_sample("handle", HandleSample(0.02 * n, 0.05 * n, 0.01 * n, float(np.sin(n / 9.0))))
        session.devices.frame()
        if n in {20, 50, 60}:
            session.do(SetOperator("facing" if n != 50 else "head"))
    session.do(SetScope("single-use-slim"))
    session.do(Steer(1.0, 0.0, 0.0, 0.0))
    session.do(StopRecording())
    recording = open_recording(tmp_path / "s.jsonl")
    assert recording.needs_wall
    volume = session.snapshot().case.volume
    # The wall is computed again, as when a recording is opened on another day.
    wall = wall_field(volume, small_airways(volume), progress=lambda *_: None, cancel=lambda: False)
    replayed = list(recording.replay(volume, wall=wall))
    assert len(replayed) > 60
    assert {moment.picture_turned for moment, _ in replayed} == {False, True}
    assert all(same for _, same in replayed)


@pytest.mark.parametrize("mode", ["free", "path"])
def test_airway_view_is_unchanged_when_scope_mode_ends_with_an_operator_facing_the_patient(fixture, mode):
    session = fixture.session
    session.do(SetScope("ebus"))
    session.do(SetOperator("facing"))
    session.do(GoTo(20.0))
    enter(fixture)
    held = session.scene().spec("airway", 32, 32, 1.0).pose.lps_from_camera
    session.do(SetMode(mode))
    np.testing.assert_allclose(session.scene().spec("airway", 32, 32, 1.0).pose.lps_from_camera, held, atol=1e-9)


def test_recording_in_scope_mode_stores_the_inputs_of_its_wall_field(fixture, tmp_path):
    session = fixture.session
    session.do(GoTo(12.0))
    enter(fixture)
    session.do(RecordFlight(tmp_path / "w.jsonl"))
    session.do(Steer(2.0, 0.0, 0.3, 0.1))
    session.do(StopRecording())
    recording = open_recording(tmp_path / "w.jsonl")
    volume = session.snapshot().case.volume
    calls = []

    def made(stored):
        calls.append(stored)
        return wall_field(volume, small_airways(volume), progress=lambda *_: None, cancel=lambda: False)

    replayed = list(recording.replay(volume, wall=made))
    assert len(calls) == 1
    assert calls[0]["digest"] == made(calls[0]).digest()
    assert calls[0]["edits"] is None
    assert all(same for _, same in replayed)


def test_scope_contact_of_a_reopened_case_is_restored_when_its_wall_field_is_computed(fixture):
    enter(fixture)
    fixture.session.do(Steer(3.0, 0.0, 0.2, 0.1))
    stored = fixture.session.ask(CurrentMoment())
    again = session_fixture(wall_field=wall_field)
    again.session.do(OpenVolume(fixture.session.snapshot().case.volume, stored))
    again.background.run_next()
    assert again.session.snapshot().mode != "scope"
    assert again.background.waiting, "the wall is not known"
    assert again.session.ask(CurrentMoment()).scope == stored.scope
    again.background.run_all()
    assert again.session.snapshot().mode == "scope"
    assert again.session.ask(CurrentMoment()).scope == stored.scope
    again.session.close()


def test_scope_contact_is_not_restored_if_the_tip_moves_before_the_wall_field_is_computed(fixture):
    enter(fixture)
    stored = fixture.session.ask(CurrentMoment())
    again = session_fixture(wall_field=wall_field)
    again.session.do(OpenVolume(fixture.session.snapshot().case.volume, stored))
    again.background.run_next()
    again.session.do(GoTo(5.0))
    assert again.session.ask(CurrentMoment()).scope is None
    again.background.run_all()
    assert again.session.snapshot().mode != "scope"
    again.session.close()
