"""SQLite connections of a case file: settings, transactions, and errors as messages."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from carina.case.error_texts import CaseFileError, damage_error, unusable_file_error
from carina.case.sqlite_journals import check_files
from carina.disk import disk_trouble, open_regular
from carina.errors import CarinaError, DiskError

MAX_VALUE_BYTES: Final = 128 << 20
"""Maximum size of one text or blob in bytes; a chunk of a packed CT has at most half of this size."""
MAX_SQL_BYTES: Final = 20_000
OLDEST_SQLITE: Final = (3, 37, 0)
"""The first version of SQLite with STRICT tables, which enforce column types."""


def open_connection(path: Path | None, mode: str = "rw", *, immutable: bool = False) -> sqlite3.Connection:
    """Open a connection whose settings and limits do not depend on the content of the file.

    Parameters
    ----------
    path
        The case file; None opens a database in memory.
    mode
        ``ro``, ``rw`` or ``rwc``.
    immutable
        Ignore locks and journals, so that SQLite writes no file beside the case file.

    Returns
    -------
    sqlite3.Connection
        A connection in autocommit mode that several threads may use.

    Raises
    ------
    CaseFileError
        ``case.sqlite``: if the version of SQLite is too old.
    """
    if sqlite3.sqlite_version_info < OLDEST_SQLITE:
        raise CaseFileError(
            f"{path}: cases need SQLite 3.37 or newer; this Python has {sqlite3.sqlite_version}; use a newer Python",
            code="case.sqlite",
        )
    uri = ":memory:"
    if path is not None:
        uri = path.absolute().as_uri() + f"?mode={mode}" + ("&immutable=1" if immutable else "")
    connection = sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False, timeout=10.0)
    # Invalid UTF-8 is replaced, not refused: digests detect a damaged value, and a damaged label can still be shown.
    connection.text_factory = _decode_text
    try:
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)
        connection.setlimit(sqlite3.SQLITE_LIMIT_SQL_LENGTH, MAX_SQL_BYTES)
        connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 1)  # VACUUM attaches a temporary database
        connection.setlimit(sqlite3.SQLITE_LIMIT_COLUMN, 32)
        connection.setlimit(sqlite3.SQLITE_LIMIT_EXPR_DEPTH, 20)
        connection.setlimit(sqlite3.SQLITE_LIMIT_COMPOUND_SELECT, 4)
        connection.setlimit(sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH, 1)
        connection.setlimit(sqlite3.SQLITE_LIMIT_WORKER_THREADS, 0)
        for pragma in ("trusted_schema=OFF", "cell_size_check=ON", "mmap_size=0", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
    except BaseException:
        connection.close()
        raise
    return connection


def _decode_text(content: bytes) -> str:
    return content.decode(errors="replace")


def set_pragmas(connection: sqlite3.Connection) -> None:
    """Set the journal mode and the disk-flush settings of a live case file: docs/decisions/0127."""
    mode = connection.execute("PRAGMA journal_mode=WAL").fetchone()[0]
    if mode != "wal":
        # A network share does not support WAL; the rollback journal is safe there, but slower.
        connection.execute("PRAGMA journal_mode=DELETE")
    for pragma in ("synchronous=FULL", "fullfsync=ON", "checkpoint_fullfsync=ON", "journal_size_limit=16777216"):
        connection.execute(f"PRAGMA {pragma}")


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Run the block in a transaction, which is committed at its end and rolled back after an error."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            connection.execute("ROLLBACK")
        raise


@contextlib.contextmanager
def convert_disk_errors(path: Path) -> Iterator[None]:
    """Convert errors of SQLite and of the disk that are raised in the block to Carina's errors.

    Parameters
    ----------
    path
        Path of the case file for messages.
    """
    try:
        yield
    except CarinaError:
        raise
    except sqlite3.Error as error:
        raise _carina_error(error, path) from error
    except UnicodeError as error:
        raise unusable_file_error(
            path, f"it is damaged ({error}); open an earlier copy", code="case.damaged"
        ) from error
    except OSError as error:
        raise disk_trouble(error, "cannot use the case at", path) from error


def _carina_error(error: sqlite3.Error, path: Path) -> CarinaError:
    """Return the Carina error with a message for the user that corresponds to an error of SQLite."""
    code = getattr(error, "sqlite_errorcode", None)
    primary = None if code is None else code & 0xFF
    doing = f"cannot write the case to {path}"
    words = {
        sqlite3.SQLITE_FULL: ("disk.full", f"{doing}: the disk is full; free some space or choose another folder"),
        sqlite3.SQLITE_IOERR: (
            "disk.failed",
            f"{doing}: the disk reported an error; check the disk, or choose another folder",
        ),
        sqlite3.SQLITE_READONLY: ("disk.denied", f"{doing}: this file or folder is read-only; choose another folder"),
        sqlite3.SQLITE_CANTOPEN: (
            "disk.denied",
            f"cannot open the case {path}: the file or its folder is not accessible; "
            "check that it exists and that you have permission",
        ),
        sqlite3.SQLITE_BUSY: ("disk.failed", f"{doing}: another program is using it; close that program and try again"),
        sqlite3.SQLITE_PERM: ("disk.denied", f"{doing}: you do not have permission; choose another folder"),
    }
    if primary in words:
        kind, text = words[primary]
        return DiskError(text, code=kind)
    if primary == sqlite3.SQLITE_NOTADB:
        return unusable_file_error(path, "it is not a Carina case; choose a .carina file", code="case.not-a-case")
    return unusable_file_error(
        path,
        f"it is damaged ({error}); open an earlier copy, or rescue the intact parts of this one",
        code="case.damaged",
    )


@contextlib.contextmanager
def convert_value_errors() -> Iterator[None]:
    """Convert type and value errors that are raised in the block to an error ``case.damaged``.

    The block decodes content of a file, so such an error means that the file contains unexpected values.
    """
    try:
        yield
    except CarinaError:
        raise
    except (TypeError, ValueError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        found = f"other content ({type(error).__name__})"
        raise damage_error("content", "values as described in docs/case-file.md", found) from error


def check_header(path: Path) -> None:
    """Raise an error if a path is not an SQLite database, judged by its file type, its journals and its first bytes.

    Raises
    ------
    CaseFileError
        ``case.not-a-case``, or ``case.damaged`` if a journal beside the file is not a journal of SQLite.
    OSError
        If the file cannot be read.
    """
    check_files(path)
    with open_regular(path) as file:
        head = file.read(16)
    if head != b"SQLite format 3\x00":
        raise unusable_file_error(path, "it is not a Carina case; choose a .carina file", code="case.not-a-case")


def check_integrity(connection: sqlite3.Connection, path: Path) -> None:
    """Raise an error ``case.damaged`` if SQLite's quick check finds damage in the database.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    found = [row[0] for row in connection.execute("PRAGMA quick_check(3)")]
    if found != ["ok"]:
        raise unusable_file_error(
            path,
            f"it is damaged ({str(found[0])[:120]}); open an earlier copy, or rescue the intact parts of this one",
            code="case.damaged",
        )
