"""Tasks that learners fly at this moment, for a teacher: one small file for each learner, in the learners' folder."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path

from carina.disk import read_regular_text, write_whole
from carina.errors import CarinaError

SUFFIX = ".running.json"
MAX_BYTES = 4096
MAX_SHOWN = 400
WRITE_AGAIN_S = 1.0
"""Interval in s at which the file of a running task is written again, with a greater counter."""
STALE_S = 15.0
"""Age in s from which a file counts as left by a program that ended without deleting it."""
CLOSING_S = 1.0
"""Maximum time in s that :meth:`RunningTasks.close` waits for the disk."""


class RunningTasks:
    """Running tasks of the learners of a folder, which several machines may use.

    A file contains no time of day, because the clocks of machines differ. It contains a counter instead, which
    increases as long as the task runs, also during a pause: a reader lists a task once the reader has seen the counter
    change, so that a file that was left behind is not listed.

    Parameters
    ----------
    folder
        Folder of the learners.
    clock
        Returns monotonic time in seconds.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder, self._clock = folder, clock
        self._reading = threading.Lock()
        self._seen: dict[str, tuple[str, float | None]] = {}
        """Newest content of each file, and the time of its latest change; None before a change was seen."""
        self._read_s = float("-inf")
        """Instant at which the files were read last, s."""
        self._changed = threading.Condition()
        self._texts: dict[str, str] = {}
        """Text of each running task of this process, by the learner's key."""
        self._ended: set[str] = set()
        """Keys of the learners whose files the thread deletes next."""
        self._thread: threading.Thread | None = None
        """Thread that writes and deletes the files, so that no caller waits for a disk; None without a running task."""
        self._is_closed = False

    def note(self, key: str, text: str) -> None:
        """Set the text of a running task, and return without waiting for the disk.

        A disk that cannot be written is ignored, because only a teacher's view needs the file.

        Parameters
        ----------
        key
            Key of the learner.
        text
            Task and progress as text.
        """
        with self._changed:
            if not self._is_closed:
                self._texts[key] = text
                self._ended.discard(key)
                self._start_thread()

    def end(self, key: str) -> None:
        """Delete the file of a learner whose task has ended, without waiting for the disk."""
        with self._changed:
            self._texts.pop(key, None)
            self._ended.add(key)
            self._start_thread()
            self._changed.notify_all()

    def close(self) -> None:
        """Delete the files of all running tasks of this process, and ignore later tasks."""
        with self._changed:
            self._is_closed = True
            for key in tuple(self._texts):
                self.end(key)
            self._changed.wait_for(lambda: self._thread is None, CLOSING_S)

    def read(self) -> dict[str, str]:
        """Return task and progress of each learner who flies now, by the learner's key."""
        found: dict[str, str] = {}
        with self._reading:
            now_s = self._clock()
            # If the last reading is old, a file that has changed since then does not show that its task still runs.
            before = self._seen if now_s - self._read_s < STALE_S else {}
            self._seen, self._read_s = {}, now_s
            with contextlib.suppress(OSError):
                for path in self._folder.glob(f"*{SUFFIX}"):
                    with contextlib.suppress(CarinaError, OSError, ValueError):
                        key, content = path.name.removesuffix(SUFFIX), read_regular_text(path, max_bytes=MAX_BYTES)
                        known, changed_s = before.get(key, (content, None))
                        self._seen[key] = content, changed_s if content == known else now_s
            for key, (content, changed_s) in self._seen.items():
                text = _text_in(content)
                if text is not None and changed_s is not None and now_s - changed_s < STALE_S:
                    found[key] = text
        return found

    def _file(self, key: str) -> Path:
        return self._folder / f"{key}{SUFFIX}"

    def _start_thread(self) -> None:
        """Start the thread of the files if it does not run; the caller holds the condition's lock."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._write_files, name="carina-running-tasks", daemon=True)
            self._thread.start()

    def _write_files(self) -> None:
        """Write the files of running tasks at intervals, and delete those of ended tasks, until no task runs."""
        counter = 0
        while True:
            with self._changed:
                texts, ended, self._ended = dict(self._texts), self._ended, set()
                if not texts and not ended:
                    self._thread = None
                    self._changed.notify_all()
                    return
            counter += 1
            for key in ended:
                with contextlib.suppress(OSError):
                    self._file(key).unlink(missing_ok=True)
            for key, text in texts.items():
                content = json.dumps({"text": text, "counter": counter}).encode()
                with contextlib.suppress(CarinaError, OSError):
                    write_whole(self._file(key), content, what="the running task", private=True)
            with self._changed:
                self._changed.wait_for(lambda: bool(self._ended) or not self._texts, WRITE_AGAIN_S)


def _text_in(content: str) -> str | None:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return None
    text = document.get("text") if isinstance(document, dict) else None
    return text[:MAX_SHOWN] if isinstance(text, str) and text.isprintable() else None
