"""Reading of DICOM folders: finds the series, chooses the chest CT, and reads the series into a volume."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError, VolumeImportError
from carina.volume.dicom_checks import (
    Clipping,
    check_rescale_tags,
    doubt_notes,
    is_odd,
    odd_slices,
    refuse_contradicting_rescale,
)
from carina.volume.dicom_files import FolderContent, LostFiles, UnusedFile, name_files
from carina.volume.dicom_geometry import SliceStack, grid_from_slices
from carina.volume.dicom_headers import SETTINGS, SliceHeader, acquisition_date
from carina.volume.dicom_pixel_bytes import release_pixel_data
from carina.volume.dicom_pixels import Doubt, decode_slice, is_compressed
from carina.volume.dicom_series import Group, count_patients, group_slices, without_copies
from carina.volume.dicom_slice_batches import read_plain_slices
from carina.volume.hu import HU_TYPES, MAX_DOUBTFUL_SHARE, HuVerdict, clipped_note, judge_dicom
from carina.volume.jpeg2000_check import SecondDecoder, not_checked_note, second_decoder
from carina.volume.message_limits import bounded_list, bounded_message, bounded_name
from carina.volume.missing_slices import fill_between
from carina.volume.model import Note, SeriesInfo, Volume, VolumeSource
from carina.volume.padding import PaddingCount
from carina.volume.progress import Watch
from carina.volume.read_limits import MAX_VOXELS

_CHEST = re.compile(r"chest|thora|lung|pulmo|bronch", re.IGNORECASE)
# Many exporters use UIDs as file names. A volume contains no UID, not even in a message about another series.
_UID = re.compile(r"[\w.-]*\d+(?:\.\d+){4,}[\w.-]*")
_DERIVED = re.compile(r"\b(mip|minip|mpr|projection image|screen save|average|subtract\w*)\b")
_MAX_SERIES_NAMED = 4  # largest number of series that one message names
_MAX_DATES = 100  # largest number of series of a folder whose dates are read
_PHASES = {
    "NominalPercentageOfRespiratoryPhase": "breathing {} %",
    "NominalPercentageOfCardiacPhase": "heart {} %",
    "TemporalPositionIndex": "time {}",
    "TemporalPositionIdentifier": "time {}",
    "TemporalPositionTimeOffset": "time {} s",
}
_IMAGE_TYPE = list(SETTINGS).index("ImageType")
_ODD = Doubt("import.slices-odd", "a slice differs from both its neighbours far more than they differ from each other")
_ELSEWHERE = re.compile(r"head|brain|skull|neuro|sinus|abdom|pelvi|spine|knee|foot|hand|leg\b|hip\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class FoundSeries:
    """One series of a folder with its slices in order and its grid, or with the reason why it has no grid."""

    info: SeriesInfo
    slices: tuple[SliceHeader, ...]
    stack: SliceStack | None = None
    """Slices in order and the grid of their volume; None if the series is refused."""
    refusal: VolumeImportError | None = None
    score: float = 0.0
    """Number of slices times covered height in mm, weighted by header texts (body part, description, image type).

    The series with the largest score is opened.
    """
    notes: tuple[Note, ...] = ()
    """Notes about the files of the series."""
    missing: tuple[UnusedFile, ...] = ()
    """Files that look like a part of the series and could not be used."""

    @property
    def lps_from_ijk(self) -> NDArray[np.float64] | None:
        """Transform (4x4) from voxel centres to LPS mm; None if the series is refused."""
        return None if self.stack is None else self.stack.grid.lps_from_ijk

    @property
    def name(self) -> str:
        """Name of the series in messages to the user."""
        return _name(self.info)

    @property
    def coverage_mm(self) -> float:
        """Height in mm that the slices cover along their normal."""
        if len(self.slices) < 2:
            return 0.0
        normal = np.cross(self.slices[0].row_lps, self.slices[0].column_lps)
        along = np.array([header.position_lps for header in self.slices]) @ normal
        return float(along.max() - along.min())


def _name(info: SeriesInfo) -> str:
    text = f" ({info.description})" if info.description else ""
    return f"series {info.key}{text}"


def _grid(group: Group, what: str) -> SliceStack:
    """Return the sorted slices of a group and their grid, after checks of all headers."""
    slices = group.slices
    bad = [header for header in slices if header.problem is not None]
    if bad:
        first = bad[0]
        count = f" ({len(bad)} of {len(slices)} images are affected)" if len(bad) > 1 else ""
        msg = (
            f"{what}: {first.file_name} cannot be used: {first.problem}{count}; export the series again, or choose "
            "another one"
        )
        raise VolumeImportError(msg, code=first.problem_code)
    if len(slices) * slices[0].rows * slices[0].columns > MAX_VOXELS:
        raise _too_large(what, len(slices))
    try:
        # Slices on other grids that were separated from this series may be the missing ones.
        found = grid_from_slices(slices, what=what, fills_gaps=not group.mixed_with)
    except VolumeImportError:
        # Slices on other grids were separated from this series; the error of the undivided series states this cause.
        if group.mixed_with:
            grid_from_slices(group.mixed_with, what=what)
        raise
    check_rescale_tags(found.slices, what)
    if math.prod(found.grid.shape_zyx) > MAX_VOXELS:
        raise _too_large(what, found.grid.shape_zyx[0])
    return found


def _too_large(what: str, num_slices: int) -> VolumeImportError:
    msg = (
        f"{what}: its {num_slices} slices have more than {MAX_VOXELS} voxels; expected one chest CT; choose another "
        "series"
    )
    return VolumeImportError(msg, code="import.too-large")


def _score(slices: Sequence[SliceHeader], coverage_mm: float) -> float:
    """Return the score by which the chest CT is chosen; see :attr:`FoundSeries.score`."""
    first = slices[0]
    score = (1 + len(slices)) * (1 + coverage_mm)
    text = f"{first.body_part} {first.description}"
    # Texts are optional and often wrong, so they only change the score: a long CT without a text has a larger score
    # than a short one with a matching text.
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
    if _DERIVED.search(first.settings[_IMAGE_TYPE]):
        score /= 4
    return score


def find_series(content: FolderContent, watch: Watch) -> list[FoundSeries]:
    """Divide the images of a folder into series, the best chest CT first, by the rules of ``dicom_series``.

    Scouts (ImageType LOCALIZER) form their own series.

    Parameters
    ----------
    content
        Headers and unused files of the folder.
    watch
        Progress and cancellation.
    """
    headers, copies = without_copies(content.headers, watch)
    groups = group_slices(headers)
    common = _notes_of_folder(headers)
    lost = LostFiles(content)
    used: dict[str, int] = {}
    found = []
    # Sorted by number, then by file name, so that the keys that a user types do not depend on UIDs.
    for group in sorted(groups, key=lambda item: (item.slices[0].series_number or 0, str(item.slices[0].path))):
        watch.step("Sorting the images")
        slices = group.slices
        first = slices[0]
        number = "0" if first.series_number is None else str(first.series_number)
        used[number] = used.get(number, 0) + 1
        description = first.description or ("scout" if first.localizer else "")
        info = SeriesInfo(
            key=number if used[number] == 1 else f"{number}-{used[number]}",
            modality=first.modality,
            description=", ".join(filter(None, (description, group.label))),
            num_slices=len(slices),
        )
        info = replace(
            info,
            thickness_mm=_common_thickness_mm(slices),
            kernel=_common_setting(slices, "ConvolutionKernel"),
            phase=_phase(slices),
            # A folder of very many series is damaged or is not a scan, and reading all dates would take too long.
            acquired_on=acquisition_date(first.path) if len(groups) <= _MAX_DATES else None,
        )
        missing = lost.files_like(slices)
        notes = (*common, *group.notes, *_notes_of_files(slices, missing, copies))
        series = FoundSeries(info, slices, notes=notes, missing=tuple(missing))
        try:
            stack = _grid(group, f"reading {_name(info)}")
            slice_mm = float(np.linalg.norm(stack.grid.lps_from_ijk[:3, 2]))
            series = replace(
                series,
                info=replace(
                    info,
                    shape_zyx=stack.grid.shape_zyx,
                    height_mm=round(slice_mm * (stack.grid.shape_zyx[0] - 1), 2),
                    slice_distance_mm=round(slice_mm, 4),
                ),
                slices=stack.slices,
                stack=stack,
                notes=(*notes, *stack.notes),
            )
        except VolumeImportError as error:
            refusal = _with_unused_files(error, missing)
            series = replace(series, info=replace(info, refused=_UID.sub("(file name)", str(refusal))), refusal=refusal)
        found.append(replace(series, score=_score(slices, series.coverage_mm)))
    ordered = sorted(found, key=lambda item: (-item.score, item.info.key))
    if len(ordered) > 1:
        best = ordered[0]
        ordered[0] = replace(best, info=replace(best.info, likeliest=_reason(best).strip(" ()")))
    return ordered


def _common_setting(slices: Sequence[SliceHeader], keyword: str) -> str:
    """Return the value of a setting that all slices have; empty without one common value."""
    at = list(SETTINGS).index(keyword)
    found = {header.settings[at] for header in slices}
    text = found.pop() if len(found) == 1 else ""
    return "".join(c for c in text if c.isprintable())[:32]


def _phase(slices: Sequence[SliceHeader]) -> str:
    """Return the phase or time point of all slices; empty without one."""
    found = ((words, _common_setting(slices, keyword)) for keyword, words in _PHASES.items())
    return next((words.format(value) for words, value in found if value), "")


def _reason(series: FoundSeries) -> str:
    """Return why a series is the likeliest chest CT of its folder, from the facts of its score."""
    info = series.info
    if info.height_mm is None or info.slice_distance_mm is None:
        return ""
    named = (
        ", named as a chest" if _CHEST.search(f"{series.slices[0].body_part} {series.slices[0].description}") else ""
    )
    return f" (the likeliest chest CT: {info.height_mm:.0f} mm in slices {info.slice_distance_mm:.3g} mm apart{named})"


def _notes_of_folder(headers: Sequence[SliceHeader]) -> tuple[Note, ...]:
    patients = count_patients(headers)
    if patients < 2:
        return ()
    words = f"the folder contains images of {patients} patients; check that this is the right patient"
    return (Note("import.two-patients", words, badge=True),)


def _notes_of_files(
    slices: Sequence[SliceHeader], missing: Sequence[UnusedFile], copies: Mapping[Hashable, Sequence[SliceHeader]]
) -> list[Note]:
    notes = []
    if missing:
        verb = (
            "files next to the slices look like part" if len(missing) > 1 else "file next to the slices looks like part"
        )
        names = name_files([(file.path, file.reason) for file in missing])
        words = f"{len(missing)} {verb} of this series but could not be used: {names}; the scan may be incomplete"
        notes.append(Note("import.files-unread", words, badge=True))
    mine = [copy for h in slices for copy in copies.get(h.image_key, ())]
    if mine:
        names = name_files([(copy.path, "") for copy in mine])
        words = f"{len(mine)} slices have exact duplicates, which were ignored ({names})"
        notes.append(Note("import.copies", words))
    return notes


def _with_unused_files(error: VolumeImportError, missing: Sequence[UnusedFile]) -> VolumeImportError:
    """Return an import error whose message also names the files that could not be used, its likely cause."""
    if not missing:
        return error
    shown = ", ".join(f"{bounded_name(file.path.name)} ({file.reason})" for file in missing[:4])
    more = f" and {len(missing) - 4} more" if len(missing) > 4 else ""
    which = f"{len(missing)} files next to its slices look" if len(missing) > 1 else "one file next to its slices looks"
    copy = "copy them again" if len(missing) > 1 else "copy it again"
    msg = f"{error}; {which} like part of the series but could not be used: {shown}{more}; {copy}"
    return VolumeImportError(bounded_message(msg), code=error.code)


def describe_series(series: Sequence[SeriesInfo]) -> str:
    """Return a list of the first series: "series 2 (Thorax 1.0), CT, 300 slices; series 1 (scout), CT, 1 slice"."""
    named = [
        f"{_name(info)}, {info.modality or 'no modality'}, {info.num_slices} slice{'s' if info.num_slices != 1 else ''}"
        for info in series
    ]
    return bounded_list(named, at_most=_MAX_SERIES_NAMED)


def choose_series(found: Sequence[FoundSeries], *, key: str | None, where: str) -> tuple[FoundSeries, tuple[Note, ...]]:
    """Choose a series by its key, or else the largest chest CT, and return it with notes about the other series.

    If the largest series is refused, another CT replaces it only if it covers at least half of its height, and a note
    states the replacement.

    Parameters
    ----------
    found
        Series from :func:`find_series`, the best first.
    key
        Key of the series; None chooses the best.
    where
        Name of the folder for messages.

    Returns
    -------
    chosen, notes
        The chosen series and its notes.

    Raises
    ------
    UsageError
        ``usage.series``: no series has this key.
    VolumeImportError
        The refusal of the chosen series, with the names of the others.
    """
    if key is not None:
        chosen = next((item for item in found if item.info.key == key), None)
        if chosen is None:
            msg = f"{where} has no series {key!r}; it has {describe_series([item.info for item in found])}"
            raise UsageError(bounded_message(msg), code="usage.series")
        if chosen.refusal is not None:
            raise chosen.refusal
        return chosen, chosen.notes
    chosen = found[0]
    notes: list[Note] = []
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
            more = f"; {where} also contains {describe_series(others)}" if others else ""
            raise VolumeImportError(bounded_message(f"{refusal}{more}"), code=refusal.code)
        chosen = candidates[0]
        words = f"the largest series was refused ({refused.info.refused}); {chosen.name} was opened instead"
        notes.append(Note("import.series-replaced", bounded_message(words)))
    others = [item.info for item in found if item is not chosen]
    if others:
        words = (
            f"the folder contains several series; opened: {chosen.name}, {chosen.info.num_slices} slices"
            f"{_reason(chosen)}; not opened: {describe_series(others)}"
        )
        notes.append(Note("import.several-series", bounded_message(words)))
    return chosen, (*notes, *chosen.notes)


def open_series(series: FoundSeries, *, others: Sequence[SeriesInfo], notes: tuple[Note, ...], watch: Watch) -> Volume:
    """Read the pixels of one series into a volume.

    Parameters
    ----------
    series
        The series to read.
    others
        The other series of the folder, for :attr:`VolumeSource.other_series`.
    notes
        Notes from :func:`choose_series`.
    watch
        Progress and cancellation.

    Raises
    ------
    VolumeImportError
        If a slice is truncated or cannot be decoded; the message names the file.
    CancelledError
        If the user cancels; at most one slice is read after that.
    """
    stack = series.stack
    if stack is None:
        raise series.refusal or VolumeImportError(f"reading {series.name}: it has no voxel grid")
    first = series.slices[0]
    all_notes = list(notes)
    clipping = Clipping()
    padding = PaddingCount()
    doubts: list[tuple[SliceHeader, Doubt]] = []
    with second_decoder() as check:
        try:
            values = _read_slices(series, clipping, padding, doubts, watch, check=check)
        finally:
            release_pixel_data()
        for index, (header, problem) in enumerate(check.problems()):
            watch.step("Checking the compressed slices", index / len(check))
            if problem is not None:
                doubts.append((header, Doubt("import.pixels-damaged", f"the compressed data is corrupt: {problem}")))
    if values.min() == values.max():
        msg = f"reading {series.name}: every pixel has the same value, so it contains no image; export it again"
        raise VolumeImportError(msg, code="import.values")
    if clipping.count:
        all_notes.append(clipped_note(clipping.count))
    all_notes.extend(padding.notes(values.size))
    if (not_checked := not_checked_note(series.slices)) is not None:
        all_notes.append(not_checked)
    if any(header.lossy for header in series.slices):
        all_notes.append(
            Note("import.lossy", "the slices were compressed with loss; thin walls may be blurred", badge=True)
        )
    if first.modality == "CT" and stack.uneven is None:
        slice_mm = float(np.linalg.norm(stack.grid.lps_from_ijk[:3, 2]))
        at_level = dict(zip(stack.levels, stack.slices, strict=True))
        found = odd_slices(values, compressed=any(map(is_compressed, series.slices)), slice_mm=slice_mm)
        doubts.extend((at_level[level], _ODD) for level in found if level in at_level)
    in_doubt = doubt_notes(doubts, len(series.slices))
    verdict = judge_dicom(
        values,
        modality=first.modality,
        has_rescale=all(header.has_rescale for header in series.slices),
        rescale_type=next((h.rescale_type for h in series.slices if h.rescale_type not in HU_TYPES), ""),
        bits_stored=min(header.bits_stored for header in series.slices),
    )
    if not all(header.has_rescale for header in series.slices):
        all_notes.append(_no_rescale_note(first, is_hu=verdict.is_hu))
    all_notes.extend(in_doubt)
    lost = clipping.lost / values.size
    if verdict.is_hu and in_doubt:
        verdict = HuVerdict(False, in_doubt[0].words)
    elif verdict.is_hu and lost > MAX_DOUBTFUL_SHARE:
        verdict = HuVerdict(False, f"{100 * lost:.0f} % of its voxels lie outside -32768 to 32767 and were clipped")
    source = VolumeSource(
        format="dicom",
        title=series.info.description or f"{first.modality} series {series.info.key}",
        series=series.info,
        other_series=tuple(others),
        notes=tuple(all_notes),
        acquired_on=acquisition_date(first.path),
        slice_thickness_mm=_common_thickness_mm(series.slices),
        interpolated_slices=stack.missing,
        tilt_deg=None if stack.tilt is None else round(stack.tilt.tilt_deg, 2),
        slice_places=stack.places if stack.is_corrected else (),
    )
    watch.step("Reading the slices", 1.0)
    return Volume(values, stack.grid.lps_from_ijk, is_hu=verdict.is_hu, not_hu_reason=verdict.reason, source=source)


def _common_thickness_mm(slices: Sequence[SliceHeader]) -> float | None:
    """Return the thickness that all slices state, to 0.01 mm; None if they differ or some slices state none."""
    found = {None if header.thickness_mm is None else round(header.thickness_mm, 2) for header in slices}
    return found.pop() if len(found) == 1 else None


def _read_slices(
    series: FoundSeries,
    clipping: Clipping,
    padding: PaddingCount,
    doubts: list[tuple[SliceHeader, Doubt]],
    watch: Watch,
    *,
    check: SecondDecoder,
) -> NDArray[np.int16]:
    """Return the decoded slices on the grid of the stack; count clipped and padded voxels, and collect doubts."""
    stack = series.stack
    assert stack is not None
    values, read = read_plain_slices(stack, watch)
    check.submit([header for index, header in enumerate(stack.slices) if index not in read])
    before: tuple[SliceHeader, NDArray[Any]] | None = None
    planes: dict[int, NDArray[np.int16]] = {}
    for index, (header, level) in enumerate(zip(stack.slices, stack.levels, strict=True)):
        if index in read:
            continue
        watch.step("Reading the slices", index / len(stack.slices))
        pixels = decode_slice(header)
        numbers: NDArray[Any] = pixels.numbers
        doubts.extend((header, doubt) for doubt in pixels.doubts)
        if pixels.padded is not None:
            padding.add(pixels.padded)
        if header.modality_lut is None:
            refuse_contradicting_rescale(before, header, numbers, f"reading {series.name}")
        before = header, numbers
        # Allocated after the first slice, so that an unreadable one does not cost the memory of the volume.
        if values is None:
            values = np.empty(stack.grid.shape_zyx, dtype=np.int16)
        if numbers.dtype.kind == "f":
            numbers = np.rint(numbers)
        numbers = clipping.clip(header, numbers)
        if stack.tilt is not None:
            numbers = stack.tilt.correct(numbers.astype(np.int16), index)
        if stack.uneven is None:
            values[level] = numbers
        else:
            planes[index] = numbers.astype(np.int16)
            planes.pop(index - 4, None)
            if index >= 2:
                stack.uneven.fill(values, index - 2, planes)
                # Interpolated slices resemble their neighbours, so that the measured slices are compared.
                three = (planes[index - 2], planes[index - 1], planes[index])
                slice_mm = float(stack.uneven.gaps_mm[index - 2 : index].max())
                if header.modality == "CT" and is_odd(*three, compressed=is_compressed(header), slice_mm=slice_mm):
                    doubts.append((stack.slices[index - 1], _ODD))
    assert values is not None  # a grid has at least two slices
    if stack.uneven is not None:
        stack.uneven.fill(values, len(stack.slices) - 2, planes)
    if stack.tilt is not None:
        stack.tilt.fill_beyond(values, stack.sources, (stack.slices[0].rows, stack.slices[0].columns))
    if stack.uneven is None:
        for low, high in itertools.pairwise(stack.levels):
            fill_between(values, low, high)
    return values


def _no_rescale_note(first: SliceHeader, *, is_hu: bool) -> Note:
    lacking = [
        tag
        for tag, given in (("RescaleSlope", first.has_slope), ("RescaleIntercept", first.has_intercept))
        if not given
    ]
    if first.modality_lut is not None and len(lacking) == 2:
        unit = first.modality_lut.unit or "not stated"
        return Note("import.modality-lut", f"the values come from the Modality LUT of the slices (unit: {unit})")
    end = "but the values indicate HU" if is_hu else "so the values are not treated as HU"
    return Note("import.rescale-absent", f"no slice has {' or '.join(lacking)}, {end}", badge=True)
