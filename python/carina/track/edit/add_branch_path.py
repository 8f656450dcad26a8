"""Path of a branch that a user adds; preview and edit use the same path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import reached, sees
from carina.display import one_line
from carina.errors import NoEvidenceError, NoResultError, UsageError
from carina.track.edit.centreline_pieces import kind_of_added
from carina.track.edit.edit_list import Point, branch_title
from carina.track.edit.evidence import Evidence, PathStart, evidence_of
from carina.track.edit.lumen import EditedLumen, Voxels, by_faces, voxel_of
from carina.track.edit.preview_lines import EditPreview, PreviewLine
from carina.track.edit.remeasure import with_walls
from carina.track.edit.tree_changes import CentrelinePoint, Points, TreeDraft, along_mm
from carina.track.find.result import Airways
from carina.track.paths.tracker import as_point
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Volume

MIN_ADDED_MM = 1.0
"""Minimum length in mm of a new branch outside the tree's tubes; a shorter branch is already in the tree."""
FORK_RADII = 1.0
"""Distance from a tube's centreline, in radii of the tube, beyond which a path has left the tube (as in the search)."""
MIN_REMAINING_MM = 3.0
"""Minimum length in mm of the tip that remains beyond a new fork; a tip shorter than this or 1.5 slices is removed."""
MIN_STATED_MM = 5.0
"""Minimum length in mm, with evidence in the CT, of a part of a path that an error message offers to add separately."""
TIP_POINTS = 3
"""Number of the last points of a branch whose median radius is the radius at its tip."""
SMOOTH_MM, STEP_MM = 1.0, 1.0
"""Sigma in mm of the smoothing of a path of voxels, and distance in mm between the points of the smoothed path."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class BranchWay(EditPreview):
    """Path of the branch that :class:`carina.track.AddBranch` would create, from the tree to a given point."""

    parent_id: int | None
    """ID of the branch that the new branch leaves; None if there is a problem."""
    parent_title: str | None
    """Name of the branch that the new branch leaves, or a text with its ID; None if there is a problem."""
    extends: bool
    """Whether the new points begin at the tip of the branch that they leave, so that no fork is added."""

    @property
    def points_lps(self) -> NDArray[np.float64]:
        """Points (n, 3) from the tree to the target, LPS in mm; (0, 3) if there is a problem."""
        return self.lines[0].points_lps if self.lines else np.empty((0, 3))

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """Flags (n-1,): True for each segment of the path round which the CT shows no wall."""
        return self.lines[0].doubtful if self.lines else np.empty(0, dtype=bool)


def branch_way(volume: Volume, airways: Airways, lps: Point | Sequence[float] | NDArray[np.float64]) -> BranchWay:
    """Return the path that ``AddBranch(lps)`` would create, fast enough to follow a pointer.

    The first call also computes the comparison values of the volume's lung.

    Parameters
    ----------
    volume
        The CT in which ``airways`` were found.
    airways
        Airways before the edit; not changed.
    lps
        End of the branch, LPS in mm.

    Returns
    -------
    BranchWay
        The path; if nothing can be added, no lines and a ``problem``.
    """
    x, y, z = (float(value) for value in lps)
    lumen = EditedLumen(airways.tracker.grid, airways.tracker.core)
    # The edit uses the same tree, with distances to the wall as radii.
    tree = with_walls(airways.tree)
    draft = TreeDraft(tree, airways.next_id or 1 + max(b.id for b in tree.branches))
    try:
        plan = planned_way(lumen, tree, draft, evidence_of(airways), (x, y, z))
    except (NoResultError, UsageError) as error:
        return BranchWay((), False, str(error), parent_id=None, parent_title=None, extends=False)
    drawn = np.full(len(plan.doubtful), kind_of_added(plan.doubtful) == "manual")
    return BranchWay(
        lines=(PreviewLine(plan.points, plan.doubtful, drawn),),
        has_evidence=not plan.doubtful.any(),
        problem=None,
        parent_id=plan.leaves_id,
        parent_title=branch_title(draft[plan.leaves_id].name, plan.leaves_id),
        extends=not draft[plan.parent_id].children,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PlannedWay:
    """Path of a branch that is about to be added to a modified copy (*draft*) of the tree."""

    points: Points
    """Points (n, 3) of the future centreline, LPS in mm; the first is the end of ``parent_id``."""
    doubtful: NDArray[np.bool_]
    """Flags (n-1,): True for each segment of the path round which the CT shows no wall."""
    voxels: Voxels
    """Voxels (m, 3) i, j, k of the path outside the lumen; consecutive voxels share a face; m may be 0."""
    parent_id: int
    """ID of the draft's branch at whose end the new branch begins; an existing branch may have been split there."""
    leaves_id: int
    """ID of the branch that the new branch leaves in the tree before the edit."""

    @property
    def doubtful_mm(self) -> float:
        """Length of those segments of the path whose wall is doubtful, mm."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1)[self.doubtful].sum())


def planned_way(lumen: EditedLumen, tree: AirwayTree, draft: TreeDraft, evidence: Evidence, lps: Point) -> PlannedWay:
    """Plan the path of a new branch to a point; the draft is split where the path leaves the tree.

    ``tree`` is the tree before the edit with distances to the wall as radii (:func:`with_walls`).

    Raises
    ------
    UsageError
        If the point is outside the volume.
    NoResultError
        If the tree already reaches the point, the point is tissue, or no path leads to it.
    """
    voxel = voxel_of(lumen.volume, lps)
    way = np.zeros((0, 3), dtype=np.uint16)
    if lumen.state_at(voxel) == 2:
        path = path_to(lumen, lumen_node(lumen, voxel))
    else:
        branch, at, _ = tree.nearest_branch(lps)
        nearest = voxel_of(lumen.volume, as_point(branch.points[at]))
        found = evidence.way(lumen, voxel, nearest, _tip_voxels(lumen, tree))
        path = path_to(lumen, lumen_node(lumen, found[0].astype(np.int64)))
        way = by_faces(found)[1:]
    place, left = join_of(lumen, draft.ordered(), path)
    beyond = np.concatenate([path[left:], lumen.volume.to_lps(way.astype(np.float64))])
    if not len(beyond) or along_mm(np.concatenate([path[left - 1 : left], beyond]))[-1] < MIN_ADDED_MM:
        branch, _, away_mm = tree.nearest_branch(lps)
        title = branch_title(branch.name, branch.id)
        msg = (
            f"the tree already reaches this point: it lies in {title}, {away_mm:.1f} mm from its centreline; "
            "click where the missing branch ends"
        )
        raise NoResultError(msg, code="track.edit-nothing")
    left_before = draft[place.branch_id]
    # A remainder that is shorter than the diameter of the tube is the end of the centreline, not another branch.
    diameter_mm = 2.0 * float(left_before.radius[place.index])
    parent_id = draft.parent_at(place, max(MIN_REMAINING_MM, 1.5 * max(lumen.volume.spacing_mm), diameter_mm))
    points = _line(lumen, draft[parent_id], beyond, is_inside=not len(way))
    doubtful = _doubtful(lumen, evidence, points, draft[parent_id])
    is_shorter = not draft[parent_id].children and len(draft[parent_id].points) < len(left_before.points)
    if is_shorter and kind_of_added(doubtful) == "manual":
        # A branch drawn by hand must not shorten another branch: the new branch begins at the end of that branch.
        draft.change(
            parent_id,
            points=left_before.points,
            radius=left_before.radius,
            cost=left_before.cost,
            doubtful_mm=left_before.doubtful_mm,
        )
        points = _line(lumen, left_before, beyond, is_inside=not len(way))
        doubtful = _doubtful(lumen, evidence, points, left_before)
    return PlannedWay(points, doubtful, way, parent_id, place.branch_id)


def _tip_voxels(lumen: EditedLumen, tree: AirwayTree) -> Voxels:
    """Return the voxels (n, 3) around the last points of all branches without children; not all are lumen."""
    spacing_mm = np.array(lumen.volume.spacing_mm)
    found = []
    for branch in tree.branches:
        if branch.children:
            continue
        reach_mm = float(np.median(branch.radius[-TIP_POINTS:])) + spacing_mm.max()
        low = -np.ceil(reach_mm / spacing_mm).astype(int)
        offset = np.stack(np.meshgrid(*(np.arange(n, 1 - n) for n in low), indexing="ij"), axis=-1).reshape(-1, 3)
        offset = offset[np.linalg.norm(offset * spacing_mm, axis=1) <= reach_mm]
        found.append(np.floor(lumen.volume.to_ijk(branch.points[-1]) + 0.5).astype(int) + offset)
    voxels = np.concatenate(found)
    shape = np.array(lumen.volume.shape_zyx[::-1])
    return voxels[((voxels >= 0) & (voxels < shape)).all(axis=1)].astype(np.uint16)


def _line(lumen: EditedLumen, parent: Branch, beyond: Points, *, is_inside: bool) -> Points:
    chain = np.concatenate([parent.points[-1:], beyond])
    return _ended(lumen.core.smooth(chain, step_mm=STEP_MM, keep_end=True), chain) if is_inside else drawn(chain)


def _doubtful(lumen: EditedLumen, evidence: Evidence, points: Points, parent: Branch) -> NDArray[np.bool_]:
    inside = lumen.core.inside(points)
    if inside.all():
        # These points are already in the lumen: found by the search, or painted by the user, which is not evidence.
        i, j, k = np.floor(lumen.volume.to_ijk(points) + 0.5).astype(int).T
        was_found = evidence.found_zyx[k, j, i] != 0
        return np.asarray(evidence.doubtful(points) & ~(was_found[1:] & was_found[:-1]))
    first = int(np.argmin(inside))
    back = parent.points[-1] - parent.points[max(len(parent.points) - 6, 0)]
    radius_mm = float(np.median(parent.radius[-6:]))
    return evidence.doubtful(points, PathStart(float(along_mm(points)[first]), radius_mm, back))


def no_evidence(plan: PlannedWay) -> NoEvidenceError:
    """Return the error for a path without evidence in the CT; it states where the evidence ends and what to do."""
    along = along_mm(plan.points)
    first_mm = float(along[int(np.argmax(plan.doubtful))])
    total_mm, doubtful_mm = float(along[-1]), plan.doubtful_mm
    do = (
        "Click where the wall is still visible, or, if the airway is obstructed, bridge the obstruction. You can also "
        "add the branch without evidence: it is then labelled as drawn by hand and has no anatomical name"
    )
    if first_mm < MIN_STATED_MM:
        msg = (
            f"the CT shows no continuous airway wall along this path: {doubtful_mm:.0f} of {total_mm:.0f} mm are "
            f"uncertain. {do}"
        )
    else:
        msg = (
            f"the CT shows an airway wall for the first {first_mm:.0f} mm of this path; {doubtful_mm:.0f} of the "
            f"{total_mm - first_mm:.0f} mm beyond are uncertain. {do}"
        )
    return NoEvidenceError(msg, doubtful_mm=doubtful_mm, way_lps=plan.points, doubtful=plan.doubtful)


def drawn(chain: Points) -> Points:
    """Return a smooth line with a point every mm along given voxel centres; both ends are unchanged."""
    along = along_mm(chain)
    fine = np.linspace(0.0, along[-1], max(2, int(np.ceil(4.0 * along[-1])) + 1))
    line = np.stack([np.interp(fine, along, chain[:, axis]) for axis in range(3)], axis=1)
    step_mm = along[-1] / (len(fine) - 1) if along[-1] > 0.0 else 1.0
    reach = int(np.ceil(3.0 * SMOOTH_MM / step_mm))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_mm / SMOOTH_MM) ** 2)
    # The line is continued by its point reflection at each end, so that smoothing does not move the ends.
    before, after = 2.0 * line[:1] - line[1 : reach + 1][::-1], 2.0 * line[-1:] - line[-reach - 1 : -1][::-1]
    padded = np.concatenate([before, line, after])
    if len(padded) == len(line) + 2 * reach:
        weights /= weights.sum()
        line = np.stack([np.convolve(padded[:, axis], weights, mode="valid") for axis in range(3)], axis=1)
    along = along_mm(line)
    places = np.linspace(0.0, along[-1], max(2, round(along[-1] / STEP_MM) + 1))
    points = np.stack([np.interp(places, along, line[:, axis]) for axis in range(3)], axis=1)
    return _ended(points, chain)


def _ended(points: Points, ends: Points) -> Points:
    """Return a line whose two end points are replaced by given points, at which other branches begin."""
    points[0], points[-1] = ends[0], ends[-1]
    return points


def lumen_node(lumen: EditedLumen, voxel: NDArray[np.int64], reach_mm: float = 0.0) -> int:
    """Return the tracker's node of a voxel that paths reach, or the nearest such node within ``reach_mm``.

    Raises
    ------
    NoResultError
        If there is no such node.
    """
    volume = lumen.volume
    x, y, z = (float(value) for value in volume.to_lps(voxel.astype(np.float64)))
    found = lumen.core.nearest((x, y, z), max(reach_mm, 0.1 * min(volume.spacing_mm)))
    if found is None or not reached(lumen.core, np.array([found[0]], np.uint32))[0]:
        msg = (
            f"no branch of the tree is within {reach_mm:g} mm of the point; click inside an airway"
            if found is None
            else "the lumen at the point is not connected to the tree; bridge to it, or add a branch to it first"
        )
        raise NoResultError(msg, code="track.outside-lumen")
    return found[0]


def path_to(lumen: EditedLumen, node: int) -> Points:
    """Return the centres of the voxels on the path from the root to a node, (n, 3) LPS in mm."""
    found = lumen.core.path(node)
    assert found is not None
    return found[0]


def together(branches: list[Branch]) -> tuple[Points, NDArray[np.int64]]:
    """Return the points of all branches in one array, and the index at which each branch begins."""
    points = np.concatenate([branch.points for branch in branches])
    starts = np.cumsum([0, *(len(branch.points) for branch in branches[:-1])])
    return points, starts


def join_of(lumen: EditedLumen, branches: list[Branch], path: Points) -> tuple[CentrelinePoint, int]:
    """Return the place at which a path leaves the tree, and the index of the path's first point outside the tree.

    A point of the path is still inside a tube if some point of the tube's centreline is within its radius and
    visible from it.
    """
    tree_points, starts = together(branches)
    radius = np.concatenate([branch.radius for branch in branches])
    # Half a voxel is added, because the middle of a tube of one voxel is that voxel.
    reach = FORK_RADII * radius + 0.5 * min(lumen.volume.spacing_mm)
    low, high = path.min(axis=0) - reach.max(), path.max(axis=0) + reach.max()
    near = np.flatnonzero(((tree_points >= low) & (tree_points <= high)).all(axis=1))
    owner = np.searchsorted(starts, near, side="right") - 1
    index = near - starts[owner]
    owner = np.array([branch.id for branch in branches])[owner]
    tree_points, reach = tree_points[near], reach[near]
    leaves, place = 0, 0
    for first in range(0, len(path), 64):
        part = path[first : first + 64]
        off = np.sqrt(sum(np.square(part[:, None, a] - tree_points[None, :, a]) for a in range(3)))
        over = np.where(off <= reach[None], off, np.inf)
        for n in range(len(part)):
            order = np.flatnonzero(np.isfinite(over[n]))
            order = order[np.argsort(over[n][order], kind="stable")[:4]]
            if len(order):
                same = np.repeat(part[n : n + 1], len(order), axis=0)
                order = order[sees(lumen.core, same, tree_points[order])]
            if len(order):
                leaves, place = first + n, int(order[0])
    return CentrelinePoint(int(owner[place]), int(index[place])), leaves + 1
