"""Checks of compressed streams before decoding, and capture of the decoder's messages.

A decoder uses the stream, not the tags, and the streams have no checksum: a damaged stream is often decoded into wrong
pixels without an error. The stream is therefore checked before it is decoded (size, depth, sign and the sequence of its
parts), and messages of the native decoder on stderr are read.

Sources: ITU-T T.81 B (JPEG), T.87 C (JPEG-LS), T.800 A (JPEG 2000), DICOM PS3.5 A.4 (fragments), G (RLE).
"""

from __future__ import annotations

import itertools
import os
import re
import struct
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from carina import _core

_JPEG_START, _J2K_START = b"\xff\xd8\xff", b"\xff\x4f\xff\x51"
_MAX_J2K_TILES = 4096  # one tile is usual; each tile costs the decoder kilobytes
_LOSSY_JPEG = (0xC0, 0xC1, 0xC2)
_END = b"\xff\xd9"


@dataclass(frozen=True, slots=True)
class Stream:
    """The header of a JPEG, JPEG-LS or JPEG 2000 stream."""

    rows: int
    columns: int
    components: int
    bits: int
    signed: bool | None
    """Whether the numbers are signed; None if the format does not state it (JPEG, JPEG-LS)."""
    problem: str | None
    """Description of a truncated or invalid part of the stream; None if the stream is valid."""

    def has_size_of(self, rows: int, columns: int) -> bool:
        """Return whether the stream contains one grey picture with these rows and columns."""
        return (self.rows, self.columns, self.components) == (rows, columns, 1)


def fragments(stored: bytes) -> bytes | None:
    """Return the joined fragments of an encapsulated single frame; None if they are not a valid sequence of items.

    The offset table is omitted. A sequence without its final delimiter, as some writers leave it, is accepted.
    """
    at, parts = 0, []
    while at + 8 <= len(stored):
        tag, length = stored[at : at + 4], int.from_bytes(stored[at + 4 : at + 8], "little")
        if tag == b"\xfe\xff\xdd\xe0":
            break
        if tag != b"\xfe\xff\x00\xe0" or at + 8 + length > len(stored):
            return None
        parts.append(stored[at + 8 : at + 8 + length])
        at += 8 + length
    return b"".join(parts[1:]) if len(parts) > 1 else None


def read_stream(stored: bytes) -> Stream | None:
    """Read the header of a stream and check its parts; return None if it has no readable header."""
    try:
        at = stored.find(_J2K_START, 0, 4096)
        if at >= 0:
            return _read_j2k(stored, at)
        at = stored.find(_JPEG_START, 0, 4096)
        return _read_jpeg(stored, at) if at >= 0 else None
    except (IndexError, struct.error, ValueError):
        return None


def _read_j2k(stored: bytes, start: int) -> Stream | None:
    right, bottom, left, top, tile_x, tile_y = struct.unpack_from(">6I", stored, start + 8)
    components, depth = struct.unpack_from(">HB", stored, start + 40)
    if min(tile_x, tile_y) < 1 or -(-right // tile_x) * -(-bottom // tile_y) > _MAX_J2K_TILES:
        return None
    problem = _follow_j2k(stored, start + 2)
    return Stream(bottom - top, right - left, components, (depth & 0x7F) + 1, bool(depth >> 7), problem)


def _follow_j2k(stored: bytes, at: int) -> str | None:
    """Return the problem of a JPEG 2000 stream's main header and tile parts.

    None if they are valid to the end marker.
    """
    while True:
        marker = stored[at : at + 2]
        if marker == _END:
            return None
        if len(marker) < 2:
            return "it ends without its end marker"
        if marker == b"\xff\x90":  # start of a tile part; its length counts from this marker
            if at + 12 > len(stored):
                return "it ends within a tile"
            (length,) = struct.unpack_from(">I", stored, at + 6)
            if length == 0:  # the length of the last part may be 0, which means up to the end
                return None if stored.rstrip(b"\0").endswith(_END) else "it ends without its end marker"
            if length < 14 or at + length > len(stored):
                return "a tile is truncated"
            at += length
        elif marker[0] == 0xFF and marker[1] >= 0x4F:
            at += 2 + int.from_bytes(stored[at + 2 : at + 4], "big")
        else:
            return "a required marker is missing"


def _read_jpeg(stored: bytes, start: int) -> Stream | None:
    """Read the header of a JPEG or JPEG-LS stream and check its parts."""
    at, head, kind = start + 2, None, 0
    while stored[at] == 0xFF:
        marker = stored[at + 1]
        if marker == 0xF7 or (0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC)):
            bits, rows, columns, components = struct.unpack_from(">B2HB", stored, at + 4)
            head, kind = (rows, columns, components, bits), marker
        if marker == 0xDA:
            break
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        at += 2 + int.from_bytes(stored[at + 2 : at + 4], "big")
    else:
        if head is None:
            return None
    if head is None:
        return None
    problem = _follow_jpeg(stored, at, _IN_JPEG_LS if kind == 0xF7 else _IN_JPEG)
    problem = problem or _core.lossless_jpeg_problem(stored, start=start)
    return Stream(*head, signed=None, problem=problem)


# A marker within coded data: in JPEG a byte FF of the data is followed by 00, in JPEG-LS by a byte below 80.
_IN_JPEG = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])", re.DOTALL)
_IN_JPEG_LS = re.compile(rb"\xff+([\x80-\xcf\xd8-\xfe])", re.DOTALL)
# Markers that may follow a scan: tables, comments, the next scan, the number of lines.
_AFTER_SCAN = frozenset((0xC4, 0xDA, 0xDB, 0xDC, 0xDD, 0xFE, *range(0xE0, 0xF0), 0xF8))


def _follow_jpeg(stored: bytes, at: int, in_data: re.Pattern[bytes]) -> str | None:
    """Return the problem of a JPEG stream's data and markers from the first scan on; None if they are valid."""
    while True:
        at += 2 + int.from_bytes(stored[at + 2 : at + 4], "big")  # skip the header of the scan or the table
        found = in_data.search(stored, at)
        if found is None:
            return "it ends without its end marker"
        at, marker = found.end() - 2, found[1][0]
        if marker == 0xD9:
            return None
        if marker not in _AFTER_SCAN:
            return "a marker is in an invalid position"


def rle_problem(frame: bytes, num_pixels: int) -> str | None:
    """Return why the segments of an RLE frame do not unpack to exactly the pixels (PS3.5 G.3); None if they do."""
    if len(frame) < 64:
        return "its header is truncated"
    count, *offsets = struct.unpack_from("<16I", frame)
    if not 1 <= count <= 15:
        return f"it should contain 1 to 15 segments; its header claims {count}"
    starts = [*offsets[:count], len(frame)]
    for begin, end in itertools.pairwise(starts):
        if not 64 <= begin <= end <= len(frame):
            return "its segments lie outside the stream"
        segment, at, pixels = frame[begin:end], 0, 0
        while at < len(segment) and pixels < num_pixels:
            code = segment[at]
            if code < 128:
                at += code + 2
                pixels += code + 1
            elif code > 128:
                at += 2
                pixels += 257 - code
            else:
                at += 1
        # At most a pair of bytes pads a segment to an even length.
        if pixels != num_pixels or not 0 <= len(segment) - at <= 2:
            return "a compressed segment does not decode to the size of the image"
    return None


_lock = threading.Lock()
# Words in the messages of libjpeg, CharLS, OpenJPEG, GDCM and ITK; other lines on stderr come from other threads.
_DECODER = re.compile(
    rb"jpeg|j2k|jp2|huffman|marker|quantization|\bD[QHAN][TCL]\b|\bSO[SFI]\b|\btile|code-?block|codestream|segment|"
    rb"packet|precinct|subband|resolution|component|\[(?:warning|error|info)\]|gdcm|\bitk|^warning: in |rle|"
    rb"scan parameters|progress",
    re.IGNORECASE,
)
# Messages about intact streams: the reader tries several libraries, and those that cannot decode a stream write them.
_HARMLESS = re.compile(rb"Unsupported JPEG data precision|\[info\]", re.IGNORECASE)


@contextmanager
def decoder_words(theirs: re.Pattern[bytes] = _DECODER) -> Iterator[list[str]]:
    """Capture what native code writes to stderr within the block; the list is filled at the end of the block.

    Only the file descriptor is redirected, for one decoder at a time. Lines that do not match ``theirs``, such as the
    log of another thread, are written to stderr afterwards.

    Parameters
    ----------
    theirs
        Pattern of the lines that a decoder writes.

    Yields
    ------
    list of str
        The captured lines.
    """
    caught: list[str] = []
    with _lock, tempfile.TemporaryFile() as taken:
        try:
            before = os.dup(2)
        except OSError:  # without stderr, there is nothing to capture
            yield caught
            return
        try:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(taken.fileno(), 2)
            try:
                yield caught
            finally:
                os.dup2(before, 2)
                taken.seek(0)
                for line in taken.read(1 << 20).splitlines():
                    if not theirs.search(line):
                        if line.strip():
                            os.write(before, line + b"\n")
                    elif not _HARMLESS.search(line):
                        caught.append(line.decode("ascii", "replace").strip())
        finally:
            os.close(before)
