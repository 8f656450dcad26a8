"""The list of the user's cases: renaming, forgetting and restoring cases, and the cache of CTs."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from carina import commands as c
from carina.disk import disk_trouble
from carina.display import one_line
from carina.errors import UsageError
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import SessionCore
from carina.session.saving.unsaved_work import UnsavedWork
from carina.session.state.snapshot import ErrorEvent
from carina.session.store.local_settings import RecentCase
from carina.session.store.registry import CaseRecord, CaseRecords
from carina.session.store.registry_repair import repair_records

if TYPE_CHECKING:
    from carina.session.saving.autosave import Autosave


@one_line
@dataclass(frozen=True, slots=True)
class ListedCase:
    """An entry in the list of cases."""

    recent_id: str
    title: str
    used_s: float
    """Time of the last use in seconds since 1970; the start of the day if only the date is known."""
    num_changes: int | None = None
    """Number of changes stored with the case; None if only the path of its CT is stored."""
    num_nodules: int | None = None
    """Number of targets with a size; None if it is not known."""
    num_bytes: int = 0
    opens: bool = True
    """Whether the CT of the case is available, so that the case can be opened."""
    scanned_on: str | None = None
    """ISO date on which the CT was scanned; None if it is unknown."""
    pictured_s: float | None = None
    begun_s: float | None = None
    named: bool = False
    """Whether the user has given the case a name; otherwise lists show its neutral alias."""


@one_line
@dataclass(frozen=True, slots=True)
class StorageInfo:
    """Data on the disk besides the cases of the list: cached CTs and forgotten cases."""

    num_cts: int
    ct_bytes: int
    keeps_cts: Literal["on", "off", "never"]
    """State of the CT cache; *never* means that Carina was started without a cache."""
    forgotten: tuple[ListedCase, ...]


class CaseList(CommandHandlers):
    """The list of stored cases and of CTs that were opened without a stored case."""

    def __init__(self, core: SessionCore, saving: Autosave, end_recording: Callable[[], object] = lambda: None) -> None:
        super().__init__(core)
        self._saving = saving
        self._end_recording = end_recording
        if core.store is not None and saving.cache is not None and not core.store.keeps_cts():
            saving.cache.switch(False)

    # ------------------------------------------------------------ content of the list

    def listed(self) -> tuple[ListedCase, ...]:
        """Return the cases, the one used last first; move unreadable files aside first, with a message."""
        records = self._saving.records
        self._move_damaged_aside()
        cases = () if records is None else records.all()
        places = {record.place for record in cases}
        opened = () if self.core.store is None else self.core.store.recent()
        opens = self._can_open_ct(cases)
        stored = [_entry_of_record(record, records, opens=opens(record)) for record in cases if records is not None]
        only_opened = [_entry_of_recent_ct(case) for case in opened if case.path not in places]
        # Stored cases are in the order of their use numbers, which no clock changes; other entries follow by date.
        return tuple(heapq.merge(stored, only_opened, key=lambda one: one.used_s, reverse=True))

    def _move_damaged_aside(self) -> None:
        records, store = self._saving.records, self.core.store
        messages = () if records is None else repair_records(records)
        for message in (*messages, *(() if store is None else store.moved_aside())):
            self.core.emit(ErrorEvent("case.record", message))

    def _can_open_ct(self, cases: Sequence[CaseRecord]) -> Callable[[CaseRecord], bool]:
        """Return a function that returns whether the CT of a case is at a known path, in a case file or cached."""
        if self._saving.scans is None:
            return lambda record: record.place is not None
        cts = {record.digest for record in cases if record.place is not None}
        cache = self._saving.cache
        if cache is not None and cache.is_on and any(record.digest not in cts for record in cases):
            cts |= {one.digest for one in cache.sizes()}
        return lambda record: record.holds_ct or record.digest in cts

    def storage(self) -> StorageInfo:
        """Return the state and size of the CT cache, and the forgotten cases that can be restored."""
        records, cache = self._saving.records, self._saving.cache
        sizes = () if cache is None else cache.sizes()
        deleted = () if records is None else records.forgotten()
        forgotten = tuple(_entry_of_record(one, records, opens=True) for one in deleted if records is not None)
        keeps: Literal["on", "off", "never"] = "never"
        if cache is not None and cache.can_be_on:
            keeps = "on" if cache.is_on else "off"
        return StorageInfo(
            num_cts=len(sizes),
            ct_bytes=sum(one.num_bytes for one in sizes),
            keeps_cts=keeps,
            forgotten=forgotten,
        )

    @property
    def open_case(self) -> tuple[str, int] | None:
        """ID and number of the open case; None if no case is open or the case is not stored."""
        return self._saving.open_case

    def picture(self, case_id: str) -> bytes | None:
        """Return the thumbnail of a case as JPEG; None if it has none."""
        records = self._saving.records
        return None if records is None else records.picture(case_id)

    def unsaved(self) -> tuple[UnsavedWork, ...]:
        """End a recording, stop all jobs, wait for the disks, and return the work that could not be saved."""
        self._end_recording()
        self.core.jobs.cancel_kinds()
        return self._saving.unsaved()

    def save_elsewhere(self, case_number: int, path: Path) -> Path:
        """Save a case with unsaved work to another file or folder, and return the file.

        Raises
        ------
        CarinaError
            ``case.exists``, ``case.no-place``, or the error of the disk if the case cannot be written there either.
        """
        return self._saving.save_elsewhere(case_number, path)

    # ------------------------------------------------------------ commands

    @does(c.RenameCase)
    def rename(self, command: c.RenameCase) -> None:
        """Rename an open or closed case; a case that another window has open cannot be renamed."""
        records, record = self._existing_record(command.recent_id)
        title = None if command.title is None else command.title.strip() or None
        if not self._saving.rename(record.case_id, title) and not records.rename(record, title):
            raise UsageError("this case is open in another window of Carina; rename it there", code="case.open")
        self._notify_listeners()

    @does(c.ForgetCase)
    def forget(self, command: c.ForgetCase) -> None:
        """Forget a case; its cached CT is deleted unless another case has the same CT."""
        place = next((one.path for one in self._recent_cts() if one.recent_id == command.recent_id), None)
        if place is None:
            records, record = self._existing_record(command.recent_id)
            try:
                deleted = records.forget(record)
            except OSError as error:
                raise disk_trouble(error, "cannot forget the case", None) from error
            if not deleted:
                raise UsageError("this case is open; close it before forgetting it", code="case.open")
            place = record.place
            if self._saving.cache is not None and records.newest_of(record.digest) is None:
                self._saving.cache.forget(record.digest)
        if place is not None and self.core.store is not None:
            self.core.store.forget(place)
        self._notify_listeners()

    @does(c.RestoreCase)
    def restore(self, command: c.RestoreCase) -> None:
        """Restore a forgotten case; its CT is read from its files."""
        records = self._saving.records
        try:
            restored = None if records is None else records.restore(command.recent_id)
        except OSError as error:
            raise disk_trouble(error, "cannot restore the case", None) from error
        if restored is None:
            raise UsageError("this case has been permanently deleted", code="session.recent")
        self._notify_listeners()

    @does(c.EmptyForgotten)
    def empty_forgotten(self, _command: c.EmptyForgotten) -> None:
        """Delete all forgotten cases permanently."""
        if self._saving.records is not None:
            self._saving.records.empty_forgotten()
        self._notify_listeners()

    @does(c.EmptyCtCache)
    def empty_ct_cache(self, _command: c.EmptyCtCache) -> None:
        """Delete all cached CTs, which contain no work of the user."""
        if self._saving.cache is not None:
            self._saving.cache.empty()
        self._notify_listeners()

    @does(c.KeepCts)
    def keep_cts(self, command: c.KeepCts) -> None:
        """Switch the cache of CTs on or off, also for later starts; switching it off deletes the cached CTs."""
        cache = self._saving.cache
        if cache is None or not cache.can_be_on:
            raise UsageError("Carina was started without the CT cache", code="case.no-cache")
        cache.switch(command.on)
        if self.core.store is not None:
            self.core.store.keep_cts(command.on)
        self._notify_listeners()

    def _recent_cts(self) -> tuple[RecentCase, ...]:
        return () if self.core.store is None else self.core.store.recent()

    def _existing_record(self, case_id: str) -> tuple[CaseRecords, CaseRecord]:
        records = self._saving.records
        record = None if records is None else records.find(case_id)
        if records is None or record is None:
            raise UsageError("this case is no longer in the list", code="session.recent")
        return records, record

    def _notify_listeners(self) -> None:
        with self.core.lock:
            self.core.changed("start")


def _entry_of_record(record: CaseRecord, records: CaseRecords, *, opens: bool) -> ListedCase:
    return ListedCase(
        recent_id=record.case_id,
        title=record.shown_title,
        used_s=record.used_s,
        num_changes=record.num_changes,
        num_nodules=record.num_nodules,
        num_bytes=records.num_bytes(record),
        opens=opens,
        scanned_on=record.scanned_on,
        pictured_s=record.pictured_s,
        begun_s=record.begun_s,
        named=record.alias is not None,
    )


def _entry_of_recent_ct(case: RecentCase) -> ListedCase:
    try:
        used_s = time.mktime(time.strptime(case.date[:10], "%Y-%m-%d"))
    except (ValueError, OverflowError):
        used_s = 0.0
    return ListedCase(recent_id=case.recent_id, title=case.title, used_s=used_s)
