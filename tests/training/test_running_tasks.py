"""Tests of the files that tell a teacher which tasks are flown on all machines of a classroom."""

from __future__ import annotations

import json
import threading
import time

import pytest

from carina.training import running_tasks
from carina.training.running_tasks import RunningTasks

KEY = "0123456789abcdef"


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def trainee(tmp_path):
    made = RunningTasks(tmp_path)
    yield made
    made.close()


def until(condition):
    end_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def write(folder, text, counter):
    (folder / f"{KEY}.running.json").write_text(json.dumps({"text": text, "counter": counter}))


def test_task_of_another_machine_is_listed_while_its_counter_advances(tmp_path, clock):
    teacher = RunningTasks(tmp_path, clock)
    assert teacher.read() == {}
    for counter in range(40):
        write(tmp_path, "Find RB6: 0 of 1 steps, 4 s, paused", counter)
        clock.now_s += 3.0
        # The text is the same for two minutes, as in a pause.
        assert teacher.read() == ({KEY: "Find RB6: 0 of 1 steps, 4 s, paused"} if counter > 0 else {})
    (tmp_path / f"{KEY}.running.json").unlink()
    assert teacher.read() == {}


def test_file_that_a_crash_left_behind_is_never_listed(tmp_path, clock):
    write(tmp_path, "Find RB6", 7)
    teacher = RunningTasks(tmp_path, clock)
    for _ in range(20):
        assert teacher.read() == {}
        clock.now_s += 3.0


def test_file_that_changed_since_an_old_reading_is_not_listed_before_it_changes_again(tmp_path, clock):
    teacher = RunningTasks(tmp_path, clock)
    write(tmp_path, "Find RB6", 1)
    teacher.read()
    # The program that wrote the second text crashed while nobody read the file.
    write(tmp_path, "Find RB6", 2)
    clock.now_s += 600.0
    assert teacher.read() == {}
    clock.now_s += 3.0
    assert teacher.read() == {}


def test_task_of_a_program_that_is_killed_is_not_listed_for_long(tmp_path, clock):
    teacher = RunningTasks(tmp_path, clock)
    for counter in range(2):
        write(tmp_path, "Find RB6", counter)
        clock.now_s += 3.0
        teacher.read()
    clock.now_s += running_tasks.STALE_S - 0.1
    assert teacher.read() != {}
    clock.now_s += 0.2
    assert teacher.read() == {}


def test_file_is_written_again_without_another_note_and_deleted_at_the_end(tmp_path, trainee, monkeypatch):
    monkeypatch.setattr(running_tasks, "WRITE_AGAIN_S", 0.02)
    path = tmp_path / f"{KEY}.running.json"
    trainee.note(KEY, "Find RB6, paused")
    until(path.exists)
    first = json.loads(path.read_text())
    until(lambda: json.loads(path.read_text())["counter"] > first["counter"] + 2)
    assert json.loads(path.read_text())["text"] == first["text"] == "Find RB6, paused"
    teacher = RunningTasks(tmp_path)
    until(lambda: teacher.read() == {KEY: "Find RB6, paused"})
    trainee.end(KEY)
    until(lambda: list(tmp_path.iterdir()) == [])
    until(lambda: trainee._thread is None)
    trainee.note(KEY, "Find LB6")
    until(path.exists)


def test_closing_deletes_the_files_and_ignores_later_tasks(tmp_path, trainee):
    trainee.note(KEY, "Find RB6")
    until(lambda: list(tmp_path.glob("*.running.json")))
    trainee.close()
    until(lambda: list(tmp_path.iterdir()) == [])
    trainee.note(KEY, "Find RB6")
    until(lambda: trainee._thread is None)
    assert list(tmp_path.iterdir()) == []


def test_folder_that_does_not_respond_stops_neither_a_task_nor_the_end(tmp_path, trainee, monkeypatch):
    hangs, go = threading.Event(), threading.Event()

    def hang(*_what, **_options):
        hangs.set()
        assert go.wait(60.0)

    monkeypatch.setattr(running_tasks, "write_whole", hang)
    monkeypatch.setattr(running_tasks, "CLOSING_S", 0.1)
    trainee.note(KEY, "Find RB6")
    assert hangs.wait(60.0)
    # These calls return while the thread waits for the disk.
    trainee.note(KEY, "Find RB6, 2 s")
    trainee.end(KEY)
    trainee.close()
    assert not go.is_set()
    go.set()
    until(lambda: trainee._thread is None)


@pytest.mark.parametrize("content", ["", "{", "[]", '{"text": 3}', '{"text": "\\u001b[2J"}', "x" * 5000])
def test_damaged_file_is_ignored(tmp_path, clock, content):
    teacher = RunningTasks(tmp_path, clock)
    write(tmp_path, "Find RB6", 1)
    teacher.read()
    (tmp_path / f"{KEY}.running.json").write_text(content)
    clock.now_s += 1.0
    assert teacher.read() == {}


def test_missing_folder_is_no_error(tmp_path):
    tasks = RunningTasks(tmp_path / "missing")
    tasks.note(KEY, "Find RB6")
    tasks.end(KEY)
    assert tasks.read() == {}
    tasks.close()
