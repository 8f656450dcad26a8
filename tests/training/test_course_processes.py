"""Tests of learners that several processes change: every attempt that was stored is read again, also after a crash."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap

import pytest

from carina.disk.locks import try_lock
from carina.errors import DiskError
from carina.training import Course
from carina.training import course as course_module

WRITER = textwrap.dedent(
    """
    import sys
    from carina.training.course import Course, CourseAttempt, _VALUES

    folder, name, label = sys.argv[1:]
    course = Course(folder)
    for number in range(10_000):
        digest = f"{label}-{number}"
        attempt = CourseAttempt.from_json({
            "task": "inspect-all", "title": "Inspect", "is_inspection": True, "completed": False, "num_steps_done": 0,
            "num_steps": 18, "values": dict.fromkeys(_VALUES), "passed": False, "reasons": [], "digest": digest,
            "poses": [digest], "statements": [{"id": digest, "filler": "x" * 20_000}],
        })
        course._store(name, lambda learner: attempt)
        print(digest, flush=True)
    """
)


def writer(folder, label):
    """Start a process that stores attempts of the learner *one* until it is killed."""
    command = [sys.executable, "-c", WRITER, str(folder), "one", label]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def killed(process):
    """Kill a process, and return the digests that it still reported."""
    process.send_signal(signal.SIGKILL)
    rest, _ = process.communicate()
    return rest.split()


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL")
def test_attempts_of_two_processes_are_all_stored_although_one_is_killed_again_and_again(tmp_path):
    Course(tmp_path).add("one")
    stored = []
    steady = writer(tmp_path, "steady")
    try:
        for round_number in range(4):
            other = writer(tmp_path, f"killed{round_number}")
            for _ in range(3 + round_number):
                stored.append(other.stdout.readline().strip())
            stored += killed(other)
        stored += [steady.stdout.readline().strip() for _ in range(5)]
    finally:
        stored += killed(steady)
    course = Course(tmp_path)
    assert course.problems() == ()
    found = [one.digest for one in course.learner("one").attempts]
    assert "" not in stored
    assert set(stored) <= set(found)
    # A process may be killed after it has stored an attempt and before it reports it.
    assert len(found) <= len(stored) + 5
    assert {one.partition("-")[0] for one in found} == {"steady", *(f"killed{n}" for n in range(4))}


def test_learners_that_another_process_locks_are_not_changed(tmp_path, monkeypatch):
    course = Course(tmp_path)
    course.add("one")
    monkeypatch.setattr(course_module, "LOCK_WAIT_S", 0.05)
    with (tmp_path / course_module.LOCK).open("r+b") as held:
        assert try_lock(held.fileno()) is True
        with pytest.raises(DiskError, match="another program of Carina changes the learners; wait until"):
            course.add("two")
    course.add("two")
    assert [one.name for one in course.learners()] == ["one", "two"]


def test_learner_whose_file_is_damaged_is_not_taken_for_a_deleted_one(tmp_path):
    course = Course(tmp_path)
    key = course.add("one").key
    (tmp_path / f"{key}.learner.json").write_text("{")
    with pytest.raises(DiskError, match="the file of this learner cannot be read; it is left unchanged"):
        course._store(key, lambda _name: None)
