"""Long work in the background: progress with time left, cancelling, one sentence when it fails."""

from __future__ import annotations

import contextvars
import itertools
import logging
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from carina.disk import disk_trouble, is_disk_trouble
from carina.display import one_line
from carina.errors import CancelledError, CarinaError
from carina.session.errands import current_errand
from carina.session.freed import give_freed_memory_back

__all__ = ["Job", "JobEnded", "JobProgress", "JobRunner", "log_fault"]

logger = logging.getLogger(__name__)

Outcome = Literal["done", "cancelled", "failed"]


@one_line
@dataclass(frozen=True, slots=True)
class JobProgress:
    """How far a job is; fraction and time left are None where they cannot be known."""

    job_id: str
    title: str
    what: str
    fraction: float | None
    seconds_left: float | None


@one_line
@dataclass(frozen=True, slots=True)
class JobEnded:
    """A job has ended."""

    job_id: str
    title: str
    outcome: Outcome
    error: CarinaError | None


def log_fault(log: logging.Logger, words: str, trouble: BaseException) -> None:
    """Log a fault of ours by kind and place; its message, which may name a file, only at DEBUG."""
    frames = traceback.extract_tb(trouble.__traceback__)
    place = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    log.error("%s: %s%s", words, type(trouble).__name__, place)
    log.debug("%s", words, exc_info=trouble)


def _fault(title: str, trouble: BaseException) -> CarinaError:
    log_fault(logger, f"a job failed: {title}", trouble)
    return CarinaError(f"{title} failed: internal error in Carina ({type(trouble).__name__})", code="carina.fault")


def _of_machine(title: str, trouble: OSError) -> CarinaError:
    """A full disk, a lost permission or too many open files are no fault of Carina."""
    if is_disk_trouble(trouble):
        return disk_trouble(trouble, f"{title} failed", None)
    return _fault(title, trouble)


def _closing(title: str) -> CancelledError:
    return CancelledError(f"{title}: Carina is closing")


class Job:
    """One running piece of work; ``progress`` and ``cancel`` are handed to the function that does it."""

    def __init__(self, job_id: str, title: str, kind: str, runner: JobRunner) -> None:
        self.job_id = job_id
        self.title = title
        self.kind = kind
        self._runner = runner
        self._cancelled = threading.Event()
        self._stage = ""
        self._began_s, self._began_at = 0.0, 0.0
        """When, and at what share, began what the time left is guessed from."""
        self._told_s = float("-inf")
        self.latest: JobProgress | None = None

    def cancel(self) -> bool:
        """Whether the person stopped it: what long functions ask as ``cancel()``."""
        return self._cancelled.is_set()

    def stop(self) -> None:
        """Ask it to stop; it ends at its next look."""
        self._cancelled.set()

    def check(self) -> None:
        """Raise if it was stopped.

        Raises
        ------
        CancelledError
            If :meth:`stop` was called.
        """
        if self.cancel():
            raise CancelledError(f"{self.title}: stopped")

    def begin_again(self) -> None:
        """What comes begins anew: time left is not guessed from what was done before."""
        self._stage = ""

    def progress(self, what: str, fraction: float | None) -> None:
        """Note how far it is; told to listeners at most ten times a second."""
        self.check()
        now_s = self._runner.clock()
        if what != self._stage:
            before = None if self.latest is None or self._stage == "" else self.latest.fraction
            # A share that goes on from that of the stage before is a share of the whole.
            if before is None or fraction is None or fraction < before:
                self._began_s, self._began_at = now_s, fraction or 0.0
            self._stage, self._told_s = what, float("-inf")
        left_s: float | None = None
        if fraction is not None:
            fraction = min(1.0, max(0.0, fraction))
            # Of less than 5 % done the guess would be noise.
            done = fraction - self._began_at
            if done >= 0.05:
                left_s = (now_s - self._began_s) * (1.0 - fraction) / done
        self.latest = JobProgress(self.job_id, self.title, what, fraction, left_s)
        if now_s - self._told_s >= 0.1:
            self._told_s = now_s
            self._runner.tell(self.latest)


class JobRunner:
    """Runs jobs through ``submit`` (a thread pool's, or a test's) and tells their progress.

    A new job of a kind stops the running one of that kind.
    """

    def __init__(
        self,
        submit: Callable[[Callable[[], None]], object],
        tell: Callable[[JobProgress | JobEnded], None],
        clock: Callable[[], float],
    ) -> None:
        self._submit = submit
        self.tell = tell
        self.clock = clock
        self._lock = threading.Lock()
        self._jobs: dict[str, Job] = {}
        self._numbers = itertools.count(1)
        self._idle = threading.Condition(self._lock)
        self._closed = False

    @property
    def running(self) -> tuple[Job, ...]:
        """Jobs that have not ended."""
        with self._lock:
            return tuple(self._jobs.values())

    def start(self, kind: str, title: str, work: Callable[[Job], None]) -> str:
        """Start a job; ``work`` raises CarinaError to fail in words. Returns its id.

        Raises
        ------
        CancelledError
            If Carina is closing: a job that is stopped for that may want to leave its rest to another one.
        """
        with self._lock:
            if self._closed:
                raise _closing(title)
            for other in self._jobs.values():
                if other.kind == kind:
                    other.stop()
            job = Job(f"job-{next(self._numbers)}", title, kind, self)
            self._jobs[job.job_id] = job
        # With what is true of whoever starts it, such as the command that is being done.
        context = contextvars.copy_context()
        errand = current_errand()
        if errand is not None:
            errand.job_began()
        try:
            self._submit(lambda: context.run(self._run, job, work))
        except RuntimeError:
            # The threads were given back since the look above.
            if errand is not None:
                errand.job_ended(None)
            if not self._closed:
                raise
            with self._idle:
                self._jobs.pop(job.job_id, None)
                self._idle.notify_all()
            raise _closing(title) from None
        return job.job_id

    def close(self) -> None:
        """Stop all jobs, and start no more."""
        with self._lock:
            self._closed = True
        self.cancel_kinds()

    def cancel(self, job_id: str) -> bool:
        """Stop a job; False if there is none of this id."""
        with self._lock:
            job = self._jobs.get(job_id)
        if job is not None:
            job.stop()
        return job is not None

    def is_stopping(self, job_id: str) -> bool:
        """Whether a job was asked to stop and has not ended."""
        with self._lock:
            job = self._jobs.get(job_id)
        return job is not None and job.cancel()

    def cancel_kinds(self, *kinds: str) -> None:
        """Stop the jobs of these kinds, or all without one."""
        for job in self.running:
            if not kinds or job.kind in kinds:
                job.stop()

    def cancel_others(self, than: Job) -> None:
        """Stop all jobs but this one."""
        for job in self.running:
            if job is not than:
                job.stop()

    def wait_idle(self, timeout_s: float | None) -> bool:
        """Wait until no job runs; False after ``timeout_s``, None waits as long as it takes."""
        with self._idle:
            return self._idle.wait_for(lambda: not self._jobs, timeout_s)

    def _run(self, job: Job, work: Callable[[Job], None]) -> None:
        outcome: Outcome = "done"
        error: CarinaError | None = None
        try:
            # Stopped before it began: the work finds out at its first look, and tidies up as after any stop.
            work(job)
        except CancelledError:
            outcome = "cancelled"
        except CarinaError as trouble:
            outcome, error = "failed", trouble
        except OSError as trouble:
            outcome, error = "failed", _of_machine(job.title, trouble)
        except BaseException as trouble:
            # BaseException: a panic of the compiled module is no Exception, and a job must end whatever happens.
            outcome, error = "failed", _fault(job.title, trouble)
        give_freed_memory_back()
        errand = current_errand()
        if errand is not None:
            # Before the runner is idle: whoever waits for that knows how it ended.
            errand.job_ended(error)
        with self._idle:
            self._jobs.pop(job.job_id, None)
            self._idle.notify_all()
        self.tell(JobEnded(job.job_id, job.title, outcome, error))
