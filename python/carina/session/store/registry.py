"""Records of the user's cases on this machine: a private folder for each case, with its live file and its record.

Paths and dates are stored in the record and not in the case file, so that the case file can be shared. The name of the
CT's file and the text of its series are not stored: a case without a user's name is shown by a neutral alias.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import re
import shutil
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

from carina.case.bounds import shortened_text
from carina.disk import make_folder, read_regular_text, write_whole
from carina.disk.locks import Held, try_lock
from carina.display import one_line
from carina.errors import UsageError, VolumeImportError
from carina.session.store.attach_endpoint import AttachEndpoint, delete_endpoint, read_endpoint, write_endpoint
from carina.session.store.case_names import neutral_alias, new_case_id
from carina.session.store.named_file_lock import NamedLock
from carina.typed_reading import read_plain
from carina.value import TEXT, Count, FrozenValue

logger = logging.getLogger(__name__)

FORMAT, VERSION = "carina-record", 2
READ_VERSIONS = (1, 2)
"""Versions of the record format that can be read.

Version 1 also contained ``title``: the CT's file name or series text.
"""
RECORD, LOCK, FILE, PICTURE = "record.json", "lock", "case.carina", "picture.jpg"
FORGOTTEN = ".forgotten"
"""Name of the folder of forgotten cases, next to the other cases; a forgotten case can be restored for a day."""
MAX_RECORD_BYTES: Final = 1 << 20
MAX_S: Final = 1e11
"""Maximum time in a record, in seconds since 1970 (year 5138), which every clock and calendar can show."""
MAX_TITLE_CHARS: Final = 1000
MAX_PLACE_CHARS: Final = 4096
FORGOTTEN_FOR_S = 24 * 3600.0
CLAIMS = ".open-cts"
"""Name of the folder with a lock file for each CT that a window has open."""


Seconds = Annotated[float, Meta(ge=0.0, le=MAX_S)]
"""Seconds since 1970."""
ShortText = Annotated[str, Meta(max_length=64, pattern=TEXT)]
TitleText = Annotated[str, Meta(max_length=MAX_TITLE_CHARS, pattern=TEXT)]
PlaceText = Annotated[str, Meta(max_length=MAX_PLACE_CHARS)]


class CaseRecord(FrozenValue, frozen=True):
    """Data about a case that are stored on this machine and not in the case file."""

    case_id: ShortText
    digest: Annotated[str, Meta(max_length=128, pattern=TEXT)]
    """Digest of the CT (:func:`carina.volume.ct_digest`), which identifies the CT wherever its files are."""
    place: PlaceText | None
    """Last path of the CT: an absolute path, or ``demo:NAME``; None if the CT cannot be found again."""
    begun_s: Seconds
    """Time when the case was begun, in seconds since 1970."""
    used_s: Seconds
    copy_path: PlaceText | None = None
    """Path of the named file; None without a named file."""
    copied_s: Seconds | None = None
    copy_digest: ShortText | None = None
    """Digest of the named file as this case last read or wrote it; None in records of earlier versions."""
    copy_save_id: ShortText | None = None
    copy_generation: Count = 0
    """Generation of the save mark in the named file (:class:`carina.case.save_mark.SaveMark`)."""
    next_copy_digest: ShortText | None = None
    """Digest of a save that was about to replace the named file: after a crash the file may have this digest."""
    use_number: Count = 0
    """Number of the last use: each use of any case gets the next number, which a clock cannot set back."""
    num_changes: Count = 0
    """Number of changes in the stored history that are not undone."""
    num_nodules: Count | None = None
    """Number of targets with a size; None in records of earlier versions, until the case is saved again."""
    alias: TitleText | None = None
    """Name that the user gave; None without such a name."""
    scanned_on: ShortText | None = None
    """ISO date of the scan; None if its files state no date."""
    holds_ct: bool = False
    """Whether the CT is packed in the case file."""
    pictured_s: Seconds | None = None
    """Time of the thumbnail in seconds since 1970; None without a thumbnail."""
    forgotten_s: Seconds | None = None
    """Time when the case was forgotten, in seconds since 1970; None while the case is in the list."""

    @property
    def shown_title(self) -> str:
        """Name of the case in lists: the name that the user gave, else the neutral alias."""
        return neutral_alias(self.case_id) if self.alias is None else self.alias


@one_line
class LockedCase:
    """A stored case that this process owns until it releases the case."""

    def __init__(self, folder: Path, record: CaseRecord, lock: int, endpoint: AttachEndpoint) -> None:
        self.folder = folder
        self.record = record
        self._lock: int | None = lock
        self._endpoint = endpoint
        self._noting = threading.Lock()

    @property
    def path(self) -> Path:
        """Path of the live case file."""
        return self.folder / FILE

    def note(self, **values: object) -> None:
        """Change fields of the case's record, in memory and on the disk; may be called from several threads."""
        with self._noting:
            self.record = msgspec.structs.replace(self.record, **values)
            write_record(self.folder, self.record)

    def clear(self) -> None:
        """Delete a live file to which nothing was saved, which a faulty disk may have left."""
        for path in self.folder.glob(f"{FILE}*"):
            path.unlink()

    def put_picture(self, jpeg: bytes, now_s: float) -> None:
        """Store the thumbnail of the case."""
        write_whole(self.folder / PICTURE, jpeg, what="the thumbnail of the case", private=True)
        self.note(pictured_s=now_s)

    def write_endpoint(self) -> None:
        """Write the address with which programs join this process into the case's folder, or that they cannot join."""
        write_endpoint(self.folder, self._endpoint)

    def release(self) -> None:
        """Release the lock, so that another process may own the case."""
        lock, self._lock = self._lock, None
        if lock is not None:
            delete_endpoint(self.folder)
            os.close(lock)


class CaseRecords:
    """Folders and records of all stored cases.

    Parameters
    ----------
    folder
        Folder of the cases in the user's data, created with the first case.
    now_s
        Returns the seconds since 1970.
    documents
        The user's folder of documents, in which named files are suggested; None suggests no path.
    """

    def __init__(self, folder: Path, now_s: Callable[[], float], documents: Path | None = None) -> None:
        self._folder = folder
        self.documents = documents
        self.now_s = now_s
        self.endpoint = AttachEndpoint()
        """Address and token with which programs join this process."""

    def __repr__(self) -> str:
        """Describe the records by their number."""
        return f"CaseRecords({len(self.all())} cases)"

    @property
    def folder(self) -> Path:
        """The folder that contains the folder of each case."""
        return self._folder

    def all(self) -> tuple[CaseRecord, ...]:
        """Return the records of all cases that have a file, the last used first.

        The order is that of the use numbers, because a clock can be set back. Records of earlier versions, which have
        no use number, follow in the order of their times.
        """
        found = [_read(path) for path in self._folder.glob(f"*/{RECORD}") if (path.parent / FILE).exists()]
        return tuple(sorted((one for one in found if one), key=lambda one: (one.use_number, one.used_s), reverse=True))

    def next_use_number(self) -> int:
        """Return the next use number, which is larger than those of all records and orders the cases by last use."""
        return 1 + max((one.use_number for one in self.all()), default=0)

    def claim(self, digest: str) -> NamedLock | None:
        """Claim the CT that a window opens, until the lock is released.

        A case is stored after its first change. The claim shows before that change that a window has the CT open.

        Returns
        -------
        NamedLock | None
            None if locks do not work.

        Raises
        ------
        LockedElsewhereError
            If another window has claimed the CT.
        """
        folder = self._folder / CLAIMS
        try:
            make_folder(folder, what="the cases", private=True)
        except OSError:
            return None
        return NamedLock.take(folder / digest[:32])

    def newest_of(self, digest: str) -> CaseRecord | None:
        """Return the record of the case of a CT that was used last; None if the CT has no case."""
        return next((one for one in self.all() if one.digest == digest), None)

    def begin(
        self, digest: str, place: str | None, *, begun_s: float | None = None, case_id: str | None = None
    ) -> LockedCase:
        """Store the record of a new case, and own the case.

        Parameters
        ----------
        digest, place
            Digest and path of the CT, as in :class:`CaseRecord`.
        begun_s
            Time when the case was begun, in seconds since 1970; None means now.
        case_id
            Id from :func:`new_case_id` of a case that was shown before it had a record. The record gets another id if a
            case of this machine has the same id or the same neutral alias.

        Raises
        ------
        OSError
            If the disk refuses the write.
        """
        now_s = self.now_s()
        record = CaseRecord(
            self._unused_id(case_id),
            digest,
            place,
            begun_s=now_s if begun_s is None else begun_s,
            used_s=now_s,
            use_number=self.next_use_number(),
        )
        folder = self._folder / record.case_id
        # The folders are flushed to the disk, so that a power failure cannot remove a case that was reported as saved.
        make_folder(self._folder, what="the cases", private=True, lasting=True)
        make_folder(folder, what="the case", private=True, lasting=True)
        write_record(folder, record)
        held = self._lock_case(folder, record)
        assert held is not None
        return held

    def _unused_id(self, case_id: str | None) -> str:
        """Return an id that no case of this machine has, with a neutral alias that differs from all shown names."""
        shown = {one.shown_title.casefold() for one in (*self.all(), *self.forgotten())}
        chosen = case_id or new_case_id()
        while neutral_alias(chosen).casefold() in shown or self._has_files(chosen):
            chosen = new_case_id()
        return chosen

    def _has_files(self, case_id: str) -> bool:
        """Return whether a case of this id has files, also if its record is unreadable or the case is forgotten."""
        folders = (self._folder / case_id, self._folder / FORGOTTEN / case_id)
        return any(True for folder in folders for _ in folder.glob(f"{FILE}*"))

    def hold(self, record: CaseRecord) -> LockedCase | None:
        """Lock a case as its owner; return None if another process owns the case."""
        folder = self._folder / record.case_id
        held = self._lock_case(folder, record)
        if held is not None:
            # The previous owner may have changed the record since.
            held.record = _read(folder / RECORD) or record
        return held

    def _lock_case(self, folder: Path, record: CaseRecord) -> LockedCase | None:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            held: Held = try_lock(descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        if held is not True:
            os.close(descriptor)
            return None
        # Deletes connection details that a crash left.
        delete_endpoint(folder)
        return LockedCase(folder, record, descriptor, self.endpoint)

    def is_held(self, record: CaseRecord) -> bool:
        """Return whether a process has a case open; the check takes the lock for a moment."""
        try:
            descriptor = os.open(self._folder / record.case_id / LOCK, os.O_RDWR)
        except OSError:  # Without a lock file no process has the case open.
            return False
        try:
            return try_lock(descriptor) is False
        finally:
            os.close(descriptor)

    def open_elsewhere(self, path: Path) -> CaseRecord | None:
        """Return the case whose named file is at a path, if a process has the case open: its live file is newer."""
        for record in self.all():
            if record.copy_path == str(path):
                held = self.hold(record)
                if held is None:
                    return record
                held.release()
        return None

    def find(self, case_id: str) -> CaseRecord | None:
        """Return a case of the list; None if the list has no such case."""
        return next((one for one in self.all() if one.case_id == case_id), None)

    def live_path(self, case_id: str) -> Path:
        """Return the path of a listed case's live file, even if the record is unreadable."""
        return self._folder / case_id / FILE

    def stores(self, path: Path) -> bool:
        """Return whether a path is in the folder of the stored cases, also by another spelling or a link."""
        for folder in Path(os.path.realpath(path)).parents:
            with contextlib.suppress(OSError):
                if folder.samefile(self._folder):
                    return True
        return False

    def refuse_stored(self, path: Path) -> None:
        """Refuse to save a case under a name in the folder of the stored cases.

        A save replaces the file at its path. If that were a live file, its owner would continue to write to the
        replaced file, and those changes would be lost.

        Raises
        ------
        UsageError
            ``case.no-place``: if :meth:`stores` returns True.
        """
        if self.stores(path):
            raise UsageError(
                f"{path} is in the folder in which Carina stores its cases; choose another folder", code="case.no-place"
            )

    def record_at(self, path: Path) -> CaseRecord | None:
        """Return the listed case whose live file is at a path; None if no such case is listed."""
        place = Path(os.path.realpath(path))
        return self.find(place.parent.name) if self.stores(path) and place.name == FILE else None

    def path_of(self, record: CaseRecord) -> Path:
        """Return the path of the live case file; another process may be writing it."""
        return self._case_folder(record) / FILE

    def endpoint_of(self, record: CaseRecord) -> AttachEndpoint | None:
        """Return the connection details of the process that has a case open; None without them.

        A crash may have left them.
        """
        return read_endpoint(self._case_folder(record))

    def num_bytes(self, record: CaseRecord) -> int:
        """Return the number of bytes of a case on the disk."""
        total = 0
        for path in self._case_folder(record).glob("*"):
            with contextlib.suppress(OSError):
                total += path.stat().st_size
        return total

    def picture(self, case_id: str) -> bytes | None:
        """Return the thumbnail of a case, also of a forgotten one; None where it has none."""
        for record in (*self.all(), *self.forgotten()):
            if record.case_id == case_id:
                with contextlib.suppress(OSError):
                    return (self._case_folder(record) / PICTURE).read_bytes()
        return None

    def rename(self, record: CaseRecord, alias: str | None) -> bool:
        """Set the name of a case; return False if a process has the case open."""
        held = self.hold(record)
        if held is None:
            return False
        held.note(alias=alias)
        held.release()
        return True

    def remove_titles(self) -> int:
        """Rewrite the records of earlier versions without file names and series texts; return their number.

        The record of a case that another process has open is rewritten at a later start.
        """
        rewritten = 0
        for path in (*self._folder.glob(f"*/{RECORD}"), *(self._folder / FORGOTTEN).glob(f"*/{RECORD}")):
            if not _holds_title(path) or (record := _read(path)) is None:
                continue
            with contextlib.suppress(OSError):
                held = self._lock_case(path.parent, record)
                if held is None:
                    continue
                try:
                    # The owner may have written the record between the check and the lock.
                    if _holds_title(path) and (newest := _read(path)) is not None:
                        write_record(path.parent, newest)
                        rewritten += 1
                finally:
                    held.release()
        return rewritten

    # ------------------------------------------------------------ forgotten cases

    def forgotten(self) -> tuple[CaseRecord, ...]:
        """Return the forgotten cases that can be restored, the last forgotten first."""
        found = [_read(path) for path in (self._folder / FORGOTTEN).glob(f"*/{RECORD}")]
        # A process that was killed may have moved the folder without storing the time.
        dated = [msgspec.structs.replace(one, forgotten_s=one.forgotten_s or self.now_s()) for one in found if one]
        return tuple(sorted(dated, key=lambda one: one.forgotten_s or 0.0, reverse=True))

    def forget(self, record: CaseRecord) -> bool:
        """Remove a case from the list; for a day it can be restored. Return False if a process has the case open.

        Raises
        ------
        OSError
            If the disk refuses.
        """
        held = self.hold(record)
        if held is None:
            return False
        try:
            make_folder(self._folder / FORGOTTEN, what="the forgotten cases", private=True)
            if sys.platform == "win32":  # Windows moves no folder with an open file.
                held.release()
            place = self._folder / FORGOTTEN / record.case_id
            held.folder.rename(place)
            write_record(place, msgspec.structs.replace(held.record, forgotten_s=self.now_s()))
        finally:
            held.release()
        return True

    def restore(self, case_id: str) -> CaseRecord | None:
        """Restore a forgotten case; return None if the case no longer exists."""
        record = next((one for one in self.forgotten() if one.case_id == case_id), None)
        if record is None:
            return None
        restored = msgspec.structs.replace(record, forgotten_s=None)
        place = self._folder / record.case_id
        self._case_folder(record).rename(place)
        write_record(place, restored)
        return restored

    def empty_forgotten(self, older_than_s: float = 0.0) -> int:
        """Delete the cases that were forgotten at least ``older_than_s`` seconds ago, and return their number."""
        removed = 0
        for record in self.forgotten():
            if self.now_s() - (record.forgotten_s or 0.0) >= older_than_s:
                shutil.rmtree(self._case_folder(record), ignore_errors=True)
                removed += not self._case_folder(record).exists()
        return removed

    def remove(self, case_id: str) -> bool:
        """Delete a forgotten case; return False if no such case is forgotten, or the disk refuses."""
        record = next((one for one in self.forgotten() if one.case_id == case_id), None)
        if record is None:
            return False
        shutil.rmtree(self._case_folder(record), ignore_errors=True)
        return not self._case_folder(record).exists()

    def _case_folder(self, record: CaseRecord) -> Path:
        return (self._folder if record.forgotten_s is None else self._folder / FORGOTTEN) / record.case_id


def write_record(folder: Path, record: CaseRecord) -> None:
    """Write the record of a case, with each value changed to the nearest value that can be read back.

    Raises
    ------
    DiskError
        If the record cannot be written.
    """
    plain = {name: _clamped_to_bounds(name, value) for name, value in msgspec.structs.asdict(record).items()}
    text = json.dumps({"format": FORMAT, "version": VERSION, **plain}, indent=1, allow_nan=False)
    write_whole(folder / RECORD, (text + "\n").encode(), what="the case's record", private=True)


def _clamped_to_bounds(name: str, value: Any) -> Any:
    if isinstance(value, float):
        return min(max(value, 0.0), MAX_S) if math.isfinite(value) else 0.0
    return shortened_text(value, MAX_TITLE_CHARS) if name == "alias" and value is not None else value


def is_damaged_record(path: Path) -> bool:
    """Return whether the content of a record is damaged; a read error and a newer version are not damage."""
    try:
        return _decode_record(path) is None
    except OSError:
        return False


def _decode_record(path: Path) -> CaseRecord | None:
    """Return the record in a file; None if the content is damaged.

    Raises
    ------
    OSError
        If the file cannot be read, or a newer Carina wrote it.
    """
    try:
        plain = json.loads(read_regular_text(path, max_bytes=MAX_RECORD_BYTES), parse_constant=_refuse_constant)
        if not isinstance(plain, dict) or plain.pop("format", None) != FORMAT:
            return None
        version = plain.pop("version", None)
        if isinstance(version, int) and version > VERSION:
            raise OSError("a newer version of Carina wrote this record")
        known = {name: value for name, value in plain.items() if name in CaseRecord.__struct_fields__}
        record = read_plain(known, CaseRecord)
    except VolumeImportError as error:
        if error.code != "disk.too-large":
            raise
        return None
    except (ValueError, RecursionError, msgspec.ValidationError):
        return None
    if version not in READ_VERSIONS:
        return None
    if record.case_id != path.parent.name:
        other = path.parent.with_name(record.case_id) if re.fullmatch(r"[\w-]+", record.case_id) else None
        if other is not None and other.exists():
            # A folder with the record of another case is a copy made by the user, which Carina must not change.
            raise OSError("the record belongs to another folder")
        return None
    return record


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number in JSON")


def _read(path: Path) -> CaseRecord | None:
    with contextlib.suppress(OSError):
        record = _decode_record(path)
        if record is not None:
            return record
    logger.warning("the record of a saved case could not be read")
    return None


def _holds_title(path: Path) -> bool:
    """Return whether a readable record contains a title, as records of earlier versions do."""
    with contextlib.suppress(OSError, ValueError, RecursionError):
        plain = json.loads(read_regular_text(path, max_bytes=MAX_RECORD_BYTES))
        return isinstance(plain, dict) and "title" in plain
    return False
