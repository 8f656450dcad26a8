"""Tests of tasks in a session: start, progress, end, scores, and the ends that do not count."""

from __future__ import annotations

import dataclasses
import gc
import threading
from types import SimpleNamespace

import numpy as np
import pytest

import carina
from cached_test_data import masked_chest
from carina.commands import (
    AnswerQuiz,
    NextQuestion,
    PauseTask,
    RecordFlight,
    RepeatQuestion,
    ScoreFlight,
    ScoreOf,
    SetOperator,
    StartQuiz,
    StartTask,
    Steer,
    StopQuiz,
    StopRecording,
    StopTask,
)
from carina.errors import NoResultError, UsageError
from carina.navigate import HandleSample, open_recording
from carina.scopes import scope_preset
from carina.session.open_case.open_case import OpenCase
from carina.session.training import attempts
from carina.session.training.attempts import TrainingHandlers, entry_way
from carina.session.training.live_attempt import LiveAttempt
from carina.training import FlightEvent, find_task
from carina.training.flight_frames import FlightOptics
from training_workstation import Workstation, flights, until


@pytest.fixture(scope="module")
def chest():
    return masked_chest()


@pytest.fixture
def workstation(tmp_path, chest, monkeypatch):
    made = Workstation(tmp_path, chest, monkeypatch)
    yield made
    made.session.close()


def test_task_inserts_the_scope_records_the_flight_and_is_scored_when_the_user_ends_it(workstation):
    workstation.start("inspect-all")
    snapshot = workstation.session.snapshot()
    assert snapshot.mode == "scope"
    assert snapshot.document.look.scope is not None
    running = workstation.info.running
    assert (running.task, running.flight, running.elapsed_s) == ("inspect-all", flights(workstation)[0].number, 0.0)
    workstation.advance_tip(60.0)
    running = workstation.info.running
    assert running.elapsed_s == pytest.approx(3.0)
    assert running.num_steps == 18
    assert running.next_step == "RB1"
    workstation.session.do(StopTask())
    assert workstation.info.running is None
    (flight,) = flights(workstation)
    assert flight.state == "complete"
    assert flight.name == "Visit all segments (structured progress scores the ascending order), attempt 1"
    (score,) = workstation.scored()
    assert (score.flight, score.task, score.doubts) == (flight.number, "inspect-all", ())
    assert score.published.time_s == pytest.approx(3.0, abs=0.11)
    assert score.unmarked.path_mm == pytest.approx(60.0, abs=3.0)
    assert len(score.seen) + len(score.not_seen) == 18
    assert score.unmarked.num_contacts == 0, "the scope is inserted in the middle of the trachea"
    assert workstation.info.verdict.startswith("no verdict: it needs 6 attempts that count")


def test_score_in_the_window_equals_the_score_of_the_recording(workstation, chest, tmp_path):
    workstation.start("find-rb6")
    workstation.advance_tip(40.0)
    workstation.session.do(StopTask())
    path = tmp_path / "flight.jsonl"
    path.write_text(workstation.text_of(flights(workstation)[0].number), encoding="utf-8")
    volume, airways, wall = chest
    again = carina.score_recording(volume, airways, path, wall=wall)
    (shown,) = workstation.scored()
    assert again.task.name == "find-rb6", "the recording states its task"
    assert shown.published.time_s == again.procedure_time_s
    assert shown.unmarked.path_mm == again.path_length_mm
    assert shown.unmarked.middle_share == again.lumen_in_middle
    assert shown.seen == again.segments_seen
    assert workstation.session.ask(ScoreOf(shown.flight)).to_json() == again.to_json()


def test_task_ends_at_its_time_limit(workstation, monkeypatch):
    limited = dataclasses.replace(find_task("find-rb6"), time_limit_s=2.0)
    monkeypatch.setattr("carina.session.training.attempts.find_task", lambda _name: limited)
    workstation.start("find-rb6")
    assert workstation.follow(1.9)
    assert not workstation.follow(1.5)
    (score,) = workstation.scored()
    assert score.published.time_s == pytest.approx(2.0, abs=0.11)
    assert (score.completed, score.doubts) == (False, ())


def test_pause_stops_clock_and_tip_and_the_attempt_does_not_count(workstation, chest, tmp_path):
    session = workstation.session
    workstation.start("inspect-all")
    session.devices.receive_sample("handle", HandleSample(0.5, 0.0, 0.0, 0.0))
    session.devices.frame()
    workstation.advance_tip(20.0)
    session.do(PauseTask(True))
    before = session.pose_info().pose
    session.do(Steer(5.0, 0.0, 0.0, 0.0))
    session.devices.receive_sample("handle", HandleSample(1.0, 30.0, 0.0, 0.0))
    session.devices.frame()
    assert workstation.follow(30.0)
    running = workstation.info.running
    assert (running.paused, running.elapsed_s) == (True, 1.0)
    assert session.pose_info().pose is before
    session.do(PauseTask(False))
    # The first sample after the pause is the new origin of the handle.
    session.devices.receive_sample("handle", HandleSample(32.0, 40.0, 0.0, 0.0))
    session.devices.frame()
    assert np.array_equal(session.pose_info().pose.position_lps, before.position_lps)
    workstation.advance_tip(20.0)
    assert workstation.info.running.elapsed_s == pytest.approx(2.0)
    session.do(StopTask())
    (score,) = workstation.scored()
    assert score.published.time_s == pytest.approx(2.0, abs=0.11)
    assert score.unmarked.path_mm == pytest.approx(40.0, abs=3.0)
    assert score.doubts == ("the attempt was paused once, for 30 s in total",)
    # The recording has the same times, and a replay passes the pause without a jump.
    path = tmp_path / "flight.jsonl"
    path.write_text(workstation.text_of(score.flight), encoding="utf-8")
    recording = open_recording(path)
    assert recording.pauses == ((pytest.approx(1.0), pytest.approx(30.0)),)
    assert recording.length_s == pytest.approx(2.0, abs=0.01)
    assert all(same for _, same in recording.replay(chest[0], wall=chest[2]))


def test_attempt_that_is_ended_during_a_pause_releases_the_tip(workstation):
    workstation.start("inspect-all")
    workstation.advance_tip(10.0)
    workstation.session.do(PauseTask(True))
    workstation.clock.advance(5.0)
    workstation.session.do(StopTask())
    (score,) = workstation.scored()
    assert score.doubts == ("the attempt was paused once, for 5 s in total",)
    before = workstation.session.pose_info().pose
    workstation.session.do(Steer(2.0, 0.0, 0.0, 0.0))
    assert workstation.session.pose_info().pose is not before


def test_task_is_refused_during_a_recording_and_in_an_unsuitable_case(workstation, monkeypatch):
    workstation.session.do(RecordFlight())
    with pytest.raises(UsageError, match="a recording is running; stop it first"):
        workstation.session.do(StartTask("inspect-all"))
    workstation.session.do(StopRecording())
    with pytest.raises(UsageError, match=r"task: expected one of ebus-landmarks"):
        workstation.session.do(StartTask("no-such-task"))
    other = dataclasses.replace(find_task("hold-rul"), structure="No such branch")
    monkeypatch.setattr("carina.session.training.attempts.find_task", lambda _name: other)
    with pytest.raises(NoResultError, match="No such branch"):
        workstation.session.do(StartTask("hold-rul"))
    assert workstation.info.running is None


def test_recorded_flight_without_a_task_is_scored_as_an_inspection_or_by_the_named_task(workstation):
    workstation.session.do(RecordFlight())
    workstation.clock.advance(1.0)
    workstation.session.do(Steer(1.0, 0.0, 0.0, 0.0))
    workstation.session.do(StopRecording())
    number = flights(workstation)[0].number
    workstation.session.do(ScoreFlight(number))
    assert [one.task for one in workstation.scored()] == ["inspect-all"]
    workstation.session.do(ScoreFlight(number, task="find-lb6"))
    until(lambda: [one.task for one in workstation.info.scores] == ["find-lb6"])


def test_attempts_of_one_task_are_numbered(workstation):
    for _ in range(2):
        workstation.start("find-lb6")
        workstation.follow(0.3)
        workstation.session.do(StopTask())
        until(lambda: workstation.info.running is None)
    assert [one.name for one in flights(workstation)] == ["Find LB6, attempt 1", "Find LB6, attempt 2"]


def test_attempt_ends_when_the_case_is_closed(workstation):
    workstation.start("find-lb6")
    workstation.follow(0.3)
    workstation.close_case()
    assert not workstation.follow(0.1)
    assert workstation.info == type(workstation.info)()


def test_closed_case_of_an_attempt_and_of_a_quiz_is_released(workstation):
    workstation.session.do(StartQuiz("name-opening", num=2))
    until(lambda: workstation.info.quiz is not None)
    workstation.start("find-lb6")
    workstation.follow(0.3)
    _, (case, _) = workstation.attempts.pop()
    # Other tests of this process may hold cases of their own.
    number = id(case)
    del case
    workstation.close_case()

    def is_released() -> bool:
        gc.collect()
        return not any(isinstance(one, OpenCase) and id(one) == number for one in gc.get_objects())

    until(is_released)


def test_closing_a_case_stops_the_score_of_an_attempt_that_it_ends(workstation, monkeypatch):
    workstation.start("find-lb6")
    workstation.follow(0.3)
    session, begun, go = workstation.session, threading.Event(), threading.Event()
    release = session._saving.release_case

    def score(*_what, **_options):
        begun.set()
        assert go.wait(20.0)
        raise AssertionError("the score of a closed case was computed")

    def release_slowly(*within):
        # The thread that computes the score of the attempt starts while the closing of the case waits for the disk.
        assert not workstation.follow(0.1)
        assert begun.wait(20.0)
        release(*within)

    monkeypatch.setattr(attempts, "read_recording", score)
    monkeypatch.setattr(session._saving, "release_case", release_slowly)
    workstation.close_case()
    running = session.jobs.running
    go.set()
    assert all(job.cancel() for job in running)


def test_score_of_a_long_attempt_is_computed_more_rarely(workstation, monkeypatch):
    workstation.start("inspect-all")
    _, (_, attempt) = workstation.attempts[-1]
    scored_at_s = []

    def slow(_attempt, now_s):
        scored_at_s.append(now_s)
        _attempt.scored_s = now_s
        workstation.clock.advance(2.0)

    monkeypatch.setattr(type(attempt), "update_score", slow)
    workstation.follow(30.0)
    assert np.diff(scored_at_s) == pytest.approx(20.1, abs=0.2)


def test_thread_of_an_attempt_ends_with_the_attempt(tmp_path, chest, monkeypatch):
    watch = TrainingHandlers._watch
    made = Workstation(tmp_path, chest, monkeypatch)
    monkeypatch.setattr(TrainingHandlers, "_watch", watch)
    try:
        made.session.do(StartTask("find-lb6"))
        until(lambda: any(one.name == "carina-attempt" for one in threading.enumerate()))
        made.session.do(StopTask())
        until(lambda: not any(one.name == "carina-attempt" for one in threading.enumerate()))
    finally:
        made.session.close()


def test_way_of_entry_begins_in_the_trachea_and_ends_in_a_main_bronchus(chest):
    tree = chest[1].tree
    way = np.array(entry_way(tree))
    assert np.allclose(way[0], tree.root.points[0])
    assert tree.nearest_branch(way[-1])[0].parent == tree.root.id


def test_quiz_places_the_tip_for_each_question_and_states_the_answer_after_that_of_the_trainee(workstation):
    workstation.session.do(StartQuiz("name-opening", seed=4, num=2))
    until(lambda: workstation.info.quiz is not None)
    first = workstation.info.quiz
    assert (first.number, first.num_questions, first.given, first.answer) == (1, 2, None, None)
    pose = workstation.session.pose_info().pose
    with pytest.raises(UsageError, match="answer this question first"):
        workstation.session.do(NextQuestion())
    with pytest.raises(UsageError, match=r"expected one of .*; found 'RMB'"):
        workstation.session.do(AnswerQuiz("RMB"))
    workstation.session.do(AnswerQuiz(first.choices[0]))
    answered = workstation.info.quiz
    assert answered.given == first.choices[0]
    assert answered.num_right == (answered.given == answered.answer)
    with pytest.raises(UsageError, match="answered already"):
        workstation.session.do(AnswerQuiz(first.choices[1]))
    workstation.session.do(Steer(3.0, 0.0, 0.0, 0.0))
    assert not np.allclose(workstation.session.pose_info().pose.position_lps, pose.position_lps)
    workstation.session.do(RepeatQuestion())
    assert np.array_equal(workstation.session.pose_info().pose.lps_from_camera, pose.lps_from_camera)
    assert np.allclose(np.reshape(answered.lps_from_tip, (4, 4)), pose.lps_from_camera)
    workstation.session.do(NextQuestion())
    second = workstation.info.quiz
    assert (second.number, second.answer, second.is_over) == (2, None, False)
    assert not np.allclose(workstation.session.pose_info().pose.position_lps, pose.position_lps)
    workstation.session.do(AnswerQuiz(second.choices[0]))
    assert workstation.info.quiz.is_over
    with pytest.raises(UsageError, match="this was the last question"):
        workstation.session.do(NextQuestion())
    workstation.session.do(StopQuiz())
    assert workstation.info.quiz is None
    with pytest.raises(UsageError, match="no quiz is running"):
        workstation.session.do(AnswerQuiz("RB1"))


def test_quiz_with_slices_places_the_crosshair_and_restores_it(workstation, chest):
    session = workstation.session
    before = session.snapshot().sight
    session.do(StartQuiz("slices", seed=1, num=2))
    until(lambda: workstation.info.quiz is not None)
    sight, quiz = session.snapshot().sight, workstation.info.quiz
    assert sight.crosshair_lps is not None
    assert sight.place("axial").mm_per_px == pytest.approx(0.4)
    assert chest[2].distance_mm(np.array([sight.crosshair_lps]))[0] > 0.0, "the slices meet in the lumen"
    session.do(AnswerQuiz(quiz.choices[0]))
    session.do(NextQuestion())
    assert session.snapshot().sight.crosshair_lps != sight.crosshair_lps
    session.do(StopQuiz())
    after = session.snapshot().sight
    assert (after.crosshair_lps, after.zoom) == (before.crosshair_lps, before.zoom)


def test_clock_hours_of_a_quiz_are_those_of_the_picture_of_an_operator_who_faces_the_patient(workstation):
    session = workstation.session

    def hours(choices):
        return [int(one.split()[0]) for one in choices]

    session.do(StartQuiz("slices", seed=1, num=2))
    until(lambda: workstation.info.quiz is not None)
    head = workstation.info.quiz.choices
    session.do(SetOperator("facing"))
    facing = workstation.info.quiz.choices
    # The picture is turned by 180 degrees.
    assert sorted((hour + 5) % 12 + 1 for hour in hours(head)) == hours(facing)
    pose = session.pose_info().pose
    assert np.allclose(np.reshape(workstation.info.quiz.lps_from_tip, (4, 4)), pose.lps_from_camera)
    session.do(RepeatQuestion())
    assert np.allclose(session.pose_info().pose.lps_from_camera, pose.lps_from_camera), "the picture stays turned"
    with pytest.raises(UsageError, match="expected one of"):
        session.do(AnswerQuiz("no hour"))
    session.do(AnswerQuiz(facing[0]))
    turned = workstation.info.quiz
    assert turned.given == facing[0]
    session.do(SetOperator("head"))
    upright = workstation.info.quiz
    assert hours([upright.answer]) == [(hour + 5) % 12 + 1 for hour in hours([turned.answer])]
    assert (upright.given == upright.answer) == (turned.given == turned.answer) == (turned.num_right == 1)


def test_task_ends_the_quiz(workstation):
    workstation.session.do(StartQuiz("where-are-you"))
    until(lambda: workstation.info.quiz is not None)
    workstation.start("find-lb6")
    assert workstation.info.quiz is None
    workstation.session.do(StopTask())


@pytest.mark.parametrize(
    ("task", "kind", "text"),
    [
        ("inspect-all", "seen", "seen"),
        ("inspect-all", "visit", "visited: RB4"),
        ("find-rb6", "visit", "visited"),
        ("find-rb6", "wrong-segment", "another segment"),
        ("hold-rul", "seen", "seen: RB4"),
        ("turns-to-rb10", "entered", "entered: RB4"),
        ("find-rb6", "contact", "touching the wall at 3 o'clock"),
    ],
)
def test_messages_of_a_task_without_names_name_no_segment_that_the_trainee_must_recognise(chest, task, kind, text):
    _, airways, wall = chest
    pose = carina.FlightPath(entry_way(airways.tree)).pose_at(5.0)
    optics = FlightOptics(scope_preset("generic"), False, 120.0, False)
    attempt = LiveAttempt(find_task(task), airways, wall, optics=optics, flight=1, begun_s=0.0, pose=pose)
    assert attempt._event_words(FlightEvent(1.0, kind, "RB4", "3 o'clock")) == text


def test_event_that_a_slow_machine_scores_late_is_shown_until_the_next_score(workstation):
    workstation.start("inspect-all")
    _, (_, attempt) = workstation.attempts[-1]
    touch = SimpleNamespace(events=(FlightEvent(5.0, "contact", "RMB", "3 o'clock"),))
    # Scores after 1, 4 and 20 s: the touch is reported by the last one, although it is older than 3 s then.
    for at_s in (1.0, 4.0, 20.0):
        attempt.update_score(at_s + attempt.begun_s)
    assert attempt._latest_event(touch, 20.5) == touch.events[0]
    attempt.update_score(21.0 + attempt.begun_s)
    assert attempt._latest_event(touch, 21.0) is None
    assert attempt._latest_event(touch, 7.9) == touch.events[0], "an event is shown for 3 s"
