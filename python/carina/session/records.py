"""The cases of a person on this machine: a private folder each, with the live case file and what leads back to its CT.

Paths, titles and dates stay in these folders; the case file itself holds none, so that it can be handed on.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec

from carina.disk import make_folder, write_whole
from carina.disk.locks import Held, try_lock
from carina.display import one_line
from carina.value import FrozenValue

__all__ = ["CaseRecord", "CaseRecords", "HeldCase"]

logger = logging.getLogger(__name__)

FORMAT, VERSION = "carina-record", 1
RECORD, LOCK, FILE = "record.json", "lock", "case.carina"


class CaseRecord(FrozenValue, frozen=True):
    """What this machine knows of a case beside its file."""

    case_id: str
    digest: str
    """Of the CT (:func:`carina.volume.ct_digest`): it is known again by it, wherever its files lie."""
    place: str | None
    """Where its CT was opened from last: an absolute path, or ``demo:NAME``; None where nobody could find it again."""
    title: str
    begun_s: float
    """When it was begun and last used, seconds since 1970."""
    used_s: float
    copy_path: str | None = None
    """Where the copy lies that a person asked for."""
    copied_s: float | None = None
    num_changes: int = 0
    """Steps that hold."""


@one_line
class HeldCase:
    """A case of this machine that this process owns, until it is released."""

    def __init__(self, folder: Path, record: CaseRecord, lock: int) -> None:
        self.folder = folder
        self.record = record
        self._lock: int | None = lock

    @property
    def path(self) -> Path:
        """The live case file."""
        return self.folder / FILE

    def note(self, **values: object) -> None:
        """Change what is known beside the file, on the disk, too."""
        self.record = msgspec.structs.replace(self.record, **values)
        _write(self.folder, self.record)

    def release(self) -> None:
        """Another process may own it now."""
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)


class CaseRecords:
    """The folders of all cases.

    Parameters
    ----------
    folder
        In the person's own data; made when the first case is begun.
    now_s
        Seconds since 1970.
    documents
        The person's folder of documents: where a copy is suggested to be.
    """

    def __init__(self, folder: Path, now_s: Callable[[], float], documents: Path | None = None) -> None:
        self._folder = folder
        self.documents = documents
        self.now_s = now_s

    def __repr__(self) -> str:
        return f"CaseRecords({len(self.all())} cases)"

    def all(self) -> tuple[CaseRecord, ...]:
        """Those that read, the last used first."""
        found = [_read(path) for path in self._folder.glob(f"*/{RECORD}")]
        return tuple(sorted((one for one in found if one), key=lambda one: one.used_s, reverse=True))

    def newest_of(self, digest: str) -> CaseRecord | None:
        """The case of a CT that was used last."""
        return next((one for one in self.all() if one.digest == digest), None)

    def begin(self, digest: str, place: str | None, title: str) -> HeldCase:
        """A new case.

        Raises
        ------
        OSError
            If the disk does not take it.
        """
        now_s = self.now_s()
        record = CaseRecord(secrets.token_hex(8), digest, place, title, now_s, now_s)
        folder = self._folder / record.case_id
        make_folder(self._folder, what="the cases", private=True)
        make_folder(folder, what="the case", private=True)
        _write(folder, record)
        held = self._hold(folder, record)
        assert held is not None
        return held

    def hold(self, record: CaseRecord) -> HeldCase | None:
        """Own a case; None where another process does."""
        return self._hold(self._folder / record.case_id, record)

    def _hold(self, folder: Path, record: CaseRecord) -> HeldCase | None:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            held: Held = try_lock(descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        if held is not True:
            os.close(descriptor)
            return None
        return HeldCase(folder, record, descriptor)

    def forget(self, record: CaseRecord) -> bool:
        """Remove all that is kept of a case here; False where another process has it open."""
        held = self.hold(record)
        if held is None:
            return False
        held.release()
        shutil.rmtree(held.folder, ignore_errors=True)
        return not held.folder.exists()


def _write(folder: Path, record: CaseRecord) -> None:
    plain = {"format": FORMAT, "version": VERSION, **msgspec.structs.asdict(record)}
    write_whole(folder / RECORD, (json.dumps(plain, indent=1) + "\n").encode(), what="the case's record", private=True)


def _read(path: Path) -> CaseRecord | None:
    with contextlib.suppress(OSError, ValueError, RecursionError, msgspec.ValidationError):
        plain = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(plain, dict) and plain.pop("format", None) == FORMAT and plain.pop("version", None) == VERSION:
            return msgspec.convert(plain, CaseRecord)
    logger.warning("the record of a saved case could not be read")
    return None
