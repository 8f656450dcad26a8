"""Encoding of images as PNG, and decoding of these files (PNG specification, third edition: 9, 11.2, 11.3.3.2)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

MAX_SIDE_PX = 16_384
"""Maximum width and height of a PNG that is read, in pixels; more than Carina writes."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"


def png_bytes(rgb: NDArray[np.uint8], texts: Mapping[str, str] | None = None) -> bytes:
    """Encode an image, shape (height, width, 3), uint8, as PNG; ``texts`` maps keywords to ASCII text.

    Carina has its own encoder because image libraries that write files do not report a full disk clearly.
    """
    height, width, _ = rgb.shape
    rows = rgb.reshape(height, width * 3)
    above = np.zeros_like(rows)
    above[1:] = rows[:-1]
    left = np.zeros_like(rows)
    left[:, 3:] = rows[:, :-3]
    # Each row uses the filter None, Sub or Up (0, 1, 2) with the least sum of absolute values (12.7); differences
    # below 0 wrap around.
    candidates = [rows, rows - left, rows - above]
    costs = [np.abs(c.view(np.int8).astype(np.int16)).sum(axis=1, dtype=np.int64) for c in candidates]
    chosen = np.argmin(costs, axis=0).astype(np.uint8)
    filtered = np.choose(chosen[:, None], candidates).astype(np.uint8)
    scanlines = np.concatenate([chosen[:, None], filtered], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = [_chunk(b"IHDR", header)]
    chunks += [_chunk(b"tEXt", k.encode("latin-1") + b"\0" + t.encode("ascii")) for k, t in (texts or {}).items()]
    chunks += [_chunk(b"IDAT", zlib.compress(scanlines.tobytes(), 6)), _chunk(b"IEND", b"")]
    return SIGNATURE + b"".join(chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_pixels(stored: bytes) -> NDArray[np.uint8]:
    """Decode an image that :func:`png_bytes` encoded: shape (height, width, 3).

    Raises
    ------
    ValueError
        If the data are damaged, or another program wrote them with other options.
    """
    if not stored.startswith(SIGNATURE):
        raise ValueError("expected a PNG")
    at, header, parts = len(SIGNATURE), b"", []
    while at + 12 <= len(stored):
        (length,) = struct.unpack_from(">I", stored, at)
        kind, data = stored[at + 4 : at + 8], stored[at + 8 : at + 8 + length]
        if stored[at : at + 12 + length] != _chunk(kind, data):
            raise ValueError("a chunk is truncated or its checksum is wrong")
        if kind == b"IHDR":
            header = data
        elif kind == b"IDAT":
            parts.append(data)
        at += 12 + length
        if kind == b"IEND":
            break
    else:
        raise ValueError("the end is missing")
    if len(header) != 13 or header[8:] != bytes((8, 2, 0, 0, 0)):
        raise ValueError("expected 8-bit colour without transparency")
    width, height = struct.unpack_from(">II", header)
    if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX):
        raise ValueError("the size is out of range")
    row_bytes = 3 * width + 1
    unpacker = zlib.decompressobj()
    try:
        # One byte more than expected, so that a longer image is detected without being unpacked.
        scanlines = unpacker.decompress(b"".join(parts), height * row_bytes + 1)
    except zlib.error:
        raise ValueError("the compressed data are damaged") from None
    if len(scanlines) != height * row_bytes:
        raise ValueError("the data do not match the size")
    rows = np.frombuffer(scanlines, np.uint8).reshape(height, row_bytes)
    found = np.zeros((height, width, 3), dtype=np.uint8)
    above = np.zeros((width, 3), dtype=np.uint8)
    for row, scanline in enumerate(rows):
        values = scanline[1:].reshape(width, 3)
        if scanline[0] == 1:
            values = np.cumsum(values, axis=0, dtype=np.uint8)
        elif scanline[0] == 2:
            values = values + above
        elif scanline[0] != 0:
            raise ValueError("another program has changed the image")
        found[row] = above = values
    return found
