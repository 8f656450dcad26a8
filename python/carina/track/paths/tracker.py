"""Resumable tracker of least-cost paths in an airway lumen (paper 6)."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker, lumen_array, nodes_at
from carina.display import one_line
from carina.errors import NoResultError, UsageError
from carina.track.intensity_levels import AirScale, air_scale
from carina.track.paths.live_path import LivePath, find_live_path, noise_hu
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.progress import Cancel
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Volume
from carina.volume.point_check import check_in_volume
from carina.volume.sparse_mask import PackedMask

SNAP_MM = 5.0
STEP_MM = 1.0

Point = tuple[float, float, float]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TrackedPath:
    """Least-cost path from the root to a target, smoothed inside the lumen."""

    points_lps: NDArray[np.float64]
    """Points (n, 3) from root to target, LPS in mm, about 1 mm apart; each one is in a lumen voxel."""
    radius_mm: NDArray[np.float64]
    """Radius (n,) in mm of the branch at its nearest point (:attr:`Branch.radius`); off the tree, wall distance."""
    wall_mm: NDArray[np.float64]
    """Distance (n,) to the wall in mm, which is the radius of the largest ball that fits.

    The distance is less than ``radius_mm`` if the lumen is not round.
    """
    length_mm: float
    """Length of the smoothed path, mm."""
    cost: float
    """Cost of the voxel path: the sum over its edges of length in mm times weight."""
    generation: NDArray[np.int32]
    """Number (n,) of airway forks between the root and each point."""
    branch_ids: NDArray[np.int32]
    """ID (n,) of the branch of the automatic tree at each point."""
    voxel_path_lps: NDArray[np.float64]
    """Voxel centres (m, 3) that the tracker chose, before smoothing, LPS in mm."""
    target_node: int
    """Node of the target in the compiled tracker."""
    snapped_mm: float
    """Distance in mm of the requested point from the lumen; 0 inside the lumen."""


class PathTracker:
    """Tracker of least-cost paths from one fixed root (paper 6.3).

    Voxels settled for one target are reused for the next. :func:`carina.track.find_airways` creates trackers. A
    tracker may be used from several threads. The pickle of a tracker contains the CT, the lumen and the branches;
    the compiled tracker is rebuilt from them at first use.
    """

    __slots__ = (
        "__weakref__",
        "_air_scale",
        "_branches",
        "_follows",
        "_labels",
        "_lock",
        "_lumen_zyx",
        "_made_core",
        "_nodes",
        "_noise_hu",
        "_on_tree",
        "_recipe",
        "_root_ijk",
        "grid",
    )

    def __init__(
        self,
        grid: PathGrid,
        core: LumenTracker | None,
        *,
        recipe: CoreRecipe,
        root_ijk: tuple[int, int, int] | None = None,
        lumen_zyx: NDArray[np.uint8] | None = None,
    ) -> None:
        """Wrap a tracker of the compiled module, or the values from which it is built at first use.

        A compiled tracker takes seconds and much memory to build. Without ``core`` it is built at first use, from
        the root and the lumen.

        Parameters
        ----------
        grid
            Grid in which the paths run.
        core
            Compiled tracker on that grid; None to build it at first use.
        recipe
            Parameters for rebuilding the compiled tracker.
        root_ijk
            Voxel of the grid at which all paths begin; required without ``core``.
        lumen_zyx
            Lumen on the grid; required without ``core``.
        """
        self._root_ijk = root_ijk
        self._lumen_zyx = lumen_zyx
        self.grid = grid
        """Grid in which the paths run: the grid of the CT, or a finer one if the slices are thick."""
        self._made_core = core
        self._recipe = recipe
        self._lock = threading.RLock()
        self._branches: tuple[Branch, ...] = ()
        self._nodes: list[NDArray[np.uint32]] | None = []
        self._follows = False
        self._labels: NDArray[np.int32] | None = None
        self._on_tree: NDArray[np.int32] | None = None
        self._noise_hu: float | None = None
        self._air_scale: AirScale | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor and the values from which a pickle restores the tracker."""
        values = {"grid": self.grid, "recipe": self._recipe, "root_ijk": self.root_ijk}
        nodes = None if self._follows else self._nodes
        return _tracker_of, (values, PackedMask.of(self.lumen_zyx), self._branches, nodes)

    def __repr__(self) -> str:
        """Return one line with the numbers of nodes and settled nodes."""
        core = self._made_core
        if core is None:
            return "PathTracker(not built yet)"
        return f"PathTracker(num_nodes={core.num_nodes}, num_settled={core.num_settled})"

    @property
    def num_nodes(self) -> int:
        """Number of lumen voxels, each of which is a node."""
        return self.core.num_nodes

    @property
    def num_settled(self) -> int:
        """Number of lumen voxels whose least cost is known."""
        return self.core.num_settled

    @property
    def quantum(self) -> float:
        """Smallest unit of the costs; the cost of a path is correct within 0.5 %."""
        return self.core.quantum

    @property
    def core(self) -> LumenTracker:
        """Compiled tracker; built once at first use, from any thread."""
        core = self._made_core
        if core is None:
            with self._lock:
                core = self._made_core
                if core is None:
                    assert self._lumen_zyx is not None and self._root_ijk is not None
                    core = self._made_core = self._recipe.build(self.grid.volume, self._lumen_zyx, self._root_ijk)
        return core

    @property
    def volume(self) -> Volume:
        """CT on the grid in which the paths run; interpolated at first use if that grid is finer than the CT's."""
        return self.grid.volume

    @property
    def lumen_zyx(self) -> NDArray[np.uint8]:
        """Lumen (nz, ny, nx) in which the paths run, on the grid, 1 inside, read-only."""
        if self._lumen_zyx is None:
            self._lumen_zyx = lumen_voxels(self.core)
        return self._lumen_zyx

    @property
    def root_ijk(self) -> tuple[int, int, int]:
        """Voxel (i, j, k) of the grid at which all paths begin."""
        if self._root_ijk is None:
            found = self.core.path(self.core.root)
            assert found is not None
            i, j, k = (int(v) for v in np.rint(self.grid.volume.to_ijk(found[0][0])))
            self._root_ijk = (i, j, k)
        return self._root_ijk

    @property
    def branches(self) -> tuple[Branch, ...]:
        """Branches that were passed to :meth:`set_branches` or :meth:`follow_branches`, unchanged."""
        return self._branches

    @property
    def given_nodes(self) -> tuple[NDArray[np.uint32], ...] | None:
        """Nodes of each branch, if :meth:`set_branches` set them; None if they follow from the centrelines."""
        return None if self._follows else tuple(self._branch_nodes)

    def snap(self, point_lps: Sequence[float] | NDArray[np.float64], *, snap_mm: float = SNAP_MM) -> tuple[int, float]:
        """Return the lumen voxel (as a node) nearest to a point, and the distance in mm (0 inside the lumen).

        Parameters
        ----------
        point_lps
            Point, LPS in mm.
        snap_mm
            Largest distance of the point from the lumen.

        Raises
        ------
        UsageError
            If the point is not in the volume.
        NoResultError
            If the lumen is farther away than ``snap_mm``; the message states the distance.
        """
        point = as_point(point_lps)
        check_in_volume(self.grid.ct, point, "the point")
        if bool(self.core.inside([point])[0]):
            node, _ = self._nearest(point, float(np.linalg.norm(self.grid.lps_from_ijk[:3, :3])))
            return node, 0.0
        found = self.core.nearest(point, snap_mm)
        if found is None:
            farther = self.core.nearest(point, 60.0)
            far = "more than 60 mm" if farther is None else f"{farther[1]:.1f} mm"
            msg = (
                f"the point {words(point)} is {far} from the segmented lumen; expected at most {snap_mm:g} mm; "
                "choose a point inside an airway, or extend the lumen there"
            )
            raise NoResultError(msg, code="track.outside-lumen")
        return found

    def _nearest(self, point: Point, reach_mm: float) -> tuple[int, float]:
        found = self.core.nearest(point, reach_mm)
        assert found is not None
        return found

    def path_to(
        self,
        point_lps: Sequence[float] | NDArray[np.float64],
        *,
        snap_mm: float = SNAP_MM,
        cancel: Cancel | None = None,
    ) -> TrackedPath:
        """Return the least-cost path from the root to a point.

        Parameters
        ----------
        point_lps
            Target, LPS in mm.
        snap_mm
            A target outside the lumen is moved to the nearest lumen voxel if it is within this distance.
        cancel
            Function that returns True to stop the calculation.

        Raises
        ------
        UsageError
            If the point is not in the volume.
        NoResultError
            If the lumen is farther away than ``snap_mm`` (the message states the distance), or no path leads to the
            target.
        """
        node, snapped_mm = self.snap(point_lps, snap_mm=snap_mm)
        if not self.core.solve_to(node, cancel=cancel):
            msg = (
                f"no path: the lumen at {words(as_point(point_lps))} is not connected to the start of "
                "the tree; the airway may be obstructed in between"
            )
            raise NoResultError(msg, code="track.no-path")
        return self._path(node, snapped_mm)

    def live_path(self, point_lps: Sequence[float] | NDArray[np.float64], *, reach_mm: float = SNAP_MM) -> LivePath:
        """Return the path to the point under the pointer, or a result that states why there is none.

        Once all paths from the root are solved (:func:`carina.track.find_airways` solves them) a call takes about a
        millisecond.

        Parameters
        ----------
        point_lps
            Position of the pointer, LPS in mm.
        reach_mm
            A point outside the lumen is moved to the nearest lumen voxel within this distance.

        Raises
        ------
        UsageError
            If the point is not in the volume. A point outside the lumen raises nothing: see ``LivePath.problem``.

        References
        ----------
        Paper 6.3.
        """
        return find_live_path(self, self.volume, as_point(point_lps), reach_mm=reach_mm)

    @property
    def air_scale(self) -> AirScale:
        """Voxel values of air and soft tissue in this volume, which need not be HU."""
        if self._air_scale is None:
            self._air_scale = air_scale(self.volume)
        return self._air_scale

    @property
    def noise_hu(self) -> float:
        """Standard deviation of the values deep inside the first airway of the tree, HU."""
        if self._noise_hu is None:
            trunk = self._branches[0] if self._branches else None
            deep = np.empty((0, 3))
            if trunk is not None:
                # Half a radius off the centreline there is no wall: sample sixteen places round each point.
                turns = 2.0 * np.pi * np.arange(16) / 16
                ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(16)], axis=1)
                reach = 0.5 * trunk.radius[:, None, None]
                deep = (trunk.points[:, None, :] + reach * ring[None, :, :]).reshape(-1, 3)
                deep = deep[self.inside(deep)]
            self._noise_hu = noise_hu(self.volume, deep, self.air_scale)
        return self._noise_hu

    def new_share(self, node: int) -> tuple[float, int | None]:
        """Return the length share of a settled node's path outside the tree, and the branch where it starts.

        The share is the length outside the tree over the whole length. The branch is None if no part of the path is
        on the tree.
        """
        found = self.core.path(node)
        assert found is not None
        points, nodes = found
        on_tree = self._places_on_tree()
        on = np.flatnonzero(on_tree[nodes] >= 0)
        if not len(on):
            return 1.0, None
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        share = 1.0 - along[on[-1]] / along[-1] if along[-1] > 0.0 else 0.0
        return float(share), self._branches[int(on_tree[nodes[on[-1]]])].id

    def middle_to(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return smooth (n, 3) points of the path to a settled node (LPS, mm), and their (n,) distances to the wall.

        The distances are in mm. The points equal those of :meth:`path_to`; the branches are left out, because the
        first look-up of them takes a while.
        """
        found = self.core.path(node)
        assert found is not None
        points = self.core.smooth(found[0], step_mm=STEP_MM, keep_end=True)
        return points, self.core.radius_mm(points)

    def branch_at(self, point_lps: Sequence[float] | NDArray[np.float64]) -> int | None:
        """Return the ID of the branch to whose lumen a point belongs; None without branches.

        The branch is that of the last point of :meth:`path_to` to the same point. At a fork it may differ from the
        branch whose centreline is nearest to the point.

        Parameters
        ----------
        point_lps
            Point in the lumen, LPS in mm.

        Raises
        ------
        NoResultError
            If the point is farther from the lumen than a path may be moved.
        """
        if not self._branches:
            return None
        node, _ = self.snap(as_point(point_lps))
        return self._branches[max(int(self._branch_of_node[node]), 0)].id

    def _path(self, node: int, snapped_mm: float) -> TrackedPath:
        found, cost = self.core.path(node), self.core.cost(node)
        assert found is not None
        assert cost is not None
        voxel_path, nodes = found
        points = self.core.smooth(voxel_path, step_mm=STEP_MM, keep_end=True)
        steps = np.linalg.norm(np.diff(voxel_path, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        # The smooth points are evenly spaced along the voxel path: each one gets the branch of the voxel at its
        # position.
        places = np.linspace(0.0, along[-1], len(points))
        at = np.clip(np.searchsorted(along, places - 1e-9), 0, len(nodes) - 1)
        branch_ids, generation = self._branches_along(nodes[at])
        return TrackedPath(
            points_lps=points,
            radius_mm=self.calibres(points, branch_ids),
            wall_mm=self.core.radius_mm(points),
            length_mm=float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()),
            cost=cost,
            generation=generation,
            branch_ids=branch_ids,
            voxel_path_lps=voxel_path,
            target_node=node,
            snapped_mm=snapped_mm,
        )

    def calibres(self, points: NDArray[np.float64], branch_ids: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the (n,) radius of the branch at each point, at the nearest centreline point.

        Off the tree the distance to the wall is returned.
        """
        radius = self.core.radius_mm(points)
        by_id = {branch.id: branch for branch in self._branches}
        for branch_id in np.unique(branch_ids):
            branch = by_id.get(int(branch_id))
            if branch is None:
                continue
            mine = np.flatnonzero(branch_ids == branch_id)
            off = np.linalg.norm(points[mine, None] - branch.points[None], axis=2)
            near = off.argmin(axis=1)
            # Off the tree (such as at a click in a small pocket of lumen) only the distance to the wall is known.
            on_it = off[np.arange(len(mine)), near] <= np.maximum(branch.radius[near], STEP_MM)
            radius[mine[on_it]] = branch.radius[near[on_it]]
        return radius

    def smooth(self, points_lps: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return evenly spaced, smooth points of a path inside the lumen, and their distance to the wall in mm.

        Every point of the result is in a lumen voxel if every point of the path is. The last point may move a
        little.
        """
        points = self.core.smooth(points_lps, step_mm=STEP_MM, keep_end=False)
        return points, self.core.radius_mm(points)

    def inside(self, points_lps: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return (n,) flags: whether the voxel that contains each (n, 3) point (LPS, mm) is lumen."""
        return self.core.inside(np.asarray(points_lps, dtype=np.float64).reshape(-1, 3))

    def _branches_along(self, nodes: NDArray[np.uint32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return branch ID and generation of each node of a path.

        A path that cuts a corner touches the mouth of a branch that it does not enter. Therefore only the branches
        between the root and the last node count, in this order.
        """
        if not self._branches:
            return np.zeros(len(nodes), dtype=np.int32), np.zeros(len(nodes), dtype=np.int32)
        parents = self._parents()
        lineage = [max(int(self._branch_of_node[nodes[-1]]), 0)]
        while (parent := parents[lineage[-1]]) is not None:
            lineage.append(parent)
        lineage.reverse()
        place_of = np.full(len(self._branches), -1, dtype=np.int32)
        for number, parent in enumerate(parents):
            # Parents come first, so a branch off the path gets the position of its nearest ancestor on the path.
            place_of[number] = 0 if parent is None else place_of[parent]
            if number in lineage:
                place_of[number] = lineage.index(number)
        places = np.maximum.accumulate(place_of[np.maximum(self._branch_of_node[nodes], 0)])
        numbers = np.array(lineage, dtype=np.int32)[places]
        ids = np.array([branch.id for branch in self._branches], dtype=np.int32)[numbers]
        return ids, np.array([branch.generation for branch in self._branches], dtype=np.int32)[numbers]

    def set_branches(self, branches: Sequence[Branch], nodes: Sequence[NDArray[np.uint32]]) -> None:
        """Set the branches and the voxels of their centrelines, so that paths know their branches; parents first."""
        self._set_branch_nodes(branches, list(nodes))

    def follow_branches(self, branches: Sequence[Branch]) -> None:
        """Set the branches like :meth:`set_branches`, but take the voxels from the centrelines at first use."""
        self._set_branch_nodes(branches, None)

    def _set_branch_nodes(self, branches: Sequence[Branch], nodes: list[NDArray[np.uint32]] | None) -> None:
        self._branches = tuple(branches)
        self._nodes = nodes
        self._follows = nodes is None
        self._labels = None
        self._on_tree = None
        self._noise_hu = None

    @property
    def _branch_nodes(self) -> list[NDArray[np.uint32]]:
        nodes = self._nodes
        if nodes is None:
            # Two threads may both compute the nodes, but with the same result.
            nodes = self._nodes = self._nodes_along(self._branches)
        return nodes

    def _nodes_along(self, branches: Sequence[Branch]) -> list[NDArray[np.uint32]]:
        nodes = nodes_at(self.core, np.concatenate([branch.points for branch in branches]))
        ends = np.cumsum([len(branch.points) for branch in branches])
        of_branches = []
        for branch, found in zip(branches, np.split(nodes, ends[:-1]), strict=True):
            inside = found[found >= 0]
            if not len(inside):
                inside = np.array([self._nearest(as_point(branch.points[0]), 60.0)[0]])
            of_branches.append(inside[np.diff(inside, prepend=-1) != 0].astype(np.uint32))
        return of_branches

    @property
    def _branch_of_node(self) -> NDArray[np.int32]:
        """Index of the branch to whose lumen each node belongs, (nodes,); computed at first use."""
        labels = self._labels
        if labels is None:
            if not self._branches:
                return np.zeros(self.core.num_nodes, dtype=np.int32)
            # Two threads may both compute the labels, but with the same result.
            labels = self._labels = self.core.branch_of_nodes(self._branch_nodes, self._parents())
        return labels

    def _places_on_tree(self) -> NDArray[np.int32]:
        """Return for each node the index of the branch whose centreline is in or beside its voxel, or -1."""
        on_tree = self._on_tree
        if on_tree is None:
            on_tree = np.full(self.core.num_nodes, -1, dtype=np.int32)
            steps = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
            around = steps @ self.grid.lps_from_ijk[:3, :3].T
            # A child begins with the last voxel of its parent, which stays assigned to the parent.
            for place in reversed(range(len(self._branches))):
                points = self._branches[place].points
                nodes = nodes_at(self.core, (points[:, None, :] + around[None, :, :]).reshape(-1, 3))
                on_tree[nodes[nodes >= 0]] = place
            for place in reversed(range(len(self._branch_nodes))):
                on_tree[self._branch_nodes[place]] = place
            # Two threads may both compute the array, but with the same result.
            self._on_tree = on_tree
        return on_tree

    def _parents(self) -> list[int | None]:
        """Return the index of each branch's parent in the list; IDs are not indices once a tree was edited."""
        place_of_id = {branch.id: number for number, branch in enumerate(self._branches)}
        return [None if branch.parent is None else place_of_id[branch.parent] for branch in self._branches]

    def tree_to(self, paths: Sequence[TrackedPath]) -> AirwayTree:
        """Return the part of the airway tree that leads to the targets of the paths, with names and generations."""
        rows = self.core.branches_to([path.target_node for path in paths], self._branch_nodes, self._parents())
        branches = []
        for branch, row in zip(branches_from_rows(rows), rows, strict=True):
            # Two targets can part inside one branch of the airway: both pieces keep its name and generation.
            known = int(self._branch_of_node[row["nodes"][len(row["nodes"]) // 2]])
            whole = self._branches[known]
            branches.append(dataclasses.replace(branch, name=whole.name, generation=whole.generation))
        return AirwayTree(tuple(branches), _smooth=self.smooth)


def _tracker_of(
    values: dict[str, Any], lumen: PackedMask, branches: tuple[Branch, ...], nodes: list[NDArray[np.uint32]] | None
) -> PathTracker:
    """Return the path tracker that the values in a pickle describe."""
    tracker = PathTracker(core=None, lumen_zyx=lumen.mask_zyx(), **values)
    tracker._set_branch_nodes(branches, nodes)
    return tracker


def lumen_voxels(core: LumenTracker) -> NDArray[np.uint8]:
    """Return the lumen (nz, ny, nx) of a tracker, 1 inside, read-only; memory pages without lumen stay untouched."""
    lumen = lumen_array(core)
    lumen.flags.writeable = False
    return lumen


def branches_from_rows(rows: Sequence[dict[str, Any]]) -> tuple[Branch, ...]:
    """Return the branches from the compiled tracker's list of dicts; their IDs are the indices in the list."""
    children: list[list[int]] = [[] for _ in rows]
    for number, row in enumerate(rows):
        parent = row["parent"]
        if isinstance(parent, int):
            children[parent].append(number)
    return tuple(
        Branch(
            id=number,
            parent=row["parent"],
            children=tuple(children[number]),
            generation=row["generation"],
            name=None,
            kind="tracked",
            points=row["points"],
            radius=row["radius_mm"],
            wall_mm=row["wall_mm"],
            cost=row["cost"],
        )
        for number, row in enumerate(rows)
    )


def as_point(point_lps: Sequence[float] | NDArray[np.float64]) -> Point:
    """Return a point as three finite numbers, or raise an error.

    Raises
    ------
    UsageError
        If the argument is anything else.
    """
    point = np.asarray(point_lps, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        msg = f"expected a point x,y,z in LPS mm, found {point_lps!r}"
        raise UsageError(msg)
    return float(point[0]), float(point[1]), float(point[2])


def words(point: Point) -> str:
    """Return the coordinates of a point as text, such as (1.0, 2.0, 3.0)."""
    return "({:.1f}, {:.1f}, {:.1f})".format(*point)
