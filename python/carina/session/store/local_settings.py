"""Private settings files: recent CTs, accepted notice and read hints, CT cache, available instruments, processor.

A path is needed to open a CT again and is never sent to a client, which receives an id, a date and a neutral alias.
"""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carina.config import PROCESSOR_NAME
from carina.disk import make_folder, read_regular_text, write_whole
from carina.display import as_words, one_line
from carina.errors import VolumeImportError
from carina.session.store.case_names import neutral_alias, new_case_id

logger = logging.getLogger(__name__)

MAX_RECENT = 12
MAX_BYTES = 4 << 20
MAX_SCOPES, MAX_NAME = 200, 64
"""Maximum number of available scopes, and maximum length of a scope's name; further or longer entries are ignored."""
CHARS = {"recent_id": 64, "date": 64, "path": 4096}
"""Maximum length of each text of an entry in the list of recent CTs; an entry with a longer text is ignored."""


@one_line
@dataclass(frozen=True, slots=True)
class RecentCase:
    """A CT opened before."""

    recent_id: str
    date: str
    """ISO date of the last opening."""
    path: str

    @property
    def title(self) -> str:
        """Neutral alias by which the CT is listed."""
        return neutral_alias(self.recent_id)


class LocalStore:
    """The settings files; if the folder is not writable, the settings are lost when Carina is closed."""

    def __init__(self, folder: Path) -> None:
        self._unwritten: dict[Path, dict[str, Any]] = {}
        """Content that could not be written; it is used until Carina is closed."""
        self._messages: list[str] = []
        self._recent_file = folder / "recent.json"
        self._notice_file = folder / "notice.json"
        self._hints_file = folder / "hints.json"
        self._storage_file = folder / "storage.json"
        self._instruments_file = folder / "instruments.json"
        self._processor_file = folder / PROCESSOR_NAME

    def __repr__(self) -> str:
        """Describe the store by its folder."""
        return f"LocalStore({as_words(str(self._recent_file.parent))})"

    def recent(self) -> tuple[RecentCase, ...]:
        """Return the CTs opened before, the newest first, without unreadable entries."""
        found = []
        entries = self._read(self._recent_file).get("cases", [])
        for entry in entries if isinstance(entries, list) else ():
            try:
                texts = [entry[key] for key in CHARS]
            except (KeyError, TypeError):
                continue
            if all(
                isinstance(text, str) and len(text) <= most for text, most in zip(texts, CHARS.values(), strict=True)
            ):
                found.append(RecentCase(*texts))
        return tuple(found[:MAX_RECENT])

    def moved_aside(self) -> tuple[str, ...]:
        """Return the messages about unreadable files that were moved aside; each message is returned once."""
        for path in (
            self._recent_file,
            self._notice_file,
            self._hints_file,
            self._storage_file,
            self._instruments_file,
            self._processor_file,
        ):
            self._read(path)
        messages, self._messages = tuple(self._messages), []
        return messages

    def remember(self, path: str, date: str) -> None:
        """Put the path of a CT first in the list."""
        place = str(Path(path).absolute())
        cases = self.recent()
        known = next((one for one in cases if one.path == place), None)
        # The id is random, because a digest of the path could be compared with guessed names.
        recent_id = new_case_id() if known is None else known.recent_id
        self._write_cases([RecentCase(recent_id, date, place), *(c for c in cases if c.path != place)])

    def remove_titles(self) -> bool:
        """Rewrite a list of an earlier version without file names and series texts; return whether the list changed."""
        entries = self._read(self._recent_file).get("cases", [])
        old = isinstance(entries, list) and any(isinstance(one, dict) and "title" in one for one in entries)
        if old:
            # The entries get new ids, because the ids of earlier versions were digests of the paths.
            self._write_cases([RecentCase(new_case_id(), one.date, one.path) for one in self.recent()])
        return old

    def forget(self, path: str) -> None:
        """Remove a CT from the list."""
        cases = self.recent()
        left = [case for case in cases if case.path != path]
        if len(left) < len(cases):
            self._write_cases(left)

    def _write_cases(self, cases: list[RecentCase]) -> None:
        entries = [{"recent_id": c.recent_id, "date": c.date, "path": c.path} for c in cases[:MAX_RECENT]]
        self._write(self._recent_file, {"format": "carina-recent", "version": 2, "cases": entries})

    def notice_accepted(self) -> bool:
        """Return whether the notice "not a medical device" was accepted on this machine."""
        return self._read(self._notice_file).get("accepted") is True

    def accept_notice(self) -> None:
        """Store that the user accepted the safety notice."""
        self._write(self._notice_file, {"format": "carina-notice", "version": 1, "accepted": True})

    def hints_read(self) -> bool:
        """Return whether the user has read the hints of the first minute."""
        return self._read(self._hints_file).get("read") is True

    def read_hints(self) -> None:
        """Store that the user has read the hints of the first minute."""
        self._write(self._hints_file, {"format": "carina-hints", "version": 1, "read": True})

    def keeps_cts(self) -> bool:
        """Return whether opened CTs are cached, so that they open faster."""
        return self._read(self._storage_file).get("keeps_cts") is not False

    def keep_cts(self, on: bool) -> None:
        """Store whether opened CTs are cached."""
        self._write(self._storage_file, {"format": "carina-storage", "version": 1, "keeps_cts": on})

    def available_scopes(self) -> tuple[str, ...] | None:
        """Return the names of the scopes that the user has marked as available here; None: all."""
        names = self._read(self._instruments_file).get("scopes")
        if not isinstance(names, list):
            return None
        return tuple(name for name in names[:MAX_SCOPES] if isinstance(name, str) and len(name) <= MAX_NAME)

    def set_available_scopes(self, names: tuple[str, ...] | None) -> None:
        """Store the names of the scopes that are available here; None: all."""
        listed = None if names is None else list(names)
        self._write(self._instruments_file, {"format": "carina-instruments", "version": 1, "scopes": listed})

    def set_processor(self, processor: str) -> None:
        """Store the processor that the user has chosen, one of ``carina.config.BACKENDS``.

        ``carina.config.load_settings`` reads the choice, for the window and for the command line.
        """
        self._write(self._processor_file, {"format": "carina-processor", "version": 1, "processor": processor})

    def _read(self, path: Path) -> dict[str, Any]:
        if path in self._unwritten:
            return self._unwritten[path]
        try:
            text = read_regular_text(path, max_bytes=MAX_BYTES)
        except VolumeImportError as error:
            if error.code == "disk.too-large":
                self._move_aside(path)
            return {}
        except OSError:
            return {}
        except ValueError:  # The file is not text.
            self._move_aside(path)
            return {}
        try:
            value = json.loads(text, parse_constant=_refuse_constant)
        except (ValueError, RecursionError):
            value = None
        if not isinstance(value, dict):
            self._move_aside(path)
            return {}
        return value

    def _move_aside(self, path: Path) -> None:
        """Rename an unreadable settings file, so that Carina no longer reads it."""
        number = 1
        while (target := path.with_name(f"{path.stem}.damaged-{number}{path.suffix}")).exists():
            number += 1
        try:
            path.rename(target)
        except OSError as error:
            logger.warning("could not rename %s: %s", path.name, error.strerror)
            return
        self._messages.append(
            f"The settings file {path.name} was damaged and is not used. It is kept as {target.name} beside it."
        )

    def _write(self, path: Path, value: dict[str, Any]) -> None:
        try:
            make_folder(path.parent, what="settings", private=True)
            write_whole(
                path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode(), what="settings", private=True
            )
            self._unwritten.pop(path, None)
        except OSError as error:
            # The value is then read from memory; otherwise an accepted notice would be shown again after every change.
            self._unwritten[path] = value
            logger.warning("could not write %s: %s", path.name, error.strerror)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number in JSON")
