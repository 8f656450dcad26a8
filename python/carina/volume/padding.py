"""Padding of CT images: pixels outside the reconstructed image, whose values have no meaning (PS3.3 C.7.5.1.1.2).

``PixelPaddingValue``, and with ``PixelPaddingRangeLimit`` a range of values, mark these pixels. The rescale can convert
the mark to any number: 63536 becomes 62512 HU. The rules, in this order:

1. A mark at or below -1000 HU, or at or below every other value of the slice, keeps its value, because it cannot be
confused with tissue.
2. A mark above 30,710 HU (the end of the extended CT scale) is not a value of tissue, so every such pixel is padding.
3. Any other mark is also a possible value of tissue or metal. Only connected regions of the mark that touch the edge
of the slice are padding; pixels within the image keep their values.
4. Without a mark, a value of 2000 HU or more in all four corners of a slice is padding, and so is a value above 30,710
HU in any corner, because no anatomy has this pattern. A note states that the file does not declare this padding.
Files without padding tags (NIfTI, NRRD, MetaImage) follow this rule with the eight corners of the volume.

Padding is set to the lowest other value of its slice, but not below -1024 HU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.volume.mask_parts import numbered_parts
from carina.volume.model import Note

AIR_HU = -1024
"""Minimum value in HU that replaces padding: the lowest number of 12-bit CTs."""
_HARMLESS_HU = -1000
_NO_TISSUE_HU = 30_710
_CORNER_HU = 2000
_TISSUE_HU = (-1000, 2000)
# Noise causes regions of a few equal pixels at the edge; padding fills corners.
_FEWEST_PIXELS = 16
_SMALLEST_SHARE = 1 / 2000
_SMALLEST_UNMARKED_SHARE = 0.01

PaddingRange = tuple[int, int]
"""Lowest and highest stored number that marks padding."""


@dataclass(frozen=True, slots=True, eq=False)
class PaddedPixels:
    """The padding of one slice."""

    inside: NDArray[np.bool_]
    """(rows, columns); true for pixels that are padding."""
    fill: float
    """Value in HU that replaces the padding of the slice."""
    value: float
    """Most frequent value, after rescaling, of the pixels that are padding."""
    num_unchanged: int
    """Number of pixels inside the image that have a padding value and are not changed."""
    is_marked: bool
    """Whether the file states which value is padding."""


def padding_ranges(
    value: int, limit: int | None, *, bits_allocated: int, bits_stored: int, high_bit: int, signed: bool
) -> tuple[PaddingRange, ...]:
    """Return the ranges of stored numbers that the padding tags mark.

    Writers confuse signed and unsigned forms of the tags (US and SS), so the bits of the tags decide, read in the form
    of the pixels. If the pixels use fewer bits than the tag, the used bits of the tag count too.

    Parameters
    ----------
    value, limit
        Values of PixelPaddingValue and PixelPaddingRangeLimit; ``limit`` is None without that tag.
    bits_allocated, bits_stored, high_bit, signed
        Format of the stored numbers.
    """

    def read(number: int, bits: int) -> int:
        number &= (1 << bits) - 1
        return number - (1 << bits) if signed and number >> (bits - 1) else number

    ends = [value] if limit is None else [value, limit]
    whole = sorted(read(number, bits_allocated) for number in ends)
    found = [(whole[0], whole[-1])]
    used = sorted(read(number, bits_stored) for number in ends)
    if high_bit == bits_stored - 1 and used[-1] - used[0] == whole[-1] - whole[0]:
        found.append((used[0], used[-1]))
    return tuple(dict.fromkeys(found))


def find_padding(
    stored: NDArray[np.int32], numbers: NDArray[np.float64] | NDArray[np.int32], ranges: Sequence[PaddingRange]
) -> PaddedPixels | None:
    """Find the padding of a CT slice that would look like tissue or metal.

    Parameters
    ----------
    stored
        (rows, columns) stored numbers.
    numbers
        The same pixels after the rescale, HU.
    ranges
        Stored numbers that mark padding, from ``padding_ranges``; empty if the file has no padding tag.

    Returns
    -------
    PaddedPixels | None
        None if the slice has no such padding.
    """
    marked = np.zeros(stored.shape, dtype=np.bool_)
    for low, high in ranges:
        marked |= (stored >= low) & (stored <= high)
    is_marked = bool(marked.any())
    smallest = max(_FEWEST_PIXELS, int(_SMALLEST_SHARE * stored.size))
    if not is_marked:
        marked = _untagged_padding(stored, numbers)
        smallest = max(_FEWEST_PIXELS, int(_SMALLEST_UNMARKED_SHARE * stored.size))
        if not marked.any():
            return None
    others = numbers[~marked]
    lowest = float(others.min()) if others.size else float(AIR_HU)
    marked &= numbers > max(_HARMLESS_HU, lowest)
    if not marked.any():
        return None
    impossible = marked & (numbers > _NO_TISSUE_HU)
    inside = _edge_regions(marked & ~impossible, smallest)
    inside |= impossible if is_marked else _edge_regions(impossible, smallest)
    if not inside.any():
        return None
    values, counts = np.unique(numbers[inside], return_counts=True)
    return PaddedPixels(
        inside,
        max(float(AIR_HU), lowest),
        float(values[counts.argmax()]),
        int(np.count_nonzero(marked & ~inside)),
        is_marked,
    )


def _untagged_padding(stored: NDArray[np.int32], numbers: NDArray[np.float64] | NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the pixels with the value of the corners, if no anatomy can have this value."""
    corners = stored[[0, 0, -1, -1], [0, -1, 0, -1]]
    heights = numbers[[0, 0, -1, -1], [0, -1, 0, -1]]
    if corners.min() == corners.max() and heights[0] >= _CORNER_HU:
        return np.asarray(stored == corners[0])
    impossible = corners[heights > _NO_TISSUE_HU]
    if not impossible.size:  # true for nearly every slice
        return np.zeros(stored.shape, dtype=np.bool_)
    return np.asarray(np.isin(stored, impossible))


def _edge_regions(pixels: NDArray[np.bool_], smallest: int) -> NDArray[np.bool_]:
    """Return the connected regions of at least ``smallest`` pixels that touch the edge of the slice."""
    if not pixels.any():
        return pixels
    labels = numbered_parts(pixels)
    at_edge = np.zeros(int(labels.max()) + 1, dtype=np.bool_)
    for line in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        at_edge[np.unique(line)] = True
    taken = at_edge & (np.bincount(labels.reshape(-1)) >= smallest)
    taken[0] = False
    return np.asarray(taken[labels])


def without_corner_padding(hu: NDArray[np.int16]) -> tuple[NDArray[np.int16], tuple[Note, ...]]:
    """Set the padding of a volume without padding tags to air, by rule 4 of this module.

    Parameters
    ----------
    hu
        (nz, ny, nx) HU. Not modified; returned as it is if it has no padding.

    Returns
    -------
    hu, notes
        A copy with padding set to air, and a note with the share.
    """
    if min(hu.shape) < 2:
        return hu, ()
    at_corners = tuple(slice(None, None, size - 1) for size in hu.shape)
    corners = hu[at_corners]
    value = int(corners.flat[0])
    if value < _CORNER_HU or corners.min() != corners.max():
        return hu, ()
    marked = hu == value
    others = hu[~marked]
    labels = numbered_parts(marked)
    inside = np.isin(labels, np.unique(labels[at_corners]))
    count = int(np.count_nonzero(inside))
    if count < _SMALLEST_UNMARKED_SHARE * hu.size or not others.size:
        return hu, ()
    out = hu.copy()
    fill = max(AIR_HU, int(others.min()))
    out[inside] = fill
    found = PaddingCount()
    found.add(PaddedPixels(inside, fill, value, int(np.count_nonzero(marked)) - count, is_marked=False))
    return out, found.notes(hu.size)


class PaddingCount:
    """Sum of the padding of all slices of a series, for a note about it."""

    def __init__(self) -> None:
        self._num_pixels = self._num_unchanged = 0
        self._values: dict[float, int] = {}
        self._fills: list[float] = []
        self._is_marked = True

    def add(self, padded: PaddedPixels) -> None:
        """Add the padding of one slice."""
        count = int(np.count_nonzero(padded.inside))
        self._num_pixels += count
        self._num_unchanged += padded.num_unchanged
        self._values[padded.value] = self._values.get(padded.value, 0) + count
        self._fills.append(padded.fill)
        self._is_marked &= padded.is_marked

    def notes(self, num_voxels: int) -> tuple[Note, ...]:
        """Return a note with the share of the padding, or nothing if there is no padding.

        The note is a badge if the file does not state the padding, or if the padding has a value that tissue may have.
        """
        if not self._num_pixels:
            return ()
        value = max(self._values, key=lambda one: self._values[one])
        low, high = min(self._fills), max(self._fills)
        filled = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        share = 100 * self._num_pixels / num_voxels
        which = "are marked as padding by the file" if self._is_marked else "look like padding, which no tag states"
        words = f"{share:.2g} % of the voxels {which}: they had the value {value:g} and were set to {filled}"
        if self._num_unchanged:
            words += f"; {self._num_unchanged} voxels with such a value within the picture were not changed"
        in_tissue = any(_TISSUE_HU[0] < one < _TISSUE_HU[1] for one in self._values)
        return (Note("import.padding", words, badge=in_tissue or not self._is_marked),)
