"""DICOM folders: which series they hold, which one is the chest CT, and how it becomes a volume."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError, VolumeImportError
from carina.volume.dicom_geometry import grid_from_slices
from carina.volume.dicom_headers import SliceHeader, read_headers
from carina.volume.dicom_pixels import read_slice
from carina.volume.hu import judge_dicom
from carina.volume.model import SeriesInfo, Volume, VolumeSource
from carina.volume.watch import Watch

__all__ = ["FoundSeries", "choose_series", "find_series", "open_series"]

MAX_VOXELS = 1 << 31
"""Of any volume that is opened: 4 GiB as int16, ten times a large chest CT."""

_CHEST = re.compile(r"chest|thora|lung|pulmo|bronch", re.IGNORECASE)
# Many exporters name files by their UID; a volume carries none, not even inside a sentence about another series.
_UID = re.compile(r"[\w.-]*\d+(?:\.\d+){4,}[\w.-]*")
_ELSEWHERE = re.compile(r"head|brain|skull|neuro|sinus|abdom|pelvi|spine|knee|foot|hand|leg\b|hip\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class FoundSeries:
    """One series of a folder, with its slices in order and its grid, or the reason why it has none."""

    info: SeriesInfo
    slices: tuple[SliceHeader, ...]
    lps_from_ijk: NDArray[np.float64] | None
    refusal: VolumeImportError | None
    score: float
    """Slices times covered height in mm, weighted by what the texts say; decides which one is the chest CT."""

    @property
    def name(self) -> str:
        """How messages call it."""
        return _name(self.info)

    @property
    def coverage_mm(self) -> float:
        """Height of the stack along its normal."""
        if len(self.slices) < 2:
            return 0.0
        normal = np.cross(self.slices[0].row_lps, self.slices[0].column_lps)
        along = np.array([header.position_lps for header in self.slices]) @ normal
        return float(along.max() - along.min())


def _name(info: SeriesInfo) -> str:
    text = f" ({info.description})" if info.description else ""
    return f"series {info.key}{text}"


def _grid(slices: Sequence[SliceHeader], what: str) -> tuple[list[SliceHeader], NDArray[np.float64]]:
    bad = [header for header in slices if header.problem is not None]
    if bad:
        first = bad[0]
        count = f" ({len(bad)} of {len(slices)} images are affected)" if len(bad) > 1 else ""
        msg = (
            f"{what}: {first.path.name} cannot be used: {first.problem}{count}; export the series again, or choose "
            "another one"
        )
        raise VolumeImportError(msg, code=first.problem_code)
    if len(slices) * slices[0].rows * slices[0].columns > MAX_VOXELS:
        msg = (
            f"{what}: its {len(slices)} slices hold more than {MAX_VOXELS} voxels; expected one chest CT; choose "
            "another series"
        )
        raise VolumeImportError(msg, code="import.too-large")
    return grid_from_slices(slices, what=what)


def _score(slices: Sequence[SliceHeader], coverage_mm: float) -> float:
    first = slices[0]
    score = (1 + len(slices)) * (1 + coverage_mm)
    text = f"{first.body_part} {first.description}"
    # Texts are optional and often wrong, so they only weigh: a long chest CT without a text beats a short one with it.
    if _CHEST.search(text):
        score *= 4
    elif _ELSEWHERE.search(text):
        score /= 4
    if first.localizer:
        score *= 1e-6
    if first.modality != "CT":
        score *= 1e-6
    if first.problem_code in ("import.not-a-scan", "import.multi-frame"):
        score *= 1e-3
    return score


def find_series(headers: Sequence[SliceHeader]) -> list[FoundSeries]:
    """Group images into series, best chest CT first.

    Images of one SeriesInstanceUID belong together, except scouts (ImageType LOCALIZER), which are a series of their
    own.
    """
    groups: dict[tuple[str, bool], list[SliceHeader]] = {}
    for header in headers:
        groups.setdefault((header.series_uid, header.localizer), []).append(header)

    used: dict[str, int] = {}
    found = []
    # By number, then by file name: the keys a person types do not depend on UIDs.
    for slices in sorted(groups.values(), key=lambda group: (group[0].series_number or 0, str(group[0].path))):
        first = slices[0]
        number = "0" if first.series_number is None else str(first.series_number)
        used[number] = used.get(number, 0) + 1
        key = number if used[number] == 1 else f"{number}-{used[number]}"
        info = SeriesInfo(
            key=key,
            modality=first.modality,
            description=first.description or ("scout" if first.localizer else ""),
            num_slices=len(slices),
        )
        series = FoundSeries(info, tuple(slices), None, None, 0.0)
        try:
            ordered, lps_from_ijk = _grid(slices, f"reading {_name(info)}")
            shape = (len(ordered), first.rows, first.columns)
            series = replace(
                series, info=replace(info, shape_zyx=shape), slices=tuple(ordered), lps_from_ijk=lps_from_ijk
            )
        except VolumeImportError as error:
            series = replace(series, info=replace(info, refused=_UID.sub("(file name)", str(error))), refusal=error)
        found.append(replace(series, score=_score(slices, series.coverage_mm)))
    return sorted(found, key=lambda item: (-item.score, item.info.key))


def describe_series(series: Sequence[SeriesInfo]) -> str:
    """One line that lists series: "series 2 (Thorax 1.0), 300 slices; series 1 (scout), 1 slice"."""
    return "; ".join(
        f"{_name(info)}, {info.modality or 'no modality'}, {info.num_slices} slice{'s' if info.num_slices != 1 else ''}"
        for info in series
    )


def choose_series(found: Sequence[FoundSeries], *, key: str | None, where: str) -> tuple[FoundSeries, tuple[str, ...]]:
    """Choose by key, else the largest chest CT; say which others there are.

    Where the largest is refused, another CT takes its place only if it covers at least half of its height, and a
    warning says so.

    Returns
    -------
    chosen, warnings

    Raises
    ------
    UsageError
        ``usage.series``: no series has this key.
    VolumeImportError
        The refusal of the chosen series, with the others named.
    """
    if key is not None:
        chosen = next((item for item in found if item.info.key == key), None)
        if chosen is None:
            msg = f"{where} has no series {key!r}; it has {describe_series([item.info for item in found])}"
            raise UsageError(msg, code="usage.series")
        if chosen.refusal is not None:
            raise chosen.refusal
        return chosen, ()
    chosen = found[0]
    notes: list[str] = []
    if chosen.refusal is not None:
        refused, refusal = chosen, chosen.refusal
        candidates = [
            item
            for item in found[1:]
            if item.refusal is None
            and item.info.modality == refused.info.modality
            and not item.slices[0].localizer
            and item.coverage_mm >= 0.5 * refused.coverage_mm > 0
        ]
        if not candidates:
            others = [item.info for item in found[1:]]
            more = f". {where} also has: {describe_series(others)}" if others else ""
            raise VolumeImportError(f"{refusal}{more}", code=refusal.code)
        chosen = candidates[0]
        notes.append(f"the largest series was refused ({refused.info.refused}); {chosen.name} was opened in its place")
    others = [item.info for item in found if item is not chosen]
    if others:
        notes.append(
            f"the folder holds several series; opened {chosen.name}, {chosen.info.num_slices} slices; not opened: "
            f"{describe_series(others)}"
        )
    return chosen, tuple(notes)


def open_series(
    series: FoundSeries, *, others: Sequence[SeriesInfo], warnings: tuple[str, ...], watch: Watch
) -> Volume:
    """Read the pixels of one series into a volume.

    Raises
    ------
    VolumeImportError
        If a slice is cut short or does not decode; the message names the file.
    CancelledError
        If the person cancels, at the latest after one slice.
    """
    if series.lps_from_ijk is None or series.info.shape_zyx is None:
        raise series.refusal or VolumeImportError(f"reading {series.name}: it has no grid")
    first = series.slices[0]
    notes = list(warnings)
    values: NDArray[np.int16] | None = None
    num_clipped = 0
    for index, header in enumerate(series.slices):
        watch.step("Reading the slices", index / len(series.slices))
        numbers: NDArray[Any] = read_slice(header)
        if values is None:  # only now: a first slice that cannot be read costs no memory for the rest
            values = np.empty(series.info.shape_zyx, dtype=np.int16)
        if numbers.dtype.kind == "f":
            numbers = np.rint(numbers)
        if numbers.min() < -32768 or numbers.max() > 32767:
            num_clipped += int(np.count_nonzero((numbers < -32768) | (numbers > 32767)))
            numbers = np.clip(numbers, -32768, 32767)
        values[index] = numbers
    assert values is not None  # a grid has at least two slices
    if values.min() == values.max():
        msg = f"reading {series.name}: every pixel holds the same number, so there is nothing to see; export it again"
        raise VolumeImportError(msg, code="import.values")
    if num_clipped:
        notes.append(f"{num_clipped} voxels lie outside -32768..32767 and were set to the nearest of these")
    if any(header.lossy for header in series.slices):
        notes.append("the slices were compressed with loss; fine walls may be blurred")
    verdict = judge_dicom(
        values,
        modality=first.modality,
        has_rescale=all(header.has_rescale for header in series.slices),
        rescale_type=first.rescale_type,
        bits_stored=min(header.bits_stored for header in series.slices),
    )
    source = VolumeSource(
        format="dicom",
        title=series.info.description or f"{first.modality} series {series.info.key}",
        series=series.info,
        other_series=tuple(others),
        warnings=tuple(notes),
    )
    watch.step("Reading the slices", 1.0)
    return Volume(values, series.lps_from_ijk, is_hu=verdict.is_hu, not_hu_reason=verdict.reason, source=source)


def series_in(folder: Path, *, recursive: bool, watch: Watch) -> list[FoundSeries]:
    """All series in a folder, best chest CT first; empty where there is no DICOM image."""
    return find_series(read_headers(folder, recursive=recursive, watch=watch))
