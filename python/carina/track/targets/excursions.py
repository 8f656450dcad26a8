"""Replacement of excursions (parts of a relaxed path outside the lumen) by ways through the lumen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.track.find.result import Airways
from carina.track.paths.tracker import STEP_MM, as_point
from carina.track.targets.relaxed_path import (
    LUMEN_SHARE,
    evenly_spaced,
    relaxed_in_tube,
    relaxed_path,
    tube_around,
)
from carina.volume.model import Volume

Points = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Excursion:
    """Part of a path outside the lumen, and the way through the lumen between the same ends."""

    leaves_at: int
    """Index of the last point before the excursion."""
    returns_at: int
    """Index of the first point after the excursion."""
    way: Points
    """Relaxed way (n, 3) through the lumen from the first to the last point, LPS in mm."""
    is_beside_wide_lumen: bool
    """Whether the way is three voxels wide next to a point of the excursion."""


def flyable_path(volume: Volume, airways: Airways | None, nodes_lps: Points) -> Points:
    """Return the relaxed path of a search by the cost ``walls``, with its avoidable excursions replaced.

    An excursion is replaced by the way through the lumen if that way is three voxels wide beside the excursion, or if
    the whole path becomes shorter. Other excursions remain, and so do paths without an excursion.

    Parameters
    ----------
    volume
        The CT.
    airways
        Airways whose lumen is compared with the path; None if there are none.
    nodes_lps
        Points (n, 3) of the path of the search, LPS in mm.

    Returns
    -------
    ndarray
        Points about 1 mm apart with the same ends, LPS in mm.
    """
    points = relaxed_path(volume, airways, nodes_lps)
    return points if airways is None else replace_excursions(volume, airways, points)


def replace_excursions(volume: Volume, airways: Airways, points: Points) -> Points:
    """Return a relaxed path (n, 3) whose avoidable excursions are replaced; the same array without any."""
    excursions = find_excursions(volume, airways, points)
    chain, may_leave = _shortest_chain(airways, points, excursions) if excursions else (points, None)
    return points if may_leave is None else relaxed_path(volume, airways, chain, may_leave=may_leave)


def find_excursions(volume: Volume, airways: Airways, points: Points) -> list[Excursion]:
    """Return the excursions of a path from the lumen for which a way through the lumen exists, in order.

    A path that begins outside the lumen has none. An end of the path outside the lumen belongs to the lumen if that is
    not farther than the longest edge of a voxel.
    """
    inside = airways.tracker.inside(points)
    if not inside[0]:
        return []
    outside = np.flatnonzero(~inside)
    excursions: list[Excursion] = []
    snap_mm = max(volume.spacing_mm)
    # An excursion may be nearest to the lumen before the point where it leaves: use the whole path in the lumen.
    whole = way_through_lumen(airways, points[0], points[-1], snap_mm) if len(outside) else None
    for run in np.split(outside, np.flatnonzero(np.diff(outside) > 1) + 1):
        if not len(run):
            continue
        first, last = int(run[0]) - 1, min(int(run[-1]) + 1, len(points) - 1)
        nodes = way_through_lumen(airways, points[first], points[last], snap_mm)
        if nodes is None or last - first < 2:
            continue
        tube = tube_around(volume, airways, nodes, may_leave=np.zeros(len(nodes), dtype=bool))
        way = relaxed_in_tube(evenly_spaced(nodes, STEP_MM), tube)
        beside = airways.tracker.core.smooth((nodes if whole is None else whole)[1:-1], step_mm=STEP_MM, keep_end=True)
        nearest = np.linalg.norm(beside[None] - points[run][:, None], axis=2).argmin(axis=1)
        is_wide = in_wide_lumen(volume, airways, beside)[nearest]
        excursions.append(Excursion(first, last, way, bool(is_wide.any())))
    return excursions


def way_through_lumen(airways: Airways, start_lps: Points, end_lps: Points, snap_mm: float) -> Points | None:
    """Return points (n, 3) of the way through the lumen between two points, LPS in mm; None if there is none.

    Both points may be outside the lumen by up to ``snap_mm``.
    """
    paths: list[Points] = []
    for point in (start_lps, end_lps):
        try:
            node, _ = airways.tracker.snap(as_point(point), snap_mm=snap_mm)
        except NoResultError:
            return None
        if not airways.tracker.core.solve_to(node):
            return None
        found = airways.tracker.core.path(node)
        assert found is not None
        paths.append(found[0])
    start, end = paths
    shared = min(len(start), len(end))
    differs = (start[:shared] != end[:shared]).any(axis=1)
    # Both paths begin at the root of the airways: the way turns at their last common voxel.
    fork = (int(differs.argmax()) if bool(differs.any()) else shared) - 1
    return np.concatenate([start_lps[None], start[fork:][::-1], end[fork + 1 :], end_lps[None]])


def in_wide_lumen(volume: Volume, airways: Airways, points: Points) -> Mask:
    """Return (n,) whether the voxel of each (n, 3) point, LPS in mm, is in a cube of 3 x 3 x 3 lumen voxels."""
    ijk = np.rint(volume.to_ijk(points)).astype(np.intp)
    most = np.array(volume.shape_zyx[::-1])
    first, last = np.maximum(ijk.min(axis=0) - 2, 0), np.minimum(ijk.max(axis=0) + 3, most)
    box = airways.lumen_zyx[first[2] : last[2], first[1] : last[1], first[0] : last[0]] != 0
    within: Mask = np.all((ijk >= 0) & (ijk < most), axis=1)
    i, j, k = np.where(within[:, None], ijk - first, 0).T
    found: Mask = within & wide_lumen(box)[k, j, i]
    return found


def wide_lumen(lumen: Mask) -> Mask:
    """Return the voxels of a lumen that are in a cube of 3 x 3 x 3 lumen voxels (opening by that cube)."""
    for combine in (np.logical_and, np.logical_or):
        for axis in range(3):
            padded = np.pad(lumen, [(1, 1) if a == axis else (0, 0) for a in range(3)])
            size = lumen.shape[axis]
            first, second, third = (np.take(padded, range(n, n + size), axis=axis) for n in range(3))
            lumen = combine(combine(first, second), third)
    return lumen


def _shortest_chain(airways: Airways, points: Points, excursions: list[Excursion]) -> tuple[Points, Mask | None]:
    """Return the shortest chain of points of a path and its detours round excursions, and its points in excursions.

    The chain may pass between two points in the lumen if one is in the ball of lumen around the other. It does not use
    excursions beside wide lumen. The second value is True (n,) for points of the remaining excursions; it is None if
    all excursions remain.
    """
    every = np.concatenate([points, *(one.way for one in excursions)])
    inside = airways.tracker.inside(every)
    reach = np.where(inside, LUMEN_SHARE * airways.tracker.core.radius_mm(every), 0.0)
    distance = np.linalg.norm(every[:, None] - every[None], axis=2)
    is_linked = (distance <= np.maximum(reach[:, None], reach[None])) & inside[:, None] & inside[None]
    along_path = np.ones(len(points) - 1, dtype=bool)
    ways = len(points)
    for one in excursions:
        along_path[one.leaves_at : one.returns_at] = not one.is_beside_wide_lumen
        end = ways + len(one.way) - 1
        is_linked[np.arange(ways, end), np.arange(ways + 1, end + 1)] = True
        is_linked[one.leaves_at, ways] = is_linked[end, one.returns_at] = True
        ways = end + 1
    before = np.flatnonzero(along_path)
    is_linked[before, before + 1] = True
    chain = shortest_path(np.where(is_linked | is_linked.T, distance, np.inf), len(points) - 1)
    replaced = [one for one in excursions if one.leaves_at + 1 not in chain]
    if not replaced:
        return points, None
    may_leave = ~inside & (np.arange(len(every)) < len(points))
    for one in replaced:
        may_leave[one.leaves_at : one.returns_at + 1] = False
    return every[chain], may_leave[chain]


def shortest_path(lengths: NDArray[np.float64], target: int) -> list[int]:
    """Return the shortest path from node 0 to a target by Dijkstra's algorithm on a matrix (n, n) of edge lengths."""
    best = np.full(len(lengths), np.inf)
    best[0] = 0.0
    previous = np.zeros(len(lengths), dtype=np.intp)
    is_open = np.ones(len(lengths), dtype=bool)
    node = 0
    while node != target:
        is_open[node] = False
        shorter = is_open & (best[node] + lengths[node] < best)
        best[shorter] = best[node] + lengths[node][shorter]
        previous[shorter] = node
        node = int(np.where(is_open, best, np.inf).argmin())
        assert np.isfinite(best[node])
    path = [target]
    while path[-1] != 0:
        path.append(int(previous[path[-1]]))
    return path[::-1]
