"""Recordings of a case, stored in chunks of at most a second, so that a crash loses at most a second."""

from __future__ import annotations

import io
import json
import math
import sqlite3
import threading
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from carina.case.bounds import (
    MAX_MESSAGE_CHARS,
    MAX_NAME_CHARS,
    MAX_S,
    MAX_WHOLE,
    bounded_number,
    bounded_text,
    bounded_whole,
    shortened_text,
)
from carina.case.compression import content_digest, deflate, inflate
from carina.case.database import convert_disk_errors, convert_value_errors, transaction
from carina.case.error_texts import damage_error
from carina.display import as_words, one_line
from carina.errors import UsageError
from carina.navigate import Recording
from carina.navigate.recording import read_recording

CHUNK_S: Final = 1.0
"""Maximum duration of a chunk in seconds; a chunk stays in memory until the next :meth:`RecordingWriter.keep`."""
MAX_CHUNK_CHARS: Final = 8 << 20
MAX_CHUNKS: Final = 1_000_000
MAX_RECORDING_BYTES: Final = 1 << 30


@one_line
@dataclass(frozen=True, slots=True)
class RecordingFacts:
    """Number, name, note, start and length of a recording, without its lines."""

    recording_id: int
    """Number of the recording in its case, from 1; no two recordings of a case have the same number."""
    name: str
    words: str
    """Note that the user wrote about the recording; empty without one."""
    begun_s: float
    """Start of the recording in seconds since the creation of the case."""
    length_s: float
    complete: bool
    """Whether the recording ended normally; False if Carina was stopped during the recording."""


@one_line
@dataclass(frozen=True, slots=True)
class WholeRecording:
    """A recording with all its lines, to be copied to another case file."""

    facts: RecordingFacts
    text: str

    def writer(self) -> RecordingWriter:
        """Return a writer with the content of the recording; :meth:`RecordingWriter.keep` stores it in another file."""
        made = RecordingWriter(self.facts.name, self.facts.begun_s, number=self.facts.recording_id)
        made.write(self.text)
        if self.facts.complete:
            made.close()
        return made


class RecordingTable:
    """Table of the recordings in an open case file, for reading and writing."""

    def __init__(
        self,
        reading: Callable[[], sqlite3.Connection],
        writing: Callable[[], sqlite3.Connection],
        lock: threading.RLock,
        path: Path,
    ) -> None:
        self._reading, self._writing, self._lock, self._path = reading, writing, lock, path

    def begin(self, name: str, begun_s: float, number: int | None = None) -> int:
        """Begin a recording without lines, and return its number: the given one, or the next free one."""
        with self._lock, convert_disk_errors(self._path):
            connection = self._writing()
            with transaction(connection):
                made = connection.execute(
                    "INSERT INTO recording (id, place, name, words, begun_s, length_s, complete) VALUES "
                    "(?, (SELECT 1 + coalesce(max(place), 0) FROM recording), ?, '', ?, 0.0, 0)",
                    (number, shortened_text(name, MAX_NAME_CHARS), _seconds(begun_s)),
                )
            assert made.lastrowid is not None
            return made.lastrowid

    def add(self, recording_id: int, first_n: int, chunks: list[str], length_s: float, *, complete: bool) -> None:
        """Add chunks of lines to a recording, in one transaction.

        Parameters
        ----------
        recording_id
            Number of the recording.
        first_n
            Number of the first new chunk in the recording.
        chunks
            The texts of the new chunks.
        length_s
            Duration of the whole recording in seconds.
        complete
            Whether the recording has ended.
        """
        with self._lock, convert_disk_errors(self._path):
            connection = self._writing()
            with transaction(connection):
                for n, chunk in enumerate(chunks, start=first_n):
                    content = chunk.encode()
                    row = (recording_id, n, len(content), content_digest(content), deflate(content))
                    connection.execute(
                        "INSERT INTO recording_chunk (recording, n, size, digest, data) VALUES (?, ?, ?, ?, ?)", row
                    )
                connection.execute(
                    "UPDATE recording SET length_s = ?, complete = ? WHERE id = ?",
                    (_seconds(length_s), int(complete), recording_id),
                )

    def all(self) -> tuple[RecordingFacts, ...]:
        """Return the facts of all recordings, in their order."""
        rows = self._reading().execute(
            "SELECT id, place, substr(name, 1, ?), substr(words, 1, ?), begun_s, length_s, complete "
            "FROM recording ORDER BY place, id LIMIT 100000",
            (MAX_NAME_CHARS + 1, MAX_MESSAGE_CHARS + 1),
        )
        with convert_value_errors():
            return tuple(_facts_of(row) for row in rows)

    def text(self, recording_id: int) -> str:
        """Return the lines of a recording as one text."""
        where = f"recording {recording_id}"
        connection = self._reading()
        found = connection.execute("SELECT count(*) FROM recording WHERE id = ?", (recording_id,)).fetchone()[0]
        if not found:
            raise UsageError(
                f"this case has no recording {recording_id}; choose one from its list", code="case.write_recording"
            )
        count, size = connection.execute(
            "SELECT count(*), coalesce(sum(size), 0) FROM recording_chunk WHERE recording = ?", (recording_id,)
        ).fetchone()
        if count > MAX_CHUNKS or not isinstance(size, int) or not 0 <= size <= MAX_RECORDING_BYTES:
            raise damage_error(
                where, f"at most {MAX_CHUNKS} pieces and {MAX_RECORDING_BYTES} bytes", f"{count} pieces, {size} bytes"
            )
        pieces = []
        rows = connection.execute(
            "SELECT n, size, digest, data FROM recording_chunk WHERE recording = ? ORDER BY n", (recording_id,)
        )
        for place, (n, size, digest, data) in enumerate(rows):
            content = inflate(data, size, where)
            if n != place or content_digest(content) != digest:
                raise damage_error(
                    where, f"piece {place} with a matching digest", "a different piece or altered content"
                )
            pieces.append(content)
        try:
            return b"".join(pieces).decode()
        except UnicodeDecodeError as error:
            raise damage_error(where, "UTF-8 text", "invalid bytes") from error

    def read(self, recording_id: int) -> Recording:
        """Return a stored recording for replay."""
        return read_recording(io.StringIO(self.text(recording_id)), Path(f"recording {recording_id} of {self._path}"))

    def change(self, recording_id: int, *, name: str | None, words: str | None) -> None:
        """Change the name or the note of a recording; None leaves the value unchanged."""
        sql = "UPDATE recording SET name = coalesce(?, name), words = coalesce(?, words) WHERE id = ?"
        name = None if name is None else shortened_text(name, MAX_NAME_CHARS)
        words = None if words is None else shortened_text(words, MAX_MESSAGE_CHARS)
        self._update_row(sql, (name, words, recording_id), recording_id)

    def order(self, recording_ids: Sequence[int]) -> None:
        """Set the order of the recordings; the argument contains the number of every recording once."""
        connection = self._writing()
        known = [row[0] for row in connection.execute("SELECT id FROM recording")]
        if sorted(recording_ids) != sorted(known):
            raise UsageError(
                f"the new order must contain each recording once: expected {sorted(known)}; "
                f"found {list(recording_ids)}",
                code="case.write_recording",
            )
        with transaction(connection):
            rows = [(place, number) for place, number in enumerate(recording_ids, start=1)]
            connection.executemany("UPDATE recording SET place = ? WHERE id = ?", rows)

    def replace_list(self, wanted: Sequence[RecordingFacts], removed: Collection[int]) -> None:
        """Set the names, notes and order of the recordings, and delete the removed ones.

        The file is not written if nothing changes. A recording that neither argument names stays unchanged.
        """
        with self._lock, convert_disk_errors(self._path):
            connection = self._writing()
            rows = connection.execute("SELECT id, place, name, words FROM recording")
            found = {number: tuple(others) for number, *others in rows}
            deleted = [(number,) for number in removed if number in found]
            texts = [
                (
                    place,
                    shortened_text(one.name, MAX_NAME_CHARS),
                    shortened_text(one.words, MAX_MESSAGE_CHARS),
                    one.recording_id,
                )
                for place, one in enumerate(wanted, start=1)
            ]
            changed_rows = [row for row in texts if row[3] in found and found[row[3]] != row[:3]]
            if deleted or changed_rows:
                with transaction(connection):
                    connection.executemany("DELETE FROM recording WHERE id = ?", deleted)
                    connection.executemany(
                        "UPDATE recording SET place = ?, name = ?, words = ? WHERE id = ?", changed_rows
                    )

    def forget(self, recording_id: int) -> None:
        """Delete a recording from the case file."""
        self._update_row("DELETE FROM recording WHERE id = ?", (recording_id,), recording_id)

    def _update_row(self, sql: str, values: tuple[object, ...], recording_id: int) -> None:
        connection = self._writing()
        with transaction(connection):
            changed = connection.execute(sql, values).rowcount
        if not changed:
            raise UsageError(
                f"this case has no recording {recording_id}; choose one from its list", code="case.write_recording"
            )


class RecordingWriter(io.TextIOBase):
    """The text file that a recorder writes to: lines stay in memory until :meth:`keep` stores them in the case file.

    Parameters
    ----------
    name
        Name of the recording.
    begun_s
        Start of the recording in seconds since the creation of the case.
    number
        Number of the recording in the file; None selects the next free number.
    table
        The recordings of the case file. With None, :meth:`close` does not write to the disk; a thread that may wait for
        the disk then calls :meth:`CaseFile.keep_recording`.
    """

    def __init__(
        self, name: str, begun_s: float, table: RecordingTable | None = None, *, number: int | None = None
    ) -> None:
        super().__init__()
        self.name, self.begun_s, self.number = name, begun_s, number
        self._table = table
        self._closes_file = table is not None
        self._recording_id = None if table is None else table.begin(name, begun_s, number)
        self._lock = threading.Lock()
        self._keeping = threading.Lock()
        self._chunks: list[list[str]] = []
        self._chunk_from_s = 0.0
        self._length_s = 0.0
        self._num_stored = 0
        self._is_complete = False

    def __repr__(self) -> str:
        """Return the name and the duration of the recording, and whether it is closed."""
        return f"RecordingWriter({as_words(self.name)}, {self._length_s:.1f} s{', closed' if self.closed else ''})"

    @property
    def recording_id(self) -> int:
        """Number that identifies the recording in the case file."""
        if self._recording_id is None:
            raise UsageError("no part of this recording has been saved in a case file yet", code="case.write_recording")
        return self._recording_id

    @property
    def is_complete(self) -> bool:
        """Whether the recording was closed and is stored completely in the case file."""
        return self._is_complete

    def writable(self) -> bool:
        """Return True, because lines can be written to this file object."""
        return True

    def write(self, text: str) -> int:
        """Add one or more lines in memory, without access to the disk; return the number of characters."""
        with self._lock:
            for line in text.splitlines(keepends=True):
                at_s = _time_of(line)
                long = bool(self._chunks) and sum(map(len, self._chunks[-1])) + len(line) > MAX_CHUNK_CHARS
                if not self._chunks or long or at_s - self._chunk_from_s >= CHUNK_S:
                    self._chunks.append([])
                    self._chunk_from_s = at_s
                self._chunks[-1].append(line)
                self._length_s = max(self._length_s, at_s)
        return len(text)

    def keep(self, table: RecordingTable | None = None, *, complete: bool = False) -> None:
        """Store the lines written since the last call in the case file.

        Parameters
        ----------
        table
            The recordings of the case file, used if the writer has none yet.
        complete
            Mark the recording as complete.

        Raises
        ------
        DiskError
            If the lines cannot be written; they stay in memory, and the next call tries again.
        """
        with self._keeping:
            if self._table is None:
                self._table = table
            if self._table is None or self._is_complete:
                return
            with self._lock:
                complete = complete or self.closed
                ready = ["".join(lines) for lines in self._chunks]
                length_s = self._length_s
                # Lines written during the save begin a new chunk.
                num_ready = len(ready)
                self._chunk_from_s = float("-inf")
            if not ready and not complete:
                return
            if self._recording_id is None:
                self._recording_id = self._table.begin(self.name, self.begun_s, self.number)
            self._table.add(self._recording_id, self._num_stored, ready, length_s, complete=complete)
            self._is_complete = complete
            with self._lock:
                self._num_stored += num_ready
                del self._chunks[:num_ready]

    def unsaved_part(self) -> tuple[int, str]:
        """Return the number of stored chunks, and the lines that are not stored yet; the disk is not accessed."""
        with self._lock:
            return self._num_stored, "".join(line for lines in self._chunks for line in lines)

    def close(self) -> None:
        """End the recording: store the remaining lines in the case file, now or at the next :meth:`keep`.

        Raises
        ------
        DiskError
            If the lines cannot be written.
        """
        if not self.closed:
            try:
                if self._closes_file:
                    self.keep(complete=True)
            finally:
                with self._lock:
                    super().close()


def _facts_of(row: tuple[object, ...]) -> RecordingFacts:
    """Return the facts of a recording after checking its columns, which no digest protects."""
    number, place, name, words, begun_s, length_s, complete = row
    where = f"recording {number}"
    bounded_whole(place, where, -MAX_WHOLE, MAX_WHOLE)
    return RecordingFacts(
        bounded_whole(number, where, 1, MAX_WHOLE),
        bounded_text(name, where, MAX_NAME_CHARS),
        bounded_text(words, where, MAX_MESSAGE_CHARS),
        bounded_number(begun_s, where, 0.0, MAX_S),
        bounded_number(length_s, where, 0.0, MAX_S),
        bool(bounded_whole(complete, where, 0, 1)),
    )


def _seconds(value: float) -> float:
    """Return a time that can be read back: a time outside the bounds becomes the nearest bound."""
    return min(max(float(value), 0.0), MAX_S) if math.isfinite(value) else 0.0


def _time_of(line: str) -> float:
    """Return the time of a recording's line in seconds since its start; 0 for its header."""
    try:
        value = json.loads(line)
        return float(value.get("t", value.get("end", 0.0)))
    except (ValueError, AttributeError, TypeError):
        return 0.0
