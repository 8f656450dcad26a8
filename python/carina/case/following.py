"""The live file of a case that another process owns and writes: its newest moment, read again and again."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from carina.case import facts as f
from carina.case.database import connected, no_surprise, told
from carina.case.document import Document
from carina.case.file import all_content, step_rows
from carina.case.moment import Moment
from carina.case.packing import from_json
from carina.case.reading import CaseReader, Rows
from carina.case.schema import CONTENT, check_schema
from carina.case.source import grid_words, read_source, turn_between
from carina.case.trouble import refused
from carina.volume import Volume

__all__ = ["CaseFollower"]


class CaseFollower:
    """Reads what another process saves, while that one goes on: nothing is written, and nothing is read twice.

    Content is only ever added to a live file, so that what one moment shares with the one before is the same object
    here: a tree that was renamed in brings no other lumen.

    Parameters
    ----------
    path
        The live file of a case of this machine.
    volume
        Its CT, whose voxels the caller has compared by their digest.
    """

    def __init__(self, path: Path, volume: Volume) -> None:
        self.path = path
        self._volume = volume
        self._rows: Rows = {}
        self._reader: _GrowingReader | None = None
        self._saved: tuple[Any, list[tuple[Any, ...]]] | None = None
        self._newest: Moment | None = None

    def __repr__(self) -> str:
        return f"CaseFollower({str(self.path)!r})"

    def newest(self) -> Moment:
        """The moment that was saved last; the same object while nothing has been saved since.

        Raises
        ------
        CaseFileError
            ``case.empty``, ``case.other-scan``, ``case.newer`` or ``case.damaged``.
        DiskError
            If it cannot be read.
        """
        with told(self.path), contextlib.closing(connected(self.path, "ro")) as connection:
            if check_schema(connection, self.path) != "ours":
                raise refused(
                    self.path,
                    "another version of Carina has it open; work in that version, or close the case there first",
                    code="case.newer",
                )
            connection.execute("BEGIN")
            found = connection.execute("SELECT position, facts FROM moment").fetchone()
            if found is None:
                raise refused(self.path, "nothing has been saved in it yet; open the scan instead", code="case.empty")
            saved = (found, step_rows(connection))
            if self._newest is None or saved != self._saved:
                self._newest = self._read(connection, *saved)
                self._saved = saved
            return self._newest

    def _read(
        self, connection: sqlite3.Connection, found: tuple[Any, ...], numbered: Sequence[tuple[Any, ...]]
    ) -> Moment:
        if self._reader is None or not self._take_new_rows(connection):
            source = read_source(connection)
            turn = turn_between(source, self._volume)
            if turn is None:
                raise refused(
                    self.path,
                    f"it belongs to another scan, whose grid ({grid_words(source.shape_zyx)} voxels) differs from this "
                    f"one's ({grid_words(self._volume.shape_zyx)} voxels) in size or position; choose the scan that "
                    "the case was made from",
                    code="case.other-scan",
                )
            self._rows = all_content(connection)
            self._reader = _GrowingReader(self._rows, self._volume, _ignored, turn)
        with no_surprise():
            facts: f.MomentFacts = from_json(found[1], f.decoders().moment, "current state")
            return self._reader.moment([row[1:] for row in numbered], found[0], facts)

    def _take_new_rows(self, connection: sqlite3.Connection) -> bool:
        """False where its owner has swept the file meanwhile: then a number may stand for other content."""
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
    """Reads one moment after the other; edited airways are kept whole only while they are the present ones."""

    _present: int | None = None
    """The row of the present airways..."""
    _whole_documents: dict[int, Document] | None = None
    """... and the documents that hold them whole."""

    def moment(self, steps: Sequence[tuple[Any, ...]], position: int, facts: f.MomentFacts) -> Moment:
        """The moment of steps, sharing what it can with the one before."""
        if not 1 <= position + 1 <= len(steps):
            return super().moment(steps, position, facts)
        with self._lock:
            self._measures = {columns[1]: row for row, columns in self._rows["measures"].items()}
            present = self.airways_of(steps[position][3])
            if present != self._present:
                self._present, self._whole_documents = present, None
                # Documents that were read while these were far away hold them folded.
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


def _ignored(_kind: str, _value: object, _row: int) -> None:
    """Nothing is written to it, so nobody need know which row an object came from."""
