"""Values that follow from others: made by a job or on the spot, and never given for inputs that are not theirs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Generic, Literal, TypeVar

from carina.errors import CancelledError
from carina.session.jobs import Job, JobRunner

__all__ = ["Attempt", "Cached", "Derived", "Standing", "identical"]

Inputs = TypeVar("Inputs")
Value = TypeVar("Value")

Standing = Literal["unwanted", "making", "had", "failed", "stopped"]


def identical(a: Any, b: Any) -> bool:
    """The same object; tuples by their items. What is large is immutable, and another object is another value."""
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(identical(x, y) for x, y in zip(a, b, strict=True))
    return a is b


class Attempt(Generic[Value]):
    """What a function that makes a value is given beside its inputs: whom to tell how far it is, and when to stop.

    Parameters
    ----------
    job
        The job that it runs in.
    is_stale
        Whether other inputs are wanted by now.
    before
        The newest value, of other inputs; None where there is none. What has not changed since may be taken from it.
    """

    def __init__(self, job: Job, is_stale: Callable[[], bool], before: Value | None) -> None:
        self._job = job
        self._is_stale = is_stale
        self._was_stale = False
        self.before = before

    def is_stale(self) -> bool:
        """Whether other inputs are wanted, or were when this was asked before: whoever heard it may have given up."""
        self._was_stale = self._was_stale or self._is_stale()
        return self._was_stale

    def cancel(self) -> bool:
        """Whether to stop: what long functions ask as ``cancel()``."""
        return self._job.cancel() or self.is_stale()

    def check(self) -> None:
        """Raise CancelledError if it is to stop."""
        self._job.check()
        if self.is_stale():
            raise CancelledError(f"{self._job.title}: restarting")

    def progress(self, what: str, fraction: float | None) -> None:
        """Tell how far it is, and :meth:`check`."""
        self.check()
        self._job.progress(what, fraction)


class Derived(Generic[Inputs, Value]):
    """A value that a job makes from inputs, for those that are wanted now.

    There is one job, however often the inputs change: a change makes what it works on stale, and the same job begins
    again with the newest. What failed or was stopped by a person is not tried again until the inputs change or
    :meth:`again` is called.

    Parameters
    ----------
    jobs
        Runs the job, and tells its progress and its end.
    lock
        The session's; reentrant. It is not held while a value is made, and always while something here changes.
    kind, title
        Of the job; no other job has this kind.
    make
        Makes the value in the background, and asks :class:`Attempt` whether to stop.
    same
        Whether two inputs are the same.
    settled
        Called with the session locked, when the wanted value is had, or will not come: it failed or was stopped.
    """

    def __init__(
        self,
        jobs: JobRunner,
        lock: AbstractContextManager[Any],
        *,
        kind: str,
        title: str,
        make: Callable[[Inputs, Attempt[Value]], Value],
        same: Callable[[Inputs, Inputs], bool] = identical,
        settled: Callable[[], None] = lambda: None,
    ) -> None:
        self._jobs = jobs
        self._lock = lock
        self._kind = kind
        self._title = title
        self._make = make
        self._same = same
        self._settled = settled
        self._wanted: Inputs | None = None
        self._then: Callable[[Value], None] | None = None
        self._had: tuple[Inputs, Value] | None = None
        self._came_to: Literal["open", "failed", "stopped"] = "open"
        """How it ended for the wanted inputs without a value."""
        self._error: BaseException | None = None
        self._runs = False
        self._job_id = ""
        self._wanted_after_stop = False
        """Other inputs were wanted after a person stopped the job, and before it ended."""
        self._discarded = False

    def __repr__(self) -> str:
        with self._lock:
            standing = "unwanted" if self._wanted is None else self.standing(self._wanted)
            return f"Derived({self._kind!r}, {standing})"

    # ------------------------------------------------------------ what is asked

    def of(self, inputs: Inputs | None) -> Value | None:
        """The value of these inputs; None where it has not been made."""
        with self._lock:
            had = self._had
            return had[1] if had is not None and self._is(inputs, had[0]) else None

    def standing(self, inputs: Inputs) -> Standing:
        """What has become of these inputs."""
        with self._lock:
            if self._had is not None and self._is(inputs, self._had[0]):
                return "had"
            if not self._is(inputs, self._wanted):
                return "unwanted"
            return "making" if self._came_to == "open" else self._came_to

    @property
    def error(self) -> BaseException | None:
        """Why the wanted value failed."""
        with self._lock:
            return self._error

    # ------------------------------------------------------------ what is said

    def want(self, inputs: Inputs | None, then: Callable[[Value], None] | None = None) -> None:
        """Have the value made of these inputs, unless that is so or was tried; None wants nothing any more.

        Parameters
        ----------
        inputs
            Not changed afterwards.
        then
            Done once, with the session locked, when the value is had: at once if it is. Forgotten if it will not come.

        Raises
        ------
        CancelledError
            If Carina is closing.
        """
        with self._lock:
            if self._discarded:
                return
            if not self._is(inputs, self._wanted):
                self._wanted_after_stop = self._is_stopping()
                self._wanted, self._then = inputs, None
                self._came_to, self._error = "open", None
            had = self._had
            if then is not None and had is not None and self._is(inputs, had[0]):
                then(had[1])
            elif then is not None and self._came_to == "open":
                self._then = then
            self._begin()

    def again(self) -> None:
        """Forget that it failed or was stopped, since a person asks: whoever wants it next has it tried again."""
        with self._lock:
            self._came_to, self._error = "open", None
            self._wanted_after_stop = self._wanted_after_stop or self._is_stopping()

    def discard(self) -> None:
        """Stop, and hold nothing any more: the case is closed."""
        with self._lock:
            self._discarded = True
            self._wanted = self._then = self._had = self._error = None

    # ------------------------------------------------------------ the job

    def _is(self, a: Inputs | None, b: Inputs | None) -> bool:
        return a is b or (a is not None and b is not None and self._same(a, b))

    def _is_stale(self, inputs: Inputs) -> bool:
        """Asked without the lock, as often as a kernel likes."""
        return self._wanted is not inputs

    def _is_open(self) -> bool:
        """Whether the wanted value is still to be made."""
        had = self._had is not None and self._is(self._wanted, self._had[0])
        return self._wanted is not None and not had and self._came_to == "open"

    def _is_stopping(self) -> bool:
        return self._runs and self._jobs.is_stopping(self._job_id)

    def _begin(self) -> None:
        if self._runs or not self._is_open():
            return
        # Before the start: a background that runs at once has ended when it returns.
        self._runs, self._wanted_after_stop = True, False
        try:
            job_id = self._jobs.start(self._kind, self._title, self._run)
        except BaseException:
            self._runs = False
            raise
        if self._runs:
            self._job_id = job_id

    def _run(self, job: Job) -> None:
        attempt: Attempt[Value] | None = None
        ended = False
        try:
            while True:
                with self._lock:
                    job.check()
                    inputs = self._wanted
                    if inputs is None or not self._is_open():
                        raise CancelledError(f"{self._title}: no longer needed")
                    before = None if self._had is None else self._had[1]
                    attempt = Attempt(job, partial(self._is_stale, inputs), before)
                job.begin_again()
                try:
                    value = self._make(inputs, attempt)
                except CancelledError:
                    if not attempt.is_stale():
                        raise
                    # Not stopped, or not that alone: newer inputs are wanted.
                    continue
                with self._lock:
                    job.check()
                    if not attempt.is_stale():
                        self._had, ended, self._runs = (inputs, value), True, False
                        then, self._then = self._then, None
                        self._settled()
                        if then is not None:
                            then(value)
                        return
        except BaseException as trouble:
            with self._lock:
                if not ended:
                    self._give_up(job, attempt, trouble)
            raise

    def _give_up(self, job: Job, attempt: Attempt[Value] | None, trouble: BaseException) -> None:
        """The job ends without the value; with the session locked."""
        self._runs = False
        if not self._is_open():
            return
        newer = self._wanted_after_stop if job.cancel() else attempt is not None and attempt.is_stale()
        if newer:
            # What was wanted after the stop, or while something else failed, is another matter.
            self._begin()
            return
        stopped = isinstance(trouble, CancelledError)
        self._came_to, self._error = ("stopped", None) if stopped else ("failed", trouble)
        self._then = None
        self._settled()


class Cached(Generic[Inputs, Value]):
    """A value that is made on the spot when it is asked for, and kept for the newest inputs. Not locked by itself.

    Parameters
    ----------
    make
        Makes the value; quick.
    same
        Whether two inputs are the same.
    """

    def __init__(self, make: Callable[[Inputs], Value], *, same: Callable[[Inputs, Inputs], bool] = identical) -> None:
        self._make = make
        self._same = same
        self._had: tuple[Inputs, Value] | None = None

    def __repr__(self) -> str:
        return f"Cached({'nothing' if self._had is None else type(self._had[1]).__name__})"

    def of(self, inputs: Inputs) -> Value:
        """The value of these inputs, as it was or made anew."""
        if self._had is None or not self._same(inputs, self._had[0]):
            self._had = (inputs, self._make(inputs))
        return self._had[1]

    def is_of_others(self, inputs: Inputs) -> bool:
        """Whether what is kept was made from other inputs."""
        return self._had is not None and not self._same(inputs, self._had[0])

    def forget(self) -> None:
        """Keep nothing."""
        self._had = None
