"""Tests of the course in a session: choice of a learner, stored attempts, full disk, deletion."""

from __future__ import annotations

import json
import threading

import pytest

from cached_test_data import masked_chest
from carina.commands import (
    AddLearner,
    ChooseLearner,
    ClassroomOf,
    CloseCase,
    CompareFlight,
    LearnerFiles,
    MarkExpert,
    OpenRecent,
    PauseTask,
    ReadTrainingFiles,
    RemoveFlight,
    RemoveLearner,
    StopTask,
)
from carina.errors import DiskError, NoResultError, UsageError
from carina.server.windows.broadcast_cache import SharedTexts
from carina.server.wire import messages as wire
from carina.session import ErrorEvent
from carina.training import Course, Learner, running_tasks
from carina.training.running_tasks import RunningTasks
from training_workstation import Workstation, flights, until


@pytest.fixture(scope="module")
def chest():
    return masked_chest()


@pytest.fixture
def workstation(tmp_path, chest, monkeypatch):
    made = Workstation(tmp_path, chest, monkeypatch, course=Course(tmp_path / "learners"))
    yield made
    made.session.close()


def experts(workstation):
    return [one.number for one in flights(workstation) if one.is_expert]


def fly(workstation, *, paused=False, task="inspect-all"):
    """Fly an attempt, and return once it is scored."""
    num = len(workstation.info.scores)
    workstation.start(task)
    workstation.advance_tip(20.0 + 2.0 * num)
    if paused:
        workstation.session.do(PauseTask(True))
    workstation.session.do(StopTask())
    workstation.scored(num + 1)


def test_attempts_of_the_chosen_learner_are_stored(workstation):
    session = workstation.session
    fly(workstation)
    session.do(AddLearner("Blue heron"))
    assert workstation.info.course.chosen == "Blue heron"
    fly(workstation)
    fly(workstation, paused=True)
    course = workstation.info.course
    assert [(one.number, one.task, one.counts) for one in course.attempts] == [
        (1, "inspect-all", False),
        (2, "inspect-all", False),
    ]
    assert course.attempts[0].reasons == ("no segment was seen",)
    assert course.attempts[1].reasons[0] == "the attempt was paused once, for 0 s in total"
    assert [(one.name, one.num_attempts, one.num_counted) for one in course.learners] == [("Blue heron", 2, 0)]
    session.do(ChooseLearner(None))
    fly(workstation)
    assert [one.num_attempts for one in workstation.info.course.learners] == [2]
    assert sorted(session.ask(LearnerFiles("blue heron"))) == ["attempts.csv", "xapi.json"]


def test_attempt_belongs_to_the_learner_who_began_it(workstation):
    workstation.session.do(AddLearner("one"))
    workstation.start("inspect-all")
    workstation.session.do(AddLearner("two"))
    workstation.advance_tip(20.0)
    workstation.session.do(StopTask())
    workstation.scored(1)
    assert {one.name: one.num_attempts for one in workstation.info.course.learners} == {"one": 1, "two": 0}


def test_paused_attempt_at_a_task_states_why_it_does_not_count(workstation):
    workstation.session.do(AddLearner("one"))
    fly(workstation, paused=True, task="find-rb6")
    (attempt,) = workstation.info.course.attempts
    assert not attempt.is_inspection
    assert attempt.reasons == ("the attempt was paused once, for 0 s in total",)


def test_score_that_cannot_be_stored_is_stored_with_the_next_one(workstation, monkeypatch):
    errors = []
    workstation.session.subscribe(lambda event: errors.append(event) if isinstance(event, ErrorEvent) else None)
    workstation.session.do(AddLearner("one"))
    record = Course.record

    def full(*_what):
        raise DiskError("the disk is full", code="disk.full")

    monkeypatch.setattr(Course, "record", full)
    fly(workstation)
    assert "1 scores are not stored yet" in workstation.info.course.problems[0]
    assert any("the score of one was not stored: the disk is full" in one.message for one in errors)
    monkeypatch.setattr(Course, "record", record)
    fly(workstation)
    assert workstation.info.course.problems == ()
    assert len(workstation.info.course.attempts) == 2


def test_deleted_learner_is_not_chosen_any_more(workstation):
    workstation.session.do(AddLearner("one"))
    workstation.session.do(RemoveLearner("one"))
    assert (workstation.info.course.learners, workstation.info.course.chosen) == ((), None)
    with pytest.raises(UsageError, match="learner: expected one of none; found 'one'"):
        workstation.session.do(ChooseLearner("one"))


def test_flight_is_compared_with_the_flight_that_is_marked_as_the_experts(workstation):
    session = workstation.session
    for _ in range(2):
        fly(workstation)
    first, second = (one.number for one in flights(workstation))
    with pytest.raises(NoResultError, match="no flight is marked as the expert's, and no simulated drive exists"):
        session.do(CompareFlight(second))
    session.do(MarkExpert(first))
    assert experts(workstation) == [first]
    with pytest.raises(UsageError, match="this flight is the expert's"):
        session.do(CompareFlight(first))
    session.do(CompareFlight(second))
    until(lambda: workstation.info.scores[1].comparison)
    assert workstation.info.scores[1].comparison[0].startswith("time: 1 s, expert 1 s")
    assert workstation.info.scores[1].comparison_moments == ()
    session.do(MarkExpert(second))
    assert workstation.info.scores[1].comparison == (), "the comparison was with another flight"
    session.do(RemoveFlight(second))
    assert experts(workstation) == []
    with pytest.raises(UsageError):
        session.do(MarkExpert(second))


def test_mark_of_the_experts_flight_is_stored_with_the_case(workstation):
    session = workstation.session
    fly(workstation)
    number = flights(workstation)[0].number
    session.do(MarkExpert(number))
    session.do(CloseCase())
    (entry,) = session.cases.listed()
    session.do(OpenRecent(entry.recent_id))
    until(lambda: experts(workstation) == [number])


# ------------------------------------------------------------ the teacher's view


def teacher_reads(folder, wanted):
    """Return a condition: a teacher on another machine, who uses the same folder, reads a wanted text."""
    teacher = RunningTasks(folder)
    return lambda: any(wanted in text for text in teacher.read().values())


def test_teacher_reads_a_running_task_also_during_a_pause_and_not_after_its_end(workstation, tmp_path, monkeypatch):
    monkeypatch.setattr(running_tasks, "WRITE_AGAIN_S", 0.02)
    session, folder = workstation.session, tmp_path / "learners"
    session.do(AddLearner("one"))
    workstation.start("find-rb6")
    workstation.advance_tip(40.0)
    until(teacher_reads(folder, "Find RB6: 0 of 1 steps, "))
    session.do(PauseTask(True))
    # The attempt is not followed meanwhile: the file changes nevertheless, so that the learner remains listed.
    until(teacher_reads(folder, "Find RB6: 0 of 1 steps, 2 s, paused"))
    session.do(PauseTask(False))
    until(lambda: "paused" not in next(folder.glob("*.running.json")).read_text())
    session.do(StopTask())
    until(lambda: not list(folder.glob("*.running.json")))


@pytest.mark.parametrize(
    "end", [lambda one: one.close_case(), lambda one: one.session.close()], ids=["case", "session"]
)
def test_end_of_case_or_session_deletes_the_file_of_the_running_task(workstation, tmp_path, end):
    folder = tmp_path / "learners"
    workstation.session.do(AddLearner("one"))
    workstation.start("find-rb6")
    workstation.advance_tip(40.0)
    until(lambda: list(folder.glob("*.running.json")))
    end(workstation)
    until(lambda: not list(folder.glob("*.running.json")))


def test_folder_that_does_not_respond_does_not_stop_the_sampling_of_the_tip(workstation, monkeypatch):
    hangs, go = threading.Event(), threading.Event()

    def hang(*_what, **_options):
        hangs.set()
        assert go.wait(60.0)

    monkeypatch.setattr(running_tasks, "write_whole", hang)
    workstation.session.do(AddLearner("one"))
    workstation.start("inspect-all")
    workstation.advance_tip(30.0)
    assert hangs.wait(60.0)
    workstation.advance_tip(30.0)
    assert workstation.info.running.elapsed_s == pytest.approx(3.0)
    go.set()
    workstation.session.do(StopTask())
    (score,) = workstation.scored()
    assert score.unmarked.path_mm == pytest.approx(60.0, abs=3.0)


def test_attempts_of_learners_are_judged_once_for_all_teachers(workstation, monkeypatch):
    session, judged, mastery = workstation.session, [], Learner.mastery

    def counted(learner):
        judged.append(learner.name)
        return mastery(learner)

    for name in ("one", "two"):
        session.do(AddLearner(name))
        fly(workstation)
    monkeypatch.setattr(Learner, "mastery", counted)
    first = session.ask(ClassroomOf())
    assert [(one.learner.name, len(one.attempts), one.running) for one in first] == [("one", 1, None), ("two", 1, None)]
    session.do(ReadTrainingFiles())
    again = session.ask(ClassroomOf())
    assert all(one is other for one, other in zip(first, again, strict=True))
    assert judged == []
    fly(workstation)
    changed = session.ask(ClassroomOf())
    assert judged == ["two"], "only the learner with a new attempt"
    assert changed[0] is first[0]
    assert len(changed[1].attempts) == 2


def test_observers_share_one_text_in_which_only_changed_learners_are_encoded_again(workstation, monkeypatch):
    session, encoded, encode = workstation.session, [], wire.encode_message

    def counted(message, **fields):
        encoded.append(type(message).__name__)
        return encode(message, **fields)

    session.do(AddLearner("Blue heron"))
    texts = SharedTexts(session, None, print)
    monkeypatch.setattr(wire, "encode_message", counted)
    without = json.loads(texts.observed_training(with_learners=False))
    assert without["classroom"] == []
    first = texts.observed_training(with_learners=True)
    assert [one["learner"]["name"] for one in json.loads(first)["classroom"]] == ["Blue heron"]
    assert json.loads(first) == {**without, "classroom": json.loads(first)["classroom"]}
    encoded.clear()
    assert texts.observed_training(with_learners=True) is first
    assert encoded == []
    workstation.start("inspect-all")
    for seconds in (1.0, 2.0):
        workstation.follow(1.0)
        shown = json.loads(texts.observed_training(with_learners=True))
        assert shown["running"]["elapsed_s"] == pytest.approx(seconds)
        assert shown["classroom"] == json.loads(first)["classroom"]
    assert encoded == ["TrainingMessage"] * 2, "the list of the learners is not encoded again"
    texts.observed_training(with_learners=False)
    assert "heron" not in texts.observed_training(with_learners=False)
    workstation.session.do(StopTask())
