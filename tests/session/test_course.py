"""Tests of the course in a session: choice of a learner, stored attempts, full disk, deletion."""

from __future__ import annotations

import pytest

import carina
from cached_test_data import MASKED_CHEST, cached_airways, cached_phantom
from carina.commands import (
    AddLearner,
    ChooseLearner,
    CloseCase,
    CompareFlight,
    LearnerFiles,
    MarkExpert,
    OpenRecent,
    PauseTask,
    RemoveFlight,
    RemoveLearner,
    StopTask,
)
from carina.errors import DiskError, NoResultError, UsageError
from carina.session import ErrorEvent
from carina.training import Course
from training_workstation import Workstation, flights, until


@pytest.fixture(scope="module")
def chest():
    volume, airways = cached_phantom(**MASKED_CHEST).volume, cached_airways(**MASKED_CHEST)
    return volume, airways, carina.wall_field(volume, airways, spacing_mm=0.6, progress=False)


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
