"""Stages of a long search: name of the current stage, its progress, and cancellation."""

from __future__ import annotations

from collections.abc import Callable

from carina.errors import CancelledError

Progress = Callable[[str, float | None], None]
Cancel = Callable[[], bool]


class Stages:
    """Reporter of progress with the name of the current stage, which stops the search between stages if cancelled."""

    def __init__(self, progress: Progress | None, cancel: Cancel | None) -> None:
        self._progress = progress
        self.cancel = cancel
        self._what = ""

    def begin(self, what: str, fraction: float | None = None) -> None:
        """Start a stage and report it.

        Parameters
        ----------
        what
            Name of the stage, for the user.
        fraction
            Completed share, 0..1; None if unknown.

        Raises
        ------
        CancelledError
            If ``cancel()`` returns True.
        """
        if self.cancel is not None and self.cancel():
            raise CancelledError("stopped while finding the airways")
        self._what = what
        if self._progress is not None:
            self._progress(what, fraction)

    def share(self, fraction: float) -> None:
        """Report the completed share (0 to 1) of the current stage."""
        if self._progress is not None:
            self._progress(self._what, fraction)
