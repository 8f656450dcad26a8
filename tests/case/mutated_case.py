"""Mutations of a case file whose digests are recomputed, so that only the checks of values can detect them."""

from __future__ import annotations

import json
import random
import sqlite3
import zlib
from typing import Any

import numpy as np

from carina.case.compression import DTYPES, deflated, digest_of
from carina.case.schema import CONTENT

WHOLE = (-1, 0, 1, 2, 2**31, 2**53 + 1, 2**63 - 1, -(2**63))
REAL = (float("inf"), float("-inf"), float("nan"), 1e300, -1e300, 1e12, -1.0, 0.0, 5e-324)
TEXT = (
    "", "x" * 200_000, "x" * 1001, "\x1b[31mred", "\u202egnp.exe", "a\x00b", "\x9b2J", "[" * 5000, "[]", "{}", "null",
    "1e999", "\ud800",
)  # fmt: skip
BLOBS = (b"", b"\x00" * 40, deflated(b"\xff" * 512), deflated(b""))
RAW = ("1e999", "-1e999", "NaN", "Infinity", "1e308", "-1e308", "1" * 400)
"""Texts of numbers, valid and invalid in JSON, that replace a number of a case file."""
VALUES = (
    -1, 0, 0.5, 2**63, 2**31, -1e9 - 1, 1e6 + 1, 1e300, True, None, "", "x" * 30_000, "\x1b[2J", "word", [], {}, [1, 2],
    {"a": 1},
)  # fmt: skip
JSON_COLUMNS = (
    ("value", "json"), ("airways", "facts"), ("moment", "facts"), ("route", "facts"), ("tracker", "levels"),
    ("measured_branch", "facts"), ("measures", "facts"), ("step", "command"), ("source", "choices"), ("extra", "json"),
    ("tree", "facts"),
)  # fmt: skip


class Mutator:
    """Random change of one value of a case file; ``description`` states it for the message of a failing test."""

    def __init__(self, connection: sqlite3.Connection, seed: int) -> None:
        self._connection = connection
        self._random = random.Random(seed)
        self.description = ""

    def mutate(self) -> None:
        """Change one column, one JSON field, one array, one list of numbers, one recording or the order of rows."""
        while True:
            kind = self._random.choices(
                (self._column, self._json, self._array, self._figures, self._recording, self._order),
                (4, 8, 3, 1, 1, 1),
            )[0]
            try:
                if kind():
                    return
            except sqlite3.IntegrityError:  # SQLite stores NaN as NULL, or the digest exists already
                continue

    # Kinds of mutation

    def _column(self) -> bool:
        tables = [row[0] for row in self._connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        table = self._random.choice(tables)
        columns = [
            row for row in self._connection.execute(f"PRAGMA table_info({table})") if row[1] not in {"id", "digest"}
        ]
        name, kind = self._random.choice([(row[1], row[2]) for row in columns])
        rowid = self._row(table)
        if rowid is None:
            return False
        values: tuple[Any, ...] = {"INTEGER": WHOLE, "REAL": REAL, "TEXT": TEXT, "BLOB": BLOBS}[kind]
        return self._set(table, rowid, name, self._random.choice(values))

    def _json(self) -> bool:
        table, column = self._random.choice(JSON_COLUMNS)
        rowid = self._row(table, f"{column} IS NOT NULL")
        if rowid is None:
            return False
        (json_text,) = self._connection.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (rowid,)).fetchone()
        text = zlib.decompress(json_text).decode() if isinstance(json_text, bytes) else json_text
        value = json.loads(text)
        places = list(_places(value))
        if not places:
            return False
        holder, key = self._random.choice(places)
        how = self._random.choice(("value", "value", "value", "raw", "drop", "reverse", "double"))
        mark = None
        if how == "value":
            holder[key] = self._random.choice(VALUES)
        elif how == "raw":
            mark = self._random.choice(RAW)
            holder[key] = "MARK"
        elif how == "drop":
            del holder[key]
        elif isinstance(holder[key], list):
            holder[key] = holder[key][::-1] if how == "reverse" else holder[key] * 2
        else:
            return False
        made = json.dumps(value, ensure_ascii=False, separators=(",", ":"))
        made = made if mark is None else made.replace('"MARK"', mark)
        if made == text:
            return False
        self.description = f"JSON {how} at {key!r}: "
        if table == "tree":
            self._connection.execute("UPDATE tree SET size = ? WHERE rowid = ?", (len(made.encode()), rowid))
            return self._set(table, rowid, column, deflated(made.encode()))
        return self._set(table, rowid, column, made)

    def _array(self) -> bool:
        rowid = self._row("array")
        dtype, count, width, data = self._connection.execute(
            "SELECT dtype, count, width, data FROM array WHERE rowid = ?", (rowid,)
        ).fetchone()
        numbers = np.frombuffer(zlib.decompress(data), dtype=DTYPES[dtype]).copy()
        if not len(numbers):
            return False
        how = self._random.choice(("one", "one", "all", "reverse", "shorter", "none"))
        values = (np.inf, -np.inf, np.nan, 1e300, -1.0, 1e7, 0.0) if dtype[0] == "f" else (0, 2**31 - 1, 1)
        value = self._random.choice(values)
        if how == "one":
            numbers[self._random.randrange(len(numbers))] = value
        elif how == "all":
            numbers[:] = value
        elif how == "reverse":
            numbers = numbers[::-1]
        else:
            across = max(width, 1)
            numbers = numbers[: across * (max(count - 1, 0) if how == "shorter" else 0)]
            count = len(numbers) // across
        self._connection.execute("UPDATE array SET count = ? WHERE rowid = ?", (count, rowid))
        self.description = f"numbers {how} {value}: "
        return self._set("array", rowid, "data", deflated(numbers.tobytes()))

    def _figures(self) -> bool:
        rowid = self._row("sections")
        if rowid is None:
            return False
        (data,) = self._connection.execute("SELECT figures FROM sections WHERE rowid = ?", (rowid,)).fetchone()
        numbers = np.frombuffer(zlib.decompress(data), dtype="<f8").copy()
        value = self._random.choice((np.inf, -np.inf, np.nan, 1e300, -1e12))
        numbers[self._random.randrange(len(numbers))] = value
        self.description = f"figure {value}: "
        return self._set("sections", rowid, "figures", deflated(numbers.tobytes()))

    def _recording(self) -> bool:
        rowid = self._row("recording_chunk")
        if rowid is None:
            return False
        (data,) = self._connection.execute("SELECT data FROM recording_chunk WHERE rowid = ?", (rowid,)).fetchone()
        lines = zlib.decompress(data).decode().splitlines()
        place = self._random.randrange(len(lines))
        line = json.loads(lines[place])
        holder, key = self._random.choice(list(_places(line)))
        holder[key] = "MARK"
        mark = self._random.choice((*RAW, '"text"', "null", "-1", "[]"))
        lines[place] = json.dumps(line).replace('"MARK"', mark)
        content = "".join(f"{one}\n" for one in lines).encode()
        self.description = f"recording {key!r} {mark[:20]}"
        self._connection.execute(
            "UPDATE recording_chunk SET size = ?, digest = ?, data = ? WHERE rowid = ?",
            (len(content), digest_of(content), deflated(content), rowid),
        )
        return True

    def _order(self) -> bool:
        rows = self._connection.execute("SELECT n, document FROM step ORDER BY n").fetchall()
        order = [document for _, document in rows]
        self._random.shuffle(order)
        for (n, _), document in zip(rows, order, strict=True):
            self._connection.execute("UPDATE step SET document = ? WHERE n = ?", (document, n))
        self.description = "steps shuffled"
        return order != [document for _, document in rows]

    # Helper functions

    def _row(self, table: str, where: str = "1") -> int | None:
        found = [row[0] for row in self._connection.execute(f"SELECT rowid FROM {table} WHERE {where}")]
        return self._random.choice(found) if found else None

    def _set(self, table: str, rowid: int, column: str, value: Any) -> bool:
        if isinstance(value, str):
            value = value.encode(errors="surrogatepass")
            self._connection.execute(f"UPDATE {table} SET {column} = CAST(? AS TEXT) WHERE rowid = ?", (value, rowid))
        else:
            self._connection.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, rowid))
        self.description += f"{table}.{column} row {rowid} = {value!r}"[:200]
        if table in CONTENT:
            cursor = self._connection.execute(f"SELECT * FROM {table} WHERE rowid = ?", (rowid,))
            row = dict(zip((one[0] for one in cursor.description), cursor.fetchone(), strict=True))
            try:
                digest = digest_again(table, row)
            except (zlib.error, ValueError):  # data that cannot be inflated have no digest
                return True
            self._connection.execute(f"UPDATE {table} SET digest = ? WHERE rowid = ?", (digest, rowid))
        return True


def digest_again(table: str, row: dict[str, Any]) -> bytes:
    """Return the digest of a row, as docs/case-file.md describes it."""

    def numbers(data: bytes) -> bytes:
        steps = np.frombuffer(zlib.decompress(data), dtype="<i4")
        return np.cumsum(steps, dtype=np.int64).astype("<i4").tobytes()

    if table == "array":
        return digest_of("array", row["dtype"], row["count"], row["width"], zlib.decompress(row["data"]))
    if table == "tile":
        return digest_of("tile", zlib.decompress(row["data"]))
    if table == "tree":
        return digest_of("tree", numbers(row["branches"]), zlib.decompress(row["facts"]))
    if table == "lumen":
        return digest_of("lumen", row["nz"], row["ny"], row["nx"], numbers(row["places"]), numbers(row["tiles"]))
    return digest_of(table, *(value for name, value in row.items() if name not in {"id", "digest"}))


def _places(value: Any) -> Any:
    """Return every container and key of a JSON value."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in list(pairs):
        yield value, key
        yield from _places(part)
