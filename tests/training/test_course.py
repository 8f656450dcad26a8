"""Tests of the course: pseudonymous learners, stored attempts, mastery, export, deletion and damaged files."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os

import pytest
from scripted_flights import Script, recording_of

from carina.errors import CarinaError, UsageError
from carina.training import Course, find_task, flight_frames, judge_mastery, score_flight
from carina.training.course import CourseAttempt, Learner


@pytest.fixture(scope="module")
def scores(chest):
    """Return the scores of two short inspections, of one that repeats the first, and of a search."""

    def score_of(end_mm, task):
        script = Script(chest.tree)
        script.start()
        script.go(0, end_mm)
        script.inspect("RB1")
        frames = flight_frames(recording_of(script.poses, chest.volume))
        return score_flight(chest.tree, chest.wall, frames, find_task(task))

    return [score_of(60.0, "inspect-all"), score_of(70.0, "inspect-all"), score_of(60.0, "find-rb6")]


def test_attempts_of_a_learner_are_read_again_with_their_scores(tmp_path, scores):
    course = Course(tmp_path / "learners")
    assert course.learners() == ()
    course.add("  Blue   heron ")
    for score in scores[:2]:
        course.record("blue heron", score)
    (learner,) = Course(tmp_path / "learners").learners()
    assert (learner.name, len(learner.attempts)) == ("Blue heron", 2)
    assert learner == course.learner("Blue heron")
    values = learner.attempts[1].values
    assert values["diagnostic_completeness"] == scores[1].diagnostic_completeness
    assert values["procedure_time_s"] == scores[1].procedure_time_s
    assert not learner.attempts[0].completed


def test_file_of_a_learner_contains_no_pose_no_time_of_day_and_no_case(tmp_path, scores):
    course = Course(tmp_path)
    course.add("Blue heron")
    course.record("Blue heron", scores[0])
    (path,) = tmp_path.glob("*.learner.json")
    text = path.read_text()
    assert "lps" not in text
    assert not {"timestamp", "patient", "case_id", "date"} & {*json.loads(text)["attempts"][0]}
    assert path.stat().st_mode & 0o077 == 0 or os.name == "nt"


def test_score_of_the_same_flight_and_task_replaces_the_attempt(tmp_path, scores):
    course = Course(tmp_path)
    course.add("one")
    course.record("one", scores[0])
    assert len(course.record("one", scores[0]).attempts) == 1
    assert len(course.record("one", scores[2]).attempts) == 2, "another task is another attempt"


def test_mastery_of_a_learner_equals_that_of_the_scores(tmp_path, scores):
    course = Course(tmp_path)
    course.add("one")
    for score in scores[:2]:
        course.record("one", score)
    found, expected = course.learner("one").mastery(), judge_mastery(scores[:2])
    assert (found.passed, found.counted, found.reasons) == (expected.passed, expected.counted, expected.reasons)
    assert found.words.startswith("no verdict: it needs 6 attempts that count")


def attempt(scores, number, *, passed, counts=True):
    made = CourseAttempt.of(scores[0], "one")
    return dataclasses.replace(
        made, passed=passed, reasons=() if counts else ("paused",), digest=str(number),
        poses=frozenset({str(number), "x"}),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("passed", "counts", "verdict"),
    [
        ("00011", "11111", None),
        ("000011", "111111", True),
        ("001010", "111111", False),
        ("0000110", "1111011", False),
        ("0001100", "0111111", True),
    ],
)
def test_mastery_needs_six_attempts_that_count_and_two_passed_in_a_row(scores, passed, counts, verdict):
    made = [
        attempt(scores, n, passed=one == "1", counts=two == "1")
        for n, (one, two) in enumerate(zip(passed, counts, strict=True))
    ]
    learner = Learner("one", tuple(made))
    assert learner.mastery().verdict is verdict
    if verdict is not None:
        assert "over all attempts of this learner, in their order" in learner.mastery().words


def test_replay_of_an_earlier_attempt_does_not_count(scores):
    first = attempt(scores, 1, passed=True)
    again = dataclasses.replace(first, digest="other")
    mastery = Learner("one", (first, again)).mastery()
    assert mastery.counted == (True, False)
    assert "repeat those of attempt 1" in mastery.reasons[1][0]


def test_export_has_a_row_and_statements_for_each_attempt(tmp_path, scores):
    course = Course(tmp_path / "learners")
    course.add("=Blue")
    course.record("=Blue", scores[0])
    course.record("=Blue", scores[2])
    table, statements = course.export("=Blue", tmp_path / "out")
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert [row["task"] for row in rows] == ["inspect-all", "find-rb6"]
    assert rows[0]["learner"] == "'=Blue", "no spreadsheet program takes the name for a formula"
    assert float(rows[0]["procedure_time_s"]) == scores[0].procedure_time_s
    found = json.loads(statements.read_text())
    assert {one["actor"]["account"]["name"] for one in found} == {"=Blue"}
    assert len({one["id"] for one in found}) == len(found)


def test_deleted_learner_leaves_no_file(tmp_path, scores):
    course = Course(tmp_path)
    course.add("one")
    course.add("two")
    course.record("one", scores[0])
    course.remove("ONE")
    assert [one.name for one in course.learners()] == ["two"]
    assert len(list(tmp_path.glob("*.learner.json"))) == 1
    with pytest.raises(UsageError, match="learner: expected one of two; found 'one'"):
        course.record("one", scores[0])


@pytest.mark.parametrize("name", ["", "   ", "x" * 41, "a\x07b"])
def test_invalid_pseudonym_is_refused(tmp_path, name):
    with pytest.raises(UsageError):
        Course(tmp_path).add(name)


def test_pseudonym_in_use_is_refused_whatever_its_case(tmp_path):
    course = Course(tmp_path)
    course.add("Blue heron")
    with pytest.raises(UsageError, match="in use"):
        course.add("blue HERON")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"format":"carina-learner","version":1,"name":"x","attempts":[{}]}',
        '{"format":"other"}',
        "[" * 9000,
    ],
)
def test_damaged_file_is_reported_and_never_changed(tmp_path, text):
    course = Course(tmp_path)
    course.add("one")
    damaged = tmp_path / "0123.learner.json"
    damaged.write_text(text)
    assert [one.name for one in course.learners()] == ["one"]
    assert course.problems() == ("the file 0123.learner.json of a learner cannot be read; it is left unchanged",)
    course.remove("one")
    assert damaged.read_text() == text


@pytest.mark.parametrize("name", ["KEY (1)", "Copy of KEY", "blue", "KEY0", "KEY\u202e"])
def test_copied_or_renamed_file_is_reported_and_not_listed(tmp_path, scores, name):
    course = Course(tmp_path)
    course.add("Blue heron")
    course.record("Blue heron", scores[0])
    (path,) = tmp_path.glob("*.learner.json")
    copy = tmp_path / f"{name.replace('KEY', path.name.removesuffix('.learner.json'))}.learner.json"
    text = path.read_text()
    copy.write_text(text)
    (learner,) = course.learners()
    assert learner.key == path.name.removesuffix(".learner.json")
    (problem,) = course.problems()
    assert copy.name.replace("\u202e", "\\u202e") in problem
    assert "was copied or renamed, and is not used" in problem
    # Attempts are stored in the file with the learner's key.
    course.record("Blue heron", scores[1])
    assert len(Course(tmp_path).learner("Blue heron").attempts) == 2
    assert copy.read_text() == text
    path.unlink()
    assert course.learners() == ()
    with pytest.raises(UsageError, match="learner: expected one of none"):
        course.record("Blue heron", scores[0])


@pytest.mark.parametrize(
    "change",
    [
        lambda file: file["attempts"][0]["values"].update(diagnostic_completeness=float("nan")),
        lambda file: file["attempts"][0]["values"].update(diagnostic_completeness=float("inf")),
        lambda file: file["attempts"][0]["values"].update(procedure_time_s=10**400),
        lambda file: file["attempts"][0].update(num_steps=10**400),
        lambda file: file["attempts"][0]["statements"][0].update(result=float("-inf")),
        lambda file: file["attempts"][0].update(title="half \ud800"),
        lambda file: file.update(name="screen \x1b[2J"),
        lambda file: file.update(name="half \ud800"),
    ],
)
def test_values_that_cannot_be_shown_or_exported_are_damage(tmp_path, scores, change):
    course = Course(tmp_path)
    course.add("one")
    course.record("one", scores[0])
    (path,) = tmp_path.glob("*.learner.json")
    file = json.loads(path.read_text())
    change(file)
    path.write_text(json.dumps(file))
    assert Course(tmp_path).learners() == ()
    assert len(Course(tmp_path).problems()) == 1


def test_attempt_on_a_full_disk_leaves_the_stored_attempts(tmp_path, scores, monkeypatch):
    course = Course(tmp_path)
    course.add("one")
    course.record("one", scores[0])
    monkeypatch.setattr("carina.disk.atomic_files.os.fsync", full_disk)
    with pytest.raises(CarinaError):
        course.record("one", scores[1])
    monkeypatch.undo()
    assert len(Course(tmp_path).learner("one").attempts) == 1
    assert len(course.record("one", scores[1]).attempts) == 2


def full_disk(_file):
    raise OSError(28, "No space left on device")
