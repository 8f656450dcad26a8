"""Commands that open and close a case, and undo and redo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from carina import commands as c
from carina.case import CaseFile, CaseFileError
from carina.case.stored_state import Moment
from carina.errors import UsageError, VolumeImportError
from carina.session.airways.finding import AirwayHandlers
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.core import ALL_TOPICS, SessionCore
from carina.session.derived.plans import CtOrigin
from carina.session.flights.recording import FlightRecorder
from carina.session.flights.scope_contact import ScopeContactHandlers
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import OpenCase, new_case
from carina.session.saving.autosave import Autosave
from carina.session.state.snapshot import OpeningInfo, UserMessage
from carina.session.store.find_scan import CaseScans, is_case_file
from carina.session.store.named_file import FileMark, open_marked
from carina.session.store.registry import CaseRecord
from carina.volume import Volume
from carina.volume.dicom_references import References
from carina.volume.opening_preview import OpeningPreview, previews_to
from carina.volume.progress import Watch


@dataclass(slots=True)
class _OpenedFile:
    """Results of the job that reads a case file."""

    file: CaseFile | None = None
    """The opened case file; None before it is read."""
    mark: FileMark | None = None
    """Mark of the opened file; None for a dropped file."""
    place: str | None = None
    """Path from which the CT of the case file was opened; None if it has no path."""


@dataclass(slots=True)
class _DroppedCt:
    """Results of the job that reads a CT from dropped files."""

    references: References | None = None
    files: str | None = None
    """Path of the dropped files if they contain several series that can be opened."""


class CaseOpener(CommandHandlers):
    """Commands that open and close a case; the current case remains on screen until the new one has been read."""

    def __init__(
        self,
        core: SessionCore,
        finding: AirwayHandlers,
        recording: FlightRecorder,
        holding: ScopeContactHandlers,
        saving: Autosave,
    ) -> None:
        super().__init__(core)
        self._holding = holding
        self._saving = saving
        self._finding = finding
        self._recording = recording

    @does(c.OpenPath)
    def open_path(self, command: c.OpenPath) -> str:
        """Open a file or folder, and add it to the list of recent cases."""
        return self._open_path(command.path)

    @does(c.OpenSeries)
    def open_series(self, command: c.OpenSeries) -> str:
        """Open another series beside the open CT; UsageError if the place of its files is not known.

        With a job, the series is opened instead of the series that the job opens; UsageError if the job has ended.
        """
        if command.job_id is not None:
            return self._open_instead(command.key, command.job_id)
        with self.core.lock:
            case = self.core.needed_case()
            place, dropped = self._saving.place_of(case), case.planning.origin.dropped
        if dropped is not None:
            return self._open_dropped(dropped, series=command.key)
        if place is None or place.startswith("demo:"):
            raise UsageError(
                "the files of this CT are not stored: open their folder or archive again to choose another series",
                code="case.no-ct",
            )

        return self._open_series(place, command.key)

    def _open_series(self, place: str, key: str) -> str:
        def read(job: Job) -> Volume:
            return self._saving.open_ct(place, job.progress, job.cancel, series=key)

        return self._open(
            "opening the series", read, None, place, open_series=lambda other: self._open_series(place, other)
        )

    def _open_instead(self, key: str, job_id: str) -> str:
        """Open another series of the folder that a job is opening; the job is cancelled."""
        with self.core.lock:
            opening = self.core.opening
            if opening is None or opening.job_id != job_id:
                raise UsageError(
                    "this CT is no longer being opened: choose another series in Check, or open the folder again",
                    code="session.opening",
                )
            new_job_id = opening.open_series(key)
            # The list stays on screen while the new job reads the headers.
            preview = replace(opening.preview, chosen_key=key, slice=None)
            self.core.opening = replace(opening, job_id=new_job_id, preview=preview)
            self.core.changed("opening")
        return new_job_id

    @does(c.OpenFiles)
    def open_files(self, command: c.OpenFiles) -> str:
        """Open files in a temporary folder, such as dropped files; their path is not stored."""
        scans = self._saving.scans
        if scans is not None and is_case_file(command.path):
            return self._open_case_file(Path(command.path), scans, dropped=True)
        return self._open_dropped(command.path)

    def _open_dropped(self, path: str, *, series: str | None = None) -> str:
        """Open a CT from dropped files; by default the likeliest chest CT among their series."""
        dropped = _DroppedCt()
        options = {} if series is None else {"series": series}

        def read(job: Job) -> Volume:
            volume = self.core.parts.open_volume(path, job.progress, job.cancel, **options)
            if any(one.refused is None for one in volume.source.other_series):
                dropped.files = path
            if volume.source.format == "dicom":
                from carina.volume.dicom_structures import ct_references  # slow to import

                # The temporary files are deleted after reading; these references replace them in later comparisons.
                watch = Watch(job.progress, job.cancel)
                dropped.references = ct_references(Path(path), volume, watch)
            return volume

        return self._open(
            "opening the case",
            read,
            None,
            dropped=dropped,
            open_series=lambda key: self._open_dropped(path, series=key),
        )

    def _open_path(self, path: str, case_id: str | None = None) -> str:
        scans = self._saving.scans
        if scans is not None and is_case_file(path):
            return self._open_case_file(Path(path), scans)

        def read(job: Job) -> Volume:
            try:
                volume = self._saving.open_ct(path, job.progress, job.cancel)
                return volume if case_id is None else self._saving.series_of_case(volume, path, case_id, job)
            except VolumeImportError as error:
                if case_id is None or Path(path).exists():
                    raise
                raise UsageError(
                    f"the CT of this case is no longer at {path}: choose its current location to continue",
                    code="case.no-ct",
                ) from error

        place = str(Path(path).absolute())
        return self._open(
            "opening the case",
            read,
            path,
            case_id=case_id,
            # The series of a stored case is decided, and the first series that is read may be another one.
            open_series=None if case_id is not None else lambda key: self._open_series(place, key),
        )

    @does(c.OpenCaseFile)
    def open_case_file(self, command: c.OpenCaseFile) -> str:
        """Open a case file; a CT that the command names is compared with the case's, and another CT is refused."""
        scans = self._saving.scans
        if scans is None:
            raise UsageError("this session cannot open case files", code="case.not-kept")
        return self._open_case_file(Path(command.path), scans, command.ct)

    def _open_case_file(self, path: Path, scans: CaseScans, ct: Path | None = None, *, dropped: bool = False) -> str:
        """Open a case file with its CT, and store the case on this machine from now on.

        A dropped file has no path, so a copy of the file is stored; the copy waits until its CT is found.
        """
        found = _OpenedFile()

        def read(job: Job) -> Volume:
            if dropped:
                file = found.file = CaseFile.open(path, read_only=True)
            else:
                found.file, found.mark = open_marked(path)
                file = found.file
            if file.note is not None:
                self.core.emit(UserMessage(file.note))
            scan = self._saving.open_ct_of(file) if dropped else None
            try:
                if scan is None:
                    scan = scans.open(file, ct=ct, dropped=dropped, progress=job.progress, cancel=job.cancel)
            except CaseFileError as error:
                if not dropped or error.code != "case.no-scan":
                    raise
                raise self._store_and_request_ct(file) from error
            except VolumeImportError as error:
                if not dropped:
                    raise
                raise self._store_and_request_ct(file) from error
            found.place = scan.place
            return scan.volume

        def close() -> None:
            if found.file is not None:
                found.file.close()

        # A stored case is in the list of recent cases by its record, without a path.
        listed = None if dropped or self._saving.stores(path) else str(path)
        return self._open("opening the case", read, listed, found=found, ended=close)

    def _store_and_request_ct(self, file: CaseFile) -> UsageError:
        """Store a dropped case without its CT, and return the error whose message asks the user to open the CT."""
        store_waiting_case = file.note is None and self._saving.store_waiting_case(file)
        if store_waiting_case:
            with self.core.lock:
                self.core.changed("start")
        return UsageError(
            "the CT of this case was not found on this computer: drop the CT here or choose it to continue"
            + (
                ". The case stays in the list of recent cases"
                if store_waiting_case
                else ", then drop the case file again"
            ),
            code="case.no-ct",
        )

    def _open_record(self, record: CaseRecord) -> str:
        if record.place is None:
            return self._open_with_unknown_ct_path(record)
        name = record.place.removeprefix("demo:")
        if name == record.place:
            return self._open_path(record.place, record.case_id)
        return self._open_demo(name, record.case_id)

    def _open_with_unknown_ct_path(self, record: CaseRecord) -> str:
        """Open a stored case without a path of its CT, which was dropped or was in a dropped case file.

        The CT may be in the cache, in the case file, or at the path that another case states.
        """
        scans, records = self._saving.scans, self._saving.records
        no_ct = UsageError(
            "the location of this case's CT is not known: drop the CT here or choose it to continue", code="case.no-ct"
        )
        if scans is None or records is None:
            raise no_ct
        found = _OpenedFile()

        def read(job: Job) -> Volume:
            with CaseFile.open(records.path_of(record), read_only=True) as file:
                try:
                    scan = scans.open(file, dropped=True, progress=job.progress, cancel=job.cancel)
                except CaseFileError as error:
                    if error.code != "case.no-scan":
                        raise
                    raise no_ct from error
                except VolumeImportError as error:
                    raise no_ct from error
            found.place = scan.place
            return scan.volume

        return self._open("opening the case", read, None, case_id=record.case_id, found=found)

    @does(c.OpenDemo)
    def open_demo(self, command: c.OpenDemo) -> str:
        """Open a bundled CT, or generate the phantom."""
        return self._open_demo(command.name)

    def _open_demo(self, name: str, case_id: str | None = None) -> str:
        def read(job: Job) -> Volume:
            return self.core.parts.open_demo(name, job.progress, job.cancel)

        return self._open("opening the demo", read, None, f"demo:{name}", case_id=case_id)

    @does(c.BeginAnew)
    def begin_anew(self, _command: c.BeginAnew) -> str:
        """Begin a new case of the open CT, without the stored content of earlier cases."""
        with self.core.lock:
            case = self.core.needed_case()
            place = self._saving.place_of(case)
        return self._open("starting a new case", lambda _job: case.info.volume, None, place, as_new_case=True)

    @does(c.OpenVolume)
    def open_volume(self, command: c.OpenVolume) -> str:
        """Open a volume that is already in memory."""
        volume: Volume = command.volume
        return self._open(
            "opening the volume", lambda _job: volume, None, given=command.kept, finds=not command.follows
        )

    @does(c.OpenRecent)
    def open_recent(self, command: c.OpenRecent) -> str:
        """Open a case of the list; UsageError if the list has no such case."""
        records = self._saving.records
        record = None if records is None else records.find(command.recent_id)
        if record is not None:
            return self._open_record(record)
        for case in self.core.store.recent() if self.core.store else ():
            if case.recent_id == command.recent_id:
                return self._open_path(case.path)
        raise UsageError("this case is no longer in the list; open its folder again", code="session.recent")

    @does(c.CloseCase)
    def close_case(self, _command: c.CloseCase) -> None:
        """Close the case and end its jobs; UsageError while the disk has not accepted the latest changes."""
        self._saving.refuse_to_lose()
        with self.core.lock:
            self._recording.stop()
            self.core.jobs.cancel_kinds()
        # release_case() may wait for the disk, so it is called without the lock, and images are still rendered.
        self._saving.release_case()
        with self.core.lock:
            # A job may have begun in the meantime, such as the score of an attempt that the closing has ended.
            self.core.jobs.cancel_kinds()
            self._discard_case()
            self.core.case = None
            self.core.changed(*ALL_TOPICS, "flights", "start")

    @does(c.Cancel)
    def cancel(self, command: c.Cancel) -> None:
        """Cancel a job; do nothing if the job has ended."""
        self.core.jobs.cancel(command.job_id)

    @does(c.Undo)
    def undo(self, _command: c.Undo) -> None:
        """Undo the last change, or notify the user that there is none."""
        self.core.undo()

    @does(c.Redo)
    def redo(self, _command: c.Redo) -> None:
        """Redo the last undone change, or notify the user that there is none."""
        self.core.redo()

    @does(c.GoToStep)
    def go_to_step(self, command: c.GoToStep) -> None:
        """Restore the state after a step of the history."""
        self.core.go_to_step(command.step)

    def _discard_case(self) -> None:
        """Stop all computations for the case on screen and release its data; the caller holds the session's lock."""
        for step in self.core.after_case:
            step()
        if self.core.case is not None:
            self.core.case.discard()

    def _open(
        self,
        title: str,
        read: Callable[[Job], Volume],
        path: str | None,
        place: str | None = None,
        *,
        case_id: str | None = None,
        as_new_case: bool = False,
        given: Moment | None = None,
        finds: bool = True,
        found: _OpenedFile | None = None,
        ended: Callable[[], None] = lambda: None,
        dropped: _DroppedCt | None = None,
        open_series: Callable[[str], str] | None = None,
    ) -> str:
        """Open a CT with the stored case ``case_id``; without an id, with the case of this CT that was used last.

        With a ``given`` state, the case continues from this state, and the caller stores the case. With
        ``open_series``, which opens another series of the same files, windows show a preview while the CT is read.
        """
        if path is not None and found is None:
            place = str(Path(path).absolute())

        def work(job: Job) -> None:
            try:
                open_it(job)
            finally:
                self._hide_preview(job)
                ended()

        def open_it(job: Job) -> None:
            job.check()
            if open_series is None:
                volume = read(job)
            else:
                with previews_to(lambda preview: self._show_preview(job, preview, open_series)):
                    volume = read(job)
            # Until this check, an opening that fails or is stopped leaves the case on screen unchanged.
            job.check()
            with self.core.lock:
                # The end of the recording belongs to the case that is being closed.
                self._recording.stop()
            with self._saving.while_opening() as keeping:
                stored = given
                found_place = place if found is None else found.place
                if found is not None and found.file is not None:
                    stored = keeping.imported(volume, found.file, found.mark)
                elif given is not None:
                    pass
                elif as_new_case:
                    keeping.begin(volume)
                else:
                    stored = keeping.reopened(volume, case_id)
                job.progress("checking the scan quality", None)
                case = new_case(
                    volume,
                    next(self.core.case_numbers),
                    parts=self.core.parts,
                    renderer_factory=self.core.renderer_factory,
                    jobs=self.core.jobs,
                    lock=self.core.lock,
                    changed=self.core.changed,
                    say=lambda words: self.core.emit(UserMessage(words)),
                    stored=stored,
                )
                case.planning.origin = CtOrigin(
                    None if found_place is None or found_place.startswith("demo:") else found_place,
                    None if dropped is None else dropped.references,
                    None if dropped is None else dropped.files,
                )
                if path is not None and self.core.store is not None:
                    self.core.store.remember(path, self.core.today())
                with self.core.lock:
                    job.check()
                    self._show_case(job, case)
                    if given is not None and given.steps:
                        case.begun_s -= given.steps[-1].at_s
                    keeping.attach(case, found_place)
                    self.core.changed(*ALL_TOPICS, "flights", "start")
            # Preparation takes a tenth of a second and makes rendering several times faster; the airway search takes
            # many seconds.
            case.content.prepare()
            if volume.is_hu:
                job.progress("assessing the CT", None)
                self.core.parts.assess_ct(volume, None)
                with self.core.lock:
                    case.info = replace(case.info, is_assessed=True)
                    self.core.changed("state")
            self._find_or_restore_airways(case, stored, finds)

        return self.core.jobs.start("open", title, work)

    @answers(c.OpeningPreviewOf)
    def opening_preview(self, _question: c.OpeningPreviewOf) -> OpeningInfo | None:
        """Return the preview of the CT that a job is opening; None without one."""
        return self.core.opening

    def _show_preview(self, job: Job, preview: OpeningPreview, open_series: Callable[[str], str]) -> None:
        """Show the preview of the CT that a job opens, unless the job was stopped."""
        # Checked with the session locked, so that a stopped job does not replace the preview of its successor.
        with self.core.lock:
            job.check()
            before, list_id = self.core.opening, job.job_id
            if before is not None and before.job_id == job.job_id and before.preview.series == preview.series:
                list_id = before.list_id
            self.core.opening = OpeningInfo(list_id, job.job_id, preview, open_series)
            self.core.changed("opening")

    def _hide_preview(self, job: Job) -> None:
        """Remove the preview of the CT that a job opens."""
        with self.core.lock:
            if self.core.opening is not None and self.core.opening.job_id == job.job_id:
                self.core.opening = None
                self.core.changed("opening")

    def _show_case(self, job: Job, case: OpenCase) -> None:
        """Show a newly opened case, and discard the previous case with its jobs.

        The caller holds the session's lock.
        """
        self._hide_preview(job)
        self._recording.stop()
        # All other jobs belong to the previous case.
        self.core.jobs.cancel_others(job)
        self._discard_case()
        case.begun_s = self.core.clock()
        for window in self.core.windows:
            case.sights.begin(window)
        self.core.case = case
        self.core.moved()

    def _find_or_restore_airways(self, case: OpenCase, stored: Moment | None, finds: bool) -> None:
        """Start the airway search of a new case, or continue a stored case and restore its scope in the lumen."""
        if stored is not None:
            with self.core.lock:
                self.core.follow(case)
                self.core.changed(*ALL_TOPICS)
            self._holding.resume(case)
        if finds and case.search.status == "waiting":
            self._finding.start(case, None, case.info.scale.threshold, label=None)
