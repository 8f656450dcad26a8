"""Opening of the input of a command: a scan, or a case with its scan and its edited tree."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import carina
from carina.cli.console import ProgressCallback, print_note
from carina.config import load_settings
from carina.errors import NoResultError, UsageError, VolumeImportError
from carina.export import read_badges
from carina.scopes import Pose
from carina.session import CaseRecords, CaseScans, is_case_file
from carina.track import assess_ct
from carina.volume import Note, Volume, VolumeCache, badges_of

if TYPE_CHECKING:
    from carina.case import CaseFile, Document, KeyFrames, Moment
    from carina.track import Airways


class Badges:
    """Permanent notes about the input of a command; each is printed once on stderr."""

    def __init__(self) -> None:
        self._notes: dict[Note, None] = {}

    @property
    def notes(self) -> tuple[Note, ...]:
        """All notes in the order in which they were added."""
        return tuple(self._notes)

    def add(self, notes: Iterable[Note]) -> None:
        """Print the new notes on stderr, and store them."""
        for note in notes:
            if note not in self._notes:
                self._notes[note] = None
                print_note(f"note: {note.words}")

    def add_airways_notes(self, airways: object) -> None:
        """Store the notes of an airway search or an imported mask; the caller prints them with the result."""
        for note in getattr(airways, "badges", ()):
            self._notes.setdefault(note, None)

    def add_tree(self, path: Path) -> None:
        """Print and store the notes that the file of a tree contains."""
        self.add(read_badges(path))

    def to_json(self) -> list[dict[str, str]]:
        """Return the notes as ``--json`` prints them under ``badges``."""
        return [{"code": note.code, "words": note.words} for note in self._notes]


@dataclass(slots=True)
class OpenedInput:
    """A scan, with the document of the case if the input was a case."""

    volume: Volume
    badges: Badges
    moment: Moment | None = None
    """Last saved state of the case; None for a scan."""
    place: Path | None = None
    """Path of the scan; None if the scan was read from the case or the cache."""
    _airways: Airways | None = None

    @property
    def document(self) -> Document | None:
        """Document of the case with the changes of the user; None for a scan."""
        return None if self.moment is None else self.moment.history().current

    @property
    def tip(self) -> Pose | None:
        """Last pose of the tip; None for a scan, and for a rescued case without its tip."""
        if self.moment is None or not self.moment.tip:
            return None
        return Pose(np.array(self.moment.tip["lps_from_camera"], dtype=np.float64))

    def airways(self, progress: ProgressCallback) -> Airways:
        """Return the airways of the case with all edits, or find those of a scan at the first call.

        Raises
        ------
        NoResultError
            If the case or the scan has no airways.
        """
        if self._airways is None:
            document = self.document
            if document is None:
                self._airways = carina.find_airways(self.volume, progress=progress)
            elif document.airways is None:
                raise NoResultError(
                    "this case has no airways yet; open it in the window to segment them, or give the scan instead of "
                    "the case",
                    code="track.no-airways",
                )
            else:
                self._airways = document.airways
            print_assessment(self.volume, self._airways)
        return self._airways

    def key_frames(self, wanted: str) -> Document:
        """Return the document with the selected key frames: ``all``, or some in the order of the flight.

        Raises
        ------
        UsageError
            If no key frame, or more than one, has a given name.
        """
        document = self.document
        assert document is not None
        return replace(document, key_frames=_selected_keys(document.key_frames, wanted))


def assessment_json(volume: Volume, airways: Airways | None) -> dict[str, Any] | None:
    """Return the statement on a CT as ``--json`` prints it under ``assessment``; None if the values are not HU."""
    return assess_ct(volume, airways).to_json() if volume.is_hu else None


def print_assessment(volume: Volume, airways: Airways) -> None:
    """Print on stderr to which generation airways can be trusted in a CT, and what limits them."""
    if volume.is_hu:
        print_note(f"CT: {assess_ct(volume, airways).summary}")


def _selected_keys(keys: KeyFrames, wanted: str) -> KeyFrames:
    if wanted.strip() == "all":
        return keys
    chosen = []
    for name in (part.strip() for part in wanted.split(",")):
        found = [one for one in keys.frames if one.name == name] or [one for one in keys.frames if one.key_id == name]
        if not found:
            known = ", ".join(one.name or one.key_id for one in keys.frames) or "none"
            raise UsageError(f"--keys: expected all, a file, or key frames of the case ({known}); found {name!r}")
        if len(found) > 1:
            ids = ", ".join(one.key_id for one in found)
            raise UsageError(f"--keys: {len(found)} key frames have the name {name!r}; use their ids: {ids}")
        chosen += found
    return replace(keys, frames=tuple(chosen))


def case_scans() -> CaseScans:
    """Return an object that finds the scans of cases on this machine."""
    from carina.session import default_parts

    settings = load_settings()
    return CaseScans(
        VolumeCache(settings.cache_dir / "volumes", max_bytes=settings.volume_cache_bytes),
        CaseRecords(settings.cases_dir, lambda: 0.0),
        default_parts().open_demo,
        advice="give its location with --ct PATH",
    )


def newest_case_file(path: Path) -> Path:
    """Return the path of a case file, or of its newer live file (with a note on stderr) if a window has it open."""
    settings = load_settings()
    records = CaseRecords(settings.cases_dir, lambda: 0.0)
    record = records.open_elsewhere(path.expanduser().absolute())
    if record is None:
        return path
    print_note(f"note: {path.name} is open in Carina; its last saved state is used")
    return records.path_of(record)


def check_case_options(path: Path, ct: Path | None, **refused: object) -> None:
    """Raise an error for contradictory options before the work begins.

    ``refused`` contains the values of options that are not allowed with a case, because the case defines the airways.

    Raises
    ------
    UsageError
        If ``--ct`` is given without a case, or one of ``refused`` with a case.
    """
    if not is_case_file(path):
        if ct is not None:
            raise UsageError("--ct only applies to a case file (NAME.carina)")
        return
    for name, value in refused.items():
        if value is not None and value is not False:
            raise UsageError(
                f"--{name.replace('_', '-')}: the case contains airways, with all edits; omit the option, "
                "or give the scan instead of the case"
            )


def check_scan_exists(path: Path) -> None:
    """Raise the error of a missing scan before other files of a command are read; a case names its own scan.

    Raises
    ------
    VolumeImportError
        ``import.not-found``: if there is no file or folder at the path.
    """
    if not is_case_file(path):
        from carina.volume.opening import check_exists

        check_exists(path.expanduser())


def open_input(
    path: Path,
    *,
    series: str | None,
    progress: ProgressCallback,
    strict: bool = False,
    ct: Path | None = None,
) -> OpenedInput:
    """Open a scan or a case, print its notes, and create the list of its badges.

    Raises
    ------
    VolumeImportError
        If the scan or the case cannot be opened; with ``strict`` also ``import.strict``, if the scan has a badge.
    """
    if is_case_file(path):
        from carina.case import CaseFile

        with CaseFile.open(newest_case_file(path), read_only=True) as case:
            found = _open_case_scan(case, ct, series, progress)
    else:
        found = OpenedInput(carina.open_volume(path, series=series, progress=progress), Badges(), place=path)
    _print_notes(found)
    if strict and found.badges.notes:
        codes = ", ".join(note.code for note in found.badges.notes)
        msg = (
            f"reading {path.name}: the scan check found problems ({codes}), which --strict does not allow; "
            "correct them, or omit --strict"
        )
        raise VolumeImportError(msg, code="import.strict")
    return found


def open_input_volume(path: Path, *, series: str | None, progress: ProgressCallback, ct: Path | None = None) -> Volume:
    """Open a scan, or the scan of a case, without printing notes."""
    if not is_case_file(path):
        return carina.open_volume(path, series=series, progress=progress)
    from carina.case import CaseFile

    with CaseFile.open(path, read_only=True) as case:
        return case_scans().open(case, ct=ct, series=series, progress=progress).volume


def _open_case_scan(case: CaseFile, ct: Path | None, series: str | None, progress: ProgressCallback) -> OpenedInput:
    if case.note is not None:
        print_note(f"note: {case.note}")
    scan = case_scans().open(case, ct=ct, series=series, progress=progress)
    place = None if scan.place is None or scan.place.startswith("demo:") else Path(scan.place)
    return OpenedInput(scan.volume, Badges(), case.load(scan.volume), place)


def _print_notes(found: OpenedInput) -> None:
    notes: Iterable[Any] = found.volume.source.notes
    for note in notes:
        if not note.badge:
            print_note(f"note: {note.words}")
    found.badges.add(badges_of(found.volume))
