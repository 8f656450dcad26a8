"""Reader of the numbers in a grid file without a library, so that all formats give identical numbers.

ITK converts NaN to 0 (soft tissue) in a NIfTI file, adds an intercept if the slope is 0, reads only the first member of
a gzip file, and needs twice the memory.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.gzip_stream import Readable, UnpackedFile, Unpacker
from carina.volume.header_fields import GridHeader
from carina.volume.model import Note
from carina.volume.progress import Watch
from carina.volume.read_limits import MAX_VOXELS

_CHUNK_BYTES = 1 << 23
_MAX_RATIO = 1100  # deflate compresses by at most 1032 to 1
_READING = "Reading the voxels"
_GZIP_DEFLATE = b"\x1f\x8b\x08"


def read_voxels(path: Path, header: GridHeader, watch: Watch) -> tuple[NDArray[np.generic], tuple[Note, ...]]:
    """Return the values ``(nz, ny, nx)`` of a file in this machine's byte order, scaled as the header states.

    Parameters
    ----------
    path
        The file, for messages.
    header
        The checked header.
    watch
        Progress and cancellation.

    Returns
    -------
    values, notes
        A note states if the file contains more data than its header claims.

    Raises
    ------
    VolumeImportError
        ``import.truncated`` or ``import.too-large``.
    CancelledError
        If the user cancels.
    """
    if header.num_voxels > MAX_VOXELS:
        msg = (
            f"reading {path.name}: its header claims {header.sizes} voxels; expected at most {MAX_VOXELS}; crop or "
            "resample a scan that large, or get an undamaged copy"
        )
        raise VolumeImportError(msg, code="import.too-large")
    if header.compression is None:
        numbers, extra = _read_plain(path, header, watch)
    else:
        numbers, extra = _read_packed(path, header, watch)
    values = numbers.view(header.dtype).reshape(header.shape_ijk[::-1])
    if not values.dtype.isnative:
        values = values.byteswap(inplace=True).view(values.dtype.newbyteorder("="))
    notes: tuple[Note, ...] = ()
    if extra:
        # A few bytes are padding; the size of a slice or more indicates that the header describes another volume.
        per_slice = header.num_bytes // header.shape_ijk[2]
        words = f"the file contains {extra} bytes more than its header states; they were ignored"
        notes = (Note("import.extra-data", words, badge=extra >= per_slice),)
    return (values if header.scaling is None else _scale_values(values, *header.scaling)), notes


def read_bytes_before_voxels(path: Path, header: GridHeader, watch: Watch) -> NDArray[np.uint8]:
    """Return the bytes that precede the values in a compressed stream and that other readers skip.

    Parameters
    ----------
    path
        The file, for messages.
    header
        The checked header, with compressed values.
    watch
        Progress and cancellation.

    Raises
    ------
    VolumeImportError
        ``import.truncated``.
    CancelledError
        If the user cancels.
    """
    needed = header.data_offset
    size = header.data_path.stat().st_size
    if needed > _MAX_RATIO * size:
        raise _truncated_error(path, header, f"the compressed file has only {size} bytes")
    out, at = np.empty(needed, dtype=np.uint8), 0
    with header.data_path.open("rb") as file:
        try:
            for piece in Unpacker(_open_at_stream(file, header), header.compression or ""):
                part = np.frombuffer(piece, dtype=np.uint8)[: needed - at]
                out[at : at + part.size] = part
                at += part.size
                watch.step(_READING, at / needed)
                if at == needed:
                    return out
        except ValueError as error:
            raise _truncated_error(path, header, str(error)) from None
    raise _truncated_error(path, header, f"the data unpacks to {at} bytes")


def _truncated_error(path: Path, header: GridHeader, found: str) -> VolumeImportError:
    msg = (
        f"reading {path.name}: its header claims {header.sizes} voxels ({header.num_bytes} bytes), but {found}; the "
        "file is incomplete or its header is wrong; copy or export it again"
    )
    return VolumeImportError(msg, code="import.truncated")


def _read_plain(path: Path, header: GridHeader, watch: Watch) -> tuple[NDArray[np.uint8], int]:
    """Return the bytes of uncompressed voxel values, and the number of bytes in the file after them."""
    size, needed = header.data_path.stat().st_size, header.num_bytes
    begin = size - needed if header.data_offset < 0 else header.data_offset
    extra = size - begin - needed
    if begin < 0 or extra < 0:
        # Detected before memory of that size is allocated.
        found = f"the file contains {size if begin < 0 else max(0, size - begin)} bytes"
        with header.data_path.open("rb") as file:
            file.seek(max(0, begin))
            if file.read(3) == _GZIP_DEFLATE:
                found += ", which look compressed by gzip although the header does not state it"
        raise _truncated_error(path, header, found)
    out = np.empty(needed, dtype=np.uint8)
    place = out.data
    with header.data_path.open("rb", buffering=0) as file:
        file.seek(begin)
        at = 0
        while at < needed:
            watch.step(_READING, at / needed)
            count = file.readinto(place[at : at + _CHUNK_BYTES])
            if not count:
                raise _truncated_error(path, header, f"the file contains {at} bytes")
            at += count
    return out, extra


def _read_packed(path: Path, header: GridHeader, watch: Watch) -> tuple[NDArray[np.uint8], int]:
    """Return the decompressed bytes of voxel values, and the number of bytes in the file after them."""
    size, needed = header.data_path.stat().st_size, header.num_bytes
    layers = 2 if header.file_is_gzipped else 1
    if header.data_offset + needed > _MAX_RATIO**layers * size:
        raise _truncated_error(path, header, f"the compressed file has only {size} bytes")
    # The system commits memory when it is written, so a wrong size in a header takes no memory.
    out = np.empty(needed, dtype=np.uint8)
    most = header.data_offset + needed + max(needed, 1 << 26)  # much more data is a decompression bomb
    total = 0
    with header.data_path.open("rb") as file:
        watch.step(_READING, 0.0)
        try:
            stream = Unpacker(_open_at_stream(file, header), header.compression or "")
            for piece in stream:
                at = total - header.data_offset
                total += len(piece)
                first = max(0, -at)
                if at < needed and first < len(piece):
                    part = np.frombuffer(piece, dtype=np.uint8)[first : needed - at]
                    out[at + first : at + first + part.size] = part
                if total > most:
                    raise _truncated_error(path, header, "the data unpacks to far more")
                watch.step(_READING, min(1.0, file.tell() / size))
        except ValueError as error:
            raise _truncated_error(path, header, str(error)) from None
    if total < header.data_offset + needed:
        raise _truncated_error(path, header, f"the data unpacks to {max(0, total - header.data_offset)} bytes")
    return out, total - header.data_offset - needed + stream.trailing_bytes


def _open_at_stream(file: BinaryIO, header: GridHeader) -> Readable:
    """Return the data file at the beginning of the compressed values.

    Raises
    ------
    ValueError
        If gzip compresses the whole file and its stream is damaged.
    """
    if not header.file_is_gzipped:
        file.seek(header.stream_offset)
        return file
    unpacked, skip = UnpackedFile(file), header.stream_offset
    while skip > 0 and (piece := unpacked.read(skip)):
        skip -= len(piece)
    return unpacked


def _scale_values(values: NDArray[np.generic], slope: float, intercept: float) -> NDArray[np.generic]:
    """Return values times slope plus intercept, slice by slice; integers if all numbers are whole and small."""
    small = values.dtype.kind in "iu" and values.dtype.itemsize <= 2
    if small and slope == int(slope) and intercept == int(intercept) and max(abs(slope), abs(intercept)) < 1 << 14:
        kind: type[np.generic] = np.int32
    else:
        # float32 is exact for 16-bit numbers and rounds once, at the end.
        kind = np.float64 if values.dtype.itemsize > 4 else np.float32
    out = np.empty(values.shape, dtype=kind)
    for k, plane in enumerate(values):
        out[k] = plane.astype(np.float64) * slope + intercept
    return out
