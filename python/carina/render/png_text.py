"""Words inside a PNG: where its camera was (PNG specification, 11.3.3.2 tEXt)."""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path
from typing import Any

from carina.errors import RenderError

__all__ = ["KEYWORD", "read_png_pose", "with_text"]

KEYWORD = "carina-pose"
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# The signature and the IHDR chunk, which comes first: length, type, 13 bytes, checksum.
_AFTER_IHDR = len(_SIGNATURE) + 12 + 13
_MAX_TEXT = 1 << 16


def with_text(png: bytes, keyword: str, text: str) -> bytes:
    """The same picture with a text chunk behind its header; ASCII only."""
    body = b"tEXt" + keyword.encode("latin-1") + b"\0" + text.encode("ascii")
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:_AFTER_IHDR] + chunk + png[_AFTER_IHDR:]


def read_png_pose(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """What a picture that Carina saved says about its view and pose; None where it says nothing.

    Raises
    ------
    RenderError
        ``render.png``: if it is no PNG.
    """
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
            if keyword == KEYWORD.encode():
                found = json.loads(text)
                return found if isinstance(found, dict) else None
        at += 12 + length
    return None
