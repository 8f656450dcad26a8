"""A case file that a program has open: worked on in a copy, written back whole when the program says so."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from carina.case import CaseFile, CaseFileError, Moment, SourceFacts
from carina.case.recordings import WholeRecording
from carina.config import load_settings
from carina.disk import ScratchFolder
from carina.errors import UsageError
from carina.session.case_scan import CASE_SUFFIX, CaseScans, FoundScan, way_between
from carina.session.named_lock import NamedLock
from carina.session.records import CaseRecords
from carina.volume import Volume, VolumeCache, ct_digest

__all__ = ["NamedCase"]


class NamedCase:
    """Where a program's case is saved to, and the copy that it is saved through."""

    def __init__(self) -> None:
        self.path: Path | None = None
        self.note: str | None = None
        """Why it cannot be saved in its place."""
        self._scratch: ScratchFolder | None = None
        self._file: CaseFile | None = None
        self._lock: NamedLock | None = None
        self._ct_place: str | None = None
        self._saved: Moment | None = None
        self._flights: set[int] = set()
        """The numbers, as the session has them, of those that were put into the file here."""

    def open(self, path: Path, ct: str | Path | None) -> tuple[Volume, Moment | None]:
        """Take a case file, and find its CT.

        Raises
        ------
        CaseFileError
            As :meth:`CaseFile.open`, and ``case.no-scan``.
        VolumeImportError
            If the CT cannot be opened, or is another one.
        """
        self.path = path.absolute()
        with CaseFile.open(path, read_only=True) as original:
            scan = _found(original, ct)
            self._ct_place = scan.place
            if original.note is not None:
                self.note = original.note
                self._saved = original.load(scan.volume)
                return scan.volume, self._saved
            if _records().open_elsewhere(self.path) is not None:
                self.note = (
                    f"{path.name} is open in a Carina window: changes made here can only be saved under another name"
                )
            else:
                self._lock = NamedLock.take(self.path)
                if self._lock is None:
                    self.note = (
                        f"{path.name} is open for editing elsewhere, or cannot be written: changes made here can "
                        "only be saved under another name"
                    )
            self._scratch = ScratchFolder()
            original.write_copy(self._scratch.path / f"case{CASE_SUFFIX}", ct_place=original.source.path)
        self._file = CaseFile.open(self._scratch.path / f"case{CASE_SUFFIX}")
        try:
            self._saved = self._file.load(scan.volume)
        except CaseFileError as trouble:
            if trouble.code != "case.empty":
                raise
        return scan.volume, self._saved

    def came_from(self, place: str | Path) -> None:
        """Where the CT of a case lies that has no file yet."""
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
        """Write one whole file; with a path the case belongs there from now on.

        Beside the flights that the file has come those that are given.

        Raises
        ------
        UsageError
            ``case.no-place``, ``case.exists`` or ``case.read-only``.
        DiskError
            If it cannot be written; what was there before stays.
        """
        target = self._target(path, replace)
        lock = self._lock
        if target != self.path or lock is None:
            lock = NamedLock.take(target)
            if lock is None:
                if not target.parent.is_dir():
                    raise UsageError(f"the folder {target.parent} does not exist", code="case.no-place")
                raise UsageError(
                    f"{target} is open for editing elsewhere, or its folder is not writable: choose another folder",
                    code="case.read-only",
                )
        try:
            file = self._needed_file(volume)
            file.save(moment)
            self._keep_flights(file, flights)
            file.write_copy(target, ct_place=way_between(target, self._ct_place))
        except BaseException:
            if lock is not self._lock:
                lock.release()
            raise
        if lock is not self._lock and self._lock is not None:
            self._lock.release()
        self.path, self._lock, self._saved, self.note = target, lock, moment, None
        return target

    def close(self) -> None:
        """Give the file back."""
        file, self._file = self._file, None
        scratch, self._scratch = self._scratch, None
        lock, self._lock = self._lock, None
        if file is not None:
            file.close()
        if scratch is not None:
            scratch.remove()
        if lock is not None:
            lock.release()

    def is_behind(self, moment: Moment) -> bool:
        """Whether the case has a place of its own, and a moment is not the one that lies there."""
        if self.path is None or self._lock is None:
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
        if target == self.path and self.note is not None:
            raise UsageError(self.note, code="case.read-only")
        if target != self.path and target.exists() and not replace:
            raise UsageError(
                f"{target} already exists; choose another name, or pass replace=True to replace it",
                code="case.exists",
            )
        return target

    def _keep_flights(self, file: CaseFile, flights: Sequence[WholeRecording]) -> None:
        there = {one.recording_id for one in file.recordings()}
        for flight in flights:
            facts, writer = flight.facts, flight.writer()
            if facts.recording_id in self._flights:
                continue
            if facts.recording_id in there:
                # A file whose numbers were lost has another flight of this number: this one gets the next.
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


def _found(case: CaseFile, ct: str | Path | None) -> FoundScan:
    from carina.session.parts import default_parts

    settings = load_settings()
    cache = VolumeCache(settings.cache_dir / "volumes", max_bytes=settings.volume_cache_bytes)
    scans = CaseScans(cache, _records(), default_parts().open_demo, advice="give its location as ct=PATH")
    return scans.open(case, ct=ct)


def _records() -> CaseRecords:
    return CaseRecords(load_settings().cases_dir, time.time)
