"""Writer that stores a case state as rows; values that are stored already are not written twice."""

from __future__ import annotations

import contextlib
import logging
import math
import sqlite3
import weakref
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.case import json_records as f
from carina.case.bounds import MAX_LABEL_CHARS, MAX_S, is_readable_tip, shortened_text
from carina.case.compression import as_checked_json, content_digest, deflate, pack_ints
from carina.case.document import Document, KeyFrames, Target
from carina.case.history import Step
from carina.case.lumen_tiles import to_tiles
from carina.case.measures import branch_facts, flags_of, sections_of
from carina.case.reading import StoredAirways, StoredMeasures
from carina.case.routes import ChosenRoute
from carina.case.schema import CONTENT
from carina.case.sized_targets import lesion_facts
from carina.case.stored_state import Moment
from carina.commands.value import LocalCommand
from carina.errors import CarinaError, UsageError
from carina.render import TransferFunction
from carina.track import Airways, AirwayTree, Branch, BranchMeasures, TreeMeasures, edits_to_json
from carina.track.edit.undo_storage import FoldedAirways, PackedAirways
from carina.track.paths.tracker import PathTracker
from carina.version import VERSION

logger = logging.getLogger(__name__)

StepRow = tuple[str, str | None, float, int]
"""Values of a row of the table of steps: label, command as JSON, seconds, and row of the document."""
_DTYPES = {"f": "f8", "i": "i8", "u": "u4"}


class _Identities:
    """Row numbers of stored objects, by object identity; the weak references do not prevent their deletion."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, int], tuple[weakref.ref[Any], int]] = {}

    def find(self, kind: str, value: object) -> int | None:
        known = self._rows.get((kind, id(value)))
        return known[1] if known is not None and known[0]() is value else None

    def note(self, kind: str, value: object, row: int) -> None:
        key = (kind, id(value))
        self._rows[key] = (weakref.ref(value, lambda _reference: self._rows.pop(key, None)), row)


class CaseWriter:
    """Writer of case states into the tables of one case file, in a transaction that the caller opened.

    Parameters
    ----------
    connection
        The case file.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._ids: dict[str, dict[bytes, int]] = {
            table: {bytes(d): n for n, d in connection.execute(f"SELECT id, digest FROM {table}")} for table in CONTENT
        }
        self._next = {table: 1 + max(ids.values(), default=0) for table, ids in self._ids.items()}
        self._decoders = f.decoders()
        self._weak = _Identities()
        self._branches: dict[tuple[int, int, int | None], int] = {}
        self._of_last: dict[tuple[str, int], tuple[object, int]] = {}
        self._of_this: dict[tuple[str, int], tuple[object, int]] = {}
        rows = connection.execute("SELECT n, label, command, at_s, document FROM step ORDER BY n").fetchall()
        self._steps: list[tuple[object, StepRow]] = [(None, row[1:]) for row in rows]
        self._first_n = rows[0][0] if rows else 0
        self._pending = (self._steps, self._first_n)
        self.reader: object = None
        """Reader of this file, whose rows need not be written again."""

    def register_row(self, kind: str, value: object, row: int) -> None:
        """Store the row number of an object that was read from this file.

        Parameters
        ----------
        kind
            Name of the table, or kind of the value.
        value
            The object.
        row
            Number of the row that stores the object.
        """
        if kind in {"array", "lumen", "tracker", "sections"}:
            self._weak.note(kind, value, row)
        else:
            self._of_last[kind, id(value)] = (value, row)

    def write(self, moment: Moment) -> None:
        """Write the rows of a case state that are not stored yet."""
        self._of_this = {}
        entries = [(moment, self._first_document_row(moment)), *((step, self._step(step)) for step in moment.steps)]
        self._write_steps(entries)
        for airways, measures in moment.measures:
            self._measures(self._airways(airways), measures)
        scope = moment.scope
        has_route = moment.history().current.route is not None
        facts = f.MomentFacts(
            sight=moment.sight,
            tip=moment.tip if is_readable_tip(moment.tip, has_route=has_route) else {},
            scope=None if scope is None else f.ScopeFacts(scope.insertion_mm, scope.roll_rad, scope.flexion_rad),
            search_status=moment.search_status,
            search_words=moment.search_words,
            person_moved=moment.person_moved,
            numbers=moment.numbers,
            saved_by=VERSION,
        )
        row = (moment.position, as_checked_json(facts, self._decoders.moment, "the current state"))
        self._connection.execute("INSERT OR REPLACE INTO moment (id, position, facts) VALUES (1, ?, ?)", row)

    def commit_rows(self) -> None:
        """Mark the written rows as stored after the commit; only objects of this state stay referenced."""
        self._of_last = self._of_this
        self._steps, self._first_n = self._pending

    def _first_document_row(self, moment: Moment) -> StepRow:
        return ("", None, 0.0, self._document(moment.first))

    def _step(self, step: Step[Document]) -> StepRow:
        command = step.command
        json_text = None
        if command is not None and not isinstance(command, LocalCommand):
            # A command of a program may exceed the bounds for reading; the step is then stored with its label only.
            with contextlib.suppress(UsageError):
                json_text = as_checked_json(command, self._decoders.command, "a command")
        label = shortened_text(step.label, MAX_LABEL_CHARS)
        # A time of a wrong system clock must not make the case unreadable.
        at_s = min(max(float(step.at_s), 0.0), MAX_S) if math.isfinite(step.at_s) else 0.0
        return (label, json_text, at_s, self._document(step.document))

    def _write_steps(self, entries: list[tuple[object, StepRow]]) -> None:
        """Write only rows that changed; if the oldest steps were deleted, the others keep their numbers."""
        rows = [row for _, row in entries]
        old = [row for _, row in self._steps]
        shift = 0
        if len(entries) > 1 and len(self._steps) > 1:
            first_step = entries[1][0]
            shift = next((n - 1 for n, (one, _) in enumerate(self._steps) if n and one is first_step), 0)
        first_n = self._first_n + shift
        change = self._connection.execute
        if shift:
            change("DELETE FROM step WHERE n < ?", (first_n,))
        for place, row in enumerate(rows):
            if not (0 <= place + shift < len(old)) or old[place + shift] != row:
                change(
                    "INSERT OR REPLACE INTO step (n, label, command, at_s, document) VALUES (?, ?, ?, ?, ?)",
                    (first_n + place, *row),
                )
        if first_n + len(rows) < self._first_n + len(old):
            change("DELETE FROM step WHERE n >= ?", (first_n + len(rows),))
        self._pending = (entries, first_n)

    def set_written_steps(self, entries: list[tuple[object, StepRow]], first_n: int) -> None:
        """Set the steps that were read from the file as already written."""
        self._steps, self._first_n = entries, first_n

    def _document(self, document: Document) -> int:
        """Return the row of a document; write the document if it is not stored yet."""
        known = self._known_row("document", document)
        if known is not None:
            self._retain_parts(document)
            return known
        values = {
            "airways": None if document.airways is None else self._airways(document.airways),
            "route": None if document.route is None else self._route(document.route),
            "transfer": self._value("transfer", document.transfer, lambda: _transfer_as_json(document.transfer)),
            "look": self._value("look", document.look, lambda: document.look),
            "targets": self._value("targets", document.targets, lambda: [self._target(t) for t in document.targets]),
            "keys": self._value("keys", document.key_frames, lambda: _key_frames_as_facts(document.key_frames)),
            "lumen_threshold": None if document.lumen_threshold is None else float(document.lumen_threshold),
        }
        return self._register_row("document", document, self._put("document", values))

    def _retain_parts(self, document: Document) -> None:
        """Retain the row numbers of an already stored document's parts for the next save."""
        parts: list[tuple[str, object]] = [
            ("transfer", document.transfer),
            ("look", document.look),
            ("targets", document.targets),
            ("keys", document.key_frames),
            ("airways", document.airways),
            ("airways", getattr(document.airways, "base", None)),
            ("route", document.route),
            *(("route", target.route) for target in document.targets),
        ]
        for kind, value in parts:
            if value is not None:
                self._known_row(kind, value)

    def _target(self, target: Target) -> f.TargetFacts:
        return f.TargetFacts(
            target_id=target.target_id,
            name=target.name,
            lps=_three_floats(target.lps),
            used_lps=None if target.used_lps is None else _three_floats(target.used_lps),
            snapped_mm=target.snapped_mm,
            length_mm=target.length_mm,
            problem=target.problem,
            route=None if target.route is None else self._route(target.route),
            cost=target.cost,
            root_lps=None if target.root_lps is None else _three_floats(target.root_lps),
            outside_mm=target.outside_mm,
            crossings_mm=target.crossings_mm,
            value_range=target.value_range,
            lesion=None if target.lesion is None else lesion_facts(target.lesion),
            note=target.note,
            priority=target.priority,
        )

    def _route(self, route: ChosenRoute) -> int:
        """Return the row of a route; write the route if it is not stored yet."""
        known = self._known_row("route", route)
        if known is not None:
            return known
        path = route.path
        made = path.made_from()
        drawn = route.drawn
        facts = f.RouteFacts(
            route_id=route.route_id,
            title=route.title,
            forks_mm=route.forks_mm,
            lookouts_mm=route.lookouts_mm,
            spans=tuple(
                f.SpanFacts(s.branch_id, s.name, s.generation, s.from_mm, s.to_mm, s.kind) for s in route.spans
            ),
            target_id=route.target_id,
            branch_id=route.branch_id,
            drawn=(drawn.length_mm, drawn.drawn_mm, drawn.bridge_mm),
            up_lps=made["up_lps"],
            path_forks_mm=made["forks_mm"],
            path_lookouts_mm=made["lookouts_mm"],
            max_deviation_mm=made["max_deviation_mm"],
            lumen_known=route.lumen_known,
            needle=route.needle,
        )
        names = ("points_lps", "cumulative_mm", "radius_mm", "wall_mm", "generation", "branch_ids")
        values: dict[str, Any] = {
            ("points" if name == "points_lps" else name): self._array(getattr(route, name)) for name in names
        }
        values["path_points"] = self._array(path.source_lps)
        values["facts"] = as_checked_json(facts, self._decoders.route, "a route")
        return self._register_row("route", route, self._put("route", values))

    def _airways(self, airways: Airways | FoldedAirways) -> int:
        """Return the number of the table row that stores the airways; write the row if it does not exist yet.

        The airways may be in memory, packed in the undo history, or stored in another case file.
        """
        known = self._known_row("airways", airways)
        if known is not None:
            return known
        if isinstance(airways, StoredAirways):
            own = airways.reader is self.reader
            row = airways.row if own else self._whole_airways(airways.reader.airways(airways.row))
        elif isinstance(airways, PackedAirways):
            row = self._packed_airways(airways)
        elif isinstance(airways, Airways):
            row = self._whole_airways(airways)
        else:
            raise UsageError(f"expected airways for a case file; found {type(airways).__name__}")
        return self._register_row("airways", airways, row)

    def _packed_airways(self, packed: PackedAirways) -> int:
        # If the airways were packed from airways that are stored, both have the same branches and edits.
        for (kind, _), (value, row) in (*self._of_this.items(), *self._of_last.items()):
            if kind == "airways" and isinstance(value, Airways) and _is_packed_copy(value, packed):
                return row
        return self._whole_airways(packed.unfold())

    def _whole_airways(self, airways: Airways) -> int:
        lumen, tree = self._lumen(airways.tracker.lumen_zyx), self._tree(airways.tree.branches, airways.tree)
        facts = f.AirwaysFacts(
            root_lps=_three_floats(airways.root_lps),
            threshold=None if math.isnan(airways.threshold) else float(airways.threshold),
            notes=tuple(airways.notes),
            wall_levels=None if airways.wall_levels is None else _three_floats(airways.wall_levels),
            next_id=airways.next_id,
            edits=tuple(
                self._value("edit", edit, lambda edit=edit: edits_to_json((edit,))["edits"][0])
                for edit in airways.edits
            ),
            uncertain=self._value("uncertain", airways.uncertain, lambda: airways.uncertain),
            bridges=tuple(self._array(bridge) for bridge in airways.bridges),
            found_by=VERSION if airways.base is None else None,
        )
        values = {
            "base": None if airways.base is None else self._airways(airways.base),
            "lumen": lumen,
            "tree": tree,
            "tracker": self._tracker(airways.tracker, lumen, airways.wall_levels),
            "facts": as_checked_json(facts, self._decoders.airways, "the airways"),
        }
        return self._put("airways", values)

    def _tracker(self, tracker: PathTracker, lumen: int, levels: tuple[float, float, float] | None) -> int:
        known = self._weak.find("tracker", tracker)
        if known is not None:
            return known
        i, j, k = tracker.root_ijk
        given = tracker.given_nodes
        values = {
            "lumen": lumen,
            "tree": self._tree(tracker.branches, None),
            "root_i": i,
            "root_j": j,
            "root_k": k,
            "levels": as_checked_json(levels, self._decoders.levels, "the wall levels"),
            "nodes": None if given is None else self._array(np.concatenate(given)),
            "num_nodes": None if given is None else self._array(np.array([len(n) for n in given], dtype=np.int64)),
        }
        row = self._put("tracker", values)
        self._weak.note("tracker", tracker, row)
        return row

    def _tree(self, branches: tuple[Branch, ...], tree: AirwayTree | None) -> int:
        """Return the row of a tree; write the tree and its branches if they are not stored yet."""
        rows = [self._branch(branch) for branch in branches]
        facts = f.TreeFacts(
            branches=tuple(
                f.BranchFacts(
                    id=b.id,
                    parent=b.parent,
                    children=tuple(b.children),
                    generation=b.generation,
                    kind=b.kind,  # type: ignore[arg-type]  # one of these words
                    name=b.name,
                    cost=b.cost,
                    confidence=b.confidence,
                    name_confidence=b.name_confidence,
                    name_from=b.name_from,  # type: ignore[arg-type]
                    variant=b.variant,
                    doubtful_mm=b.doubtful_mm,
                )
                for b in branches
            ),
            notes=() if tree is None else tuple(f.BadgeFacts(n.code, n.words, n.badge) for n in tree.notes),
        )
        words = as_checked_json(facts, self._decoders.tree, "the airway tree").encode()
        digest = content_digest("tree", np.array(rows, dtype="<i4").tobytes(), words)
        known = self._ids["tree"].get(digest)
        if known is not None:
            return known
        values = {
            "num_branches": len(rows),
            "branches": pack_ints(rows),
            "size": len(words),
            "facts": deflate(words),
        }
        return self._insert("tree", digest, values)

    def _branch(self, branch: Branch) -> int:
        wall = branch.wall_mm
        points, radius = self._array(branch.points), self._array(branch.radius)
        key = (points, radius, None if wall is None else self._array(wall))
        known = self._branches.get(key)
        if known is None:
            values = dict(zip(("points", "radius", "wall"), key, strict=True))
            known = self._branches[key] = self._put("branch", values)
        return known

    def _lumen(self, lumen_zyx: NDArray[np.uint8]) -> int:
        """Return the row of a lumen; write its tiles if they are not stored yet."""
        known = self._weak.find("lumen", lumen_zyx)
        if known is not None:
            return known
        tiles = to_tiles(lumen_zyx)
        rows = []
        for _, bits in tiles:
            digest = content_digest("tile", bits)
            row = self._ids["tile"].get(digest)
            rows.append(self._insert("tile", digest, {"data": deflate(bits)}) if row is None else row)
        places = np.array([place for place, _ in tiles], dtype="<i4")
        nz, ny, nx = lumen_zyx.shape
        digest = content_digest("lumen", nz, ny, nx, places.tobytes(), np.array(rows, dtype="<i4").tobytes())
        found = self._ids["lumen"].get(digest)
        if found is None:
            values = {
                "nz": nz,
                "ny": ny,
                "nx": nx,
                "num_tiles": len(rows),
                "places": pack_ints(places),
                "tiles": pack_ints(rows),
            }
            found = self._insert("lumen", digest, values)
        self._weak.note("lumen", lumen_zyx, found)
        return found

    def _measures(self, airways: int, measures: TreeMeasures | StoredMeasures) -> None:
        """Write the measures of airways in place of their former ones."""
        if self._known_row("measures", measures) is not None:
            return
        if isinstance(measures, StoredMeasures) and measures.reader is self.reader:
            self._register_row("measures", measures, measures.row)
            return
        try:
            whole = measures.load() if isinstance(measures, StoredMeasures) else measures
            row = self._whole_measures(airways, whole)
        except CarinaError as error:
            # Measures can be computed again, so the user's work is saved without them.
            logger.warning("the measurements of the airways could not be saved (%s)", error.code)
            row = 0
        self._register_row("measures", measures, row)

    def _whole_measures(self, airways: int, measures: TreeMeasures) -> int:
        forks = {fork.branch_id: fork for fork in measures.forks}
        rows = [self._measured_branch(branch, forks.get(branch.branch_id)) for branch in measures.branches]
        facts = f.MeasuresFacts(measures.blur_mm, measures.noise, tuple(measures.notes))
        values = {
            "airways": airways,
            "branches": pack_ints(rows),
            "facts": as_checked_json(facts, self._decoders.measures, "the measurements of the airways"),
        }
        digest = content_digest("measures", *values.values())
        known = self._ids["measures"].get(digest)
        if known is not None:
            return known
        # Airways have at most one row of measures.
        for (old,) in self._connection.execute("SELECT digest FROM measures WHERE airways = ?", (airways,)).fetchall():
            self._connection.execute("DELETE FROM measures WHERE airways = ?", (airways,))
            self._ids["measures"].pop(bytes(old), None)
        return self._insert("measures", digest, values)

    def _measured_branch(self, branch: BranchMeasures, fork: Any) -> int:
        # An edit passes on the rays of branches that it leaves unchanged, so their array identifies stored sections.
        known = self._weak.find("sections", branch.edge_mm)
        if known is None:
            known = self._put("sections", sections_of(branch))
            self._weak.note("sections", branch.edge_mm, known)
        facts = branch_facts(branch, fork)
        json_text = as_checked_json(facts, self._decoders.measured, f"the measurements of branch {branch.branch_id}")
        return self._put("measured_branch", {"sections": known, "flags": flags_of(branch), "facts": json_text})

    def _array(self, array: NDArray[Any]) -> int:
        """Return the row of an array; write the array if it is not stored yet."""
        known = self._weak.find("array", array)
        if known is not None:
            return known
        dtype = _DTYPES[array.dtype.kind] if array.dtype.itemsize == 8 else f"{array.dtype.kind}{array.dtype.itemsize}"
        content = np.ascontiguousarray(array, dtype=f"<{dtype}")
        count, width = len(content), 0 if content.ndim == 1 else content.shape[1]
        raw = content.tobytes()
        digest = content_digest("array", dtype, count, width, raw)
        row = self._ids["array"].get(digest)
        if row is None:
            values = {"dtype": dtype, "count": count, "width": width, "data": deflate(raw)}
            row = self._insert("array", digest, values)
        self._weak.note("array", array, row)
        return row

    def _value(self, kind: str, value: object, json_of: Any) -> int:
        known = self._known_row(kind, value)
        if known is not None:
            return known
        json_text = as_checked_json(json_of(), getattr(self._decoders, kind), f"a value of kind {kind}")
        return self._register_row(kind, value, self._put("value", {"kind": kind, "json": json_text}))

    def _put(self, table: str, values: dict[str, Any]) -> int:
        """Return the row with these values; insert a new row if there is none."""
        digest = content_digest(table, *values.values())
        known = self._ids[table].get(digest)
        return self._insert(table, digest, values) if known is None else known

    def _insert(self, table: str, digest: bytes, values: dict[str, Any]) -> int:
        row = self._next[table]
        names = ", ".join(("id", "digest", *values))
        marks = ", ".join("?" * (len(values) + 2))
        self._connection.execute(f"INSERT INTO {table} ({names}) VALUES ({marks})", (row, digest, *values.values()))
        self._next[table] = row + 1
        self._ids[table][digest] = row
        return row

    def _known_row(self, kind: str, value: object) -> int | None:
        known = self._of_this.get((kind, id(value))) or self._of_last.get((kind, id(value)))
        if known is None or known[0] is not value:
            return None
        self._of_this[kind, id(value)] = known
        return known[1]

    def _register_row(self, kind: str, value: object, row: int) -> int:
        self._of_this[kind, id(value)] = (value, row)
        return row


def _is_packed_copy(airways: Airways, packed: PackedAirways) -> bool:
    return airways.tree.branches is packed.branches and airways.edits is packed.edits


def _transfer_as_json(transfer: TransferFunction) -> dict[str, Any]:
    document = transfer.to_json()
    # Parse the JSON before it is written, so that nothing unreadable is stored.
    TransferFunction.from_json(document)
    return document


def _key_frames_as_facts(keys: KeyFrames) -> f.KeyFramesFacts:
    frames = tuple(
        f.KeyFrameFacts(
            key_id=key.key_id,
            lps_from_camera=tuple(key.pose.lps_from_camera.ravel().tolist()),
            name=key.name,
            speed_mm_s=key.speed_mm_s,
        )
        for key in keys.frames
    )
    return f.KeyFramesFacts(frames=frames, flying=keys.flying)


def _three_floats(values: Sequence[float] | NDArray[np.float64] | Iterable[float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
