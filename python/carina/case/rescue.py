"""Rescue of a damaged case file: its intact content as a new file, and a list of the losses."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from carina.case import json_records as f
from carina.case.bounds import MAX_LABEL_CHARS, MAX_NUMBER, MAX_S, check_tip, shortened_text
from carina.case.checked_rows import MAX_ROWS, MAX_STEPS
from carina.case.compression import from_json
from carina.case.database import check_header, convert_disk_errors, convert_value_errors, open_connection
from carina.case.document import Document, KeyFrames, Target
from carina.case.error_texts import CaseFileError, unusable_file_error
from carina.case.file import CaseFile
from carina.case.history import Step
from carina.case.json_records import TargetFacts
from carina.case.packed_ct import packed_volume
from carina.case.reading import CaseReader, Rows
from carina.case.schema import APPLICATION_ID, CONTENT, SCHEMA, SINCE
from carina.case.source import axis_permutation, read_source
from carina.case.sqlite_journals import copied_with_journal
from carina.case.stored_state import Moment
from carina.commands.look import Look
from carina.disk import ScratchFolder
from carina.errors import UsageError
from carina.render import Sight, transfer_preset
from carina.scopes import ScopeHold
from carina.volume import Volume

MAX_VOXELS: Final = 1 << 33
TROUBLE: Final = (CaseFileError, sqlite3.Error)


def rescued(path: Path | str, target: Path | str) -> tuple[str, ...]:
    """Write the intact content of a damaged case to a new file; the original stays unchanged.

    A step with a lost part stays, without that part: a target whose path is lost keeps its position, for example.

    Parameters
    ----------
    path
        The damaged file; only a copy of it is opened.
    target
        The new file; it must not exist.

    Returns
    -------
    tuple of str
        Descriptions of the losses for the user; empty if nothing was lost.

    Raises
    ------
    CaseFileError
        If nothing can be recovered.
    DiskError
        If the new file cannot be written.
    """
    place = Path(path)
    with convert_disk_errors(place), ScratchFolder() as folder:
        check_header(place)
        copy = copied_with_journal(place, folder)
        with contextlib.closing(open_connection(copy, "rw")) as connection:
            return _Rescue(connection, place).write(Path(target))


class _Rescue:
    """Reader of a damaged case that collects the intact content and records what is lost."""

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self._connection, self._path = connection, path
        self._lost: list[str] = []
        with contextlib.suppress(sqlite3.Error):
            if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
                raise unusable_file_error(
                    path, "it is not a Carina case; choose a .carina file", code="case.not-a-case"
                )
        try:
            self._source = read_source(connection)
        except TROUBLE as error:
            raise unusable_file_error(
                path,
                f"nothing can be recovered, because the record of its scan is lost ({error})",
                code="case.damaged",
            ) from error
        if int(np.prod(np.array(self._source.shape_zyx, dtype=np.float64))) > MAX_VOXELS:
            raise unusable_file_error(
                path,
                "nothing can be recovered, because the recorded size of its scan is impossible",
                code="case.damaged",
            )
        # Only the grid of this volume is used; unread pages of zeros need no physical memory.
        standing_in = Volume(np.zeros(self._source.shape_zyx, np.int16), self._source.lps_from_ijk, self._source.is_hu)
        turn = axis_permutation(self._source, standing_in)
        assert turn is not None
        self._reader = CaseReader(self._content(), standing_in, _ignore_object, turn)
        self._whole: dict[int, bool] = {}

    def write(self, target: Path) -> tuple[str, ...]:
        """Write the intact content to a new case file and return the list of losses."""
        moment = self._intact_moment()
        with CaseFile.create(target, self._source) as made:
            made.save(moment)
            self._copy_recordings(made)
            self._copy_extras(made)
            self._copy_scan(made)
        return tuple(self._lost)

    def _content(self) -> Rows:
        schema = SCHEMA
        with contextlib.suppress(sqlite3.Error):
            schema = self._connection.execute("PRAGMA user_version").fetchone()[0]
        tables = [table for table in CONTENT if SINCE.get(table, 1) <= max(schema, 1)]
        found: Rows = {table: {} for table in CONTENT}
        return found | {table: {row[0]: row[1:] for row in self._rows(table, "*")} for table in tables}

    def _rows(self, table: str, columns: str, key: str = "id") -> Iterator[tuple[Any, ...]]:
        """Yield the readable rows of a table: in one query, and after an error one by one by their number."""
        seen = 0
        last: int | None = None
        try:
            sql = f"SELECT {columns} FROM {table} ORDER BY {key} LIMIT {MAX_ROWS}"
            for row in self._connection.execute(sql):
                seen += 1
                last = row[0] if isinstance(row[0], int) else last
                yield row
            return
        except sqlite3.Error as error:
            self._lost.append(f"part of the table {table} ({error})")
        ahead = last or 0
        misses = 0
        while seen < MAX_ROWS and misses < 2000:
            ahead += 1
            try:
                row = self._connection.execute(f"SELECT {columns} FROM {table} WHERE {key} = ?", (ahead,)).fetchone()
            except sqlite3.Error:
                row = None
            if row is None:
                misses += 1
                continue
            misses, seen = 0, seen + 1
            yield row

    def _intact_moment(self) -> Moment:
        """Return the case state with all steps whose documents are intact at least in part."""
        rows = list(self._rows("step", "n, label, command, at_s, document", "n"))[:MAX_STEPS]
        position, facts = self._facts(len(rows))
        documents: list[tuple[tuple[Any, ...], Document]] = []
        for row in rows:
            document = self._document(row)
            if document is not None:
                documents.append((row, document))
            elif row[0] <= (rows[0][0] + position):
                position -= 1
        if not documents:
            raise unusable_file_error(
                self._path,
                "nothing can be recovered, because all the changes recorded in it are lost",
                code="case.damaged",
            )
        return Moment(
            first=documents[0][1],
            steps=tuple(
                Step(shortened_text(str(label), MAX_LABEL_CHARS), document, self._command(command), _seconds(at_s))
                for (_, label, command, at_s, _), document in documents[1:]
            ),
            position=min(max(position, 0), len(documents) - 1),
            sight=facts.sight,
            tip=facts.tip,
            scope=None if facts.scope is None else ScopeHold(*msgspec.structs.astuple(facts.scope)),
            search_status=facts.search_status,
            search_words=facts.search_words,
            person_moved=facts.person_moved,
            numbers=facts.numbers,
            measures=self._measures(documents),
        )

    def _measures(self, documents: Sequence[tuple[tuple[Any, ...], Document]]) -> tuple[tuple[Any, Any], ...]:
        """Return the intact measures of the intact airways."""
        found: dict[int, tuple[Any, Any]] = {}
        lost: set[int] = set()
        for (n, label, _, _, row), document in documents:
            if document.airways is None:
                continue
            airways = self._reader.airways_of(row)
            stored = None if airways is None else self._reader.measures_of(airways)
            if stored is None or stored.row in found or stored.row in lost:
                continue
            try:
                found[stored.row] = document.airways, stored.load()
            except TROUBLE:
                lost.add(stored.row)
                self._lost.append(f"step {n} ({str(label)[:80] or 'the start'}): the measurements of the airways")
        return tuple(found.values())

    def _facts(self, num_steps: int) -> tuple[int, f.MomentFacts]:
        try:
            with convert_value_errors():
                position, json_text = self._connection.execute("SELECT position, facts FROM moment").fetchone()
                facts: f.MomentFacts = from_json(json_text, f.decoders().moment, "current state")
                check_tip(facts.tip, "tip", has_route=True)
                return int(position), facts
        except TROUBLE:
            self._lost.append("the displayed views and the tip position")
            numbers = {"target": 10_000, "key": 10_000}  # higher than any assigned number
            return max(num_steps - 1, 0), f.MomentFacts(Sight(), {}, None, "found", None, True, numbers)

    def _command(self, json_text: Any) -> Any:
        try:
            return f.command_from_json(json_text, "a step")
        except CaseFileError:
            return None

    def _document(self, step: tuple[Any, ...]) -> Document | None:
        """Return the document of a step, if necessary without its damaged parts; None if it is lost."""
        n, label, _, _, row = step
        what = f"step {n} ({str(label)[:80] or 'the start'})"
        try:
            with convert_value_errors():
                document = self._reader.document(row)
                stored: Any = document.airways
                if stored is None or self._is_whole(row):
                    return document
        except TROUBLE:
            pass
        try:
            with convert_value_errors():
                return self._without_damage(row, what)
        except TROUBLE as error:
            self._lost.append(f"{what}: {error}")
            return None

    def _is_whole(self, document: int) -> bool:
        row = self._reader.airways_of(document)
        return row is None or self._airways_are_whole(row)

    def _airways_are_whole(self, row: int) -> bool:
        if row not in self._whole:
            try:
                with convert_value_errors():
                    self._reader.airways(row)
                self._whole[row] = True
            except TROUBLE:
                self._whole[row] = False
        return self._whole[row]

    def _without_damage(self, row: int, what: str) -> Document:
        """Return the document in a row without its damaged parts, which are added to the losses."""
        reader = self._reader
        airways, route, transfer, look, targets, keys, threshold = reader.columns("document", row)

        def read_part(name: str, read: Any, otherwise: Any) -> Any:
            try:
                with convert_value_errors():
                    return read()
            except TROUBLE:
                self._lost.append(f"{what}: {name}")
                return otherwise

        whole = airways is not None and self._airways_are_whole(airways)
        if airways is not None and not whole:
            self._lost.append(f"{what}: the airways")
        return Document(
            transfer=read_part(
                "the transfer function", lambda: reader.transfer(transfer), transfer_preset("endoscopic")
            ),
            look=read_part("the scope and lens settings", lambda: reader.look(look), Look()),
            airways=read_part("the airways", lambda: reader.any_airways(airways), None) if whole else None,
            lumen_threshold=threshold
            if isinstance(threshold, float) and -MAX_NUMBER <= threshold <= MAX_NUMBER
            else None,
            targets=read_part("the targets", lambda: self._targets(targets, what), ()),
            route=None if route is None else read_part("the route", lambda: reader.route(route), None),
            key_frames=read_part("the key frames", lambda: reader.keys(keys), KeyFrames()),
        )

    def _targets(self, row: int, what: str) -> Sequence[Target]:
        found: list[Target] = []
        for json_text in self._reader.target_facts(row):
            try:
                with convert_value_errors():
                    found += self._reader.targets_from_facts((json_text,))
            except TROUBLE:
                found.append(self._part_of_target(json_text, what))
        return tuple(found)

    def _part_of_target(self, json_text: TargetFacts, what: str) -> Target:
        """Return a target without its damaged part, either its lesion or its path."""
        if json_text.lesion is not None:
            try:
                with convert_value_errors():
                    (one,) = self._reader.targets_from_facts((msgspec.structs.replace(json_text, lesion=None),))
                self._lost.append(f"{what}: the boundary of {json_text.name}")
                return replace(one, problem="its boundary was lost when the case file was damaged: mark it again")
            except TROUBLE:
                pass
        self._lost.append(f"{what}: the path to {json_text.name}")
        (one,) = self._reader.targets_from_facts((msgspec.structs.replace(json_text, route=None),))
        return replace(one, problem="its path was lost when the case file was damaged")

    def _copy_recordings(self, made: CaseFile) -> None:
        for number, name, begun_s, words in self._rows("recording", "id, name, begun_s, words"):
            table = CaseFile(self._path, self._connection, read_only=True)._recording_table()
            try:
                with convert_value_errors():
                    text = table.text(number)
                    begun = _seconds(begun_s)
            except TROUBLE:
                self._lost.append(f"the recording {str(name)[:80]}")
                continue
            with made.record(str(name), begun_s=begun) as writer:
                writer.write(text)
            made.change_recording(writer.recording_id, words=str(words))

    def _copy_scan(self, made: CaseFile) -> None:
        try:
            with convert_value_errors():
                volume = packed_volume(self._connection)
            if volume is not None:
                made.pack(volume)
        except (*TROUBLE, UsageError):
            self._lost.append("the packed scan")

    def _copy_extras(self, made: CaseFile) -> None:
        stored: dict[str, list[Any]] = {}
        with contextlib.suppress(sqlite3.Error):
            for kind, json_text in self._connection.execute(
                "SELECT kind, json FROM extra WHERE kind != 'save' ORDER BY kind, n LIMIT 100000"
            ):
                try:
                    value = from_json(json_text, f.decoders().extra, "extra")
                except CaseFileError:
                    self._lost.append(f"part of the extra data ({str(kind)[:80]})")
                else:
                    stored.setdefault(str(kind), []).append(value)
        for kind, values in stored.items():
            made.set_extra(kind, tuple(values))


def _seconds(value: object) -> float:
    """Return the time of a step or recording in seconds; 0 if it is lost."""
    return value if isinstance(value, float) and 0.0 <= value <= MAX_S else 0.0


def _ignore_object(_kind: str, _value: object, _row: int) -> None:
    """Ignore an object that was read from a row; the new file has no references to rows of the old one."""
