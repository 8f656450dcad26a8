"""Recording a flight."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TextIO, cast

from carina import commands as c
from carina.case.recordings import RecordingWriter
from carina.disk import disk_trouble, make_folder
from carina.errors import UsageError
from carina.navigate import Recorder, case_key
from carina.session.case import OpenCase
from carina.session.core import SessionCore
from carina.session.flying import view_words
from carina.session.holding import ScopeHolding
from carina.session.snapshot import Said, Trouble
from carina.session.subject import Subject, does
from carina.version import VERSION

__all__ = ["FlightRecording"]


class FlightRecording(Subject):
    """Every move of the tip, until it is stopped or the case is closed."""

    def __init__(self, core: SessionCore, holding: ScopeHolding) -> None:
        super().__init__(core)
        self._holding = holding
        self._recorder: Recorder | None = None
        self._path: Path | None = None
        self._name = ""
        self._recorded_case: OpenCase | None = None
        core.before_move = self.tick

    @property
    def path(self) -> Path | None:
        """The file that is being recorded to; None where that is the case's."""
        return self._path if self._recorder is not None else None

    @property
    def name(self) -> str | None:
        """The file that is being recorded to, or what the recording is called in the case; None while there is none."""
        return self._name if self._recorder is not None else None

    @does(c.RecordFlight)
    def start(self, command: c.RecordFlight) -> None:
        """Begin, in the mode that the tip is in.

        Raises
        ------
        UsageError
            ``session.recording``: if one is being made, or a case that is not kept is to hold it.
        CarinaError
            ``machine``: if the file cannot be written.
        """

        case = self.core.needed_case()
        if self._recorder is not None:
            raise UsageError("a recording is already running; stop it first", code="session.recording")
        if command.path is None and not self.core.saving().keeps:
            raise UsageError(
                "this case is not kept on this machine: save the recording to a file instead", code="session.recording"
            )
        key = case_key(case.info.volume)
        file: TextIO
        if command.path is None:
            path = None
            with self.core.lock:
                name = f"Flight {case.next_number('flight')}"
                into = RecordingWriter(name, max(0.0, self.core.clock() - case.begun_s))
                file = cast(TextIO, into)
        else:
            path, name, into = Path(command.path), str(command.path), None
            try:
                make_folder(path.parent, what="the recording")
                file = path.open("x", encoding="utf-8")
            except OSError as trouble:
                raise disk_trouble(trouble, "cannot write the recording to", path) from trouble
        with self.core.lock:
            try:
                self._recorder = Recorder(
                    case.pilot,
                    file,
                    case=key,
                    carina=VERSION,
                    now_s=self.core.clock(),
                    view=view_words(case.document, case.sight),
                    on_end=self._ended,
                )
            except OSError as trouble:
                if path is not None:
                    with contextlib.suppress(OSError):
                        path.unlink()
                raise disk_trouble(trouble, "cannot write the recording to", path) from trouble
            self._path, self._name, self._recorded_case = path, name, case
            if into is not None:
                case.recorded = (*case.recorded, into)
            if case.navigator.scope_state is not None:
                # A replay begins with the scope laid anew, so that it can begin at all.
                self._holding.lay(case, case.navigator.scope_state.insertion_mm)
            self.core.changed("state")

    @does(c.StopRecording)
    def stop_command(self, _command: c.StopRecording) -> None:
        """Nothing where there is none."""
        self.stop()

    def stop(self) -> Path | None:
        """End the recording; returns where it is, None where there is none."""
        with self.core.lock:
            recorder, self._recorder = self._recorder, None
            if recorder is None:
                return None
            recorder.tick(self.core.clock())
            recorder.close()
            if recorder.trouble is None:
                if self._path is None:
                    self.core.emit(Said(f"{recorder.length_s:.0f} s recorded in the case: {self._name}"))
                else:
                    self.core.emit(Said(f"{recorder.length_s:.0f} s recorded to {self._path}"))
                self.core.changed("state")
            return self._path

    def _ended(self, trouble: OSError) -> None:
        """The file cannot be written any more, with the session locked; the flight goes on."""
        self._recorder = None
        kept = f"the recording so far is in {self._path}"
        told = disk_trouble(trouble, "the recording stopped: cannot write to", self._path, unchanged=kept)
        self.core.emit(Trouble(told.code, str(told)))
        self.core.changed("state")

    def tick(self, _case: OpenCase | None = None) -> None:
        """Before a move, with the session locked: the time of what follows."""
        if self._recorder is not None:
            self._recorder.tick(self.core.clock())

    def note_view(self, case: OpenCase) -> None:
        """After a change of document or sight, with the session locked."""
        if self._recorder is not None and self._recorded_case is case:
            self._recorder.note_view(view_words(case.document, case.sight), self.core.clock())
