"""Reader of the stored bytes of one DICOM image or frame, without decoding.

The position of the pixels, which the reader of the header found, is used if it is known, because parsing a file twice
would take most of the time. Frames of a compressed file are found by its offset table, by the number of its fragments,
or by the end markers of its streams (PS3.5 A.4); a file whose frames cannot be separated with certainty is refused.
"""

from __future__ import annotations

import functools
import itertools
from pathlib import Path
from typing import BinaryIO, Literal

from carina.volume.dicom_headers import PIXEL_TAGS, SliceHeader, read_dataset
from carina.volume.dicom_streams import fragments
from carina.volume.without_warnings import without_warnings

_IMPLICIT = ("1.2.840.10008.1.2", "")
_UNDEFINED = 0xFFFFFFFF
_ITEM, _END_OF_ITEMS = b"\xfe\xff\x00\xe0", b"\xfe\xff\xdd\xe0"
_END_OF_IMAGE = b"\xff\xd9"
Spans = tuple[tuple[tuple[int, int], ...], ...]
"""Offset and length of each fragment of each frame."""


def read_plain_pixels(header: SliceHeader, num_bytes: int) -> tuple[bytes, int]:
    """Return the stored bytes of an uncompressed image or frame, and the number of bytes beyond all frames.

    Parameters
    ----------
    header
        The image or frame.
    num_bytes
        Number of bytes of one frame.

    Raises
    ------
    ValueError
        If the file cannot be read as DICOM.
    """
    begin = 0 if header.frame is None else header.frame * num_bytes
    whole = header.num_frames * num_bytes
    place = _pixel_element(header)
    if place is None:
        stored = _pixel_data(header)
        found = stored if header.frame is None else stored[begin : begin + num_bytes]
        return found, max(0, len(stored) - whole)
    start, length = place
    with header.path.open("rb") as file:
        if header.frame is None:
            file.seek(start)
            stored = file.read() if length == _UNDEFINED else file.read(length)
            return stored, max(0, len(stored) - whole)
        file.seek(start + begin)
        # A frame beyond the stated length of the element would read what follows the pixels.
        available = num_bytes if length == _UNDEFINED else min(num_bytes, max(0, length - begin))
        return file.read(available), 0 if length == _UNDEFINED else max(0, length - whole)


def read_stream_bytes(header: SliceHeader) -> bytes | None:
    """Return the compressed stream of an image or frame; None if the stream is truncated.

    Raises
    ------
    ValueError
        If the file cannot be read as DICOM, or its frames cannot be separated.
    """
    if header.frame is None:
        return fragments(_whole_element(header))
    place = _pixel_element(header)
    if place is None:
        msg = "its pixel data cannot be found"
        raise ValueError(msg)
    seen = header.path.stat()
    spans = _frame_spans(header.path, seen.st_mtime_ns, seen.st_size, place[0], header.num_frames)
    parts = []
    with header.path.open("rb") as file:
        for offset, length in spans[header.frame]:
            file.seek(offset)
            parts.append(file.read(length))
            if len(parts[-1]) < length:
                return None
    return b"".join(parts)


def _whole_element(header: SliceHeader) -> bytes:
    place = _pixel_element(header)
    if place is None:
        return _pixel_data(header)
    start, length = place
    with header.path.open("rb") as file:
        file.seek(start)
        return file.read() if length == _UNDEFINED else file.read(length)


def _pixel_element(header: SliceHeader) -> tuple[int, int] | None:
    """Return the offset and the stated length of the value of PixelData; None if they are not known."""
    if header.pixels_at is None:
        return None
    with header.path.open("rb") as file:
        file.seek(header.pixels_at)
        head = file.read(12)
    order: Literal["little", "big"] = "little" if head[:4] == PIXEL_TAGS[0] else "big"
    if header.transfer_syntax in _IMPLICIT:
        return header.pixels_at + 8, int.from_bytes(head[4:8], order)
    if head[4:6] in (b"OW", b"OB", b"UN"):
        return header.pixels_at + 12, int.from_bytes(head[8:12], order)
    return None


def _pixel_data(header: SliceHeader) -> bytes:
    """Return the value of PixelData by parsing the whole file; empty if there is none."""
    if header.frame is None:
        return _parsed_pixel_data(header.path)
    seen = header.path.stat()
    return _last_pixel_data(header.path, seen.st_mtime_ns, seen.st_size)


@functools.lru_cache(maxsize=1)
def _last_pixel_data(path: Path, _time_ns: int, _size: int) -> bytes:
    return _parsed_pixel_data(path)


def release_pixel_data() -> None:
    """Release the pixels of the last multi-frame file that had to be parsed as a whole (a deflated file)."""
    _last_pixel_data.cache_clear()


def _parsed_pixel_data(path: Path) -> bytes:
    dataset = read_dataset(path, pixels=True)
    with without_warnings():
        try:
            value = dataset.get("PixelData")
        except Exception as error:
            msg = f"its pixel data cannot be read ({type(error).__name__})"
            raise ValueError(msg) from None
    return value if isinstance(value, bytes) else b""  # a damaged element may contain a number


@functools.lru_cache(maxsize=64)
def _frame_spans(path: Path, _time_ns: int, size: int, start: int, num_frames: int) -> Spans:
    """Return offset and length of each fragment of each frame of a compressed multi-frame file.

    Raises
    ------
    ValueError
        If the fragments are damaged, or their frames cannot be separated.
    """
    with path.open("rb") as file:
        items = _items(file, start, size)
        if len(items) < 2:
            msg = "its compressed pixel data has no fragments"
            raise ValueError(msg)
        file.seek(items[0][0])
        table = file.read(items[0][1])
        found = items[1:]
        offsets = [int.from_bytes(table[at : at + 4], "little") for at in range(0, len(table) - 3, 4)]
        # The offsets of the table count from the first fragment.
        at_offset = {offset - found[0][0]: number for number, (offset, _) in enumerate(found)}
        firsts = [at_offset.get(offset) for offset in offsets]
        if len(firsts) == num_frames and firsts[0] == 0 and None not in firsts:
            bounds = [*(first for first in firsts if first is not None), len(found)]
            if all(low < high for low, high in itertools.pairwise(bounds)):
                return tuple(tuple(found[low:high]) for low, high in itertools.pairwise(bounds))
        if len(found) == num_frames:
            return tuple((one,) for one in found)
        return _split_at_end_markers(file, found, num_frames)


def _items(file: BinaryIO, start: int, size: int) -> list[tuple[int, int]]:
    items = []
    at = start
    while at + 8 <= size:
        file.seek(at)
        head = file.read(8)
        length = int.from_bytes(head[4:], "little")
        if head[:4] == _END_OF_ITEMS:
            break
        if head[:4] != _ITEM or at + 8 + length > size:
            msg = "its compressed pixel data is truncated"
            raise ValueError(msg)
        items.append((at + 8, length))
        at += 8 + length
    return items


def _split_at_end_markers(file: BinaryIO, found: list[tuple[int, int]], num_frames: int) -> Spans:
    """Return the fragments of each frame by the end marker of the JPEG stream in its last fragment."""
    frames: list[tuple[tuple[int, int], ...]] = []
    parts: list[tuple[int, int]] = []
    for offset, length in found:
        parts.append((offset, length))
        file.seek(offset + max(0, length - 16))
        if file.read(min(16, length)).rstrip(b"\0").endswith(_END_OF_IMAGE):
            frames.append(tuple(parts))
            parts = []
    if parts or len(frames) != num_frames:
        msg = "the frames of its compressed pixel data cannot be separated"
        raise ValueError(msg)
    return tuple(frames)
