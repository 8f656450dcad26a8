"""Rules that decide which images form one series.

SeriesInstanceUID alone is not sufficient. Exporters and anonymisers omit it or give one UID to several scans; two scans
would then be stacked or interleaved into one volume with a finer slice spacing than that of each scan.

- Two values of an *identity* (patient, study, frame of reference, modality) or of the grid (size and spacing of pixels,
  orientation) always divide a series. If some images lack a value and all others
  have the same value, the series is not divided, and a note states it.
- A series with more than half as many frames of reference as slices stays undivided, with a note: anonymisers often
  give each slice a new ``FrameOfReferenceUID``. The grid of the series is checked like any other.
- Two values of a *setting* (kernel, acquisition, phase, contrast, ...) divide a series only if the parts share
  positions or are interleaved. A chest scanned in several breaths changes its acquisition number within the stack and
  stays one series, with a note.
- Two *stacks* of an enhanced file (StackID) divide a series unless they form one regular stack together.
- Frames of several enhanced files that share positions and do not differ in any setting are divided by file. The files
  of one concatenation count as one.
- Of byte-identical files only one counts.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carina.errors import VolumeImportError
from carina.volume.dicom_files import name_files
from carina.volume.dicom_geometry import MAX_CORNER_SHIFT_MM, grid_from_slices
from carina.volume.dicom_headers import IDENTITY, SETTINGS, SliceHeader
from carina.volume.model import Note
from carina.volume.progress import Watch

_MAX_GRIDS = 50
"""Maximum number of grids in one series; bounds the time for a folder of images that are all different."""

_MAX_PAIRS = 10_000
"""Maximum number of pairs of series (one with a UID, one without) that are compared."""

_FEWEST_FRAMES = 3
"""Minimum number of frames of reference of a series that is not divided by them: two are two scans."""

_PATIENT = [index for index, word in enumerate(IDENTITY.values()) if word == "patients"]


@dataclass(frozen=True, slots=True)
class Group:
    """Images that form one series, unsorted."""

    slices: tuple[SliceHeader, ...]
    notes: tuple[Note, ...] = ()
    label: str = ""
    """Difference from the other parts of the series, such as "kernel b70f" or "part 2", without names or UIDs."""
    mixed_with: tuple[SliceHeader, ...] = ()
    """All images of the series from which this one was separated because of its pixel grid."""


def without_copies(
    headers: Sequence[SliceHeader], watch: Watch
) -> tuple[list[SliceHeader], dict[Hashable, list[SliceHeader]]]:
    """Return the images without byte-identical copies, and the copies by identifier, series and position.

    Two files with one identifier and different content both stay, because it is unknown which is right.
    """
    alike: dict[Hashable, list[SliceHeader]] = {}
    for header in headers:
        alike.setdefault(header.image_key, []).append(header)
    if len(alike) == len(headers):
        return list(headers), {}
    copies: dict[Hashable, list[SliceHeader]] = {}
    digests: dict[Path, bytes] = {}  # all frames of a file have one digest
    for key, twins in alike.items():
        seen: set[bytes] = set()
        for header in twins if len(twins) > 1 else ():
            watch.step("Comparing duplicate files")
            digest = digests[header.path] = digests.get(header.path) or _digest(header)
            if digest in seen:
                copies.setdefault(key, []).append(header)
            seen.add(digest)
    gone = {header.path for twins in copies.values() for header in twins}
    return [header for header in headers if header.path not in gone], copies


def _digest(header: SliceHeader) -> bytes:
    try:
        with header.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError:
        return str(header.path).encode()  # differs from every other digest


def count_patients(headers: Sequence[SliceHeader]) -> int:
    """Return the number of patients according to the tags; missing tags are ignored."""
    return max([1] + [len({header.identity[at] for header in headers} - {""}) for at in _PATIENT])


def group_slices(headers: Sequence[SliceHeader]) -> list[Group]:
    """Divide images into series by the rules of this module."""
    by_uid: dict[Hashable, list[SliceHeader]] = {}
    for header in headers:
        # Without a UID, the series number is used instead.
        uid = header.series_uid or f"number {header.series_number}"
        by_uid.setdefault((uid, _kind(header)), []).append(header)
    groups: list[Group] = []
    for slices in by_uid.values():
        groups.extend(_part_by_identity(Group(tuple(slices))))
    return [part for group in _join_slices_without_series(groups) for part in _part_by_setting(group)]


def _kind(header: SliceHeader) -> str:
    if header.localizer:
        return "scout"
    return "no slice" if header.problem_code in ("import.not-a-scan", "import.multi-frame") else ""


def _by_value(slices: Sequence[SliceHeader], values: Sequence[str]) -> dict[str, list[SliceHeader]]:
    parts: dict[str, list[SliceHeader]] = {}
    for header, value in zip(slices, values, strict=True):
        parts.setdefault(value, []).append(header)
    return parts


def _part_by_identity(group: Group) -> list[Group]:
    whole = [group]
    for at, word in enumerate(IDENTITY.values()):
        whole = [
            part
            for item in whole
            for part in _part_by_value(item, word, _by_value(item.slices, [h.identity[at] for h in item.slices]))
        ]
    return [part for item in whole for part in _part_by_grid(item)]


def _part_by_value(group: Group, word: str, parts: dict[str, list[SliceHeader]]) -> list[Group]:
    """Divide a group by the values of one identity tag, or add a note that states why it is not divided."""
    if word == "frames of reference" and _is_frame_per_slice(group.slices, parts):
        note = Note(
            "import.frame-per-slice",
            f"the {len(group.slices)} slices of the series name {len(parts.keys() - {''})} frames of reference, where "
            "one is expected; the slices form one regular stack by their positions, so they were opened as one series",
        )
        return [_with_note(group, note)]
    nameless = parts.pop("", [])
    if len(parts) <= 1:
        if not nameless or not parts:
            return [group]
        note = Note(
            "import.identity-missing",
            f"{len(nameless)} of {len(group.slices)} slices do not state their {_singular(word)} "
            f"({name_files([(h.path, '') for h in nameless])}); they were grouped with the others",
            badge=word == "patients",
        )
        return [_with_note(group, note)]
    note = Note(
        "import.series-parted",
        (f"one series contained images of {len(parts)} {word}; they are now listed as separate series"),
    )
    found = [
        replace(
            group,
            slices=tuple(slices),
            notes=(*group.notes, note),
            label=_with_label(group, f"{_singular(word)} {number}"),
        )
        for number, slices in enumerate(parts.values(), 1)
    ]
    if nameless:
        lost = Note(
            "import.identity-missing",
            f"{len(nameless)} images of the original series do not state their {_singular(word)} "
            f"({name_files([(h.path, '') for h in nameless])}); they were left out",
            badge=True,
        )
        found = [replace(part, notes=(*part.notes, lost)) for part in found]
        found.append(replace(group, slices=tuple(nameless), label=_with_label(group, f"unknown {_singular(word)}")))
    return found


def _is_frame_per_slice(slices: Sequence[SliceHeader], parts: Mapping[str, Sequence[SliceHeader]]) -> bool:
    """Return whether the slices of one series have different frames of reference instead of a common one."""
    count = len(parts.keys() - {""})
    return count >= _FEWEST_FRAMES and 2 * count > len(slices) and all(header.series_uid for header in slices)


def _singular(word: str) -> str:
    return {"studies": "study", "modalities": "modality", "frames of reference": "frame of reference"}.get(
        word, word.removesuffix("s")
    )


def _with_label(group: Group, words: str) -> str:
    return f"{group.label}, {words}" if group.label else words


def _same_grid(one: SliceHeader, other: SliceHeader) -> bool:
    if (one.rows, one.columns) != (other.rows, other.columns):
        return False
    extent_mm = math.hypot(one.columns * one.spacing_mm[0], one.rows * one.spacing_mm[1])
    turn = max(math.dist(one.row_lps, other.row_lps), math.dist(one.column_lps, other.column_lps))
    stretch_mm = max(
        abs(one.spacing_mm[0] - other.spacing_mm[0]) * one.columns,
        abs(one.spacing_mm[1] - other.spacing_mm[1]) * one.rows,
    )
    return max(turn * extent_mm, stretch_mm) <= MAX_CORNER_SHIFT_MM


def _part_by_grid(group: Group) -> list[Group]:
    """Divide a group by the pixel grids of its images."""
    parts: list[list[SliceHeader]] = []
    broken = [header for header in group.slices if header.problem is not None]
    for header in group.slices:
        if header.problem is not None:
            continue
        part = next((part for part in parts if _same_grid(part[0], header)), None)
        if part is None and len(parts) < _MAX_GRIDS:
            parts.append([header])
        else:
            # With too many grids, the last part contains several, and its grid check refuses it.
            (part or parts[-1]).append(header)
    if len(parts) <= 1:
        return [group]
    parts.sort(key=len, reverse=True)
    parts[0].extend(broken)
    note = Note(
        "import.series-parted",
        f"one series contained images on {len(parts)} grids (size, pixel spacing or orientation); they are now listed "
        "as separate series",
    )
    return [
        replace(
            group,
            slices=tuple(part),
            notes=(*group.notes, note),
            label=_with_label(group, f"{part[0].columns} x {part[0].rows} pixels, part {number}"),
            mixed_with=group.slices,
        )
        for number, part in enumerate(parts, 1)
    ]


def _is_regular(slices: Sequence[SliceHeader]) -> bool:
    if any(header.problem is not None for header in slices):
        return False
    try:
        grid_from_slices(slices, what="", fills_gaps=False)
    except VolumeImportError:
        return False
    return True


def _join_slices_without_series(groups: list[Group]) -> list[Group]:
    """Add slices without SeriesInstanceUID to the one series that they complete without a gap."""
    named = [group for group in groups if group.slices[0].series_uid]
    nameless = [group for group in groups if not group.slices[0].series_uid]
    if len(named) * len(nameless) > _MAX_PAIRS:
        return groups
    for lost in nameless:
        fitting = [group for group in named if _may_be_one(group, lost) and _is_regular((*group.slices, *lost.slices))]
        if len(fitting) != 1:
            named.append(lost)
            continue
        note = Note(
            "import.identity-missing",
            f"{len(lost.slices)} slices do not state which series they belong to "
            f"({name_files([(h.path, '') for h in lost.slices])}); they continue this series and were added to it",
        )
        at = named.index(fitting[0])
        named[at] = replace(
            fitting[0], slices=(*fitting[0].slices, *lost.slices), notes=(*fitting[0].notes, note, *lost.notes)
        )
    return named


def _may_be_one(group: Group, other: Group) -> bool:
    one, two = group.slices[0], other.slices[0]
    if _kind(one) or _kind(two) or not _same_grid(one, two):
        return False
    numbers = {one.series_number, two.series_number} - {None}
    return len(numbers) <= 1 and all(not a or not b or a == b for a, b in zip(one.identity, two.identity, strict=True))


def _part_by_setting(group: Group) -> list[Group]:
    """Divide a group by a setting whose values form stacks that share heights or are interleaved."""
    if _kind(group.slices[0]) or len(group.slices) < 2 or any(h.problem is not None for h in group.slices):
        return [group]
    keys = [
        (word, parts)
        for at, word in enumerate(SETTINGS.values())
        if len(parts := _by_value(group.slices, [h.settings[at] for h in group.slices])) > 1
    ]
    by_file = _by_file(group.slices)
    if not keys and len(by_file) < 2:
        return [group]
    # A setting with a different value in nearly every slice (a time, a counter) does not define stacks.
    telling = [(word, parts) for word, parts in keys if 2 * len(parts) <= len(group.slices)]
    is_regular = _is_regular(group.slices)
    if is_regular:
        # In a regular stack, slices without the tag do not form a second scan.
        telling = [(word, parts) for word, parts in telling if "" not in parts or len(parts) > 2]
        telling = [(word, parts) for word, parts in telling if _are_combs(group.slices, list(parts.values()))]
    else:
        telling = [
            (word, parts)
            for word, parts in telling
            if _share_heights(list(parts.values())) or (word == "stack" and min(map(len, parts.values())) > 1)
        ]
    if not telling and not is_regular and len(by_file) > 1 and _share_heights(list(by_file.values())):
        telling = [("file", by_file)]
    if not telling:
        return [_with_notes_on_settings(group, keys)]
    # The setting with the fewest values is used: two kernels in three acquisitions are two series, not three.
    word, parts = min(telling, key=lambda item: len(item[1]))
    note = Note(
        "import.series-parted",
        f"one series contained {len(parts)} stacks that differ in {word}; they are now listed as separate series",
    )
    whole_mm = float(np.ptp(_heights(group.slices)))
    found: list[Group] = []
    for value, slices in parts.items():
        part = _with_note(
            replace(group, slices=tuple(slices), label=_with_label(group, f"{word} {_setting_text(value)}")), note
        )
        stack_mm = float(np.ptp(_heights(slices)))
        if stack_mm < 0.9 * whole_mm:
            covered = f"this stack covers {stack_mm:.0f} of the {whole_mm:.0f} mm of its series"
            words = f"{covered}; the rest is listed separately"
            part = _with_note(part, Note("import.part-of-stack", words, badge=True))
        found.extend(_part_by_setting(part))
    return found


def _by_file(slices: Sequence[SliceHeader]) -> dict[str, list[SliceHeader]]:
    """Return the frames of enhanced files by their file, or by their concatenation of files, numbered by name."""
    names = {header.image_uid: str(header.path) for header in reversed(slices) if header.image_uid}
    numbers = {uid: str(number) for number, uid in enumerate(sorted(names, key=lambda uid: names[uid]), 1)}
    return _by_value(slices, [numbers.get(header.image_uid, "") for header in slices])


def _with_note(group: Group, note: Note) -> Group:
    return group if note in group.notes else replace(group, notes=(*group.notes, note))


def _setting_text(value: str) -> str:
    return "".join(c for c in value if c.isprintable())[:32] or "not given"


def _with_notes_on_settings(group: Group, keys: Sequence[tuple[str, dict[str, list[SliceHeader]]]]) -> Group:
    """Add notes on settings that change or are missing within a group."""
    # The acquisition time can separate two interleaved scans, but its change within one scan needs no note.
    keys = [(word, parts) for word, parts in keys if word != "acquisition time"]
    changes = [word for word, parts in keys if len(parts.keys() - {""}) > 1]
    missing = [word for word, parts in keys if "" in parts]
    notes = list(group.notes)
    if changes:
        words = (
            f"the {_joined_words(changes)} {'changes' if len(changes) == 1 else 'change'} within the series, which was "
            "read as one stack"
        )
        notes.append(Note("import.settings-change", words))
    if missing:
        notes.append(Note("import.settings-missing", f"some slices do not state their {_joined_words(missing)}"))
    return replace(group, notes=tuple(notes))


def _joined_words(words: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _heights(slices: Sequence[SliceHeader]) -> np.ndarray:
    normal = np.cross(slices[0].row_lps, slices[0].column_lps)
    return np.sort(np.array([header.position_lps for header in slices]) @ normal)


def _share_heights(parts: Sequence[Sequence[SliceHeader]]) -> bool:
    """Return whether the ranges of the slice positions of two parts overlap."""
    spans = sorted((float(h[0]), float(h[-1])) for h in map(_heights, parts))
    # Two slices at one position in two parts count as an overlap of the parts, too.
    return any(later[0] <= earlier[1] + 0.01 for earlier, later in itertools.pairwise(spans))


def _are_combs(whole: Sequence[SliceHeader], parts: Sequence[Sequence[SliceHeader]]) -> bool:
    """Return whether each part of a regular stack is regular by itself, and the parts interleave.

    Two interleaved scans have this pattern; a block within the stack, a single slice or two outer slices do not.
    """
    heights = _heights(whole)
    step = float(heights[-1] - heights[0]) / (len(heights) - 1)
    combs = 0
    for part in parts:
        if len(part) < 2:
            continue
        own = np.diff(_heights(part)) / step
        even = float(own.max() - own.min()) < 0.5
        combs += even and 1.5 < float(own.mean()) < len(parts) + 0.5
    return combs >= 2
