"""Progress bars for long work, in a terminal or a notebook only."""

from __future__ import annotations

import functools
import inspect
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, Protocol, TypeVar

from carina.argument_checks import progress_choice

P = ParamSpec("P")
T = TypeVar("T")

Progress = Callable[[str, float | None], None]
ProgressChoice = Progress | bool | None
"""The argument ``progress`` of every public function.

A function ``f(what, fraction)`` is called with the step and its completed fraction, 0 to 1, or None where the fraction
is unknown. True and None show a progress bar in a terminal or a notebook; False shows none.
"""

_inside: ContextVar[bool] = ContextVar("carina_progress_inside", default=False)
"""Whether a function with an argument ``progress`` is running: its choice holds for the functions that it calls."""

BEGIN_S = 0.5
"""Time in s from the start of a calculation until its progress bar appears; a shorter calculation shows no bar."""
EVERY_S = 0.1


class Bar(Protocol):
    """Interface of a progress bar."""

    def draw(self, text: str, fraction: float | None) -> None:
        """Show the text and the fraction done, 0 to 1; None if the fraction is unknown."""

    def close(self) -> None:
        """Remove the progress bar from the terminal or the notebook."""


class TerminalBar:
    """Progress bar on stderr, drawn by rich and removed when the work is done."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as RichProgress

        # Without auto_refresh, rich starts no thread.
        columns = (TextColumn("{task.description}"), BarColumn())
        self._shown = RichProgress(*columns, console=Console(stderr=True), transient=True, auto_refresh=False)
        self._shown.start()
        self._task = self._shown.add_task("", total=1.0)

    def draw(self, text: str, fraction: float | None) -> None:
        """Show the text and the fraction done, 0 to 1; None if the fraction is unknown."""
        self._shown.update(self._task, description=text, completed=fraction or 0.0, refresh=True)

    def close(self) -> None:
        """Remove the progress bar from the terminal."""
        self._shown.stop()


class NotebookBar:
    """HTML ``progress`` element below the notebook cell, removed when the work is done; it needs no widgets."""

    def __init__(self) -> None:
        from IPython.display import HTML, display  # type: ignore[import-not-found, unused-ignore]

        self._html = HTML
        self._handle = display(HTML(""), display_id=True)

    def draw(self, text: str, fraction: float | None) -> None:
        """Show the text and the fraction done, 0 to 1; None if the fraction is unknown."""
        from carina.display.html import escaped

        value = "" if fraction is None else f' value="{fraction:.3f}"'
        self._handle.update(self._html(f'<progress max="1"{value}></progress> <small>{escaped(text)}</small>'))

    def close(self) -> None:
        """Remove the progress bar from the notebook."""
        self._handle.update(self._html(""))


def create_progress_bar() -> Callable[[], Bar] | None:
    """Return the bar that fits the terminal or notebook; None without a viewer and outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        return None
    shell = sys.modules.get("IPython")
    running = None if shell is None else shell.get_ipython()
    if running is not None and hasattr(running, "kernel"):
        return NotebookBar
    return TerminalBar if sys.stderr is not None and sys.stderr.isatty() else None


class BarCallback:
    """A progress callback that draws a bar once the work has taken half a second."""

    def __init__(self, make: Callable[[], Bar], clock: Callable[[], float]) -> None:
        self._make, self._clock = make, clock
        self._begin_s = self._shown_s = clock()
        self._task_s = self._begin_s
        self._what: str | None = None
        self._bar: Bar | None = None

    def __call__(self, what: str, fraction: float | None) -> None:
        """Show the progress of a task; the bar appears after BEGIN_S."""
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
        """Remove the bar if there is one."""
        if self._bar is not None:
            self._bar.close()


def progress_function(progress: ProgressChoice) -> Progress | None:
    """Return the function of a choice, None for True, False and None; for functions that `shows_progress` wraps."""
    return progress if callable(progress) else None


def fraction_callback(
    progress: Progress | None, what: str, first: float = 0.0, last: float = 1.0
) -> Callable[[float], None] | None:
    """Return a function that reports the fraction of one step of the work; None without a progress function.

    Parameters
    ----------
    progress
        Receives the step and its completed fraction.
    what
        The step.
    first, last
        Fraction of the whole work at the step's beginning and at its end.
    """
    return None if progress is None else lambda fraction: progress(what, first + (last - first) * fraction)


@contextmanager
def without_bars() -> Iterator[None]:
    """Show no bar in the block unless a call passes ``progress=True``; the command line reports progress itself."""
    before = _inside.set(True)
    try:
        yield
    finally:
        _inside.reset(before)


def shows_progress(function: Callable[P, T]) -> Callable[P, T]:
    """Let a function with an argument ``progress`` accept every `ProgressChoice`.

    The function receives a progress function or None. If another such function calls it without
    ``progress``, it shows no bar, because the caller already shows one.
    """
    place = list(inspect.signature(function).parameters).index("progress")

    @functools.wraps(function)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
        is_positional = place < len(args)
        choice: Any = args[place] if is_positional else kwargs.get("progress")
        progress_choice(function.__qualname__, "progress", choice)
        bar: BarCallback | None = None
        if not callable(choice):
            is_wanted = choice is True or (choice is None and not _inside.get())
            make = create_progress_bar() if is_wanted else None
            bar = choice = None if make is None else BarCallback(make, time.monotonic)
        changed: Any = (*args[:place], choice, *args[place + 1 :]) if is_positional else args
        if not is_positional:
            kwargs["progress"] = choice
        before = _inside.set(True)
        try:
            return function(*changed, **kwargs)
        finally:
            _inside.reset(before)
            if bar is not None:
                bar.close()

    return wrapper
