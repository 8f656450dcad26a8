"""Tests of the simulated breathing in a session: scene, clock, pause, recording, playback and attempts."""

from __future__ import annotations

import io
import threading
from pathlib import Path

import numpy as np
import pytest

import carina
from cached_test_data import MASKED_CHEST, cached_airways, cached_phantom
from carina.breathing import Breathing, ChestFrame
from carina.commands import Cough, FlyFlight, PauseTask, SetBreathing, SetMode, StopTask
from carina.errors import UsageError
from carina.navigate.recording import read_recording
from carina.render import LEAD_VIEW
from carina.session import ChestMoved
from carina.training import FlightScorer, find_task, flight_frames, score_flight
from training_workstation import Workstation, flights, until


@pytest.fixture(scope="module")
def chest():
    volume, airways = cached_phantom(**MASKED_CHEST).volume, cached_airways(**MASKED_CHEST)
    return volume, airways, carina.wall_field(volume, airways, spacing_mm=0.6, progress=False)


@pytest.fixture
def workstation(tmp_path, chest, monkeypatch):
    made = Workstation(tmp_path, chest, monkeypatch)
    yield made
    made.session.close()


def shown(workstation):
    """Return the view of the airway picture, and its key."""
    scene = workstation.session.scene()
    return scene.spec(LEAD_VIEW, 64, 64, 1.0), scene.key(LEAD_VIEW)


def test_breathing_is_off_by_default_and_its_amplitude_0_shows_the_same_view(workstation):
    session = workstation.session
    assert session.snapshot().breathing.on is False
    plain, _ = shown(workstation)
    assert plain.deformation is None
    session.do(SetBreathing(on=True, movement_mm=0.0))
    workstation.clock.advance(1.3)
    still, _ = shown(workstation)
    assert still.deformation.is_rest
    assert still.pose is plain.pose
    assert still.lps_from_rest is None
    assert session.snapshot().breathing.movement_mm == 0.0


def test_picture_moves_with_the_clock_and_slices_stay_at_rest(workstation, chest):
    session, frame = workstation.session, ChestFrame.of_tree(chest[1].tree)
    slices = session.scene().key("axial")
    session.do(SetBreathing(on=True, movement_mm=24.0, period_s=4.0))
    at_rest, first = shown(workstation)
    assert at_rest.lps_from_rest is None
    workstation.clock.advance(2.0)
    moved, second = shown(workstation)
    expected = Breathing.of_movement(24.0, 4.0).at(2.0, frame)
    assert np.allclose(moved.lps_from_rest, expected.lps_from_rest)
    assert np.allclose(moved.pose.position_lps, expected.points(session.pose_info().pose.position_lps)[0])
    assert first != second
    assert session.scene().key("axial") == slices
    assert session.scene().spec("axial", 64, 64, 1.0) is not None
    # Another movement with the same period continues the breath; another period begins at rest.
    session.do(SetBreathing(on=True, movement_mm=12.0, period_s=4.0))
    assert np.allclose(
        shown(workstation)[0].lps_from_rest, Breathing.of_movement(12.0, 4.0).at(2.0, frame).lps_from_rest
    )
    session.do(SetBreathing(on=True, movement_mm=12.0, period_s=5.0))
    assert shown(workstation)[0].lps_from_rest is None
    session.do(SetBreathing(on=False))
    assert shown(workstation)[0].deformation is None


def test_cough_needs_breathing_and_narrows_the_airways_for_half_a_second(workstation):
    session = workstation.session
    with pytest.raises(UsageError, match="switch it on"):
        session.do(Cough())
    session.do(SetBreathing(on=True, movement_mm=0.0))
    workstation.clock.advance(1.0)
    session.do(Cough())
    workstation.clock.advance(0.25)
    assert shown(workstation)[0].lps_from_rest[0, 0] < 0.75
    workstation.clock.advance(0.25)
    assert shown(workstation)[0].lps_from_rest is None


def test_pictures_are_requested_while_the_chest_moves_and_not_during_a_pause(workstation):
    session, moved = workstation.session, []
    session.subscribe(lambda event: moved.append(event) if isinstance(event, ChestMoved) else None)
    session.do(SetBreathing(on=True))
    until(lambda: len(moved) >= 2)
    workstation.start("inspect-all")
    session.do(PauseTask(paused=True))
    num = len(moved)
    assert workstation.follow(0.5)
    key = shown(workstation)[1]
    workstation.clock.advance(1.0)
    assert shown(workstation)[1] == key
    # A report that began before the pause may still arrive.
    assert len(moved) <= num + 1
    session.do(PauseTask(paused=False))
    until(lambda: len(moved) >= num + 2)
    assert moved[-1].moves_scope
    session.do(SetBreathing(on=False))


def test_attempt_breathes_on_its_own_clock_and_the_recording_scores_the_same(workstation, chest):
    session = workstation.session
    session.do(SetBreathing(on=True, movement_mm=18.0, period_s=4.0))
    workstation.clock.advance(1.7)
    workstation.start("find-rb6")
    assert shown(workstation)[0].lps_from_rest is None, "each attempt begins at rest"
    workstation.advance_tip(20.0)
    session.do(PauseTask(paused=True))
    before = shown(workstation)[0].lps_from_rest
    workstation.follow(2.0)
    assert np.array_equal(shown(workstation)[0].lps_from_rest, before)
    session.do(PauseTask(paused=False))
    session.do(Cough())
    workstation.advance_tip(20.0)
    live = shown(workstation)[0].lps_from_rest
    _, (_, attempt) = workstation.attempts[-1]
    attempt.update_score(workstation.clock())
    frames = attempt.score.frames
    session.do(StopTask())
    workstation.scored()
    recording = read_recording(io.StringIO(workstation.text_of(flights(workstation)[0].number)), Path("flight"))
    (_, first), (cough_s, second) = recording.motions
    assert (first.began_s, first.breathing.craniocaudal_mm) == (0.0, 18.0)
    assert second.breathing.coughs_s == pytest.approx((cough_s,))
    assert np.allclose(second.at(recording.length_s).lps_from_rest, live, atol=1e-6)
    _, airways, wall = chest
    again = flight_frames(recording)
    for n in range(len(frames.lps_from_tip)):
        one, other = frames.deformation(n), again.deformation(n)
        assert (one is None) == (other is None)
        assert one is None or np.allclose(one.lps_from_rest, other.lps_from_rest, atol=1e-6)
    scored = score_flight(airways.tree, wall, again, find_task("find-rb6"))
    (score,) = workstation.info.scores
    assert score.unmarked.middle_share == scored.lumen_in_middle
    assert any("simulated breathing, 18 mm every 4 s" in note for note in score.notes)
    # The frames of a growing flight are scored once; all at once they have the same score.
    scorer = FlightScorer(airways.tree, wall, find_task("find-rb6"))
    assert scorer.score(again).to_json() == scored.to_json()


@pytest.mark.parametrize("during", [False, True])
def test_breathing_ends_with_the_task_and_the_next_attempt_is_without_it(workstation, during):
    session = workstation.session
    moved = []
    session.subscribe(lambda event: moved.append(event) if isinstance(event, ChestMoved) else None)
    if not during:
        session.do(SetBreathing(on=True, movement_mm=18.0, period_s=4.0))
    workstation.start("find-rb6")
    if during:
        session.do(SetBreathing(on=True, movement_mm=18.0, period_s=4.0))
    workstation.advance_tip(20.0)
    assert session.snapshot().breathing.on
    session.do(StopTask())
    breathing = session.snapshot().breathing
    assert (breathing.on, breathing.movement_mm, breathing.period_s) == (False, 18.0, 4.0)
    assert shown(workstation)[0].lps_from_rest is None
    until(lambda: all(thread.name != "carina-breathing" for thread in threading.enumerate()))
    number = len(moved)
    workstation.scored()
    assert len(moved) == number
    session.do(SetBreathing(on=True, movement_mm=18.0, period_s=4.0))
    assert session.snapshot().breathing.on, "the switch of the live flight works without a task"
    session.do(SetBreathing(on=False))


def test_replayed_flight_shows_its_own_breathing(workstation):
    session = workstation.session
    session.do(SetBreathing(on=True, movement_mm=18.0, period_s=4.0))
    workstation.start("find-rb6")
    workstation.advance_tip(20.0)
    session.do(StopTask())
    workstation.scored()
    session.do(SetBreathing(on=False))
    session.do(SetMode("free"))
    number = flights(workstation)[0].number
    workstation.text_of(number)
    session.do(FlyFlight(number, 0.9))
    until(lambda: session.scene().deformation is not None)
    expected = Breathing.of_movement(18.0, 4.0).expiration(0.9)
    assert 0.0 < expected < 1.0
    matrix = session.scene().deformation.lps_from_rest
    session.do(FlyFlight(number, 0.0))
    assert session.scene().deformation.is_rest
    assert matrix[2, 2] == pytest.approx(
        1.0 - 18.0 * expected / (matrix[2, 3] / (1.0 - matrix[2, 2]) - _base(workstation))
    )


def _base(workstation) -> float:
    """Return the height of the lowest airways."""
    tree = workstation.session.snapshot().document.airways.tree
    return ChestFrame.of_tree(tree).base_z_mm
