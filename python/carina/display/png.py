"""Encoding of images as PNG (PNG specification, third edition: 9, 11.2, 11.3.3.2)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

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
