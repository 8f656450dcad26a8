"""Values that are computed from inputs, by a job or immediately, and returned only for exactly these inputs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Generic, Literal, TypeVar

from carina.errors import CancelledError
from carina.session.jobs.background_jobs import Job, JobRunner

Inputs = TypeVar("Inputs")
Value = TypeVar("Value")

Standing = Literal["unwanted", "making", "had", "failed", "stopped"]


def identical(a: Any, b: Any) -> bool:
    """Return whether two values are the same object, or tuples of the same objects.

    Large values are immutable, so a different object is treated as a different value.
    """
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(identical(x, y) for x, y in zip(a, b, strict=True))
    return a is b


class Attempt(Generic[Value]):
    """Progress and cancellation of one computation, passed to the function that computes a value.

    Parameters
    ----------
    job
        The job in which the function runs.
    is_stale
        Returns whether a value of other inputs has been requested since.
    before
        The newest value of other inputs, from which unchanged parts may be reused; None if there is none.
    """

    def __init__(self, job: Job, is_stale: Callable[[], bool], before: Value | None) -> None:
        self._job = job
        self._is_stale = is_stale
        self._was_stale = False
        self.before = before

    def is_stale(self) -> bool:
        """Return whether inputs other than those of this attempt were requested at any time since its start."""
        self._was_stale = self._was_stale or self._is_stale()
        return self._was_stale

    def cancel(self) -> bool:
        """Return whether the computation should stop; long functions receive this method as ``cancel``."""
        return self._job.cancel() or self.is_stale()

    def check(self) -> None:
        """Raise CancelledError if the computation should stop."""
        self._job.check()
        if self.is_stale():
            raise CancelledError(f"{self._job.title}: restarting")

    def progress(self, what: str, fraction: float | None) -> None:
        """Report the progress, and raise CancelledError if the computation should stop."""
        self.check()
        self._job.progress(what, fraction)


class Derived(Generic[Inputs, Value]):
    """A value that a background job computes from the inputs that were requested last.

    At most one job runs, however often the inputs change: a change makes the running computation stale, and the same
    job starts again with the newest inputs. A computation that failed or that the user stopped is not repeated until
    the inputs change or :meth:`again` is called.

    Parameters
    ----------
    jobs
        Runs the job, and reports its progress and its end.
    lock
        The session's reentrant lock. It is not held while a value is computed, and is held during every change of
        this object.
    kind, title
        Kind and title of the job; the kind must be unique.
    make
        Computes the value in the background, and calls :class:`Attempt` to learn whether to stop.
    same
        Returns whether two inputs are the same.
    settled
        Called with the session locked when the requested value is available, failed or was stopped.
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
        self._outcome: Literal["open", "failed", "stopped"] = "open"
        """Status of the computation for the requested inputs while it has no result."""
        self._error: BaseException | None = None
        self._runs = False
        self._job_id = ""
        self._requested_after_stop = False
        """Whether other inputs were requested after the user stopped the job and before the job ended."""
        self._discarded = False

    def __repr__(self) -> str:
        """Return the kind of the value and the status of its computation for the requested inputs."""
        with self._lock:
            return f"Derived({self._kind!r}, {self.standing(self._wanted)})"

    # ------------------------------------------------------------ state

    def of(self, inputs: Inputs | None) -> Value | None:
        """Return the value that was computed from these inputs; None if the newest computed value has other inputs."""
        with self._lock:
            had = self._had
            return had[1] if had is not None and self._are_same(inputs, had[0]) else None

    def standing(self, inputs: Inputs | None) -> Standing:
        """Return whether the value of these inputs is computed, in progress, failed or stopped.

        The status is *had* (available), *making*, *failed*, *stopped* or *unwanted* (not requested, or no inputs).
        """
        with self._lock:
            if inputs is None:
                return "unwanted"
            if self._had is not None and self._are_same(inputs, self._had[0]):
                return "had"
            if not self._are_same(inputs, self._wanted):
                return "unwanted"
            return "making" if self._outcome == "open" else self._outcome

    @property
    def error(self) -> BaseException | None:
        """The error of the computation for the requested inputs; None if it did not fail."""
        with self._lock:
            return self._error

    # ------------------------------------------------------------ requests

    def want(self, inputs: Inputs | None, then: Callable[[Value], None] | None = None) -> None:
        """Request the value of these inputs, and compute it unless it is available, failed or was stopped.

        Parameters
        ----------
        inputs
            The inputs, which must not change afterwards; None withdraws the request.
        then
            Called once with the session locked when the value is available, at once if it already is. Not called if the
            value fails or is stopped, or if other inputs are requested.

        Raises
        ------
        CancelledError
            If Carina is closing.
        """
        with self._lock:
            if self._discarded:
                return
            if not self._are_same(inputs, self._wanted):
                self._requested_after_stop = self._is_stopping()
                self._wanted, self._then = inputs, None
                self._outcome, self._error = "open", None
            had = self._had
            if then is not None and had is not None and self._are_same(inputs, had[0]):
                then(had[1])
            elif then is not None and self._outcome == "open":
                self._then = then
            self._start_job()

    def again(self) -> None:
        """Allow a failed or stopped computation to run again at the next request, because the user requested it."""
        with self._lock:
            self._outcome, self._error = "open", None
            self._requested_after_stop = self._requested_after_stop or self._is_stopping()

    def discard(self) -> None:
        """Stop the computation and release all values, because the case is being closed."""
        with self._lock:
            self._discarded = True
            self._wanted = self._then = self._had = self._error = None

    # ------------------------------------------------------------ the job

    def _are_same(self, a: Inputs | None, b: Inputs | None) -> bool:
        return a is b or (a is not None and b is not None and self._same(a, b))

    def _is_stale(self, inputs: Inputs) -> bool:
        """Return whether the requested inputs differ from these.

        Called without the lock, because kernels call it often.
        """
        return self._wanted is not inputs

    def _is_open(self) -> bool:
        """Return whether the requested value is still to be computed."""
        had = self._had is not None and self._are_same(self._wanted, self._had[0])
        return self._wanted is not None and not had and self._outcome == "open"

    def _is_stopping(self) -> bool:
        return self._runs and self._jobs.is_stopping(self._job_id)

    def _start_job(self) -> None:
        if self._runs or not self._is_open():
            return
        # The flag is set before the start, because a job that runs synchronously has ended when start() returns.
        self._runs, self._requested_after_stop = True, False
        try:
            job_id = self._jobs.start(self._kind, self._title, self._run_job)
        except BaseException:
            self._runs = False
            raise
        if self._runs:
            self._job_id = job_id

    def _run_job(self, job: Job) -> None:
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
                job.restart_estimate()
                try:
                    value = self._make(inputs, attempt)
                except CancelledError:
                    if not attempt.is_stale():
                        raise
                    # A newer request has cancelled this computation; the loop computes the value of the newer inputs.
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
        except BaseException as error:
            with self._lock:
                if not ended:
                    self._end_without_value(job, attempt, error)
            raise

    def _end_without_value(self, job: Job, attempt: Attempt[Value] | None, trouble: BaseException) -> None:
        """End the computation without a value; the caller holds the session's lock."""
        self._runs = False
        if not self._is_open():
            return
        newer = self._requested_after_stop if job.cancel() else attempt is not None and attempt.is_stale()
        if newer:
            # A request after the stop or during the failed computation gets its own attempt.
            self._start_job()
            return
        stopped = isinstance(trouble, CancelledError)
        self._outcome, self._error = ("stopped", None) if stopped else ("failed", trouble)
        self._then = None
        self._settled()


class Cached(Generic[Inputs, Value]):
    """A value that is computed at once when it is requested, and cached for the newest inputs; not locked.

    Parameters
    ----------
    make
        Computes the value; must be quick.
    same
        Returns whether two inputs are the same.
    """

    def __init__(self, make: Callable[[Inputs], Value], *, same: Callable[[Inputs, Inputs], bool] = identical) -> None:
        self._make = make
        self._same = same
        self._had: tuple[Inputs, Value] | None = None

    def __repr__(self) -> str:
        """Describe the cached value by its type."""
        return f"Cached({'nothing' if self._had is None else type(self._had[1]).__name__})"

    def of(self, inputs: Inputs) -> Value:
        """Return the value for given inputs, from the cache or newly computed."""
        if self._had is None or not self._same(inputs, self._had[0]):
            self._had = (inputs, self._make(inputs))
        return self._had[1]

    def known(self, inputs: Inputs) -> Value | None:
        """Return the cached value if it was computed from these inputs; None otherwise."""
        return self._had[1] if self._had is not None and self._same(inputs, self._had[0]) else None

    def has_other_inputs(self, inputs: Inputs) -> bool:
        """Return whether the cached value was computed from other inputs."""
        return self._had is not None and not self._same(inputs, self._had[0])

    def forget(self) -> None:
        """Delete the cached value."""
        self._had = None
