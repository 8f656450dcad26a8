"""Reader of the values of a VTI file: text, base64 or raw, with or without zlib."""

from __future__ import annotations

import binascii
import mmap
import re
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.header_fields import GridHeader
from carina.volume.header_vti import VtiData, read_vti_data
from carina.volume.progress import Watch
from carina.volume.read_limits import MAX_VOXELS

__all__ = ["read_vti_voxels"]

_READING = "Reading the voxels"
_MAX_BLOCKS = 1 << 22
_MAX_BLOCK_BYTES = 1 << 30
_MAX_TEXT_PER_NUMBER = 40
_BLANK = re.compile(rb"\s+")


def read_vti_voxels(path: Path, header: GridHeader, watch: Watch) -> NDArray[np.generic]:
    """Return the values ``(nz, ny, nx)`` of a file in this machine's byte order.

    Parameters
    ----------
    path
        The file.
    header
        Its checked header.
    watch
        Progress and cancellation.

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
    watch.step(_READING, 0.0)
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        place = read_vti_data(path, content)
        try:
            values = _numbers(content, place, header, watch)
        except (ValueError, IndexError, zlib.error, binascii.Error) as error:
            msg = (
                f"reading {path.name}: its values are damaged or incomplete ({type(error).__name__}); expected "
                f"{header.sizes} voxels; copy or export the file again"
            )
            raise VolumeImportError(msg, code="import.truncated") from None
    if not values.dtype.isnative:
        values = values.astype(values.dtype.newbyteorder("="))
    watch.step(_READING, 1.0)
    return values.reshape(header.shape_ijk[::-1])


def _numbers(content: mmap.mmap, place: VtiData, header: GridHeader, watch: Watch) -> NDArray[np.generic]:
    if place.coding == "ascii":
        return _text_numbers(content[place.begin : place.end], header)
    source = _Source(content, place)
    data = _inflated(source, header, watch) if place.is_compressed else _plain(source, header)
    return np.frombuffer(data, dtype=header.dtype)


def _text_numbers(text: bytes, header: GridHeader) -> NDArray[np.generic]:
    if not header.num_voxels * 2 - 1 <= len(text) <= max(4096, header.num_voxels * _MAX_TEXT_PER_NUMBER):
        raise ValueError
    parts = text.split()
    if len(parts) != header.num_voxels:
        raise ValueError
    kind = header.dtype.newbyteorder("=")
    if kind.kind == "f":
        return np.array([float(part) for part in parts], dtype=kind)
    limits = np.iinfo(str(kind))
    numbers = [int(part) for part in parts]
    if min(numbers) < limits.min or max(numbers) > limits.max:
        raise ValueError
    return np.array(numbers, dtype=kind)


class _Source:
    """Bytes of the values; base64 is decoded where it is read."""

    def __init__(self, content: mmap.mmap, place: VtiData) -> None:
        self._content = content
        self._place = place
        self._at = place.begin
        if place.coding == "base64":
            while content[self._at : self._at + 1].isspace():
                self._at += 1
        self.word = place.word

    def header_words(self, count: int) -> NDArray[np.unsignedinteger]:
        """Return the first numbers of the header, without moving on."""
        return np.frombuffer(self._peek(count * self.word.itemsize), dtype=self.word)

    def skip_header(self, num_bytes: int) -> None:
        """Skip a header of a given number of bytes."""
        self._at += num_bytes if self._place.coding == "raw" else _base64_length(num_bytes)

    def rest(self, num_bytes: int) -> bytes:
        """Return the bytes from the present position to the end.

        Raises
        ------
        ValueError
            If the file is shorter.
        """
        return self._peek(num_bytes)

    def _peek(self, num_bytes: int) -> bytes:
        if self._place.coding == "raw":
            data = self._content[self._at : min(self._at + num_bytes, self._place.end)]
        else:
            length = _base64_length(num_bytes)
            text = self._content[self._at : min(self._at + length, self._place.end)]
            if _BLANK.search(text):  # line breaks: all the text that may belong to the bytes
                text = _BLANK.sub(b"", self._content[self._at : self._place.end])[:length]
            data = binascii.a2b_base64(text, strict_mode=False)[:num_bytes]
        if len(data) < num_bytes:
            raise ValueError
        return data


def _base64_length(num_bytes: int) -> int:
    return (num_bytes + 2) // 3 * 4


def _plain(source: _Source, header: GridHeader) -> bytes:
    """Return uncompressed values; their length precedes them in the same stream."""
    size = source.word.itemsize
    if int(source.header_words(1)[0]) != header.num_bytes:
        raise ValueError
    return source.rest(size + header.num_bytes)[size:]


def _inflated(source: _Source, header: GridHeader, watch: Watch) -> NDArray[np.uint8]:
    """Return values that are compressed in blocks; the sizes of all blocks precede them in a stream of their own."""
    num_blocks, block_bytes, last_bytes = (int(number) for number in source.header_words(3))
    full = num_blocks - 1 if last_bytes else num_blocks
    if not 0 < num_blocks <= _MAX_BLOCKS or block_bytes > _MAX_BLOCK_BYTES or last_bytes > block_bytes:
        raise ValueError
    if full * block_bytes + last_bytes != header.num_bytes:
        raise ValueError
    sizes = [int(number) for number in source.header_words(3 + num_blocks)[3:]]
    source.skip_header((3 + num_blocks) * source.word.itemsize)
    packed = source.rest(sum(sizes))
    out = np.empty(header.num_bytes, dtype=np.uint8)
    at = begin = 0
    for index, size in enumerate(sizes):
        watch.step(_READING, index / num_blocks)
        expected = block_bytes if index < full else last_bytes
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(packed[begin : begin + size], expected + 1)
        if len(data) != expected or not unpacker.eof:
            raise ValueError
        out[at : at + expected] = np.frombuffer(data, dtype=np.uint8)
        at, begin = at + expected, begin + size
    return out
