"""Tests of attempts that are interrupted: each shows its message, and nothing that was recorded is lost."""

from __future__ import annotations

import dataclasses
import errno
import json
import threading
from pathlib import Path

import pytest

from cached_test_data import masked_chest
from carina.commands import (
    AddLearner,
    BeginAnew,
    Cancel,
    ChooseLearner,
    CloseCase,
    CutBranch,
    DeviceGone,
    EditTree,
    FlyFlight,
    GoTo,
    OpenCaseFile,
    OpenDemo,
    OpenFiles,
    OpenPath,
    OpenRecent,
    OpenSeries,
    OpenVolume,
    ReadTrainingFiles,
    RemoveLearner,
    ScoreFlight,
    SetMode,
    SetRoot,
    SetScope,
    StartTask,
    Steer,
    StopRecording,
    StopTask,
    ToggleMode,
    Undo,
    all_commands,
)
from carina.errors import NoResultError, UsageError
from carina.navigate import HandleSample
from carina.navigate.moves import SetMode as MoveToMode
from carina.session import ErrorEvent
from carina.session.training import attempts
from carina.session.training.attempts import REFUSED_COMMANDS
from carina.training import Course, TaskFolder, find_task, segments_of_case, task_to_json
from training_workstation import Workstation, flights, until


@pytest.fixture(scope="module")
def chest():
    return masked_chest()


@pytest.fixture
def workstation(tmp_path, chest, monkeypatch):
    made = Workstation(
        tmp_path, chest, monkeypatch, course=Course(tmp_path / "learners"), tasks=TaskFolder(tmp_path / "tasks")
    )
    made.errors = []
    made.session.subscribe(lambda event: made.errors.append(event) if isinstance(event, ErrorEvent) else None)
    yield made
    made.session.close()


def num_attempts(workstation):
    return {one.name: one.num_attempts for one in workstation.info.course.learners}


def reported(workstation, text):
    return any(text in one.message for one in (*workstation.messages, *workstation.errors))


def fly_and_end(workstation, task="inspect-all"):
    num = len(workstation.info.scores)
    workstation.start(task)
    workstation.advance_tip(20.0)
    workstation.session.do(StopTask())
    workstation.scored(num + 1)


# ------------------------------------------------------------ the learner who flew owns the score


def test_score_of_an_earlier_flight_is_stored_for_the_learner_who_flew_it(workstation):
    session = workstation.session
    session.do(AddLearner("one"))
    fly_and_end(workstation)
    session.do(AddLearner("two"))
    session.do(ScoreFlight(flights(workstation)[0].number))
    until(lambda: not session.jobs.running)
    assert num_attempts(workstation) == {"one": 1, "two": 0}


def test_flight_without_a_learner_is_never_stored_for_the_learner_who_is_chosen_later(workstation):
    session = workstation.session
    fly_and_end(workstation)
    session.do(AddLearner("one"))
    session.do(ScoreFlight(flights(workstation)[0].number))
    until(lambda: not session.jobs.running)
    assert num_attempts(workstation) == {"one": 0}


def test_running_attempt_states_its_learner_after_another_one_is_chosen(workstation):
    session = workstation.session
    session.do(AddLearner("two"))
    session.do(AddLearner("one"))
    workstation.start("inspect-all")
    session.do(ChooseLearner("two"))
    assert (workstation.info.running.learner, workstation.info.course.chosen) == ("one", "two")
    workstation.advance_tip(20.0)
    session.do(StopTask())
    workstation.scored()
    assert num_attempts(workstation) == {"one": 1, "two": 0}


def test_learner_is_chosen_when_the_task_is_started_and_not_when_the_wall_is_computed(workstation, monkeypatch):
    session = workstation.session
    session.do(AddLearner("two"))
    session.do(AddLearner("one"))
    handlers = session._training
    begin, waiting = handlers._begin, []
    monkeypatch.setattr(handlers, "_begin", lambda *what: waiting.append(what))
    session.do(StartTask("inspect-all"))
    until(lambda: waiting)
    session.do(ChooseLearner("two"))
    monkeypatch.undo()
    with session._core.lock:
        begin(*waiting[0])
    assert workstation.info.running.learner == "one"
    session.do(StopTask())


def test_new_learner_with_the_pseudonym_of_a_deleted_one_gets_no_earlier_flight(workstation):
    session = workstation.session
    session.do(AddLearner("one"))
    fly_and_end(workstation)
    session.do(RemoveLearner("one"))
    session.do(AddLearner("one"))
    session.do(ScoreFlight(flights(workstation)[0].number))
    until(lambda: reported(workstation, "the learner who flew this attempt is not on this machine"))
    assert num_attempts(workstation) == {"one": 0}


def test_attempt_that_is_scored_by_another_task_is_not_stored(workstation):
    session = workstation.session
    session.do(AddLearner("one"))
    fly_and_end(workstation)
    session.do(ScoreFlight(flights(workstation)[0].number, task="find-lb6"))
    until(lambda: [one.task for one in workstation.info.scores] == ["find-lb6"])
    until(lambda: not session.jobs.running)
    assert [one.task for one in workstation.info.course.attempts] == ["inspect-all"]


def test_flight_contains_no_pseudonym(workstation):
    workstation.session.do(AddLearner("Blue heron"))
    fly_and_end(workstation)
    text = workstation.text_of(flights(workstation)[0].number)
    assert "heron" not in text
    (line,) = [one for one in map(json.loads, text.splitlines()) if "task" in one]
    assert line["learner"] == Course(workstation.session._course._course._folder).learner("Blue heron").key


# ------------------------------------------------------------ commands that would end the attempt


@pytest.mark.parametrize(
    "command",
    [
        SetMode("free"),
        SetMode("path"),
        ToggleMode(),
        SetScope("ultrathin"),
        StopRecording(),
        GoTo(10.0),
        FlyFlight(1, 0.0),
        SetRoot((0.0, 0.0, 0.0)),
        Undo(),
        OpenPath("/scans/another"),
        OpenSeries("another"),
        OpenCaseFile(Path("/scans/another.carina")),
        OpenDemo("phantom"),
        OpenRecent("another"),
        OpenFiles("/uploads/another"),
        OpenVolume(None),
        BeginAnew(),
        CloseCase(),
    ],
    ids=lambda command: type(command).__name__,
)
def test_command_that_would_end_the_attempt_is_refused_and_the_attempt_continues(workstation, command):
    workstation.start("inspect-all")
    workstation.advance_tip(10.0)
    refused = "a task is running, and this would end the attempt: choose End the task first"
    with pytest.raises(UsageError, match=refused):
        workstation.session.do(command)
    workstation.advance_tip(10.0)
    assert workstation.info.running.elapsed_s == pytest.approx(1.0)
    workstation.session.do(StopTask())
    (score,) = workstation.scored()
    assert score.doubts == ()


def test_commands_that_change_only_the_picture_or_the_scope_mode_itself_are_possible_during_a_task(workstation):
    workstation.start("inspect-all")
    workstation.session.do(SetMode("scope"))
    workstation.session.do(Steer(1.0, 0.0, 0.0, 0.0))
    assert workstation.follow(0.2)


def test_tree_that_is_edited_during_a_task_is_refused(workstation):
    workstation.start("inspect-all")
    workstation.advance_tip(10.0)
    with pytest.raises(UsageError, match="choose End the task first"):
        workstation.session.do(EditTree(CutBranch(3)))
    assert workstation.follow(0.2)


def test_airways_that_change_nevertheless_end_the_attempt_with_a_message_and_a_score(workstation, chest):
    session = workstation.session
    session.do(AddLearner("one"))
    workstation.start("inspect-all")
    workstation.advance_tip(20.0)
    case = session._core.case
    with session._core.lock:
        changed = dataclasses.replace(case.document, airways=dataclasses.replace(chest[1]))
        session._core.change(case, "another search", changed)
    assert reported(workstation, "the task ended early, and the attempt does not count: the airways have changed")
    (score,) = workstation.scored()
    assert score.doubts != ()
    assert [one.counts for one in workstation.info.course.attempts] == [False]


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (lambda session: session._core.fly(MoveToMode("free")), "the scope was taken out of the airways"),
        (lambda session: session._recording.stop(), "the recording was stopped"),
    ],
)
def test_attempt_that_a_device_or_the_disk_ends_is_scored_and_does_not_count(workstation, end, reason):
    workstation.start("inspect-all")
    workstation.advance_tip(20.0)
    end(workstation.session)
    assert not workstation.follow(0.2)
    assert reported(workstation, reason)
    (score,) = workstation.scored()
    assert any("cut off" in words or "early" in words for words in score.doubts)


def test_every_command_that_opens_or_closes_a_case_is_refused_during_a_task():
    """Commands of this name in later versions must be added to the refused ones as well."""
    opening = {one for one in all_commands() if one.__name__.startswith(("Open", "Close", "BeginAnew"))}
    assert opening <= {*REFUSED_COMMANDS}
    assert len(opening) == 9


def test_opening_that_began_before_the_task_ends_the_attempt_with_a_message(workstation, monkeypatch, tmp_path):
    session, go = workstation.session, threading.Event()
    session.do(AddLearner("one"))
    read = session._core.parts.open_volume

    def read_slowly(*what):
        assert go.wait(60.0)
        return read(*what)

    parts = dataclasses.replace(session._core.parts, open_volume=read_slowly)
    monkeypatch.setattr(session._core, "parts", parts)
    number = session.snapshot().case_number
    (tmp_path / "other").mkdir()
    session.do(OpenPath(str(tmp_path / "other")))
    workstation.start("inspect-all")
    workstation.advance_tip(20.0)
    go.set()
    until(lambda: session.snapshot().case_number != number)
    assert not workstation.follow(0.1)
    assert reported(workstation, "because the case was closed: its flight is stored in the case")


# ------------------------------------------------------------ scores that are stopped


@pytest.fixture
def slow_scores(monkeypatch):
    """Make each score of a recording wait for the event, and count the begun ones."""
    go, begun, read = threading.Event(), [], attempts.read_recording

    def read_slowly(*what):
        begun.append(what)
        assert go.wait(60.0)
        return read(*what)

    monkeypatch.setattr(attempts, "read_recording", read_slowly)
    yield go, begun
    go.set()


def end_unscored(workstation, begun):
    """Fly an attempt and end it; return once its score has begun."""
    num = len(begun)
    workstation.start("inspect-all")
    workstation.advance_tip(20.0 + 2.0 * num)
    workstation.session.do(StopTask())
    until(lambda: len(begun) > num)


def test_score_of_an_attempt_is_stored_although_a_second_attempt_is_scored(workstation, slow_scores):
    go, begun = slow_scores
    workstation.session.do(AddLearner("one"))
    for _ in range(2):
        end_unscored(workstation, begun)
    go.set()
    workstation.scored(2)
    until(lambda: num_attempts(workstation) == {"one": 2})
    assert not reported(workstation, "is not stored yet")


@pytest.mark.parametrize(
    ("stop", "remedy"),
    [
        (lambda session: session.do(Cancel(session.jobs.running[0].job_id)), "stopped: choose Score it"),
        (lambda session: session.do(CloseCase()), "stopped: open the case again and choose Score it"),
        (lambda session: session.do(BeginAnew()), "stopped: open the case again and choose Score it"),
    ],
    ids=["cancelled", "closed", "another case"],
)
def test_score_that_is_stopped_is_reported_and_stored_by_scoring_the_flight_again(
    workstation, slow_scores, stop, remedy
):
    go, begun = slow_scores
    session = workstation.session
    session.do(AddLearner("one"))
    number = session.snapshot().case_number
    end_unscored(workstation, begun)
    stop(session)
    until(lambda: all(job.cancel() for job in session.jobs.running if job.kind.startswith("score")))
    go.set()
    until(lambda: reported(workstation, f"attempt 1 is not stored yet, because its computation was {remedy}"))
    until(lambda: not session.jobs.running)
    assert num_attempts(workstation) == {"one": 0}
    if session.snapshot().case_number != number:
        (entry,) = session.cases.listed()
        session.do(OpenRecent(entry.recent_id))
        until(lambda: session.snapshot().airways == "found")
        until(lambda: flights(workstation))
    session.do(ScoreFlight(flights(workstation)[0].number))
    until(lambda: num_attempts(workstation) == {"one": 1})


def test_score_that_is_started_again_is_not_reported_as_stopped(workstation, slow_scores):
    go, begun = slow_scores
    session = workstation.session
    session.do(AddLearner("one"))
    end_unscored(workstation, begun)
    session.do(ScoreFlight(flights(workstation)[0].number))
    go.set()
    until(lambda: num_attempts(workstation) == {"one": 1})
    until(lambda: not session.jobs.running)
    assert not reported(workstation, "is not stored yet")


# ------------------------------------------------------------ devices, disks, closed windows


def test_device_that_is_unplugged_in_flight_leaves_the_attempt_running_with_a_message(workstation):
    session = workstation.session
    workstation.start("inspect-all")
    session.devices.receive_sample("handle", HandleSample(0.5, 0.0, 0.0, 0.0))
    session.devices.frame()
    session.do(DeviceGone("handle"))
    assert reported(workstation, "handle was disconnected: the task continues, and the clock runs")
    workstation.advance_tip(20.0)
    session.do(StopTask())
    (score,) = workstation.scored()
    assert score.doubts == ()


def test_device_that_is_unplugged_without_a_task_or_that_does_not_move_the_tip_gives_no_message(workstation):
    session = workstation.session
    session.devices.receive_sample("handle", HandleSample(0.5, 0.0, 0.0, 0.0))
    session.devices.frame()
    session.do(DeviceGone("handle"))
    workstation.start("inspect-all")
    session.do(DeviceGone("other"))
    assert not reported(workstation, "disconnected")


def test_full_disk_is_reported_and_the_score_is_stored_when_there_is_space_again(workstation, monkeypatch):
    session = workstation.session
    session.do(AddLearner("one"))

    def full(*_what, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("carina.disk.atomic_files.os.fsync", full)
    fly_and_end(workstation)
    assert reported(workstation, "the score of one was not stored: ")
    assert reported(workstation, "disk is full")
    assert "1 scores are not stored yet" in workstation.info.course.problems[-1]
    assert len(workstation.info.scores) == 1, "the score is shown nevertheless"
    monkeypatch.undo()
    # The flight can be scored again as well.
    session.do(ScoreFlight(flights(workstation)[0].number))
    until(lambda: num_attempts(workstation) == {"one": 1})
    assert not any("not stored yet" in one for one in workstation.info.course.problems)


def test_closed_case_ends_the_attempt_with_a_message_and_its_flight_is_scored_for_its_learner_later(workstation):
    session = workstation.session
    session.do(AddLearner("one"))
    workstation.start("inspect-all")
    workstation.advance_tip(20.0)
    workstation.close_case()
    assert reported(workstation, "because the case was closed: its flight is stored in the case")
    session.do(ChooseLearner(None))
    (entry,) = session.cases.listed()
    session.do(OpenRecent(entry.recent_id))
    until(lambda: session.snapshot().airways == "found")
    until(lambda: flights(workstation))
    session.do(ScoreFlight(flights(workstation)[0].number))
    (score,) = workstation.scored()
    assert any("early" in words or "cut off" in words for words in score.doubts)
    until(lambda: num_attempts(workstation) == {"one": 1})


def test_session_that_ends_during_a_task_leaves_the_flight_with_its_learner(tmp_path, chest, monkeypatch):
    first = Workstation(tmp_path, chest, monkeypatch, course=Course(tmp_path / "learners"))
    first.session.do(AddLearner("one"))
    first.start("inspect-all")
    first.advance_tip(20.0)
    first.session.close()
    again = Workstation(tmp_path, chest, monkeypatch, course=Course(tmp_path / "learners"))
    try:
        until(lambda: flights(again))
        again.session.do(ScoreFlight(flights(again)[0].number))
        until(lambda: num_attempts(again) == {"one": 1})
        assert again.info.scores[0].doubts != ()
    finally:
        again.session.close()


# ------------------------------------------------------------ tasks of teachers


def test_tasks_of_teachers_are_listed_and_started_and_invalid_files_state_their_reason(workstation, tmp_path):
    folder, session = tmp_path / "tasks", workstation.session
    folder.mkdir()
    own = dataclasses.replace(find_task("find-rb6"), name="my-task", title="Find RB6 my way", hints=("arrow",))
    (folder / "mine.json").write_text(json.dumps(task_to_json(own)))
    (folder / "wrong.json").write_text(json.dumps({**task_to_json(own), "kind": "fly"}))
    (folder / "broken.json").write_text("{")
    (folder / "same.json").write_text(json.dumps(task_to_json(own)))
    (folder / "taken.json").write_text(json.dumps({**task_to_json(own), "name": "inspect-all"}))
    session.do(ReadTrainingFiles())
    info = workstation.info
    assert [one.name for one in info.tasks if one.is_own] == ["my-task"]
    problems = "\n".join(info.task_problems)
    assert "wrong.json: kind: expected" in problems and "found 'fly'" in problems
    assert "broken.json: expected a JSON file with one task" in problems
    assert "same.json: name: expected another name than in mine.json; found my-task" in problems
    assert "taken.json: name: expected a name of your own" in problems
    workstation.start("my-task")
    workstation.advance_tip(40.0)
    running = workstation.info.running
    tree = workstation.attempts[-1][1][1].airways.tree
    (segment,) = [one for one in segments_of_case(tree) if one.name == "RB6"]
    assert running.arrow_branches == segment.branch_ids
    session.do(StopTask())
    (score,) = workstation.scored()
    assert (score.task, score.task_title) == ("my-task", "Find RB6 my way")
    # The flight states its task, so that it can be scored after the file was deleted.
    (folder / "mine.json").unlink()
    (folder / "same.json").unlink()
    session.do(ReadTrainingFiles())
    assert not any(one.is_own for one in workstation.info.tasks)
    session.do(ScoreFlight(score.flight))
    until(lambda: not session.jobs.running)
    assert workstation.info.scores[0].task == "my-task"


def test_own_task_that_the_case_lacks_is_listed_with_the_reason_and_refused(workstation, tmp_path):
    folder = tmp_path / "tasks"
    folder.mkdir()
    own = dataclasses.replace(find_task("hold-rul"), name="lacking", structure="No such branch")
    (folder / "lacking.json").write_text(json.dumps(task_to_json(own)))
    workstation.session.do(ReadTrainingFiles())
    (info,) = [one for one in workstation.info.tasks if one.is_own]
    assert "expected a branch named No such branch" in info.problem
    with pytest.raises(NoResultError, match="No such branch"):
        workstation.session.do(StartTask("lacking"))


def test_window_names_no_file_as_a_task(workstation, tmp_path):
    path = tmp_path / "somewhere.json"
    path.write_text(json.dumps(task_to_json(dataclasses.replace(find_task("find-rb6"), name="mine"))))
    with pytest.raises(UsageError, match=r"task: expected one of .*; found"):
        workstation.session.do(StartTask(str(path)[-80:]))


def test_task_without_the_hint_has_no_arrow(workstation):
    workstation.start("inspect-all")
    workstation.advance_tip(40.0)
    assert workstation.info.running.next_step == "RB1"
    assert workstation.info.running.arrow_branches == ()
