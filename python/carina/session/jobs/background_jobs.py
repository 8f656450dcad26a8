"""Background jobs with progress, estimated time left, cancellation, and a one-sentence error on failure."""

from __future__ import annotations

import contextvars
import ctypes
import itertools
import logging
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from carina.disk import disk_trouble, is_disk_trouble
from carina.display import one_line
from carina.errors import CancelledError, CarinaError
from carina.session.jobs.job_groups import current_group

logger = logging.getLogger(__name__)

STARTED_AGAIN = "the same job was started again, for example in another window"
CASE_CLOSED = "the case was closed"
OTHER_CASE = "another case was opened"


@cache
def _load_malloc_trim() -> Callable[[int], int] | None:
    if not sys.platform.startswith("linux"):
        return None
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):
        # C libraries other than glibc have no malloc_trim.
        return None


def return_freed_memory() -> None:
    """Return freed memory to the operating system (malloc_trim).

    After a large job glibc retains half a volume of freed memory, to which the next job would add. The call takes a
    few milliseconds.
    """
    trim = _load_malloc_trim()
    if trim is not None:
        trim(0)


Outcome = Literal["done", "cancelled", "failed"]


@one_line
@dataclass(frozen=True, slots=True)
class JobProgress:
    """Progress of a job; fraction and time left (s) are None if they are unknown."""

    job_id: str
    title: str
    what: str
    fraction: float | None
    seconds_left: float | None


@one_line
@dataclass(frozen=True, slots=True)
class JobEnded:
    """End of a job, with its outcome and error."""

    job_id: str
    title: str
    outcome: Outcome
    error: CarinaError | None


def log_fault(log: logging.Logger, words: str, trouble: BaseException) -> None:
    """Log an internal fault by type and line; log its message, which may name a file, only at DEBUG."""
    frames = traceback.extract_tb(trouble.__traceback__)
    place = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    log.error("%s: %s%s", words, type(trouble).__name__, place)
    log.debug("%s", words, exc_info=trouble)


def _fault_error(title: str, trouble: BaseException) -> CarinaError:
    log_fault(logger, f"a job failed: {title}", trouble)
    return CarinaError(f"{title} failed: internal error in Carina ({type(trouble).__name__})", code="carina.fault")


def _disk_or_memory_error(title: str, trouble: OSError) -> CarinaError:
    """Return a Carina error for an OSError of a job.

    Disk errors, such as a full disk, are not internal faults of Carina.
    """
    if is_disk_trouble(trouble):
        return disk_trouble(trouble, f"{title} failed", None)
    return _fault_error(title, trouble)


def _closing_error(title: str) -> CancelledError:
    return CancelledError(f"{title}: Carina is closing")


class Job:
    """A running background job; ``progress`` and ``cancel`` are passed to the function that does the work."""

    def __init__(self, job_id: str, title: str, kind: str, runner: JobRunner, *, of_case: bool = True) -> None:
        self.job_id = job_id
        self.title = title
        self.kind = kind
        self.of_case = of_case
        """Whether the job stops when the case is closed or another case is opened."""
        self._runner = runner
        self._cancelled = threading.Event()
        self.stop_reason: str | None = None
        """Reason why the job was stopped, as the end of a sentence; None for a running or cancelled job."""
        self._stage = ""
        self._began_s, self._began_at = 0.0, 0.0
        """Time in s and finished fraction at the start of the current stage.

        The time left is extrapolated from them.
        """
        self._reported_s = float("-inf")
        self.latest: JobProgress | None = None

    def cancel(self) -> bool:
        """Return whether the job was stopped; passed to long functions as ``cancel``."""
        return self._cancelled.is_set()

    def stop(self, reason: str | None = None) -> None:
        """Request the end of the job, which ends at its next check.

        Parameters
        ----------
        reason
            Reason as the end of a sentence for the user; None if the user cancelled the job.
        """
        if not self.cancel():
            self.stop_reason = reason
        self._cancelled.set()

    def check(self) -> None:
        """Raise CancelledError if the job was stopped.

        Raises
        ------
        CancelledError
            If :meth:`stop` was called.
        """
        if self.cancel():
            raise CancelledError(f"{self.title}: stopped")

    def restart_estimate(self) -> None:
        """Restart the estimate of the time left, because the work starts again."""
        self._stage = ""

    def progress(self, what: str, fraction: float | None) -> None:
        """Record the progress; listeners receive it at most ten times a second."""
        self.check()
        now_s = self._runner.clock()
        if what != self._stage:
            before = None if self.latest is None or self._stage == "" else self.latest.fraction
            # If the fraction continues from the previous stage, it is a fraction of the whole job.
            if before is None or fraction is None or fraction < before:
                self._began_s, self._began_at = now_s, fraction or 0.0
            self._stage, self._reported_s = what, float("-inf")
        left_s: float | None = None
        if fraction is not None:
            fraction = min(1.0, max(0.0, fraction))
            # With less than 5 % of the work done the estimate of the time left would be too noisy.
            done = fraction - self._began_at
            if done >= 0.05:
                left_s = (now_s - self._began_s) * (1.0 - fraction) / done
        self.latest = JobProgress(self.job_id, self.title, what, fraction, left_s)
        if now_s - self._reported_s >= 0.1:
            self._reported_s = now_s
            self._runner.notify(self.latest)


class JobRunner:
    """Runner of background jobs, which reports their progress and end.

    A new job stops a running job of the same kind.

    Parameters
    ----------
    submit
        Runs a function in the background, such as a thread pool does.
    notify
        Called with each report of progress or end.
    clock
        Returns time in seconds.
    """

    def __init__(
        self,
        submit: Callable[[Callable[[], None]], object],
        notify: Callable[[JobProgress | JobEnded], None],
        clock: Callable[[], float],
    ) -> None:
        self._submit = submit
        self.notify = notify
        self.clock = clock
        self._lock = threading.Lock()
        self._jobs: dict[str, Job] = {}
        self._numbers = itertools.count(1)
        self._idle = threading.Condition(self._lock)
        self._closed = False

    @property
    def running(self) -> tuple[Job, ...]:
        """Jobs that were started and have not ended."""
        with self._lock:
            return tuple(self._jobs.values())

    def start(self, kind: str, title: str, work: Callable[[Job], None], *, of_case: bool = True) -> str:
        """Start a job, and return its ID.

        Parameters
        ----------
        kind
            Kind of the job; a running job of this kind is stopped.
        title
            Title for the user.
        work
            Function that does the work; it raises CarinaError to report a failure to the user.
        of_case
            Whether the job stops when the case is closed or another case is opened.

        Returns
        -------
        str
            ID of the job.

        Raises
        ------
        CancelledError
            If Carina is closing.
        """
        with self._lock:
            if self._closed:
                raise _closing_error(title)
            for other in self._jobs.values():
                if other.kind == kind:
                    other.stop(STARTED_AGAIN)
            job = Job(f"job-{next(self._numbers)}", title, kind, self, of_case=of_case)
            self._jobs[job.job_id] = job
        # The job inherits the context of the caller, such as the current command.
        context = contextvars.copy_context()
        job_group = current_group()
        if job_group is not None:
            job_group.job_began()
        try:
            self._submit(lambda: context.run(self._run, job, work))
        except RuntimeError:
            # The worker threads have ended since the check of _closed.
            if job_group is not None:
                job_group.job_ended(None)
            if not self._closed:
                raise
            with self._idle:
                self._jobs.pop(job.job_id, None)
                self._idle.notify_all()
            raise _closing_error(title) from None
        return job.job_id

    def close(self) -> None:
        """Stop all jobs and refuse new ones."""
        with self._lock:
            self._closed = True
        for job in self.running:
            job.stop(CASE_CLOSED)

    def cancel(self, job_id: str) -> bool:
        """Stop a job; return False if no job has this ID."""
        with self._lock:
            job = self._jobs.get(job_id)
        if job is not None:
            job.stop()
        return job is not None

    def is_stopping(self, job_id: str) -> bool:
        """Return whether a job was requested to stop and has not ended yet."""
        with self._lock:
            job = self._jobs.get(job_id)
        return job is not None and job.cancel()

    def cancel_kinds(self, *kinds: str) -> None:
        """Stop the jobs of these kinds; without kinds stop all jobs of the case, because the case is closed."""
        for job in self.running:
            if job.kind in kinds or (not kinds and job.of_case):
                job.stop(None if kinds else CASE_CLOSED)

    def cancel_others(self, than: Job) -> None:
        """Request all jobs of the case except ``than``, which opens another case, to stop."""
        for job in self.running:
            if job is not than and job.of_case:
                job.stop(OTHER_CASE)

    def wait_idle(self, timeout_s: float | None) -> bool:
        """Wait until no job runs; return False after ``timeout_s`` seconds. With None, wait without limit."""
        with self._idle:
            return self._idle.wait_for(lambda: not self._jobs, timeout_s)

    def _run(self, job: Job, work: Callable[[Job], None]) -> None:
        outcome: Outcome = "done"
        error: CarinaError | None = None
        try:
            # A job that was stopped before its start also runs, ends at its first check, and cleans up as after any
            # stop.
            work(job)
        except CancelledError:
            outcome = "cancelled"
        except CarinaError as exc:
            outcome, error = "failed", exc
        except OSError as exc:
            outcome, error = "failed", _disk_or_memory_error(job.title, exc)
        except BaseException as exc:
            # BaseException, because a panic of the compiled module is not an Exception; every job must report its end.
            outcome, error = "failed", _fault_error(job.title, exc)
        return_freed_memory()
        job_group = current_group()
        if job_group is not None:
            # The result is stored before the runner becomes idle, so that a thread that waits for idle finds it.
            job_group.job_ended(error)
        with self._idle:
            self._jobs.pop(job.job_id, None)
            self._idle.notify_all()
        self.notify(JobEnded(job.job_id, job.title, outcome, error))
