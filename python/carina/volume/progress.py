"""Progress reports and cancellation of long imports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carina.errors import CancelledError


@dataclass(frozen=True, slots=True)
class Watch:
    """The ``progress`` and ``cancel`` arguments of a long function, as one object."""

    progress: Callable[[str, float | None], None] | None = None
    cancel: Callable[[], bool] | None = None

    def step(self, what: str, fraction: float | None = None) -> None:
        """Report progress, or raise an error if the user cancelled.

        Parameters
        ----------
        what
            Description of the current step for the user.
        fraction
            Finished share of the step, 0 to 1; None if unknown.

        Raises
        ------
        CancelledError
            If ``cancel()`` returned true.
        """
        if self.cancel is not None and self.cancel():
            msg = f"cancelled while {what[:1].lower()}{what[1:]}"
            raise CancelledError(msg)
        if self.progress is not None:
            self.progress(what, fraction)
