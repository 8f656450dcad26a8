"""Boundary of a nodule in a plane, and its surface in space.

Boundary and surface are computed by surface nets (Gibson, MICCAI 1998): each cell that the boundary crosses contains
one point, the mean of the crossings with the cell's edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.plan.cubic_box import smoothed
from carina.plan.targets.grow_nodule import Nodule

Points = NDArray[np.float64]
Values = NDArray[np.float64]
MAX_CELLS = 24
"""Number of grid cells along the longest side of a nodule's surface mesh; larger nodules get larger cells."""
PAD = 3


class NoduleShare:
    """Fraction of the volume at a point that a nodule fills, 0 to 1, interpolated between the voxels of its mask."""

    def __init__(self, nodule: Nodule) -> None:
        mask = np.pad(nodule.inside_zyx, PAD).astype(np.float32)
        self._share = smoothed(mask, 0.7).astype(np.float64)
        self._lps_from_ijk = nodule.lps_from_ijk.copy()
        self._lps_from_ijk[:3, 3] -= PAD * self._lps_from_ijk[:3, :3].sum(axis=1)
        self._ijk_from_lps = np.linalg.inv(self._lps_from_ijk)

    def at(self, points_lps: Points) -> Values:
        """Return the share of the nodule at each of (..., 3) points, LPS mm."""
        ijk = points_lps @ self._ijk_from_lps[:3, :3].T + self._ijk_from_lps[:3, 3]
        last = np.array(self._share.shape[::-1]) - 1
        ijk = np.clip(ijk, 0.0, last)
        low = np.minimum(np.floor(ijk).astype(np.intp), last - 1)
        part = ijk - low
        total = np.zeros(ijk.shape[:-1])
        for corner in range(8):
            ends = [corner >> axis & 1 for axis in range(3)]
            weight = np.prod([part[..., a] if ends[a] else 1.0 - part[..., a] for a in range(3)], axis=0)
            i, j, k = (low[..., a] + ends[a] for a in range(3))
            total += weight * self._share[k, j, i]
        return total


def boundary_in_plane(
    nodule: Nodule, lps_from_pixel: NDArray[np.float64], width: int, height: int, *, every_px: float = 1.0
) -> tuple[Points, ...]:
    """Return the closed lines (n, 2) in which the plane of an image cuts a nodule.

    Parameters
    ----------
    nodule
        The nodule.
    lps_from_pixel
        (4, 4) transform as in `carina.render.Picture`.
    width, height
        Size of the image; lines end one step beyond its edges.
    every_px
        Distance of the sampled points.

    Returns
    -------
    tuple[Points, ...]
        Columns and rows in corner coordinates.
    """
    across = np.arange(-every_px, width + 2 * every_px, every_px)
    down = np.arange(-every_px, height + 2 * every_px, every_px)
    columns, rows = np.meshgrid(across, down)
    points = (
        columns[..., None] * lps_from_pixel[:3, 0] + rows[..., None] * lps_from_pixel[:3, 1] + lps_from_pixel[:3, 3]
    )
    share = NoduleShare(nodule).at(points)
    share[[0, -1]] = 0.0
    share[:, [0, -1]] = 0.0
    return tuple(line * every_px - every_px for line in _closed_lines(share))


def surface_of(nodule: Nodule) -> tuple[Points, NDArray[np.int64]]:
    """Return the vertices (n, 3) LPS mm and quads (m, 4) of a nodule's surface, coarse enough for a drawing.

    The corners of a quad are anticlockwise as seen from outside.
    """
    shape = np.array(nodule.inside_zyx.shape[::-1]) + 2 * PAD
    step = max(float(shape.max()) / MAX_CELLS, 1.0)
    num = np.ceil((shape - 1) / step).astype(int) + 1
    k, j, i = np.indices(tuple(num[::-1].tolist())).astype(np.float64) * step - PAD
    points = np.stack([i, j, k], axis=-1) @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3]
    share = NoduleShare(nodule).at(points)
    total, count = np.zeros((*share.shape, 3)), np.zeros(share.shape)
    crossings: list[list[NDArray[np.intp]]] = []
    for axis in range(3):
        low, high = np.moveaxis(share, axis, 0)[:-1], np.moveaxis(share, axis, 0)[1:]
        places = np.argwhere(np.moveaxis((low > 0.5) != (high > 0.5), 0, axis))
        ahead = places.copy()
        ahead[:, axis] += 1
        here = share[tuple(places.T)]
        where = places.astype(np.float64)
        where[:, axis] += (0.5 - here) / (share[tuple(ahead.T)] - here)
        one, other = (across for across in range(3) if across != axis)
        around = []
        # The four cells round the edge, in cyclic order.
        for back in ((0, 0), (1, 0), (1, 1), (0, 1)):
            cell = places.copy()
            cell[:, one] -= back[0]
            cell[:, other] -= back[1]
            np.add.at(total, tuple(cell.T), where)
            np.add.at(count, tuple(cell.T), 1.0)
            around.append(cell)
        crossings.append(around)
    used = count > 0
    number = np.full(share.shape, -1)
    number[used] = np.arange(int(used.sum()))
    ijk = (total[used] / count[used][:, None])[:, ::-1] * step - PAD
    vertices = ijk @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3]
    quads = [np.stack([number[tuple(cell.T)] for cell in around], axis=1) for around in crossings]
    return vertices, _outwards(vertices, np.concatenate(quads))


def _outwards(vertices: Points, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the quads of a surface oriented so that their normals point away from the surface's middle."""
    if not len(faces):
        return faces
    corners = vertices[faces]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    away = corners.mean(axis=1) - vertices.mean(axis=0)
    turned = (normal * away).sum(axis=1) < 0.0
    faces = faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    return faces


def _closed_lines(share: Values) -> list[Points]:
    """Return the closed contours at 0.5 of values on a grid with a rim of 0, as (n, 2) columns and rows."""
    rows, columns = share.shape
    total, count = np.zeros((rows, columns, 2)), np.zeros((rows, columns))
    links: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for axis in (0, 1):
        low, high = (share[:-1], share[1:]) if axis == 0 else (share[:, :-1], share[:, 1:])
        for r, c in np.argwhere((low > 0.5) != (high > 0.5)).tolist():
            a, b = float(low[r, c]), float(high[r, c])
            t = (0.5 - a) / (b - a)
            place = (c, r + t) if axis == 0 else (c + t, r)
            one, other = ((r, c), (r, c - 1)) if axis == 0 else ((r, c), (r - 1, c))
            for cell in (one, other):
                total[cell] += place
                count[cell] += 1
            links.setdefault(one, []).append(other)
            links.setdefault(other, []).append(one)
    lines: list[Points] = []
    while links:
        start = next(iter(links))
        line, at = [start], start
        while links.get(at):
            ahead = links[at].pop()
            links[ahead].remove(at)
            if not links[at]:
                del links[at]
            at = ahead
            line.append(at)
        links.pop(at, None)
        lines.append(np.array([total[cell] / count[cell] for cell in line]))
    return lines
