"""Tests of the reason that a stopped job has, which the messages about lost videos and contact sheets contain."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from carina.errors import CancelledError, CarinaError
from carina.server.files.films import _reported
from carina.server.files.fork_sheets import fork_sheet_answer
from carina.session.jobs.background_jobs import CASE_CLOSED, OTHER_CASE, STARTED_AGAIN, JobRunner


@pytest.fixture
def jobs():
    with ThreadPoolExecutor(4) as pool:
        yield JobRunner(pool.submit, lambda _event: None, time.monotonic)


def running_job(jobs, kind, *, of_case=True):
    """Start a job that runs until it is stopped, and return it."""
    begun, found = threading.Event(), []

    def work(job):
        found.append(job)
        begun.set()
        while True:
            job.check()

    job_id = jobs.start(kind, f"a job of the kind {kind}", work, of_case=of_case)
    assert begun.wait(60.0)
    return job_id, found[0]


def test_job_states_why_it_was_stopped(jobs):
    job_id, cancelled = running_job(jobs, "a")
    jobs.cancel(job_id)
    # The first reason is that of the user.
    jobs.cancel_kinds()
    assert cancelled.stop_reason is None
    _, replaced = running_job(jobs, "b")
    _, present = running_job(jobs, "b")
    assert replaced.stop_reason == STARTED_AGAIN
    _, other = running_job(jobs, "c")
    jobs.cancel_others(other)
    assert present.stop_reason == OTHER_CASE
    jobs.cancel_kinds()
    assert other.stop_reason == CASE_CLOSED
    assert jobs.wait_idle(60.0)


def test_job_that_does_not_belong_to_the_case_continues_in_another_case_and_stops_with_carina(jobs):
    _, retrieval = running_job(jobs, "a", of_case=False)
    _, opening = running_job(jobs, "open")
    jobs.cancel_others(opening)
    jobs.cancel_kinds()
    assert opening.cancel()
    assert not retrieval.cancel()
    jobs.close()
    assert retrieval.cancel()
    assert jobs.wait_idle(60.0)


def test_lost_video_has_another_code_than_a_cancelled_one():
    error = CancelledError("stopped")
    assert _reported(error, SimpleNamespace(stop_reason=None)).code == "export.video-stopped"
    lost = _reported(error, SimpleNamespace(stop_reason=OTHER_CASE))
    assert (lost.code, str(lost)) == ("export.video-lost", "the video was cancelled because another case was opened")


def test_contact_sheet_that_another_window_starts_again_is_reported_as_lost(jobs, monkeypatch):
    begun = threading.Event()

    def endless(*_, cancel, **_options):
        begun.set()
        while not cancel():
            pass
        raise CancelledError("stopped")

    monkeypatch.setattr("carina.server.files.fork_sheets.fork_sheet_png", endless)
    route = SimpleNamespace(spans=(1,), forks_mm=(10.0,))
    state = SimpleNamespace(volume=None, airways=object(), route=route, operator="head", cost="lumen")
    session = SimpleNamespace(jobs=jobs, ask=lambda _question: state)

    async def ask_then_start_again():
        first = asyncio.create_task(fork_sheet_answer(session))
        await asyncio.to_thread(begun.wait, 60.0)
        jobs.start("fork-sheet", "rendering the forks", lambda _job: None)
        await first

    with pytest.raises(CarinaError, match="in another window") as lost:
        asyncio.run(ask_then_start_again())
    assert lost.value.code == "plan.sheet-lost"
