"""The case file of a program: the program works on a copy, and each save writes the copy to the file."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from carina.case import CaseFile, CaseFileError, Moment, SourceFacts
from carina.case.recordings import WholeRecording
from carina.case.save_mark import SaveMark
from carina.config import load_settings
from carina.disk import Placement, ScratchFolder
from carina.errors import UsageError
from carina.session.saving.unsaved_work import check_saved
from carina.session.store.find_scan import CASE_SUFFIX, CaseScans, FoundScan, relative_path
from carina.session.store.named_file import FileMark, NamedFile, NamedFileConflictError, free_path_beside, open_marked
from carina.session.store.registry import CaseRecords
from carina.volume import Volume, VolumeCache, ct_digest

WHERE_WORK_IS = "Your changes are in this program only"


class NamedCase:
    """The named file of a program's case, and the copy that the program works on."""

    def __init__(self) -> None:
        self.path: Path | None = None
        self.note: str | None = None
        """Reason why the case cannot be saved to its file; None if the case can be saved."""
        self._scratch: ScratchFolder | None = None
        self._file: CaseFile | None = None
        self._named: NamedFile | None = None
        self._ct_place: str | None = None
        self._saved: Moment | None = None
        self._flights: set[int] = set()
        """The session's numbers of the flights that this program wrote to the file."""

    def open(self, path: Path, ct: str | Path | None) -> tuple[Volume, Moment | None]:
        """Open a case file, and find its CT.

        Parameters
        ----------
        path
            Path of the case file.
        ct
            Path of the CT, if the CT has moved.

        Returns
        -------
        tuple
            The CT, and the saved state of the case; the state is None if none was saved.

        Raises
        ------
        CaseFileError
            If the file cannot be opened (:meth:`CaseFile.open`); ``case.no-scan`` if its CT is not found.
        VolumeImportError
            If the CT cannot be opened, or is not the CT of the case.
        """
        self.path = path.absolute()
        original, mark = open_marked(self.path)
        with original:
            scan = _find_ct(original, ct)
            self._ct_place = scan.place
            if original.note is not None:
                self.note = original.note
                self._saved = original.load(scan.volume)
                return scan.volume, self._saved
            if _records().stores(self.path):
                self.note = (
                    f"The file {self.path} is a stored case of the Carina window: changes made here can only be saved "
                    "under another name"
                )
            else:
                self._open_named(mark, original.digest)
            self._scratch = ScratchFolder()
            original.write_copy(self._scratch.path / f"case{CASE_SUFFIX}", ct_place=original.source.path)
        self._file = CaseFile.open(self._scratch.path / f"case{CASE_SUFFIX}")
        try:
            self._saved = self._file.load(scan.volume)
        except CaseFileError as error:
            if error.code != "case.empty":
                raise
        return scan.volume, self._saved

    def _open_named(self, mark: FileMark, ct_digest: str) -> None:
        """Lock the case file for this program; if another program has it open, set :attr:`note` to the reason."""
        assert self.path is not None
        self._named = NamedFile(self.path, mark, ct_digest=ct_digest, where_work_is=WHERE_WORK_IS)
        try:
            self._named.check()
        except NamedFileConflictError as conflict:
            self.note = str(conflict)
        if self.note is None and _records().open_elsewhere(self.path) is not None:
            self.note = (
                f"The file {self.path.name} is open in a Carina window: changes made here can only be saved under "
                "another name"
            )
            self._named.close()

    def set_ct_path(self, place: str | Path) -> None:
        """Store the path of the CT from which a case without a file was opened, for the first save."""
        self._ct_place = str(Path(place).expanduser().absolute())

    def save(
        self,
        volume: Volume,
        moment: Moment,
        path: str | Path | None,
        *,
        replace: bool,
        flights: Sequence[WholeRecording] = (),
    ) -> Path:
        """Write the case to one file; a file at a given path becomes the named file of the case.

        The given flights are added to the flights in the file.

        Raises
        ------
        UsageError
            ``case.no-place``: if the case has no file, or the folder does not exist; ``case.exists``: if another file
            is at the path; ``case.read-only``: if :attr:`note` is set.
        NamedFileConflictError
            ``case.changed``: if the file has other content than this program last read or wrote; ``case.read-only``: if
            another window or program has the file open. The file is unchanged.
        DiskError
            If the file cannot be written; a former file stays unchanged.
        """
        target = self._target(path, replace)
        if not target.parent.is_dir():
            raise UsageError(f"the folder {target.parent} does not exist", code="case.no-place")
        before = self._named
        is_before = before is not None and before.has_path(target)
        file = self._needed_file(volume)
        named = before if is_before else NamedFile(target, ct_digest=file.digest, where_work_is=WHERE_WORK_IS)
        assert named is not None
        file.save(moment)
        self._copy_flights(file, flights)

        def write(place: Path, mark: SaveMark, placement: Placement) -> None:
            file.write_copy(place, ct_place=relative_path(place, self._ct_place), save_mark=mark, placement=placement)

        try:
            named.write(write, replace=replace, may_be_missing=True)
        except BaseException:
            if not is_before:
                named.close()
            raise
        if before is not None and not is_before:
            before.close()
        self.path, self._named, self._saved, self.note = target, named, moment, None
        return target

    def save_at_end(self, volume: Volume, moment: Moment, flights: Sequence[WholeRecording]) -> None:
        """Save the case when the program ends; if the file has other content, save under a new name beside the file.

        Raises
        ------
        NamedFileConflictError
            If the case was saved under a new name, which the message states.
        CarinaError
            If the case cannot be saved (see :meth:`save`).
        """
        try:
            self.save(volume, moment, None, replace=False, flights=flights)
        except NamedFileConflictError as conflict:
            beside = self.save(volume, moment, free_path_beside(conflict.path), replace=False, flights=flights)
            raise NamedFileConflictError(
                f"The file {conflict.path.name} was not written, because its content was changed elsewhere. The "
                f"changes of this program are saved in {beside}",
                conflict.path,
                conflict.kind,
            ) from conflict

    def close(self) -> None:
        """Close the case file and its working copy, and release the lock of the case file."""
        file, self._file = self._file, None
        scratch, self._scratch = self._scratch, None
        named, self._named = self._named, None
        if file is not None:
            file.close()
        if scratch is not None:
            scratch.remove()
        if named is not None:
            named.close()

    def check_saved(self, moment: Moment, *, last_saved: Moment | None = None, live: Path | None = None) -> None:
        """Refuse to close a case whose file cannot be written and lacks changes.

        Parameters
        ----------
        moment
            The current state of the case.
        last_saved, live
            State in the live file, and its path, for an object that has neither read nor written a named file.

        Raises
        ------
        UnsavedWorkError
            If a change is in no file.
        """
        path = self.path or live
        if path is not None and self.note is not None:
            check_saved(path, self.note, self._saved or last_saved, moment)

    def lacks_changes(self, moment: Moment) -> bool:
        """Return whether the case has a writable file that lacks the current state of the case."""
        if self.path is None or self._named is None or self.note is not None:
            return False
        saved = self._saved
        if saved is None:
            return True
        same_steps = len(saved.steps) == len(moment.steps) and all(
            one.document is other.document for one, other in zip(saved.steps, moment.steps, strict=True)
        )
        same_rest = (saved.position, saved.sight, saved.tip, saved.scope, saved.numbers) == (
            moment.position,
            moment.sight,
            moment.tip,
            moment.scope,
            moment.numbers,
        )
        return not (same_steps and same_rest and saved.first is moment.first)

    def _target(self, path: str | Path | None, replace: bool) -> Path:
        if path is None:
            if self.path is None:
                raise UsageError(
                    "this case has not been saved to a file yet: give a path, such as NAME.carina", code="case.no-place"
                )
            if self.note is not None:
                raise UsageError(self.note, code="case.read-only")
            return self.path
        target = Path(path).expanduser().absolute()
        if target.suffix.lower() != CASE_SUFFIX:
            target = target.with_name(target.name + CASE_SUFFIX)
        _records().refuse_stored(target)
        if target == self.path and self.note is not None and not replace:
            raise UsageError(self.note, code="case.read-only")
        is_own = self._named is not None and self._named.has_path(target)
        if not is_own and target.exists() and not replace:
            raise UsageError(
                f"{target} already exists; choose another name, or pass replace=True to replace it",
                code="case.exists",
            )
        return target

    def _copy_flights(self, file: CaseFile, flights: Sequence[WholeRecording]) -> None:
        there = {one.recording_id for one in file.recordings()}
        for flight in flights:
            facts, writer = flight.facts, flight.writer()
            if facts.recording_id in self._flights:
                continue
            if facts.recording_id in there:
                # A file that lost its numbers may have another flight with this number, so the flight gets the next
                # number.
                writer.number = None
            file.keep_recording(writer)
            if facts.words:
                file.change_recording(writer.recording_id, words=facts.words)
            self._flights.add(facts.recording_id)

    def _needed_file(self, volume: Volume) -> CaseFile:
        if self._file is None:
            if self._scratch is None:
                self._scratch = ScratchFolder()
            place = self._scratch.path / f"case{CASE_SUFFIX}"
            self._file = CaseFile.create(place, SourceFacts.of(volume, ct_digest(volume)))
        return self._file


def _find_ct(case: CaseFile, ct: str | Path | None) -> FoundScan:
    from carina.session.engines import default_parts

    settings = load_settings()
    cache = VolumeCache(settings.cache_dir / "volumes", max_bytes=settings.volume_cache_bytes)
    scans = CaseScans(cache, _records(), default_parts().open_demo, advice="give its location as ct=PATH")
    return scans.open(case, ct=ct)


def _records() -> CaseRecords:
    return CaseRecords(load_settings().cases_dir, time.time)
