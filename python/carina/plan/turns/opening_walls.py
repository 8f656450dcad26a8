"""Visible wall of each branch at a fork: the first wall on each ray of a picture, and the branch that it belongs to."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.scopes import Pose
from carina.track import AirwayTree, Branch

Points = NDArray[np.float64]
Field = NDArray[np.float64]
Mask = NDArray[np.bool_]

FOV_DEG = 120.0
"""Field of view of the pictures of turns in degrees, as wide as that of the library's scopes."""
NEAR_MM = 80.0
"""Distance in mm from the fork within which branches are considered when walls are assigned to branches."""
POSITION_STEP_MM = 0.7
"""Distance in mm between the centreline points from which the distance to a branch's surface is computed."""
BESIDE_MM = 4.0
"""Maximum distance in mm of a wall outside a branch's surface that still belongs to the branch."""
BEYOND_RADII = 0.25
"""Distance between the point at which a branch begins and all other lumens, in radii of the branch.

Nearer to the other lumens, most of the ball round the centreline is inside them.
"""
FARTHEST_MM = 80.0
"""Distance in mm from the camera beyond which a wall is ignored."""
TOUCH_MM = 0.05
"""Distance in mm from the wall at which a ray has met the wall."""
MIN_STEP_MM = 0.15
"""Minimum step in mm along a ray, so that a ray along a wall ends."""
MAX_STEPS = 200
TUBES_REACH_MM = 40.0
"""Distance in mm from a place within which `TubeWall` considers the tubes of a tree."""
NO_BRANCH, OTHER_BRANCH = -2, -1
"""Values of a pixel's owner besides branch indices: no branch, and a branch that is not listed."""


class TubeWall:
    """Wall of the tubes of a tree near a place: the surface of the balls along the centrelines.

    Parameters
    ----------
    tree
        The tree; each branch is a tube with the radii of its points.
    near_lps
        (3,) place, LPS mm.
    """

    def __init__(self, tree: AirwayTree, near_lps: Points) -> None:
        parts = [
            _places(branch)
            for branch in tree.branches
            if float(np.linalg.norm(branch.points - near_lps, axis=1).min()) <= TUBES_REACH_MM
        ]
        if not parts:
            parts = [(np.empty((0, 3)), np.empty(0))]
        line, radius = np.concatenate([one for one, _ in parts]), np.concatenate([one for _, one in parts])
        near = np.linalg.norm(line - near_lps, axis=1) <= TUBES_REACH_MM
        self._line, self._radius = line[near], radius[near]

    def distance_mm(self, points_lps: Points) -> Field:
        """Return the distances (n,) in mm from points (n, 3), LPS mm, to the wall; positive in the lumen."""
        if not len(self._line):
            return np.full(len(points_lps), -np.inf)
        return -_to_surface_mm(points_lps, self._line, self._radius)


def pixel_angles_rad(size_px: int) -> tuple[Field, Field]:
    """Return the angles in rad to the right and down of each pixel of a turn's picture, (size, size) each.

    The lens is equidistant: the distance of a pixel from the middle is proportional to the angle.
    """
    steps = (np.arange(size_px) + 0.5 - size_px / 2) / (size_px / 2) * math.radians(FOV_DEG / 2)
    down, right = np.meshgrid(steps, steps, indexing="ij")
    return right, down


def first_walls(camera: Pose, size_px: int, wall: TubeWall) -> Points:
    """Return the first wall on the ray of each pixel of a turn's picture, (size, size, 3), LPS mm.

    Parameters
    ----------
    camera
        Camera of the picture.
    size_px
        Width and height of the picture.
    wall
        Tubes of the tree near the fork.

    Returns
    -------
    numpy.ndarray
        NaN where no wall is nearer than `FARTHEST_MM`.
    """
    right, down = pixel_angles_rad(size_px)
    angle = np.hypot(right, down)
    across = np.sin(angle) / np.maximum(angle, 1e-9)
    rays = np.stack([across * right, across * down, np.cos(angle)], axis=-1).reshape(-1, 3)
    rays = rays @ camera.lps_from_camera[:3, :3].T
    depth = np.zeros(len(rays))
    going = np.arange(len(rays))
    for _ in range(MAX_STEPS):
        gap = wall.distance_mm(camera.position_lps + depth[going, None] * rays[going])
        going, gap = going[gap > TOUCH_MM], gap[gap > TOUCH_MM]
        depth[going] += np.maximum(gap, MIN_STEP_MM)
        going = going[depth[going] < FARTHEST_MM]
        if not going.size:
            break
    depth[going] = np.inf
    depth[depth >= FARTHEST_MM] = np.nan
    found: Points = (camera.position_lps + depth[:, None] * rays).reshape(size_px, size_px, 3)
    return found


class ForkWalls:
    """Branches at a fork, to which the visible walls are assigned.

    A wall belongs to the branch with the nearest surface: least distance from the centreline, less the radius. A branch
    begins where its centreline has left the lumens of all other branches by `BEYOND_RADII`, and includes its
    descendants.

    Parameters
    ----------
    tree
        The airway tree.
    fork_lps
        (3,) position of the fork, LPS mm.
    branch_ids
        Branches that begin at the fork.
    """

    def __init__(self, tree: AirwayTree, fork_lps: Points, branch_ids: Sequence[int]) -> None:
        fork = np.asarray(fork_lps, dtype=np.float64)
        number = {branch_id: n for n, branch_id in enumerate(branch_ids)}
        owner: dict[int, int] = {}
        parts: list[list[tuple[Points, Field]]] = [[] for _ in range(len(branch_ids) + 1)]
        # Parents precede their children in the tree.
        for branch in tree.branches:
            inherited = OTHER_BRANCH if branch.parent is None else owner[branch.parent]
            owner[branch.id] = number.get(branch.id, inherited)
            if float(np.linalg.norm(branch.points - fork, axis=1).min()) > NEAR_MM:
                continue
            line, radius = _places(branch)
            near = np.linalg.norm(line - fork, axis=1) <= NEAR_MM
            if near.any():
                parts[owner[branch.id]].append((line[near], radius[near]))
        self._tubes: list[list[tuple[Points, Field]]] = [[] for _ in branch_ids]
        self._others = list(parts[OTHER_BRANCH])
        self.mouths_lps: list[Points] = []
        """For each branch the point of its centreline at which it begins, (3,) LPS mm."""
        self.own_mouths_lps: list[Points] = []
        """For each branch the point at which its own centreline begins, (3,) LPS mm.

        Its subtree counts only if no point of its centreline has left the lumens of the other branches.
        """
        self.axes_lps: list[Points] = []
        """For each branch the points (n, 3) of its centreline from this beginning on, LPS mm."""
        for n, branch_id in enumerate(branch_ids):
            outside = [one for k, part in enumerate(parts) if k != n for one in part]
            others = _joined(outside)
            for line, radius in parts[n]:
                apart = (
                    np.ones(len(line), dtype=bool)
                    if not len(others[0])
                    else _to_surface_mm(line, *others) >= BEYOND_RADII * radius
                )
                self._tubes[n].append((line[apart], radius[apart]))
                if not apart.all():
                    self._others.append((line[~apart], radius[~apart]))
            beyond = _joined(self._tubes[n])[0]
            end = tree.branch(branch_id).points[-1]
            nearest = beyond[int(np.argmin(np.linalg.norm(beyond - fork, axis=1)))] if len(beyond) else end
            self.mouths_lps.append(np.asarray(nearest, dtype=np.float64))
            # A branch includes its subtree; the first tube is the branch's own centreline.
            axis = self._tubes[n][0][0] if self._tubes[n] else beyond[:0]
            own = axis[int(np.argmin(np.linalg.norm(axis - fork, axis=1)))] if len(axis) else nearest
            self.own_mouths_lps.append(np.asarray(own, dtype=np.float64))
            away = np.linalg.norm(axis - self.mouths_lps[n], axis=1)
            self.axes_lps.append(axis[int(np.argmin(away)) :] if len(axis) else axis)

    def owners(self, walls_lps: Points) -> NDArray[np.int64]:
        """Return for walls (h, w, 3) the index (h, w) of the branch, `OTHER_BRANCH` or `NO_BRANCH`."""
        points = walls_lps.reshape(-1, 3)
        known: Mask = np.asarray(np.isfinite(points).all(axis=1))
        points = np.where(known[:, None], points, np.inf)
        gaps = np.stack([_least_gap_mm(points, tubes) for tubes in (*self._tubes, self._others)])
        found = np.argmin(gaps, axis=0)
        found = np.where(found == len(self._tubes), OTHER_BRANCH, found)
        found = np.where(known & np.isfinite(gaps.min(axis=0)), found, NO_BRANCH)
        return found.reshape(walls_lps.shape[:2])


def opening_pixels(owners: NDArray[np.int64], branch: int, seed_px: tuple[float, float]) -> Mask:
    """Return the pixels (h, w) of the opening of a branch: the connected visible wall of the branch.

    Parameters
    ----------
    owners
        Index (h, w) of the branch of each pixel's wall (`ForkWalls.owners`).
    branch
        Index of the branch.
    seed_px
        Position (column, row) in the picture; of several parts of the branch's visible wall the nearest one is the
        opening.
    """
    return _connected(owners == branch, (owners != branch) & (owners != NO_BRANCH), seed_px)


def _joined(parts: Sequence[tuple[Points, Field]]) -> tuple[Points, Field]:
    if not parts:
        return np.empty((0, 3)), np.empty(0)
    return np.concatenate([line for line, _ in parts]), np.concatenate([radius for _, radius in parts])


def _least_gap_mm(points: Points, tubes: list[tuple[Points, Field]]) -> Field:
    """Return the distance in mm of points outside the nearest of several tubes; infinite above :data:`BESIDE_MM`."""
    found = np.full(len(points), np.inf)
    for line, radius in tubes:
        if not len(line):
            continue
        reach = (radius + BESIDE_MM)[:, None]
        low, high = (line - reach).min(axis=0), (line + reach).max(axis=0)
        close = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        if close.size:
            found[close] = np.minimum(found[close], _to_surface_mm(points[close], line, radius))
    return np.where(found <= BESIDE_MM, found, np.inf)


def _places(branch: Branch) -> tuple[Points, Field]:
    """Return evenly spaced points (n, 3) of a branch's centreline and the radii (n,) at these points."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(2, math.ceil(along[-1] / POSITION_STEP_MM) + 1))
    line = np.stack([np.interp(at, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    return line, np.interp(at, along, branch.radius)


def _to_surface_mm(points: Points, line: Points, radius: Field) -> Field:
    """Return the least distance in mm of points outside a tube: distance from its line, less the radius there."""
    middle = line.mean(axis=0)
    away, line = points - middle, line - middle
    squared = (away**2).sum(axis=1)[:, None] + (line**2).sum(axis=1) - 2.0 * away @ line.T
    found: Field = (np.sqrt(np.maximum(squared, 0.0)) - radius).min(axis=1)
    return found


def _connected(mask: NDArray[np.bool_], others: NDArray[np.bool_], seed: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the part of a mask nearest to a position (column, row), without holes except those of other branches."""
    if not mask.any():
        return mask
    # Slivers of the wall behind a corner are connected by a few pixels and are not part of the opening.
    core = _shrunk(mask)
    core = core if core.any() else mask
    rows, columns = np.nonzero(core)
    nearest = int(np.argmin((columns + 0.5 - seed[0]) ** 2 + (rows + 0.5 - seed[1]) ** 2))
    start = np.zeros_like(mask)
    start[rows[nearest], columns[nearest]] = True
    patch = _filled_from(start, core)
    if core is not mask:
        patch = ~_shrunk(~patch) & mask
    # A hole cannot be reached from the border of the picture. Far walls inside an opening belong to no branch.
    border = np.zeros_like(mask)
    border[[0, -1], :] = border[:, [0, -1]] = True
    hole = ~patch & ~_filled_from(border & ~patch, ~patch)
    return patch | (hole & ~others)


def _shrunk(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Erode a mask by two pixels; the mask is continued beyond the edges of the picture."""
    found = mask
    for step in range(2):
        padded = np.pad(found, 1, mode="edge")
        crossed = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:] & found
        if step:
            crossed &= padded[:-2, :-2] & padded[2:, 2:] & padded[:-2, 2:] & padded[2:, :-2]
        found = crossed
    return found


def _filled_from(start: NDArray[np.bool_], within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the part of a mask that is connected to a start by sides, by alternate sweeps over rows and columns."""
    found = start & within
    while True:
        before = int(found.sum())
        for axis in (0, 1):
            for turned in (False, True):
                found = _swept(found, within, axis=axis, backwards=turned)
        if int(found.sum()) == before:
            return found


def _swept(found: NDArray[np.bool_], within: NDArray[np.bool_], *, axis: int, backwards: bool) -> NDArray[np.bool_]:
    """Fill each run of ``within`` along an axis from the run's first pixel in ``found`` onwards."""
    a = np.moveaxis(found, axis, 1)
    w = np.moveaxis(within, axis, 1)
    if backwards:
        a, w = a[:, ::-1], w[:, ::-1]
    place = np.arange(a.shape[1])
    last_found = np.maximum.accumulate(np.where(a, place, -1), axis=1)
    last_gap = np.maximum.accumulate(np.where(w, -1, place), axis=1)
    filled = w & (last_found > last_gap)
    if backwards:
        filled = filled[:, ::-1]
    return np.ascontiguousarray(np.moveaxis(filled, 1, axis))
