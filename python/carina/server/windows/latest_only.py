"""Background thread that runs only the latest pending task of each kind."""

from __future__ import annotations

import threading
from collections.abc import Callable


class LatestTaskRunner:
    """Thread that runs the latest task of each kind; a newer task replaces a pending task of the same kind.

    The class serves requests that follow the cursor: a slow machine cannot answer all of them, and only the answer to
    the latest is of use.
    """

    def __init__(self, name: str) -> None:
        self._tasks: dict[str, Callable[[], None]] = {}
        self._changed = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread that runs the tasks."""
        self._thread.start()

    def submit(self, kind: str, task: Callable[[], None]) -> None:
        """Queue a task and drop the pending task of the same kind; the task must not raise."""
        with self._changed:
            # The task is queued as the last one, so that no kind of task can delay the others for long.
            self._tasks.pop(kind, None)
            self._tasks[kind] = task
            self._changed.notify()

    def stop_soon(self) -> None:
        """Drop all pending tasks and end the thread after the running task, without waiting for the thread."""
        with self._changed:
            self._stopped = True
            self._tasks.clear()
            self._changed.notify()

    def stop(self) -> None:
        """Drop all pending tasks, end the thread and wait until the running task has finished."""
        self.stop_soon()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def thread(self) -> threading.Thread:
        """Thread that runs the tasks."""
        return self._thread

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopped or bool(self._tasks))
                if self._stopped:
                    return
                task = self._tasks.pop(next(iter(self._tasks)))
            task()
