"""Tests of the files that tell a teacher which tasks are flown on all machines of a classroom."""

from __future__ import annotations

import pytest

from carina.training import running_tasks
from carina.training.running_tasks import RunningTasks


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def test_task_of_another_machine_is_listed_while_its_file_changes(tmp_path, clock):
    trainee, teacher = RunningTasks(tmp_path), RunningTasks(tmp_path, clock)
    assert teacher.read() == {}
    for second in range(40):
        clock.now_s += 1.0
        trainee.note("0123456789abcdef", "Find RB6: 0 of 1 steps", float(second))
        assert teacher.read() == {"0123456789abcdef": "Find RB6: 0 of 1 steps"}
    trainee.end("0123456789abcdef")
    assert teacher.read() == {}
    assert list(tmp_path.iterdir()) == []


def test_file_of_a_program_that_was_killed_is_not_listed_for_long(tmp_path, clock):
    RunningTasks(tmp_path).note("0123456789abcdef", "Find RB6", 3.0)
    teacher = RunningTasks(tmp_path, clock)
    assert teacher.read() != {}
    clock.now_s += running_tasks.STALE_S - 0.1
    assert teacher.read() != {}
    clock.now_s += 0.2
    assert teacher.read() == {}


@pytest.mark.parametrize("content", ["", "{", "[]", '{"text": 3}', '{"text": "\\u001b[2J"}', "x" * 5000])
def test_damaged_file_is_ignored(tmp_path, content):
    (tmp_path / "0123456789abcdef.running.json").write_text(content)
    assert RunningTasks(tmp_path).read() == {}


def test_missing_folder_is_no_error(tmp_path):
    tasks = RunningTasks(tmp_path / "missing")
    tasks.note("0123456789abcdef", "Find RB6", 1.0)
    tasks.end("0123456789abcdef")
    assert tasks.read() == {}
