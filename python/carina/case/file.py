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

from carina.case import json_records as f
from carina.case.bounds import MAX_LABEL_CHARS, check_plain
from carina.case.checked_rows import MAX_STEPS, all_content, check_step, command_type_name, step_rows
from carina.case.compression import MAX_JSON_BYTES, as_checked_json, from_json
from carina.case.database import (
    check_header,
    check_integrity,
    convert_disk_errors,
    convert_value_errors,
    open_connection,
    set_pragmas,
    transaction,
)
from carina.case.error_texts import CaseFileError, unusable_file_error
from carina.case.packed_ct import packed_volume, write_ct
from carina.case.reading import CaseReader
from carina.case.recordings import RecordingFacts, RecordingTable, RecordingWriter
from carina.case.save_mark import SaveMark, read_save_mark, write_save_mark
from carina.case.schema import check_schema, make_tables, write_migrated_copy
from carina.case.source import (
    SourceFacts,
    axis_permutation,
    grid_text,
    inserted_structures,
    read_source,
    write_source,
)
from carina.case.sqlite_journals import copied_with_journal, has_journal, rename_foreign_file
from carina.case.stored_state import Moment
from carina.case.summary import CaseSummary, read_summary
from carina.case.unused_content import delete_unreferenced_rows
from carina.case.writing import CaseWriter
from carina.disk import Placement, ScratchFolder, disk_trouble, drafted, write_whole
from carina.disk.move_files import move_to_new_name
from carina.display import one_line
from carina.installation import carina_command
from carina.navigate import Recording
from carina.volume import Volume

MAX_IN_MEMORY_BYTES: Final = 256 << 20
"""Maximum size in bytes of a case that is copied in memory; a larger case is copied on the disk."""


@one_line
@dataclass(frozen=True, slots=True)
class StepFacts:
    """Label, command and time of a step of the history."""

    label: str
    command: str | None
    """Type of the command that caused the step (``edit_tree``); None if no command caused it."""
    at_s: float
    """Seconds since the creation of the case."""
    holds: bool
    """Whether the step is in effect; False if the user has undone the step."""


class CaseFile:
    """An open case file, made by :meth:`create`, :meth:`in_memory` or :meth:`open`; several threads may use it.

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
        """Wrap an open connection; :meth:`create` and :meth:`open` call this."""
        self.path = path
        self.read_only = read_only
        self.note = note
        """Message for the user if a newer version of Carina saved the file, otherwise None."""
        self._scratch = scratch
        self._lock = threading.RLock()
        self._connection: sqlite3.Connection | None = connection
        self._writer: CaseWriter | None = None
        self._has_orphans = False

    def __repr__(self) -> str:
        """Return the path of the file and whether it is open for reading only."""
        return f"CaseFile({str(self.path)!r}{', read only' if self.read_only else ''})"

    def __enter__(self) -> CaseFile:
        """Return the open case for a ``with`` block."""
        return self

    def __exit__(self, *_trouble: object) -> None:
        """Close the case at the end of a ``with`` block."""
        self.close()

    @classmethod
    def create(cls, path: Path | str, source: SourceFacts) -> CaseFile:
        """Create a case file that only its user may read; a journal exists beside the file while it is open.

        Parameters
        ----------
        path
            The new file.
        source
            Description of the CT.

        Returns
        -------
        CaseFile
            The open case, without any step.

        Raises
        ------
        DiskError
            If the file cannot be written, or already exists.
        """
        place = Path(path)
        try:
            if place.exists():
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
            # The database is built in memory and written atomically, so a crash leaves either no file or a complete
            # case.
            with convert_disk_errors(place), contextlib.closing(_new_in_memory_case(source)) as begun:
                content = begun.serialize()
            write_whole(place, content, what="the case", private=True, lasting=True, placement=move_to_new_name)
        except OSError as error:
            raise disk_trouble(error, "cannot write the case to", place) from error
        with convert_disk_errors(place):
            connection = open_connection(place, "rw")
            try:
                set_pragmas(connection)
            except BaseException:
                connection.close()
                raise
        return cls(place, connection)

    @classmethod
    def in_memory(cls, source: SourceFacts) -> CaseFile:
        """Create a case in memory only; :meth:`write_copy` writes it to a file."""
        return cls(Path("case.carina"), _new_in_memory_case(source))

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = False) -> CaseFile:
        """Open a case file of any user and version.

        Parameters
        ----------
        path
            The case file.
        read_only
            Read the last committed state, and write neither to the file nor beside it. A file of a newer version of
            Carina is always opened in this way, with the content that this version knows; :attr:`note` then states it.
            A file of an older version is migrated in a temporary copy.

        Returns
        -------
        CaseFile
            The open case.

        Raises
        ------
        CaseFileError
            ``case.not-a-case``, ``case.damaged``, ``case.newer``, or ``case.older``: a file of an older version must be
            migrated before it can be written.
        DiskError
            If the file cannot be read or written.

        Notes
        -----
        A file that was not closed has a journal beside it. Such a file is checked in a copy before its journal is
        replayed.
        """
        place = Path(path)
        with convert_disk_errors(place), contextlib.ExitStack() as undo:
            check_header(place)
            left = has_journal(place)
            scratch: ScratchFolder | None = None
            looked_at = place
            if left:
                scratch = ScratchFolder()
                undo.callback(scratch.remove)
                looked_at = copied_with_journal(place, scratch.path)
            connection = undo.enter_context(
                contextlib.closing(open_connection(looked_at, "rw" if left else "ro", immutable=not left))
            )
            standing = check_schema(connection, place)
            if standing != "ours" or read_only or left:
                check_integrity(connection, place)
            if standing == "older":
                if not read_only:
                    command = carina_command("case", "migrate")
                    raise unusable_file_error(
                        place,
                        f"an older version of Carina saved it; migrate it with `{command}`",
                        code="case.older",
                    )
                if scratch is None:
                    scratch = ScratchFolder()
                    undo.callback(scratch.remove)
                write_migrated_copy(connection, scratch.path / "migrated.carina")
                connection.close()
                connection = undo.enter_context(
                    contextlib.closing(open_connection(scratch.path / "migrated.carina", "ro", immutable=True))
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
        with convert_disk_errors(place):
            rename_foreign_file(place)
            connection = open_connection(place, "rw")
            try:
                set_pragmas(connection)
                check_schema(connection, place)
            except BaseException:
                connection.close()
                raise
        return cls(place, connection)

    def close(self) -> None:
        """Close the file and remove its journal; later calls raise an error and cannot change the file."""
        with self._lock:
            connection, self._connection = self._connection, None
            self._writer = None
            try:
                if connection is not None:
                    # Unreferenced rows only use space, so errors while deleting them are ignored.
                    with contextlib.suppress(sqlite3.Error, CaseFileError):
                        if self._has_orphans and not self.read_only:
                            with transaction(connection):
                                delete_unreferenced_rows(connection, all_content(connection))
                    with contextlib.suppress(sqlite3.Error):
                        connection.close()
            finally:
                scratch, self._scratch = self._scratch, None
                if scratch is not None:
                    scratch.remove()

    def save(self, moment: Moment) -> None:
        """Write a state of the case in one transaction; content that the file already contains is not written again.

        Parameters
        ----------
        moment
            The state to save.

        Raises
        ------
        DiskError
            If the state cannot be written; the previously saved state stays.
        """
        with self._lock, convert_disk_errors(self.path):
            connection = self._writable_connection()
            writer = self._checked_writer()
            try:
                with transaction(connection):
                    writer.write(moment)
            except BaseException:
                # A new writer is made for the next save: this one may refer to rows that the transaction rolled back.
                self._writer = None
                raise
            writer.commit_rows()
            self._has_orphans = True

    def load(self, volume: Volume) -> Moment:
        """Return the case state that was saved last.

        Nothing is detected again: airways are read with their stored tree, and paths are computed at first use. The
        airways of steps far from the current step are :class:`carina.track.FoldedAirways`.

        Parameters
        ----------
        volume
            The CT; the caller has compared the digest of its voxels. If its axes are in another order than in the saved
            CT, voxel data are reordered.

        Returns
        -------
        Moment
            The saved state.

        Raises
        ------
        CaseFileError
            ``case.other-scan``, ``case.damaged``, or ``case.empty`` if nothing was saved yet.
        """
        with self._lock, convert_disk_errors(self.path):
            connection = self._checked_connection()
            source = read_source(connection)
            turn = axis_permutation(source, volume)
            if turn is None:
                raise unusable_file_error(
                    self.path,
                    f"it belongs to another scan, whose grid ({grid_text(source.shape_zyx)} voxels) differs from this "
                    f"one's ({grid_text(volume.shape_zyx)} voxels) in size or position; choose the scan that the case "
                    "was made from",
                    code="case.other-scan",
                )
            found = connection.execute("SELECT position, facts FROM moment").fetchone()
            if found is None:
                raise unusable_file_error(
                    self.path, "nothing has been saved in it yet; open the scan instead", code="case.empty"
                )
            rows = all_content(connection)
            numbered = step_rows(connection)
            writer = None if self.read_only or not turn.is_identity else self._checked_writer()
            with self._newer_version_notice(), convert_value_errors():
                reader = CaseReader(rows, volume, _ignore_object if writer is None else writer.register_row, turn)
                facts: f.MomentFacts = from_json(found[1], f.decoders().moment, "current state")
                moment = reader.moment([row[1:] for row in numbered], found[0], facts)
            if writer is not None:
                writer.reader = reader
                objects: list[object] = [moment, *moment.steps]
                writer.set_written_steps(
                    [(one, row[1:]) for one, row in zip(objects, numbered, strict=True)], numbered[0][0]
                )
            return moment

    def history(self) -> tuple[StepFacts, ...]:
        """Return label, command and time of all steps, the oldest first, undone steps included.

        No large data are read.
        """
        with self._lock, convert_disk_errors(self.path):
            connection = self._checked_connection()
            found = connection.execute("SELECT position FROM moment").fetchone()
            position = 0 if found is None else found[0]
            rows = connection.execute(
                "SELECT n, substr(label, 1, ?), substr(command, 1, 200), at_s FROM step ORDER BY n LIMIT ?",
                (MAX_LABEL_CHARS + 1, MAX_STEPS),
            ).fetchall()
        with convert_value_errors():
            for number, label, _, at_s in rows:
                check_step(number, label, at_s)
            return tuple(
                StepFacts(label, command_type_name(command), at_s, n < position)
                for n, (_, label, command, at_s) in enumerate(rows[1:])
            )

    def summary(self) -> CaseSummary:
        """Return the summary for the list of cases; no large data and no CT are read."""
        with self._lock, convert_disk_errors(self.path), convert_value_errors():
            return read_summary(self._checked_connection())

    @property
    def source(self) -> SourceFacts:
        """Description of the CT of the case."""
        with self._lock, convert_disk_errors(self.path):
            return read_source(self._checked_connection())

    @property
    def inserted(self) -> tuple[str, ...]:
        """Descriptions of nodules that were inserted into the CT of the case; empty without them.

        Raises
        ------
        CaseFileError
            ``case.damaged``.
        """
        with self._lock, convert_disk_errors(self.path), convert_value_errors():
            return inserted_structures(self._checked_connection())

    @property
    def digest(self) -> str:
        """Digest of the voxels of the CT."""
        return self.source.digest

    @property
    def save_mark(self) -> SaveMark | None:
        """Mark of the save that wrote this named file; None for a live file and for a file of an older version."""
        with self._lock, convert_disk_errors(self.path):
            return read_save_mark(self._checked_connection())

    def pack(self, volume: Volume) -> None:
        """Store the CT in this file, losslessly compressed, in chunks with checksums.

        Raises
        ------
        DiskError
            If the CT cannot be written.
        UsageError
            ``case.other-scan``: if the volume is not the CT of the case.
        """
        with self._lock, convert_disk_errors(self.path):
            connection = self._writable_connection()
            with transaction(connection):
                write_ct(connection, volume)

    @property
    def holds_ct(self) -> bool:
        """Whether the case file contains the voxels of the CT."""
        with self._lock, convert_disk_errors(self.path):
            return self._checked_connection().execute("SELECT 1 FROM ct LIMIT 1").fetchone() is not None

    def packed_volume(self) -> Volume | None:
        """Return the CT stored in the file; None if the file contains none.

        Raises
        ------
        CaseFileError
            ``case.damaged``.
        """
        with self._lock, convert_disk_errors(self.path), convert_value_errors():
            return packed_volume(self._checked_connection())

    def set_source_path(self, path: str | None) -> None:
        """Store the path of the scan relative to the case file; None if the path is unknown."""
        with self._lock, convert_disk_errors(self.path):
            connection = self._writable_connection()
            with transaction(connection):
                write_source(connection, replace(read_source(connection), path=path))

    def extra(self, kind: str) -> tuple[Any, ...]:
        """Return the stored values of a kind outside the history (a plan, a report, scores), in their stored order."""
        with self._lock, convert_disk_errors(self.path):
            rows = (
                self._checked_connection()
                .execute("SELECT json FROM extra WHERE kind = ? ORDER BY n", (kind,))
                .fetchall()
            )
            where = f"extra data of kind {kind[:80]}"
            found = tuple(from_json(json_text, f.decoders().extra, where) for (json_text,) in rows)
            check_plain(found, where, most_chars=MAX_JSON_BYTES)
            return found

    def set_extra(self, kind: str, values: tuple[Any, ...]) -> None:
        """Store plain JSON values of a kind, and delete the former values of that kind.

        Parameters
        ----------
        kind
            Name of the kind, such as that of a plan, a report or scores.
        values
            The new values, in their order.
        """
        with self._lock, convert_disk_errors(self.path):
            connection = self._writable_connection()
            with transaction(connection):
                connection.execute("DELETE FROM extra WHERE kind = ?", (kind,))
                for n, value in enumerate(values):
                    row = (kind, n, as_checked_json(value, f.decoders().extra, kind))
                    connection.execute("INSERT INTO extra (kind, n, json) VALUES (?, ?, ?)", row)

    def record(self, name: str, *, begun_s: float) -> RecordingWriter:
        """Begin a recording and return the text file that :class:`carina.navigate.Recorder` writes to.

        The text stays in memory until :meth:`RecordingWriter.keep` stores it in the case file, in chunks of at most a
        second, so that navigation never waits for the disk.

        Parameters
        ----------
        name
            Name of the recording.
        begun_s
            Start of the recording, in seconds since the creation of the case.
        """
        with self._lock, convert_disk_errors(self.path):
            return RecordingWriter(name, begun_s, self._recording_table())

    def keep_recording(self, recording: RecordingWriter) -> None:
        """Store the text recorded since the last call, in chunks of at most a second.

        Raises
        ------
        DiskError
            If the text cannot be written; it then stays in memory.
        """
        with self._lock, convert_disk_errors(self.path):
            self._writable_connection()
            recording.keep(self._recording_table())

    def recordings(self) -> tuple[RecordingFacts, ...]:
        """Return name, note, start and length of all recordings, in the user's order."""
        with self._lock, convert_disk_errors(self.path):
            return self._recording_table().all()

    def recording(self, recording_id: int) -> Recording:
        """Return a recording for replay.

        Parameters
        ----------
        recording_id
            Number of the recording in this case.

        Raises
        ------
        UsageError
            ``case.write_recording``: if no recording has this number.
        CaseFileError, VolumeImportError
            If the recording is damaged, or its content is not a recording.
        """
        with self._lock, convert_disk_errors(self.path):
            return self._recording_table().read(recording_id)

    def recording_text(self, recording_id: int) -> str:
        """Return a recording as the text of a ``carina-recording`` file, which other programs read.

        Raises
        ------
        UsageError, CaseFileError
            As in :meth:`recording`.
        """
        with self._lock, convert_disk_errors(self.path):
            return self._recording_table().text(recording_id)

    def set_recordings(self, wanted: Sequence[RecordingFacts], *, removed: Collection[int] = ()) -> None:
        """Set the names, notes and order of the recordings, and delete those that are not in the list.

        A recording that neither argument names stays unchanged. Nothing is written if nothing changes.

        Parameters
        ----------
        wanted
            Facts of the recordings, in the new order.
        removed
            Numbers of the recordings to delete.

        Raises
        ------
        DiskError
            If the changes cannot be written.
        """
        with self._lock, convert_disk_errors(self.path):
            self._recording_table().replace_list(wanted, removed)

    def change_recording(self, recording_id: int, *, name: str | None = None, words: str | None = None) -> None:
        """Change the name or the note of a recording; None leaves the value unchanged."""
        with self._lock, convert_disk_errors(self.path):
            self._recording_table().change(recording_id, name=name, words=words)

    def order_recordings(self, recording_ids: Sequence[int]) -> None:
        """Set the order of the recordings; the argument contains the number of every recording once."""
        with self._lock, convert_disk_errors(self.path):
            self._recording_table().order(recording_ids)

    def forget_recording(self, recording_id: int) -> None:
        """Delete a recording from the case file."""
        with self._lock, convert_disk_errors(self.path):
            self._recording_table().forget(recording_id)

    def _recording_table(self) -> RecordingTable:
        return RecordingTable(self._checked_connection, self._writable_connection, self._lock, self.path)

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
        """Write the case as one complete file without a journal, for storing under a name, sharing and backup.

        The copy is made in memory, or in a temporary folder if it is large, and is then moved to its path. So no
        database is open on a network share, and a copy to another disk needs no space on a full disk.

        Parameters
        ----------
        path
            The file to write.
        ct_place
            Path of the scan relative to the copy; None if unknown.
        volume
            The CT, to be stored in the copy, losslessly compressed, in chunks with checksums; None stores no CT.
        private
            Whether only the user may read the copy, as for a live file.
        save_mark
            Mark that the copy gets, to identify this save; None stores no mark.
        placement
            Moves the complete copy to its path; None replaces any file at the path.

        Raises
        ------
        DiskError
            If the copy cannot be written; a former file at the path stays.
        UsageError
            ``case.other-scan``: if ``volume`` is not the CT of the case.
        CarinaError
            If ``placement`` refuses the move; a former file at the path stays.
        """
        target = Path(path)
        with self._lock, convert_disk_errors(self.path):
            pages, size = (
                self._checked_connection().execute(f"PRAGMA {name}").fetchone()[0]
                for name in ("page_count", "page_size")
            )
        if volume is None and pages * size <= MAX_IN_MEMORY_BYTES:
            with convert_disk_errors(self.path), contextlib.closing(open_connection(None)) as copy:
                self._back_up(copy, ct_place, save_mark)
                content = copy.serialize()
            write_whole(target, content, what="the case", private=private, lasting=True, placement=placement)
            return
        with ScratchFolder() as folder:
            made = folder / "copy.carina"
            with convert_disk_errors(made), contextlib.closing(open_connection(made, "rwc")) as copy:
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
        """Copy the whole case to another database connection, without unreferenced rows and without a journal."""
        with self._lock:
            self._checked_connection().backup(copy)
        copy.execute("PRAGMA journal_mode=DELETE")
        # A copy that a crash leaves incomplete is deleted, so SQLite need not flush it to the disk.
        copy.execute("PRAGMA synchronous=OFF")
        with transaction(copy):
            write_source(copy, replace(read_source(copy), path=ct_place))
            write_save_mark(copy, save_mark)
            delete_unreferenced_rows(copy, all_content(copy))
        copy.execute("VACUUM")

    @contextlib.contextmanager
    def _newer_version_notice(self) -> Iterator[None]:
        """Replace a damage error, raised in the block, by an update notice if a newer Carina wrote the file."""
        try:
            yield
        except CaseFileError as error:
            if self.note is None or error.code != "case.damaged":
                raise
            raise unusable_file_error(
                self.path,
                f"a newer version of Carina saved it, with content that this version cannot read; "
                f"update Carina ({error})",
                code="case.newer",
            ) from error

    def _checked_writer(self) -> CaseWriter:
        if self._writer is None:
            self._writer = CaseWriter(self._checked_connection())
        return self._writer

    def _checked_connection(self) -> sqlite3.Connection:
        if self._connection is None:
            raise CaseFileError(f"{self.path}: this case is closed; open it again", code="case.closed")
        return self._connection

    def _writable_connection(self) -> sqlite3.Connection:
        if self.read_only:
            raise CaseFileError(
                f"{self.path}: this case is open for reading only; open it for writing, or save a copy elsewhere",
                code="case.read-only",
            )
        return self._checked_connection()


def _new_in_memory_case(source: SourceFacts) -> sqlite3.Connection:
    """Return the connection of a new in-memory database with a case without steps."""
    connection = open_connection(None)
    with transaction(connection):
        make_tables(connection)
        write_source(connection, source)
    return connection


def _ignore_object(_kind: str, _value: object, _row: int) -> None:
    """Ignore an object that was read from a row; a read-only file needs no row numbers for later saves."""
