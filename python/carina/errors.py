"""Errors of Carina: one base class, a subclass for each kind of error, and stable codes.

A message states the operation, the expected value, the found value, and a remedy. The Rust crates and the web client
use the same codes; ``exit_code`` is the exit code of the command line (docs/contracts.md).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NoReturn

from carina.display.escaped_text import printable, shortened_words

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
    "PacsError",
    "ProtocolError",
    "RenderError",
    "TrackingError",
    "UnconfirmedTargetError",
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

    The message is one line that every encoder accepts: control characters and bytes that are not UTF-8, which file
    names may contain, are replaced.
    """

    code: str = "carina"
    exit_code: int = 1

    def __init__(self, message: str, *, code: str | None = None) -> None:
        super().__init__(shortened_words(printable(message)))
        if code is not None:
            self.code = code

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the class, message and attributes of the error for pickle."""
        state = dict(self.__dict__)
        if isinstance(self, OSError) and self.errno is not None:
            state["errno"] = self.errno
        # The class is not called: some subclasses need more arguments than the message.
        return _pickled_error, (type(self), self.args, state)


class CancelledError(CarinaError):
    """Long task that the user stopped; nothing was changed."""

    code = "cancelled"
    exit_code = 130


class UsageError(CarinaError, ValueError):
    """Argument that has a wrong type or is out of range."""

    code = "usage"
    exit_code = 2


class VolumeImportError(CarinaError, OSError):
    """File or series that is rejected; the message names it and states a remedy."""

    code = "import"
    exit_code = 3

    def __str__(self) -> str:
        # OSError formats its arguments as errno and strerror; messages of Carina are one sentence.
        """Return the message, without an error number."""
        return str(self.args[0]) if self.args else ""


class DiskError(CarinaError, OSError):
    """Disk that cannot be written: it is full or read-only, or the file or folder does not exist.

    The message states the operation, the path and a remedy; ``errno`` is the system's.
    """

    code = "disk.failed"
    exit_code = 1

    def __str__(self) -> str:
        # OSError formats its arguments as errno and strerror; messages of Carina are one sentence.
        """Return the message, without an error number."""
        return str(self.args[0]) if self.args else ""


class UnsavedWorkError(CarinaError):
    """Changes that could not be saved when Carina ended or a case was closed.

    The message states the number of lost changes, the reason, and the path of the last saved state.
    """

    code = "case.not-saved"
    exit_code = 5


class GeometryError(CarinaError, ValueError):
    """Grid, transform or array shape that is unusable."""

    code = "geometry"
    exit_code = 3


class RenderError(CarinaError, ValueError):
    """View or camera that is out of range."""

    code = "render"
    exit_code = 2


class TrackingError(CarinaError):
    """Path or airway that could not be tracked."""

    code = "track"
    exit_code = 4


class NoResultError(TrackingError):
    """Request without a result in this volume: no airway, no path."""

    code = "track.no-result"
    exit_code = 4


class NoEvidenceError(NoResultError):
    """Requested airway along which the CT shows no continuous wall.

    The caller can repeat the request to draw the airway by hand.

    Attributes
    ----------
    doubtful_mm
        Length of the path without a visible wall, mm.
    way_lps
        (n, 3) float64, LPS mm, path from the tree to the point.
    doubtful
        (n-1,) bool, whether each segment of the path is doubtful.
    """

    code = "track.no-evidence"

    def __init__(
        self, message: str, *, doubtful_mm: float, way_lps: NDArray[np.float64], doubtful: NDArray[np.bool_]
    ) -> None:
        super().__init__(message)
        self.doubtful_mm = doubtful_mm
        self.way_lps = way_lps
        self.doubtful = doubtful


class UnconfirmedTargetError(NoResultError):
    """Target of a plan that may not be a nodule, and that the caller has not confirmed.

    The caller can repeat the request with a confirmation. The code of the error is that of the first doubt.

    Attributes
    ----------
    doubts
        The doubts that are not confirmed, each with ``code`` and ``words``.
    """

    code = "plan.unconfirmed"

    def __init__(self, message: str, *, doubts: tuple[Any, ...]) -> None:
        super().__init__(message, code=doubts[0].code)
        self.doubts = doubts


class ClusterError(CarinaError):
    """Machine that the cluster rejected or lost."""

    code = "cluster"
    exit_code = 1


class PacsError(CarinaError):
    """Request that a PACS refused, or that did not reach it; the message states one remedy."""

    code = "pacs"
    exit_code = 1


class ProtocolError(CarinaError, ValueError):
    """Message that does not follow the wire format."""

    code = "protocol"
    exit_code = 1


def kind_of(error: CarinaError) -> str:
    """Return the name of the error's class, or of the class of this module from which that class derives."""
    return next(cls.__name__ for cls in type(error).__mro__ if cls.__module__ == __name__)


def error_of(kind: str, message: str, *, code: str) -> CarinaError:
    """Rebuild an error of another process from the name of its class (:func:`kind_of`), its message and its code.

    The result is the nearest base class that needs only a message, if the class needs more or is unknown to this
    version.
    """
    cls = globals().get(kind)
    if not isinstance(cls, type) or not issubclass(cls, CarinaError):
        cls = CarinaError
    plain = next(one for one in cls.__mro__ if one is CarinaError or "__init__" not in vars(one))
    made: CarinaError = plain(message, code=code)
    return made


def _pickled_error(cls: type[CarinaError], args: tuple[Any, ...], state: dict[str, Any]) -> CarinaError:
    """Return the error that a pickle contains; joblib and Ray pass errors of their workers as pickles."""
    error = cls.__new__(cls, *args)
    error.args = args
    for name, value in state.items():
        setattr(error, name, value)
    return error


def check_type(where: str, name: str, value: object, kinds: type | tuple[type, ...], remedy: str) -> None:
    """Reject an argument of a wrong type in a public function, with the uniform message.

    Parameters
    ----------
    where, name
        Function and argument.
    value
        Passed value.
    kinds
        Accepted types.
    remedy
        How to get such a value; the end of the sentence.

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
    """Raise the error for pickling or copying a value that exists only in its process, such as a renderer.

    ``__reduce__`` of such a class calls this function.

    Parameters
    ----------
    value
        The value that was to be pickled.
    remedy
        End of the message: what the caller can do instead.

    Raises
    ------
    TypeError
        Always. Python raises TypeError for objects that cannot be pickled; callers that handle `CarinaError` as the
        negative result of a plan or a search do not catch a TypeError.
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
