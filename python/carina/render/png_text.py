"""Camera pose and notes as text chunks of PNG files (PNG specification, third edition: 9, 11.2, 11.3.3.2)."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path
from typing import Any

from carina.disk import open_regular
from carina.display.png import SIGNATURE
from carina.errors import RenderError
from carina.volume import Note

KEYWORD = "carina-pose"
BADGES_KEYWORD = "carina-badges"
_MAX_TEXT = 1 << 16


def read_png_pose(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return the view and the pose that Carina stored in a saved picture; None if the picture has none.

    Raises
    ------
    RenderError
        ``render.png``: if the file is not a PNG.
    """
    found = _text(path, KEYWORD)
    return found if isinstance(found, dict) else None


def read_png_badges(path: str | os.PathLike[str]) -> tuple[Note, ...]:
    """Return the permanent notes that Carina stored in a saved picture; empty if the picture has none.

    Raises
    ------
    RenderError
        ``render.png``: if the file is not a PNG.
    """
    found = _text(path, BADGES_KEYWORD)
    rows = found if isinstance(found, list) else []
    return tuple(Note(str(row["code"]), str(row["words"]), badge=True) for row in rows)


def _text(path: str | os.PathLike[str], wanted: str) -> Any:
    """Return the JSON value of the named text chunk of a PNG file; None if the file has no such chunk."""
    with open_regular(path) as file:
        data = file.read()
    if not data.startswith(SIGNATURE):
        raise RenderError(f"reading the pose of an image: expected a PNG; found {Path(path).name!r}", code="render.png")
    at = len(SIGNATURE)
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
