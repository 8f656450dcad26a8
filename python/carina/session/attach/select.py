"""Cases of notebooks and scripts: opened in the process of the program, or joined in a running Carina."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from carina.commands import Command, CurrentMoment, OpenPath, OpenVolume, UnstoredFlights
from carina.session.attach.working_copy import NamedCase
from carina.session.jobs.job_groups import JobGroup
from carina.session.session import Session
from carina.session.store.find_scan import is_case_file
from carina.volume import Volume


class ProgramCase(Protocol):
    """Interface of the cases that :class:`carina.Case` uses: cases of this process and joined cases."""

    @property
    def session(self) -> Session:
        """The session with the current state of the case."""

    @property
    def path(self) -> Path | None:
        """Path of the case file; None if the case has no file yet."""

    @property
    def note(self) -> str | None:
        """Reason why the case cannot be saved to its file; None if it can."""

    def do(self, command: Command) -> None:
        """Run a command in the session that owns the case, and wait for the command's jobs."""

    def save(self, path: str | Path | None, *, replace: bool) -> Path:
        """Write the case to one file, and return the path."""

    def close(self) -> None:
        """Save the case to its file, stop its jobs, and release its memory.

        Raises
        ------
        DiskError, UnsavedWorkError
            If the file cannot be written; the case is closed nevertheless.
        """


class LocalCase:
    """A case that only this process uses: its session, and the file to which it is saved."""

    def __init__(self) -> None:
        self._session = program_session()
        self._named = NamedCase()

    def open(self, source: str | Path | Volume, ct: str | Path | None) -> None:
        """Open a CT or a case file (see :meth:`carina.Case.open`)."""
        if isinstance(source, Volume):
            self.do(OpenVolume(source))
        elif is_case_file(source):
            self.do(OpenVolume(*self._named.open(Path(source).expanduser(), ct)))
        else:
            self.do(OpenPath(str(source)))
            self._named.set_ct_path(source)

    @property
    def session(self) -> Session:
        """The session of the case in this process."""
        return self._session

    @property
    def path(self) -> Path | None:
        """Path from which the case was opened or to which it was saved; None without one."""
        return self._named.path

    @property
    def note(self) -> str | None:
        """Reason why the case cannot be saved to its file; None if it can."""
        return self._named.note

    def do(self, command: Command) -> None:
        """Run a command in this process, and wait until the command and its jobs have ended."""
        do_and_wait(self._session, command)

    def save(self, path: str | Path | None, *, replace: bool) -> Path:
        """Write the case to ``path``, or to its file if ``path`` is None."""
        moment, case = self._session.ask(CurrentMoment()), self._session.snapshot().case
        assert case is not None
        flights = self._session.ask(UnstoredFlights())
        return self._named.save(case.volume, moment, path, replace=replace, flights=flights)

    def close(self) -> None:
        """Save the case to its file if it has unsaved changes, then close the session and the file."""
        try:
            case = self._session.snapshot().case
            if case is not None:
                moment = self._session.ask(CurrentMoment())
                self._named.check_saved(moment)
                if self._named.lacks_changes(moment):
                    self._named.save_at_end(case.volume, moment, self._session.ask(UnstoredFlights()))
        finally:
            self._session.close()
            self._named.close()


def program_session(**options: object) -> Session:
    """Create a session whose renderer runs in this process."""
    from carina.render import Renderer

    return Session(lambda volume, transfer: Renderer(volume, transfer=transfer), **options)  # type: ignore[arg-type]


def do_and_wait(session: Session, command: Command) -> None:
    """Run a command, and wait until no job runs any more.

    Raises
    ------
    CarinaError
        The error of the command, or of the first of its jobs that failed.
    """
    job_group = JobGroup()
    with job_group.doing():
        session.do(command)
    session.jobs.wait_idle(None)
    for error in job_group.wait():
        raise error
