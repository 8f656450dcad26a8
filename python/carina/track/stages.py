"""The stages of a long search: what is going on, how far it is, and whether to stop."""

from __future__ import annotations

from collections.abc import Callable

from carina.errors import CancelledError

__all__ = ["Cancel", "Progress", "Stages"]

Progress = Callable[[str, float | None], None]
Cancel = Callable[[], bool]


class Stages:
    """Hands progress on, with the name of the present stage, and stops between stages when asked."""

    def __init__(self, progress: Progress | None, cancel: Cancel | None) -> None:
        self._progress = progress
        self.cancel = cancel
        self._what = ""

    def begin(self, what: str, fraction: float | None = None) -> None:
        if self.cancel is not None and self.cancel():
            raise CancelledError("stopped while finding the airways")
        self._what = what
        if self._progress is not None:
            self._progress(what, fraction)

    def share(self, fraction: float) -> None:
        if self._progress is not None:
            self._progress(self._what, fraction)
