"""Results of background jobs, stored until the HTTP requests that wait for them read them."""

from __future__ import annotations

from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from typing import TypeVar

Result = TypeVar("Result")


def set_result(done: Future[Result], result: Result) -> None:
    """Set the result of a job, unless the request that waits for it was cancelled, which can happen at any time."""
    with suppress(InvalidStateError):
        done.set_result(result)


def set_failure(done: Future[Result], error: BaseException) -> None:
    """Set the error of a job, unless the request that waits for it was cancelled, which can happen at any time."""
    with suppress(InvalidStateError):
        done.set_exception(error)
