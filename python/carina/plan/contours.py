"""Outlines drawn on slices, as shares of a CT's voxels: exact along rows, eight lines to a voxel across them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.plan.mask_measures import Drawn
from carina.volume import Volume
from carina.volume.dicom_structures import Contour

__all__ = ["OutlineError", "drawn_in"]

PLANE = 0.1
"""Of the distance of two slices: farther from a slice an outline does not lie on it. Files round to 0.01 mm."""
LINES = 8
"""Sub-lines of a voxel: a disc of 5 mm radius at 0.7 mm is right to 0.1 %."""
MOST_GAP = 2
"""Slices without an outline between two with one: filled, as planning systems do. More is another structure."""
ON_CENTRE = 0.02
"""Of a voxel: an outline all of whose corners are nearer to voxels' centres runs through them."""


class OutlineError(VolumeImportError):
    """Outlines that do not lie on a CT's slices."""

    code = "import.mask-grid"


def drawn_in(volume: Volume, contours: Sequence[Contour]) -> tuple[Drawn, tuple[str, ...], float]:
    """What outlines enclose on a CT's own slices.

    An outline within another is a hole; others on one slice add up.

    Returns
    -------
    drawn, notes, off_mm
        Shares of voxels; what was done, in words; by how much the boundary is more uncertain for it.

    Raises
    ------
    OutlineError
        If they do not lie on its slices, or not within it.
    """
    points = [volume.to_ijk(contour.points_lps) for contour in contours]
    axis = _axis_across(points)
    planes = _planes(volume, points, axis)
    across = [n for n in range(3) if n != axis]
    limits = np.array(volume.shape_zyx[::-1])
    flat = [one[:, across] for one in points]
    low = np.min([one.min(axis=0) for one in flat], axis=0)
    high = np.max([one.max(axis=0) for one in flat], axis=0)
    if (low < -1.0).any() or (high > limits[across]).any():
        raise OutlineError("part of its outline lies outside this CT: it was drawn on another or a larger one")
    first = np.maximum(np.floor(low).astype(int) - 1, 0)
    size = np.minimum(np.ceil(high).astype(int) + 2, limits[across]) - first
    start, num = min(planes), max(planes) - min(planes) + 1
    share = np.zeros((num, int(size[1]), int(size[0])), dtype=np.float32)
    notes: list[str] = []
    centred = all(np.abs(one - np.rint(one)).max() <= ON_CENTRE for one in flat)
    for plane in sorted(set(planes)):
        here = [
            (one - first, contour.is_xor)
            for one, contour, at in zip(flat, contours, planes, strict=True)
            if at == plane
        ]
        share[plane - start] = _slice(here, (int(size[1]), int(size[0])), centred=centred)
    if centred:
        notes.append("its outline runs through the centres of voxels, which were taken as inside")
    off_mm = 0.0
    empty = sorted(set(range(num)) - {plane - start for plane in planes})
    if empty:
        filled = _fill(share, empty)
        if filled:
            spacing = volume.spacing_mm[axis]
            off_mm = 0.5 * spacing * filled / num
            notes.append(f"{filled} slice{'s' if filled > 1 else ''} without an outline between others: interpolated")
    order = [2 - across[1], 2 - across[0]]
    # Axes of the array are plane, second, first of the two across.
    placed = np.moveaxis(share, (0, 1, 2), (2 - axis, order[0], order[1]))
    corner = [0, 0, 0]
    corner[2 - axis], corner[order[0]], corner[order[1]] = start, int(first[1]), int(first[0])
    return Drawn(np.ascontiguousarray(placed), (corner[0], corner[1], corner[2])), tuple(notes), off_mm


def _axis_across(points: Sequence[NDArray[np.float64]]) -> int:
    """Which of i, j, k is the same for all points of each outline."""
    spread = np.max([np.ptp(one, axis=0) for one in points], axis=0)
    axis = int(np.argmin(spread))
    if spread[axis] > PLANE:
        raise OutlineError("its outlines are not parallel to the slices of this CT: they were drawn on another one")
    return axis


def _planes(volume: Volume, points: Sequence[NDArray[np.float64]], axis: int) -> list[int]:
    heights = np.array([float(one[:, axis].mean()) for one in points])
    planes = np.rint(heights)
    off = np.abs(heights - planes)
    worst = int(np.argmax(off))
    if off[worst] > PLANE:
        raise OutlineError(
            f"an outline lies {off[worst] * volume.spacing_mm[axis]:.1f} mm off the nearest slice of this CT: it was "
            "drawn on one with other slices"
        )
    if planes.min() < 0 or planes.max() >= volume.shape_zyx[2 - axis]:
        raise OutlineError("part of its outline lies outside this CT: it was drawn on another or a larger one")
    return [int(plane) for plane in planes]


def _slice(
    outlines: Sequence[tuple[NDArray[np.float64], bool]], shape: tuple[int, int], *, centred: bool
) -> NDArray[np.float32]:
    """Shares of the voxels of one slice, from outlines in its voxel coordinates."""
    covers = [(_centres_in(one, shape) if centred else coverage(one, shape), is_xor) for one, is_xor in outlines]
    covers.sort(key=lambda cover: -float(cover[0].sum()))
    total = np.zeros(shape)
    for cover, is_xor in covers:
        area = float(cover.sum())
        # Enclosed by what is there: a hole.
        if is_xor or (area > 0.0 and float(np.minimum(cover, total).sum()) >= 0.999 * area):
            total = np.abs(total - cover)
        else:
            total = np.maximum(total, np.minimum(total + cover, 1.0))
    found: NDArray[np.float32] = np.clip(total, 0.0, 1.0).astype(np.float32)
    return found


def coverage(points: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """The share of each voxel (rows, columns) that a closed outline (n, 2), columns first, encloses."""
    rows, columns = shape
    found = np.zeros(shape)
    x0, y0 = points.T
    x1, y1 = np.roll(points, -1, axis=0).T
    left = np.arange(columns) - 0.5
    for line in range(rows * LINES):
        y = (line + 0.5) / LINES - 0.5
        crosses = (y0 <= y) != (y1 <= y)
        if not crosses.any():
            continue
        a, b, c, d = x0[crosses], y0[crosses], x1[crosses], y1[crosses]
        at = np.sort(a + (y - b) / (d - b) * (c - a)).reshape(-1, 2)
        spans = np.clip(at[:, 1:] - left, 0.0, 1.0) - np.clip(at[:, :1] - left, 0.0, 1.0)
        found[line // LINES] += spans.sum(axis=0) / LINES
    return found


def _centres_in(points: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """1 for each voxel whose centre lies in or on an outline that runs through centres."""
    # A little larger than itself: what lies on it is inside then.
    found = np.zeros(shape)
    for shift in (-0.02, 0.02):
        found = np.maximum(found, _even_odd(points + np.array([0.0, shift]), shape))
    for one, other in zip(points, np.roll(points, -1, axis=0), strict=True):
        steps = int(np.ceil(np.abs(other - one).max())) + 1
        for at in np.linspace(one, other, steps + 1):
            if np.abs(at - np.rint(at)).max() <= ON_CENTRE:
                column, row = np.rint(at).astype(int)
                if 0 <= row < shape[0] and 0 <= column < shape[1]:
                    found[row, column] = 1.0
    return found


def _even_odd(points: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    x0, y0 = points.T
    x1, y1 = np.roll(points, -1, axis=0).T
    columns = np.arange(shape[1])
    found = np.zeros(shape)
    for row in range(shape[0]):
        crosses = (y0 <= row) != (y1 <= row)
        if crosses.any():
            a, b, c, d = x0[crosses], y0[crosses], x1[crosses], y1[crosses]
            at = a + (row - b) / (d - b) * (c - a)
            found[row] = (at[:, None] < columns).sum(axis=0) % 2
    return found


def _fill(share: NDArray[np.float32], empty: Sequence[int]) -> int:
    """Fill short gaps between slices by the distances to their outlines; how many were filled."""
    num = 0
    known = sorted(set(range(len(share))) - set(empty))
    for below, above in pairwise(known):
        gap = above - below - 1
        if not 1 <= gap <= MOST_GAP or not np.minimum(share[below], share[above]).any():
            continue
        one, other = _signed(share[below]), _signed(share[above])
        for n in range(1, gap + 1):
            part = n / (gap + 1)
            share[below + n] = np.clip(0.5 + (1.0 - part) * one + part * other, 0.0, 1.0)
            num += 1
    return num


def _signed(cover: NDArray[np.float32]) -> NDArray[np.float64]:
    """Distance to the outline in voxels, positive inside."""
    import SimpleITK as sitk  # slow to load, and most of what is public here does not need it

    inside = cover >= 0.5
    if not inside.any():
        return np.full(cover.shape, -1e3)
    image = sitk.GetImageFromArray(inside.astype(np.uint8))
    far = sitk.SignedMaurerDistanceMap(image, insideIsPositive=True, squaredDistance=False, useImageSpacing=False)
    found: NDArray[np.float64] = sitk.GetArrayFromImage(far).astype(np.float64)
    # Centres of voxels: the outline lies half a voxel beyond the last.
    return found + 0.5
