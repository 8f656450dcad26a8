"""Vessels thinner than what a threshold finds, by their shape; and the tree that vessels form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.box import Box, ball_distance, smoothed

__all__ = ["VesselBranch", "VesselTree", "eigenvalues", "grow_tree", "thin_vessels"]

Mask = NDArray[np.bool_]
Values = NDArray[np.float32]

THIN_SIGMA_MM = 0.7
"""Of the Gaussian whose curvature is looked at; the blur of a CT comes to it."""
RISE_HU = 60.0
"""A vessel stands out of the lung by at least this, smoothed by 0.5 mm."""
LEAST_HU = 40.0
TIMES_NOISE = 5.0
"""Curvature across (HU, times the square of sigma): at least so much, and so many times what noise alone gives."""
LEAST_LENGTH_MM = 3.0
"""A shorter piece is noise."""
SLAB = 48
"""Slices that are looked at together: memory of whole lungs."""
SPUR_MM = 2.0
"""A branch shorter than this beyond what lies round its parent is a bump of it."""
MOST_BRANCHES = 4000
LOOK_EVERY = 20_000
"""Voxels; most of them already belong to a branch."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class VesselBranch:
    """A piece of a vessel from where it leaves another to its end."""

    points_lps: NDArray[np.float64]
    """(n, 3) middle line, from the wide end; voxel centres made smooth."""
    radius_mm: NDArray[np.float64]
    """(n,) largest ball inside what is seen. A vessel thinner than the CT resolves looks about 0.7 mm wide."""
    parent: int | None
    """Place of the branch that it leaves; None where a piece begins."""
    sure: float
    """Median over its voxels of how sure it is that they are vessel, 0 to 1."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class VesselTree:
    """Vessels as lines with radii. Arteries and veins are not told apart; where they touch they are one tree.

    Vessels of the mediastinum are not visible without contrast and are no part of it.
    """

    branches: tuple[VesselBranch, ...] = field(repr=False)
    """Parents come before those that leave them."""
    is_whole: bool = True
    """False where there were more branches than are followed."""

    @property
    def length_mm(self) -> float:
        """Of all branches together."""
        return sum(float(np.linalg.norm(np.diff(b.points_lps, axis=0), axis=1).sum()) for b in self.branches)


def thin_vessels(
    box: Box, lung_hu: float, clear: Mask, *, on_share: Callable[[float], None] | None = None
) -> tuple[Mask, Values]:
    """Voxels of bright lines, and how sure it is of each that it is one.

    A line curves downwards in two directions across and hardly along; a plate (a fissure, the pleura) in one, and a
    wall of a lumen not evenly.

    Parameters
    ----------
    clear
        (nz, ny, nx) where vessels can be: away from airways' walls, the nodule, thick tissue.
    on_share
        Receives the share done; it may raise CancelledError.

    Returns
    -------
    (NDArray, NDArray)
        (nz, ny, nx) mask, and float32 0 to 1: 0.5 at the threshold, by how far the curvature stands above noise.
    """
    soft = smoothed(box.hu_zyx, 0.5 / box.step_mm)
    inner = box.known & clear
    rises = inner & (soft > lung_hu + RISE_HU)
    plain = inner & (soft < lung_hu + RISE_HU) & (soft > lung_hu - 150.0)
    if on_share is not None:
        on_share(0.3)
    curved, noise = _line_strength(box, rises, plain)
    least = max(LEAST_HU, TIMES_NOISE * noise)
    mask = _long_pieces(curved > least, box.step_mm)
    sure = np.where(mask, 1.0 - 0.5 * np.exp(-3.0 * (curved / least - 1.0)), 0.0).astype(np.float32)
    return mask, sure


def _line_strength(box: Box, rises: Mask, plain: Mask) -> tuple[Values, float]:
    """Curvature across where something rises, and its spread in plain lung."""
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
        return found, LEAST_HU / TIMES_NOISE
    return found, 1.4826 * float(np.median(np.abs(spread - np.median(spread))))


def second_differences(padded: Values) -> list[Values]:
    """zz, yy, xx, zy, zx, yx of all but the outermost voxels, per voxel squared."""
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
    """Of symmetric 3x3 matrices given by zz, yy, xx, zy, zx, yx (n,): the least first (Smith, CACM 4 (1961) 168)."""
    a, b, c, d, e, f = second
    mean = (a + b + c) / 3.0
    spread = np.sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * (d * d + e * e + f * f)) / 6.0) + 1e-6
    a, b, c, d, e, f = (a - mean) / spread, (b - mean) / spread, (c - mean) / spread, d / spread, e / spread, f / spread
    half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
    turn = np.arccos(np.clip(half, -1.0, 1.0)) / 3.0
    most = mean + 2.0 * spread * np.cos(turn)
    least = mean + 2.0 * spread * np.cos(turn + 2.0 * np.pi / 3.0)
    return least, 3.0 * mean - least - most, most


def _long_pieces(mask: Mask, step_mm: float) -> Mask:
    """Pieces whose box's diagonal is long enough."""
    import SimpleITK as sitk  # slow to load, and most of what is public here does not need it

    labels: Any = sitk.GetArrayFromImage(sitk.ConnectedComponent(sitk.GetImageFromArray(mask.astype(np.uint8)), True))
    at = np.nonzero(labels)
    of = labels[at]
    num = int(labels.max()) + 1
    square = np.zeros(num)
    for axis in at:
        low, high = np.full(num, np.iinfo(np.int64).max), np.zeros(num, dtype=np.int64)
        np.minimum.at(low, of, axis)
        np.maximum.at(high, of, axis)
        square += np.maximum(high - low + 1, 0) ** 2.0 * (low <= high)
    keep = np.sqrt(square) * step_mm >= LEAST_LENGTH_MM
    keep[0] = False
    found: Mask = keep[labels]
    return found


def grow_tree(box: Box, vessel: Mask, sure: Values, *, on_share: Callable[[float], None] | None = None) -> VesselTree:
    """The vessels of a box as a tree: from each piece's widest place to its far ends, along the middle.

    Parameters
    ----------
    vessel, sure
        (nz, ny, nx) of the box.
    on_share
        Receives the share done; it may raise CancelledError.
    """
    import SimpleITK as sitk  # slow to load, and most of what is public here does not need it

    if not vessel.any():
        return VesselTree(())
    depth = ball_distance(vessel, box.step_mm)
    # By faces, as the front goes.
    labels: Any = sitk.GetArrayFromImage(sitk.ConnectedComponent(sitk.GetImageFromArray(vessel.astype(np.uint8))))
    arrival = _arrival(vessel, depth, labels)
    owner = np.full(vessel.shape, -1, dtype=np.int32)
    order = np.flatnonzero(vessel)
    order = order[np.argsort(-arrival.reshape(-1)[order], kind="stable")]
    branches: list[VesselBranch] = []
    ways: list[NDArray[np.intp]] = []
    whole = True
    for num, start in enumerate(order):
        if on_share is not None and num % LOOK_EVERY == 0:
            on_share(num / len(order))
        if owner.reshape(-1)[start] >= 0:
            continue
        if len(branches) >= MOST_BRANCHES:
            whole = False
            break
        way, parent = _downhill(np.array(np.unravel_index(int(start), vessel.shape)), arrival, owner)
        # A way of voxels wavers about the middle: the deepest place beside it tells the width.
        radius = _deepest(depth, way)
        if parent is not None:
            # From the parent's middle line, not from the edge of what lies round it.
            joint = ways[parent][((ways[parent] - way[0]) ** 2).sum(axis=1).argmin()]
            length = _length(way) * box.step_mm
            way = np.concatenate([joint[None], way])
        elif _length(way) * box.step_mm < SPUR_MM:
            continue
        # A way of voxels wavers about the middle: the deepest place beside it tells the width.
        radius = _deepest(depth, way)
        number = len(branches) if parent is None or length >= SPUR_MM else parent
        _cover(owner, way, 1.3 * radius / box.step_mm + 1.0, number, vessel)
        if number == len(branches):
            points = _evened(way[:, ::-1] * box.step_mm + box.lps_from_ijk[:3, 3])
            branches.append(VesselBranch(points, radius, parent, float(np.median(sure[tuple(way.T)]))))
            ways.append(way)
    return VesselTree(tuple(branches), whole)


def _arrival(vessel: Mask, depth: Values, labels: NDArray[Any]) -> Values:
    """How long a front takes from each piece's widest voxel, quicker in the middle; endless outside."""
    import SimpleITK as sitk  # slow to load, and most of what is public here does not need it

    flat, of = depth.reshape(-1), labels.reshape(-1)
    inside = np.flatnonzero(of)
    widest = inside[np.lexsort((flat[inside], of[inside]))]
    last = np.flatnonzero(np.diff(of[widest], append=-1) != 0)
    seeds = np.array(np.unravel_index(widest[last], vessel.shape)).T[:, ::-1]
    speed = np.where(vessel, depth * depth, 0.0).astype(np.float32)
    march = sitk.FastMarchingImageFilter()
    march.SetTrialPoints([tuple(int(k) for k in seed) for seed in seeds])
    time: Values = sitk.GetArrayFromImage(march.Execute(sitk.GetImageFromArray(speed)))
    time[~vessel] = np.inf
    return time


_AROUND = np.array([(z, y, x) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1) if z or y or x])


def _downhill(at: NDArray[np.intp], arrival: Values, owner: NDArray[np.int32]) -> tuple[NDArray[np.intp], int | None]:
    """The way to a branch that is known or to where the front began, from there to here."""
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
    """What lies round a way belongs to it, where nothing else came first."""
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
    """Its ends stay; the steps of voxels between them are taken away."""
    out = points
    for _ in range(2):
        if len(out) > 2:
            out = np.concatenate([out[:1], 0.25 * out[:-2] + 0.5 * out[1:-1] + 0.25 * out[2:], out[-1:]])
    return out
