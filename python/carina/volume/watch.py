"""How a long import reports what it does and notices that the person no longer wants it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carina.errors import CancelledError

__all__ = ["Watch"]


@dataclass(frozen=True, slots=True)
class Watch:
    """The ``progress`` and ``cancel`` arguments of a long function, as one object to pass down."""

    progress: Callable[[str, float | None], None] | None = None
    cancel: Callable[[], bool] | None = None

    def step(self, what: str, fraction: float | None = None) -> None:
        """Report, and stop here if the person cancelled.

        Raises
        ------
        CancelledError
            If ``cancel()`` is true.
        """
        if self.cancel is not None and self.cancel():
            msg = f"cancelled while {what[:1].lower()}{what[1:]}"
            raise CancelledError(msg)
        if self.progress is not None:
            self.progress(what, fraction)
