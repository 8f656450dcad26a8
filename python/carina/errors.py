"""Errors of Carina: one base class, a subclass for each kind of error, and stable codes.

A message says what was being done, what was expected, what was found, and what to try. Codes are shared with the Rust
crates and with the web client; ``exit_code`` is what the command line returns (docs/contracts.md).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NoReturn

from carina.display.printable import printable, shortened_words

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "CancelledError",
    "CarinaError",
    "ClusterError",
    "DiskError",
    "GeometryError",
    "NoEvidenceError",
    "NoResultError",
    "ProtocolError",
    "RenderError",
    "TrackingError",
    "UnsavedWorkError",
    "UsageError",
    "VolumeImportError",
    "check_type",
    "error_of",
    "kind_of",
    "refuse_pickle",
    "without_options",
]


class CarinaError(Exception):
    """Base class of all errors that Carina raises on purpose.

    The message is one line that every encoder accepts: names of files may contain control characters and bytes that are
    not UTF-8.
    """

    code: str = "carina"
    exit_code: int = 1

    def __init__(self, message: str, *, code: str | None = None) -> None:
        super().__init__(shortened_words(printable(message)))
        if code is not None:
            self.code = code

    def __reduce__(self) -> tuple[Any, ...]:
        state = dict(self.__dict__)
        if isinstance(self, OSError) and self.errno is not None:
            state["errno"] = self.errno
        # The class is not called: some subclasses need more arguments than the message.
        return _pickled_error, (type(self), self.args, state)


class CancelledError(CarinaError):
    """The person stopped a long task; nothing was changed."""

    code = "cancelled"
    exit_code = 130


class UsageError(CarinaError, ValueError):
    """An argument is wrong or out of range."""

    code = "usage"
    exit_code = 2


class VolumeImportError(CarinaError, OSError):
    """A file or a series is refused; the message names it and says what to do."""

    code = "import"
    exit_code = 3

    def __str__(self) -> str:
        # OSError formats its arguments as errno and strerror; ours is one sentence.
        return str(self.args[0]) if self.args else ""


class DiskError(CarinaError, OSError):
    """A disk takes nothing more: it is full, read-only, or what was named is not there.

    The message says what, where and what to do; ``errno`` is the system's.
    """

    code = "disk.failed"
    exit_code = 1

    def __str__(self) -> str:
        # OSError formats its arguments as errno and strerror; ours is one sentence.
        return str(self.args[0]) if self.args else ""


class UnsavedWorkError(CarinaError):
    """Carina ended, or a case was closed, with work that could not be saved.

    The message states the number of lost changes, the reason, and the path of the last saved state.
    """

    code = "case.not-saved"
    exit_code = 5


class GeometryError(CarinaError, ValueError):
    """A grid, a transform or an array's shape is unusable."""

    code = "geometry"
    exit_code = 3


class RenderError(CarinaError, ValueError):
    """A view or a camera is out of range."""

    code = "render"
    exit_code = 2


class TrackingError(CarinaError):
    """A path or an airway could not be tracked."""

    code = "track"
    exit_code = 4


class NoResultError(TrackingError):
    """The question has no answer in this volume: no airway, no path."""

    code = "track.no-result"
    exit_code = 4


class NoEvidenceError(NoResultError):
    """An airway was asked for where the CT shows no wall round the whole way; asked again, it can be drawn by hand.

    Attributes
    ----------
    doubtful_mm
        Length of the way along which no wall is seen, mm.
    way_lps
        (n, 3) float64, LPS mm, the way from the tree to the point.
    doubtful
        (n-1,) bool, which of its segments are doubtful.
    """

    code = "track.no-evidence"

    def __init__(
        self, message: str, *, doubtful_mm: float, way_lps: NDArray[np.float64], doubtful: NDArray[np.bool_]
    ) -> None:
        super().__init__(message)
        self.doubtful_mm = doubtful_mm
        self.way_lps = way_lps
        self.doubtful = doubtful


class ClusterError(CarinaError):
    """The cluster refused or lost a machine."""

    code = "cluster"
    exit_code = 1


class ProtocolError(CarinaError, ValueError):
    """A message does not follow the wire format."""

    code = "protocol"
    exit_code = 1


def kind_of(error: CarinaError) -> str:
    """Return the name of the class of this module that an error is of, or that its class derives from."""
    return next(cls.__name__ for cls in type(error).__mro__ if cls.__module__ == __name__)


def error_of(kind: str, message: str, *, code: str) -> CarinaError:
    """Rebuild an error of another process from the name of its class (:func:`kind_of`), its message and its code.

    One that has more than words, and one that this Carina does not know, is the nearest that has words alone.
    """
    cls = globals().get(kind)
    if not isinstance(cls, type) or not issubclass(cls, CarinaError):
        cls = CarinaError
    plain = next(one for one in cls.__mro__ if one is CarinaError or "__init__" not in vars(one))
    made: CarinaError = plain(message, code=code)
    return made


def _pickled_error(cls: type[CarinaError], args: tuple[Any, ...], state: dict[str, Any]) -> CarinaError:
    """Return the error that a pickle holds, as joblib and Ray pass errors of their workers."""
    error = cls.__new__(cls, *args)
    error.args = args
    for name, value in state.items():
        setattr(error, name, value)
    return error


def check_type(where: str, name: str, value: object, kinds: type | tuple[type, ...], remedy: str) -> None:
    """Refuse an argument of another type at a public door, in the words of all other refusals.

    Parameters
    ----------
    where, name
        The function and its argument.
    value
        What was passed.
    kinds
        What it must be.
    remedy
        How to get one; the end of the sentence.

    Raises
    ------
    UsageError
        ``usage.type``.
    """
    if not isinstance(value, kinds):
        expected = " or ".join(kind.__name__ for kind in (kinds if isinstance(kinds, tuple) else (kinds,)))
        raise UsageError(
            f"{where}: {name}: expected {expected}; found {type(value).__name__}; {remedy}", code="usage.type"
        )


def refuse_pickle(value: object, remedy: str) -> NoReturn:
    """Refuse to pickle or copy a value that is bound to its process; ``__reduce__`` of its class calls this function.

    Raises
    ------
    TypeError
        The class that Python raises for pickles. An error of Carina could be taken for an answer, such as a verdict.
        ``remedy`` is the end of the sentence.
    """
    raise TypeError(f"a {type(value).__name__} cannot be copied or pickled; {remedy}")


def without_options(message: str) -> str:
    """Return a message without command-line options, for the window.

    Examples
    --------
    >>> without_options("choose one (--label, or label=N in Python)")
    'choose one'
    """
    return re.sub(r" \(--[^()]*\)", "", message)
