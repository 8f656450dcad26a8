"""The CT of a case file: where it lies now, and that it is the one."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from carina.case import CaseFile, CaseFileError
from carina.display import one_line
from carina.display.progress import Progress, ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, CarinaError, UsageError
from carina.volume import Volume, refuse_other_ct

if TYPE_CHECKING:
    from carina.session.records import CaseRecords
    from carina.volume import VolumeCache

__all__ = ["CASE_SUFFIX", "CaseScans", "FoundScan", "is_case_file", "way_between"]

CASE_SUFFIX = ".carina"
Cancel = Callable[[], bool] | None


def is_case_file(path: str | Path) -> bool:
    """Whether a path is to be opened as a case; a folder of that name holds slices."""
    place = Path(path)
    return place.suffix.lower() == CASE_SUFFIX and not place.is_dir()


@one_line
@dataclass(frozen=True, slots=True)
class FoundScan:
    """The CT of a case."""

    volume: Volume
    place: str | None
    """Where it was opened from: an absolute path, or ``demo:NAME``; None where it came from a cache or the case."""


class CaseScans:
    """Looks for the CTs of cases.

    Parameters
    ----------
    cache
        CTs that were opened before.
    records
        The cases of this person: they know where a CT was opened from last.
    open_demo
        ``open_demo(name, progress, cancel)``, for cases of the bundled CTs.
    advice
        What to do where a CT is not found: it ends the sentence.
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

        It is looked for at the place in the file, where this person opened it last, in the cache and in the file
        itself; whatever is found is compared by digest and geometry.

        Parameters
        ----------
        ct
            Where a person says that it lies; nothing else is looked at then.
        series
            As of :func:`carina.open_volume`.
        dropped
            The file lies where its person did not put it, so the place in it leads nowhere.
        progress
            False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction
            is None where it is unknown.
        cancel
            Called often; the work stops when it returns True.

        Raises
        ------
        CaseFileError
            ``case.no-scan``: if it is nowhere.
        VolumeImportError
            If ``ct`` cannot be opened, or is another CT; or another lies at the place in the file, and none elsewhere.
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
                volume = self._opened(Path(place), series, report, cancel)
            refuse_other_ct(volume, source.digest, source)
            return FoundScan(volume, place)

        if ct is not None:
            return opened(str(Path(ct).expanduser().absolute()))
        refusal: CarinaError | None = None
        path = None if dropped else source.path
        for place in self._places(case, path, source.digest):
            try:
                return opened(place)
            except CancelledError:
                raise
            except (CarinaError, OSError) as trouble:
                if refusal is None and isinstance(trouble, CarinaError):
                    refusal = trouble
        kept = None if self._cache is None else self._cache.find_digest(source.digest)
        volume = None if kept is None else kept.load(progress=report, cancel=cancel)
        if volume is None:
            volume = case.packed_volume()
        if volume is not None:
            refuse_other_ct(volume, source.digest, source)
            return FoundScan(volume, None)
        if refusal is not None:
            raise refusal
        raise CaseFileError(
            f"{case.path}: the scan of this case was not found{'' if path is None else f' at {path}'}; {self._advice}",
            code="case.no-scan",
        )

    def _places(self, case: CaseFile, path: str | None, digest: str) -> list[str]:
        found: list[str] = []
        if path is not None:
            # What a stranger wrote leads to files and folders alone, never to a device or a pipe.
            beside = (case.path.absolute().parent / path).resolve()
            if beside.is_file() or beside.is_dir():
                found.append(str(beside))
        known = (one.place for one in self._records.all() if one.digest == digest) if self._records is not None else ()
        # Where it was opened last; a copy of the case that came without its CT knows no place.
        place = next((one for one in known if one is not None), None)
        if place is not None and place not in found:
            is_demo = place.startswith("demo:")
            if self._open_demo is not None if is_demo else Path(place).exists():
                found.append(place)
        return found

    def _opened(self, place: Path, series: str | None, progress: Progress | None, cancel: Cancel) -> Volume:
        from carina.volume import open_volume

        if is_case_file(place):
            raise UsageError(f"{place}: expected the CT of the case, found a case file")
        if self._cache is None:
            return open_volume(place, series=series, progress=progress, cancel=cancel)
        return self._cache.open(place, series=series, progress=progress, cancel=cancel).volume


def way_between(copy: Path, place: str | None) -> str | None:
    """From the copy to its CT; None where there is none, as between two drives of Windows."""
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
