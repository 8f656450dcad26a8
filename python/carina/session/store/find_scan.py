"""Search for the CT of a case file, with verification of its digest and geometry."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from carina.case import CaseFile, CaseFileError
from carina.display import one_line
from carina.display.progress import Progress, ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, CarinaError, UsageError
from carina.volume import Volume, ct_digest, refuse_other_ct
from carina.volume.inserted_structures import with_inserted

if TYPE_CHECKING:
    from carina.session.store.registry import CaseRecords
    from carina.volume import VolumeCache

CASE_SUFFIX = ".carina"
Cancel = Callable[[], bool] | None


def is_case_file(path: str | Path) -> bool:
    """Return whether a path has the suffix of case files and is not a folder (a folder contains slices)."""
    place = Path(path)
    return place.suffix.lower() == CASE_SUFFIX and not place.is_dir()


@one_line
@dataclass(frozen=True, slots=True)
class FoundScan:
    """The CT of a case, and the path from which it was opened."""

    volume: Volume
    place: str | None
    """Absolute path of the CT, or ``demo:NAME``; None if the CT came from the cache or the case file."""


class CaseScans:
    """Search for the CTs of cases.

    Parameters
    ----------
    cache
        Cache of opened CTs.
    records
        Records of the user's cases, which contain the last path of each CT.
    open_demo
        ``open_demo(name, progress, cancel)``, for cases of the bundled CTs.
    advice
        Advice at the end of the message if a CT is not found.
    """

    def __init__(
        self,
        cache: VolumeCache | None = None,
        records: CaseRecords | None = None,
        open_demo: Callable[..., Volume] | None = None,
        *,
        advice: str = "give its current location",
    ) -> None:
        self._cache = cache
        self._records = records
        self._open_demo = open_demo
        self._advice = advice

    def __repr__(self) -> str:
        """Describe the search by its cache."""
        return f"CaseScans({self._cache!r})"

    @shows_progress
    def open(
        self,
        case: CaseFile,
        *,
        ct: str | Path | None = None,
        series: str | None = None,
        dropped: bool = False,
        progress: ProgressChoice = None,
        cancel: Cancel = None,
    ) -> FoundScan:
        """Open the CT of a case.

        The CT is searched at the path in the case file, at the last path of this user, in the cache and in the case
        file itself. The digest and the geometry of a found CT must be those of the case.

        Parameters
        ----------
        case
            The open case file.
        ct
            Path of the CT given by the user; no other location is then searched.
        series
            Series of a folder with several, as for :func:`carina.open_volume`.
        dropped
            Whether the case file was dropped into a window, so that its relative path to the CT is not valid.
        progress
            False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook;
            False shows none. The fraction is None while the progress is unknown.
        cancel
            Called often; the work stops when it returns True.

        Returns
        -------
        FoundScan
            The CT and its location.

        Raises
        ------
        CaseFileError
            ``case.no-scan``: if the CT is not found.
        VolumeImportError
            If ``ct`` cannot be opened or is another CT; or if another CT is at the path in the case file and the right
            CT is not found elsewhere.
        """
        source = case.source
        if series is None and isinstance(source.choices.get("series"), str):
            series = source.choices["series"]

        report = progress_function(progress)

        def opened(place: str) -> FoundScan:
            if place.startswith("demo:"):
                assert self._open_demo is not None
                volume = self._open_demo(place.removeprefix("demo:"), report or _no_progress, cancel or _no_cancel)
            else:
                volume = self._open_scan(Path(place), series, report, cancel)
                if series is None:
                    volume = self._series_with_digest(volume, source.digest, Path(place), report, cancel)
            refuse_other_ct(volume, source.digest, source)
            return FoundScan(_with_mark(volume, case), place)

        if ct is not None:
            return opened(str(Path(ct).expanduser().absolute()))
        refusal: CarinaError | None = None
        path = None if dropped else source.path
        for place in self._candidate_places(case, path, source.digest):
            try:
                return opened(place)
            except CancelledError:
                raise
            except (CarinaError, OSError) as error:
                if refusal is None and isinstance(error, CarinaError):
                    refusal = error
        cached = None if self._cache is None else self._cache.find_digest(source.digest)
        volume = None if cached is None else cached.load(progress=report, cancel=cancel)
        if volume is None:
            volume = case.packed_volume()
        if volume is not None:
            refuse_other_ct(volume, source.digest, source)
            return FoundScan(_with_mark(volume, case), None)
        if refusal is not None:
            raise refusal
        raise CaseFileError(
            f"{case.path}: the scan of this case was not found{'' if path is None else f' at {path}'}; {self._advice}",
            code="case.no-scan",
        )

    def _series_with_digest(
        self, volume: Volume, digest: str, place: Path, progress: Progress | None, cancel: Cancel
    ) -> Volume:
        """Return the series of a folder that has a digest; if there is none, the volume of the likeliest chest CT."""
        if ct_digest(volume) == digest:
            return volume
        for info in volume.source.other_series:
            if info.refused is None and info.num_slices > 1:
                other = self._open_scan(place, info.key, progress, cancel)
                if ct_digest(other) == digest:
                    return other
        return volume

    def _candidate_places(self, case: CaseFile, path: str | None, digest: str) -> list[str]:
        found: list[str] = []
        if path is not None:
            # The case file may come from another person, so its path may lead only to files and folders, not to a
            # device or pipe.
            beside = (case.path.absolute().parent / path).resolve()
            if beside.is_file() or beside.is_dir():
                found.append(str(beside))
        known = (one.place for one in self._records.all() if one.digest == digest) if self._records is not None else ()
        # The last path of this user; a copy of the case that was opened without its CT has none.
        place = next((one for one in known if one is not None), None)
        if place is not None and place not in found:
            is_demo = place.startswith("demo:")
            if self._open_demo is not None if is_demo else Path(place).exists():
                found.append(place)
        return found

    def _open_scan(self, place: Path, series: str | None, progress: Progress | None, cancel: Cancel) -> Volume:
        from carina.volume import open_volume

        if is_case_file(place):
            raise UsageError(f"{place}: expected the CT of the case, found a case file")
        if self._cache is None:
            return open_volume(place, series=series, progress=progress, cancel=cancel)
        return self._cache.open(place, series=series, progress=progress, cancel=cancel).volume


def _with_mark(volume: Volume, case: CaseFile) -> Volume:
    """Return a CT with the note on nodules that the case records, if a copy of the CT has lost its own mark."""
    if volume.source.inserted:
        return volume
    inserted = case.inserted
    if not inserted:
        return volume
    return replace(volume, source=with_inserted(volume.source, inserted))


def relative_path(copy: Path, place: str | None) -> str | None:
    """Return the relative path from a case file to its CT; None if there is none, as between two Windows drives."""
    if place is None or place.startswith("demo:"):
        return None
    try:
        return Path(os.path.relpath(place, copy.parent)).as_posix()
    except ValueError:
        return None


def _no_progress(_what: str, _fraction: float | None) -> None:
    pass


def _no_cancel() -> bool:
    return False
