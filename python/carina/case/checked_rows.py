"""Rows of a case file's tables, read with checks of their number, size and bounds."""

from __future__ import annotations

import sqlite3
from typing import Any, Final

from carina.case import json_records as f
from carina.case.bounds import MAX_LABEL_CHARS, MAX_S, MAX_WHOLE, bounded_number, bounded_text, bounded_whole
from carina.case.error_texts import damage_error
from carina.case.reading import Rows
from carina.case.schema import CONTENT

MAX_CONTENT_BYTES: Final = 2 << 30
"""Maximum total size in bytes of the rows of a case without its CT; a larger file is refused."""
MAX_ROWS: Final = 2_000_000
MAX_STEPS: Final = 10_000


def all_content(connection: sqlite3.Connection) -> Rows:
    """Return all rows of the content tables, after checking their number and size.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if there are too many.
    """
    for table in CONTENT:
        count = connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        if count > MAX_ROWS:
            raise damage_error(table, f"at most {MAX_ROWS} rows", str(count))
    pages, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
    chunks = sum(
        connection.execute(f"SELECT coalesce(sum(length(data)), 0) FROM {table}").fetchone()[0]
        for table in ("ct", "recording_chunk")
    )
    if pages * size - chunks > MAX_CONTENT_BYTES:
        raise damage_error("content", f"at most {MAX_CONTENT_BYTES} bytes", str(pages * size - chunks))
    return {table: {row[0]: row[1:] for row in connection.execute(f"SELECT * FROM {table}")} for table in CONTENT}


def step_rows(connection: sqlite3.Connection) -> list[tuple[Any, ...]]:
    """Return the rows of the history's steps: number, label, command as JSON, seconds, row of the document.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if there are no or too many steps, or the numbers have a gap.
    """
    count = connection.execute("SELECT count(*) FROM step").fetchone()[0]
    if not 1 <= count <= MAX_STEPS:
        raise damage_error("history", f"1 to {MAX_STEPS} steps", str(count))
    sql = "SELECT n, substr(label, 1, ?), command, at_s, document FROM step ORDER BY n"
    rows = connection.execute(sql, (MAX_LABEL_CHARS + 1,)).fetchall()
    for row in rows:
        check_step(row[0], row[1], row[3])
    if [row[0] for row in rows] != list(range(rows[0][0], rows[0][0] + count)):
        raise damage_error("history", "consecutive step numbers", "a gap")
    return rows


def check_step(number: int, label: object, at_s: object) -> None:
    """Raise an error if the number, the label or the time of a step, which no digest protects, is out of bounds.

    Parameters
    ----------
    number
        Number of the step.
    label
        Label of the step.
    at_s
        Time of the step in seconds since the creation of the case.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    bounded_whole(number, "number of a step", -MAX_WHOLE, MAX_WHOLE)
    bounded_text(label, f"label of step {number}", MAX_LABEL_CHARS)
    bounded_number(at_s, f"time of step {number}", 0.0, MAX_S)


def command_type_name(command: object) -> str | None:
    """Return the current name of a command's type from the beginning of its JSON; None if there is none."""
    if not isinstance(command, str):
        return None
    _, mark, rest = command.partition('"type":"')
    kind = rest.partition('"')[0]
    return f.EARLIER_NAMES.get(kind, kind) if mark and kind.isidentifier() else None
