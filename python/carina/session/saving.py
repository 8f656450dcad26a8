"""Keeping the open case on the disk: at most two seconds behind, and at once before anything risky."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from carina import commands as c
from carina.case import CaseFile, CaseFileError
from carina.case.moment import Moment
from carina.disk import disk_trouble
from carina.display import one_line
from carina.errors import CarinaError, UsageError
from carina.session.case import OpenCase, moment_of
from carina.session.case_scan import CASE_SUFFIX, way_between
from carina.session.core import SessionCore
from carina.session.jobs import Job, log_fault
from carina.session.named_lock import NamedLock
from carina.session.records import CaseRecord, CaseRecords, HeldCase
from carina.session.snapshot import Changed, Said, SavingInfo, Trouble
from carina.session.subject import Subject, answers, does

if TYPE_CHECKING:
    from carina.session.case_scan import CaseScans
    from carina.session.core import Event
    from carina.session.parts import Cancel, Progress
    from carina.session.scene import ShownCase
    from carina.volume import Volume

__all__ = ["CtCache", "KeptCt", "KeptFile", "KeptFiles", "Reopened", "Saving"]

logger = logging.getLogger(__name__)

DECIDED_WITHIN_S = 0.4
"""What a person did is written this soon; what follows within that time goes along."""
MOVED_WITHIN_S = 1.5
"""A tip that only moves is written this often."""
RETRY_S = 2.0
SLOW_S = 2.5
"""A disk that takes longer is told of, since what it has not taken could be lost."""
COPY_EVERY_S = 60.0
SAME_TIME_S = 2.0
"""By which a file's time and the clock may differ."""
CLOSING_S = 20.0


class KeptFile(Protocol):
    """A case file: :class:`carina.case.CaseFile`."""

    def save(self, moment: Moment) -> None:
        """Write what is new."""

    def load(self, volume: Volume) -> Moment:
        """What was written last; CaseFileError ``case.empty`` where nothing was."""

    def write_copy(self, path: Path, *, ct_place: str | None = None) -> None:
        """One whole file elsewhere, with the relative way from it to its CT."""

    def close(self) -> None:
        """Nothing more is written."""


class KeptCt(Protocol):
    """A CT that is kept to open faster."""

    @property
    def digest(self) -> str:
        """What it is known by."""

    @property
    def num_bytes(self) -> int:
        """On the disk."""


class CtCache(Protocol):
    """CTs that are kept to open faster: :class:`carina.volume.VolumeCache`."""

    @property
    def is_on(self) -> bool:
        """It may keep something."""

    @property
    def can_be_on(self) -> bool:
        """It may be switched on."""

    def sizes(self) -> Sequence[KeptCt]:
        """What is kept."""

    def forget(self, digest: str) -> int:
        """Remove a CT; returns the bytes removed."""

    def empty(self) -> int:
        """Remove every CT; returns the bytes removed."""

    def switch(self, on: bool) -> None:
        """Keep CTs from now on, or none and also not those that are kept."""


def _nothing() -> None:
    """Of a CT nothing is kept."""


@one_line
@dataclass(frozen=True, slots=True)
class KeptFiles:
    """How case files are made and opened, and how a CT is known again."""

    create: Callable[[Path, Volume, str], KeptFile]
    """``create(path, volume, digest)``."""
    open: Callable[[Path], KeptFile]
    digest: Callable[[Volume], str]
    """What a CT is known by."""
    open_ct: Callable[[str, Progress, Cancel], Volume] | None = None
    """``open_ct(path, progress, cancel)`` gives a CT that was opened before from what was kept of it; None: nothing
    is kept of CTs."""
    close: Callable[[], None] = _nothing
    """No more CT is kept."""
    picture: Callable[[ShownCase], bytes] | None = None
    """A small JPEG of what is shown; None makes none."""
    cache: CtCache | None = None
    """The CTs that are kept, to be looked after."""
    scans: CaseScans | None = None
    """Looks for the CTs of case files; None opens none."""


@one_line
@dataclass(slots=True)
class Reopened:
    """A case that was kept, while its CT is read."""

    held: HeldCase
    file: KeptFile


class Between:
    """One case has been given back; the next one is found, and attached or given back."""

    def __init__(self, saving: Saving) -> None:
        self._saving = saving
        self._digest: str | None = None
        self._reopened: Reopened | None = None

    def begin(self, volume: Volume) -> None:
        """What was kept of this CT stays where it is: a new case of it is begun."""
        self._digest = self._saving.digest_of(volume)

    def take(self, digest: str | None, case_id: str | None = None) -> Reopened | None:
        """Own what was kept of a CT: the case that is meant, or the one that was used last."""
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
                    "the CT in this place is not the one that this case was made with. Choose the case's own CT "
                    "again, or open this one to begin a new case",
                    code="case.other-ct",
                )
        self._reopened = None if record is None else self._saving.opened(record)
        return self._reopened

    def reopened(self, volume: Volume, case_id: str | None = None) -> Moment | None:
        """What was kept of this CT, wherever its files lie now; None where nothing was, or nothing can be read."""
        reopened = self.take(self._saving.digest_of(volume), case_id)
        if reopened is None:
            return None
        try:
            return reopened.file.load(volume)
        except (OSError, sqlite3.Error, CarinaError) as trouble:
            if isinstance(trouble, CaseFileError) and trouble.code == "case.empty":
                # A crash right after it was begun: the same file is gone on with.
                return None
            self._saving.say_unreadable(reopened.held, trouble)
        self.give_back()
        return None

    def imported(self, volume: Volume, case: CaseFile) -> Moment | None:
        """Go on from a case file: from what is kept of it here, else from a copy; None where nothing was saved in it.

        One of a newer Carina is shown and not kept.
        """
        digest = self._saving.digest_of(volume)
        if digest is None or case.note is not None:
            return case.load(volume)
        self._digest = digest
        self._reopened = self._saving.reopened_file(case) or self._saving.taken_over(case, volume, digest)
        try:
            return self._reopened.file.load(volume)
        except CaseFileError as trouble:
            if trouble.code != "case.empty":
                raise
            return None

    def attach(self, case: OpenCase, place: str | None) -> None:
        """From now on this case is kept; with the session locked."""
        reopened, self._reopened = self._reopened, None
        if self._digest is not None:
            self._saving.attach(case, place, self._digest, reopened)

    def give_back(self) -> None:
        """What was kept is not shown after all."""
        reopened, self._reopened = self._reopened, None
        if reopened is not None:
            reopened.file.close()
            reopened.held.release()


@dataclass(slots=True)
class _Kept:
    """The open case and where it is kept; the thread's alone, but for ``case``."""

    case: OpenCase
    place: str | None
    digest: str
    held: HeldCase | None = None
    file: KeptFile | None = None
    elsewhere: Path | None = None
    """Where all of it was written whole, when the live file's disk refused."""
    pictured: bool = False
    """Its picture was tried to be made."""


class Saving(Subject):
    """One thread that writes; whoever changes something only wakes it.

    Parameters
    ----------
    core
        Of the session.
    records
        The cases of this person; None keeps nothing.
    files
        How case files are made and opened.
    """

    def __init__(self, core: SessionCore, records: CaseRecords | None, files: KeptFiles | None) -> None:
        super().__init__(core)
        self.records = records
        self._files = files
        self._kept: _Kept | None = None
        self._wake = threading.Condition()
        self._writing = threading.Lock()
        self._changed_s: float | None = None
        self._within_s = MOVED_WITHIN_S
        self._ended = False
        self._is_elsewhere = False
        """All that was done is in a file that a person asked for, since the live one's disk refuses."""
        self._telling = False
        """What changes now is only what is said about saving."""
        self._retry_s = float("-inf")
        self._thread: threading.Thread | None = None
        self._info = SavingInfo()
        if records is not None:
            core.subscribe(self._hear)

    # ------------------------------------------------------------ opening and closing

    @contextmanager
    def between(self) -> Iterator[Between]:
        """While another case takes the place of this one; where that fails, this one is kept on."""
        before = self._kept
        self.refuse_to_lose()
        self.let_go()
        between = Between(self)
        try:
            yield between
        except BaseException:
            between.give_back()
            if before is not None:
                with self.core.lock:
                    again = Between(self)
                    again.take(before.digest, None if before.held is None else before.held.record.case_id)
                    again.attach(before.case, before.place)
            raise

    def opened(self, record: CaseRecord) -> Reopened | None:
        """A case that was kept, owned from now on; None, said, where it is not to be had."""
        assert self.records is not None
        assert self._files is not None
        held = self.records.hold(record)
        if held is None:
            self.core.emit(
                Said("this CT is already open in another window; changes made here are kept as a separate case")
            )
            return None
        try:
            if held.path.exists():
                return Reopened(held, self._files.open(held.path))
        except (OSError, sqlite3.Error, CarinaError) as trouble:
            self.say_unreadable(held, trouble)
        held.release()
        return None

    def reopened_file(self, case: CaseFile) -> Reopened | None:
        """What is kept here of a case file, owned from now on; None where nothing is that goes on from it."""
        assert self.records is not None
        steps, path = _told(case), str(case.path.absolute())
        changed_s = case.path.stat().st_mtime
        for record in self.records.all():
            if record.digest != case.digest:
                continue
            # Nobody else has written it since; or all that was done in it was done here, too.
            is_copy = record.copy_path == path and changed_s <= (record.copied_s or 0.0) + SAME_TIME_S
            if is_copy or (steps and self._told_here(record)[: len(steps)] == steps):
                return self.opened(record)
        return None

    def _told_here(self, record: CaseRecord) -> tuple[tuple[str, float], ...]:
        assert self.records is not None
        try:
            with CaseFile.open(self.records.path_of(record), read_only=True) as live:
                return _told(live)
        except (OSError, sqlite3.Error, CarinaError):
            return ()

    def taken_over(self, case: CaseFile, volume: Volume, digest: str) -> Reopened:
        """A copy of a case file, kept here from now on; the file that it came from follows it."""
        assert self.records is not None
        assert self._files is not None
        held = self.records.begin(digest, None, volume.source.title)
        try:
            case.write_copy(held.path)
            file = self._files.open(held.path)
        except BaseException:
            held.release()
            if self.records.forget(held.record):
                self.records.remove(held.record.case_id)
            raise
        steps, now_s = case.history(), self.records.now_s()
        held.note(
            begun_s=now_s - max((step.at_s for step in steps), default=0.0),
            num_changes=sum(step.holds for step in steps),
            copy_path=str(case.path.absolute()),
            copied_s=now_s,
        )
        return Reopened(held, file)

    def say_unreadable(self, held: HeldCase, trouble: BaseException) -> None:
        """Nothing of it is lost, but nothing is shown."""
        self.core.emit(
            Trouble(
                "case.unreadable",
                f"the saved case of this CT could not be read: {trouble}. Its file is unchanged: "
                f"{held.path}. This is a new case of the same CT.",
            )
        )

    @property
    def open_ct(self) -> Callable[[str, Progress, Cancel], Volume]:
        """Open a CT of this machine."""
        kept = None if self._files is None else self._files.open_ct
        return self.core.parts.open_volume if kept is None else kept

    def digest_of(self, volume: Volume) -> str | None:
        """What a CT is known by; None where nothing is kept."""
        return None if self._files is None or self.records is None else self._files.digest(volume)

    def attach(self, case: OpenCase, place: str | None, digest: str, reopened: Reopened | None) -> None:
        """From now on this case is kept; with the session locked."""
        assert self.records is not None
        kept = _Kept(case, place, digest)
        documents = self.records.documents
        # No title and no date: a name that a person chooses tells more than either, and gives away less.
        suggested = None if documents is None else str(documents / f"case{CASE_SUFFIX}")
        info = SavingInfo(keeps=True, suggested=suggested)
        if reopened is not None:
            record = reopened.held.record
            kept.held, kept.file = reopened.held, reopened.file
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
        with self._wake:
            self._kept, self._info, self._changed_s = kept, info, None
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="carina-saving", daemon=True)
                self._thread.start()

    def refuse_to_lose(self) -> None:
        """Before the case is closed for another one, or for none.

        Raises
        ------
        UsageError
            ``case.not-saved``: if the disk has not taken the latest changes, and they were saved nowhere else.
        """
        self.write_now()
        if self._kept is None or self._changed_s is None or self._is_elsewhere:
            return
        raise UsageError(
            f"the case stays open, because its latest changes could not be saved: {self._info.problem}. Save it in "
            "another folder (Ctrl+S), or free some space",
            code="case.not-saved",
        )

    def let_go(self) -> None:
        """Write what is not written yet, and give the case back; another is opened, or none."""
        kept = self._kept
        if kept is None:
            return
        self.write_now()
        with self._writing:
            if self._changed_s is not None and self._info.problem is not None:
                self.core.emit(
                    Trouble("case.not-saved", f"the latest changes have not been saved: {self._info.problem}")
                )
            self._picture(kept)
            if kept.file is not None:
                self._refresh_copy(kept, now=True)
                kept.file.close()
            if kept.held is not None:
                kept.held.release()
            with self._wake:
                self._kept, self._info, self._changed_s = None, SavingInfo(), None

    def close(self) -> None:
        """Write the rest, and end the thread."""
        self.let_go()
        with self._wake:
            self._ended = True
            self._wake.notify_all()
        if self._thread is not None:
            self._thread.join(CLOSING_S)
        if self._files is not None:
            self._files.close()

    @property
    def info(self) -> SavingInfo:
        """What is saved, for the window."""
        return self._info

    # ------------------------------------------------------------ when

    def _hear(self, event: Event) -> None:
        """Something has changed; with the session locked."""
        kept = self._kept
        if kept is None or self._telling or not isinstance(event, Changed) or self.core.case is not kept.case:
            return
        with self._wake:
            self._is_elsewhere = False
            within_s = MOVED_WITHIN_S if event.topics <= {"pose", "views"} else DECIDED_WITHIN_S
            if self._changed_s is None:
                self._changed_s, self._within_s = self.core.clock(), within_s
            elif within_s < self._within_s:
                self._within_s = within_s
            self._wake.notify_all()

    def _wait_s(self) -> float | None:
        """Until something is to be written; None: nothing is. With ``_wake`` held."""
        if self._kept is None or self._changed_s is None:
            return None
        return max(self._changed_s + self._within_s, self._retry_s) - self.core.clock()

    def _run(self) -> None:
        while True:
            with self._wake:
                while not self._ended and ((wait_s := self._wait_s()) is None or wait_s > 0.0):
                    self._wake.wait(wait_s)
                if self._ended:
                    return
            self.write()

    def write_now(self) -> bool:
        """Write what is not written yet, before anything risky; whether all is on the disk then."""
        self.write()
        return self._changed_s is None

    # ------------------------------------------------------------ writing

    def write(self) -> None:
        """Write the newest moment, if there is a newer one."""
        with self._writing:
            kept = self._kept
            with self._wake:
                if kept is None or self._changed_s is None:
                    return
                changed_s, self._changed_s = self._changed_s, None
            watch = threading.Timer(SLOW_S, self._slow)
            watch.daemon = True
            watch.start()
            try:
                self._write(kept)
            except (OSError, sqlite3.Error, CarinaError) as trouble:
                with self._wake:
                    self._changed_s = changed_s if self._changed_s is None else min(changed_s, self._changed_s)
                    self._retry_s = self.core.clock() + RETRY_S
                self._tell(problem=_words(trouble))
            finally:
                watch.cancel()

    def _write(self, kept: _Kept) -> None:
        assert self.records is not None
        assert self._files is not None
        volume = kept.case.info.volume
        if kept.held is None:
            kept.held = self.records.begin(kept.digest, kept.place, volume.source.title)
        if kept.file is None:
            kept.file = self._files.create(kept.held.path, volume, kept.digest)
        with self.core.lock:
            # All that was done until now is on the disk when it is said.
            now_s = self.records.now_s()
            moment = moment_of(kept.case)
        kept.file.save(moment)
        kept.held.note(used_s=now_s, place=kept.place or kept.held.record.place, num_changes=moment.position)
        self._tell(problem=None, saved_s=now_s, begun_s=kept.held.record.begun_s)
        if kept.held.record.pictured_s is None and not kept.pictured:
            # Else it is made when the case is closed: a Carina that is killed has one, too.
            self._picture(kept)
        self._refresh_copy(kept)

    def _picture(self, kept: _Kept) -> None:
        """The small picture by which a person knows the case again; nothing waits for it, and nothing fails by it."""
        if kept.held is None or self._files is None or self._files.picture is None or self.records is None:
            return
        scene = self.core.scene()
        if scene is None or scene.case_number != kept.case.number or not scene.has_lumen:
            return
        kept.pictured = True
        try:
            kept.held.put_picture(self._files.picture(scene), self.records.now_s())
        except Exception as trouble:
            log_fault(logger, "the case's picture could not be made", trouble)

    def rename(self, case_id: str, alias: str | None) -> bool:
        """Call the open case by a name of its person's; False where it is another case."""
        with self._writing:
            kept = self._kept
            if kept is None or kept.held is None or kept.held.record.case_id != case_id:
                return False
            kept.held.note(alias=alias)
        self._tell(title=alias)
        return True

    def place_of(self, case: OpenCase) -> str | None:
        """Where the CT of the open case was opened from."""
        kept = self._kept
        return None if kept is None or kept.case is not case else kept.place

    @property
    def scans(self) -> CaseScans | None:
        """Looks for the CTs of case files."""
        return None if self._files is None else self._files.scans

    @property
    def cache(self) -> CtCache | None:
        """The CTs that are kept to open faster."""
        return None if self._files is None else self._files.cache

    def _refresh_copy(self, kept: _Kept, *, now: bool = False) -> None:
        """The copy that a person asked for follows, once a minute and when the case is closed."""
        assert self.records is not None
        if kept.held is None or kept.held.record.copy_path is None or kept.file is None:
            return
        record = kept.held.record
        written_s, copied_s = record.used_s, record.copied_s or 0.0
        if written_s <= copied_s or not (now or self.records.now_s() - copied_s >= COPY_EVERY_S):
            return
        try:
            self._copy(kept, Path(record.copy_path or ""))
        except (OSError, sqlite3.Error, CarinaError) as trouble:
            self._tell(copy_problem=_words(trouble))

    def _copy(self, kept: _Kept, path: Path) -> None:
        """With ``_writing`` held."""
        assert kept.file is not None
        assert kept.held is not None
        assert self.records is not None
        place = kept.held.record.place
        if NamedLock.is_taken(path):
            raise UsageError(f"{path.name} is open for change elsewhere: close it there, or choose another name")
        kept.file.write_copy(path, ct_place=way_between(path, place))
        now_s = self.records.now_s()
        kept.held.note(copy_path=str(path), copied_s=now_s)
        self._tell(copied_s=now_s, copy_name=path.name, copy_folder=str(path.parent), copy_problem=None)

    def _write_elsewhere(self, kept: _Kept, path: Path) -> None:
        """All of it as a file of its own: a copy of the live one would lack what its disk has refused."""
        assert self._files is not None
        with self.core.lock:
            self._is_elsewhere = True
            moment = moment_of(kept.case)
        draft = path.with_name(f".{path.name}.new")
        try:
            draft.unlink(missing_ok=True)
            file = self._files.create(draft, kept.case.info.volume, kept.digest)
            try:
                file.save(moment)
            finally:
                file.close()
            draft.replace(path)
            kept.elsewhere = path
        except BaseException:
            self._is_elsewhere = False
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
            raise

    def _slow(self) -> None:
        self._tell(problem="the disk has not responded for some seconds; Carina keeps trying")

    def _tell(self, **values: object) -> None:
        before = self._info
        self._info = before.with_(**values)
        if self._info.shown != before.shown:
            with self.core.lock:
                self._telling = True
                try:
                    self.core.changed("state")
                finally:
                    self._telling = False

    # ------------------------------------------------------------ a place of its own

    @answers(c.MomentToKeep)
    def moment_to_keep(self, _question: c.MomentToKeep) -> Moment:
        """For whoever keeps the case in a file of their own."""
        case = self.core.needed_case()
        with self.core.lock:
            return moment_of(case)

    @does(c.SaveCase)
    def save_case(self, command: c.SaveCase) -> str:
        """Give the case a name and a place, as a job; without a path, refresh the copy that has one."""
        self.core.needed_case()
        kept = self._kept
        if kept is None:
            raise UsageError("this case is not kept on this machine, so it cannot be saved", code="case.not-kept")
        known = None if kept.held is None else kept.held.record.copy_path
        if command.path is None and known is None:
            raise UsageError(
                "this case has not been saved to a file yet: choose a folder and a name", code="case.no-place"
            )
        path = Path(known or "") if command.path is None else _with_suffix(Path(command.path).expanduser())
        if not path.is_absolute():
            raise UsageError(f"expected a full path such as C:\\cases\\NAME or /home/NAME; found {command.path}")
        is_ours = str(path) == known or path == kept.elsewhere
        if command.path is not None and path.exists() and not command.replace and not is_ours:
            raise UsageError(f"there is a file already: {path}; choose another name, or replace it", code="case.exists")

        def work(job: Job) -> None:
            job.check()
            is_live = self.write_now() or self._info.problem is None
            with self._writing:
                if self._kept is not kept:
                    return
                try:
                    if is_live:
                        self._copy(kept, path)
                    else:
                        self._write_elsewhere(kept, path)
                except OSError as trouble:
                    raise disk_trouble(trouble, "cannot save the case to", path) from trouble
            self.core.emit(Said(f"saved as {path}"))

        return self.core.jobs.start("save", "saving the case", work)


def _told(case: CaseFile) -> tuple[tuple[str, float], ...]:
    """What was done in a case and when: no two cases have the same."""
    return tuple((step.label, step.at_s) for step in case.history())


def _with_suffix(path: Path) -> Path:
    return path if path.suffix.lower() == CASE_SUFFIX else path.with_name(path.name + CASE_SUFFIX)


def _words(trouble: BaseException) -> str:
    if isinstance(trouble, CarinaError):
        return str(trouble)
    if isinstance(trouble, OSError):
        return str(disk_trouble(trouble, "cannot save the case", None))
    return f"cannot save the case: {trouble}"
