"""What was asked for, with all jobs that go on with it: whoever asked waits for these, and hears their trouble."""

from __future__ import annotations

import contextlib
import contextvars
import threading
from collections.abc import Iterator

from carina.errors import CarinaError

__all__ = ["Errand", "current_errand"]

# Goes along into the jobs that are started meanwhile, and into those that they start.
_current: contextvars.ContextVar[Errand | None] = contextvars.ContextVar("errand", default=None)


class Errand:
    """Something that was asked for, and the jobs that go on with it: those that it starts, and those that these start.

    Parameters
    ----------
    case_number
        The case that it is about: with another one open it is refused, never done to that one. None is any case.
    """

    def __init__(self, case_number: int | None = None) -> None:
        self.case_number = case_number
        self._changed = threading.Condition()
        self._num_running = 0
        self._errors: list[CarinaError] = []

    def __repr__(self) -> str:
        return f"Errand({self._num_running} jobs)"

    @contextlib.contextmanager
    def doing(self) -> Iterator[None]:
        """What is started here belongs to it."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def job_began(self) -> None:
        """A job goes on with it."""
        with self._changed:
            self._num_running += 1

    def job_ended(self, error: CarinaError | None) -> None:
        """One of them has ended."""
        with self._changed:
            self._num_running -= 1
            if error is not None:
                self._errors.append(error)
            self._changed.notify_all()

    def failed(self, error: CarinaError) -> None:
        """Something was refused at once."""
        with self._changed:
            self._errors.append(error)

    def wait(self) -> tuple[CarinaError, ...]:
        """Wait until no job goes on with it; the trouble that there was, in its order."""
        with self._changed:
            self._changed.wait_for(lambda: not self._num_running)
            return tuple(self._errors)


def current_errand() -> Errand | None:
    """What is being done now; None where nobody waits for it."""
    return _current.get()
