"""Whether the numbers of a series fit together: its rescale tags, its slices beside each other, what had to be cut.

Tags alone do not tell: a slice whose intercept was lost, or rewritten as 0, lies 1024 HU off and looks like any other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.dicom_files import name_files
from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixels import Doubt
from carina.volume.message_limits import bounded_name
from carina.volume.model import Note

__all__ = ["Clipping", "check_rescale_tags", "doubt_notes", "odd_slices", "refuse_contradicting_rescale"]


def check_rescale_tags(slices: Sequence[SliceHeader], what: str) -> None:
    """Refuse a series in which some slices have a slope, an intercept or a Modality LUT and others do not.

    Raises
    ------
    VolumeImportError
        ``import.rescale-mixed``, naming the slices that lack what the others have.
    """
    for tag, given in (
        ("RescaleIntercept", [header.has_intercept for header in slices]),
        ("RescaleSlope", [header.has_slope for header in slices]),
        ("ModalityLUTSequence", [header.modality_lut is not None for header in slices]),
    ):
        if all(given) or not any(given):
            continue
        lacking = [header for header, has in zip(slices, given, strict=True) if not has]
        msg = (
            f"{what}: {len(lacking)} of its {len(slices)} slices have no {tag} ({_files(lacking)}), so their "
            "values would be on a different scale from those of the others; expected the tag in every slice; export "
            "the series again from its original archive, or omit these files if the other slices are complete"
        )
        raise VolumeImportError(msg, code="import.rescale-mixed")


def _files(slices: Sequence[SliceHeader]) -> str:
    """Names of files for a refusal, which a person at the screen reads: whole."""
    shown = ", ".join(sorted(bounded_name(header.path.name) for header in slices)[:6])
    return shown + (f" and {len(slices) - 6} more" if len(slices) > 6 else "")


def _some(numbers: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(numbers[::4, ::4], dtype=np.float64)


def refuse_contradicting_rescale(
    before: tuple[SliceHeader, NDArray[Any]] | None, header: SliceHeader, numbers: NDArray[Any], what: str
) -> None:
    """Refuse two neighbouring CT slices whose different rescale tears apart what their stored numbers join.

    Scanners and converters may give every slice its own slope and intercept; then the rescaled numbers fit together and
    the stored ones do not. Where it is the other way round, one of the tags is wrong.

    Raises
    ------
    VolumeImportError
        ``import.rescale-contradicts``, naming both slices.
    """
    if before is None or header.modality != "CT":
        return
    other, other_numbers = before
    if (other.slope, other.intercept) == (header.slope, header.intercept):
        return
    here, there = _some(numbers), _some(other_numbers)
    as_there = (here - header.intercept) / header.slope * other.slope + other.intercept
    apart, joined = (float(np.median(np.abs(values - there))) for values in (here, as_there))
    if apart > 100 and joined < 0.25 * apart:
        msg = (
            f"{what}: the rescale tags of neighbouring slices contradict their pixels: {other.path.name} has slope "
            f"{other.slope:g} and intercept {other.intercept:g}, {header.path.name} has slope {header.slope:g} and "
            f"intercept {header.intercept:g}, and rescaled with these tags their pixels differ by {apart:.0f} HU (by "
            f"{joined:.0f} HU if both have the tags of one); expected the scanner's rescale tags in every slice; "
            "export the series again from its original archive"
        )
        raise VolumeImportError(msg, code="import.rescale-contradicts")


class Clipping:
    """Counts what does not fit into int16, slice by slice; padding outside the reconstructed circle is no loss."""

    def __init__(self) -> None:
        self.count = 0
        """Voxels set to the nearest number of int16."""
        self.lost = 0
        """Those that were no padding."""
        self._padding: set[float] = set()

    def take(self, header: SliceHeader, numbers: NDArray[Any]) -> NDArray[Any]:
        """Return the numbers cut to int16, and count the cut ones."""
        low, high = float(numbers.min()), float(numbers.max())
        if low >= -32768 and high <= 32767:
            return numbers
        outside = numbers[(numbers < -32768) | (numbers > 32767)]
        self.count += outside.size
        for padding in header.padding:
            ends = sorted(number * header.slope + header.intercept for number in padding)
            outside = outside[(outside < ends[0]) | (outside > ends[1])]
        below = outside[outside < -32768]
        # Without a tag, one single value far below air is padding too; it is the same in all slices.
        if below.size and below.min() == below.max():
            self._padding.add(float(below[0]))
            if len(self._padding) == 1:
                outside = outside[outside > 32767]
        self.lost += outside.size
        return np.asarray(np.clip(numbers, -32768, 32767))


def odd_slices(values: NDArray[np.int16], *, compressed: bool, slice_mm: float) -> list[int]:
    """Slices that differ from both neighbours far more than these differ from each other.

    Anatomy changes on its way through the body, so both neighbours of a slice differ at least about as much as the
    slice from one of them; noise adds the same everywhere. On the shared CTs, thin and thick, the difference of the
    differences stays below 0 HU over whole slices and below 15 HU in parts of a sixteenth of their width; a slice on
    another scale or of damaged pixels reaches hundreds.

    Parameters
    ----------
    values
        [z, y, x] HU.
    compressed
        Look at parts of a slice, too: a damaged stream often spoils one place alone.
    slice_mm
        From slice to slice. The farther they lie apart, the more a healthy part of one slice may show alone: a rib, a
        vessel that runs in its plane, a nodule. Every second slice of the shared CTs (6 mm) reaches 185 HU, every
        third (9 mm) 409.
    """
    if len(values) < 3:
        return []
    whole = [_fits_worst(*neighbours, tile=None) for neighbours in zip(values, values[1:], values[2:], strict=False)]
    found = {at + 1 for at, excess in enumerate(whole) if excess > 20}
    if compressed:
        tile = max(8, values.shape[1] // 16)
        most = 100.0 * max(slice_mm / 2.0, 1.0) ** 1.5
        parts = [
            _fits_worst(*neighbours, tile=tile) for neighbours in zip(values, values[1:], values[2:], strict=False)
        ]
        found |= {at + 1 for at, excess in enumerate(parts) if excess > most}
    return sorted(found)


def _fits_worst(below: NDArray[Any], middle: NDArray[Any], above: NDArray[Any], *, tile: int | None) -> float:
    """How much more the middle differs from the nearer of its neighbours than it may, HU, where that is worst."""
    step = 4 if tile is None else 1
    three = [np.clip(part[::step, ::step], -1200, 1500).astype(np.int32) for part in (below, middle, above)]

    def apart(one: int, other: int) -> NDArray[np.float64]:
        difference = np.abs(three[one] - three[other])
        if tile is None:
            return np.array([difference.mean()])
        high, wide = (side // tile for side in difference.shape)
        tiles = difference[: high * tile, : wide * tile].reshape(high, tile, wide, tile)
        return np.asarray(tiles.mean(axis=(1, 3)))

    allowed = 2.0 if tile is None else 2.5
    return float((np.minimum(apart(0, 1), apart(1, 2)) - allowed * apart(0, 2)).max(initial=-np.inf))


def doubt_notes(doubts: Sequence[tuple[SliceHeader, Doubt]], num_slices: int) -> list[Note]:
    """One lasting note for each kind of doubt, with the number of its slices and the first few by name."""
    notes = []
    for code, _ in Counter(doubt.code for _, doubt in doubts).most_common():
        mine = [(header, doubt) for header, doubt in doubts if doubt.code == code]
        words = Counter(doubt.words for _, doubt in mine).most_common(1)[0][0]
        files = name_files([(path, "") for path in dict.fromkeys(header.path for header, _ in mine)])
        count = len({header.path for header, _ in mine})
        notes.append(
            Note(code, f"{words} ({count} of {num_slices} slices: {files}); the values there may be wrong", badge=True)
        )
    return notes
