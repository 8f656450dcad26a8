"""Wrong values for arguments of public functions, and the check of a call's outcome."""

from __future__ import annotations

import dataclasses
import inspect
import math
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import msgspec
import numpy as np

from carina.errors import CarinaError
from carina.track import TreeMeasures

LIMIT_S = 60.0
"""Time limit of one call, seconds; the slowest call takes 2 s on an idle machine."""

NEVER_VALID: dict[str, Any] = {
    "nan": math.nan,
    "inf": math.inf,
    "-inf": -math.inf,
    "complex": 1j,
    "bytes": b"\xff",
    "object": object(),
    "class": int,
    "point with nan": (math.nan, 0.0, 0.0),
    "point with inf": (0.0, math.inf, 0.0),
    "points with nan": np.full((2, 3), math.nan),
    "array with inf": np.full((4, 4, 4), np.inf),
    "matrix of nan": np.full((4, 4), math.nan),
    "array of objects": np.array([object()]),
}
"""Values that every argument must refuse; a call that succeeds has ignored its argument."""

SELDOM_VALID: dict[str, Any] = {
    "huge": 1e300,
    "negative huge": -1e300,
    "huge whole number": 10**20,
    "negative huge whole number": -(10**20),
    "negative": -1,
    "zero": 0,
    "tiny": 5e-324,
    "True": True,
    "None": None,
    "empty text": "",
    "blank text": "  ",
    "text with NUL": "a\0b",
    "text": "no-such-thing",
    "long text": "x" * 100_000,
    "empty tuple": (),
    "empty list": [],
    "empty dict": {},
    "empty points": np.zeros((0, 3)),
    "ragged": [[1.0], [1.0, 2.0]],
    "point": (0.0, 0.0, 0.0),
    "huge point": (1e300, 0.0, 0.0),
    "far point": (9e4, -9e4, 9e4),
    "two numbers": (1.0, 2.0),
    "empty array": np.zeros((0, 0, 0), dtype=np.uint8),
}
"""Values that only some arguments accept: the call must be refused, or its result must be finite."""

NUMBERS = {"huge", "negative huge", "huge whole number", "negative huge whole number"}
"""Names of the values that are outside the range of every number argument."""
NOT_NUMBERS = {
    "True", "empty text", "blank text", "text with NUL", "text", "long text", "empty tuple", "empty list", "empty dict",
    "empty points", "ragged", "point", "huge point", "far point", "two numbers", "empty array",
}  # fmt: skip
NOT_PATHS = {"empty text", "blank text", "text with NUL"}


class CallTooLongError(BaseException):
    """Error for a call that exceeds the time limit."""


@contextmanager
def time_limit(seconds: float = LIMIT_S) -> Iterator[None]:
    """Raise :class:`CallTooLongError` in the block after some seconds, on platforms with interval timers.

    Compiled code that never returns is ended by pytest's own limit (``faulthandler_timeout``).
    """
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_number: int, _frame: object) -> None:
        raise CallTooLongError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def is_a(annotation: str, *names: str) -> bool:
    """Return whether an annotation consists only of the given types and None."""
    parts = {part.strip() for part in annotation.split("|")} - {"None"}
    return bool(parts) and parts <= set(names)


def must_be_refused(parameter: inspect.Parameter, name: str) -> bool:
    """Return whether a parameter must refuse the value ``name``, because its type excludes it or it is never valid."""
    if name in NEVER_VALID:
        return True
    annotation = str(parameter.annotation)
    if name == "None":
        return (
            parameter.default is not None and "None" not in annotation and annotation not in {"ProgressChoice", "Any"}
        )
    if is_a(annotation, "int", "float"):
        return name in NUMBERS | NOT_NUMBERS
    if is_a(annotation, "bool"):
        return name != "True"
    if is_a(annotation, "Path", "str", "os.PathLike[str]", "Path | str") and "Path" in annotation:
        return name in NOT_PATHS
    return False


def call_problem(call: Callable[[], Any], *, refuse: bool, after: Callable[[], Any] | None = None) -> str | None:
    """Call a function, and return a description of a wrong outcome; None if the outcome is right.

    The call must be refused, or, if ``refuse`` is false, may also succeed with finite results.

    Parameters
    ----------
    call
        The function with one wrong value.
    refuse
        Whether the call must be refused.
    after
        Function that reads the state of the object afterwards, which must be finite as well.
    """
    try:
        with time_limit():
            result = call()
            state = None if after is None else after()
    except CarinaError as error:
        text = str(error)
        if not text or len(text) > 2000:
            return f"refused with a message of {len(text)} characters"
        return None
    except CallTooLongError:
        return f"did not end within {LIMIT_S:g} s"
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        return f"raised {type(error).__name__}: {str(error)[:200]}"
    if refuse:
        return "was accepted"
    found = not_finite(result) or not_finite(state)
    return None if found is None else f"gave a value that is not finite: {found}"


def not_finite(value: Any, place: str = "result", depth: int = 0) -> str | None:
    """Return the place of the first number in a result that is not finite; None if all are finite."""
    if depth > 6 or value is None or isinstance(value, str | bytes | bool | int):
        return None
    if isinstance(value, TreeMeasures):
        # A cross-section that could not be measured is NaN by definition; the JSON document stores null for it.
        value = value.to_json()
    if isinstance(value, float):
        return None if math.isfinite(value) else f"{place} is {value}"
    if isinstance(value, np.ndarray):
        bad = value.dtype.kind == "f" and not np.isfinite(value).all()
        return f"{place} has {np.count_nonzero(~np.isfinite(value))} such values" if bad else None
    if isinstance(value, Mapping):
        inner = [(f"{place}[{key!r}]", one) for key, one in value.items()]
    elif isinstance(value, list | tuple):
        inner = [(f"{place}[{n}]", one) for n, one in enumerate(value[:50])]
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        inner = [(f"{place}.{one.name}", getattr(value, one.name)) for one in dataclasses.fields(value)]
    elif isinstance(value, msgspec.Struct):
        inner = [(f"{place}.{name}", getattr(value, name)) for name in value.__struct_fields__]
    else:
        return None
    return next((found for at, one in inner if (found := not_finite(one, at, depth + 1)) is not None), None)
