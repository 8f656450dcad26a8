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
STALE_S = 15.0
"""Time in s without a change after which a file was left by a program that ended without deleting it."""


class RunningTasks:
    """Running tasks of the learners of a folder, which several machines may use.

    A file contains no time of day, because the clocks of machines differ: a reader recognises a file that was left
    behind, because the file does not change any more.

    Parameters
    ----------
    folder
        Folder of the learners.
    clock
        Returns monotonic time in seconds.
    """

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder, self._clock = folder, clock
        self._lock = threading.Lock()
        self._seen: dict[str, tuple[str, float]] = {}
        """Newest content of each file, and the time at which it was read first."""

    def note(self, key: str, text: str, elapsed_s: float) -> None:
        """Store what a learner flies; a disk that cannot be written is ignored, because only a teacher's view needs it.

        Parameters
        ----------
        key
            Key of the learner.
        text
            Task and progress as text.
        elapsed_s
            Time since the beginning of the attempt.
        """
        content = json.dumps({"text": text, "elapsed_s": round(elapsed_s, 1)})
        with contextlib.suppress(CarinaError, OSError):
            write_whole(self._folder / f"{key}{SUFFIX}", content.encode(), what="the running task", private=True)

    def end(self, key: str) -> None:
        """Delete the file of a learner whose task has ended."""
        with contextlib.suppress(OSError):
            (self._folder / f"{key}{SUFFIX}").unlink(missing_ok=True)

    def read(self) -> dict[str, str]:
        """Return task and progress of each learner who flies now, by the learner's key."""
        now_s = self._clock()
        found: dict[str, str] = {}
        with self._lock:
            seen: dict[str, tuple[str, float]] = {}
            with contextlib.suppress(OSError):
                for path in self._folder.glob(f"*{SUFFIX}"):
                    with contextlib.suppress(CarinaError, OSError, ValueError):
                        key, content = path.name.removesuffix(SUFFIX), read_regular_text(path, max_bytes=MAX_BYTES)
                        before = self._seen.get(key)
                        seen[key] = before if before is not None and before[0] == content else (content, now_s)
            self._seen = seen
            for key, (content, since_s) in seen.items():
                text = _text_in(content)
                if text is not None and now_s - since_s < STALE_S:
                    found[key] = text
        return found


def _text_in(content: str) -> str | None:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return None
    text = document.get("text") if isinstance(document, dict) else None
    return text[:MAX_SHOWN] if isinstance(text, str) and text.isprintable() else None
