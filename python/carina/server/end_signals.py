"""Signals that stop the workstation: the first one saves the work first, a second one stops at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

__all__ = ["EndSignals"]

CLOSED_TERMINAL = "SIGHUP"
ENDING = ("SIGTERM", CLOSED_TERMINAL)
"""Names of the handled signals; Python and uvicorn handle SIGINT (Ctrl-C)."""


class EndSignals:
    """Handlers of SIGTERM and SIGHUP while the server runs and while the session is closed.

    Without these handlers either signal ends the process at once: SIGHUP in the middle of the work, SIGTERM after the
    server has ended and before the session is closed. A signal that is ignored (``nohup``) stays ignored.

    Parameters
    ----------
    stop
        Callback that makes the server stop; called for the first signal.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self._former: dict[signal.Signals, Any] = {}
        self._received: list[int] = []
        self._is_closing = False

    @property
    def has_terminal_closed(self) -> bool:
        """Whether the terminal was closed, so that no user can answer."""
        return any(signal.Signals(number).name == CLOSED_TERMINAL for number in self._received)

    def begin_closing(self) -> None:
        """Mark the server as stopped; each later signal raises an interrupt as Ctrl-C does."""
        self._is_closing = True

    def __enter__(self) -> EndSignals:
        """Install the signal handlers."""
        # Signals can only be handled in the main thread; in another thread, the caller stops the server.
        if threading.current_thread() is threading.main_thread():
            for name in ENDING:
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                    self._former[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_error: object) -> None:
        """Restore the previous signal handlers."""
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        self._received.append(number)
        if self._is_closing:
            raise KeyboardInterrupt
        self._stop()
