"""Detection of vessels too thin for a threshold, by their shape, and the tree of all vessels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.cubic_box import Box, smoothed
from carina.volume.front_times import arrival_times
from carina.volume.mask_distances import ball_distance
from carina.volume.mask_parts import numbered_parts

Mask = NDArray[np.bool_]
Values = NDArray[np.float32]

THIN_SIGMA_MM = 0.7
"""Standard deviation in mm of the Gaussian that smooths the CT before the curvature is computed."""
RISE_HU = 60.0
"""Minimum rise in HU of a vessel above the density of lung, after smoothing by 0.5 mm."""
MIN_HU = 40.0
"""Curvature in HU (second derivative times sigma squared) across a line below which it is not a vessel."""
TIMES_NOISE = 5.0
"""Minimum curvature across a vessel, as a multiple of the curvature that noise causes."""
MIN_LENGTH_MM = 3.0
"""Minimum length in mm of a connected piece of a thin vessel; shorter pieces are noise."""
SLAB = 48
"""Number of slices processed together; it limits the memory for whole lungs."""
SPUR_MM = 2.0
"""Minimum length in mm of a vessel branch beyond the surface of its parent; a shorter one is a bump of the parent."""
MAX_BRANCHES = 4000
REPORT_INTERVAL = 20_000
"""Number of processed voxels after which progress is reported."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class VesselBranch:
    """Part of a vessel between two divisions, from its parent to its end."""

    points_lps: NDArray[np.float64]
    """(n, 3) smoothed centreline of the branch in LPS mm, from its wide end."""
    radius_mm: NDArray[np.float64]
    """(n,) radius in mm of the largest ball inside the segmented vessel.

    A vessel thinner than the CT resolves appears about 0.7 mm wide.
    """
    parent: int | None
    """Index of the parent branch in the tree; None for the first branch of a connected piece."""
    sure: float
    """Median confidence of the branch's voxels, 0 to 1."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class VesselTree:
    """Vessels as lines with radii; arteries and veins are not distinguished, and where they touch they form one tree.

    Vessels of the mediastinum are not visible without contrast and are not included.
    """

    branches: tuple[VesselBranch, ...] = field(repr=False)
    """Branches of the tree; parents precede their children."""
    is_whole: bool = True
    """Whether the tree contains all branches; False if the box has more than `MAX_BRANCHES`, which limits the tree."""

    @property
    def length_mm(self) -> float:
        """Total length of all branches, mm."""
        return sum(float(np.linalg.norm(np.diff(b.points_lps, axis=0), axis=1).sum()) for b in self.branches)


def thin_vessels(
    box: Box, lung_hu: float, clear: Mask, *, on_progress: Callable[[float], None] | None = None
) -> tuple[Mask, Values]:
    """Return the mask of the voxels of thin bright lines (vessels), and the confidence of each voxel.

    The curvature of a line is negative in two directions across it and small along it. A plate (a fissure, the pleura)
    has one such direction, and a wall of a lumen has two unequal ones.

    Parameters
    ----------
    box
        Part of the CT.
    lung_hu
        Density of the lung, HU.
    clear
        (nz, ny, nx) mask of possible vessels: away from airways' walls, the nodule and thick tissue.
    on_progress
        Receives the completed fraction; it may raise CancelledError.

    Returns
    -------
    mask, sure
        (nz, ny, nx) mask, and float32 confidence: 0.5 at the threshold, up to 1 with increasing curvature; 0 outside.
    """
    soft = smoothed(box.hu_zyx, 0.5 / box.step_mm)
    inner = box.known & clear
    rises = inner & (soft > lung_hu + RISE_HU)
    plain = inner & (soft < lung_hu + RISE_HU) & (soft > lung_hu - 150.0)
    if on_progress is not None:
        on_progress(0.3)
    curved, noise = _line_strength(box, rises, plain)
    least = max(MIN_HU, TIMES_NOISE * noise)
    mask = _long_pieces(curved > least, box.step_mm)
    sure = np.where(mask, 1.0 - 0.5 * np.exp(-3.0 * (curved / least - 1.0)), 0.0).astype(np.float32)
    return mask, sure


def _line_strength(box: Box, rises: Mask, plain: Mask) -> tuple[Values, float]:
    """Return the curvature across bright lines, and the spread of the curvature in plain lung."""
    values = smoothed(box.hu_zyx, THIN_SIGMA_MM / box.step_mm)
    scale = np.float32((THIN_SIGMA_MM / box.step_mm) ** 2)
    found = np.zeros(values.shape, dtype=np.float32)
    noise = []
    num = values.shape[0]
    for first in range(0, num, SLAB):
        last = min(first + SLAB, num)
        part = slice(first, last)
        wide = values[max(first - 1, 0) : min(last + 1, num)]
        pad = (int(first == 0), int(last == num))
        second = second_differences(np.pad(wide, (pad, (1, 1), (1, 1)), mode="edge"))
        _, middle, last_one = eigenvalues([one[rises[part]] for one in second])
        found[part][rises[part]] = scale * (np.maximum(-middle, 0.0) - np.abs(last_one))
        some = np.flatnonzero(plain[part])[::23]
        _, middle, _ = eigenvalues([one.reshape(-1)[some] for one in second])
        noise.append(scale * middle)
    spread = np.concatenate(noise)
    if spread.size < 200:
        return found, MIN_HU / TIMES_NOISE
    return found, 1.4826 * float(np.median(np.abs(spread - np.median(spread))))


def second_differences(padded: Values) -> list[Values]:
    """Return the second differences zz, yy, xx, zy, zx, yx of all but the outermost voxels, per voxel squared."""
    num = tuple(n - 2 for n in padded.shape)

    def at(z: int, y: int, x: int) -> Values:
        return padded[1 + z : 1 + z + num[0], 1 + y : 1 + y + num[1], 1 + x : 1 + x + num[2]]

    twice = 2.0 * at(0, 0, 0)
    return [
        at(1, 0, 0) + at(-1, 0, 0) - twice,
        at(0, 1, 0) + at(0, -1, 0) - twice,
        at(0, 0, 1) + at(0, 0, -1) - twice,
        0.25 * (at(1, 1, 0) + at(-1, -1, 0) - at(1, -1, 0) - at(-1, 1, 0)),
        0.25 * (at(1, 0, 1) + at(-1, 0, -1) - at(1, 0, -1) - at(-1, 0, 1)),
        0.25 * (at(0, 1, 1) + at(0, -1, -1) - at(0, 1, -1) - at(0, -1, 1)),
    ]


def eigenvalues(second: list[Values]) -> tuple[Values, Values, Values]:
    """Return the eigenvalues of symmetric 3x3 matrices, in ascending order (Smith, CACM 4 (1961) 168).

    Parameters
    ----------
    second
        Matrix elements zz, yy, xx, zy, zx, yx, (n,) each.
    """
    a, b, c, d, e, f = second
    mean = (a + b + c) / 3.0
    square = (a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * (d * d + e * e + f * f)
    # Adding 1e-6 instead of taking the maximum would change equal eigenvalues by its square root.
    spread = np.maximum(np.sqrt(square / 6.0), 1e-6)
    a, b, c, d, e, f = (a - mean) / spread, (b - mean) / spread, (c - mean) / spread, d / spread, e / spread, f / spread
    half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
    turn = np.arccos(np.clip(half, -1.0, 1.0)) / 3.0
    most = mean + 2.0 * spread * np.cos(turn)
    least = mean + 2.0 * spread * np.cos(turn + 2.0 * np.pi / 3.0)
    return least, 3.0 * mean - least - most, most


def _long_pieces(mask: Mask, step_mm: float) -> Mask:
    """Return the pieces of a mask whose bounding box has a diagonal of at least `MIN_LENGTH_MM`."""
    labels = numbered_parts(mask, corners=True)
    at = np.nonzero(labels)
    of = labels[at]
    num = int(labels.max()) + 1
    square = np.zeros(num)
    for axis in at:
        low, high = np.full(num, np.iinfo(np.int64).max), np.zeros(num, dtype=np.int64)
        np.minimum.at(low, of, axis)
        np.maximum.at(high, of, axis)
        square += np.maximum(high - low + 1, 0) ** 2.0 * (low <= high)
    keep = np.sqrt(square) * step_mm >= MIN_LENGTH_MM
    keep[0] = False
    found: Mask = keep[labels]
    return found


def grow_tree(
    box: Box, vessel: Mask, sure: Values, *, on_progress: Callable[[float], None] | None = None
) -> VesselTree:
    """Return the vessels of a box as a tree of centrelines, from the widest place of each piece to its ends.

    Parameters
    ----------
    box
        Box of the masks.
    vessel, sure
        (nz, ny, nx) mask of the vessels, and their confidence.
    on_progress
        Receives the completed fraction; it may raise CancelledError.
    """
    if not vessel.any():
        return VesselTree(())
    depth = ball_distance(vessel, box.step_mm)
    # Pieces are connected by faces, because the fast-marching front also spreads across faces.
    labels = numbered_parts(vessel)
    arrival = _arrival(vessel, depth, labels)
    owner = np.full(vessel.shape, -1, dtype=np.int32)
    order = np.flatnonzero(vessel)
    order = order[np.argsort(-arrival.reshape(-1)[order], kind="stable")]
    branches: list[VesselBranch] = []
    ways: list[NDArray[np.intp]] = []
    whole = True
    for num, start in enumerate(order):
        if on_progress is not None and num % REPORT_INTERVAL == 0:
            on_progress(num / len(order))
        if owner.reshape(-1)[start] >= 0:
            continue
        if len(branches) >= MAX_BRANCHES:
            whole = False
            break
        way, parent = _downhill(np.array(np.unravel_index(int(start), vessel.shape)), arrival, owner)
        # The path of voxels deviates from the middle, so the radius is taken from the deepest neighbour.
        radius = _deepest(depth, way)
        if parent is not None:
            # The branch begins on the centreline of its parent, not at the surface of the parent.
            joint = ways[parent][((ways[parent] - way[0]) ** 2).sum(axis=1).argmin()]
            length = _length(way) * box.step_mm
            way = np.concatenate([joint[None], way])
        elif _length(way) * box.step_mm < SPUR_MM:
            continue
        radius = _deepest(depth, way)
        number = len(branches) if parent is None or length >= SPUR_MM else parent
        _cover(owner, way, 1.3 * radius / box.step_mm + 1.0, number, vessel)
        if number == len(branches):
            points = _evened(way[:, ::-1] * box.step_mm + box.lps_from_ijk[:3, 3])
            branches.append(VesselBranch(points, radius, parent, float(np.median(sure[tuple(way.T)]))))
            ways.append(way)
    return VesselTree(tuple(branches), whole)


def _arrival(vessel: Mask, depth: Values, labels: NDArray[Any]) -> Values:
    """Return for each voxel the time at which a front from the vessel piece's widest voxel arrives; infinite outside.

    The front is faster in the middle of a vessel.
    """
    flat, of = depth.reshape(-1), labels.reshape(-1)
    inside = np.flatnonzero(of)
    widest = inside[np.lexsort((flat[inside], of[inside]))]
    last = np.flatnonzero(np.diff(of[widest], append=-1) != 0)
    seeds = np.array(np.unravel_index(widest[last], vessel.shape)).T
    speed = np.where(vessel, depth * depth, 0.0).astype(np.float32)
    return arrival_times(speed, seeds)


_AROUND = np.array([(z, y, x) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1) if z or y or x])


def _downhill(at: NDArray[np.intp], arrival: Values, owner: NDArray[np.int32]) -> tuple[NDArray[np.intp], int | None]:
    """Return the path of voxels from a branch already in the tree, or from the front's start, to a voxel.

    The second value is the index of that branch, or None at the start of the front.
    """
    way = [at]
    top = np.array(arrival.shape) - 1
    while True:
        near = np.clip(at + _AROUND, 0, top)
        times = arrival[tuple(near.T)]
        best = int(np.argmin(times))
        if times[best] >= arrival[tuple(at)]:
            return np.array(way[::-1]), None
        at = near[best]
        way.append(at)
        known = int(owner[tuple(at)])
        if known >= 0:
            return np.array(way[::-1]), known


def _deepest(depth: Values, way: NDArray[np.intp]) -> NDArray[np.float64]:
    near = np.clip(way[:, None] + np.concatenate([_AROUND, [[0, 0, 0]]]), 0, np.array(depth.shape) - 1)
    deepest: NDArray[np.float64] = depth[tuple(np.moveaxis(near, -1, 0))].max(axis=1).astype(np.float64)
    return deepest


def _length(way: NDArray[np.intp]) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def _cover(
    owner: NDArray[np.int32], way: NDArray[np.intp], reach: NDArray[np.float64], number: int, vessel: Mask
) -> None:
    """Assign to a branch those voxels round its path that belong to no other branch, in place."""
    shape = np.array(vessel.shape)
    for at, far in zip(way, reach, strict=True):
        whole = int(np.ceil(far))
        low, high = np.maximum(at - whole, 0), np.minimum(at + whole + 1, shape)
        z, y, x = ((np.arange(a, b) - k) ** 2.0 for a, b, k in zip(low, high, at, strict=True))
        ball = z[:, None, None] + y[None, :, None] + x[None, None, :] <= far * far
        part = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        own = owner[part]
        own[ball & vessel[part] & (own < 0)] = number


def _evened(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a line with its voxel steps smoothed and its ends unchanged."""
    out = points
    for _ in range(2):
        if len(out) > 2:
            out = np.concatenate([out[:1], 0.25 * out[:-2] + 0.5 * out[1:-1] + 0.25 * out[2:], out[-1:]])
    return out
