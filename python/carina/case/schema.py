"""The tables of a case file, the check of a file's tables, and the migration of older files."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Final, Literal

from carina.case.error_texts import unusable_file_error

APPLICATION_ID: Final = 0x43415249
"""Value of SQLite's ``application_id`` in a case file: the letters ``CARI``."""
SCHEMA: Final = 2
Standing = Literal["ours", "older", "newer"]
# Rows of content are never changed and are found by their digest, so equal content is stored once.
_CONTENT = "id INTEGER PRIMARY KEY, digest BLOB NOT NULL UNIQUE"
TABLES: Final = {
    "source": """CREATE TABLE source (
  id INTEGER PRIMARY KEY CHECK (id = 1),
  digest TEXT NOT NULL,
  nz INTEGER NOT NULL, ny INTEGER NOT NULL, nx INTEGER NOT NULL,
  lps_from_ijk BLOB NOT NULL,
  is_hu INTEGER NOT NULL,
  path TEXT,
  choices TEXT NOT NULL
) STRICT""",
    "value": f"CREATE TABLE value ({_CONTENT}, kind TEXT NOT NULL, json TEXT NOT NULL) STRICT",
    "array": f"""CREATE TABLE array ({_CONTENT},
  dtype TEXT NOT NULL, count INTEGER NOT NULL, width INTEGER NOT NULL, data BLOB NOT NULL
) STRICT""",
    "branch": f"""CREATE TABLE branch ({_CONTENT},
  points INTEGER NOT NULL REFERENCES array, radius INTEGER NOT NULL REFERENCES array, wall INTEGER REFERENCES array
) STRICT""",
    "tree": f"""CREATE TABLE tree ({_CONTENT},
  num_branches INTEGER NOT NULL, branches BLOB NOT NULL, size INTEGER NOT NULL, facts BLOB NOT NULL
) STRICT""",
    "tile": f"CREATE TABLE tile ({_CONTENT}, data BLOB NOT NULL) STRICT",
    "lumen": f"""CREATE TABLE lumen ({_CONTENT},
  nz INTEGER NOT NULL, ny INTEGER NOT NULL, nx INTEGER NOT NULL,
  num_tiles INTEGER NOT NULL, places BLOB NOT NULL, tiles BLOB NOT NULL
) STRICT""",
    "tracker": f"""CREATE TABLE tracker ({_CONTENT},
  lumen INTEGER NOT NULL REFERENCES lumen, tree INTEGER NOT NULL REFERENCES tree,
  root_i INTEGER NOT NULL, root_j INTEGER NOT NULL, root_k INTEGER NOT NULL, levels TEXT NOT NULL,
  nodes INTEGER REFERENCES array, num_nodes INTEGER REFERENCES array
) STRICT""",
    "airways": f"""CREATE TABLE airways ({_CONTENT},
  base INTEGER REFERENCES airways, lumen INTEGER NOT NULL REFERENCES lumen, tree INTEGER NOT NULL REFERENCES tree,
  tracker INTEGER NOT NULL REFERENCES tracker, facts TEXT NOT NULL
) STRICT""",
    "sections": f"""CREATE TABLE sections ({_CONTENT},
  num_sections INTEGER NOT NULL, figures BLOB NOT NULL, rays BLOB NOT NULL
) STRICT""",
    "measured_branch": f"""CREATE TABLE measured_branch ({_CONTENT},
  sections INTEGER NOT NULL REFERENCES sections, flags BLOB NOT NULL, facts TEXT NOT NULL
) STRICT""",
    "measures": f"""CREATE TABLE measures ({_CONTENT},
  airways INTEGER NOT NULL UNIQUE REFERENCES airways, branches BLOB NOT NULL, facts TEXT NOT NULL
) STRICT""",
    "route": f"""CREATE TABLE route ({_CONTENT},
  points INTEGER NOT NULL REFERENCES array, cumulative_mm INTEGER NOT NULL REFERENCES array,
  radius_mm INTEGER NOT NULL REFERENCES array, wall_mm INTEGER NOT NULL REFERENCES array,
  generation INTEGER NOT NULL REFERENCES array, branch_ids INTEGER NOT NULL REFERENCES array,
  path_points INTEGER NOT NULL REFERENCES array, facts TEXT NOT NULL
) STRICT""",
    "document": f"""CREATE TABLE document ({_CONTENT},
  airways INTEGER REFERENCES airways, route INTEGER REFERENCES route,
  transfer INTEGER NOT NULL REFERENCES value, look INTEGER NOT NULL REFERENCES value,
  targets INTEGER NOT NULL REFERENCES value, keys INTEGER NOT NULL REFERENCES value, lumen_threshold REAL
) STRICT""",
    "step": """CREATE TABLE step (
  n INTEGER PRIMARY KEY, label TEXT NOT NULL, command TEXT, at_s REAL NOT NULL,
  document INTEGER NOT NULL REFERENCES document
) STRICT""",
    "moment": """CREATE TABLE moment (
  id INTEGER PRIMARY KEY CHECK (id = 1), position INTEGER NOT NULL, facts TEXT NOT NULL
) STRICT""",
    "recording": """CREATE TABLE recording (
  id INTEGER PRIMARY KEY, place INTEGER NOT NULL, name TEXT NOT NULL, words TEXT NOT NULL,
  begun_s REAL NOT NULL, length_s REAL NOT NULL, complete INTEGER NOT NULL
) STRICT""",
    "recording_chunk": """CREATE TABLE recording_chunk (
  recording INTEGER NOT NULL REFERENCES recording ON DELETE CASCADE, n INTEGER NOT NULL,
  size INTEGER NOT NULL, digest BLOB NOT NULL, data BLOB NOT NULL, PRIMARY KEY (recording, n)
) STRICT""",
    "extra": """CREATE TABLE extra (
  kind TEXT NOT NULL, n INTEGER NOT NULL, json TEXT NOT NULL, PRIMARY KEY (kind, n)
) STRICT""",
    "ct": """CREATE TABLE ct (
  n INTEGER PRIMARY KEY, first_k INTEGER NOT NULL, num_k INTEGER NOT NULL, digest BLOB NOT NULL, data BLOB NOT NULL
) STRICT""",
}
SINCE: Final = {"sections": 2, "measured_branch": 2, "measures": 2}
"""Version of the case file's schema that introduced a table, by table name; unlisted tables exist since version 1."""
CONTENT: Final = (
    "value", "array", "branch", "tree", "tile", "lumen", "tracker", "airways", "sections", "measured_branch",
    "measures", "route", "document",
)  # fmt: skip
"""Names of the content tables, in an order in which each table follows those that it refers to."""


def _add_measures(connection: sqlite3.Connection) -> None:
    """Migrate schema 1 to 2: add the tables of airway measures, which stay empty."""
    for name, since in SINCE.items():
        if since == 2:
            connection.execute(TABLES[name])


MIGRATIONS: Final[dict[int, Callable[[sqlite3.Connection], None]]] = {1: _add_measures}
"""Function that migrates a file to the next schema version, by the version that it migrates from."""


def make_tables(connection: sqlite3.Connection) -> None:
    """Create the tables of a case file in an empty database."""
    connection.execute(f"PRAGMA application_id={APPLICATION_ID}")
    for sql in TABLES.values():
        connection.execute(sql)
    connection.execute(f"PRAGMA user_version={SCHEMA}")


def check_schema(connection: sqlite3.Connection, path: Path) -> Standing:
    """Return whether a file has the present, an older or a newer schema; raise an error if its tables differ.

    A newer version of Carina may add tables, but no view, no trigger and no virtual table.

    Raises
    ------
    CaseFileError
        ``case.not-a-case``, ``case.newer`` or ``case.damaged``.
    sqlite3.Error
        If SQLite cannot read the file.
    """
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if application != APPLICATION_ID:
        raise unusable_file_error(path, "it is not a Carina case; choose a .carina file", code="case.not-a-case")
    found = set(connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_master LIMIT 200"))
    ours = _listed_tables(SCHEMA)
    if version == SCHEMA and found == ours:
        return "ours"
    if version > SCHEMA:
        if found >= ours and all(_is_table_without_code(*row) for row in found - ours):
            return "newer"
        raise unusable_file_error(
            path,
            f"a newer version of Carina saved it (schema {version}; this version reads {SCHEMA}); update Carina",
            code="case.newer",
        )
    if version in MIGRATIONS and found == _listed_tables(version):
        return "older"
    schema = version if version in MIGRATIONS else SCHEMA
    raise unusable_file_error(
        path,
        f"its tables are not those of schema {schema}, so it is damaged or was changed by another program; "
        "open an earlier copy",
        code="case.damaged",
    )


def _is_table_without_code(kind: object, name: object, _table: object, sql: object) -> bool:
    if kind == "index":
        return sql is None and str(name).startswith("sqlite_autoindex_")
    plain = kind == "table" and isinstance(sql, str) and sql.startswith("CREATE TABLE ") and sql.endswith(" STRICT")
    return plain and "GENERATED" not in str(sql).upper() and " AS " not in str(sql).upper()


def write_migrated_copy(connection: sqlite3.Connection, target: Path) -> None:
    """Write a copy of a file with an older schema, migrated to the current schema, to another path."""
    with contextlib.closing(sqlite3.connect(target, isolation_level=None)) as made:
        connection.backup(made)
        made.execute("PRAGMA journal_mode=DELETE")
        while (version := made.execute("PRAGMA user_version").fetchone()[0]) < SCHEMA:
            MIGRATIONS[version](made)
            made.execute(f"PRAGMA user_version={version + 1}")
        check_schema(made, target)


def _listed_tables(schema: int) -> set[tuple[str, str, str, str | None]]:
    """Return the tables and indexes that a file of a schema contains, as SQLite lists them."""
    with contextlib.closing(sqlite3.connect(":memory:")) as empty:
        for name, sql in TABLES.items():
            if SINCE.get(name, 1) <= schema:
                empty.execute(sql)
        return set(empty.execute("SELECT type, name, tbl_name, sql FROM sqlite_master"))
