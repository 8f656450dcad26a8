"""Shares of lung points and of airway points that a click of *Add branch* accepts as airways."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.track import Airways, branch_way, find_airways
from carina.track.edit.tree_changes import along_mm
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Volume

__all__ = ["lung_points", "missed_points", "removed_branches", "shows_lumen", "taken"]

Points = NDArray[np.float64]

CLEAR_MM = 5.0
"""Minimum distance in mm from every airway of a point that counts as lung without airways."""
FARTHEST_MM = 40.0
"""Maximum distance in mm from the airway tree of the lung points that are used."""
MISSED_MM = 3.0
"""Minimum distance in mm of a missed airway's point from the lumen that was found."""
SURE = 0.95
"""Minimum confidence of a branch that counts as a true airway."""
SIDES, SEEN_MM, OPEN_SHARE, SEEN_NOISE = 16, 3.0, 0.2, 3.0
"""Condition of a visible lumen, see :func:`shows_lumen`.

In order: number of sides in a plane; distance within which the values rise, mm; share of sides that need not rise;
least rise as a multiple of the standard deviation of the noise.
"""
LUNG_HU, OUTSIDE_HU = -650.0, -988.0
"""Limits of the CT values in HU: maximum of lung, and maximum of the air outside the patient."""


def lung_points(volume: Volume, airways: Airways, truth_zyx: NDArray[np.uint8], num: int, seed: int) -> Points:
    """Return (num, 3) random points in lung without airways, LPS mm.

    The points are more than 5 mm from every airway and at most 40 mm from the airway tree.

    Parameters
    ----------
    truth_zyx
        (nz, ny, nx) not 0 in true airways. Found airways are avoided as well.
    num
        Number of points.
    seed
        Seed of the random generator.
    """
    rng = np.random.default_rng(seed)
    tree = np.concatenate([b.points for b in airways.tree.branches if b.generation >= 2])
    known = (truth_zyx != 0) | (airways.lumen_zyx != 0)
    shape = np.array(volume.shape_zyx[::-1])
    found: list[Points] = []
    while len(found) < num:
        direction = rng.normal(size=3)
        reach_mm = rng.uniform(CLEAR_MM, FARTHEST_MM)
        place = tree[rng.integers(len(tree))] + reach_mm * direction / np.linalg.norm(direction)
        voxel = np.floor(volume.to_ijk(place) + 0.5).astype(int)
        if (voxel < 0).any() or (voxel >= shape).any():
            continue
        values, off_mm, _ = _round(volume, voxel, volume.hu_zyx, 4.0)
        near = off_mm <= 2.5
        if not OUTSIDE_HU < values[near].mean() < LUNG_HU or values[off_mm == 0.0][0] > LUNG_HU:
            continue
        airway, off_mm, _ = _round(volume, voxel, known, CLEAR_MM + 2.0)
        if (airway & (off_mm <= CLEAR_MM)).any():
            continue
        found.append(volume.to_lps(voxel.astype(np.float64)))
    return np.array(found)


def removed_branches(volume: Volume, airways: Airways, num: int, seed: int, *, whole: bool) -> tuple[Airways, Points]:
    """Return airways of a mask from which branches were removed, and points (num, 3), LPS mm, in these branches.

    Parameters
    ----------
    whole
        True removes segmental bronchi with all their descendants; False removes single tips.
    """
    rng = np.random.default_rng(seed)
    tree = airways.tree
    if whole:
        stems = [b for b in tree.branches if b.children and 3 <= b.generation <= 4]
        stems = [stems[n] for n in rng.permutation(len(stems))[: max(3, len(stems) // 4)]]
    else:
        stems = [b for b in tree.tips() if b.generation >= 2 and b.length_mm >= 4.0 and (b.confidence or 1.0) >= SURE]
        stems = [stems[n] for n in rng.permutation(len(stems))[: max(3, (3 * len(stems)) // 4)]]
    removed: dict[int, Branch] = {}
    for stem in stems:
        below = [stem]
        for branch in below:
            below.extend(tree.branch(child) for child in branch.children)
        removed.update({branch.id: branch for branch in below})
    points = np.concatenate([b.points for b in tree.branches])
    radius = np.concatenate([b.radius for b in tree.branches])
    owner = np.concatenate([np.full(len(b.points), b.id) for b in tree.branches])
    mask = airways.lumen_zyx.copy()
    voxels = np.argwhere(mask)[:, ::-1]
    centres = volume.to_lps(voxels.astype(np.float64))
    is_removed = np.zeros(len(voxels), dtype=bool)
    wanted = np.array(sorted(removed))
    for first in range(0, len(voxels), 4000):
        part = slice(first, first + 4000)
        off = np.sqrt(sum((centres[part, None, a] - points[None, :, a]) ** 2 for a in range(3))) - radius[None]
        is_removed[part] = np.isin(owner[off.argmin(axis=1)], wanted)
    i, j, k = voxels[is_removed].T
    mask[k, j, i] = 0
    opened = find_airways(volume, lumen_zyx=mask, root_lps=airways.root_lps)
    # A branch of low confidence may not be an airway, so no point is drawn in it.
    branches = [b for b in removed.values() if b.confidence is None or b.confidence >= SURE]
    places = []
    for _ in range(num):
        branch = branches[rng.integers(len(branches))]
        along = along_mm(branch.points)
        at = rng.uniform(0.3, 1.0) * along[-1]
        places.append([np.interp(at, along, branch.points[:, axis]) for axis in range(3)])
    return opened, np.array(places)


def missed_points(volume: Volume, airways: Airways, truth_zyx: NDArray[np.uint8], num: int, seed: int) -> Points:
    """Return at most (num, 3) points, LPS mm, in the middle of true airways, with no lumen found within 3 mm of them.

    In thick slices the mask of an oblique airway extends beyond its lumen by a slice or two, so a point of the mask
    need not be visible as a lumen: see :func:`shows_lumen`.
    """
    rng = np.random.default_rng(seed)
    truth = truth_zyx != 0
    voxels = np.argwhere(truth & (airways.lumen_zyx == 0))[:, ::-1]
    found: list[Points] = []
    for n in rng.permutation(len(voxels)):
        voxel = voxels[n]
        is_truth, off_mm, around = _round(volume, voxel, truth, 2.0)
        near = around[is_truth & (off_mm <= 2.0)]
        middle = near[np.argmin(np.linalg.norm(volume.to_lps(near) - volume.to_lps(near).mean(axis=0), axis=1))]
        x, y, z = (float(v) for v in volume.to_lps(middle))
        # The search does not cover the part of a mask above the top of the trachea, so its points are not missed
        # airways.
        if z < airways.root_lps[2] and airways.tracker.core.nearest((x, y, z), MISSED_MM) is None:
            found.append(np.array([x, y, z]))
        if len(found) == num:
            break
    return np.array(found).reshape(-1, 3)


def shows_lumen(volume: Volume, points: Points, noise_hu: float) -> NDArray[np.bool_]:
    """Return for each (n, 3) point, LPS mm, whether the CT is darker there than around it, as in a visible lumen.

    The condition: in one of 13 planes through the point the values rise by three times the noise within 3 mm on four
    fifths of 16 sides. Values are those of the CT, averaged over 2 mm across the plane. 2 to 3 % of random points of
    lung meet the condition.

    Parameters
    ----------
    noise_hu
        Standard deviation of the CT values in air, HU.

    Returns
    -------
    NDArray[np.bool_]
        (n,) True where a lumen is visible.
    """
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    found = np.full(len(points), -np.inf)
    for axis in np.array(list(np.ndindex(3, 3, 3)))[14:] - 1.0:
        normal = axis / np.linalg.norm(axis)
        across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        across /= np.linalg.norm(across)
        sides = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(normal, across)
        off = sides[:, None, :] * np.arange(0.0, SEEN_MM + 0.1, 0.5)[None, :, None]
        places = points[:, None, None, :] + off
        values = np.mean([_values_at(volume, places + shift * normal) for shift in (-1.0, 0.0, 1.0)], axis=0)
        rise = np.quantile(values.max(axis=2), OPEN_SHARE, axis=1) - values[:, 0, 0]
        found = np.maximum(found, rise)
    return np.asarray(found >= SEEN_NOISE * noise_hu)


def taken(volume: Volume, airways: Airways, points: Points) -> NDArray[np.int8]:
    """Return the result of a click of *Add branch* at each of (n, 3) points, LPS mm.

    Returns
    -------
    NDArray[np.int8]
        (n,) 1 if the click is accepted, 0 if it is questioned or refused, -1 if the point is already in the tree.
    """
    found = np.zeros(len(points), dtype=np.int8)
    for number, point in enumerate(points):
        way = branch_way(volume, airways, point)
        is_there = way.problem is not None and "there already" in way.problem
        found[number] = -1 if is_there else int(way.has_evidence)
    return found


def _values_at(volume: Volume, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the CT in HU at points (..., 3), LPS mm, by trilinear interpolation, clamped at the volume's edges."""
    last = np.array(volume.shape_zyx[::-1]) - 1
    ijk = np.clip(volume.to_ijk(places.reshape(-1, 3)), 0, last)
    low = np.minimum(ijk.astype(np.int64), last - 1)
    share = ijk - low
    total = np.zeros(len(ijk))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(np.array(corner) == 1, share, 1.0 - share).prod(axis=1)
        i, j, k = (low + np.array(corner)).T
        total += weight * volume.hu_zyx[k, j, i]
    return total.reshape(places.shape[:-1])


def _round(
    volume: Volume, voxel: NDArray[np.int64], values: NDArray[Any], reach_mm: float
) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[np.float64]]:
    """Return the values in a box round a voxel, the distances from the voxel in mm, and the indices (i, j, k)."""
    reach = np.ceil(reach_mm / np.array(volume.spacing_mm)).astype(int)
    shape = np.array(volume.shape_zyx[::-1])
    low, high = np.maximum(voxel - reach, 0), np.minimum(voxel + reach, shape - 1)
    k, j, i = np.mgrid[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1].reshape(3, -1)
    around = np.stack([i, j, k], axis=1)
    off_mm = np.linalg.norm((around - voxel) @ volume.lps_from_ijk[:3, :3].T, axis=1)
    return values[k, j, i], off_mm, around.astype(np.float64)
