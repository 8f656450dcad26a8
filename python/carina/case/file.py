"""The case file: all work on a CT, in one SQLite database (docs/case-file.md)."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sqlite3
import threading
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from carina.case import facts as f
from carina.case.bounds import (
    MAX_LABEL_CHARS,
    MAX_S,
    MAX_WHOLE,
    bounded_number,
    bounded_text,
    bounded_whole,
    check_plain,
)
from carina.case.database import (
    check_header,
    check_whole,
    connected,
    no_surprise,
    set_up,
    told,
    transaction,
)
from carina.case.journals import copied_with_journal, has_journal, set_foreign_aside
from carina.case.moment import Moment
from carina.case.packed_ct import packed_volume, write_ct
from carina.case.packing import MAX_JSON_BYTES, as_checked_json, from_json
from carina.case.reading import CaseReader, Rows
from carina.case.recordings import RecordingFacts, RecordingTable, RecordingWriter
from carina.case.save_mark import SaveMark, read_save_mark, write_save_mark
from carina.case.schema import CONTENT, check_schema, make_tables, migrated
from carina.case.source import SourceFacts, grid_words, read_source, turn_between, write_source
from carina.case.summary import CaseSummary, read_summary
from carina.case.sweeping import sweep
from carina.case.trouble import CaseFileError, damaged, refused
from carina.case.writing import CaseWriter
from carina.disk import Placement, ScratchFolder, disk_trouble, drafted, write_whole
from carina.disk.placing import move_to_new_name
from carina.display import one_line
from carina.installation import carina_command
from carina.navigate import Recording
from carina.volume import Volume

__all__ = ["CaseFile", "StepFacts", "all_content", "migrate", "migrate_live", "step_rows"]

MAX_CONTENT_BYTES: Final = 2 << 30
"""Of all rows of a case without its CT."""
MAX_IN_MEMORY_BYTES: Final = 256 << 20
"""A copy that is larger is made on the disk; without its CT hardly any case is."""
MAX_ROWS: Final = 2_000_000
MAX_STEPS: Final = 10_000


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
        self,
        path: Path,
        connection: sqlite3.Connection,
        *,
        read_only: bool = False,
        note: str | None = None,
        scratch: ScratchFolder | None = None,
    ) -> None:
        """As :meth:`create` and :meth:`open` do."""
        self.path = path
        self.read_only = read_only
        self.note = note
        """What a person should know of it, in a sentence: a newer Carina saved it."""
        self._scratch = scratch
        self._lock = threading.RLock()
        self._connection: sqlite3.Connection | None = connection
        self._writer: CaseWriter | None = None
        self._has_orphans = False

    def __repr__(self) -> str:
        return f"CaseFile({str(self.path)!r}{', read only' if self.read_only else ''})"

    def __enter__(self) -> CaseFile:
        return self

    def __exit__(self, *_trouble: object) -> None:
        self.close()

    # ------------------------------------------------------------ opening

    @classmethod
    def create(cls, path: Path | str, source: SourceFacts) -> CaseFile:
        """Create a case file that only its user may read; a journal is beside the file while it is open.

        Raises
        ------
        DiskError
            If it cannot be written, or a file is there.
        """
        place = Path(path)
        try:
            if place.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
            # Whole from its first moment on: what a crash leaves is no file, or a case.
            with told(place), contextlib.closing(_begun(source)) as begun:
                content = begun.serialize()
            write_whole(place, content, what="the case", private=True, lasting=True, placement=move_to_new_name)
        except OSError as error:
            raise disk_trouble(error, "cannot write the case to", place) from error
        with told(place):
            connection = connected(place, "rw")
            try:
                set_up(connection)
            except BaseException:
                connection.close()
                raise
        return cls(place, connection)

    @classmethod
    def in_memory(cls, source: SourceFacts) -> CaseFile:
        """Begin a case file that no disk has to take, until it is written by :meth:`write_copy`."""
        return cls(Path("case.carina"), _begun(source))

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = False) -> CaseFile:
        """Open a case file of any user or version.

        Parameters
        ----------
        read_only
            Nothing is written to it or beside it, and its last committed state is read. A newer Carina's file is
            opened so in any case, where it has all that this one knows; :attr:`note` says it. One of an older Carina is
            then migrated in a copy.

        Notes
        -----
        One that was not closed (a journal stands beside it) is looked through in a copy before its journal is replayed.

        Raises
        ------
        CaseFileError
            ``case.not-a-case``, ``case.damaged``, ``case.newer``, ``case.older`` (to be written: migrate it first).
        DiskError
            If it cannot be read or written.
        """
        place = Path(path)
        with told(place), contextlib.ExitStack() as undo:
            check_header(place)
            left = has_journal(place)
            scratch: ScratchFolder | None = None
            looked_at = place
            if left:
                scratch = ScratchFolder()
                undo.callback(scratch.remove)
                looked_at = copied_with_journal(place, scratch.path)
            connection = undo.enter_context(
                contextlib.closing(connected(looked_at, "rw" if left else "ro", immutable=not left))
            )
            standing = check_schema(connection, place)
            if standing != "ours" or read_only or left:
                check_whole(connection, place)
            if standing == "older":
                if not read_only:
                    command = carina_command("case", "migrate")
                    raise refused(
                        place,
                        f"an older version of Carina saved it; migrate it with `{command}`",
                        code="case.older",
                    )
                if scratch is None:
                    scratch = ScratchFolder()
                    undo.callback(scratch.remove)
                migrated(connection, scratch.path / "migrated.carina")
                connection.close()
                connection = undo.enter_context(
                    contextlib.closing(connected(scratch.path / "migrated.carina", "ro", immutable=True))
                )
            if read_only or standing == "newer":
                undo.pop_all()
                note = None
                if standing == "newer":
                    note = (
                        "a newer version of Carina saved this case: it can be viewed here, but changed only with "
                        "that version"
                    )
                return cls(place, connection, read_only=True, note=note, scratch=scratch)
        with told(place):
            set_foreign_aside(place)
            connection = connected(place, "rw")
            try:
                set_up(connection)
                check_schema(connection, place)
            except BaseException:
                connection.close()
                raise
        return cls(place, connection)

    def close(self) -> None:
        """Close it; its journal goes. Nothing if it is closed."""
        with self._lock:
            connection, self._connection = self._connection, None
            self._writer = None
            try:
                if connection is not None:
                    # What is not reached any more costs room alone: trouble here loses nothing.
                    with contextlib.suppress(sqlite3.Error, CaseFileError):
                        if self._has_orphans and not self.read_only:
                            with transaction(connection):
                                sweep(connection, all_content(connection))
                    with contextlib.suppress(sqlite3.Error):
                        connection.close()
            finally:
                scratch, self._scratch = self._scratch, None
                if scratch is not None:
                    scratch.remove()

    # ------------------------------------------------------------ the moment

    def save(self, moment: Moment) -> None:
        """Write a moment, whole or not at all; what is there already is not written again.

        Raises
        ------
        DiskError
            If it cannot be written: what was saved before stays.
        """
        with self._lock, told(self.path):
            connection = self._writable()
            writer = self._needed_writer()
            try:
                with transaction(connection):
                    writer.write(moment)
            except BaseException:
                # It may know rows that were taken back.
                self._writer = None
                raise
            writer.kept()
            self._has_orphans = True

    def load(self, volume: Volume) -> Moment:
        """Return the moment that was saved last.

        Nothing is found again: airways come with their tree as it was, and paths are calculated when they are first
        needed. Those of steps far from the present one are :class:`carina.track.FoldedAirways`.

        Parameters
        ----------
        volume
            The CT, whose voxels the caller has compared by their digest. Where its axes are in another order than when
            the case was saved, what lies in voxels is turned to it.

        Raises
        ------
        CaseFileError
            ``case.other-scan``, ``case.damaged``, or ``case.empty``: nothing was saved yet.
        """
        with self._lock, told(self.path):
            connection = self._open()
            source = read_source(connection)
            turn = turn_between(source, volume)
            if turn is None:
                raise refused(
                    self.path,
                    f"it belongs to another scan, whose grid ({grid_words(source.shape_zyx)} voxels) differs from this "
                    f"one's ({grid_words(volume.shape_zyx)} voxels) in size or position; choose the scan that the case "
                    "was made from",
                    code="case.other-scan",
                )
            found = connection.execute("SELECT position, facts FROM moment").fetchone()
            if found is None:
                raise refused(self.path, "nothing has been saved in it yet; open the scan instead", code="case.empty")
            rows = all_content(connection)
            numbered = step_rows(connection)
            writer = None if self.read_only or not turn.is_none else self._needed_writer()
            with self._newer_in_words(), no_surprise():
                reader = CaseReader(rows, volume, _ignored if writer is None else writer.know, turn)
                facts: f.MomentFacts = from_json(found[1], f.decoders().moment, "current state")
                moment = reader.moment([row[1:] for row in numbered], found[0], facts)
            if writer is not None:
                writer.reader = reader
                objects: list[object] = [moment, *moment.steps]
                writer.take_steps([(one, row[1:]) for one, row in zip(objects, numbered, strict=True)], numbered[0][0])
            return moment

    def history(self) -> tuple[StepFacts, ...]:
        """Return the labels and facts of all steps, the oldest first, undone ones included; read nothing large."""
        with self._lock, told(self.path):
            connection = self._open()
            found = connection.execute("SELECT position FROM moment").fetchone()
            position = 0 if found is None else found[0]
            rows = connection.execute(
                "SELECT n, substr(label, 1, ?), substr(command, 1, 200), at_s FROM step ORDER BY n LIMIT ?",
                (MAX_LABEL_CHARS + 1, MAX_STEPS),
            ).fetchall()
        with no_surprise():
            for number, label, _, at_s in rows:
                check_step(number, label, at_s)
            return tuple(
                StepFacts(label, _kind_of(command), at_s, n < position)
                for n, (_, label, command, at_s) in enumerate(rows[1:])
            )

    def summary(self) -> CaseSummary:
        """Return a summary for the list of cases; read nothing large and no CT."""
        with self._lock, told(self.path), no_surprise():
            return read_summary(self._open())

    # ------------------------------------------------------------ beside it

    @property
    def source(self) -> SourceFacts:
        """The CT that it is of."""
        with self._lock, told(self.path):
            return read_source(self._open())

    @property
    def digest(self) -> str:
        """Of the voxels of the CT that it is of."""
        return self.source.digest

    @property
    def save_mark(self) -> SaveMark | None:
        """Mark of the save that wrote this named file; None for a live file and for a file of an older version."""
        with self._lock, told(self.path):
            return read_save_mark(self._open())

    def pack(self, volume: Volume) -> None:
        """Put the CT into this file: lossless, in pieces with checksums.

        Raises
        ------
        DiskError
            If it cannot be written.
        UsageError
            ``case.other-scan``: if it is not the case's.
        """
        with self._lock, told(self.path):
            connection = self._writable()
            with transaction(connection):
                write_ct(connection, volume)

    @property
    def holds_ct(self) -> bool:
        """Whether the CT was packed with the case."""
        with self._lock, told(self.path):
            return self._open().execute("SELECT 1 FROM ct LIMIT 1").fetchone() is not None

    def packed_volume(self) -> Volume | None:
        """Return the CT that was packed with the case; None without a packed CT.

        Raises
        ------
        CaseFileError
            ``case.damaged``.
        """
        with self._lock, told(self.path), no_surprise():
            return packed_volume(self._open())

    def set_source_path(self, path: str | None) -> None:
        """Store the place of the scan relative to the case file; None where the place is unknown."""
        with self._lock, told(self.path):
            connection = self._writable()
            with transaction(connection):
                write_source(connection, replace(read_source(connection), path=path))

    def extra(self, kind: str) -> tuple[Any, ...]:
        """Return the extra values of a kind (a plan, a report, scores), in the order of their numbers."""
        with self._lock, told(self.path):
            rows = self._open().execute("SELECT json FROM extra WHERE kind = ? ORDER BY n", (kind,)).fetchall()
            where = f"extra data of kind {kind[:80]}"
            found = tuple(from_json(said, f.decoders().extra, where) for (said,) in rows)
            check_plain(found, where, most_chars=MAX_JSON_BYTES)
            return found

    def set_extra(self, kind: str, values: tuple[Any, ...]) -> None:
        """Keep plain JSON values under a word, in the place of those before."""
        with self._lock, told(self.path):
            connection = self._writable()
            with transaction(connection):
                connection.execute("DELETE FROM extra WHERE kind = ?", (kind,))
                for n, value in enumerate(values):
                    row = (kind, n, as_checked_json(value, f.decoders().extra, kind))
                    connection.execute("INSERT INTO extra (kind, n, json) VALUES (?, ?, ?)", row)

    # ------------------------------------------------------------ recordings

    def record(self, name: str, *, begun_s: float) -> RecordingWriter:
        """Begin a recording: a text file for :class:`carina.navigate.Recorder`.

        What is written to it is kept in memory until :meth:`RecordingWriter.keep` puts it into the file, in pieces of
        at most a second: whoever flies never waits for a disk.

        Parameters
        ----------
        begun_s
            Seconds since the case was begun.
        """
        with self._lock, told(self.path):
            return RecordingWriter(name, begun_s, self._table())

    def keep_recording(self, recording: RecordingWriter) -> None:
        """Put what was recorded since the last call into the file, in pieces of at most a second.

        Raises
        ------
        DiskError
            If it cannot be written: it stays in memory.
        """
        with self._lock, told(self.path):
            self._writable()
            recording.keep(self._table())

    def recordings(self) -> tuple[RecordingFacts, ...]:
        """Return the facts of all recordings, in their order."""
        with self._lock, told(self.path):
            return self._table().all()

    def recording(self, recording_id: int) -> Recording:
        """One of them, to be flown again.

        Raises
        ------
        UsageError
            ``case.recording``: if there is none of that number.
        CaseFileError, VolumeImportError
            If it is damaged, or no recording.
        """
        with self._lock, told(self.path):
            return self._table().read(recording_id)

    def recording_text(self, recording_id: int) -> str:
        """One of them as the file that other programs read (``carina-recording``).

        Raises
        ------
        UsageError, CaseFileError
            As :meth:`recording`.
        """
        with self._lock, told(self.path):
            return self._table().text(recording_id)

    def set_recordings(self, wanted: Sequence[RecordingFacts], *, removed: Collection[int] = ()) -> None:
        """Have the recordings called, described and ordered as these, without the removed ones.

        What is in neither stays, and nothing is written where all is so already.

        Raises
        ------
        DiskError
            If it cannot be written.
        """
        with self._lock, told(self.path):
            self._table().become(wanted, removed)

    def change_recording(self, recording_id: int, *, name: str | None = None, words: str | None = None) -> None:
        """Call a recording otherwise, or say something about it; None leaves that as it is."""
        with self._lock, told(self.path):
            self._table().change(recording_id, name=name, words=words)

    def order_recordings(self, recording_ids: Sequence[int]) -> None:
        """Have the recordings in this order: each by its number, once."""
        with self._lock, told(self.path):
            self._table().order(recording_ids)

    def forget_recording(self, recording_id: int) -> None:
        """Take a recording away."""
        with self._lock, told(self.path):
            self._table().forget(recording_id)

    def _table(self) -> RecordingTable:
        return RecordingTable(self._open, self._writable, self._lock, self.path)

    # ------------------------------------------------------------ copies

    def write_copy(
        self,
        path: Path | str,
        *,
        ct_place: str | None = None,
        volume: Volume | None = None,
        private: bool = False,
        save_mark: SaveMark | None = None,
        placement: Placement | None = None,
    ) -> None:
        """Write the case as one whole file, without a journal, to be named, shared and backed up.

        The copy is made in memory, or in a temporary folder if it is large, and is then moved to its path. No database
        is ever open on a network share, and a copy on another disk needs no space on a full disk.

        Parameters
        ----------
        ct_place
            Path of the scan relative to the copy; None if unknown.
        volume
            The CT, to be packed into the copy: lossless, in pieces with checksums.
        private
            Whether only the user may read the copy, as for a live file.
        save_mark
            Mark that the copy gets, to identify this save; None stores no mark.
        placement
            Moves the complete copy to its path; None replaces whatever file is there.

        Raises
        ------
        DiskError
            If the copy cannot be written; a former file at the path stays.
        UsageError
            ``case.other-scan``: if ``volume`` is not the case's.
        CarinaError
            As ``placement`` raises; a former file at the path stays.
        """
        target = Path(path)
        with self._lock, told(self.path):
            pages, size = (self._open().execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
        if volume is None and pages * size <= MAX_IN_MEMORY_BYTES:
            with told(self.path), contextlib.closing(connected(None)) as copy:
                self._back_up(copy, ct_place, save_mark)
                content = copy.serialize()
            write_whole(target, content, what="the case", private=private, lasting=True, placement=placement)
            return
        with ScratchFolder() as folder:
            made = folder / "copy.carina"
            with told(made), contextlib.closing(connected(made, "rwc")) as copy:
                self._back_up(copy, ct_place, save_mark)
                if volume is not None:
                    with transaction(copy):
                        write_ct(copy, volume)
            needed_bytes = made.stat().st_size
            with (
                drafted(
                    target,
                    what="the case",
                    needed_bytes=needed_bytes,
                    private=private,
                    lasting=True,
                    placement=placement,
                ) as file,
                made.open("rb") as whole,
            ):
                shutil.copyfileobj(whole, file, 1 << 20)

    def _back_up(self, copy: sqlite3.Connection, ct_place: str | None, save_mark: SaveMark | None) -> None:
        """Copy the whole case, without unreferenced rows and without a journal."""
        with self._lock:
            self._open().backup(copy)
        copy.execute("PRAGMA journal_mode=DELETE")
        # Until it is whole it may be thrown away.
        copy.execute("PRAGMA synchronous=OFF")
        with transaction(copy):
            write_source(copy, replace(read_source(copy), path=ct_place))
            write_save_mark(copy, save_mark)
            sweep(copy, all_content(copy))
        copy.execute("VACUUM")

    # ------------------------------------------------------------ inside

    @contextlib.contextmanager
    def _newer_in_words(self) -> Iterator[None]:
        """Replace a damage error by an update notice if a newer version of Carina wrote the file."""
        try:
            yield
        except CaseFileError as trouble:
            if self.note is None or trouble.code != "case.damaged":
                raise
            raise refused(
                self.path,
                f"a newer version of Carina saved it, with content that this version cannot read; "
                f"update Carina ({trouble})",
                code="case.newer",
            ) from trouble

    def _needed_writer(self) -> CaseWriter:
        if self._writer is None:
            self._writer = CaseWriter(self._open())
        return self._writer

    def _open(self) -> sqlite3.Connection:
        if self._connection is None:
            raise CaseFileError(f"{self.path}: this case is closed; open it again", code="case.closed")
        return self._connection

    def _writable(self) -> sqlite3.Connection:
        if self.read_only:
            raise CaseFileError(
                f"{self.path}: this case is open for reading only; open it for writing, or save a copy elsewhere",
                code="case.read-only",
            )
        return self._open()


def migrate(path: Path | str, target: Path | str) -> None:
    """Write a case of an older version of Carina to a new file in the present format; the original stays unchanged.

    Raises
    ------
    CaseFileError
        As :meth:`CaseFile.open`.
    DiskError
        If it cannot be written, or a file is at the target.
    """
    with CaseFile.open(path, read_only=True) as case:
        case.write_copy(target, ct_place=case.source.path, placement=move_to_new_name)


def migrate_live(path: Path) -> Path:
    """Have a live file of an older Carina be one of this, in its place; whoever calls owns the case.

    At each moment one of the two lies there whole.

    Returns
    -------
    Path
        Where it lies as it was.

    Raises
    ------
    CaseFileError
        As :meth:`CaseFile.open`.
    DiskError
        If it cannot be written; it stays as it was.
    """
    with CaseFile.open(path, read_only=True) as case, told(path):
        if has_journal(path):
            # Looked through in a copy just now: what stands in its journal goes into the file.
            with contextlib.closing(connected(path, "rw")) as live:
                live.execute("PRAGMA journal_mode=DELETE")
        with contextlib.closing(connected(path, "ro", immutable=True)) as old:
            schema = old.execute("PRAGMA user_version").fetchone()[0]
        before = path.with_name(f"{path.stem}-schema-{schema}{path.suffix}")
        size = path.stat().st_size
        with (
            drafted(before, what="the case", needed_bytes=size, private=True, lasting=True) as file,
            path.open("rb") as whole,
        ):
            shutil.copyfileobj(whole, file, 1 << 20)
        case.write_copy(path, ct_place=case.source.path, private=True)
    return before


def _begun(source: SourceFacts) -> sqlite3.Connection:
    """Create a case in memory in which nothing was done."""
    connection = connected(None)
    with transaction(connection):
        make_tables(connection)
        write_source(connection, source)
    return connection


def all_content(connection: sqlite3.Connection) -> Rows:
    """All rows of content, after their number and size were looked at.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if there are too many.
    """
    for table in CONTENT:
        count = connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        if count > MAX_ROWS:
            raise damaged(table, f"at most {MAX_ROWS} rows", str(count))
    pages, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
    chunks = sum(
        connection.execute(f"SELECT coalesce(sum(length(data)), 0) FROM {table}").fetchone()[0]
        for table in ("ct", "recording_chunk")
    )
    if pages * size - chunks > MAX_CONTENT_BYTES:
        raise damaged("content", f"at most {MAX_CONTENT_BYTES} bytes", str(pages * size - chunks))
    return {table: {row[0]: row[1:] for row in connection.execute(f"SELECT * FROM {table}")} for table in CONTENT}


def step_rows(connection: sqlite3.Connection) -> list[tuple[Any, ...]]:
    """Return the steps: number, label, command, seconds, document.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if there are too many, or one is missing.
    """
    count = connection.execute("SELECT count(*) FROM step").fetchone()[0]
    if not 1 <= count <= MAX_STEPS:
        raise damaged("history", f"1 to {MAX_STEPS} steps", str(count))
    sql = "SELECT n, substr(label, 1, ?), command, at_s, document FROM step ORDER BY n"
    rows = connection.execute(sql, (MAX_LABEL_CHARS + 1,)).fetchall()
    for row in rows:
        check_step(row[0], row[1], row[3])
    if [row[0] for row in rows] != list(range(rows[0][0], rows[0][0] + count)):
        raise damaged("history", "consecutive step numbers", "a gap")
    return rows


def check_step(number: int, label: object, at_s: object) -> None:
    """Check the columns of a step that have no digest.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    bounded_whole(number, "number of a step", -MAX_WHOLE, MAX_WHOLE)
    bounded_text(label, f"label of step {number}", MAX_LABEL_CHARS)
    bounded_number(at_s, f"time of step {number}", 0.0, MAX_S)


def _ignored(_kind: str, _value: object, _row: int) -> None:
    """Ignore a read row: a file that is only read needs no record of its rows."""


def _kind_of(command: object) -> str | None:
    """Return the kind of a command from the beginning of its JSON, by its present name."""
    if not isinstance(command, str):
        return None
    _, mark, rest = command.partition('"type":"')
    kind = rest.partition('"')[0]
    return f.EARLIER_NAMES.get(kind, kind) if mark and kind.isidentifier() else None
