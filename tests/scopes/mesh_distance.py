"""Signed distance to a closed mesh in plain numpy: the reference for tests of the compiled search.

A lattice of cells lists the triangles near each point. The distance to these triangles is exact (Ericson, Real-Time
Collision Detection, 2005, 5.1.5), and angle-weighted normals give the side (Baerentzen and Aanaes 2005).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
CELL_MM = 1.0
CHUNK = 1_500


@dataclass(frozen=True)
class Nearest:
    """Nearest feature of the mesh for each of n points, and the distance from it."""

    signed_mm: Floats
    """Signed distance (mm): positive outside the mesh, negative inside, infinite where no triangle is within reach."""


class MeshDistance:
    """Exact signed distances to a closed mesh within ``reach_mm`` of it, above 0 outside.

    Parameters
    ----------
    vertices, triangles
        The mesh; seen from outside, the corners of each triangle run counterclockwise.
    reach_mm
        The distance of points farther away is infinite; `is_inside` gives their side.
    """

    def __init__(self, vertices: Floats, triangles: NDArray[np.integer], *, reach_mm: float = 1.2) -> None:
        corners = vertices[triangles]
        self._corners = corners
        self._centres = corners.mean(axis=1)
        self._radii = np.linalg.norm(corners - self._centres[:, None], axis=2).max(axis=1)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        faces = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
        # Normals of the features of a triangle: 0 is the face, 1 to 3 the edges (from corner 0, 1, 2), 4 to 6 the
        # corners.
        self._normals = np.zeros((len(corners), 7, 3))
        self._normals[:, 0] = faces
        count = int(triangles.max()) + 1
        at_corner = np.zeros((count, 3))
        edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        _, edge = np.unique(edges.astype(np.int64) @ np.array([count, 1]), return_inverse=True)
        at_edge = np.zeros((edge.max() + 1, 3))
        np.add.at(at_edge, edge, np.repeat(faces, 3, axis=0))
        for n in range(3):
            a, b, c = (corners[:, (n + k) % 3] for k in range(3))
            with np.errstate(invalid="ignore", divide="ignore"):
                cosine = _dot(b - a, c - a) / np.linalg.norm(b - a, axis=1) / np.linalg.norm(c - a, axis=1)
            angle = np.arccos(np.clip(np.nan_to_num(cosine), -1.0, 1.0))
            np.add.at(at_corner, triangles[:, n], angle[:, None] * faces)
        for n in range(3):
            self._normals[:, 1 + n] = at_edge[edge.reshape(-1, 3)[:, n]]
            self._normals[:, 4 + n] = at_corner[triangles[:, n]]
        self._reach_mm = reach_mm
        self._low = corners.min(axis=(0, 1)) - reach_mm - CELL_MM
        self._num = (np.ptp(corners, axis=(0, 1)) / CELL_MM + 2.0 * reach_mm / CELL_MM + 4.0).astype(np.int64)
        self._cells, self._first, self._members = self._registered()

    def _registered(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return the sorted keys of cells with triangles in reach, the index of each first member, and the members."""
        lows = ((self._corners.min(axis=1) - self._reach_mm - self._low) // CELL_MM).astype(np.int64)
        highs = ((self._corners.max(axis=1) + self._reach_mm - self._low) // CELL_MM).astype(np.int64)
        most = (highs - lows).max(axis=0) + 1
        keys, members = [], []
        for offset in itertools.product(*map(range, most)):
            held = ((lows + offset) <= highs).all(axis=1)
            # Cells that are near the bounding box of a triangle but outside its bounding ball are excluded.
            middle = self._low + (lows[held] + offset + 0.5) * CELL_MM
            off = np.linalg.norm(middle - self._centres[held], axis=1)
            near = off <= self._radii[held] + self._reach_mm + 0.5 * np.sqrt(3.0) * CELL_MM
            which = np.flatnonzero(held)[near]
            keys.append(self._key(lows[which] + offset))
            members.append(which)
        key, member = np.concatenate(keys), np.concatenate(members)
        order = np.argsort(key, kind="stable")
        cells, first = np.unique(key[order], return_index=True)
        return cells, np.append(first, len(order)), member[order]

    def _key(self, at: NDArray[np.int64]) -> NDArray[np.int64]:
        return (at[:, 2] * self._num[1] + at[:, 1]) * self._num[0] + at[:, 0]

    def signed_mm(self, points: Floats) -> Floats:
        """Return signed distances (mm) of (n, 3) points, positive outside; infinite on both sides beyond the reach."""
        return np.concatenate([np.zeros(0), *(self._of(points[n : n + CHUNK]) for n in range(0, len(points), CHUNK))])

    def is_inside(self, point: Floats) -> bool:
        """Return whether a point is inside the mesh, at any distance from its surface.

        The side is that of the solid angle of the whole mesh (Van Oosterom and Strackee 1983).
        """
        return bool(solid_angles(point[None], self._corners)[0] > 0.5)

    def _of(self, points: Floats) -> Floats:
        found = np.full(len(points), np.inf)
        at = ((points - self._low) // CELL_MM).astype(np.int64)
        valid = ((at >= 0) & (at < self._num)).all(axis=1)
        key = np.where(valid, self._key(at), -1)
        place = np.minimum(np.searchsorted(self._cells, key), len(self._cells) - 1)
        valid &= self._cells[place] == key
        indices = np.flatnonzero(valid)
        first = self._first[place[indices]]
        num = self._first[place[indices] + 1] - first
        if not len(indices):
            return found
        ends = np.cumsum(num)
        who = np.repeat(np.arange(len(indices)), num)
        triangle = self._members[np.arange(ends[-1]) - np.repeat(ends - num - first, num)]
        p = points[indices]
        to_centre = np.linalg.norm(p[who] - self._centres[triangle], axis=1)
        # Triangles that cannot be the nearest one to their point are omitted.
        nearest = np.minimum.reduceat(to_centre + self._radii[triangle], ends - num)
        is_near = to_centre - self._radii[triangle] <= nearest[who]
        who, triangle = who[is_near], triangle[is_near]
        offset, feature = _to_triangle(p[who], self._corners[triangle])
        far = np.linalg.norm(offset, axis=1)
        order = np.lexsort((far, who))
        best = order[np.flatnonzero(np.append(True, np.diff(who[order]) > 0))]
        side = np.where(_dot(offset[best], self._normals[triangle[best], feature[best]]) >= 0.0, 1.0, -1.0)
        near = far[best] <= self._reach_mm
        found[indices[who[best][near]]] = (side * far[best])[near]
        return found


def solid_angles(points: Floats, corners: Floats) -> Floats:
    """Return the winding number of a closed mesh with corners (m, 3, 3) around each point: 1 inside, 0 outside."""
    away = corners[None] - points[:, None, None]
    far = np.linalg.norm(away, axis=3)
    a, b, c = (away[:, :, n] for n in range(3))
    la, lb, lc = (far[:, :, n] for n in range(3))
    dot = [(p * q).sum(axis=2) for p, q in ((a, b), (a, c), (b, c))]
    above = (a * np.cross(b, c)).sum(axis=2)
    below = la * lb * lc + dot[0] * lc + dot[1] * lb + dot[2] * la
    turns: Floats = np.arctan2(above, below).sum(axis=1) / (2.0 * np.pi)
    return turns


def _dot(a: Floats, b: Floats) -> Floats:
    return np.einsum("na,na->n", a, b)


def _to_triangle(p: Floats, corners: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return the vector from each triangle's nearest point to the query point, and the feature at the nearest point."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    bp = p - b
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    cp = p - c
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    cases = [
        (d1 <= 0) & (d2 <= 0),
        (d3 >= 0) & (d4 <= d3),
        (vc <= 0) & (d1 >= 0) & (d3 <= 0),
        (d6 >= 0) & (d5 <= d6),
        (vb <= 0) & (d2 >= 0) & (d6 <= 0),
        (va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0),
    ]
    feature = np.select(cases, [4, 5, 1, 6, 3, 2], 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        along_ab, along_ac = d1 / (d1 - d3), d2 / (d2 - d6)
        along_bc = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        whole = va + vb + vc
        v = np.select(cases, [0 * d1, 1 + 0 * d1, along_ab, 0 * d1, 0 * d1, 1 - along_bc], vb / whole)
        w = np.select(cases, [0 * d1, 0 * d1, 0 * d1, 1 + 0 * d1, along_ac, along_bc], vc / whole)
    # In a triangle without area the nearest point is on an edge or a corner.
    v, w = np.nan_to_num(v), np.nan_to_num(w)
    return ap - v[:, None] * ab - w[:, None] * ac, feature
