"""The resumable path tracker over an airway lumen (paper 6)."""

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
from carina.track.levels import AirScale, air_scale
from carina.track.paths.live import LivePath, find_live_path, noise_hu
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt import CoreRecipe
from carina.track.stages import Cancel
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Volume
from carina.volume.sparse_mask import PackedMask

__all__ = ["PathTracker", "TrackedPath"]

SNAP_MM = 5.0
STEP_MM = 1.0

Point = tuple[float, float, float]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TrackedPath:
    """The least-cost path from the root to a target, smoothed inside the lumen."""

    points_lps: NDArray[np.float64]
    """(n, 3) LPS mm, root to target, about 1 mm apart; each in a lumen voxel."""
    radius_mm: NDArray[np.float64]
    """(n,) radius of the branch at its nearest place, see :attr:`Branch.radius`; off the tree the wall's distance."""
    wall_mm: NDArray[np.float64]
    """(n,) distance to the wall: how large a ball fits there, less than ``radius_mm`` where the lumen is no circle."""
    length_mm: float
    cost: float
    """Cost of the voxel path: the sum of length in mm times weight over its edges."""
    generation: NDArray[np.int32]
    """(n,) forks of the airway passed."""
    branch_ids: NDArray[np.int32]
    """(n,) branch of the automatic tree at each point."""
    voxel_path_lps: NDArray[np.float64]
    """(m, 3) voxel centres that the tracker chose, before smoothing."""
    target_node: int
    snapped_mm: float
    """How far the asked point was from the lumen; 0 inside it."""


class PathTracker:
    """Least-cost paths from one fixed root; what one target has settled is there for the next (paper 6.3).

    Made by :func:`carina.track.find_airways`. May be used from several threads. A pickle of it holds the CT, the lumen
    and the branches; the compiled tracker is built again from them when it is first needed.
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
        """Make a tracker from a compiled one, or from the recipe of one.

        A compiled tracker takes seconds and much memory to build. Without one it is built when it is first needed, from
        the root and the lumen.

        Parameters
        ----------
        grid
            The grid that the paths run in.
        core
            The compiled tracker on that grid; None builds it when it is first needed.
        recipe
            How the compiled tracker is built again.
        root_ijk
            The voxel of the grid where all paths begin; needed without ``core``.
        lumen_zyx
            The lumen on the grid; needed without ``core``.
        """
        self._root_ijk = root_ijk
        self._lumen_zyx = lumen_zyx
        self.grid = grid
        """The grid that the paths run in: that of the CT, or a finer one where its slices are thick."""
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
        values = {"grid": self.grid, "recipe": self._recipe, "root_ijk": self.root_ijk}
        nodes = None if self._follows else self._nodes
        return _tracker_of, (values, PackedMask.of(self.lumen_zyx), self._branches, nodes)

    def __repr__(self) -> str:
        core = self._made_core
        if core is None:
            return "PathTracker(not built yet)"
        return f"PathTracker(num_nodes={core.num_nodes}, num_settled={core.num_settled})"

    @property
    def num_nodes(self) -> int:
        """Lumen voxels."""
        return self.core.num_nodes

    @property
    def num_settled(self) -> int:
        """Lumen voxels whose least cost is known."""
        return self.core.num_settled

    @property
    def quantum(self) -> float:
        """Integer unit of the costs; a path's cost is right within 0.5 %."""
        return self.core.quantum

    @property
    def core(self) -> LumenTracker:
        """The compiled tracker; made now where it was not needed before, once, whichever thread asks."""
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
        """The CT on the grid that the paths run in; where that is a finer one, it is interpolated when first needed."""
        return self.grid.volume

    @property
    def lumen_zyx(self) -> NDArray[np.uint8]:
        """(nz, ny, nx) of the grid, 1 inside the lumen that the paths run in, read-only."""
        if self._lumen_zyx is None:
            self._lumen_zyx = lumen_voxels(self.core)
        return self._lumen_zyx

    @property
    def root_ijk(self) -> tuple[int, int, int]:
        """The voxel of the grid where all paths begin."""
        if self._root_ijk is None:
            found = self.core.path(self.core.root)
            assert found is not None
            i, j, k = (int(v) for v in np.rint(self.grid.volume.to_ijk(found[0][0])))
            self._root_ijk = (i, j, k)
        return self._root_ijk

    @property
    def branches(self) -> tuple[Branch, ...]:
        """The branches that paths are told to run through, as they were when it was told of them."""
        return self._branches

    @property
    def given_nodes(self) -> tuple[NDArray[np.uint32], ...] | None:
        """The nodes of each branch, where :meth:`set_branches` was told them; None where the centrelines tell them."""
        return None if self._follows else tuple(self._branch_nodes)

    def snap(self, point_lps: Sequence[float] | NDArray[np.float64], *, snap_mm: float = SNAP_MM) -> tuple[int, float]:
        """The lumen voxel (as a node) that stands for a point, and how far it was moved in mm (0 inside the lumen).

        Raises
        ------
        UsageError
            If the point is not in the volume.
        NoResultError
            If the lumen is farther than ``snap_mm``; says how far.
        """
        point = as_point(point_lps)
        if not self.grid.ct.contains_lps(np.array(point)):
            msg = f"the point {words(point)} lies outside the volume"
            raise UsageError(msg)
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
        """The least-cost path from the root to a point.

        Parameters
        ----------
        point_lps
            Target, LPS mm.
        snap_mm
            A target outside the lumen is moved to the nearest lumen voxel when it is within this distance.

        Raises
        ------
        UsageError
            If the point is not in the volume.
        NoResultError
            If the lumen is farther than ``snap_mm`` (with the distance), or no path leads to the target.
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
        """The path to the place under the pointer, or the words that say why there is none.

        Once the root is solved (:func:`carina.track.find_airways` does it) this takes about a millisecond.

        Parameters
        ----------
        point_lps
            Where the pointer is, LPS mm.
        reach_mm
            A place outside the lumen stands for the nearest lumen voxel within this distance.

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
        """Air and soft tissue in the volume's numbers."""
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
                # Half a radius off the middle there is no wall; sixteen places round each point.
                turns = 2.0 * np.pi * np.arange(16) / 16
                ring = np.stack([np.cos(turns), np.sin(turns), np.zeros(16)], axis=1)
                reach = 0.5 * trunk.radius[:, None, None]
                deep = (trunk.points[:, None, :] + reach * ring[None, :, :]).reshape(-1, 3)
                deep = deep[self.inside(deep)]
            self._noise_hu = noise_hu(self.volume, deep, self.air_scale)
        return self._noise_hu

    def new_share(self, node: int) -> tuple[float, int | None]:
        """Share of the length of the path to a settled node that is outside the tree, and the branch that it leaves."""
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
        """Smooth (n, 3) LPS points of the path to a settled node, and their (n,) distance to the wall in mm.

        The points of :meth:`path_to`, without the branches, which take a while to be told apart the first time.
        """
        found = self.core.path(node)
        assert found is not None
        points = self.core.smooth(found[0], step_mm=STEP_MM, keep_end=True)
        return points, self.core.radius_mm(points)

    def _path(self, node: int, snapped_mm: float) -> TrackedPath:
        found, cost = self.core.path(node), self.core.cost(node)
        assert found is not None
        assert cost is not None
        voxel_path, nodes = found
        points = self.core.smooth(voxel_path, step_mm=STEP_MM, keep_end=True)
        steps = np.linalg.norm(np.diff(voxel_path, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        # The smooth points are even along the voxel path: each takes the branch of the voxel at its place.
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
        """(n,) radius of the branch that each point is in, at its nearest place; off the tree the wall's distance."""
        radius = self.core.radius_mm(points)
        by_id = {branch.id: branch for branch in self._branches}
        for branch_id in np.unique(branch_ids):
            branch = by_id.get(int(branch_id))
            if branch is None:
                continue
            mine = np.flatnonzero(branch_ids == branch_id)
            off = np.linalg.norm(points[mine, None] - branch.points[None], axis=2)
            near = off.argmin(axis=1)
            # Off the tree (a click in a leaf of lumen) only the wall is known.
            on_it = off[np.arange(len(mine)), near] <= np.maximum(branch.radius[near], STEP_MM)
            radius[mine[on_it]] = branch.radius[near[on_it]]
        return radius

    def smooth(self, points_lps: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Even, smooth points of a way inside the lumen, and their distance to the wall in mm.

        Every point of the result lies in a lumen voxel if every point of the way does. The last one may move a little.
        """
        points = self.core.smooth(points_lps, step_mm=STEP_MM, keep_end=False)
        return points, self.core.radius_mm(points)

    def inside(self, points_lps: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n,) whether the voxel that holds each (n, 3) point is lumen."""
        return self.core.inside(np.asarray(points_lps, dtype=np.float64).reshape(-1, 3))

    def _branches_along(self, nodes: NDArray[np.uint32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Branch and generation of each node of a path.

        A path that cuts a corner touches the mouth of a branch it does not enter; only the branches on the way to its
        last node count, and they come in order.
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
            # Parents come first, so a branch off the way has its nearest ancestor's place.
            place_of[number] = 0 if parent is None else place_of[parent]
            if number in lineage:
                place_of[number] = lineage.index(number)
        places = np.maximum.accumulate(place_of[np.maximum(self._branch_of_node[nodes], 0)])
        numbers = np.array(lineage, dtype=np.int32)[places]
        ids = np.array([branch.id for branch in self._branches], dtype=np.int32)[numbers]
        return ids, np.array([branch.generation for branch in self._branches], dtype=np.int32)[numbers]

    def set_branches(self, branches: Sequence[Branch], nodes: Sequence[NDArray[np.uint32]]) -> None:
        """Tell which voxels are the middle of which branch, so that paths know their branches; parents come first."""
        self._tell(branches, list(nodes))

    def follow_branches(self, branches: Sequence[Branch]) -> None:
        """As :meth:`set_branches`, with the voxels that the centrelines run through; looked up when first needed."""
        self._tell(branches, None)

    def _tell(self, branches: Sequence[Branch], nodes: list[NDArray[np.uint32]] | None) -> None:
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
            # Two threads may both find them: they find the same.
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
        """Place in the list of the branch in whose tube each node lies; found when first asked for."""
        labels = self._labels
        if labels is None:
            if not self._branches:
                return np.zeros(self.core.num_nodes, dtype=np.int32)
            # Two threads may both find it: they find the same.
            labels = self._labels = self.core.branch_of_nodes(self._branch_nodes, self._parents())
        return labels

    def _places_on_tree(self) -> NDArray[np.int32]:
        """For each node the place of the branch whose centreline runs through it or beside it, -1 elsewhere."""
        on_tree = self._on_tree
        if on_tree is None:
            on_tree = np.full(self.core.num_nodes, -1, dtype=np.int32)
            steps = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
            around = steps @ self.grid.lps_from_ijk[:3, :3].T
            # A child begins with its parent's last voxel, which stays the parent's.
            for place in reversed(range(len(self._branches))):
                points = self._branches[place].points
                nodes = nodes_at(self.core, (points[:, None, :] + around[None, :, :]).reshape(-1, 3))
                on_tree[nodes[nodes >= 0]] = place
            for place in reversed(range(len(self._branch_nodes))):
                on_tree[self._branch_nodes[place]] = place
            # Two threads may both find it: they find the same.
            self._on_tree = on_tree
        return on_tree

    def _parents(self) -> list[int | None]:
        """Place of each branch's parent in the list; ids are not places once a tree was edited."""
        place_of_id = {branch.id: number for number, branch in enumerate(self._branches)}
        return [None if branch.parent is None else place_of_id[branch.parent] for branch in self._branches]

    def tree_to(self, paths: Sequence[TrackedPath]) -> AirwayTree:
        """The part of the airway tree that leads to the given paths' targets; names and generations are kept."""
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
    """Return the tracker that a pickle holds."""
    tracker = PathTracker(core=None, lumen_zyx=lumen.mask_zyx(), **values)
    tracker._tell(branches, nodes)
    return tracker


def lumen_voxels(core: LumenTracker) -> NDArray[np.uint8]:
    """Return (nz, ny, nx) 1 inside a tracker's lumen, read-only; pages of memory without lumen are never touched."""
    lumen = lumen_array(core)
    lumen.flags.writeable = False
    return lumen


def branches_from_rows(rows: Sequence[dict[str, Any]]) -> tuple[Branch, ...]:
    """Branches of the compiled tracker's list of dicts; ids are places in the list."""
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
    """Three finite numbers.

    Raises
    ------
    UsageError
        If it is anything else.
    """
    point = np.asarray(point_lps, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        msg = f"expected a point x,y,z in LPS mm, found {point_lps!r}"
        raise UsageError(msg)
    return float(point[0]), float(point[1]), float(point[2])


def words(point: Point) -> str:
    """A point as people read it."""
    return "({:.1f}, {:.1f}, {:.1f})".format(*point)
