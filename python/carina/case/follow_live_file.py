"""Reading of a live case file that another process owns and writes."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from carina.case import json_records as f
from carina.case.checked_rows import all_content, step_rows
from carina.case.compression import from_json
from carina.case.database import convert_disk_errors, convert_value_errors, open_connection
from carina.case.document import Document
from carina.case.error_texts import unusable_file_error
from carina.case.reading import CaseReader, Rows
from carina.case.schema import CONTENT, check_schema
from carina.case.source import axis_permutation, grid_text, read_source
from carina.case.stored_state import Moment
from carina.volume import Volume


class CaseFollower:
    """Reader of the case states that another process saves in a live file; it never writes, and reads each row once.

    The owner only adds rows to a live file, so content that two states share is the same object in both. If a branch
    is renamed, for example, the lumen is not read again.

    Parameters
    ----------
    path
        The live file of a case on this machine.
    volume
        The CT of the case; the caller has compared the digest of its voxels.
    """

    def __init__(self, path: Path, volume: Volume) -> None:
        self.path = path
        self._volume = volume
        self._rows: Rows = {}
        self._reader: _GrowingReader | None = None
        self._saved: tuple[Any, list[tuple[Any, ...]]] | None = None
        self._newest: Moment | None = None

    def __repr__(self) -> str:
        """Return the path of the file."""
        return f"CaseFollower({str(self.path)!r})"

    def latest_moment(self) -> Moment:
        """Return the case state that was saved last; the same object if nothing was saved since the last call.

        Raises
        ------
        CaseFileError
            ``case.empty``, ``case.other-scan``, ``case.newer`` or ``case.damaged``.
        DiskError
            If the file cannot be read.
        """
        with convert_disk_errors(self.path), contextlib.closing(open_connection(self.path, "ro")) as connection:
            if check_schema(connection, self.path) != "ours":
                raise unusable_file_error(
                    self.path,
                    "another version of Carina has it open; work in that version, or close the case there first",
                    code="case.newer",
                )
            connection.execute("BEGIN")
            found = connection.execute("SELECT position, facts FROM moment").fetchone()
            if found is None:
                raise unusable_file_error(
                    self.path, "nothing has been saved in it yet; open the scan instead", code="case.empty"
                )
            saved = (found, step_rows(connection))
            if self._newest is None or saved != self._saved:
                self._newest = self._read_moment(connection, *saved)
                self._saved = saved
            return self._newest

    def _read_moment(
        self, connection: sqlite3.Connection, found: tuple[Any, ...], numbered: Sequence[tuple[Any, ...]]
    ) -> Moment:
        """Return the case state of the given step rows, after reading the content rows that are new."""
        if self._reader is None or not self._take_new_rows(connection):
            source = read_source(connection)
            turn = axis_permutation(source, self._volume)
            if turn is None:
                raise unusable_file_error(
                    self.path,
                    f"it belongs to another scan, whose grid ({grid_text(source.shape_zyx)} voxels) differs from this "
                    f"one's ({grid_text(self._volume.shape_zyx)} voxels) in size or position; choose the scan that "
                    "the case was made from",
                    code="case.other-scan",
                )
            self._rows = all_content(connection)
            self._reader = _GrowingReader(self._rows, self._volume, _ignore_object, turn)
        with convert_value_errors():
            facts: f.MomentFacts = from_json(found[1], f.decoders().moment, "current state")
            return self._reader.moment([row[1:] for row in numbered], found[0], facts)

    def _take_new_rows(self, connection: sqlite3.Connection) -> bool:
        """Add the rows that were written since the last call; return False if rows were deleted or replaced.

        After False, a row number may refer to other content, so the caller must read all rows again.
        """
        for table in CONTENT:
            known = self._rows[table]
            there = dict(connection.execute(f"SELECT id, digest FROM {table}"))
            if any(there.get(row) != columns[0] for row, columns in known.items()):
                return False
            newer = connection.execute(f"SELECT * FROM {table} WHERE id > ?", (max(known, default=0),)).fetchall()
            if len(known) + len(newer) != len(there):
                return False
            known.update((row[0], row[1:]) for row in newer)
        return True


class _GrowingReader(CaseReader):
    """Reader of consecutive case states; only the edited airways of the current step are unpacked."""

    _present: int | None = None
    """Row number of the airways that were current when the file was read last."""
    _whole_documents: dict[int, Document] | None = None
    """Documents with the current airways, decompressed, by row number."""

    def moment(self, steps: Sequence[tuple[Any, ...]], position: int, facts: f.MomentFacts) -> Moment:
        """Return the case state with the given steps; content shared with the preceding state is reused."""
        if not 1 <= position + 1 <= len(steps):
            return super().moment(steps, position, facts)
        with self._lock:
            self._measures = {columns[1]: row for row, columns in self._rows["measures"].items()}
            present = self.airways_of(steps[position][3])
            if present != self._present:
                self._present, self._whole_documents = present, None
                # Documents that were read while other airways were current contain the present airways in packed form;
                # these documents are read again.
                folded: object = None if present is None else self._folded.get(present)
                if folded is not None:
                    self._documents = {row: one for row, one in self._documents.items() if one.airways is not folded}
            if self._whole_documents and present is not None:
                self._documents.update(self._whole_documents)
                self._whole[present] = next(iter(self._whole_documents.values())).airways  # type: ignore[assignment]
            made = super().moment(steps, position, facts)
            if present is not None and self.columns("airways", present)[0] is not None:
                whole = made.history().current.airways
                self._whole_documents = {row: one for row, one in self._documents.items() if one.airways is whole}
                for row in self._whole_documents:
                    del self._documents[row]
            return made


def _ignore_object(_kind: str, _value: object, _row: int) -> None:
    """Ignore an object that was read from a row; a follower writes nothing, so it needs no row numbers."""
