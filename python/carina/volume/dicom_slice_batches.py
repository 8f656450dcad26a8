"""Fast reading of the pixels of unremarkable slices, on all cores, straight into the volume.

The compiled module reads a slice only if its pixels are certainly those that ``dicom_pixels`` would return, without a
doubt, padding or clipping. FFmpeg decodes reversible JPEG 2000, because it reports damage, which OpenJPEG does not; in
400 damaged streams, OpenJPEG reported no damage that FFmpeg had not. Every other slice is left to ``dicom_pixels``, the
reference, which decides about errors and notes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.volume.dicom_geometry import SliceStack
from carina.volume.dicom_header_batches import MAX_FAST_INFLATED_BYTES
from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixel_bytes import read_stream_bytes
from carina.volume.dicom_streams import read_stream
from carina.volume.jpeg2000_check import has_second_decoder, intact_j2k_words
from carina.volume.padding import PaddingRange
from carina.volume.progress import Watch

_CODINGS = {
    "1.2.840.10008.1.2": "implicit",
    "1.2.840.10008.1.2.1": "little",
    "1.2.840.10008.1.2.2": "big",
    "1.2.840.10008.1.2.1.99": "deflated",
    "1.2.840.10008.1.2.5": "rle",
    "1.2.840.10008.1.2.4.57": "lossless jpeg",
    "1.2.840.10008.1.2.4.70": "lossless jpeg",
    "1.2.840.10008.1.2.4.80": "jpeg ls",
    "1.2.840.10008.1.2.4.81": "jpeg ls",
}
"""Coding of the pixels in each transfer syntax that the compiled module reads."""
_JPEG_2000 = "jpeg 2000"
_REVERSIBLE_JPEG_2000 = "1.2.840.10008.1.2.4.90"
_MAX_INTERCEPT = 1 << 24
_BATCH = 16  # slices that one call of the compiled module reads

_Format = tuple[str, int, int, int, bool, int, tuple[PaddingRange, ...] | None]


def read_plain_slices(stack: SliceStack, watch: Watch) -> tuple[NDArray[np.int16] | None, frozenset[int]]:
    """Read the unremarkable slices of a series.

    Parameters
    ----------
    stack
        Slices and grid of the series.
    watch
        Progress and cancellation.

    Returns
    -------
    values, read
        The volume (nz, ny, nx) with the slices that were read, and their numbers in ``stack.slices``; the other voxels
        are undefined. ``values`` is None if no slice was read.

    Raises
    ------
    CancelledError
        If the user cancels.
    """
    groups: dict[_Format, list[int]] = {}
    # The values of slices with different rescale tags must be compared, and corrected geometry needs each slice alone.
    if not stack.is_resampled and len({(header.slope, header.intercept) for header in stack.slices}) == 1:
        for number, header in enumerate(stack.slices):
            form = _format(header)
            if form is not None:
                groups.setdefault(form, []).append(number)
    if not groups:
        return None, frozenset()
    values = np.empty(stack.shape_zyx, dtype=np.int16)
    read: set[int] = set()
    for form, numbers in groups.items():
        watch.step("Reading the slices", len(read) / len(stack.slices))
        read.update(_read(stack, form, numbers, values, watch))
    return values, frozenset(read)


def _format(header: SliceHeader) -> _Format | None:
    """Return the arguments of the compiled module for a slice; None if it does not read such slices."""
    coding = _CODINGS.get(header.transfer_syntax)
    if header.transfer_syntax == _REVERSIBLE_JPEG_2000 and has_second_decoder():
        coding = _JPEG_2000
    is_readable = coding is not None and (header.pixels_at is not None or coding == "deflated")
    is_plain = header.slope == 1.0 and header.intercept == int(header.intercept) and header.modality_lut is None
    if coding is None or not is_readable or not is_plain or header.frame is not None:
        return None
    if abs(header.intercept) >= _MAX_INTERCEPT:
        return None
    return (
        coding,
        header.bits_allocated,
        header.bits_stored,
        header.high_bit,
        header.signed,
        int(header.intercept),
        header.padding if header.modality == "CT" else None,
    )


def _read(
    stack: SliceStack, form: _Format, numbers: Sequence[int], values: NDArray[np.int16], watch: Watch
) -> list[int]:
    coding, bits_allocated, bits_stored, high_bit, signed, intercept, padding = form
    read: list[int] = []
    # In batches: between two calls the threads draw the pictures of an open case, and Ctrl-C ends the reading.
    for begin in range(0, len(numbers), _BATCH):
        watch.step("Reading the slices", begin / len(numbers))
        batch = numbers[begin : begin + _BATCH]
        slices = [(stack.slices[number], stack.levels[number]) for number in batch]
        if coding == _JPEG_2000:
            read += _read_jpeg_2000(stack, batch, values, watch)
            continue
        found = _core.decode_dicom_slices(
            [(header.path, header.pixels_at or 0, level) for header, level in slices],
            values,
            coding=coding,
            bits_allocated=bits_allocated,
            bits_stored=bits_stored,
            high_bit=high_bit,
            signed=signed,
            intercept=intercept,
            padding=None if padding is None else list(padding),
            max_inflated=MAX_FAST_INFLATED_BYTES,
            cancel=watch.cancel,
        )
        read += [number for number, is_read in zip(batch, found, strict=True) if is_read]
    return read


def _read_jpeg_2000(stack: SliceStack, numbers: Sequence[int], values: NDArray[np.int16], watch: Watch) -> list[int]:
    """Decode slices on all cores into the volume; return those that are intact and unremarkable."""

    def decode(number: int) -> bool:
        header = stack.slices[number]
        if watch.cancel is not None and watch.cancel():
            return False  # the next step of the progress ends the reading
        try:
            frame = read_stream_bytes(header)
        except (ValueError, OSError):
            return False
        stream = None if frame is None else read_stream(frame)
        if frame is None or stream is None or stream.signed != header.signed:
            return False
        # Compared before the decoding, because a stream may claim a picture that does not fit into the memory.
        if not stream.has_size_of(header.rows, header.columns):
            return False
        words = intact_j2k_words(frame, stream)
        if words is None:
            return False
        return _core.place_dicom_words(
            words,
            values,
            level=stack.levels[number],
            bits=stream.bits,
            bits_allocated=header.bits_allocated,
            bits_stored=header.bits_stored,
            high_bit=header.high_bit,
            signed=header.signed,
            intercept=int(header.intercept),
            padding=list(header.padding) if header.modality == "CT" else None,
        )

    with ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="jpeg-2000") as pool:
        return [number for number, is_read in zip(numbers, pool.map(decode, numbers), strict=True) if is_read]
