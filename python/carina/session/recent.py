"""Cases opened before, and whether the safety notice was read: two small files in the person's config folder.

Paths stay in these files: the wire carries an id, a date and the series text, never a name or a path.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["LocalStore", "RecentCase"]

logger = logging.getLogger(__name__)

MAX_RECENT = 12


@dataclass(frozen=True, slots=True)
class RecentCase:
    """A case opened before."""

    recent_id: str
    date: str
    """ISO date of the last opening."""
    title: str
    path: str


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that a crash or a full disk leaves the old one whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


class LocalStore:
    """The files; a folder that cannot be written costs the memory of them, not the session."""

    def __init__(self, folder: Path) -> None:
        self._unwritten: dict[Path, dict[str, Any]] = {}
        """What the disk did not take: it holds until Carina is closed."""
        self._recent_file = folder / "recent.json"
        self._notice_file = folder / "notice.json"

    def recent(self) -> tuple[RecentCase, ...]:
        """Newest first; entries that do not read are left out."""
        found = []
        for entry in self._read(self._recent_file).get("cases", []):
            try:
                found.append(RecentCase(*(str(entry[key]) for key in ("recent_id", "date", "title", "path"))))
            except (KeyError, TypeError):
                continue
        return tuple(found[:MAX_RECENT])

    def remember(self, path: str, title: str, date: str) -> None:
        """Put a case first in the list."""
        place = str(Path(path).absolute())
        recent_id = hashlib.sha256(place.encode()).hexdigest()[:16]
        cases = [RecentCase(recent_id, date, title, place), *(c for c in self.recent() if c.recent_id != recent_id)]
        entries = [
            {"recent_id": c.recent_id, "date": c.date, "title": c.title, "path": c.path} for c in cases[:MAX_RECENT]
        ]
        self._write(self._recent_file, {"format": "carina-recent", "version": 1, "cases": entries})

    def notice_accepted(self) -> bool:
        """Whether "not a medical device" was read on this machine."""
        return self._read(self._notice_file).get("accepted") is True

    def accept_notice(self) -> None:
        """Remember that it was read."""
        self._write(self._notice_file, {"format": "carina-notice", "version": 1, "accepted": True})

    def _read(self, path: Path) -> dict[str, Any]:
        if path in self._unwritten:
            return self._unwritten[path]
        try:
            value = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return {}
        return value if isinstance(value, dict) else {}

    def _write(self, path: Path, value: dict[str, Any]) -> None:
        try:
            write_atomically(path, json.dumps(value, indent=1) + "\n")
            self._unwritten.pop(path, None)
        except OSError as error:
            # Else a notice that was read would be asked for again after every change.
            self._unwritten[path] = value
            logger.warning("could not write %s: %s", path.name, error.strerror)
