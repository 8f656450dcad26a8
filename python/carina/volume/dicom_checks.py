"""Consistency checks of a series' values: rescale tags, differences between neighbouring slices, clipped values.

Tags alone are not sufficient: a slice whose intercept was lost, or rewritten as 0, is wrong by 1024 HU and otherwise
looks normal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import VolumeImportError
from carina.volume.dicom_files import name_files
from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixels import Doubt
from carina.volume.message_limits import bounded_name
from carina.volume.model import Note


def check_rescale_tags(slices: Sequence[SliceHeader], what: str) -> None:
    """Raise an error if only some slices of a series have a slope, an intercept or a Modality LUT.

    Parameters
    ----------
    slices
        All slices of the series.
    what
        Beginning of the message.

    Raises
    ------
    VolumeImportError
        ``import.rescale-mixed``, with the names of the slices that lack the tag.
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
            f"{what}: {len(lacking)} of its {len(slices)} slices have no {tag} ({_file_names(lacking)}), so their "
            "values would be on a different scale from those of the others; expected the tag in every slice; export "
            "the series again from its original archive, or omit these files if the other slices are complete"
        )
        raise VolumeImportError(msg, code="import.rescale-mixed")


def _file_names(slices: Sequence[SliceHeader]) -> str:
    """Return the complete file names of slices as one text for an error message."""
    shown = ", ".join(sorted(bounded_name(header.file_name) for header in slices)[:6])
    return shown + (f" and {len(slices) - 6} more" if len(slices) > 6 else "")


def _every_fourth(numbers: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(numbers[::4, ::4], dtype=np.float64)


def refuse_contradicting_rescale(
    before: tuple[SliceHeader, NDArray[Any]] | None, header: SliceHeader, numbers: NDArray[Any], what: str
) -> None:
    """Raise an error if the rescale tags of two neighbouring CT slices contradict their pixels.

    Scanners and converters may give every slice its own slope and intercept; then the rescaled values of neighbours are
    similar and the stored values are not. If instead the stored values are similar and the rescaled ones are not, one
    of the tags is wrong.

    Parameters
    ----------
    before
        Header and rescaled values of the preceding slice; None for the first slice.
    header, numbers
        Header and rescaled values of the slice.
    what
        Beginning of the message.

    Raises
    ------
    VolumeImportError
        ``import.rescale-contradicts``, with the names of both slices.
    """
    if before is None or header.modality != "CT":
        return
    other, other_numbers = before
    if (other.slope, other.intercept) == (header.slope, header.intercept):
        return
    here, there = _every_fourth(numbers), _every_fourth(other_numbers)
    as_there = (here - header.intercept) / header.slope * other.slope + other.intercept
    differences, joined = (float(np.median(np.abs(values - there))) for values in (here, as_there))
    if differences > 100 and joined < 0.25 * differences:
        msg = (
            f"{what}: the rescale tags of neighbouring slices contradict their pixels: {other.file_name} has slope "
            f"{other.slope:g} and intercept {other.intercept:g}, {header.file_name} has slope {header.slope:g} and "
            f"intercept {header.intercept:g}, and rescaled with these tags their pixels differ by {differences:.0f} HU "
            f"(by {joined:.0f} HU if both have the tags of one); expected the scanner's rescale tags in every slice; "
            "export the series again from its original archive"
        )
        raise VolumeImportError(msg, code="import.rescale-contradicts")


class Clipping:
    """Counter of values outside int16; padding outside the reconstructed circle does not count as a loss."""

    def __init__(self) -> None:
        self.count = 0
        """Number of voxels whose value did not fit into int16 and was set to the nearest int16 value."""
        self.lost = 0
        """Number of clipped voxels that were not padding."""
        self._padding: set[float] = set()

    def clip(self, header: SliceHeader, numbers: NDArray[Any]) -> NDArray[Any]:
        """Return the numbers of a slice clipped to int16, and count the clipped ones."""
        low, high = float(numbers.min()), float(numbers.max())
        if low >= -32768 and high <= 32767:
            return numbers
        outside = numbers[(numbers < -32768) | (numbers > 32767)]
        self.count += outside.size
        for padding in header.padding:
            ends = sorted(number * header.slope + header.intercept for number in padding)
            outside = outside[(outside < ends[0]) | (outside > ends[1])]
        below = outside[outside < -32768]
        # Without a tag, one single value far below air is padding too, if it is the same in all slices.
        if below.size and below.min() == below.max():
            self._padding.add(float(below[0]))
            if len(self._padding) == 1:
                outside = outside[outside > 32767]
        self.lost += outside.size
        return np.asarray(np.clip(numbers, -32768, 32767))


def odd_slices(values: NDArray[np.int16], *, compressed: bool, slice_mm: float) -> list[int]:
    """Return the indices of slices that differ from both neighbours far more than these differ from each other.

    Anatomy changes gradually along the body, so the two neighbours of a slice differ from each other at least about as
    much as the slice differs from one of them; noise adds the same to all differences. In the shared CTs, thin and
    thick, the excess stays below 0 HU for whole slices and below 15 HU in parts of a sixteenth of their width; for a
    slice with another scale or damaged pixels it reaches hundreds of HU.

    Parameters
    ----------
    values
        (nz, ny, nx) HU.
    compressed
        Also compare parts of a slice, because a damaged stream often changes one place only.
    slice_mm
        Distance of the slices in mm. With a larger distance, structures that appear in one slice only (a rib, a vessel
        in its plane, a nodule) cause a larger excess: every second slice of the shared CTs (6 mm) reaches 185 HU, every
        third (9 mm) 409 HU.

    Returns
    -------
    list of int
        Indices of the slices, ascending.
    """
    whole = _core.slice_excesses(values, tile=None, step=_STEP, allowed=_ALLOWED)
    odd = {at + 1 for at, excess in enumerate(whole) if excess > _MOST_OF_SLICE}
    if compressed:
        tiled = _core.slice_excesses(values, tile=_tile(values.shape[1]), step=1, allowed=_ALLOWED_OF_TILE)
        odd |= {at + 1 for at, excess in enumerate(tiled) if excess > _most_of_tile(slice_mm)}
    return sorted(odd)


_STEP = 4  # every fourth pixel along both axes is compared in whole slices
_ALLOWED, _ALLOWED_OF_TILE = 2.0, 2.5  # multiples of the neighbours' difference
_MOST_OF_SLICE = 20.0  # HU


def _tile(rows: int) -> int:
    return max(8, rows // 16)


def _most_of_tile(slice_mm: float) -> float:
    """Return the largest excess in HU of a tile of an undamaged slice."""
    scale: float = max(slice_mm / 2.0, 1.0) ** 1.5
    return 100.0 * scale


def is_odd(
    below: NDArray[Any], middle: NDArray[Any], above: NDArray[Any], *, compressed: bool, slice_mm: float
) -> bool:
    """Return whether a slice differs from both neighbours far more than these differ from each other.

    Parameters
    ----------
    below, middle, above
        (ny, nx) HU of three slices.
    compressed, slice_mm
        As for :func:`odd_slices`.
    """
    if _fits_worst(below, middle, above, tile=None) > _MOST_OF_SLICE:
        return True
    return compressed and _fits_worst(below, middle, above, tile=_tile(middle.shape[0])) > _most_of_tile(slice_mm)


def _fits_worst(below: NDArray[Any], middle: NDArray[Any], above: NDArray[Any], *, tile: int | None) -> float:
    """Return the largest excess in HU of the middle slice over what its two neighbours explain.

    The excess is the difference from the nearer neighbour minus a multiple of the neighbours' difference. With
    ``tile``, differences are means over square tiles of this side, otherwise over the whole slice.
    """
    step = _STEP if tile is None else 1
    three = [np.clip(part[::step, ::step], -1200, 1500).astype(np.int32) for part in (below, middle, above)]

    def differences(one: int, other: int) -> NDArray[np.float64]:
        difference = np.abs(three[one] - three[other])
        if tile is None:
            return np.array([difference.mean()])
        high, wide = (side // tile for side in difference.shape)
        tiles = difference[: high * tile, : wide * tile].reshape(high, tile, wide, tile)
        return np.asarray(tiles.mean(axis=(1, 3)))

    allowed = _ALLOWED if tile is None else _ALLOWED_OF_TILE
    return float((np.minimum(differences(0, 1), differences(1, 2)) - allowed * differences(0, 2)).max(initial=-np.inf))


def doubt_notes(doubts: Sequence[tuple[SliceHeader, Doubt]], num_slices: int) -> list[Note]:
    """Return one permanent note for each kind of doubt, with the number of its slices and some file names."""
    notes = []
    for code, _ in Counter(doubt.code for _, doubt in doubts).most_common():
        mine = [(header, doubt) for header, doubt in doubts if doubt.code == code]
        words = Counter(doubt.words for _, doubt in mine).most_common(1)[0][0]
        files = name_files([(path, "") for path in dict.fromkeys(header.path for header, _ in mine)])
        count = len({(header.path, header.frame) for header, _ in mine})
        notes.append(
            Note(code, f"{words} ({count} of {num_slices} slices: {files}); the values there may be wrong", badge=True)
        )
    return notes
