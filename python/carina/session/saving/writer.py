"""Storage of one open case: a thread that writes the live file, a thread that writes the named file, and their state.

No other thread waits for a disk. A change wakes the writing thread. A caller that needs all changes on the disk calls
:meth:`CaseSaver.settle`, which returns after a time limit if the disk does not respond.
"""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carina.disk import disk_trouble
from carina.errors import CarinaError, DiskError
from carina.session.jobs.background_jobs import log_fault
from carina.session.open_case.open_case import OpenCase, moment_of
from carina.session.saving.unsaved_work import UnsavedWork, unsaved_labels
from carina.session.state.snapshot import ErrorEvent, SavingInfo, Topic
from carina.session.store.find_scan import relative_path
from carina.session.store.flight_copies import flight_count, whole_flights
from carina.session.store.interfaces import WholeCase
from carina.session.store.named_file import FileMark, NamedFile, NamedFileConflictError, free_path_beside

if TYPE_CHECKING:
    from carina.case.save_mark import SaveMark
    from carina.case.stored_state import Moment
    from carina.disk import Placement
    from carina.session.core import SessionCore
    from carina.session.store.interfaces import CaseFileFunctions, StoredCaseFile
    from carina.session.store.named_file_lock import NamedLock
    from carina.session.store.registry import CaseRecord, CaseRecords, LockedCase

logger = logging.getLogger(__name__)

DECIDED_WITHIN_S = 0.4
"""Maximum delay in s before a user's change is written, together with later changes in this time."""
MOVED_WITHIN_S = 1.5
"""Maximum delay, in s, before a moved tip is written while nothing else changes."""
RECORDED_WITHIN_S = 0.8
"""Maximum delay, in s, before new lines of a running recording are written: a crash loses at most its last second."""
RETRY_S = 2.0
SLOW_S = 2.5
"""Time in s without response of the disk after which this is reported and callers stop waiting."""
COPY_EVERY_S = 60.0
COPY_RETRY_S = 10.0
NOT_RESPONDING = "the disk has not responded for some seconds; Carina keeps trying"
ELSEWHERE = (
    "the disk has not responded for some seconds; Carina keeps trying. Meanwhile you can save the case in another "
    "folder (Ctrl+S)"
)


@dataclass(frozen=True, slots=True)
class SavedAs:
    """Result of writing the case to a named file."""

    num_missing: int
    """Number of recorded flights missing in the named file, because the live file could not be read."""
    replaced: Path | None
    """Path where the replaced content of the named file was stored; None if no content was replaced."""


@dataclass(frozen=True, slots=True)
class _WorkInNamedFileOnly:
    """Work that only a named file contains, because writing to the disk of the live file failed."""

    path: Path
    moment: Moment
    flights: frozenset[int]
    """Numbers of the finished flights in the named file."""


class CaseSaver:
    """Writer of one case to its live file and its named file, until another case replaces this case.

    Parameters
    ----------
    core
        The session.
    records, files
        The records of all cases, and the storage that makes case files.
    case, place, digest
        The open case, the path and the digest of its CT.
    is_current
        Returns whether no other case has replaced this one.
    held, file
        The record and the live file, if the case was stored before.
    named
        The named file that is updated with the case, if the case was opened from one.
    claim
        The claim on the CT, released with the case.
    info
        The initial saving info.
    """

    def __init__(
        self,
        core: SessionCore,
        records: CaseRecords,
        files: CaseFileFunctions,
        case: OpenCase,
        *,
        place: str | None,
        digest: str,
        is_current: Callable[[CaseSaver], bool],
        held: LockedCase | None = None,
        file: StoredCaseFile | None = None,
        named: NamedFile | None = None,
        claim: NamedLock | None = None,
        info: SavingInfo,
    ) -> None:
        self._core = core
        self._records = records
        self._files = files
        self._is_current = is_current
        self.case = case
        self.place = place
        self.digest = digest
        self.held = held
        self.file = file
        self.info = info
        self.is_reporting = False
        """Whether the session is reporting a change that concerns only the saving info and needs no write."""
        # Lock of the fields below; it is taken after the session's lock, and never held while waiting for a disk.
        self._wake = threading.Condition()
        self._changed_s: float | None = None
        self._within_s = MOVED_WITHIN_S
        self._retry_s = float("-inf")
        self._notes: dict[str, Any] = {}
        """New values of fields of the case's record that are not written yet, by field name."""
        self._is_urgent = False
        self._elsewhere: _WorkInNamedFileOnly | None = None
        """Latest work that was written to a named file because the disk of the live file does not accept writes."""
        self._is_copy_current = False
        """Whether the named file was written from memory after the last reported change."""
        self._busy: object = None
        """Identity of the write in progress; None between writes."""
        self._is_slow = False
        self._saved = None if file is None else moment_of(case)
        """State of the case that the live file contains."""
        self._num_begun = self._num_written = self._num_failed = 0
        """Counters of writes of the live file: number of the last begun, the last finished and the last failed write.
        """
        self._num_saved = self._num_copied = 0
        """Number of the last write that saved a change, and number of the write whose state the named file has."""
        self._named = named
        self._claim = claim
        self._copy_s: float | None = None
        """Session time, in s, of the next check or write of the named file; None if none is planned."""
        self._is_named_checked = named is None or named.is_locked
        """Whether the named file's content was compared with the last known content since the case was opened."""
        if held is not None and held.record.copy_path is not None:
            if self._named is None:
                self._named, self._is_named_checked = _recorded_file(held.record), False
            if held.record.used_s > (held.record.copied_s or 0.0):
                self._num_copied = -1
        self._written_flights: object = None
        """Identity of the list of flights that was last written to the live file."""
        self._is_ending = self._has_ended = False
        self._pictured = False
        self._is_use_numbered = False
        self._is_endpoint_written = False
        """Whether the connection details with which programs join this case are on the disk."""
        self._copier: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread that saves the case; call it when the case has become the session's current case."""
        with self._wake:
            self._plan_copy(0.0 if not self._is_named_checked else COPY_EVERY_S)
        threading.Thread(target=self._run, name="carina-saving", daemon=True).start()

    def __repr__(self) -> str:
        """Describe the saver by its saving info."""
        return f"CaseSaver({self.info!r})"

    # ------------------------------------------------------------ calls from other threads

    def changed(self, topics: frozenset[Topic]) -> None:
        """Schedule a write after a change of the case."""
        moved_s = RECORDED_WITHIN_S if self.case.flights.unwritten else MOVED_WITHIN_S
        within_s = moved_s if topics <= {"pose", "views"} else DECIDED_WITHIN_S
        with self._wake:
            self._is_copy_current = False
            if self._changed_s is None:
                self._changed_s, self._within_s = self._core.clock(), within_s
            elif within_s < self._within_s:
                self._within_s = within_s
            self._wake.notify_all()

    def settle(self) -> bool:
        """Write all present changes, and return whether they are on the disk.

        The call returns False as soon as the disk refuses a write that begins after the call, or does not respond for
        :data:`SLOW_S`. The failure of an earlier write is ignored, because its cause may have been removed. The caller
        must not hold the session's lock, which the writing thread needs.
        """
        with self._wake:
            begun = self._num_begun

            def is_written() -> bool:
                return self._num_written > begun or (self._changed_s is None and self._busy is None)

            def is_done() -> bool:
                # This condition includes the fields of the record; if only these cannot be written, no work is lost.
                return self._num_written > begun or (is_written() and not self._notes)

            if not is_done():
                self._is_urgent = True
                self._wake.notify_all()
                self._wake.wait_for(lambda: is_done() or self._num_failed > begun or self._is_slow or self._has_ended)
            return is_written()

    def end(self, within_s: float | None = None) -> bool:
        """Write the remaining changes and release the case; return whether both are done.

        With ``within_s`` the call waits at most that many seconds. Without, the call waits until the disk stops
        responding; the thread then continues in the background.
        """
        with self._wake:
            self._is_ending = True
            self._wake.notify_all()
            if within_s is not None:
                return self._wake.wait_for(lambda: self._has_ended, within_s)
            self._wake.wait_for(lambda: self._has_ended or self._is_slow)
            return self._has_ended

    @property
    def has_ended(self) -> bool:
        """Whether the remaining changes were written and the case was released."""
        return self._has_ended

    @property
    def is_elsewhere(self) -> bool:
        """Whether all changes are in a file that the user named, because the disk of the live file refuses them.

        The caller must hold no lock.
        """
        return self._elsewhere is not None and self.unsaved() is None

    @property
    def named(self) -> NamedFile | None:
        """The file under a name that the user chose; None where the case has none."""
        return self._named

    @property
    def copy_path(self) -> Path | None:
        """Path of the named file; None where the case has none."""
        return None if self._named is None else self._named.path

    @property
    def has_conflict(self) -> bool:
        """Whether the named file has content that this window did not write, so that the user must decide."""
        return self.info.copy_conflict is not None

    def unsaved(self) -> UnsavedWork | None:
        """Return the work that could not be saved; None if all is saved. The caller must not hold ``_wake``."""
        with self._core.lock:
            moment, flights = moment_of(self.case), self.case.flights.unwritten
        with self._wake:
            is_saved = self._changed_s is None and self._busy is None
            renamed = "alias" in self._notes
            saved, elsewhere, problem, held = self._saved, self._elsewhere, self.info.problem, self.held
        saved_path = None if held is None or saved is None else held.path
        copy_path = self.copy_path
        if elsewhere is not None:
            # A reported change may concern state that no file stores, so the states of the case are compared.
            saved, saved_path, copy_path = elsewhere.moment, elsewhere.path, None
            flights = tuple(one for one in flights if one.number not in elsewhere.flights)
        labels = unsaved_labels(moment if is_saved else saved, moment, renamed=renamed)
        num_flights = 0 if is_saved else len(flights)
        if not labels and not num_flights:
            return None
        return UnsavedWork(
            case_number=self.case.number,
            title=self.info.title or self.case.neutral_title,
            labels=labels,
            num_flights=num_flights,
            problem=problem or NOT_RESPONDING,
            saved_path=saved_path,
            num_saved=0 if saved is None else saved.position,
            copy_path=copy_path,
        )

    def call(self, alias: str | None, suggested: str | None) -> None:
        """Rename the case in its record, and show the new name and the suggested file name in the saving info."""
        with self._wake:
            self._notes["alias"] = alias
            self._wake.notify_all()
        self._set_info(title=alias, suggested=suggested)

    def flight_text(self, number: int) -> str:
        """Return the lines of a recorded flight, after :meth:`settle`; the call may wait for the disk."""
        file = self.file
        if file is None:
            raise CarinaError(self.info.problem or NOT_RESPONDING, code="case.not-saved")
        return file.recording_text(number)

    def save_to(self, path: Path, *, replace: bool = False, may_be_missing: bool = True) -> SavedAs:
        """Write the case as one whole file under a name, and update that file with the case from now on.

        The call waits for the disk of that file.

        Parameters
        ----------
        path
            Path of the file.
        replace
            Replace other content; the replaced content is stored beside the file.
        may_be_missing
            Write the file also where it was moved, renamed or deleted since the last save.

        Raises
        ------
        NamedFileConflictError
            If the file has other content than this window last read or wrote, or is open elsewhere. The file is
            unchanged.
        CarinaError, OSError, sqlite3.Error
            If it cannot be written.
        """
        before = self._named
        named = before if before is not None and before.has_path(path) else NamedFile(path, ct_digest=self.digest)
        with self._wake:
            file, num_saved = self.file, self._num_saved
            is_whole = file is not None and self.info.problem is None
        num_missing = 0
        elsewhere: _WorkInNamedFileOnly | None = None

        def write(place: Path, mark: SaveMark, placement: Placement) -> None:
            nonlocal num_missing, elsewhere
            ct_place = relative_path(place, self.place)
            if is_whole:
                assert file is not None
                file.write_copy(place, ct_place=ct_place, save_mark=mark, placement=placement)
                return
            # A copy of the live file would lack the changes that its disk has refused, or would wait for that disk.
            with self._core.lock:
                self._is_copy_current = True
                moment = moment_of(self.case)
                listed, unwritten = self.case.flights.listed, self.case.flights.unwritten
                finished = {one.number for one in unwritten if one.number is not None and one.closed}
            flights, num_missing = whole_flights(file, listed, unwritten, SLOW_S)
            if num_missing and place.exists():
                # The existing file may be the only one that still contains these flights.
                raise CarinaError(
                    f"{place.name} was left as it is: {flight_count(num_missing)} cannot be read from the faulty "
                    "disk; save the case under another name",
                    code="case.not-saved",
                )
            whole = WholeCase(self.case.info.volume, self.digest, moment, flights)
            self._files.write(place, whole, ct_place, mark, placement)
            written = {one.facts.recording_id for one in flights}
            elsewhere = _WorkInNamedFileOnly(path, moment, frozenset(written & finished))

        # The live file has all of this content, so the record may state the digest before the named file is written.
        before_placing = self._note_next_copy if is_whole and named is before else None
        try:
            replaced = named.write(write, replace=replace, may_be_missing=may_be_missing, before_placing=before_placing)
        except BaseException:
            self._is_copy_current = False
            if named is not before:
                named.close()
            raise
        mark = named.mark
        assert mark is not None
        now_s = self._records.now_s()
        copy_facts = {
            "copied_s": now_s,
            "copy_name": path.name,
            "copy_folder": str(path.parent),
            "copy_problem": None,
            "copy_conflict": None,
            "beside": None,
        }

        def is_outdated() -> bool:
            # The user saved the case under another name while the update of this file waited for its disk.
            return named is before and self._named is not before

        with self._change_info(copy_facts, unless=is_outdated):
            former = self._named
            if not is_outdated():
                self._notes |= {
                    "copy_path": str(path),
                    "copied_s": now_s,
                    "copy_digest": mark.digest,
                    "copy_save_id": mark.save_id,
                    "copy_generation": mark.generation,
                    "next_copy_digest": None,
                }
                self._named, self._num_copied, self._copy_s = named, max(self._num_copied, num_saved), None
                self._is_named_checked = True
                if elsewhere is not None:
                    self._elsewhere = elsewhere
                if former is not named:
                    # A thread that waits for the disk of the former file ends when that disk responds.
                    self._copier = None
                self._plan_copy(COPY_EVERY_S)
        if former is not None and former is not self._named:
            former.close()
        if self._has_ended:
            named.close()
        return SavedAs(num_missing, replaced)

    def _note_next_copy(self, mark: FileMark) -> None:
        """Store the digest of a save before the save replaces the file, so that a crash in between is recognised."""
        present = None if self._named is None else self._named.mark
        if self.held is not None and present is not None:
            # If the disk refuses, the only effect is that the file counts as changed elsewhere after a crash.
            with suppress(OSError, CarinaError):
                # The record gets both digests: it may contain the present one only as that of an interrupted save.
                self.held.note(
                    copy_digest=present.digest,
                    copy_save_id=present.save_id,
                    copy_generation=present.generation,
                    next_copy_digest=mark.digest,
                )

    # ------------------------------------------------------------ the thread that writes

    def _run(self) -> None:
        try:
            while self._has_work():
                self._try_write()
            if self._is_ending:
                self._close_and_unlock()
        finally:
            with self._wake:
                self._has_ended, self._is_slow = True, False
                self._wake.notify_all()
            # A job may have saved the case under another name since the case was released.
            if self._named is not None:
                self._named.close()

    def _has_work(self) -> bool:
        """Wait until there is something to write and return True; return False when the case is to be released."""
        with self._wake:
            while not self._is_ending:
                if not self._is_current(self):
                    return False
                wait_s = self._wait_s()
                if wait_s is not None and wait_s <= 0.0:
                    return True
                self._wake.wait(wait_s)
            return False

    def _wait_s(self) -> float | None:
        """Return the seconds until the next write; None if nothing is to be written. The caller holds ``_wake``."""
        now_s = self._core.clock()
        if self._changed_s is None:
            return None if not self._notes else 0.0 if self._is_urgent else max(self._retry_s - now_s, 0.0)
        return 0.0 if self._is_urgent else max(self._changed_s + self._within_s, self._retry_s) - now_s

    def _try_write(self) -> None:
        """Write the case's state, if it has changed, and changed record fields.

        A failed write is reported and tried again.
        """
        with self._wake:
            self._num_begun += 1
            self._busy = object()
            changed_s, self._changed_s = self._changed_s, None
            notes, self._notes = self._notes, {}
            self._is_urgent = False
        written: dict[str, Any] = {}
        exc: BaseException | None = None
        with self._shows_slow_disk():
            try:
                written = self._write(notes, is_changed=changed_s is not None)
            except Exception as error:  # Otherwise the thread would end and store no further change.
                exc = error
            with self._change_info(written | {"problem": None if exc is None else _error_text(exc)}):
                if exc is None:
                    self._num_written = self._num_begun
                    if changed_s is not None:
                        self._num_saved = self._num_begun
                else:
                    self._num_failed = self._num_begun
                    self._notes = notes | self._notes
                    if changed_s is not None:
                        self._changed_s = changed_s if self._changed_s is None else min(changed_s, self._changed_s)
                    self._retry_s = self._core.clock() + RETRY_S
                self._plan_copy(COPY_EVERY_S)
                self._busy, self._is_slow = None, False
        if exc is None and not self._pictured and self.held is not None and self.held.record.pictured_s is None:
            # The thumbnail is stored before the case is closed, so that a case of a killed process has one, too.
            self._store_thumbnail()

    def _write(self, notes: dict[str, Any], *, is_changed: bool) -> dict[str, Any]:
        """Write the live case and its record, and return the changed fields of the saving info."""
        volume = self.case.info.volume
        if self.held is None:
            self.held = self._records.begin(
                self.digest, self.place, begun_s=self.info.begun_s, case_id=self.case.case_id
            )
            self.case.case_id = self.held.record.case_id
            notes = {"scanned_on": volume.source.acquired_on} | notes
        if self.file is None:
            self.held.clear()
            self.file = self._files.create(self.held.path, volume, self.digest)
        if not self._is_endpoint_written:
            self.held.write_endpoint()
            self._is_endpoint_written = True
        facts: dict[str, Any] = {}
        if is_changed:
            with self._core.lock:
                # The time is read first, so that everything done before the stated time is on the disk.
                now_s = self._records.now_s()
                moment = moment_of(self.case)
                num_nodules = sum(target.lesion is not None for target in self.case.document.targets)
                flights = self.case.flights.listed
                recorded, removed = self.case.flights.unwritten, self.case.flights.removed
            self.file.save(moment)
            self._saved = moment
            for recording in recorded:
                self.file.keep_recording(recording)
            if flights is not self._written_flights:
                self.file.set_recordings(flights, removed=removed)
                self._written_flights = flights
            self._elsewhere = None
            with self._core.lock:
                self.case.flights.unwritten = tuple(one for one in self.case.flights.unwritten if not one.is_complete)
            facts["saved_s"] = now_s
            place = self.place or self.held.record.place
            counts = {"num_changes": moment.position, "num_nodules": num_nodules}
            notes = {"used_s": now_s, "place": place} | counts | notes
            if not self._is_use_numbered:
                notes["use_number"] = self._records.next_use_number()
                self._is_use_numbered = True
        self.held.note(**notes)
        return facts

    def _store_thumbnail(self) -> None:
        """Store a thumbnail of the case; a failure is logged and stops nothing."""
        if self.held is None or self._files.picture is None:
            return
        scene = self._core.scene()
        if scene is None or scene.case_number != self.case.number or not scene.has_lumen:
            return
        self._pictured = True
        try:
            picture = self._files.picture(scene)
            with self._shows_slow_disk():
                self.held.put_picture(picture, self._records.now_s())
        except DiskError as error:
            # The next write of the case reports the disk; the thumbnail is created again when the case is closed.
            logger.info("the disk refused the thumbnail of the case (%s)", error.code)
        except Exception as error:
            log_fault(logger, "the thumbnail of the case could not be created", error)
        if self.info.problem == ELSEWHERE:
            self._set_info(problem=None)

    def _close_and_unlock(self) -> None:
        """Write the remaining changes, then close the live file and release its lock."""
        if self._changed_s is not None or self._notes:
            self._try_write()
        # If the disk refuses writes, no thumbnail is stored: its error would replace the error about the case.
        if self.info.problem is None:
            self._store_thumbnail()
        with self._shows_slow_disk():
            if self._copier is not None:
                # A write of the named file that is in progress could otherwise replace newer content.
                self._copier.join()
            if self._copy_is_behind():
                self._update_named_file()
            if self._copy_is_behind():
                self._emit_copy_problem()
            if self._named is not None:
                self._named.close()
            if self._changed_s is not None and self.info.problem is not None and not self.is_elsewhere:
                self._core.emit(
                    ErrorEvent("case.not-saved", f"the latest changes have not been saved: {self.info.problem}")
                )
            try:
                if self.file is not None:
                    self.file.close()
            except Exception as error:
                log_fault(logger, "a case could not be closed", error)
            finally:
                if self.held is not None:
                    self.held.release()
                if self._claim is not None:
                    self._claim.release()

    def _emit_copy_problem(self) -> None:
        """Report that the named file does not have the latest changes when the case is closed."""
        info = self.info
        if info.copy_conflict is not None:
            self._core.emit(ErrorEvent("case.changed", f"{info.copy_problem}"))
        elif info.copy_problem is not None and self._changed_s is None:
            words = f"the file {info.copy_name} does not have the latest changes: {info.copy_problem}"
            self._core.emit(ErrorEvent("case.copy", f"{words}. All changes are saved in the case on this computer"))

    # ------------------------------------------------------------ the thread that writes the named file

    def _copy_is_behind(self) -> bool:
        if self._named is None:
            return False
        return self._num_copied < self._num_saved or (self._changed_s is not None and not self._is_copy_current)

    def _plan_copy(self, within_s: float) -> None:
        """Schedule the next check of the named file if the file is outdated or was not compared yet.

        The caller holds ``_wake``.
        """
        if self._copy_s is not None or not (self._copy_is_behind() or self._is_named_check_due()):
            return
        self._copy_s = self._core.clock() + within_s
        self._wake.notify_all()
        if self._copier is None:
            self._copier = threading.Thread(target=self._run_copies, name="carina-copying", daemon=True)
            self._copier.start()

    def _run_copies(self) -> None:
        while True:
            with self._wake:
                while True:
                    if self._is_ending or self._has_ended or threading.current_thread() is not self._copier:
                        return
                    wait_s = None if self._copy_s is None else self._copy_s - self._core.clock()
                    if wait_s is not None and wait_s <= 0.0:
                        break
                    self._wake.wait(wait_s)
                self._copy_s = None
                # The first comparison follows the opening, which is reported as a change. Without this distinction,
                # opening a case could rewrite the named file, depending on when the thread starts.
                is_behind = self._copy_is_behind() if self._is_named_checked else self._num_copied < self._num_saved
                if not is_behind and not self._is_named_check_due():
                    continue
            self._update_named_file(writes=is_behind)

    def _is_named_check_due(self) -> bool:
        """Return whether the named file was not compared yet, or was open elsewhere when it was compared."""
        return self._named is not None and (not self._is_named_checked or self.info.copy_conflict == "open-elsewhere")

    def _update_named_file(self, *, writes: bool = True) -> None:
        """Write the named file, or only compare its content if ``writes`` is False.

        Called once a minute and at closing.
        """
        named = self._named
        assert named is not None
        has_ended = threading.Event()

        def slow() -> None:
            with self._change_info(
                {"copy_problem": NOT_RESPONDING}, unless=lambda: has_ended.is_set() or is_outdated()
            ):
                pass

        def is_outdated() -> bool:
            return self._named is not named

        watch = threading.Timer(SLOW_S, slow)
        watch.daemon = True
        watch.start()
        try:
            if writes:
                self.save_to(named.path, may_be_missing=False)
            else:
                named.check()
                has_ended.set()
                with self._change_info(
                    {"copy_problem": None, "copy_conflict": None, "beside": None}, unless=is_outdated
                ):
                    self._is_named_checked = self._is_named_checked or not is_outdated()
                    self._plan_copy(COPY_EVERY_S)
        except NamedFileConflictError as conflict:
            has_ended.set()
            self.show_conflict(conflict)
        except Exception as error:
            has_ended.set()
            with self._change_info({"copy_problem": _error_text(error)}, unless=is_outdated):
                self._plan_copy(COPY_RETRY_S)
        finally:
            has_ended.set()
            watch.cancel()

    def show_conflict(self, conflict: NamedFileConflictError) -> None:
        """Show in the saving info that the named file was not written, and which choices the user has.

        A conflict of another path is not shown, because the named file of the case is not affected.
        """
        if self._named is None or conflict.path != self._named.path:
            return
        values = {
            "copy_problem": str(conflict),
            "copy_conflict": conflict.kind,
            "beside": str(free_path_beside(conflict.path)),
        }
        with self._change_info(values):
            self._is_named_checked = True
            self._plan_copy(COPY_EVERY_S)

    # ------------------------------------------------------------ changes of the saving info

    @contextmanager
    def _shows_slow_disk(self) -> Iterator[None]:
        """Show a problem in the saving info if the block waits for the disk longer than :data:`SLOW_S`."""
        this = object()

        def slow() -> None:
            with self._change_info({"problem": ELSEWHERE}, unless=lambda: self._busy is not this):
                if self._busy is this:
                    self._is_slow = True

        with self._wake:
            self._busy = this
        watch = threading.Timer(SLOW_S, slow)
        watch.daemon = True
        watch.start()
        try:
            yield
        finally:
            watch.cancel()
            with self._wake:
                if self._busy is this:
                    self._busy, self._is_slow = None, False
                    self._wake.notify_all()

    def _set_info(self, **values: object) -> None:
        with self._change_info(values):
            pass

    @contextmanager
    def _change_info(self, values: dict[str, Any], unless: Callable[[], bool] = lambda: False) -> Iterator[None]:
        """Change fields of the saving info and report the change; the block runs with both locks held."""
        with self._core.lock:
            with self._wake:
                before = self.info
                if not unless():
                    self.info = before.with_(**values)
                yield
                self._wake.notify_all()
            if self.info.shown != before.shown and self._core.case is self.case:
                self.is_reporting = True
                try:
                    self._core.changed("state")
                finally:
                    self.is_reporting = False


def _recorded_file(record: CaseRecord) -> NamedFile:
    """Return the named file of a stored case, with the content that the record states as Carina's."""
    assert record.copy_path is not None
    mark = None
    if record.copy_digest is not None:
        mark = FileMark(record.copy_digest, record.copy_save_id, record.copy_generation)
    return NamedFile(Path(record.copy_path), mark, ct_digest=record.digest, next_digest=record.next_copy_digest)


def _error_text(trouble: BaseException) -> str:
    if isinstance(trouble, CarinaError):
        return str(trouble)
    if isinstance(trouble, OSError):
        return str(disk_trouble(trouble, "cannot save the case", None))
    if isinstance(trouble, sqlite3.Error):
        return f"cannot save the case: {trouble}"
    log_fault(logger, "the case could not be saved", trouble)
    return f"the case could not be saved: internal error in Carina ({type(trouble).__name__})"
