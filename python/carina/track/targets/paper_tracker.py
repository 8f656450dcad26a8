"""Path tracker of the paper with its cost and graph, and every combination of costs and graphs (paper 6)."""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina._core import GraphTracker
from carina.errors import CancelledError, NoResultError, UsageError
from carina.track.find.result import Airways
from carina.track.paths.tracker import SNAP_MM, STEP_MM, TrackedPath, as_point, words
from carina.track.progress import Cancel, Progress
from carina.track.targets.excursions import replace_excursions
from carina.track.targets.path_union import tree_of_paths
from carina.track.targets.relaxed_path import evenly_spaced, relaxed_path, wall_crossings
from carina.track.targets.results import GraphSearch, TargetResult, TargetSearch, TrackResult
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Note, Volume
from carina.volume.point_check import check_in_volume

COSTS = ("lumen", "paper", "walls")
GRAPHS = ("voxel", "isoregion")

Points = NDArray[np.float64]
Labels = Literal["bins", "lumen"]
Box = tuple[tuple[int, int, int], tuple[int, int, int]]

MAX_BYTES = 1 << 30
"""Memory limit in bytes of a search with the cost ``paper`` or ``walls``, without its queue."""
BYTES_PER_VOXEL = {"voxel": 22, "isoregion": 38}
"""Memory in bytes per voxel of the searched box, by graph.

5 bytes for the cost and 17 for the tree; on the IsoRegion graph at most 16 more while it is built.
"""
MARGINS_MM = (20.0, 10.0, 5.0, 2.0)
NO_LUMEN = Note(
    "track.no-lumen",
    "these paths were tracked without an airway lumen: whether they leave the airway was not checked, and their radii "
    "are unknown (0 in the file)",
    badge=True,
)


def check_choice(cost: str, graph: str) -> None:
    """Raise an error if the name of a cost or a graph is unknown.

    Raises
    ------
    UsageError
        If the cost or the graph does not exist.
    """
    for what, value, allowed in (("cost", cost, COSTS), ("graph", graph, GRAPHS)):
        if value not in allowed:
            *others, last = allowed
            msg = f"{what}: expected {', '.join(others)} or {last}, found {value!r}"
            raise UsageError(msg)


def search_box(
    volume: Volume, points_lps: Sequence[Sequence[float] | Points], *, graph: str = "voxel", max_bytes: int = MAX_BYTES
) -> Box:
    """Return the box of voxels in which the costs ``paper`` and ``walls`` are searched.

    The box is the whole volume if the volume fits in the memory limit. Otherwise the box contains root and targets
    with a margin of 20 mm, or the largest margin of 10, 5 and 2 mm that fits.

    Parameters
    ----------
    volume
        The CT.
    points_lps
        Root and targets, LPS in mm.
    graph
        ``voxel`` or ``isoregion``.
    max_bytes
        Memory limit.

    Returns
    -------
    tuple
        First voxel and shape, (i, j, k).

    Raises
    ------
    UsageError
        If even the smallest box does not fit.
    """
    shape = np.array(volume.shape_zyx[::-1])
    most = max_bytes // BYTES_PER_VOXEL[graph]
    first, last = np.zeros(3, dtype=int), shape - 1
    if int(np.prod(shape)) > most:
        ijk = volume.to_ijk(np.array([as_point(point) for point in points_lps]))
        for margin in MARGINS_MM:
            reach = margin / np.array(volume.spacing_mm)
            first = np.clip(np.floor(ijk.min(axis=0) - reach), 0, shape - 1).astype(int)
            last = np.clip(np.ceil(ijk.max(axis=0) + reach), 0, shape - 1).astype(int)
            if int(np.prod(last - first + 1)) <= most:
                break
        else:
            num = int(np.prod(last - first + 1))
            msg = (
                f"the box around the root and the targets has {num / 1e6:.0f} million voxels; expected at "
                f"most {most / 1e6:.0f} million ({max_bytes >> 20} MiB); use fewer or closer targets at a time, a root "
                "closer to them, or the cost lumen"
            )
            raise UsageError(msg)
    i, j, k = (int(v) for v in first)
    ni, nj, nk = (int(v) for v in last - first + 1)
    return (i, j, k), (ni, nj, nk)


def track_on_graph(
    volume: Volume,
    airways: Airways | None,
    targets: Sequence[Sequence[float] | Points],
    *,
    cost: str,
    graph: str,
    root_lps: Sequence[float] | Points | None = None,
    labels: Labels | None = None,
    box_ijk: Box | None = None,
    snap_mm: float = SNAP_MM,
    relax: bool = True,
    progress: Progress | None = None,
    cancel: Cancel | None = None,
) -> TrackResult:
    """Track least-cost paths from one root to targets, for any combination of cost and graph.

    One search from the root stops at each target and continues for the next (Algorithm 1). The costs ``paper`` and
    ``walls`` do not use a lumen: it only serves to measure where their paths leave it, and any volume can be
    searched.

    Parameters
    ----------
    volume
        The CT.
    airways
        None if there are none: ``root_lps`` is then required, and the cost must not be ``lumen``.
    targets
        Points in the volume, LPS in mm. Cost ``lumen``: moved to the nearest lumen voxel within ``snap_mm``. Costs
        ``paper`` and ``walls``: any voxel.
    cost, graph
        ``lumen``, ``paper`` (6.2 as printed: walls are cheap) or ``walls`` (as 6.3 needs it: walls are expensive);
        ``voxel`` or ``isoregion``.
    root_lps
        Any voxel of the volume, LPS in mm; by default the root of the airways. The cost ``lumen`` always uses the
        latter.
    labels
        Property that the voxels of an IsoRegion share: ``bins`` of 16 HU (default for the costs ``paper`` and
        ``walls``) or the class of the ``lumen`` (default for the cost ``lumen``).
    box_ijk
        First voxel and shape of the box in which the costs ``paper`` and ``walls`` are searched; by default
        :func:`search_box`. The box must contain the root; a target outside the box has no path.
    snap_mm
        Largest distance by which a target is moved.
    relax
        Whether paths and branches of the cost ``walls`` are relaxed after the search (:func:`relaxed_path`), and the
        way through the lumen replaces needless excursions (:func:`replace_excursions`); False for the paths of the
        search, as in the paper. Other costs are not relaxed.
    progress
        Function that receives the name of the stage and the fraction.
    cancel
        Function that returns True to stop the search.

    Returns
    -------
    TrackResult
        Paths, their tree, and ``search`` with the effort. Points of the tree's branches are voxel centres, except
        with the cost ``walls``, where each branch is relaxed.

    Raises
    ------
    UsageError
        If cost, graph or labels do not exist or need airways that are not given, the root is missing or outside the
        volume, or the search would need too much memory.
    CancelledError
        If ``cancel()`` returned True.

    References
    ----------
    Paper 6.1 to 6.3; docs/algorithms.md.
    """
    check_choice(cost, graph)
    if labels not in (None, "bins", "lumen"):
        msg = f"labels: expected bins or lumen, found {labels!r}"
        raise UsageError(msg)
    which = None if graph == "voxel" else labels or ("lumen" if cost == "lumen" else "bins")
    if airways is None and (cost == "lumen" or which == "lumen"):
        what = "cost lumen" if cost == "lumen" else "labels lumen"
        msg = f"expected an airway lumen for the {what}; found none; choose the cost walls or paper, and labels bins"
        raise UsageError(msg)
    lumen = None if airways is None else airways.lumen_zyx
    if cost == "lumen":
        assert airways is not None
        # Use the grid of the tracker, so that the paths can equal those of the tracker.
        volume, lumen = airways.tracker.volume, airways.tracker.lumen_zyx
    root = _root(volume, airways, cost, root_lps)
    points = [as_point(target) for target in targets]
    notes: list[str] = []
    shape = volume.shape_zyx[::-1]
    box: Box = ((0, 0, 0), (shape[0], shape[1], shape[2]))
    if cost != "lumen":
        box = box_ijk or search_box(volume, [root, *points], graph=graph)
        if box[1] != shape:
            notes.append(
                "only a box around the root and the targets was searched; a lower-cost path outside it would be missed"
            )

    def stage(what: str) -> Callable[[float], None]:
        if progress is not None:
            progress(what, None)
        return lambda share: None if progress is None else progress(what, share)

    core = GraphTracker(
        volume.hu_zyx,
        volume.lps_from_ijk,
        cost=cost,
        labels=which,
        box_ijk=box,
        lumen_zyx=lumen,
        levels=None if airways is None else airways.wall_levels,
        root_lps=root,
        reach_mm=SNAP_MM,
        cancel=cancel,
        progress=stage("building the graph"),
    )
    share = stage("searching for paths")
    results: list[TargetResult] = []
    searches: list[TargetSearch | None] = []
    ways: list[_NodePath] = []
    for point in points:
        if cancel is not None and cancel():
            raise CancelledError("stopped while searching for paths")
        requested = np.array(point)
        try:
            if cost == "lumen":
                assert airways is not None
                airways.tracker.snap(point, snap_mm=snap_mm)
            place = core.place(point, snap_mm)
            settled, started = core.num_settled, time.perf_counter()
            if place is None:
                msg = f"no path: {words(point)} lies outside the box that was searched"
                raise NoResultError(msg, code="track.no-path")
            if not core.solve_to(place[0], cancel=cancel, progress=share):
                msg = f"no path: {words(point)} is not connected to the root in this graph"
                raise NoResultError(msg, code="track.no-path")
        except NoResultError as error:
            results.append(TargetResult(requested, None, 0.0, None, str(error)))
            searches.append(None)
            continue
        seconds = time.perf_counter() - started
        node, centre, to_node_mm = place
        found = core.path(node)
        path_cost = core.cost(node)
        assert found is not None
        assert path_cost is not None
        way = _NodePath(found[0], found[1], np.array(centre) if to_node_mm > 0.0 else None)
        snapped = 0.0
        if cost == "lumen" and airways is not None and not bool(airways.tracker.inside(requested[None])[0]):
            snapped = float(np.linalg.norm(np.array(centre) - requested))
        used = np.array(centre) if snapped > 0.0 else requested
        results.append(TargetResult(requested, used, snapped, None, None))
        searches.append(
            TargetSearch(
                cost=path_cost,
                search_s=seconds,
                num_settled=core.num_settled - settled,
                num_path_nodes=len(way.nodes),
                num_outside=None if airways is None else int((~airways.tracker.inside(way.points)).sum()),
                outside_mm=None if airways is None else outside_mm(way.whole, airways, volume),
                value_range=_value_range(volume, way.points),
                to_node_mm=to_node_mm,
                search_length_mm=float(np.linalg.norm(np.diff(way.whole, axis=0), axis=1).sum()),
                search_outside_mm=None if airways is None else outside_mm(way.whole, airways, volume),
                crossings=None if airways is None else wall_crossings(way.whole, airways),
            )
        )
        ways.append(way)
    is_relaxed = relax and cost == "walls"
    relaxed: list[Points] = []
    tree, branch_nodes = None if airways is None else airways.tree, np.zeros((0, 3))
    if ways:
        branches, branch_nodes = _tree_of(ways, airways, core.cost)
        if is_relaxed:
            if progress is not None:
                progress("relaxing the paths", None)
            in_tubes = [relaxed_path(volume, airways, way.whole) for way in ways]
            relaxed = in_tubes if airways is None else [replace_excursions(volume, airways, one) for one in in_tubes]
            if airways is None or all(one is other for one, other in zip(relaxed, in_tubes, strict=True)):
                branches = tuple(_relaxed_branch(branch, airways, volume) for branch in branches)
            else:
                # The nodes of the search are not on these paths, and the branches must follow the paths.
                branches, branch_nodes = tree_of_paths(relaxed, airways)
        tree = AirwayTree(branches, notes=(NO_LUMEN,) if airways is None else airways.badges)
    waiting = itertools.zip_longest(ways, relaxed)
    for number, search_of in enumerate(searches):
        if search_of is not None:
            assert tree is not None
            way, points_lps = next(waiting)
            path = _tracked_path(
                way,
                airways,
                tree,
                search_of.cost,
                results[number].snapped_mm,
                smooth=cost == "lumen",
                relaxed=points_lps,
                volume=volume,
            )
            results[number] = dataclasses.replace(results[number], path=path)
            if is_relaxed:
                searches[number] = dataclasses.replace(
                    search_of,
                    outside_mm=None if airways is None else outside_mm(path.points_lps, airways, volume),
                    crossings=None if airways is None else wall_crossings(path.points_lps, airways),
                    value_range=_value_range(volume, path.points_lps),
                )
    search = GraphSearch(
        cost=cost,
        graph=graph,
        labels=which,
        num_nodes=core.num_nodes,
        num_edges=core.num_edges(),
        num_centres=core.num_centres,
        build_s=core.build_s,
        quantum=core.quantum,
        first_ijk=box[0],
        shape_ijk=box[1],
        is_whole=box[1] == shape,
        branch_nodes_lps=branch_nodes,
        targets=tuple(searches),
        notes=tuple(notes),
        is_relaxed=is_relaxed,
    )
    return TrackResult(tree, tuple(results), airways, search)


@dataclass(frozen=True, slots=True, eq=False)
class _NodePath:
    """Nodes of a path from the root to a target."""

    points: Points
    nodes: NDArray[np.uint32]
    end: Points | None
    """Voxel of the target (LPS, mm), if another node represents it; else None."""

    @property
    def whole(self) -> Points:
        """Positions (n, 3) of the path's nodes and of the target's voxel (``end``), LPS in mm."""
        return self.points if self.end is None else np.concatenate([self.points, self.end[None]])


def outside_mm(points: Points, airways: Airways, volume: Volume) -> float:
    """Return the length (mm) of a polyline outside the lumen."""
    dense = evenly_spaced(points, 0.25 * min(volume.spacing_mm))
    pieces = np.linalg.norm(np.diff(dense, axis=0), axis=1)
    return float(pieces[~airways.tracker.inside((dense[:-1] + dense[1:]) / 2)].sum())


def _value_range(volume: Volume, points: Points) -> tuple[int, int]:
    i, j, k = np.rint(volume.to_ijk(points)).astype(int).T
    values = volume.hu_zyx[k, j, i]
    return int(values.min()), int(values.max())


def _root(
    volume: Volume, airways: Airways | None, cost: str, root_lps: Sequence[float] | Points | None
) -> tuple[float, float, float]:
    if root_lps is None or cost == "lumen":
        if airways is None:
            msg = "there are no segmented airways to start from: give the start (root) of the paths as a point"
            raise UsageError(msg)
        return as_point(airways.root_lps)
    root = as_point(root_lps)
    check_in_volume(volume, root, "the root")
    return root


def _tracked_path(
    way: _NodePath,
    airways: Airways | None,
    tracked: AirwayTree,
    cost: float,
    snapped_mm: float,
    *,
    smooth: bool,
    relaxed: Points | None,
    volume: Volume,
) -> TrackedPath:
    if smooth and airways is not None:
        # An edge may be many voxels long: sample it as densely as the paths of the voxel graph.
        dense = evenly_spaced(way.whole, min(volume.spacing_mm))
        points = airways.tracker.core.smooth(dense, step_mm=STEP_MM, keep_end=True)
    elif relaxed is not None:
        points = relaxed
    else:
        points = evenly_spaced(way.whole, STEP_MM)
    branch_ids, generation = along_branches(points, tracked if airways is None else airways.tree)
    unknown = np.zeros(len(points))
    return TrackedPath(
        points_lps=points,
        radius_mm=unknown if airways is None else airways.tracker.calibres(points, branch_ids),
        wall_mm=unknown if airways is None else airways.tracker.core.radius_mm(points),
        length_mm=float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()),
        cost=cost,
        generation=generation,
        branch_ids=branch_ids,
        voxel_path_lps=way.points,
        target_node=int(way.nodes[-1]),
        snapped_mm=snapped_mm,
    )


def _relaxed_branch(branch: Branch, airways: Airways | None, volume: Volume) -> Branch:
    """Return a branch with a relaxed centreline between the same ends."""
    points = relaxed_path(volume, airways, branch.points)
    radius = np.zeros(len(points)) if airways is None else airways.tracker.core.radius_mm(points)
    return dataclasses.replace(branch, points=points, radius=radius)


def along_branches(points: Points, tree: AirwayTree) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return branch ID and generation of (n, 3) points, LPS in mm.

    Each point gets the nearest of the branches between the root and the last point, in this order.
    """
    lineage = tree.lineage(tree.nearest_branch(points[-1])[0].id)
    distance = np.stack(
        [
            np.array([np.linalg.norm(branch.points - point, axis=1).min() for point in points], dtype=np.float64)
            for branch in lineage
        ]
    )
    places = np.maximum.accumulate(np.argmin(distance, axis=0))
    ids = np.array([branch.id for branch in lineage], dtype=np.int32)[places]
    return ids, np.array([branch.generation for branch in lineage], dtype=np.int32)[places]


def _tree_of(
    ways: Sequence[_NodePath], airways: Airways | None, cost_of: Callable[[int], float | None]
) -> tuple[tuple[Branch, ...], Points]:
    """Return the branches of the union of all paths, cut at branch nodes (paper, Figure 13), and these nodes."""
    place_of: dict[int, Points] = {}
    follows: dict[int, list[int]] = {}
    end_of: dict[int, Points] = {}
    for way in ways:
        nodes = [int(node) for node in way.nodes]
        for node, place in zip(nodes, way.points, strict=True):
            place_of[node] = place
            follows.setdefault(node, [])
        for before, after in itertools.pairwise(nodes):
            if after not in follows[before]:
                follows[before].append(after)
        if way.end is not None:
            end_of[nodes[-1]] = way.end
    root = int(ways[0].nodes[0])
    branches: list[Branch] = []
    # Node from which a branch leaves its parent, first node of the branch, its parent, and its generation.
    waiting: list[tuple[int | None, int, int | None, int]] = [(None, root, None, 0)]
    while waiting:
        leaves, node, parent, generation = waiting.pop(0)
        nodes = ([] if leaves is None else [leaves]) + [node]
        while len(follows[nodes[-1]]) == 1:
            nodes.append(follows[nodes[-1]][0])
        points = np.array([place_of[n] for n in nodes])
        if not follows[nodes[-1]] and nodes[-1] in end_of:
            points = np.concatenate([points, end_of[nodes[-1]][None]])
        first, last = cost_of(nodes[0]), cost_of(nodes[-1])
        number = len(branches)
        branches.append(
            Branch(
                id=number,
                parent=parent,
                children=(),
                generation=generation,
                name=None,
                kind="tracked",
                points=points,
                radius=np.zeros(len(points)) if airways is None else airways.tracker.core.radius_mm(points),
                cost=None if first is None or last is None else last - first,
            )
        )
        if parent is not None:
            above = branches[parent]
            branches[parent] = dataclasses.replace(above, children=(*above.children, number))
        waiting.extend((nodes[-1], after, number, generation + 1) for after in follows[nodes[-1]])
    forks = [place_of[node] for node, after in follows.items() if len(after) > 1]
    return tuple(branches), np.array(forks).reshape(-1, 3)
