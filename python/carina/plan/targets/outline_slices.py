"""Rasterisation of the outlines of one slice, with holes and with boundaries that were drawn twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError

LINES = 8
"""Number of scan lines per voxel with which an outline's area is sampled."""
ON_CENTRE = 0.02
"""Maximum distance in voxels between corners and voxel centres for an outline that runs through the centres."""
ENCLOSED = 0.999
"""Minimum share of an outline's area inside another outline for which the first counts as nested."""
SAME_OVERLAP = 0.9
"""Minimum intersection over union of two outlines that count as one boundary drawn twice."""
SAME_APART_VOX, SAME_APART_OVERLAP = 1.0, 0.7
"""Maximum mean distance in voxels and least overlap of two outlines that are one boundary.

A CT does not show a wall that is thinner than one voxel. The least overlap ensures that small hollows stay holes.
"""
UNCLEAR_OVERLAP = 0.75
"""Overlap of nested outlines above which they are refused: they may be a thin wall, or drawings by two observers."""
CLOSES_VOX = 0.005
"""Maximum distance in voxels between the first corner of a loop and the corner that closes the loop."""


class OutlineError(VolumeImportError):
    """Error for outlines that cannot be placed on a CT."""

    code = "import.mask-grid"

    def __init__(self, problem: str, *, way_out: str, code: str | None = None) -> None:
        super().__init__(problem, code=code)
        self.way_out = way_out
        """Remedy for the error, as an imperative for the user."""


@dataclass(frozen=True, slots=True, eq=False)
class SliceOutline:
    """One closed outline in the voxel coordinates of its slice."""

    points_vox: NDArray[np.float64]
    """Points (n, 2) of the outline, column and row; the last point joins the first."""
    is_xor: bool
    """Whether points in an even number of outlines are outside (CLOSEDPLANAR_XOR)."""


@dataclass(frozen=True, slots=True, eq=False)
class SliceShare:
    """Shares of the voxels of one slice, and the corrections that were made."""

    share: NDArray[np.float32]
    """Share of each voxel (rows, columns) inside the structure, 0 to 1."""
    num_merged: int = 0
    """Number of outlines that repeat another outline of the slice and were merged with it."""
    apart_vox: float = 0.0
    """Largest mean distance in voxels between two outlines that were merged."""
    hole_vox: float = 0.0
    """Area in voxels of the holes that nested CLOSED_PLANAR outlines leave."""


def slice_share(outlines: Sequence[SliceOutline], shape: tuple[int, int], *, centred: bool) -> SliceShare:
    """Compute the share of each voxel of a slice that is inside the outlines, 0 to 1.

    Outlines of the same boundary are averaged. A nested outline is a hole, an outline nested in a hole is an island,
    and other outlines are united.

    Parameters
    ----------
    shape
        Rows and columns.
    centred
        Whether the outlines run through the centres of the outermost voxels, which then count as inside.

    Raises
    ------
    OutlineError
        If two outlines are so similar that they may be one boundary or two (code ``import.mask``).
    """
    found: list[_Shape] = []
    for outline in outlines:
        points = outline.points_vox
        cover = _centres_in(points, shape) if centred else _cover(points, shape)
        if float(cover.sum()) > 0.0:
            found.append(_Shape(cover, _perimeter(points), outline.is_xor))
    unique, num_merged, apart = _merged(found)
    unique.sort(key=lambda one: -one.area)
    for n, outer in enumerate(unique):
        for inner in unique[n + 1 :]:
            _check_pair(outer, inner)
    total = np.zeros(shape)
    hole_vox = 0.0
    for one in unique:
        within = float(np.minimum(one.cover, total).sum())
        if one.is_xor:
            total = np.abs(total - one.cover)
        elif within >= ENCLOSED * one.area:
            total = np.abs(total - one.cover)
            hole_vox += one.area
        else:
            # An island fills only a part of its hole, so the hole stays open; overlapping outlines are united.
            total = np.maximum(total, np.minimum(total + one.cover, 1.0))
    share: NDArray[np.float32] = np.clip(total, 0.0, 1.0).astype(np.float32)
    return SliceShare(share, num_merged, apart, hole_vox)


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """One outline of a slice, as the covered share of each voxel."""

    cover: NDArray[np.float64]
    perimeter_vox: float
    is_xor: bool

    @property
    def area(self) -> float:
        return float(self.cover.sum())

    def overlap(self, other: _Shape) -> float:
        """Return the intersection over union of the areas of two outlines."""
        union = float(np.maximum(self.cover, other.cover).sum())
        return float(np.minimum(self.cover, other.cover).sum()) / union if union > 0.0 else 0.0

    def apart_vox(self, other: _Shape) -> float:
        """Return the mean distance in voxels between the boundaries of two outlines."""
        between = float(np.abs(self.cover - other.cover).sum())
        return between / max(0.5 * (self.perimeter_vox + other.perimeter_vox), 1e-9)

    def is_same(self, other: _Shape) -> bool:
        """Return whether two outlines are drawings of one boundary."""
        overlap = self.overlap(other)
        near = overlap >= SAME_APART_OVERLAP and self.apart_vox(other) < SAME_APART_VOX
        return overlap >= SAME_OVERLAP or near


def _merged(shapes: Sequence[_Shape]) -> tuple[list[_Shape], int, float]:
    """Replace outlines of a slice that draw the same boundary by their mean.

    Return the remaining shapes, the number of outlines that were removed, and the largest distance in voxels between
    an outline and the one that it was merged with (0 if none was merged).
    """
    groups: list[list[_Shape]] = []
    apart = 0.0
    for one in shapes:
        group = next((g for g in groups if not one.is_xor and not g[0].is_xor and one.is_same(g[0])), None)
        if group is None:
            groups.append([one])
        else:
            apart = max(apart, one.apart_vox(group[0]))
            group.append(one)
    merged = [
        _Shape(np.mean([one.cover for one in group], axis=0), group[0].perimeter_vox, group[0].is_xor)
        for group in groups
    ]
    return merged, len(shapes) - len(merged), apart


def _check_pair(outer: _Shape, inner: _Shape) -> None:
    """Raise an error for two outlines that may be one boundary or the two sides of a wall."""
    if outer.is_xor or inner.is_xor:
        # XOR of nearly equal outlines leaves a film that is thinner than a voxel, or no area.
        if outer.is_same(inner):
            raise OutlineError(
                "two CLOSEDPLANAR_XOR outlines of one slice are nearly equal and cancel each other",
                way_out="keep one of them and export the structure again",
                code="import.mask",
            )
        return
    within = float(np.minimum(outer.cover, inner.cover).sum()) >= ENCLOSED * inner.area
    if within and outer.overlap(inner) >= UNCLEAR_OVERLAP:
        raise OutlineError(
            f"two outlines of one slice lie {outer.apart_vox(inner):.1f} voxels apart, one within the other: they may "
            "be one boundary that was drawn twice, or a thin wall round a hole",
            way_out="keep one of them, or export the hole as CLOSEDPLANAR_XOR",
            code="import.mask",
        )


def _perimeter(points: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum())


def _cover(points: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the share of each voxel inside an outline.

    An outline that follows its boundary several times counts once.
    """
    loops = _loops(points)
    whole = coverage(points, shape)
    if len(loops) > 1:
        covers = [_Shape(coverage(loop, shape), _perimeter(loop), False) for loop in loops]
        if all(one.area > 0.0 and one.is_same(covers[0]) for one in covers):
            mean: NDArray[np.float64] = np.mean([one.cover for one in covers], axis=0)
            return mean
    return whole


def _loops(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the closed loops of an outline, split where the outline returns to its first point."""
    back = np.flatnonzero(np.abs(points - points[0]).max(axis=1) < CLOSES_VOX)
    ends = [*back.tolist(), len(points)]
    loops = [points[a:b] for a, b in pairwise(ends)]
    return [loop for loop in loops if len(loop) >= 3]


def coverage(points: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the share of each voxel (rows, columns) inside a closed outline (n, 2), columns first.

    Parameters
    ----------
    points
        (n, 2) outline, columns first; the last point joins the first.
    shape
        Number of rows and columns.
    """
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


def runs_through_centres(points: NDArray[np.float64]) -> bool:
    """Return whether all corners of an outline (n, 2) are voxel centres."""
    return float(np.abs(points - np.rint(points)).max()) <= ON_CENTRE


def _centres_in(points: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return 1 for each voxel whose centre is in or on an outline through voxel centres, else 0, (rows, columns)."""
    found = np.zeros(shape)
    # The outline is shifted in both directions, so that centres on the outline are inside.
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
