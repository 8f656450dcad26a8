"""True airways with which a found lumen is compared: the axes of a phantom, or the skeleton of a mask."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.volume import Volume

__all__ = ["SPUR_MM", "TrueBranch", "Truth", "sampled", "truth_of_mask", "truth_of_phantom"]

Points = NDArray[np.float64]

SPUR_MM = 5.0
"""Maximum length in mm of a side branch of a skeleton that is a spur (an artefact of the mask's surface)."""
SAMPLE_MM = 0.25
"""Maximum distance between two points of a true centreline, mm."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueBranch:
    """True centreline between two forks, or between a fork and a tip."""

    points: Points
    """Points (n, 3) of the branch's centreline, LPS mm, at most 0.25 mm apart."""
    radius_mm: NDArray[np.float64]
    """Radius (n,) of the true lumen at each point, mm."""
    generation: int
    parent: int | None = None
    """Index of the parent branch in the skeleton; None for the first branches and for a phantom's."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """True airways of a case: branches, and voxels of the lumen."""

    lumen_zyx: NDArray[np.bool_]
    branches: tuple[TrueBranch, ...]
    knows_radius: bool
    """Whether the radii are exact, as in a painted CT; otherwise they were measured in a mask."""
    touched_zyx: NDArray[np.bool_] | None = None
    """Voxels (nz, ny, nx) that contain any lumen; None if unknown. A found voxel among them is not false."""


def sampled(points: Points, radius_mm: NDArray[np.float64]) -> tuple[Points, NDArray[np.float64]]:
    """Return a line and its radii, resampled at even steps of at most 0.25 mm."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(int(np.ceil(along[-1] / SAMPLE_MM)) + 1, 2))
    even = np.stack([np.interp(at, along, points[:, axis]) for axis in range(3)], axis=1)
    return even, np.interp(at, along, radius_mm)


def truth_of_phantom(truth: dict[str, Any], lumen_zyx: NDArray[np.uint8], volume: Volume) -> Truth:
    """Return the parts of a phantom's axes inside the volume as the truth of a case."""
    branches = []
    for row in truth["branches"]:
        points, radius = sampled(np.array(row["points"]), np.array(row["radius"]))
        inside = np.array([volume.contains_lps(point) for point in points])
        if inside.sum() >= 2:
            branches.append(TrueBranch(points[inside], radius[inside], row["generation"]))
    return Truth(lumen_zyx != 0, tuple(branches), knows_radius=True)


def truth_of_mask(mask_zyx: NDArray[np.bool_], volume: Volume) -> Truth:
    """Return the reference tree of an airway mask: the skeleton of its largest component, rooted at the top.

    The skeleton (scikit-image) loses its spurs, which are short side branches caused by rough surfaces. A hole in the
    mask of a tube makes a loop in the skeleton; the loop is cut at the point that is farthest from the top along
    both sides.
    """
    measure: Any = importlib.import_module("skimage.measure")
    morphology: Any = importlib.import_module("skimage.morphology")
    ndimage: Any = importlib.import_module("scipy.ndimage")
    labels, count = measure.label(mask_zyx, connectivity=3, return_num=True)
    if count > 1:
        mask_zyx = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    del labels
    box = ndimage.find_objects(mask_zyx.astype(np.uint8))[0]
    part = np.pad(mask_zyx[box], 1)
    first_ijk = np.array([axis.start - 1 for axis in box])[::-1]
    voxels = np.argwhere(morphology.skeletonize(part))
    sampling = np.array(volume.spacing_mm)[::-1]
    depth = ndimage.distance_transform_edt(part, sampling=sampling)
    # Half a voxel is subtracted, because the lumen ends between the last voxel inside and the first voxel outside.
    radius = depth[tuple(voxels.T)] - 0.5 * float(np.cbrt(np.prod(sampling)))
    points = volume.to_lps((voxels[:, ::-1] + first_ijk).astype(np.float64))
    parents, order = _tree(voxels, points)
    remaining = _without_spurs(parents, order, points)
    return Truth(mask_zyx, tuple(_branches(parents, order, remaining, points, radius)), knows_radius=False)


def _tree(voxels: NDArray[np.int64], points: Points) -> tuple[NDArray[np.int64], list[int]]:
    """Return each skeleton voxel's predecessor on its path from the top, and the voxels in an order with parents first.

    The predecessor is -1 if there is none.
    """
    sparse: Any = importlib.import_module("scipy.sparse")
    graphs: Any = importlib.import_module("scipy.sparse.csgraph")
    shape = voxels.max(axis=0) + 2
    key = np.ravel_multi_index(tuple(voxels.T), tuple(shape))
    by_key = np.argsort(key)
    rows, columns = [], []
    offsets = [(dz, dy, dx) for dz in (-1, 0, 1) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dz, dy, dx) > (0, 0, 0)]
    for offset in offsets:
        moved = voxels + np.array(offset)
        inside = ((moved >= 0) & (moved < shape)).all(axis=1)
        there = np.ravel_multi_index(tuple(np.clip(moved, 0, shape - 1).T), tuple(shape))
        at = np.clip(np.searchsorted(key, there, sorter=by_key), 0, len(key) - 1)
        hit = inside & (key[by_key[at]] == there)
        rows.append(np.flatnonzero(hit))
        columns.append(by_key[at[hit]])
    row, column = np.concatenate(rows), np.concatenate(columns)
    length = np.linalg.norm(points[row] - points[column], axis=1)
    graph = sparse.coo_matrix((length, (row, column)), shape=(len(voxels),) * 2).tocsr()
    tree = graphs.minimum_spanning_tree(graph)
    top = int(np.argmax(points[:, 2]))
    order, parents = graphs.breadth_first_order(tree, top, directed=False)
    parents = np.where(parents < 0, -1, parents).astype(np.int64)
    return parents, [int(node) for node in order]


def _without_spurs(parents: NDArray[np.int64], order: Sequence[int], points: Points) -> NDArray[np.bool_]:
    """Return for each voxel whether it remains after spurs are removed.

    Ends shorter than :data:`SPUR_MM` are removed, the shortest first.
    """
    remaining = np.zeros(len(parents), dtype=np.bool_)
    remaining[list(order)] = True
    children = np.zeros(len(parents), dtype=np.int64)
    for node in order:
        if parents[node] >= 0:
            children[parents[node]] += 1
    while True:
        shortest: tuple[float, list[int]] | None = None
        for tip in np.flatnonzero(remaining & (children == 0)):
            end, length = [int(tip)], 0.0
            while parents[end[-1]] >= 0 and length < SPUR_MM:
                before = int(parents[end[-1]])
                length += float(np.linalg.norm(points[end[-1]] - points[before]))
                if children[before] > 1:
                    break
                end.append(before)
            if parents[end[-1]] >= 0 and length < SPUR_MM and (shortest is None or length < shortest[0]):
                shortest = (length, end)
        if shortest is None:
            return remaining
        remaining[shortest[1]] = False
        children[parents[shortest[1][-1]]] -= 1


def _branches(
    parents: NDArray[np.int64],
    order: Sequence[int],
    remaining: NDArray[np.bool_],
    points: Points,
    radius: NDArray[np.float64],
) -> list[TrueBranch]:
    children: dict[int, list[int]] = {}
    for node in order:
        if remaining[node] and parents[node] >= 0:
            children.setdefault(int(parents[node]), []).append(node)
    found: list[TrueBranch] = []
    waiting: list[tuple[int, list[int], int, int | None]] = [(order[0], children.get(order[0], []), 0, None)]
    while waiting:
        start, firsts, generation, parent = waiting.pop()
        for first in firsts:
            way = [start, first]
            while len(children.get(way[-1], [])) == 1:
                way.append(children[way[-1]][0])
            even, radii = sampled(points[way], radius[way])
            found.append(TrueBranch(even, radii, generation, parent))
            waiting.append((way[-1], children.get(way[-1], []), generation + 1, len(found) - 1))
    return found
