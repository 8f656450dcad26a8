"""Session with an open chest for tests of the training, whose attempts are followed by the test."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from pathlib import Path

from carina.case.recordings import RecordingFacts
from carina.commands import CloseCase, FlightFileQuery, OpenPath, StartTask, Steer, TrainingOf
from carina.errors import CarinaError
from carina.session import CaseRecords, Session, UserMessage, case_files, default_parts
from carina.session.training.attempts import TrainingHandlers
from small_case import Clock, SmallRenderer


class Workstation:
    """Session with an open chest, whose attempts are followed by the test instead of a thread."""

    def __init__(self, folder: Path, chest, monkeypatch, course=None, tasks=None) -> None:
        volume, airways, wall = chest
        self.clock = Clock()
        self.attempts = []
        monkeypatch.setattr(TrainingHandlers, "_watch", lambda handlers, *what: self.attempts.append((handlers, what)))
        records = CaseRecords(folder / "cases", time.time)
        self.session = Session(
            SmallRenderer,
            parts=dataclasses.replace(
                default_parts(),
                measure_tree=None,
                open_volume=lambda _path, _progress, _cancel: volume,
                find_airways=lambda _volume, **_options: airways,
                wall_field=lambda *_what, **_options: wall,
            ),
            clock=self.clock,
            records=records,
            files=case_files(None, records),
            course=course,
            tasks=tasks,
        )
        self.messages = []
        self.session.subscribe(lambda event: self.messages.append(event) if isinstance(event, UserMessage) else None)
        self.session.do(OpenPath(str(folder)))
        until(lambda: self.session.snapshot().airways == "found")
        until(lambda: self.session.snapshot().saving.keeps)

    @property
    def info(self):
        return self.session.ask(TrainingOf())

    def text_of(self, number: int) -> str:
        """Return the lines of a flight, however long a busy machine takes to write them."""
        found = []

        def is_written() -> bool:
            # The query fails if the disk has not responded within its limit.
            with contextlib.suppress(CarinaError):
                found.append(self.session.ask(FlightFileQuery(number)))
            return bool(found)

        until(is_written)
        return found[0]

    def scored(self, num: int = 1):
        """Return the scores, once there are so many and no attempt runs."""
        until(lambda: len(self.info.scores) >= num and self.info.running is None)
        return self.info.scores

    def start(self, task: str):
        num = len(self.attempts)
        self.session.do(StartTask(task))
        until(lambda: len(self.attempts) > num)

    def close_case(self):
        """Close the case during a task, as an opening does that began before the task."""
        self.session._handlers[CloseCase](CloseCase())

    def follow(self, seconds: float) -> bool:
        """Let time pass, and follow the newest attempt; return whether it continues."""
        handlers, (case, attempt) = self.attempts[-1]
        for _ in range(round(seconds / 0.1)):
            self.clock.advance(0.1)
            if not handlers.follow_attempt(case, attempt):
                return False
        return True

    def advance_tip(self, millimetres: float) -> None:
        """Insert the scope evenly at 20 mm/s, followed at each step."""
        for _ in range(round(millimetres / 2.0)):
            self.session.do(Steer(2.0, 0.0, 0.0, 0.0))
            if not self.follow(0.1):
                return


def until(condition, seconds=120.0):
    """Wait for a condition of another thread."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def flights(workstation) -> tuple[RecordingFacts, ...]:
    return workstation.session.snapshot().flights
