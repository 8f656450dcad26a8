"""Steps of each edit: the voxels that are added to the lumen or removed, and the changes of the tree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from carina._core import cut_voxels, more_tips, newly_reached, nodes_at, pulled_inside, reached, sees, voxels_of
from carina.errors import NoEvidenceError, NoResultError, UsageError
from carina.track.edit.add_branch_path import (
    FORK_RADII,
    MIN_ADDED_MM,
    join_of,
    lumen_node,
    no_evidence,
    path_to,
    planned_way,
    together,
)
from carina.track.edit.centreline_pieces import Piece, bridge_pieces, kind_of_added, painted_pieces
from carina.track.edit.edit_list import (
    AddBranch,
    Bridge,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    Point,
    SmoothBranch,
    TreeEdit,
    branch_title,
)
from carina.track.edit.evidence import Evidence
from carina.track.edit.lumen import (
    BRIDGE_RADIUS_MM,
    EditedLumen,
    Voxels,
    air_voxel,
    bridge_way,
    grown_beyond,
    missed_radii,
    painted_voxels,
    tube_round,
    voxel_of,
    voxels_along,
)
from carina.track.edit.remeasure import Box
from carina.track.edit.tree_changes import CentrelinePoint, Points, TreeDraft, along_mm, needed_branch, turn_deg
from carina.track.paths.tracker import SNAP_MM, STEP_MM
from carina.track.tree.airway_tree import AirwayTree, Branch

NO_VOXELS = np.zeros((0, 3), dtype=np.uint16)
SMOOTHING_ROUNDS = 3
MIN_BEYOND_MM = 4.0
"""Minimum length in mm of visible airway beyond an obstruction for a bridge across it."""
MAX_TURN_DEG = 120.0
"""Maximum angle in degrees between an airway before a bridge and its continuation beyond the bridge."""
COVER_REACH_MM = 30.0
"""Distance in mm beyond which a point belongs to no centreline's tube: more than the diameter of any trachea."""
RECENTRE_VOXELS = 0.5
"""Change of the wall distance, in voxels, above which a centreline is computed again."""


class EditSteps:
    """State of one edit while it is made: the lumen before and after it, and a draft of the tree.

    Parameters
    ----------
    lumen
        Lumen before the edit.
    tree, next_id
        Tree before the edit, and the first branch ID that was never used.
    found_zyx
        (nz, ny, nx) lumen before the first edit: lumen painted inside it counts as found by the search.
    bridges
        (n, 3) points of each bridge made so far, LPS in mm.
    evidence
        Function that returns the evidence in the CT; called only if an edit adds something.
    """

    def __init__(
        self,
        lumen: EditedLumen,
        tree: AirwayTree,
        next_id: int,
        found_zyx: NDArray[np.uint8],
        *,
        bridges: tuple[Points, ...],
        evidence: Callable[[], Evidence],
    ) -> None:
        self.lumen = lumen
        self._evidence = evidence
        self.judged: set[int] = set()
        """IDs of new or extended branches with a visible wall, whose confidence is still to be measured."""
        self._found_zyx = found_zyx
        self.bridges = bridges
        self.lumen_changed = False
        self.changed_boxes: list[Box] | None = []
        self._old_radius: dict[int, NDArray[np.float64]] = {}
        self.draft = TreeDraft(tree, next_id)
        self._tree = tree
        self._volume = lumen.volume

    def make(self, edit: TreeEdit) -> None:
        """Make the edit: change the lumen and the draft of the tree.

        Raises
        ------
        UsageError, NoResultError, CancelledError
            See :func:`carina.track.edit_airways`.
        """
        match edit:
            case AddBranch(lps, even_without_evidence):
                self._add(lps, even_without_evidence=even_without_evidence)
            case CutBranch(branch_id, at_mm):
                self._cut(needed_branch(self._tree, branch_id), at_mm)
            case Bridge(lps):
                self._bridge(lps)
            case MoveRoot(lps):
                self._move_root(lps)
            case MoveFork(branch_id, lps):
                self._move_fork(needed_branch(self._tree, branch_id), lps)
            case PaintLumen():
                self._paint(edit)
            case SmoothBranch(branch_id):
                self._smooth(needed_branch(self._tree, branch_id))
            case _:
                raise UsageError(f"expected an edit of a tree; found {edit!r}")

    def _add(self, lps: Point, *, even_without_evidence: bool) -> None:
        plan = planned_way(self.lumen, self._tree, self.draft, self._evidence(), lps)
        if plan.doubtful.any() and not even_without_evidence:
            raise no_evidence(plan)
        if len(plan.voxels):
            # Measure only the points outside the lumen: the wall of the tube that the path leaves is already known.
            outside = plan.points[~self.lumen.core.inside(plan.points)]
            tube = tube_round(self._volume, outside, missed_radii(self._volume, outside))
            line = voxels_along(self._volume, plan.points)
            self._change_lumen(np.concatenate([tube, line, plan.voxels]), NO_VOXELS)
        kind = kind_of_added(plan.doubtful)
        branch_id = self._hang(plan.parent_id, plan.points, kind, kind)
        if kind == "manual":
            self.draft.change(branch_id, doubtful_mm=plan.doubtful_mm)

    def _cut(self, branch: Branch, at_mm: float) -> None:
        along = along_mm(branch.points)
        title = branch_title(branch.name, branch.id)
        if at_mm >= along[-1] and at_mm > 0.0:
            msg = f"{title} is only {along[-1]:.1f} mm long; choose a point before its end, not at {at_mm:.1f} mm"
            raise UsageError(msg, code="track.edit-place")
        last = int(np.searchsorted(along, at_mm, side="right")) - 1 if at_mm > 0.0 else 0
        if branch.parent is None and last < 1:
            msg = f"{title} contains the start of the tree; cut it more distally, or move the start first"
            raise UsageError(msg, code="track.edit-root")
        below = [member.points for member in self.draft.below(branch.id)]
        below[0] = below[0][last + 1 :]
        cut_away = {member.id for member in self.draft.below(branch.id)}
        self._forget_bridges([member for member in self.draft.below(branch.id) if member.kind == "bridge"])
        remaining = [b.points for b in self._tree.branches if b.id not in cut_away] + [branch.points[: last + 1]]
        voxels = cut_voxels(self.lumen.core, self._nodes_of(below), self._nodes_of(remaining))
        if last < 1:
            self.draft.remove(branch.id)
        else:
            self.draft.shorten(branch.id, last)
        before = self.lumen.core
        self._change_lumen(NO_VOXELS, voxels)
        # Remove lumen that was only connected through the cut piece: a leak that belongs to no branch.
        loose = newly_reached(before, self.lumen.core)
        loose = loose[nodes_at(self.lumen.core, self._volume.to_lps(loose.astype(np.float64))) >= 0]
        if len(loose):
            self._change_lumen(NO_VOXELS, loose)
        self._repair_centrelines(NO_VOXELS)

    def _bridge(self, lps: Point) -> None:
        voxel = air_voxel(self.lumen, voxel_of(self._volume, lps))
        if self.lumen.state_at(voxel) == 2:
            branch, _, _ = self._tree.nearest_branch(lps)
            title = branch_title(branch.name, branch.id)
            msg = f"there is nothing to bridge: the point can be reached through {title}; add a branch instead"
            raise NoResultError(msg, code="track.edit-nothing")
        way = bridge_way(self.lumen, voxel)
        beyond = grown_beyond(self.lumen, voxel)
        added = np.unique(
            np.concatenate(
                [beyond, tube_round(self._volume, self._volume.to_lps(way.astype(np.float64)), BRIDGE_RADIUS_MM)]
            ),
            axis=0,
        )
        first_beyond = _first_in(way, beyond)
        before = self.lumen.core
        self._change_lumen(added, NO_VOXELS)
        made = self._attach(self._path(self._node(first_beyond)), "bridge", 0.0)
        if made is not None:
            self.bridges = (*self.bridges, self.draft[made].points)
        self._find_more(np.concatenate([added, newly_reached(self.lumen.core, before)]), "tracked")
        if made is not None:
            self._judge_beyond(self.draft[made], beyond)

    def _judge_beyond(self, bridge: Branch, beyond: Voxels) -> None:
        """Check the airway beyond a bridge; pieces that the CT does not show become ``manual`` (drawn by hand).

        Raises
        ------
        NoEvidenceError
            If the CT shows too little wall beyond the bridge.
        NoResultError
            If the airway beyond leads back towards the start of the bridge.
        """
        known = {(int(i), int(j), int(k)) for i, j, k in beyond}
        voxels = np.floor(self._volume.to_ijk(bridge.points) + 0.5).astype(int)
        own = np.array([(int(i), int(j), int(k)) in known for i, j, k in voxels])
        # The end of the bridge is inside the airway beyond; that part begins at the first point inside it.
        first = max(int(np.argmax(own)), 1) if own.any() else len(voxels) - 1
        lines = [bridge.points[first - 1 :]]
        doubts = [self._evidence().doubtful(lines[0])]
        for branch in self.draft.below(bridge.id)[1:]:
            if branch.id not in self.judged:
                continue
            doubtful = self._evidence().doubtful(branch.points)
            steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
            if steps[doubtful].sum() > 0.5 * steps.sum():
                self.draft.change(branch.id, kind="manual", doubtful_mm=float(steps[doubtful].sum()))
                self.judged.discard(branch.id)
            lines.append(branch.points)
            doubts.append(doubtful)
        steps = [np.linalg.norm(np.diff(line, axis=0), axis=1) for line in lines]
        evident_mm = sum(float(s[~d].sum()) for s, d in zip(steps, doubts, strict=True))
        if evident_mm < MIN_BEYOND_MM:
            doubtful_mm = sum(float(s[d].sum()) for s, d in zip(steps, doubts, strict=True))
            msg = (
                f"the CT shows too little airway wall beyond the bridge ({evident_mm:.0f} mm; at least "
                f"{MIN_BEYOND_MM:g} mm is needed). Click in the dark middle of the airway beyond the obstruction, "
                "or add a branch without evidence: it is then labelled as drawn by hand"
            )
            crossing = np.ones(len(bridge.points) - 1, dtype=bool)
            raise NoEvidenceError(msg, doubtful_mm=doubtful_mm, way_lps=bridge.points, doubtful=crossing)
        onward = [line for line in lines[1:] if np.array_equal(line[0], bridge.points[-1])]
        if onward and all(turn_deg(bridge.points, line) > MAX_TURN_DEG for line in onward):
            msg = (
                "the airway beyond leads back towards the start of the bridge, so it is not the distal part of "
                "an obstructed branch; click nearer to the end of the obstructed branch"
            )
            raise NoResultError(msg, code="track.bridge-turns")

    def _move_root(self, lps: Point) -> None:
        path = self._path(self._node(voxel_of(self._volume, lps), SNAP_MM))
        place, left = self._join(path)
        draft, trunk = self.draft, self.draft[self.draft.root_id]
        away_mm = along_mm(path[left - 1 :])[-1]
        if place.branch_id == trunk.id and place.index == 0:
            if np.linalg.norm(path[-1] - trunk.points[0]) < MIN_ADDED_MM:
                raise NoResultError("the tree already starts there; nothing was changed", code="track.edit-nothing")
            # The new root is beyond the start of the trunk: extend the trunk up to it.
            above = self._drawn(trunk.points[0], path[1:])[::-1]
            points = np.concatenate([above, trunk.points[1:]])
            draft.change(trunk.id, points=points, radius=self._radius(points), cost=None)
        elif away_mm > FORK_RADII * draft[place.branch_id].radius[place.index]:
            tip = self._attach(path, "tracked", 0.0)
            assert tip is not None
            draft.turn_round(tip)
        elif place.branch_id == trunk.id:
            # Remove the part of the trunk above the new root; its lumen stays.
            at = min(place.index, max(len(trunk.points) - 2, 0))
            draft.change(trunk.id, points=trunk.points[at:], radius=trunk.radius[at:], cost=None)
        else:
            self._begin_inside(place)
        root_voxel = voxel_of(self._volume, _point(self.draft[self.draft.root_id].points[0]))
        i, j, k = (int(v) for v in root_voxel)
        self.lumen = self.lumen.rerooted((i, j, k))

    def _begin_inside(self, place: CentrelinePoint) -> None:
        """Make a point inside a branch the root of the tree.

        The trunk becomes a single point, at which the branches in both directions begin, unless the place is at a
        tip.
        """
        branch = self.draft[place.branch_id]
        last = len(branch.points) - 1
        if not branch.children and place.index >= last - 1:
            self.draft.turn_round(branch.id)
            return
        if last < 2:
            msg = "the branch at this point is too short for the start; choose a point in the next branch"
            raise NoResultError(msg, code="track.edit-place")
        self.draft.split(CentrelinePoint(branch.id, min(max(place.index, 1), last - 1)))
        upper = self.draft[branch.id]
        trunk = self.draft.add_child(upper.id, upper.points[-1:].copy(), upper.radius[-1:].copy(), upper.kind)
        self.draft.turn_round(trunk)

    def _move_fork(self, branch: Branch, lps: Point) -> None:
        title = branch_title(branch.name, branch.id)
        if not branch.children:
            msg = (
                f"{title} ends without a fork, so there is nothing to move; to make it longer, add a branch beyond "
                "its end"
            )
            raise UsageError(msg, code="track.edit-place")
        voxel = voxel_of(self._volume, lps)
        new = np.array(lps)
        if self.lumen.state_at(voxel) != 2:
            node = self._node(voxel, SNAP_MM)
            new = self._volume.to_lps(voxels_of(self.lumen.core, np.array([node], np.uint32))[0].astype(np.float64))
        shift = new - branch.points[-1]
        shift_mm = float(np.linalg.norm(shift))
        adjoining = [branch, *(self.draft[child] for child in branch.children)]
        shortest = min(adjoining, key=lambda b: b.length_mm)
        if shift_mm >= 0.9 * shortest.length_mm:
            msg = (
                f"the fork would move {shift_mm:.1f} mm, but {branch_title(shortest.name, shortest.id)}, which meets "
                f"it, is only {shortest.length_mm:.1f} mm long; move the fork a shorter distance, or cut the branch "
                "and add it again"
            )
            raise UsageError(msg, code="track.edit-place")
        for member in adjoining:
            is_end = member.id == branch.id
            along = along_mm(member.points)
            off = along[-1] - along if is_end else along
            glide_mm = min(max(3.0 * shift_mm, 2.0 * float(member.radius[-1 if is_end else 0])), along[-1])
            x = np.clip(off / glide_mm, 0.0, 1.0)
            share = (1.0 - x) ** 2 * (1.0 + 2.0 * x)
            points = pulled_inside(self.lumen.core, member.points + share[:, None] * shift)
            points[-1 if is_end else 0] = new
            points[0 if is_end else -1] = member.points[0 if is_end else -1]
            moved = np.flatnonzero(share > 0.0)
            near = np.unique(np.clip(np.concatenate([moved - 1, moved, moved + 1]), 0, len(points) - 1))
            seen, was_seen = (sees(self.lumen.core, p[near][:-1], p[near][1:]) for p in (points, member.points))
            if not self._all_inside(points[moved]) or (was_seen & ~seen).any():
                raise NoResultError(
                    "the fork cannot be moved there: the adjoining centrelines would leave the airway; move it "
                    "a shorter distance",
                    code="track.outside-lumen",
                )
            if self._evidence().crosses_wall(points[near], member.points):
                raise NoResultError(
                    f"the fork cannot be moved there: {branch_title(member.name, member.id)} would then pass "
                    "through a wall; move it a shorter distance",
                    code="track.crosses-wall",
                )
            radius = member.radius.copy()
            radius[moved] = self._radius(points[moved])
            self.draft.change(member.id, points=points, radius=radius)

    def _paint(self, edit: PaintLumen) -> None:
        grid = self.lumen.grid
        # The brush selects whole voxels of the displayed CT, which the grid of the edit may divide.
        voxels = grid.voxels_in(painted_voxels(grid.ct, edit))
        is_lumen = nodes_at(self.lumen.core, self._volume.to_lps(voxels.astype(np.float64))) >= 0
        voxels = voxels[is_lumen == edit.erase]
        if not len(voxels):
            what = (
                "no lumen under the brush to erase"
                if edit.erase
                else ("nothing to paint: everything under the brush is already lumen")
            )
            raise NoResultError(f"there is {what}; nothing was changed", code="track.edit-nothing")
        before = self.lumen.core
        if edit.erase:
            if (voxels == np.array(self.lumen.root_ijk)).all(axis=1).any():
                msg = (
                    "the start of the tree lies under the brush, and the lumen around the start cannot be erased; "
                    "move the start first"
                )
                raise UsageError(msg, code="track.edit-root")
            self._change_lumen(NO_VOXELS, voxels)
        else:
            self._change_lumen(voxels, NO_VOXELS)
        lost = self._repair_centrelines(voxels)
        candidates = np.concatenate([newly_reached(self.lumen.core, before), lost])
        self._find_more(candidates, "tracked" if edit.erase else "painted")

    def _smooth(self, branch: Branch) -> None:
        points = branch.points
        for _ in range(SMOOTHING_ROUNDS):
            points = self._ended(self.lumen.core.smooth(points, step_mm=STEP_MM, keep_end=True), points)
        self.draft.change(branch.id, points=points, radius=self._radius(points))

    def _change_lumen(self, added: Voxels, removed: Voxels) -> None:
        """Change the lumen, and update the radii of the centrelines near the change."""
        before = self.lumen
        self.lumen = before.changed(added, removed)
        self.lumen_changed = True
        box = self.lumen.changed_box
        self.changed_boxes = None if box is None or self.changed_boxes is None else [*self.changed_boxes, box]
        self._old_radius = {}
        branches = self.draft.ordered()
        points, starts = together(branches)
        near = np.arange(len(points))
        if box is not None:
            ijk = self._volume.to_ijk(points)
            # A radius is interpolated between the voxels round a point.
            near = np.flatnonzero(((ijk > box[0] - 1.5) & (ijk < box[1] + 1.5)).all(axis=1))
        old, new = (lumen.core.radius_mm(points[near]) for lumen in (before, self.lumen))
        near, new = near[old != new], new[old != new]
        owners = np.searchsorted(starts, near, side="right") - 1
        for number in np.unique(owners):
            branch, mine = branches[number], owners == number
            self._old_radius[branch.id] = branch.radius
            radius = branch.radius.copy()
            radius[near[mine] - starts[number]] = new[mine]
            self.draft.change(branch.id, radius=radius)

    def _repair_centrelines(self, voxels: Voxels) -> Voxels:
        """Move the centrelines back into a changed lumen, and remove branches that paths no longer reach.

        Parameters
        ----------
        voxels
            Painted or erased voxels: centrelines beside which the wall moved are computed again.

        Returns
        -------
        (n, 3) uint16
            Lumen voxels of the removed branches.
        """
        lost: list[Points] = []
        self._keep_forks()
        # Repeat after branches were joined: the points of the joined branch may be outside.
        for _ in range(1 + len(self._tree)):
            if not self._repair_once(voxels, lost):
                break
            voxels = NO_VOXELS
        if not lost:
            return NO_VOXELS
        nodes = nodes_at(self.lumen.core, np.concatenate(lost))
        return voxels_of(self.lumen.core, np.unique(nodes[nodes >= 0]).astype(np.uint32))

    def _repair_once(self, voxels: Voxels, lost: list[Points]) -> bool:
        """Check every branch against the lumen once.

        Return whether a branch was removed, which may have joined two others.
        """
        branches = self.draft.ordered()
        points, starts = together(branches)
        all_fit = self._fits(points)
        num_lost = len(lost)
        for was, first in zip(branches, starts, strict=True):
            fits = all_fit[first : first + len(was.points)]
            if fits.all() and not (len(voxels) and self._wall_moved(was)):
                continue
            branch_id = was.id
            # An earlier iteration removed the branch with its parent, or joined it with the parent.
            if branch_id not in self.draft:
                continue
            branch = self.draft[branch_id]
            if len(branch.points) != len(was.points):
                continue
            if fits[0] and fits[-1]:
                drawn = self._tracked_again(branch)
                if drawn is not None:
                    self.draft.change(branch_id, points=drawn, radius=self._radius(drawn))
                    continue
                if fits.all():
                    continue
            last = int(np.argmin(fits)) - 1 if not fits.all() else len(fits) - 1
            for member in self.draft.below(branch_id):
                lost.append(member.points)
            if last >= 1 and along_mm(branch.points[: last + 1])[-1] >= MIN_ADDED_MM:
                self.draft.shorten(branch_id, last)
            elif branch.parent is None:
                self.draft.shorten(branch_id, max(last, 0))
            else:
                self.draft.remove(branch_id)
        return len(lost) > num_lost

    def _keep_forks(self) -> None:
        """Move forks outside the lumen to the nearest lumen within their tube, to keep the branches beyond."""
        forks = [branch for branch in self.draft.ordered() if branch.children]
        if not forks:
            return
        ends = np.stack([branch.points[-1] for branch in forks])
        for number in np.flatnonzero(~self._fits(ends)):
            branch = forks[number]
            reach_mm = max(float(branch.radius[-1]), 2.0 * max(self._volume.spacing_mm))
            found = self.lumen.core.nearest(_point(ends[number]), reach_mm)
            if found is None or not reached(self.lumen.core, np.array([found[0]], np.uint32))[0]:
                continue
            voxel = voxels_of(self.lumen.core, np.array([found[0]], np.uint32))[0]
            fork = self._volume.to_lps(voxel.astype(np.float64))
            for member_id, at in ((branch.id, -1), *((child, 0) for child in branch.children)):
                points, radius = self.draft[member_id].points.copy(), self.draft[member_id].radius.copy()
                points[at] = fork
                radius[at] = self._radius(fork[None])[0]
                self.draft.change(member_id, points=points, radius=radius)

    def _wall_moved(self, branch: Branch) -> bool:
        old = self._old_radius.get(branch.id)
        if old is None or len(old) != len(branch.radius):
            return False
        moved_mm = np.abs(old - branch.radius).max()
        return bool(moved_mm > RECENTRE_VOXELS * min(self._volume.spacing_mm))

    def _tracked_again(self, branch: Branch) -> Points | None:
        """Return the points of a branch, computed again as the least-cost path between its ends."""
        node = int(nodes_at(self.lumen.core, branch.points[-1:])[0])
        path = self._path(node)
        off = np.linalg.norm(path - branch.points[0], axis=1)
        nearest = int(np.argmin(off))
        if off[nearest] > max(float(branch.radius[0]), 2.0 * max(self._volume.spacing_mm)):
            return None
        chain = np.concatenate([branch.points[:1], path[nearest + 1 : -1], branch.points[-1:]])
        if branch.parent is None:
            chain = np.concatenate([path[:-1], branch.points[-1:]])
        points = self._ended(self.lumen.core.smooth(chain, step_mm=STEP_MM, keep_end=True), chain)
        return points if self._all_inside(points) else None

    def _node(self, voxel: NDArray[np.int64], reach_mm: float = 0.0) -> int:
        return lumen_node(self.lumen, voxel, reach_mm)

    def _path(self, node: int) -> Points:
        return path_to(self.lumen, node)

    def _nodes_of(self, lines: list[Points]) -> NDArray[np.uint32]:
        points = np.concatenate([line for line in lines if len(line)] or [np.zeros((0, 3))])
        nodes = nodes_at(self.lumen.core, points)
        return np.unique(nodes[nodes >= 0]).astype(np.uint32)

    def _fits(self, points: Points) -> NDArray[np.bool_]:
        """Return (n,) flags: True for each point in lumen that a path from the root reaches."""
        nodes = nodes_at(self.lumen.core, points)
        fits = np.array(nodes >= 0, dtype=bool)
        fits[fits] = reached(self.lumen.core, nodes[fits].astype(np.uint32))
        return fits

    def _all_inside(self, points: Points) -> bool:
        return bool((nodes_at(self.lumen.core, points) >= 0).all())

    def _radius(self, points: Points) -> NDArray[np.float64]:
        return self.lumen.core.radius_mm(points)

    @staticmethod
    def _ended(points: Points, ends: Points) -> Points:
        """Set the ends of a line exactly to given points, at which other branches begin."""
        points[0], points[-1] = ends[0], ends[-1]
        return points

    def _join(self, path: Points) -> tuple[CentrelinePoint, int]:
        return join_of(self.lumen, self.draft.ordered(), path)

    def _drawn(self, start: Points, beyond: Points) -> Points:
        chain = np.concatenate([start[None], beyond])
        return self._ended(self.lumen.core.smooth(chain, step_mm=STEP_MM, keep_end=True), chain)

    def _attach(self, path: Points, kind: str, least_mm: float) -> int | None:
        """Attach the end of a path to the tree at the place where the path leaves the tree.

        Return the ID of the new branch.
        """
        place, left = self._join(path)
        beyond = path[left:]
        if not len(beyond) or along_mm(path[left - 1 :])[-1] < least_mm:
            return None
        parent_id = self.draft.parent_at(place, max(3.0, 1.5 * max(self._volume.spacing_mm)))
        parent = self.draft[parent_id]
        points = self._drawn(parent.points[-1], beyond)
        for piece, piece_kind in self._pieces(points, kind):
            parent_id = self._hang(parent_id, piece, piece_kind, kind)
            if piece_kind == "manual":
                steps = np.linalg.norm(np.diff(piece, axis=0), axis=1)
                doubts = self._is_doubtful(piece)
                self.draft.change(parent_id, doubtful_mm=float(steps[doubts[1:] | doubts[:-1]].sum()))
        return parent_id

    def _hang(self, parent_id: int, points: Points, kind: str, requested_kind: str) -> int:
        """Add a branch at the end of another, or extend the other if both are the same airway.

        Return the ID of the branch.
        """
        parent, radius = self.draft[parent_id], self._radius(points)
        goes_on = kind == "tracked" or (kind == "bridge" and requested_kind != "bridge")
        if not parent.children and parent.kind == kind and goes_on:
            self.draft.change(
                parent_id,
                points=np.concatenate([parent.points, points[1:]]),
                radius=np.concatenate([parent.radius, radius[1:]]),
                cost=None,
            )
            made = parent_id
        else:
            made = self.draft.add_child(parent_id, points, radius, kind)
        if kind == "tracked":
            self.judged.add(made)
        return made

    def _pieces(self, points: Points, kind: str) -> list[Piece]:
        """Divide a centreline into pieces of one kind; a ``painted`` line may pass airways that the search found."""
        pieces = [(points, kind)]
        if kind == "painted":
            pieces = painted_pieces(points, ~self._is_doubtful(points), MIN_ADDED_MM)
        if kind == "bridge" or not self.bridges:
            return pieces
        half_voxel_mm = 0.5 * max(self._volume.spacing_mm)
        return [
            piece
            for part, its_kind in pieces
            for piece in bridge_pieces(part, its_kind, self.bridges, half_voxel_mm, MIN_ADDED_MM)
        ]

    def _is_doubtful(self, points: Points) -> NDArray[np.bool_]:
        """Return (n,) flags: True outside the lumen of the search where the CT shows no wall round the line."""
        i, j, k = np.floor(self._volume.to_ijk(points) + 0.5).astype(int).T
        is_new = self._found_zyx[k, j, i] == 0
        if is_new.any():
            segments = self._evidence().doubtful(points)
            is_new = is_new & (np.append(segments, segments[-1:]) | np.append(segments[:1], segments))
        return np.asarray(is_new)

    def _forget_bridges(self, cut: list[Branch]) -> None:
        """Remove the bridges that a cut removes from the list of bridges."""
        if not cut or not self.bridges:
            return
        cut_away = np.concatenate([branch.points for branch in cut])
        self.bridges = tuple(
            way
            for way in self.bridges
            if np.sqrt(np.square(way[:, None] - cut_away[None]).sum(axis=2)).min() > BRIDGE_RADIUS_MM
        )

    def _find_more(self, candidates: Voxels, kind: str) -> None:
        """Search for branches in the new lumen that are missing from the tree, and add them."""
        if not len(candidates):
            return
        core = self.lumen.core
        points, _ = together(self.draft.ordered())
        ends = self._volume.to_lps(candidates.astype(np.float64))
        low, high = ends.min(axis=0) - COVER_REACH_MM, ends.max(axis=0) + COVER_REACH_MM
        nodes = self._nodes_of([points[((points >= low) & (points <= high)).all(axis=1)]])
        for tip in more_tips(core, nodes, candidates, cancel=self.lumen.cancel):
            self._attach(self._path(int(tip)), kind, MIN_ADDED_MM)


def _point(values: NDArray[np.float64]) -> Point:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _first_in(way: Voxels, voxels: Voxels) -> NDArray[np.int64]:
    """Return the first voxel of a path that is in a set of voxels; the last voxel of the path if none is."""
    known = {(int(i), int(j), int(k)) for i, j, k in voxels}
    for voxel in way:
        if (int(voxel[0]), int(voxel[1]), int(voxel[2])) in known:
            return np.asarray(voxel, dtype=np.int64)
    return np.asarray(way[-1], dtype=np.int64)
