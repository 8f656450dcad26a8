"""Commands that start and stop the recording of a flight."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO, cast

from carina import commands as c
from carina.breathing import ChestMotion
from carina.case.recordings import RecordingFacts, RecordingWriter
from carina.disk import disk_trouble, make_folder
from carina.errors import UsageError
from carina.navigate import Recorder, case_key
from carina.navigate.recording import TaskOutcome
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import SessionCore
from carina.session.flights.scope_contact import ScopeContactHandlers
from carina.session.flights.tip_commands import view_words
from carina.session.open_case.open_case import OpenCase
from carina.session.state.snapshot import ErrorEvent, UserMessage
from carina.version import VERSION


class FlightRecorder(CommandHandlers):
    """Recorder of every move of the tip, until the user stops it or the case is closed."""

    def __init__(self, core: SessionCore, holding: ScopeContactHandlers) -> None:
        super().__init__(core)
        self._holding = holding
        self._recorder: Recorder | None = None
        self._path: Path | None = None
        self._name = ""
        self._recorded_case: OpenCase | None = None
        self._into: RecordingWriter | None = None
        """Writer of a recording that is stored in the case; None if the recording goes to a file."""
        core.before_move = self.tick

    @property
    def path(self) -> Path | None:
        """Path of the running recording's file.

        None if no recording runs, or if the recording is stored in the case.
        """
        return self._path if self._recorder is not None else None

    @property
    def name(self) -> str | None:
        """Path of the running recording's file, or its name in the case; None without a running recording."""
        if self._recorder is None:
            return None
        flight = self._flight()
        return self._name if flight is None else flight.name

    def _flight(self) -> RecordingFacts | None:
        """Return the running recording's entry in the list of flights.

        None without one, or if the recording goes to a file.
        """
        case, into = self._recorded_case, self._into
        if case is None or into is None:
            return None
        return next((one for one in case.flights.listed if one.recording_id == into.number), None)

    @property
    def flight_number(self) -> int | None:
        """Number of the flight that is being recorded into the case; None without one."""
        flight = None if self._recorder is None else self._flight()
        return None if flight is None else flight.recording_id

    def note_task(self, task: dict[str, Any], learner: str | None) -> None:
        """Record the beginning of an attempt at a task by a learner's key; the caller holds the session's lock."""
        if self._recorder is not None:
            self._recorder.note_task(task, self.core.clock(), learner)

    def note_task_end(self, outcome: TaskOutcome) -> None:
        """Record the end of the attempt; the caller holds the session's lock."""
        if self._recorder is not None:
            self._recorder.note_task_end(outcome, self.core.clock())

    def pause(self) -> None:
        """Stop the time of the recording; the caller holds the session's lock."""
        if self._recorder is not None:
            self._recorder.pause(self.core.clock())

    def resume(self) -> None:
        """Continue the recording after a pause; the caller holds the session's lock."""
        if self._recorder is not None:
            self._recorder.resume(self.core.clock())

    @does(c.RecordFlight)
    def start(self, command: c.RecordFlight) -> None:
        """Start a recording in the current mode of movement.

        Raises
        ------
        UsageError
            ``session.recording``: if a recording is running, or if the recording is to go into a case that is not
            stored.
        CarinaError
            ``machine``: if the file cannot be written.
        """
        case = self.core.needed_case()
        if self._recorder is not None:
            raise UsageError("a recording is already running; stop it first", code="session.recording")
        if command.path is None and not self.core.saving().keeps:
            raise UsageError(
                "this case is not stored on this machine: save the recording to a file instead",
                code="session.recording",
            )
        key = case_key(case.info.volume)
        file: TextIO
        if command.path is None:
            path = None
            with self.core.lock:
                name, into = new_flight(case, self.core.clock(), command.name)
                file = cast(TextIO, into)
        else:
            path, name, into = Path(command.path), str(command.path), None
            try:
                make_folder(path.parent, what="the recording")
                file = path.open("x", encoding="utf-8")
            except OSError as error:
                raise disk_trouble(error, "cannot write the recording to", path) from error
        with self.core.lock:
            try:
                self._recorder = Recorder(
                    case.pilot,
                    file,
                    case=key,
                    carina=VERSION,
                    now_s=self.core.clock(),
                    view=view_words(case.document, case.sight),
                    motion=_motion(case),
                    on_end=self._report_write_error,
                )
            except OSError as error:
                if path is not None:
                    with contextlib.suppress(OSError):
                        path.unlink()
                raise disk_trouble(error, "cannot write the recording to", path) from error
            self._path, self._name, self._recorded_case, self._into = path, name, case, into
            if into is not None:
                assert into.number is not None
                case.flights.unwritten = (*case.flights.unwritten, into)
                begun = RecordingFacts(into.number, name, "", into.begun_s, 0.0, complete=False)
                case.flights.listed = (*case.flights.listed, begun)
            if case.navigator.scope_state is not None:
                # A replay can only start from a scope that is in the lumen.
                self._holding.lay(case, case.navigator.scope_state.insertion_mm)
            self.core.changed("state", "flights")

    @does(c.StopRecording)
    def stop_command(self, _command: c.StopRecording) -> None:
        """Stop the recording; do nothing if there is none."""
        self.stop()

    def stop(self) -> Path | None:
        """Stop the recording, and return the path of its file; None without a recording or a file."""
        with self.core.lock:
            recorder, self._recorder = self._recorder, None
            if recorder is None:
                return None
            recorder.resume(self.core.clock())
            recorder.tick(self.core.clock())
            recorder.close()
            if recorder.trouble is None:
                flight = self._flight()
                if flight is None:
                    self.core.emit(UserMessage(f"{recorder.length_s:.0f} s recorded to {self._path}"))
                else:
                    self._store_recording(flight, recorder.length_s)
                    self.core.emit(UserMessage(f"{recorder.length_s:.0f} s recorded in the case: {flight.name}"))
                self.core.changed("state", "flights")
            # A closed case must not stay in memory.
            self._recorded_case = self._into = None
            return self._path

    def _store_recording(self, flight: RecordingFacts, length_s: float) -> None:
        assert self._recorded_case is not None
        ended = replace(flight, length_s=round(length_s, 6), complete=True)
        self._recorded_case.flights.listed = tuple(
            ended if one is flight else one for one in self._recorded_case.flights.listed
        )

    def _report_write_error(self, trouble: OSError) -> None:
        """Report that the recording's file can no longer be written; the tip can still be moved.

        The caller holds the lock.
        """
        self._recorder = None
        unchanged = f"the recording so far is in {self._path}"
        error = disk_trouble(trouble, "the recording stopped: cannot write to", self._path, unchanged=unchanged)
        self.core.emit(ErrorEvent(error.code, str(error)))
        self.core.changed("state")

    def tick(self, _case: OpenCase | None = None) -> None:
        """Record the current time before the tip moves; the caller holds the session's lock."""
        if self._recorder is not None:
            self._recorder.tick(self.core.clock())

    def note_view(self, case: OpenCase) -> None:
        """Record the view settings after a change of document or sight; the caller holds the session's lock."""
        if self._recorder is not None and self._recorded_case is case:
            self._recorder.note_view(view_words(case.document, case.sight), self.core.clock())
            self.note_breathing(case)

    def note_breathing(self, case: OpenCase) -> None:
        """Record the simulated breathing after a change; the caller holds the session's lock."""
        if self._recorder is not None and self._recorded_case is case:
            self._recorder.note_breathing(_motion(case), self.core.clock())


def _motion(case: OpenCase) -> ChestMotion | None:
    """Return the simulated breathing of a case on the session's clock; None without breathing."""
    airways = case.document.airways
    return None if airways is None else case.flights.breathing.motion(airways.tree)


def new_flight(case: OpenCase, now_s: float, name: str | None = None) -> tuple[str, RecordingWriter]:
    """Return the name and the writer of a new flight of a case; the caller holds the session's lock.

    Without a name, the flight is named by its number.
    """
    known = {one.recording_id for one in case.flights.listed}
    number = case.next_number("flight")
    while number in known:
        # A repaired file, or a file of another program, may have lost the last number.
        number = case.next_number("flight")
    name = name or f"Flight {number}"
    return name, RecordingWriter(name, max(0.0, now_s - case.begun_s), number=number)
