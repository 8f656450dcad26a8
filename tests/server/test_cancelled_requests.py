"""Tests of requests that are cancelled in the moment in which their job ends."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace

import pytest

from carina.errors import CancelledError, CarinaError
from carina.server.files.fork_sheets import fork_sheet_answer
from carina.server.files.plan_reports import Reports


class CancelledFuture(Future):
    """Future whose request is cancelled immediately before the job sets the result."""

    def set_result(self, result):
        self.cancel()
        super().set_result(result)

    def set_exception(self, exception):
        self.cancel()
        super().set_exception(exception)


class Jobs:
    """Runner of jobs at once, which stores how each job has ended."""

    def __init__(self):
        self.ends = []

    def start(self, _kind, _title, work):
        try:
            work(SimpleNamespace(progress=lambda *_: None, cancel=lambda: False, stop_reason=None))
            self.ends.append(None)
        except BaseException as error:
            self.ends.append(type(error))


def raising(error):
    def work(*_arguments, **_options):
        raise error

    return work


ENDS = pytest.mark.parametrize(
    ("work", "end"),
    [
        (lambda *_, **__: b"made", None),
        (raising(CancelledError("stopped")), CancelledError),
        (raising(CarinaError("failed")), CarinaError),
        (raising(ValueError("fault")), ValueError),
    ],
)


@ENDS
def test_contact_sheet_job_of_a_cancelled_request_ends_without_another_error(monkeypatch, work, end):
    monkeypatch.setattr("carina.server.files.fork_sheets.Future", CancelledFuture)
    monkeypatch.setattr("carina.server.files.fork_sheets.fork_sheet_png", work)
    state = SimpleNamespace(
        volume=None,
        airways=object(),
        route=SimpleNamespace(spans=(1,), forks_mm=(10.0,)),
        operator="head",
        cost="lumen",
    )
    session = SimpleNamespace(ask=lambda _question: state, jobs=Jobs())
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(fork_sheet_answer(session))
    assert session.jobs.ends == [end]


@ENDS
@pytest.mark.parametrize("name", ["plan.mrk.json", "plan.html"])
def test_report_job_of_a_cancelled_request_ends_without_another_error(monkeypatch, work, end, name):
    for function in ("export_plan", "write_report"):
        monkeypatch.setattr(f"carina.server.files.plan_reports.{function}", work)
    for function in ("whole_sheet", "_with_verdicts", "badges_of"):
        monkeypatch.setattr(f"carina.server.files.plan_reports.{function}", lambda *_, **__: None)
    monkeypatch.setattr("carina.server.files.plan_reports.Future", CancelledFuture)
    session = SimpleNamespace(jobs=Jobs())
    materials = SimpleNamespace(plan=None, volume=None, airways=SimpleNamespace(tree=None))
    done = Reports(session)._start_job(materials, "t1", Path(name), "report", None)
    assert done.cancelled()
    assert session.jobs.ends == [end]
