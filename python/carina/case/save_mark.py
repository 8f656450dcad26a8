"""Marks that identify the saves of a named case file."""

from __future__ import annotations

import secrets
import sqlite3
from typing import Annotated

import msgspec
from msgspec import Meta

from carina.typed_reading import read_json
from carina.value import FrozenValue

KIND = "save"
"""Value of the column ``kind`` of the mark in the table ``extra``."""
SaveId = Annotated[str, Meta(pattern=r"\A[0-9a-f]{16}\Z")]


class SaveMark(FrozenValue, frozen=True):
    """Identity of one save of a named case file.

    The mark contains no time, because clocks of two computers differ, and copies may keep the times of their originals.
    """

    save_id: SaveId
    """Random id; no two saves have the same id."""
    generation: Annotated[int, Meta(ge=1, le=2**53)]
    """1 for the first save of a file; each later save, by any window, has the replaced save's generation plus 1."""
    parent_id: SaveId | None = None
    """``save_id`` of the content that this save replaced; None for a new file."""

    @classmethod
    def successor(cls, parent_id: str | None, generation: int) -> SaveMark:
        """Return a mark with a new id for a save that replaces the given save; generation 0 begins a file."""
        return cls(secrets.token_hex(8), generation + 1, parent_id)


def write_save_mark(connection: sqlite3.Connection, mark: SaveMark | None) -> None:
    """Store the mark in a copy before the copy is saved under a name; None removes any mark."""
    connection.execute("DELETE FROM extra WHERE kind = ?", (KIND,))
    if mark is not None:
        row = (KIND, 0, msgspec.json.encode(mark).decode())
        connection.execute("INSERT INTO extra (kind, n, json) VALUES (?, ?, ?)", row)


def read_save_mark(connection: sqlite3.Connection) -> SaveMark | None:
    """Return the mark of the last save; None if the file has no readable mark."""
    found = connection.execute("SELECT json FROM extra WHERE kind = ? AND length(json) < 1000", (KIND,)).fetchone()
    if found is None:
        return None
    try:
        return read_json(found[0], SaveMark)
    except (msgspec.MsgspecError, UnicodeError):
        return None
