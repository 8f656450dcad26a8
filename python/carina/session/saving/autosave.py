"""Storage of the open case: the live file is at most two seconds behind, and up to date before risky steps."""

from __future__ import annotations

import logging
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from carina import commands as c
from carina.case import CaseFile, CaseFileError
from carina.case.stored_state import Moment
from carina.disk import disk_trouble
from carina.display import one_line
from carina.errors import CarinaError, UsageError
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.core import SessionCore
from carina.session.flights.recorded_flights import needed_flight
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import OpenCase, moment_of
from carina.session.saving.unsaved_work import UnsavedWork
from carina.session.saving.writer import NOT_RESPONDING, CaseSaver
from carina.session.state.snapshot import Changed, ErrorEvent, SavingInfo, UserMessage
from carina.session.store.case_names import suggested_file_name
from carina.session.store.find_scan import CASE_SUFFIX, FoundScan
from carina.session.store.flight_copies import flight_count
from carina.session.store.interfaces import CachedCtSource, CaseFileFunctions, CtCache, StoredCaseFile
from carina.session.store.named_file import FileMark, NamedFile, NamedFileConflictError
from carina.session.store.named_file_lock import LockedElsewhereError, NamedLock
from carina.session.store.registry import CaseRecord, CaseRecords, LockedCase
from carina.volume import same_geometry

if TYPE_CHECKING:
    from carina.case.recordings import RecordingFacts
    from carina.session.core import Event
    from carina.session.engines import Cancel, Progress
    from carina.session.store.find_scan import CaseScans
    from carina.volume import Volume

__all__ = ["Autosave", "CachedCtSource", "CaseFileFunctions", "CtCache", "ReopenedCase", "StoredCaseFile"]

logger = logging.getLogger(__name__)

OPEN_ELSEWHERE = "this CT is already open in another window; changes made here are saved as a separate case"
HELD_TRIES, HELD_EVERY_S = 4, 0.05
"""Number of attempts to lock a case, and the interval between them in s, because another program's check may lock
it."""
CLOSING_S = 60.0
"""Maximum time in s that Carina waits at its end for a disk that does not respond."""


@one_line
@dataclass(slots=True)
class ReopenedCase:
    """A stored case that is being opened: its lock and record, its live file and its flights."""

    held: LockedCase
    file: StoredCaseFile
    flights: tuple[RecordingFacts, ...] = ()

    def note_ct(self, volume: Volume) -> None:
        """Store the scan date of the CT in the case's record if the record has none."""
        scanned_on = self.held.record.scanned_on or volume.source.acquired_on
        if scanned_on != self.held.record.scanned_on:
            self.held.note(scanned_on=scanned_on)


class ReplacementCase:
    """The stored case that replaces the open one: it is found and locked, then attached to the session or released."""

    def __init__(self, saving: Autosave) -> None:
        self._saving = saving
        self._digest: str | None = None
        self._reopened: ReopenedCase | None = None
        self._named: NamedFile | None = None
        self._claim: NamedLock | None = None
        self._is_new = False
        """Whether the stored case is a new copy; the copy is deleted if the case is not shown after all."""

    def begin(self, volume: Volume) -> None:
        """Prepare a new case of a CT, which is stored after its first change.

        Stored cases of the CT are not changed.
        """
        self._digest = self._saving.digest_of(volume)
        self._claim_ct(is_new=False)

    def _claim_ct(self, *, is_new: bool) -> None:
        """Claim the CT, and notify the user of a new case if another window has the CT open."""
        records = self._saving.records
        if records is None or self._digest is None:
            return
        try:
            self._claim = records.claim(self._digest)
        except LockedElsewhereError:
            if is_new:
                self._saving.core.emit(UserMessage(OPEN_ELSEWHERE))

    def take(self, digest: str | None, case_id: str | None = None) -> ReopenedCase | None:
        """Lock and return a stored case of a CT, the given or the last used one.

        None if there is none or it cannot be opened.
        """
        self._digest = digest
        records = self._saving.records
        if records is None or digest is None:
            record = None
        elif case_id is None:
            record = records.newest_of(digest)
        else:
            record = records.find(case_id)
            if record is not None and record.digest != digest:
                raise CarinaError(
                    "the CT at this location is not the one that this case was made from. Choose the case's own CT, "
                    "or open this CT to start a new case",
                    code="case.other-ct",
                )
        self._reopened = None if record is None else self._saving.opened(record)
        self._claim_ct(is_new=record is None)
        return self._reopened

    def reopened(self, volume: Volume, case_id: str | None = None) -> Moment | None:
        """Return the stored state of a CT's case, wherever the CT is now; None if no state is stored or readable."""
        reopened = self.take(self._saving.digest_of(volume), case_id)
        self._saving.notify_still_waiting(self._digest)
        if reopened is None:
            return None
        try:
            moment = reopened.file.load(volume)
            reopened.note_ct(volume)
            return moment
        except (OSError, sqlite3.Error, CarinaError) as error:
            if isinstance(error, CaseFileError) and error.code == "case.empty":
                # After a crash right after the beginning of the case, the same file is used again.
                return None
            self._saving.report_unreadable(reopened.held, error)
        self.release()
        return None

    def imported(self, volume: Volume, case: CaseFile, mark: FileMark | None) -> Moment | None:
        """Open the content of a case file, and store its further changes.

        If the case that wrote the file is stored on this machine, that case is continued; otherwise the content of the
        file becomes a new stored case. A file of a newer version of Carina is shown and not stored. A file in the
        folder of stored cases (a live file) does not count as a named file: its case is continued, or copied if another
        window has the case open.

        Parameters
        ----------
        mark
            Mark of the opened file, which is updated with the case from now on; None for a dropped file, which has no
            path.

        Returns
        -------
        Moment | None
            None if no state was saved in the file.
        """
        digest = self._saving.digest_of(volume)
        if digest is None or case.note is not None:
            return case.load(volume)
        self._digest = digest
        if mark is not None and self._saving.stores(case.path):
            mark, self._reopened = None, self._saving.reopened_live(case)
        else:
            if mark is not None:
                self._named = self._saving.named_file(case, mark)
            self._reopened = self._saving.reopened_file(case, mark)
        self._claim_ct(is_new=False)
        if self._reopened is None:
            self._is_new = True
            self._reopened = self._saving.adopt_copy(case, mark)
        self._reopened.note_ct(volume)
        try:
            return self._reopened.file.load(volume)
        except CaseFileError as error:
            if error.code != "case.empty":
                raise
            return None

    def attach(self, case: OpenCase, place: str | None) -> None:
        """Store this case from now on; the caller holds the session's lock."""
        reopened, self._reopened = self._reopened, None
        if reopened is not None and not case.flights.listed:
            # A case that was open before has its list in memory, which its file may lack.
            case.flights.listed = tuple(one for one in reopened.flights if one.recording_id not in case.flights.removed)
        named, self._named = self._named, None
        claim, self._claim = self._claim, None
        if self._digest is not None:
            self._saving.attach(case, place, self._digest, reopened=reopened, named=named, claim=claim)

    def release(self) -> None:
        """Release the stored case, the named file and the claim, because the case is not shown after all."""
        reopened, self._reopened = self._reopened, None
        named, self._named = self._named, None
        claim, self._claim = self._claim, None
        if named is not None:
            named.close()
        if claim is not None:
            claim.release()
        if reopened is not None:
            reopened.file.close()
            reopened.held.release()
            if self._is_new:
                self._saving.remove(reopened.held)


class Autosave(CommandHandlers):
    """The stored case of a session and the commands about it; :class:`CaseSaver` writes the case.

    Parameters
    ----------
    core
        The session.
    records
        The records of the user's cases; None stores no case.
    files
        The storage that makes and opens case files.
    """

    def __init__(self, core: SessionCore, records: CaseRecords | None, files: CaseFileFunctions | None) -> None:
        super().__init__(core)
        self.records = records
        self._files = files
        self._saver: CaseSaver | None = None
        self._ending: list[CaseSaver] = []
        """Case savers whose disk did not respond when their case was closed."""
        self._expected_digest: str | None = None
        """Digest of the CT that the user must open to continue a dropped case; None if no case waits."""
        if records is not None:
            core.subscribe(self._on_event)

    # ------------------------------------------------------------ opening and closing

    @contextmanager
    def while_opening(self) -> Iterator[ReplacementCase]:
        """Release the open case while another case is opened; after a failure, store the open case again."""
        before = self._saver
        self.refuse_to_lose()
        self.release_case()
        while_opening = ReplacementCase(self)
        try:
            yield while_opening
        except BaseException:
            while_opening.release()
            if before is not None:
                again = ReplacementCase(self)
                try:
                    again.take(before.digest, None if before.held is None else before.held.record.case_id)
                except (OSError, sqlite3.Error, CarinaError) as error:
                    # The case remains on screen, so its changes are stored as a separate case.
                    logger.warning("the open case could not be stored again (%s)", type(error).__name__)
                with self.core.lock:
                    again.attach(before.case, before.place)
            raise

    def opened(self, record: CaseRecord) -> ReopenedCase | None:
        """Open a stored case and own it from now on; if this is impossible, notify the user and return None."""
        assert self.records is not None
        assert self._files is not None
        for keeper in self._ending:
            if keeper.held is not None and keeper.held.record.case_id == record.case_id:
                keeper.end(CLOSING_S)
        held = self.records.hold(record)
        for _ in range(HELD_TRIES):
            if held is not None:
                break
            time.sleep(HELD_EVERY_S)
            held = self.records.hold(record)
        if held is None:
            self.core.emit(UserMessage(OPEN_ELSEWHERE))
            return None
        try:
            if held.path.exists():
                file = self._files.open(held.path)
                return ReopenedCase(held, file, self._flights_in(file))
        except (OSError, sqlite3.Error, CarinaError) as error:
            self.report_unreadable(held, error)
        held.release()
        return None

    def named_file(self, case: CaseFile, mark: FileMark) -> NamedFile:
        """Return the named file that a case is opened from; warn at once if another window or program has it open."""
        named = NamedFile(case.path.absolute(), mark, ct_digest=case.digest)
        try:
            named.check()
        except NamedFileConflictError as conflict:
            self.core.emit(UserMessage(str(conflict)))
        except OSError:
            pass  # The error is reported when the file is written.
        return named

    def stores(self, path: Path) -> bool:
        """Return whether a path is in the folder of the stored cases; False if no cases are stored."""
        return self.records is not None and self.records.stores(path)

    def reopened_live(self, case: CaseFile) -> ReopenedCase | None:
        """Own the stored case whose live file was opened; None if it is open elsewhere, or not in the list."""
        assert self.records is not None
        record = self.records.record_at(case.path)
        return None if record is None else self.opened(record)

    def reopened_file(self, case: CaseFile, mark: FileMark | None) -> ReopenedCase | None:
        """Lock the stored case from which a case file was saved, and return it; None if there is no such case."""
        record = self._record_of(case, mark)
        reopened = None if record is None else self.opened(record)
        if reopened is not None and mark is not None and reopened.held.record.copy_path != str(case.path.absolute()):
            reopened.held.note(copy_path=str(case.path.absolute()))
        return reopened

    def _record_of(self, case: CaseFile, mark: FileMark | None) -> CaseRecord | None:
        """Return the record of the stored case that a case file is a copy of.

        A named file is identified by its content alone: by the digest that the case recorded when it wrote the file. A
        dropped file may be older, so all its steps must be steps of the stored case.
        """
        assert self.records is not None
        records = [one for one in self.records.all() if one.digest == case.digest]
        if mark is None:
            steps = _labels_and_times(case)
            return next(
                (one for one in records if steps and self._live_labels_and_times(one)[: len(steps)] == steps), None
            )
        path = str(case.path.absolute())
        for record in records:
            is_same = mark.digest in {record.copy_digest, record.next_copy_digest}
            # A moved file still belongs to its case. A copy beside the original becomes a separate case.
            if is_same and (record.copy_path == path or not Path(record.copy_path or "").exists()):
                return record
        if any(one.copy_path == path for one in records):
            self.core.emit(
                UserMessage(
                    f"The file {case.path.name} was changed since this computer saved it last: it is opened as a new "
                    "case. The earlier case stays in the list of recent cases"
                )
            )
        return None

    def _live_labels_and_times(self, record: CaseRecord) -> tuple[tuple[str, float], ...]:
        assert self.records is not None
        try:
            with CaseFile.open(self.records.path_of(record), read_only=True) as live:
                return _labels_and_times(live)
        except (OSError, sqlite3.Error, CarinaError):
            return ()

    def adopt_copy(self, case: CaseFile, mark: FileMark | None) -> ReopenedCase:
        """Store a copy of a case file as a new case; with a ``mark``, the file becomes the named file of the new case.

        The mark identifies the content of the file as read, so that a later change by another program is detected.
        """
        assert self.records is not None
        assert self._files is not None
        held = self.records.begin(case.digest, None)
        try:
            case.write_copy(held.path, private=True)
            file = self._files.open(held.path)
        except BaseException:
            held.release()
            self.remove(held)
            raise
        steps, now_s, flights = case.history(), self.records.now_s(), self._flights_in(file)
        # Times are chosen so that no step or flight of the case ends in the future.
        last_s = [step.at_s for step in steps] + [one.begun_s + one.length_s for one in flights]
        if mark is not None:
            held.note(
                copy_path=str(case.path.absolute()),
                copied_s=now_s,
                copy_digest=mark.digest,
                copy_save_id=mark.save_id,
                copy_generation=mark.generation,
            )
        held.note(
            begun_s=now_s - max(last_s, default=0.0),
            num_changes=sum(step.holds for step in steps),
            holds_ct=case.holds_ct,
        )
        return ReopenedCase(held, file, flights)

    def _flights_in(self, file: StoredCaseFile) -> tuple[RecordingFacts, ...]:
        try:
            return file.recordings()
        except (OSError, sqlite3.Error, CarinaError) as error:
            self.core.emit(
                ErrorEvent("case.write_recording", f"the recorded flights of this case could not be listed: {error}")
            )
            return ()

    def remove(self, held: LockedCase) -> None:
        """Remove a stored case that was prepared and is not shown, and release its lock."""
        assert self.records is not None
        if self.records.forget(held.record):
            self.records.remove(held.record.case_id)

    def store_waiting_case(self, case: CaseFile) -> bool:
        """Store a dropped case until its CT is opened; return False if no case is stored."""
        if self.records is None or self._files is None:
            return False
        if self._record_of(case, None) is None:
            reopened = self.adopt_copy(case, None)
            reopened.file.close()
            reopened.held.release()
        self._expected_digest = case.digest
        return True

    def notify_still_waiting(self, digest: str | None) -> None:
        """Notify the user if the opened CT is not that of the dropped case that waits for its CT."""
        expected, self._expected_digest = self._expected_digest, None
        if expected is not None and digest != expected:
            self.core.emit(
                UserMessage(
                    "this is not the CT of the case that you dropped; that case stays in the list of recent cases"
                )
            )

    def open_ct_of(self, case: CaseFile) -> FoundScan | None:
        """Return the CT of the open case, if it is also the CT of this case file."""
        saver = self._saver
        if saver is None or saver.digest != case.digest or self.core.case is not saver.case:
            return None
        volume = saver.case.info.volume
        return FoundScan(volume, saver.place) if same_geometry(volume, case.source) else None

    def report_unreadable(self, held: LockedCase, trouble: BaseException) -> None:
        """Report that a stored case is unreadable and unchanged, and that a new case was begun."""
        self.core.emit(
            ErrorEvent(
                "case.unreadable",
                f"the saved case of this CT could not be read: {trouble}. Its file is unchanged: "
                f"{held.path}. This is a new case of the same CT.",
            )
        )

    def open_ct(self, path: str, progress: Progress, cancel: Cancel, *, series: str | None = None) -> Volume:
        """Open a CT of this machine, with the cache if there is one.

        Parameters
        ----------
        path, progress, cancel
            As in :func:`carina.open_volume`.
        series
            Key of a DICOM series; None opens the likeliest chest CT.
        """
        stored = None if self._files is None else self._files.open_ct
        opener = self.core.parts.open_volume if stored is None else stored
        return opener(path, progress, cancel) if series is None else opener(path, progress, cancel, series=series)

    def series_of_case(self, volume: Volume, path: str, case_id: str, job: Job) -> Volume:
        """Return the CT of a stored case, which may be another series of the folder than the likeliest chest CT.

        Parameters
        ----------
        volume
            The likeliest chest CT of the folder; returned if no series is the CT of the case.
        path
            The folder.
        case_id
            The stored case.
        job
            The job that opens the case.
        """
        record = None if self.records is None else self.records.find(case_id)
        if record is None or self.digest_of(volume) == record.digest:
            return volume
        for info in volume.source.other_series:
            if info.refused is None and info.num_slices > 1:
                other = self.open_ct(path, job.progress, job.cancel, series=info.key)
                if self.digest_of(other) == record.digest:
                    return other
        return volume

    def digest_of(self, volume: Volume) -> str | None:
        """Return the digest that identifies a CT; None where no case is stored."""
        return None if self._files is None or self.records is None else self._files.digest(volume)

    def attach(
        self,
        case: OpenCase,
        place: str | None,
        digest: str,
        *,
        reopened: ReopenedCase | None,
        named: NamedFile | None,
        claim: NamedLock | None,
    ) -> None:
        """Store this case from now on; the caller holds the session's lock."""
        assert self.records is not None
        assert self._files is not None
        stored = None if reopened is None else reopened.held.record
        suggested = (
            self._suggested_path(None, case.case_id)
            if stored is None
            else self._suggested_path(stored.alias, stored.case_id)
        )
        begun_s = self.records.now_s() - (self.core.clock() - case.begun_s)
        info = SavingInfo(keeps=True, begun_s=begun_s, suggested=suggested)
        if reopened is not None:
            record = reopened.held.record
            case.case_id = record.case_id
            case.begun_s = self.core.clock() - max(0.0, self.records.now_s() - record.begun_s)
            copy = None if record.copy_path is None else Path(record.copy_path)
            info = SavingInfo(
                keeps=True,
                saved_s=record.used_s,
                begun_s=record.begun_s,
                title=record.alias,
                continued_s=record.used_s,
                continued_changes=record.num_changes,
                copied_s=record.copied_s,
                copy_name=None if copy is None else copy.name,
                copy_folder=None if copy is None else str(copy.parent),
                suggested=suggested,
            )
        saver = CaseSaver(
            self.core,
            self.records,
            self._files,
            case,
            place=place,
            digest=digest,
            is_current=lambda keeper: keeper is self._saver,
            held=None if reopened is None else reopened.held,
            file=None if reopened is None else reopened.file,
            named=named,
            claim=claim,
            info=info,
        )
        self._saver = saver
        saver.start()

    def _suggested_path(self, alias: str | None, case_id: str) -> str | None:
        """Return a path in the documents folder for the named file of a case; None without such a folder."""
        documents = None if self.records is None else self.records.documents
        return None if documents is None else str(documents / f"{suggested_file_name(alias, case_id)}{CASE_SUFFIX}")

    def refuse_to_lose(self) -> None:
        """Refuse to close the case while its latest changes are in no file; not to be called with the session locked.

        Raises
        ------
        UsageError
            ``case.not-saved``: if the disk has not accepted the latest changes, and they were not saved elsewhere.
        """
        saver = self._saver
        if saver is None or saver.settle() or saver.is_elsewhere:
            return
        raise UsageError(
            f"the case stays open, because its latest changes could not be saved: {saver.info.problem}. Save it in "
            "another folder (Ctrl+S), or free some space",
            code="case.not-saved",
        )

    def release_case(self, within_s: float | None = None) -> None:
        """Write the remaining changes and release the case.

        The wait for a disk that does not respond is in the background, unless ``within_s`` is given.
        """
        saver = self._saver
        if saver is None:
            return
        self._ending = [keeper for keeper in self._ending if not keeper.has_ended or keeper.unsaved() is not None]
        has_ended = saver.end(within_s)
        if not has_ended or saver.unsaved() is not None:
            self._ending.append(saver)
            if not has_ended and within_s is not None:
                logger.warning("Carina is closing before the latest changes to a case have been written to disk")
        if self._saver is saver:
            self._saver = None

    def unsaved(self) -> tuple[UnsavedWork, ...]:
        """Return the work of the open case and of earlier cases that could not be saved.

        The call waits for each disk, up to a time limit. The caller must not hold the session's lock.
        """
        if self._saver is not None:
            self._saver.settle()
        for keeper in self._ending:
            keeper.end()
        return tuple(work for keeper in self._savers() if (work := keeper.unsaved()) is not None)

    def save_elsewhere(self, case_number: int, path: Path) -> Path:
        """Save a case with unsaved work to another file, and return the file.

        Parameters
        ----------
        case_number
            ``case_number`` of the :class:`UnsavedWork`.
        path
            A new file, or a folder, in which the file gets the neutral alias as its name.

        Raises
        ------
        UsageError
            ``case.exists``: if the file exists; ``case.no-place``: if its folder does not, or stores Carina's cases.
        CarinaError
            If the case cannot be written to that path either.
        """
        keeper = next(one for one in self._savers() if one.case.number == case_number)
        target = path.expanduser().absolute()
        if target.is_dir():
            target /= keeper.case.neutral_title.replace(" ", "-")
        target = _with_suffix(target)
        if target.exists():
            raise UsageError(f"{target} already exists; choose another name", code="case.exists")
        if not target.parent.is_dir():
            raise UsageError(f"the folder {target.parent} does not exist", code="case.no-place")
        assert self.records is not None
        self.records.refuse_stored(target)
        try:
            keeper.save_to(target)
        except OSError as error:
            raise disk_trouble(error, "cannot save the case to", target) from error
        except sqlite3.Error as error:
            raise CarinaError(f"cannot save the case to {target}: {error}", code="case.not-saved") from error
        return target

    def _savers(self) -> tuple[CaseSaver, ...]:
        return (*self._ending, *(() if self._saver is None else (self._saver,)))

    def close(self, within_s: float = CLOSING_S) -> None:
        """Write the remaining changes and end the threads; wait up to ``within_s`` for a disk that does not respond."""
        self.release_case(within_s)
        if self._files is not None:
            self._files.close()

    @property
    def info(self) -> SavingInfo:
        """Saving state of the open case, as the window shows it."""
        saver = self._saver
        return SavingInfo() if saver is None else saver.info

    def _on_event(self, event: Event) -> None:
        """Notify the saver of the open case of a change event, so that the saver writes the case.

        Called with the session locked.
        """
        saver = self._saver
        if saver is not None and isinstance(event, Changed) and self.core.case is saver.case and not saver.is_reporting:
            saver.changed(event.topics)

    def write_now(self) -> bool:
        """Write the remaining changes before a risky step, and return whether all changes are on the disk.

        The caller must not hold the session's lock.
        """
        saver = self._saver
        return saver is None or saver.settle()

    # ------------------------------------------------------------ state for other objects

    def rename(self, case_id: str, alias: str | None) -> bool:
        """Rename the open case; return False if another case is open."""
        saver = self._saver
        if saver is None or saver.held is None or saver.held.record.case_id != case_id:
            return False
        saver.call(alias, self._suggested_path(alias, case_id))
        return True

    def place_of(self, case: OpenCase) -> str | None:
        """Return the path from which the CT of the open case was opened; None if it is unknown."""
        saver = self._saver
        return None if saver is None or saver.case is not case else saver.place

    @property
    def scans(self) -> CaseScans | None:
        """Search for the CTs of case files; None if case files cannot be opened."""
        return None if self._files is None else self._files.scans

    @property
    def cache(self) -> CtCache | None:
        """The cache of CTs; None without a cache."""
        return None if self._files is None else self._files.cache

    # ------------------------------------------------------------ programs that join

    @property
    def open_case(self) -> tuple[str, int] | None:
        """ID and number of the open case; None if no case is open or the case is not stored."""
        saver = self._saver
        return None if saver is None or saver.held is None else (saver.held.record.case_id, saver.case.number)

    @does(c.KeepNow)
    def keep_now(self, _command: c.KeepNow) -> None:
        """Write all changes to the disk now, including changes by other windows and programs."""
        case, saver = self.core.needed_case(), self._saver
        if saver is None or saver.case is not case:
            raise UsageError("this case is no longer open here", code="case.closed")
        is_saved = saver.settle()
        if self._saver is not saver or saver.has_ended:
            raise UsageError("this case is no longer open here", code="case.closed")
        if not is_saved:
            raise CarinaError(saver.info.problem or NOT_RESPONDING, code="case.not-saved")

    @answers(c.FlightFileQuery)
    def flight_file_text(self, question: c.FlightFileQuery) -> str:
        """Return the lines of a recorded flight.

        The call waits for the disk, so the caller must not hold the session's lock.
        """
        return self.flight_text(question.number)

    def flight_text(self, number: int) -> str:
        """Return the lines of a recorded flight by its number; the call waits for the disk."""
        case, saver = self.core.needed_case(), self._saver
        with self.core.lock:
            needed_flight(case, number)
        if saver is None or saver.case is not case:
            raise UsageError("this case is no longer open here", code="case.closed")
        if not saver.settle():
            raise CarinaError(saver.info.problem or NOT_RESPONDING, code="case.not-saved")
        return saver.flight_text(number)

    # ------------------------------------------------------------ the named file

    @answers(c.CurrentMoment)
    def moment_to_keep(self, _question: c.CurrentMoment) -> Moment:
        """Return the current state of the case, for a caller that stores the case in a separate file."""
        case = self.core.needed_case()
        with self.core.lock:
            return moment_of(case)

    @does(c.SaveCase)
    def save_case(self, command: c.SaveCase) -> str:
        """Save the case to a named file, as a job; without a path, update the named file of the case."""
        self.core.needed_case()
        saver = self._saver
        if saver is None:
            raise UsageError("this session does not store the case, so it cannot save it", code="case.not-kept")
        known = saver.copy_path
        if command.path is None and known is None:
            raise UsageError(
                "this case has not been saved to a file yet: choose a folder and a name", code="case.no-place"
            )
        path = known if command.path is None else _with_suffix(Path(command.path).expanduser())
        assert path is not None
        is_known = saver.named is not None and saver.named.has_path(path)
        if not path.is_absolute():
            raise UsageError(f"expected a full path such as C:\\cases\\NAME or /home/NAME; found {command.path}")
        assert self.records is not None
        self.records.refuse_stored(path)
        if path.exists() and not command.replace and not is_known:
            raise UsageError(f"{path} already exists; choose another name, or replace it", code="case.exists")

        def work(job: Job) -> None:
            job.check()
            saver.settle()
            if self._saver is not saver:
                return
            try:
                saved = saver.save_to(path, replace=command.replace and (not is_known or saver.has_conflict))
            except NamedFileConflictError as conflict:
                saver.show_conflict(conflict)
                raise
            except OSError as error:
                raise disk_trouble(error, "cannot save the case to", path) from error
            # The record must be on the disk before a program that opens the file looks up whether the case is open.
            saver.settle()
            was_replaced = "" if saved.replaced is None else f"; the replaced file is stored as {saved.replaced.name}"
            self.core.emit(UserMessage(f"saved as {path}{_without_flights(saved.num_missing)}{was_replaced}"))

        return self.core.jobs.start("save", "saving the case", work)


def _labels_and_times(case: CaseFile) -> tuple[tuple[str, float], ...]:
    """Return the label and the time, in s since the creation of the case, of each step.

    Together they identify the case.
    """
    return tuple((step.label, step.at_s) for step in case.history())


def _without_flights(num_flights: int) -> str:
    return f", without {flight_count(num_flights)} that could not be read from the faulty disk" if num_flights else ""


def _with_suffix(path: Path) -> Path:
    return path if path.suffix.lower() == CASE_SUFFIX else path.with_name(path.name + CASE_SUFFIX)
