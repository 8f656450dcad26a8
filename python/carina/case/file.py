"""The case file: all that a person made of a CT, in one SQLite database (docs/case-file.md)."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from carina.case import facts as f
from carina.case.moment import Moment
from carina.case.packing import as_json, from_json
from carina.case.reading import CaseReader, Rows
from carina.case.schema import CONTENT, JOURNALS, check_schema, connected, make_tables
from carina.case.trouble import CaseFileError, damaged, refused
from carina.case.writing import CaseWriter
from carina.disk import ScratchFolder, disk_trouble
from carina.display import one_line
from carina.errors import CarinaError, DiskError, UsageError
from carina.volume import Volume

__all__ = ["CaseFile", "SourceFacts", "StepFacts"]

GEOMETRY_MM: Final = 1e-3
"""Two grids are the same where their voxels lie nearer than this."""
MAX_CONTENT_BYTES: Final = 2 << 30
"""Of all rows of a case without its CT."""
MAX_ROWS: Final = 2_000_000
MAX_STEPS: Final = 10_000
COPY_AGAIN: Final = 5
"""How often a file is copied again that was written to meanwhile."""
MAX_PATH_CHARS: Final = 4096


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class SourceFacts:
    """The CT that a case is of; nothing of the patient."""

    digest: str
    """Of its voxels (:func:`carina.volume.ct_digest`), hexadecimal."""
    shape_zyx: tuple[int, int, int]
    lps_from_ijk: NDArray[np.float64]
    """4x4."""
    is_hu: bool = True
    path: str | None = None
    """Where it lies, relative to the case file; None where that is not known."""
    choices: dict[str, Any] = field(default_factory=dict)
    """What was chosen when it was imported: plain JSON."""

    def __post_init__(self) -> None:
        absolute = self.path is not None and (
            PurePosixPath(self.path).is_absolute() or PureWindowsPath(self.path).anchor != ""
        )
        if absolute:
            raise UsageError("a case file holds the scan's place relative to itself; found an absolute path")

    @classmethod
    def of(
        cls, volume: Volume, digest: str, *, path: str | None = None, choices: dict[str, Any] | None = None
    ) -> SourceFacts:
        """Of a volume whose digest is known."""
        return cls(digest, volume.shape_zyx, volume.lps_from_ijk, volume.is_hu, path, dict(choices or {}))


@one_line
@dataclass(frozen=True, slots=True)
class StepFacts:
    """A step of the history, in words."""

    label: str
    command: str | None
    """The kind of command that asked for it (``edit_tree``); None where nobody asked by one."""
    at_s: float
    """Seconds since the case was begun."""
    holds: bool
    """False where it was taken back."""


class CaseFile:
    """An open case file: :meth:`create` or :meth:`open` one. May be used from several threads.

    Examples
    --------
    >>> import carina, tempfile
    >>> from pathlib import Path
    >>> volume = carina.generate_phantom(spacing_mm=3.0, generations=3).volume
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with CaseFile.create(Path(folder) / "one.carina", SourceFacts.of(volume, "00")) as case:
    ...         case.source.shape_zyx == volume.shape_zyx, case.history()
    (True, ())
    """

    def __init__(
        self, path: Path, connection: sqlite3.Connection, *, read_only: bool, copied: ScratchFolder | None
    ) -> None:
        """As :meth:`create` and :meth:`open` do."""
        self.path = path
        self.read_only = read_only
        self._copied = copied
        self._lock = threading.RLock()
        self._connection: sqlite3.Connection | None = connection
        self._writer: CaseWriter | None = None

    def __repr__(self) -> str:
        return f"CaseFile({str(self.path)!r}{', read only' if self.read_only else ''})"

    def __enter__(self) -> CaseFile:
        return self

    def __exit__(self, *_trouble: object) -> None:
        self.close()

    # ------------------------------------------------------------ opening

    @classmethod
    def create(cls, path: Path | str, source: SourceFacts) -> CaseFile:
        """Begin a case file; its journal stands beside it while it is open.

        Raises
        ------
        DiskError
            If it cannot be written, or a file is there.
        """
        place = Path(path)
        try:
            # For this person alone, and never in the place of another.
            os.close(os.open(place, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600))
        except OSError as error:
            raise disk_trouble(error, "cannot write the case", place) from error
        with _told(place):
            connection = connected(place, "rw")
            try:
                _set_up(connection)
                with _transaction(connection):
                    make_tables(connection)
                    _write_source(connection, source)
            except BaseException:
                connection.close()
                raise
        return cls(place, connection, read_only=False, copied=None)

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = False) -> CaseFile:
        """Open a case file, whoever made it.

        One that was not closed (a journal stands beside it) is looked through in a copy first. With ``read_only``
        nothing is written beside it, and its last committed state is read.

        Raises
        ------
        CaseFileError
            If it is none, or a newer Carina's (then ``read_only`` refuses, too), or damaged.
        DiskError
            If it cannot be read or written.
        """
        place = Path(path)
        with _told(place):
            _check_file(place)
            left = any(_beside(place, tail).exists() for tail in JOURNALS[:2])
            copied: ScratchFolder | None = None
            try:
                looked_at, immutable = place, True
                if left:
                    copied = ScratchFolder()
                    looked_at, immutable = _copied(place, copied.path), False
                connection = connected(looked_at, "rw" if left else "ro", immutable=immutable)
                try:
                    check_schema(connection, place)
                    if read_only or left:
                        _check_whole(connection, place)
                except BaseException:
                    connection.close()
                    raise
                if read_only:
                    return cls(place, connection, read_only=True, copied=copied)
                connection.close()
            except BaseException:
                if copied is not None:
                    copied.remove()
                raise
            if copied is not None:
                copied.remove()
            connection = connected(place, "rw")
            try:
                _set_up(connection)
                check_schema(connection, place)
            except BaseException:
                connection.close()
                raise
        return cls(place, connection, read_only=False, copied=None)

    def close(self) -> None:
        """Close it; its journal goes. Nothing if it is closed."""
        with self._lock:
            connection, self._connection = self._connection, None
            self._writer = None
            try:
                if connection is not None:
                    with contextlib.suppress(sqlite3.Error):
                        connection.close()
            finally:
                copied, self._copied = self._copied, None
                if copied is not None:
                    copied.remove()

    # ------------------------------------------------------------ the moment

    def save(self, moment: Moment) -> None:
        """Write a moment, whole or not at all; what is there already is not written again.

        Raises
        ------
        DiskError
            If it cannot be written: what was saved before stays.
        """
        with self._lock, _told(self.path):
            connection = self._writable()
            writer = self._needed_writer()
            try:
                with _transaction(connection):
                    writer.write(moment)
            except BaseException:
                # It may know rows that were taken back.
                self._writer = None
                raise
            writer.kept()

    def load(self, volume: Volume) -> Moment | None:
        """The moment that was saved last; None where none was.

        Nothing is found again: airways come with their tree as it was, and paths are calculated when they are first
        needed. Those of steps far from the present one are unfolded by undo.

        Parameters
        ----------
        volume
            The CT; on another order of axes, what lies in voxels is turned to it.

        Raises
        ------
        CaseFileError
            ``case.other-scan`` or ``case.damaged``.
        """
        with self._lock, _told(self.path):
            connection = self._open()
            self._check_scan(volume)
            rows = _content(connection)
            found = connection.execute("SELECT position, facts FROM moment").fetchone()
            if found is None:
                return None
            position, said = found
            count = connection.execute("SELECT count(*) FROM step").fetchone()[0]
            if not 1 <= count <= MAX_STEPS:
                raise damaged("the steps", f"1 to {MAX_STEPS}", str(count))
            numbered = connection.execute("SELECT n, label, command, at_s, document FROM step ORDER BY n").fetchall()
            first_n = numbered[0][0]
            if [row[0] for row in numbered] != list(range(first_n, first_n + count)):
                raise damaged("the steps", "numbers without a gap", "others")
            writer = None if self.read_only else self._needed_writer()
            with _no_surprise():
                reader = CaseReader(rows, volume, _ignored if writer is None else writer.know)
                facts: f.MomentFacts = from_json(said, f.decoders().moment, "the moment")
                moment = reader.moment([row[1:] for row in numbered], position, facts)
            if writer is not None:
                writer.reader = reader
                objects: list[object] = [moment, *moment.steps]
                writer.take_steps([(one, row[1:]) for one, row in zip(objects, numbered, strict=True)], first_n)
            return moment

    def history(self) -> tuple[StepFacts, ...]:
        """The steps in words, the oldest first, with those that were taken back; nothing large is read."""
        with self._lock, _told(self.path):
            connection = self._open()
            found = connection.execute("SELECT position FROM moment").fetchone()
            position = 0 if found is None else found[0]
            rows = connection.execute(
                "SELECT label, substr(command, 1, 200), at_s FROM step ORDER BY n LIMIT ?", (MAX_STEPS,)
            ).fetchall()
        return tuple(
            StepFacts(str(label), _kind_of(command), float(at_s), n < position)
            for n, (label, command, at_s) in enumerate(rows[1:])
        )

    @property
    def source(self) -> SourceFacts:
        """The CT that it is of."""
        with self._lock, _told(self.path):
            return _read_source(self._open())

    # ------------------------------------------------------------ inside

    def _check_scan(self, volume: Volume) -> None:
        source = _read_source(self._open())
        near = source.shape_zyx == volume.shape_zyx and _same_places(source, volume)
        if not near:
            raise refused(
                self.path,
                f"it is of another scan: expected {_grid_words(source.shape_zyx)} voxels where the case has them; "
                f"found {_grid_words(volume.shape_zyx)}; choose the scan that it was made of",
                code="case.other-scan",
            )

    def _needed_writer(self) -> CaseWriter:
        if self._writer is None:
            connection = self._open()
            self._writer = CaseWriter(connection)
        return self._writer

    def _open(self) -> sqlite3.Connection:
        if self._connection is None:
            raise CaseFileError(f"{self.path}: this case is closed; open it again", code="case.closed")
        return self._connection

    def _writable(self) -> sqlite3.Connection:
        if self.read_only:
            raise CaseFileError(
                f"{self.path}: this case was opened for reading; open it for writing, or save it elsewhere",
                code="case.read-only",
            )
        return self._open()


# ------------------------------------------------------------ connections


def _set_up(connection: sqlite3.Connection) -> None:
    """How the live file is written: docs/decisions/0051-a-case-is-a-database.md."""
    mode = connection.execute("PRAGMA journal_mode=WAL").fetchone()[0]
    if mode != "wal":
        # A share: there the ordinary journal is safe, if slower.
        connection.execute("PRAGMA journal_mode=DELETE")
    for pragma in ("synchronous=FULL", "fullfsync=ON", "checkpoint_fullfsync=ON", "journal_size_limit=16777216"):
        connection.execute(f"PRAGMA {pragma}")


@contextlib.contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            connection.execute("ROLLBACK")
        raise


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """What SQLite refuses, in our words."""
    try:
        yield
    except CarinaError:
        raise
    except sqlite3.Error as error:
        raise _in_words(error, path) from error
    except OSError as error:
        raise disk_trouble(error, "cannot use the case", path) from error


def _in_words(error: sqlite3.Error, path: Path) -> CarinaError:
    code = getattr(error, "sqlite_errorcode", None)
    primary = None if code is None else code & 0xFF
    doing = f"cannot write the case to {path}"
    words = {
        sqlite3.SQLITE_FULL: ("disk.full", f"{doing}: the disk is full; free some space or choose another folder"),
        sqlite3.SQLITE_IOERR: (
            "disk.failed",
            f"{doing}: the disk reports an error; check the disk, or choose another folder",
        ),
        sqlite3.SQLITE_READONLY: ("disk.denied", f"{doing}: this file or folder is read-only; choose another folder"),
        sqlite3.SQLITE_CANTOPEN: (
            "disk.denied",
            f"cannot open the case {path}: its file or folder cannot be used; check that it is there and yours",
        ),
        sqlite3.SQLITE_BUSY: ("disk.failed", f"{doing}: another program is using it; close that, and try again"),
        sqlite3.SQLITE_PERM: ("disk.denied", f"{doing}: you do not have permission; choose another folder"),
    }
    if primary in words:
        kind, said = words[primary]
        return DiskError(said, code=kind)
    if primary == sqlite3.SQLITE_NOTADB:
        return refused(path, "it is not a case that Carina saved; choose a .carina file", code="case.not-a-case")
    return refused(path, f"it is damaged ({error}); open an earlier copy", code="case.damaged")


@contextlib.contextmanager
def _no_surprise() -> Iterator[None]:
    """Whatever a file holds in the place of our values is damage."""
    try:
        yield
    except CarinaError:
        raise
    except (TypeError, ValueError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as trouble:
        raise damaged("its content", "values as docs/case-file.md says", type(trouble).__name__) from trouble


def _check_file(path: Path) -> None:
    with path.open("rb") as file:
        head = file.read(16)
    if head != b"SQLite format 3\x00":
        raise refused(path, "it is not a case that Carina saved; choose a .carina file", code="case.not-a-case")


def _check_whole(connection: sqlite3.Connection, path: Path) -> None:
    found = [row[0] for row in connection.execute("PRAGMA quick_check(3)")]
    if found != ["ok"]:
        raise refused(path, f"it is damaged ({str(found[0])[:120]}); open an earlier copy", code="case.damaged")


def _beside(path: Path, tail: str) -> Path:
    return path.with_name(path.name + tail)


def _copied(path: Path, folder: Path) -> Path:
    """The file with its journal in a folder of ours, as they were at one moment."""
    parts = [path, *(_beside(path, tail) for tail in JOURNALS[:2])]
    for _ in range(COPY_AGAIN):
        before = [_stamp(part) for part in parts]
        for part, stamp in zip(parts, before, strict=True):
            target = folder / ("case.carina" + part.name[len(path.name) :])
            target.unlink(missing_ok=True)
            if stamp is not None:
                shutil.copyfile(part, target)
        if [_stamp(part) for part in parts] == before:
            return folder / "case.carina"
    raise refused(path, "another program keeps writing to it; close it there, or wait a moment", code="case.read-only")


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


# ------------------------------------------------------------ rows


def _write_source(connection: sqlite3.Connection, source: SourceFacts) -> None:
    nz, ny, nx = source.shape_zyx
    matrix = np.ascontiguousarray(source.lps_from_ijk, dtype="<f8")
    if matrix.shape != (4, 4):
        raise UsageError(f"lps_from_ijk is a 4x4 matrix; found {matrix.shape}")
    connection.execute(
        "INSERT OR REPLACE INTO source (id, digest, nz, ny, nx, lps_from_ijk, is_hu, path, choices) "
        "VALUES (1, ?, ?, ?, ?, ?, ?, ?, ?)",
        (
            source.digest,
            nz,
            ny,
            nx,
            matrix.tobytes(),
            int(source.is_hu),
            source.path,
            as_json(source.choices).decode(),
        ),
    )


def _read_source(connection: sqlite3.Connection) -> SourceFacts:
    where = "the source"
    row = connection.execute("SELECT digest, nz, ny, nx, lps_from_ijk, is_hu, path, choices FROM source").fetchone()
    if row is None:
        raise damaged(where, "one row", "none")
    digest, nz, ny, nx, matrix, is_hu, path, choices = row
    if not all(isinstance(n, int) and 1 <= n <= 65_535 for n in (nz, ny, nx)):
        raise damaged(where, "a shape of 1 to 65535 voxels along each axis", f"{(nz, ny, nx)}"[:80])
    if not isinstance(matrix, bytes) or len(matrix) != 128:
        raise damaged(where, "a matrix of 128 bytes", str(type(matrix)))
    places = np.frombuffer(matrix, dtype="<f8").reshape(4, 4)
    if not np.isfinite(places).all() or np.abs(places).max() > 1e6 or abs(np.linalg.det(places[:3, :3])) < 1e-12:
        raise damaged(where, "a transform that can be inverted", "another matrix")
    if not isinstance(digest, str) or len(digest) > 128 or not (path is None or _is_path(path)):
        raise damaged(where, "a digest, and a relative path", "something else")
    facts = from_json(choices, f.decoders().choices, where)
    try:
        return SourceFacts(digest, (nz, ny, nx), places, bool(is_hu), path, facts)
    except UsageError as trouble:
        raise damaged(where, "a relative path", str(trouble)) from None


def _is_path(path: object) -> bool:
    return isinstance(path, str) and 0 < len(path) <= MAX_PATH_CHARS and "\x00" not in path


def _content(connection: sqlite3.Connection) -> Rows:
    """All rows of content, after their number and size were looked at."""
    total = 0
    for table in CONTENT:
        count = connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        if count > MAX_ROWS:
            raise damaged(table, f"at most {MAX_ROWS} rows", str(count))
    pages, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
    chunks = connection.execute("SELECT coalesce(sum(length(data)), 0) FROM ct").fetchone()[0]
    chunks += connection.execute("SELECT coalesce(sum(length(data)), 0) FROM recording_chunk").fetchone()[0]
    total = pages * size - chunks
    if total > MAX_CONTENT_BYTES:
        raise damaged("its content", f"at most {MAX_CONTENT_BYTES} bytes", str(total))
    rows: Rows = {}
    for table in CONTENT:
        rows[table] = {row[0]: row[1:] for row in connection.execute(f"SELECT * FROM {table}")}
    return rows


def _ignored(_kind: str, _value: object, _row: int) -> None:
    """A file that is only read need not know what came from it."""


def _same_places(source: SourceFacts, volume: Volume) -> bool:
    """Whether the corners of both grids lie at the same places."""
    nz, ny, nx = volume.shape_zyx
    corners = np.array([[i, j, k, 1.0] for i in (0, nx - 1) for j in (0, ny - 1) for k in (0, nz - 1)])
    off = corners @ (source.lps_from_ijk - volume.lps_from_ijk).T
    return bool(np.linalg.norm(off[:, :3], axis=1).max() <= GEOMETRY_MM)


def _grid_words(shape_zyx: tuple[int, int, int]) -> str:
    nz, ny, nx = shape_zyx
    return f"{nx} x {ny} x {nz}"


def _kind_of(command: object) -> str | None:
    """The kind of a command from how its JSON begins."""
    if not isinstance(command, str):
        return None
    _, mark, rest = command.partition('"type":"')
    kind = rest.partition('"')[0]
    return kind if mark and kind.isidentifier() else None
