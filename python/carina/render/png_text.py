"""Pictures as PNG with words inside: where their camera was (PNG specification, third edition: 9, 11.2, 11.3.3.2)."""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import RenderError
from carina.volume import Note

__all__ = ["BADGES_KEYWORD", "KEYWORD", "png_bytes", "read_png_badges", "read_png_pose"]

KEYWORD = "carina-pose"
BADGES_KEYWORD = "carina-badges"
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_MAX_TEXT = 1 << 16


def png_bytes(rgb: NDArray[np.uint8], texts: dict[str, str]) -> bytes:
    """A picture, (height, width, 3) uint8, as the bytes of a PNG; ``texts`` by keyword, ASCII only.

    Written here, since libraries that write by name say little of a full disk, and that on stderr.
    """
    height, width, _ = rgb.shape
    rows = rgb.reshape(height, width * 3)
    above = np.zeros_like(rows)
    above[1:] = rows[:-1]
    left = np.zeros_like(rows)
    left[:, 3:] = rows[:, :-3]
    # None, Sub and Up (filters 0, 1, 2), by the least sum of what is left (12.7): differences below 0 wrap around.
    candidates = [rows, rows - left, rows - above]
    costs = [np.abs(c.view(np.int8).astype(np.int16)).sum(axis=1, dtype=np.int64) for c in candidates]
    chosen = np.argmin(costs, axis=0).astype(np.uint8)
    filtered = np.choose(chosen[:, None], candidates).astype(np.uint8)
    scanlines = np.concatenate([chosen[:, None], filtered], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = [_chunk(b"IHDR", header)]
    chunks += [_chunk(b"tEXt", k.encode("latin-1") + b"\0" + t.encode("ascii")) for k, t in texts.items()]
    chunks += [_chunk(b"IDAT", zlib.compress(scanlines.tobytes(), 6)), _chunk(b"IEND", b"")]
    return _SIGNATURE + b"".join(chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def read_png_pose(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """What a picture that Carina saved says about its view and pose; None where it says nothing.

    Raises
    ------
    RenderError
        ``render.png``: if it is no PNG.
    """
    found = _text(path, KEYWORD)
    return found if isinstance(found, dict) else None


def read_png_badges(path: str | os.PathLike[str]) -> tuple[Note, ...]:
    """What a picture that Carina saved says about doubts in its case; empty where there were none.

    Raises
    ------
    RenderError
        ``render.png``: if it is no PNG.
    """
    found = _text(path, BADGES_KEYWORD)
    rows = found if isinstance(found, list) else []
    return tuple(Note(str(row["code"]), str(row["words"]), badge=True) for row in rows)


def _text(path: str | os.PathLike[str], wanted: str) -> Any:
    """The JSON of a text chunk, or None."""
    data = Path(path).read_bytes()
    if not data.startswith(_SIGNATURE):
        raise RenderError(f"reading a picture's pose: expected a PNG; found {Path(path).name!r}", code="render.png")
    at = len(_SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        if length > len(data) - at - 12:
            break
        if data[at + 4 : at + 8] == b"tEXt" and length <= _MAX_TEXT:
            keyword, _, text = data[at + 8 : at + 8 + length].partition(b"\0")
            if keyword == wanted.encode():
                return json.loads(text)
        at += 12 + length
    return None
