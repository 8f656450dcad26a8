"""Answers the newest of many questions of a kind, outside the event loop."""

from __future__ import annotations

import threading
from collections.abc import Callable

__all__ = ["NewestOnly"]


class NewestOnly:
    """One thread that runs the newest task of each kind; a task that has not begun gives way to a newer one.

    A cursor asks more often than a slow machine answers. What it asked a moment ago nobody wants to know any more.
    """

    def __init__(self, name: str) -> None:
        self._tasks: dict[str, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def ask(self, kind: str, task: Callable[[], None]) -> None:
        """Run a task soon, in place of one of its kind that waits; it must not raise."""
        with self._changed:
            # To the end of the queue: kinds take turns.
            self._tasks.pop(kind, None)
            self._tasks[kind] = task
            self._changed.notify()

    def end(self) -> None:
        """End after the task under way, for which nobody waits here; what waits is dropped."""
        with self._changed:
            self._stopped = True
            self._tasks.clear()
            self._changed.notify()

    def stop(self) -> None:
        """End, and wait for the task under way."""
        self.end()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def thread(self) -> threading.Thread:
        """That runs them."""
        return self._thread

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopped or bool(self._tasks))
                if self._stopped:
                    return
                task = self._tasks.pop(next(iter(self._tasks)))
            task()
