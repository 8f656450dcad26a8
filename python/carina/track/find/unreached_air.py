"""Islands of air in the chest that no path from the trachea reaches, and their ends."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import find_pieces_of_air
from carina.volume.model import Volume

Points = NDArray[np.float64]
Ints = NDArray[np.int64]

ROUND_TREE_MM = 30.0
"""Margin in mm round the bounding box of the tree in which islands of air are searched; air beyond it is not listed."""
MIN_MM3 = 15.0
MIN_VOXELS = 8
MIN_LONG_MM = 6.0
MAX_MM3 = 60_000.0
"""Maximum volume in mm3 of an island of air; larger air is not airway.

All airways beyond a main bronchus are smaller; the stomach, air outside the body and large bullae are larger.
"""
MAX_ISLANDS = 80
MAX_ENDS = 12
DARK_NEIGHBOURS = 3
"""Minimum number of air voxels among the six neighbours of an air voxel; a voxel with fewer counts as noise."""
MAX_DARK = 4_000_000
"""Maximum number of dark voxels; with more, the lung is emphysematous and islands cannot be distinguished."""
CELL_MM = 2.0
"""Minimum edge length in mm of the cells between which paths inside an island run; at least one voxel."""
AXIS_MM, ONWARD_MM = 3.0, 9.0
"""Lengths in mm of two successive pieces of an island at its end; the axis joins their centres.

The first stretch is at least one radius long. The second is long enough to contain both of two branches, whose
common centre is on the axis of their trunk.
"""


@dataclass(frozen=True, slots=True, eq=False)
class IslandEnd:
    """End of an island of air: position, direction and radius."""

    axis_lps: Points
    """Point (3,) on the axis just inside the end, LPS in mm."""
    outward: Points
    """Unit vector (3,) that points out of the island, LPS."""
    radius_mm: float
    """Radius of the island near the end in mm, calculated from the number of voxels there."""


@dataclass(frozen=True, slots=True, eq=False)
class Island:
    """Connected piece of air that does not touch the found lumen (an island)."""

    points_lps: Points
    """Centres (n, 3) of the island's voxels, LPS in mm."""
    ends: tuple[IslandEnd, ...]
    """Ends of the island."""


def find_islands(volume: Volume, lumen_zyx: NDArray[np.uint8], tree_lps: Points, darkest: float) -> list[Island]:
    """Find connected voxels at most as bright as ``darkest`` that do not touch the lumen; the largest piece first.

    Parameters
    ----------
    volume
        The CT.
    lumen_zyx
        (nz, ny, nx), nonzero inside the found airways.
    tree_lps
        (n, 3) points of the centrelines of the tree, LPS in mm. Pieces are searched in their bounding box and 30 mm
        round it.
    darkest
        Largest voxel value that counts as air, in the unit of the volume (HU for a CT in HU).
    """
    voxel_mm3 = abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3])))
    pieces = find_pieces_of_air(
        volume.hu_zyx,
        lumen_zyx,
        darkest=math.floor(darkest),
        box_ijk=_box(volume, tree_lps),
        least_neighbours=DARK_NEIGHBOURS,
        voxels=(math.ceil(max(MIN_VOXELS, MIN_MM3 / voxel_mm3)), math.floor(MAX_MM3 / voxel_mm3)),
        most_air=MAX_DARK,
    )
    found: list[Island] = []
    for flat in pieces:
        k, j, i = np.unravel_index(flat, volume.shape_zyx)
        ijk = np.stack([i, j, k], axis=1)
        points = volume.to_lps(ijk.astype(np.float64))
        if float(np.linalg.norm(np.ptp(points, axis=0))) < MIN_LONG_MM:
            continue
        found.append(Island(points, _ends(points, _edges(flat, ijk, volume), max(volume.spacing_mm), voxel_mm3)))
        if len(found) == MAX_ISLANDS:
            break
    return found


def _box(volume: Volume, tree_lps: Points) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """Return the first voxel (i, j, k) of the searched box and the first voxel beyond it."""
    ijk = volume.to_ijk(tree_lps)
    reach = ROUND_TREE_MM / np.array(volume.spacing_mm)
    last = np.array(volume.shape_zyx[::-1]) - 1
    low = np.clip(np.floor(ijk.min(axis=0) - reach), 0, last).astype(np.int64)
    high = np.clip(np.ceil(ijk.max(axis=0) + reach), 0, last).astype(np.int64) + 1
    return (int(low[0]), int(low[1]), int(low[2])), (int(high[0]), int(high[1]), int(high[2]))


def _edges(flat: Ints, ijk: Ints, volume: Volume) -> Ints:
    """Return (m, 2) index pairs into ``flat`` (sorted voxel indices) of the voxels that share a face."""
    nz, ny, nx = volume.shape_zyx
    pairs = []
    for axis, (stride, size) in enumerate(((1, nx), (nx, ny), (nx * ny, nz))):
        there = np.searchsorted(flat, flat + stride)
        there[there == len(flat)] = 0
        beside = (flat[there] == flat + stride) & (ijk[:, axis] < size - 1)
        pairs.append(np.stack([np.flatnonzero(beside), there[beside]], axis=1))
    return np.concatenate(pairs)


def _ends(points: Points, edges: Ints, coarsest_mm: float, voxel_mm3: float) -> tuple[IslandEnd, ...]:
    """Return the ends of an island: points far from each other along paths inside it."""
    edge_mm = max(CELL_MM, coarsest_mm)
    _, cell = np.unique(np.floor(points / edge_mm).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    num = int(cell.max()) + 1
    counts = np.bincount(cell, minlength=num)
    middles = np.stack([np.bincount(cell, points[:, a], num) / counts for a in range(3)], axis=1)
    pairs = cell[edges]
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    neighbours: list[list[tuple[int, float]]] = [[] for _ in range(num)]
    for a, b in pairs.tolist():
        step_mm = float(np.linalg.norm(middles[a] - middles[b]))
        neighbours[a].append((b, step_mm))
        neighbours[b].append((a, step_mm))
    first = int(np.argmax(_ways_mm(neighbours, 0)))
    chosen = [first]
    nearest = np.full(num, np.inf)
    ends: list[IslandEnd] = []
    for _ in range(MAX_ENDS):
        away = _ways_mm(neighbours, chosen[-1])
        end = _end_at(points, away[cell], voxel_mm3)
        if end is not None:
            ends.append(end)
        nearest = np.minimum(nearest, away)
        farthest = int(np.argmax(nearest))
        if nearest[farthest] < 2.0 * AXIS_MM:
            break
        chosen.append(farthest)
    return tuple(ends)


def _end_at(points: Points, away_mm: Points, voxel_mm3: float) -> IslandEnd | None:
    """Return an end of an island of air, with the axis of the airway there; None if the island is too short.

    The axis is the line through the centres of two parts: the part of the island next to the end, and the next part.
    """
    first = away_mm <= 2.0 * AXIS_MM
    radius_mm = float(np.sqrt(first.sum() * voxel_mm3 / (2.0 * AXIS_MM) / np.pi))
    length_mm = max(AXIS_MM, radius_mm)
    one, other = away_mm <= length_mm, (away_mm > length_mm) & (away_mm <= length_mm + ONWARD_MM)
    if not one.any() or not other.any():
        return None
    near, far = points[one].mean(axis=0), points[other].mean(axis=0)
    off = near - far
    length = float(np.linalg.norm(off))
    return None if length < 0.5 else IslandEnd(near, off / length, radius_mm)


def _ways_mm(neighbours: list[list[tuple[int, float]]], start: int) -> Points:
    """Return the length in mm of the shortest path from a start node to every node of a graph; infinity without one."""
    length = np.full(len(neighbours), np.inf)
    length[start] = 0.0
    waiting = [(0.0, start)]
    while waiting:
        here, at = heapq.heappop(waiting)
        if here > length[at]:
            continue
        for to, step_mm in neighbours[at]:
            if here + step_mm < length[to]:
                length[to] = here + step_mm
                heapq.heappush(waiting, (here + step_mm, to))
    return length
