"""Groups of the jobs that one command starts; a caller can wait for the group and receive its errors."""

from __future__ import annotations

import contextlib
import contextvars
import threading
from collections.abc import Iterator

from carina.errors import CarinaError

# Jobs inherit this context, so jobs that a job starts belong to the same group.
_current: contextvars.ContextVar[JobGroup | None] = contextvars.ContextVar("job_group", default=None)


class JobGroup:
    """A command and all jobs that it starts, directly or through other jobs.

    Parameters
    ----------
    case_number
        Number of the case to which the command applies; the command is refused while another case is open. None
        allows any case.
    """

    def __init__(self, case_number: int | None = None) -> None:
        self.case_number = case_number
        self._changed = threading.Condition()
        self._num_running = 0
        self._errors: list[CarinaError] = []

    def __repr__(self) -> str:
        """Describe the group by its number of running jobs."""
        return f"JobGroup({self._num_running} jobs)"

    @contextlib.contextmanager
    def doing(self) -> Iterator[None]:
        """Add every job that is started in this context to the group."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def job_began(self) -> None:
        """Count one more running job of the group."""
        with self._changed:
            self._num_running += 1

    def job_ended(self, error: CarinaError | None) -> None:
        """Count a finished job and store its error."""
        with self._changed:
            self._num_running -= 1
            if error is not None:
                self._errors.append(error)
            self._changed.notify_all()

    def failed(self, error: CarinaError) -> None:
        """Store the error of a command that failed before it started a job."""
        with self._changed:
            self._errors.append(error)

    def wait(self) -> tuple[CarinaError, ...]:
        """Wait until no job of the group runs, and return the errors in the order in which they occurred."""
        with self._changed:
            self._changed.wait_for(lambda: not self._num_running)
            return tuple(self._errors)


def current_group() -> JobGroup | None:
    """Return the job group of the current context; None outside a group."""
    return _current.get()
