"""Reader that builds a moment from the rows of a case file; airways far from the current step are read at first use."""

from __future__ import annotations

import dataclasses
import threading
import weakref
from collections.abc import Callable, Sequence
from typing import Any, Final, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.case import json_records as f
from carina.case.bounds import (
    MAX_MM,
    MAX_NUMBER,
    bounded_array,
    bounded_number,
    check_ascending,
    check_plain,
    check_tip,
)
from carina.case.compression import DTYPES, MAX_PIECE_BYTES, content_digest, from_json, inflate, unpack_ints
from carina.case.database import convert_value_errors
from carina.case.document import ChosenKeyFrame, Document, KeyFrames, Target
from carina.case.error_texts import damage_error
from carina.case.history import Step
from carina.case.lumen_tiles import TILE_BYTES, from_tiles, num_tiles
from carina.case.measures import branch_from, fork_from
from carina.case.routes import ChosenRoute, RouteSpan
from carina.case.sized_targets import lesion_from_facts
from carina.case.source import AxisPermutation
from carina.case.stored_state import Moment
from carina.commands.look import Look
from carina.errors import CarinaError
from carina.navigate import FlightPath
from carina.render import TransferFunction
from carina.scopes import Pose, ScopeHold
from carina.track import (
    Airways,
    AirwayTree,
    Branch,
    DrawnPart,
    TreeEdit,
    TreeMeasures,
    Uncertainty,
    edits_from_json,
    edits_to_json,
)
from carina.track.edit.undo_storage import FoldedAirways
from carina.track.find.per_volume_cache import PerVolumeCache
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.paths.tracker import PathTracker
from carina.track.tree.uncertainty import without_unproven_blocks
from carina.volume import Note, Volume

Rows = dict[str, dict[int, tuple[Any, ...]]]
"""Cache of the columns of content rows, except their id, by table name and row id."""
BOUNDS: Final = {"f8": (-MAX_MM, MAX_MM), "i8": (-1, 2**31), "u4": (0, 2**32)}
"""Minimum and maximum number in a stored array, by the array's type code."""
LENGTH_MM: Final = (0.0, MAX_MM)
NO_TREES: Final = 4
"""Maximum number of airway trees that stay in memory while airways are read: that of a base and those of its edits."""


class StoredAirways(FoldedAirways):
    """Edited airways of a step that is not shown; they are read from the case file when :meth:`unfold` is called."""

    __slots__ = ("base", "reader", "row")

    def __init__(self, reader: CaseReader, row: int, base: Airways) -> None:
        self.reader, self.row, self.base = reader, row, base

    def __repr__(self) -> str:
        """Return a text with the row number of the airways."""
        return f"StoredAirways(row={self.row})"

    def unfold(self) -> Airways:
        """Return the saved airways; their paths are computed at first use.

        Raises
        ------
        CaseFileError
            ``case.damaged``.
        """
        with convert_value_errors():
            return self.reader.airways(self.row)


class StoredMeasures:
    """Measures of airways in a case file; they are read when :meth:`load` is called."""

    __slots__ = ("reader", "row")

    def __init__(self, reader: CaseReader, row: int) -> None:
        self.reader, self.row = reader, row

    def __repr__(self) -> str:
        """Return a text with the row number of the measures."""
        return f"StoredMeasures(row={self.row})"

    def load(self) -> TreeMeasures:
        """Return the saved measures; nothing is measured again.

        Raises
        ------
        CaseFileError
            ``case.damaged``.
        """
        with convert_value_errors():
            return self.reader.measures(self.row)


class CaseReader:
    """Reader that builds documents, airways and moments from the rows of a case file.

    Parameters
    ----------
    rows
        All rows of the content tables.
    volume
        The CT, on the grid of the saved case.
    register_row
        Callback that receives the kind, the object and the row number of each object that was read.
    turn
        Order and direction of the case's axes relative to those of the volume.
    """

    def __init__(
        self, rows: Rows, volume: Volume, register_row: Callable[[str, object, int], None], turn: AxisPermutation
    ) -> None:
        self._turn = turn
        self._rows = rows
        self.volume = volume
        self._register_row = register_row
        self._decoders = f.decoders()
        self._lock = threading.RLock()
        self._arrays: weakref.WeakValueDictionary[int, NDArray[Any]] = weakref.WeakValueDictionary()
        self._lumens: weakref.WeakValueDictionary[int, NDArray[np.uint8]] = weakref.WeakValueDictionary()
        self._grids: dict[int, PathGrid] = {}
        """Grids of path searches by number of parts of a voxel; trackers on one grid share its volume."""
        self._num_voxels: dict[int, int] = {}
        """Number of voxels of each stored lumen, by the row number of the lumen."""
        self._trackers: weakref.WeakValueDictionary[int, PathTracker] = weakref.WeakValueDictionary()
        self._trees: dict[int, tuple[tuple[Branch, ...], tuple[Note, ...]]] = {}
        self._whole: dict[int, Airways] = {}
        self._folded: dict[int, StoredAirways] = {}
        self._routes: dict[int, ChosenRoute] = {}
        self._values: dict[tuple[str, int], Any] = {}
        self._documents: dict[int, Document] = {}
        self._measures = {columns[1]: row for row, columns in rows["measures"].items()}
        """Row number of the measures, by row number of their airways."""

    def moment(self, steps: Sequence[tuple[Any, ...]], position: int, facts: f.MomentFacts) -> Moment:
        """Return the case state with the given steps.

        Parameters
        ----------
        steps
            Label, command, seconds and row of the document for each step; the first entry is the first document.
        position
            Number of steps in effect.
        facts
            View, pose of the tip and other parts of the moment outside the history.

        Returns
        -------
        Moment
            The moment.

        Raises
        ------
        CaseFileError
            ``case.damaged``.
        """
        if not 1 <= position + 1 <= len(steps):
            raise damage_error("position in the history", f"0 to {len(steps) - 1}", str(position))
        with self._lock:
            # The airways of the current step are read first and in full: airways of other steps share data with them.
            present = self.airways_of(steps[position][3])
            if present is not None:
                self._whole[present] = self.airways(present)
            documents = [self.document(step[3]) for step in steps]
            measures = self._all_measures([step[3] for step in steps])
            if present is not None and self.columns("airways", present)[0] is not None:
                # The document refers to these airways. A reference of the reader would hold them in memory as long
                # as any step exists.
                del self._whole[present]
            check_tip(facts.tip, "tip", has_route=documents[position].route is not None)
            route = documents[position].route
            if route is not None:
                self._check_path(route)
            scope = facts.scope
            return Moment(
                first=documents[0],
                steps=tuple(
                    Step(label, document, f.command_from_json(command, "step"), at_s)
                    for (label, command, at_s, _), document in zip(steps[1:], documents[1:], strict=True)
                ),
                position=position,
                sight=facts.sight,
                tip=facts.tip,
                scope=None if scope is None else ScopeHold(scope.insertion_mm, scope.roll_rad, scope.flexion_rad),
                search_status=facts.search_status,
                search_words=facts.search_words,
                person_moved=facts.person_moved,
                numbers=facts.numbers,
                measures=measures,
            )

    def _check_path(self, route: ChosenRoute) -> None:
        """Raise an error if the shown route is not a valid flight path.

        The curves of other routes are checked when they are computed to be shown.
        """
        try:
            length_mm = route.path.length_mm
        except CarinaError as error:
            raise damage_error("route", "a flight path", f"points that make none ({str(error)[:200]})") from None
        bounded_number(length_mm, "route", *LENGTH_MM)

    def airways_of(self, document: int) -> int | None:
        """Return the row number of a document's airways; None if the document has none."""
        row: int | None = self.columns("document", document)[0]
        return row

    def _all_measures(self, documents: Sequence[int]) -> tuple[tuple[Any, StoredMeasures], ...]:
        """Return those airways of the given documents that were measured, each with its measures."""
        measured = dict.fromkeys(self.airways_of(document) for document in documents)
        found = []
        for row in measured:
            stored = None if row is None else self.measures_of(row)
            if row is not None and stored is not None:
                found.append((self.any_airways(row), stored))
        return tuple(found)

    def document(self, row: int) -> Document:
        """Return the document in a row of the table ``document``."""
        known = self._documents.get(row)
        if known is not None:
            return known
        airways, route, transfer, look, targets, keys, threshold = self.columns("document", row)
        made = Document(
            transfer=self.transfer(transfer),
            look=self.look(look),
            airways=None if airways is None else self.any_airways(airways),
            lumen_threshold=None
            if threshold is None
            else bounded_number(threshold, f"row {row} of document", -MAX_NUMBER, MAX_NUMBER),
            targets=self._value("targets", targets, self._decoders.targets, self.targets_from_facts),
            route=None if route is None else self.route(route),
            key_frames=self.keys(keys),
        )
        self._documents[row] = made
        self._register_row("document", made, row)
        return made

    def transfer(self, row: int) -> TransferFunction:
        """Return the transfer function in a row of the table ``value``."""
        made: TransferFunction = self._value("transfer", row, self._decoders.transfer, _transfer_from_json)
        return made

    def look(self, row: int) -> Look:
        """Return the look (scope, lens, outline, operator) in a row of the table ``value``."""
        made: Look = self._value("look", row, self._decoders.look, lambda look: look)
        return made

    def keys(self, row: int) -> KeyFrames:
        """Return the key frames in a row of the table ``value``."""
        made: KeyFrames = self._value("keys", row, self._decoders.keys, _key_frames_from_facts)
        return made

    def target_facts(self, row: int) -> tuple[f.TargetFacts, ...]:
        """Return the facts of the targets in a row of the table ``value``, without their paths."""
        _, json_text = self.columns("value", row)
        found: tuple[f.TargetFacts, ...] = from_json(
            json_text, self._decoders.targets, f"row {row} of value, kind targets"
        )
        return found

    def targets_from_facts(self, targets: tuple[f.TargetFacts, ...]) -> tuple[Target, ...]:
        """Return the targets, built from their facts, with their paths."""
        return tuple(
            Target(
                target_id=t.target_id,
                name=t.name,
                lps=t.lps,
                used_lps=t.used_lps,
                snapped_mm=t.snapped_mm,
                length_mm=t.length_mm,
                problem=t.problem,
                route=None if t.route is None else self.route(t.route),
                cost=t.cost,
                root_lps=t.root_lps,
                outside_mm=t.outside_mm,
                crossings_mm=t.crossings_mm,
                value_range=t.value_range,
                lesion=None if t.lesion is None else lesion_from_facts(t.lesion),
                note=t.note,
                priority=t.priority,
            )
            for t in targets
        )

    def route(self, row: int) -> ChosenRoute:
        """Return the route in a row of the table ``route``."""
        known = self._routes.get(row)
        if known is not None:
            return known
        *columns, json_text = self.columns("route", row)
        where = f"route {row}"
        facts: f.RouteFacts = from_json(json_text, self._decoders.route, where)
        points = self._array(columns[0], "f8", width=3)
        kinds = ("f8", "f8", "f8", "i8", "i8")
        bounds = (LENGTH_MM, LENGTH_MM, LENGTH_MM, None, None)
        rest = [
            self._array(one, kind, count=len(points), bounds=limits)
            for one, kind, limits in zip(columns[1:6], kinds, bounds, strict=True)
        ]
        for places in (rest[0], facts.forks_mm, facts.lookouts_mm, facts.path_forks_mm, facts.path_lookouts_mm):
            check_ascending(places, where)
        path_points = self._array(columns[6], "f8", width=3)
        if len(points) < 2 or len(path_points) < 2:
            raise damage_error(where, "at least two points", f"{len(points)}")
        path = FlightPath.made_before(
            path_points,
            up_lps=facts.up_lps,
            forks_mm=facts.path_forks_mm,
            lookouts_mm=facts.path_lookouts_mm,
            max_deviation_mm=facts.max_deviation_mm,
        )
        made = ChosenRoute(
            route_id=facts.route_id,
            title=facts.title,
            points_lps=points,
            cumulative_mm=rest[0],
            radius_mm=rest[1],
            wall_mm=rest[2],
            generation=rest[3],
            branch_ids=rest[4],
            forks_mm=facts.forks_mm,
            lookouts_mm=facts.lookouts_mm,
            spans=tuple(
                RouteSpan(s.branch_id, s.name, s.generation, s.from_mm, s.to_mm, cast(Any, s.kind)) for s in facts.spans
            ),
            path=path,
            target_id=facts.target_id,
            branch_id=facts.branch_id,
            drawn=DrawnPart(*facts.drawn),
            lumen_known=facts.lumen_known,
            needle=facts.needle,
        )
        self._routes[row] = made
        self._register_row("route", made, row)
        return made

    def any_airways(self, row: int) -> Any:
        """Return the airways in a row: in full if they are unedited or shown, otherwise as :class:`StoredAirways`."""
        base = self.columns("airways", row)[0]
        if base is None or row in self._whole:
            whole = self._whole.get(row)
            if whole is None:
                whole = self._whole[row] = self.airways(row)
            return whole
        known = self._folded.get(row)
        if known is None:
            known = self._folded[row] = StoredAirways(self, row, self._unedited_airways(base))
            self._register_row("airways", known, row)
        return known

    def _unedited_airways(self, row: int) -> Airways:
        """Return the unedited airways in a row of the table ``airways``, in full, as the base of edited airways."""
        if self.columns("airways", row)[0] is not None:
            raise damage_error(f"row {row} of airways", "unedited airways as their base", "edited airways")
        whole = self._whole.get(row)
        if whole is None:
            whole = self._whole[row] = self.airways(row)
        return whole

    def airways(self, row: int) -> Airways:
        """Return the airways in a row of the table ``airways`` in full; their paths are computed at first use."""
        with self._lock:
            known = self._whole.get(row)
            return self._build_airways(row) if known is None else known

    def _build_airways(self, row: int) -> Airways:
        """Return the airways in a row, built from their lumen, tree and tracker."""
        base, lumen, tree, tracker, json_text = self.columns("airways", row)
        facts: f.AirwaysFacts = from_json(json_text, self._decoders.airways, f"row {row} of airways")
        columns = self.columns("tracker", tracker)
        levels = from_json(columns[5], self._decoders.levels, f"row {tracker} of tracker")
        if columns[0] != lumen or levels != facts.wall_levels:
            raise damage_error(f"row {row} of airways", "paths in its own lumen", "paths in another lumen")
        branches, notes = self._tree(tree)
        paths = self._tracker(tracker)
        whole_base = None if base is None else self._unedited_airways(base)
        made = Airways(
            lumen_zyx=paths.grid.lumen_on_ct(self._lumen(lumen), branches),
            root_lps=np.array(facts.root_lps, dtype=np.float64),
            tree=AirwayTree(branches, notes=notes, _smooth=paths.smooth),
            tracker=paths,
            threshold=float("nan") if facts.threshold is None else facts.threshold,
            notes=facts.notes,
            wall_levels=facts.wall_levels,
            edits=tuple(self._value("edit", edit, self._decoders.edit, _edit_from_facts) for edit in facts.edits),
            base=whole_base,
            next_id=facts.next_id,
            uncertain=self._value("uncertain", facts.uncertain, self._decoders.uncertain, _uncertainty_from_facts),
            bridges=tuple(self._array(bridge, "f8", width=3) for bridge in facts.bridges),
            evidence=PerVolumeCache() if whole_base is None else whole_base.evidence,
        )
        self._register_row("airways", made, row)
        return made

    def _tracker(self, row: int) -> PathTracker:
        """Return the path tracker in a row of the table ``tracker``, with its start point and its nodes."""
        known = self._trackers.get(row)
        if known is not None:
            return known
        where = f"row {row} of tracker"
        lumen, tree, i, j, k, json_text, nodes, num_nodes = self.columns("tracker", row)
        levels = from_json(json_text, self._decoders.levels, where)
        lumen_zyx = self._lumen(lumen)
        nz, ny, nx = self._rows_of("lumen", lumen)[:3]
        inside = 0 <= i < nx and 0 <= j < ny and 0 <= k < nz
        root = dataclasses.replace(self._turn, shape_zyx=(nz, ny, nx)).voxel((i, j, k))
        if not inside or not lumen_zyx[root[::-1]]:
            raise damage_error(where, "a start point in the lumen", f"voxel {(i, j, k)}")
        recipe = CoreRecipe(levels, is_edited=nodes is None)
        grid = self._grid((nz, ny, nx), where)
        made = PathTracker(grid, None, recipe=recipe, root_ijk=root, lumen_zyx=lumen_zyx)
        branches, _ = self._tree(tree)
        # Stored node numbers count along the axes of the case, so they are invalid for another order of axes.
        if nodes is None or not self._turn.is_identity:
            made.follow_branches(branches)
        else:
            all_nodes = self._array(nodes, "u4")
            counts = self._array(num_nodes, "i8", count=len(branches))
            ends = np.cumsum(counts)
            # The voxels of the lumen were counted in the tiles, because counting in the array would touch all of its
            # memory.
            num_voxels = self._num_voxels[lumen] if len(all_nodes) else 0
            if (counts < 1).any() or ends[-1] != len(all_nodes) or int(all_nodes.max()) >= num_voxels:
                raise damage_error(
                    where,
                    f"at least one node in the lumen for each of {len(branches)} branches",
                    f"{len(all_nodes)} nodes, some of which belong to no branch or lie outside the lumen",
                )
            made.set_branches(branches, np.split(all_nodes, ends[:-1]))
        self._trackers[row] = made
        self._register_row("tracker", made, row)
        return made

    def _tree(self, row: int) -> tuple[tuple[Branch, ...], tuple[Note, ...]]:
        """Return the branches and the notes of the tree in a row."""
        known = self._trees.get(row)
        if known is not None:
            return known
        where = f"row {row} of tree"
        count, packed, size, data = self._rows_of("tree", row)
        if not 1 <= count <= f.MAX_BRANCHES:
            raise damage_error(where, f"1 to {f.MAX_BRANCHES} branches", str(count))
        ids, words = unpack_ints(packed, count, where), inflate(data, size, where)
        self._check_digest("tree", row, content_digest("tree", ids.astype("<i4").tobytes(), words))
        facts: f.TreeFacts = from_json(words, self._decoders.tree, where)
        if len(facts.branches) != count:
            raise damage_error(where, f"{count} branches", str(len(facts.branches)))
        try:
            made = (
                tuple(self._branch(int(one), json_text) for one, json_text in zip(ids, facts.branches, strict=True)),
                tuple(Note(note.code, note.words, note.badge) for note in facts.notes),
            )
            AirwayTree(made[0])
        except CarinaError as error:
            raise damage_error(where, "a valid airway tree", f"an invalid one ({error})") from None
        while len(self._trees) >= NO_TREES:
            del self._trees[next(iter(self._trees))]
        self._trees[row] = made
        return made

    def _branch(self, row: int, facts: f.BranchFacts) -> Branch:
        """Return the branch whose points are in a row of the table ``branch`` and whose other values are given."""
        points, radius, wall = self.columns("branch", row)
        line = self._array(points, "f8", width=3)
        return Branch(
            id=facts.id,
            parent=facts.parent,
            children=facts.children,
            generation=facts.generation,
            name=facts.name,
            kind=facts.kind,
            points=line,
            radius=self._array(radius, "f8", count=len(line), bounds=LENGTH_MM),
            cost=facts.cost,
            confidence=facts.confidence,
            name_confidence=facts.name_confidence,
            name_from=facts.name_from,
            variant=facts.variant,
            doubtful_mm=facts.doubtful_mm,
            wall_mm=None if wall is None else self._array(wall, "f8", count=len(line), bounds=LENGTH_MM),
        )

    def _lumen(self, row: int) -> NDArray[np.uint8]:
        """Return the lumen in a row, joined from its tiles, in the axes of the volume."""
        known = self._lumens.get(row)
        if known is not None:
            return known
        where = f"row {row} of lumen"
        nz, ny, nx, count, packed_places, packed_tiles = self._rows_of("lumen", row)
        shape = (nz, ny, nx)
        self._grid(shape, where)
        most = num_tiles(shape)
        if not 0 <= count <= most:
            raise damage_error(where, f"at most {most} tiles", str(count))
        places, tiles = unpack_ints(packed_places, count, where), unpack_ints(packed_tiles, count, where)
        self._check_digest(
            "lumen",
            row,
            content_digest("lumen", nz, ny, nx, places.astype("<i4").tobytes(), tiles.astype("<i4").tobytes()),
        )
        if count and (places[0] < 0 or places[-1] >= most or (np.diff(places) <= 0).any()):
            raise damage_error(where, "tiles in ascending order", "a different order")
        bits = [self._tile(int(tile)) for tile in tiles]
        self._num_voxels[row] = sum(int.from_bytes(one).bit_count() for one in bits)
        made = self._turn.array_in_volume_axes(from_tiles(shape, zip(places.tolist(), bits, strict=True)))
        self._lumens[row] = made
        self._register_row("lumen", made, row)
        return made

    def _grid(self, shape_zyx: tuple[int, int, int], where: str) -> PathGrid:
        """Return the grid of a lumen: that of the CT, or a grid whose longest voxel edges are divided.

        Parameters
        ----------
        shape_zyx
            Shape of the lumen in the axes of the case.
        where
            Name of the row for messages.
        """
        i, j, k = (shape_zyx[::-1][axis] for axis in self._turn.axes)
        parts = PathGrid.parts_of(self.volume, (k, j, i))
        if parts is None:
            expected = f"the shape of the scan, {self._turn.shape_zyx}, or its longest voxels divided"
            raise damage_error(where, expected, str(shape_zyx))
        return self._grids.setdefault(parts, PathGrid(self.volume, parts))

    def _tile(self, row: int) -> bytes:
        (data,) = self._rows_of("tile", row)
        bits = inflate(data, TILE_BYTES, f"row {row} of tile")
        self._check_digest("tile", row, content_digest("tile", bits))
        return bits

    def measures_of(self, airways: int) -> StoredMeasures | None:
        """Return the measures of the airways in a row of the table ``airways``; None if they were not measured."""
        row = self._measures.get(airways)
        if row is None:
            return None
        stored = StoredMeasures(self, row)
        self._register_row("measures", stored, row)
        return stored

    def measures(self, row: int) -> TreeMeasures:
        """Return the measures in a row of the table ``measures``."""
        with self._lock:
            where = f"row {row} of measures"
            airways, packed, record = self.columns("measures", row)
            facts: f.MeasuresFacts = from_json(record, self._decoders.measures, where)
            branches, notes = self._tree(self.columns("airways", airways)[2])
            ids = unpack_ints(packed, len(branches), where)
            found, forks = [], []
            for one, branch in zip(ids, branches, strict=True):
                place = f"row {one} of measured_branch"
                sections, flags, of_branch = self.columns("measured_branch", int(one))
                json_text: f.MeasuredFacts = from_json(of_branch, self._decoders.measured, place)
                if json_text.branch_id != branch.id:
                    raise damage_error(place, f"branch {branch.id}", str(json_text.branch_id))
                columns = self.columns("sections", sections)
                found.append(branch_from(columns, flags, json_text, len(branch.points), place))
                self._register_row("sections", found[-1].edge_mm, sections)
                fork = fork_from(json_text)
                if fork is not None:
                    forks.append(fork)
            made = TreeMeasures.made_before(
                AirwayTree(branches, notes=notes),
                tuple(found),
                tuple(forks),
                blur_mm=facts.blur_mm,
                noise=facts.noise,
                notes=facts.notes,
            )
            self._register_row("measures", made, row)
            return made

    def _array(
        self,
        row: int,
        dtype: str,
        *,
        count: int | None = None,
        width: int = 0,
        bounds: tuple[float, float] | None = None,
    ) -> NDArray[Any]:
        """Return the array in a row after checking its digest, its type, its shape and its bounds."""
        known = self._arrays.get(row)
        where = f"row {row} of array"
        if known is None:
            kind, num, across, data = self._rows_of("array", row)
            if kind not in DTYPES or not 0 <= across <= 16 or not 0 <= num <= MAX_PIECE_BYTES:
                found_kind = f"type {kind} with {across} columns"
                raise damage_error(where, f"type {', '.join(DTYPES)} and at most 16 columns", found_kind)
            content = inflate(data, num * max(across, 1) * int(kind[1]), where)
            self._check_digest("array", row, content_digest("array", kind, num, across, content))
            found = np.frombuffer(content, dtype=DTYPES[kind])
            known = found.reshape(num, across) if across else found
            self._arrays[row] = known
            self._register_row("array", known, row)
        shape = known.shape
        if known.dtype.str != DTYPES[dtype] or len(shape) != (2 if width else 1) or (width and shape[1] != width):
            raise damage_error(where, f"{width or 1} columns of {dtype}", f"shape {shape} of {known.dtype}")
        if count is not None and shape[0] != count:
            raise damage_error(where, f"{count} numbers", str(shape[0]))
        bounded_array(known, where, *(bounds or BOUNDS[dtype]))
        return known

    def _value(self, kind: str, row: int, decoder: msgspec.json.Decoder[Any], make: Callable[[Any], Any]) -> Any:
        """Return the value in a row of the table ``value``, decoded from JSON and converted by ``make``."""
        if (kind, row) in self._values:
            return self._values[kind, row]
        where = f"row {row} of value, kind {kind}"
        found, json_text = self.columns("value", row)
        if found != kind:
            raise damage_error(where, "this kind", f"the kind {str(found)[:40]}")
        try:
            made = make(from_json(json_text, decoder, where))
        except CarinaError as error:
            if str(getattr(error, "code", "")).startswith("case."):
                raise
            raise damage_error(where, f"valid {kind} data", f"invalid data ({error})") from None
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            raise damage_error(where, f"valid {kind} data", f"invalid data ({str(error)[:200]})") from None
        self._values[kind, row] = made
        if kind != "edit":
            self._register_row(kind, made, row)
        return made

    def columns(self, table: str, row: int) -> tuple[Any, ...]:
        """Return the columns of a row after checking their digest."""
        columns = self._rows_of(table, row)
        self._check_digest(table, row, content_digest(table, *columns))
        return columns

    def _rows_of(self, table: str, row: int) -> tuple[Any, ...]:
        found = self._rows[table].get(row)
        if found is None:
            raise damage_error(f"row {row} of {table}", "an entry", "none")
        return found[1:]

    def _check_digest(self, table: str, row: int, digest: bytes) -> None:
        if self._rows[table][row][0] != digest:
            raise damage_error(f"row {row} of {table}", "content that matches its digest", "altered content")


def _edit_from_facts(row: dict[str, Any]) -> TreeEdit:
    """Return an airway edit from its stored fields; edits of programs may exceed the limits of the user interface."""
    check_plain(row, "an edit")
    (edit,) = edits_from_json({**edits_to_json(()), "edits": [row]})
    return edit


def _transfer_from_json(document: dict[str, Any]) -> TransferFunction:
    check_plain(document, "a transfer function")
    return TransferFunction.from_json(document)


def _uncertainty_from_facts(found: tuple[Uncertainty, ...]) -> tuple[Uncertainty, ...]:
    check_plain([msgspec.to_builtins(one) for one in found], "uncertain places")
    return without_unproven_blocks(found)


def _key_frames_from_facts(facts: f.KeyFramesFacts) -> KeyFrames:
    frames = tuple(
        ChosenKeyFrame(
            key_id=key.key_id,
            pose=Pose(np.array(key.lps_from_camera, dtype=np.float64).reshape(4, 4)),
            name=key.name,
            speed_mm_s=key.speed_mm_s,
        )
        for key in facts.frames
    )
    return KeyFrames(frames, facts.flying)
