"""Progress bars for long work, in a terminal or a notebook only."""

from __future__ import annotations

import functools
import math
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, ParamSpec, Protocol, TypeVar

from carina.argument_checks import progress_choice

__all__ = ["Progress", "ProgressChoice", "heard", "shows_progress"]

P = ParamSpec("P")
T = TypeVar("T")

Progress = Callable[[str, float | None], None]
ProgressChoice = Progress | bool | None
"""A callback ``progress(what, fraction)``; False shows nothing; None, as usual, a bar in a terminal or a notebook."""

BEGIN_S = 0.5
"""Shorter work needs no bar."""
EVERY_S = 0.1


class Bar(Protocol):
    """Something that can be drawn and taken away."""

    def draw(self, text: str, fraction: float | None) -> None:
        """Show how far it is."""

    def close(self) -> None:
        """Take it away."""


class TerminalBar:
    """A line on stderr, drawn by rich, that is gone when the work is done."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as RichProgress

        # Drawn when it is told, without a thread of its own.
        columns = (TextColumn("{task.description}"), BarColumn())
        self._shown = RichProgress(*columns, console=Console(stderr=True), transient=True, auto_refresh=False)
        self._shown.start()
        self._task = self._shown.add_task("", total=1.0)

    def draw(self, text: str, fraction: float | None) -> None:
        """Show how far it is."""
        self._shown.update(self._task, description=text, completed=fraction or 0.0, refresh=True)

    def close(self) -> None:
        """Take it away."""
        self._shown.stop()


class NotebookBar:
    """HTML's own bar below the cell, gone when the work is done; it needs no widgets."""

    def __init__(self) -> None:
        from IPython.display import HTML, display  # type: ignore[import-not-found, unused-ignore]

        self._html = HTML
        self._handle = display(HTML(""), display_id=True)

    def draw(self, text: str, fraction: float | None) -> None:
        """Show how far it is."""
        from carina.display.html import escaped

        value = "" if fraction is None else f' value="{fraction:.3f}"'
        self._handle.update(self._html(f'<progress max="1"{value}></progress> <small>{escaped(text)}</small>'))

    def close(self) -> None:
        """Take it away."""
        self._handle.update(self._html(""))


def bar_here() -> Callable[[], Bar] | None:
    """Return the bar that fits the terminal or notebook; None without a viewer and outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        return None
    shell = sys.modules.get("IPython")
    running = None if shell is None else shell.get_ipython()
    if running is not None and hasattr(running, "kernel"):
        return NotebookBar
    return TerminalBar if sys.stderr is not None and sys.stderr.isatty() else None


class Watched:
    """A progress callback that draws a bar once the work has taken half a second."""

    def __init__(self, make: Callable[[], Bar], clock: Callable[[], float]) -> None:
        self._make, self._clock = make, clock
        self._begin_s = self._shown_s = clock()
        self._task_s = self._begin_s
        self._what: str | None = None
        self._bar: Bar | None = None

    def __call__(self, what: str, fraction: float | None) -> None:
        now = self._clock()
        if what != self._what:
            self._what, self._task_s = what, now
        if now - self._begin_s < BEGIN_S or now - self._shown_s < EVERY_S:
            return
        self._shown_s = now
        if self._bar is None:
            self._bar = self._make()
        text = what
        if fraction is not None and 0.02 < fraction < 1.0:
            text += f", {math.ceil((now - self._task_s) * (1.0 - fraction) / fraction)} s left"
        self._bar.draw(text, fraction)

    def close(self) -> None:
        """Take the bar away, if there is one."""
        if self._bar is not None:
            self._bar.close()


def heard(progress: ProgressChoice) -> Progress | None:
    """Return the callback of a choice, if there is one; for functions that `shows_progress` wraps."""
    return progress if callable(progress) else None


def shows_progress(function: Callable[P, T]) -> Callable[P, T]:
    """Give a function with a keyword ``progress`` a default progress bar; a passed callback replaces the bar."""

    @functools.wraps(function)
    def shown(*args: P.args, **kwargs: P.kwargs) -> T:
        choice: Any = kwargs.get("progress")
        progress_choice(function.__name__, "progress", choice)
        if callable(choice):
            return function(*args, **kwargs)
        make = bar_here() if choice is not False else None
        if make is None:
            kwargs["progress"] = None
            return function(*args, **kwargs)
        told = Watched(make, time.monotonic)
        kwargs["progress"] = told
        try:
            return function(*args, **kwargs)
        finally:
            told.close()

    return shown
