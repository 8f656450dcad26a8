"""A lattice of cells known to be inside a lumen, so that exact distances are computed for few points only."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from mesh_distance import MeshDistance
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SignedMm = Callable[[Floats], Floats]
"""Function that returns signed distances (mm) of (n, 3) points; positive values are outside the lumen."""
ROOM = 8
"""Number of layers of cells between a cell and the wall that are distinguished: 4 mm, more than any scope's radius."""


class LumenCells:
    """Lattice of cells inside a lumen; distances are computed only for points outside these cells."""

    def __init__(
        self,
        low: Floats,
        cell_mm: float,
        inside: NDArray[np.bool_],
        signed_mm: SignedMm,
        is_inside: Callable[[Floats], bool] = lambda _: False,
    ) -> None:
        self._is_inside = is_inside
        self._is_inside_cell: dict[tuple[int, ...], bool] = {}
        self._low, self._cell_mm, self._inside, self._signed_mm = low, cell_mm, inside, signed_mm
        # The value of a cell is 1 plus the number of layers of inside cells around it, or 0 for a cell that is not
        # inside.
        self._depth = inside.astype(np.uint8)
        layer = inside
        for _ in range(ROOM):
            for axis in range(3):
                layer = layer & np.roll(layer, 1, axis) & np.roll(layer, -1, axis)
            self._depth += layer

    @classmethod
    def unknown(cls, signed_mm: SignedMm) -> LumenCells:
        """Return a lattice without inside cells, so that the distance is computed for every point."""
        return cls(np.zeros(3), 1.0, np.zeros((1, 1, 1), dtype=bool), signed_mm)

    @classmethod
    def of_mesh(cls, wall: MeshDistance, corners: Floats, seeds: Floats) -> LumenCells:
        """Build the lattice of a closed mesh: inside cells do not touch the mesh and are connected to the seeds."""
        cell = 0.5
        low = corners.min(axis=(0, 1)) - 2.0 * cell
        num = (np.ptp(corners, axis=(0, 1)) / cell).astype(int) + 5
        # Every point of the mesh is within half of ``apart`` of one of these points.
        apart = 0.6 * cell
        quarter = 0.25 * cell
        places = ((points_on(corners, apart) - low) / quarter).astype(int)
        places = np.stack(np.unravel_index(np.unique(np.ravel_multi_index(places.T, 4 * num)), 4 * num), axis=1)
        reach = (0.5 * quarter + 0.5 * apart) / cell
        is_wall = np.zeros(num, dtype=bool)
        for offset in itertools.product((-reach, 0.0, reach), repeat=3):
            is_wall[tuple(((places + 0.5) * 0.25 + offset).astype(int).T)] = True
        # The inside grows from the seeds cell by cell. The outermost cells of the lattice are outside the mesh.
        open_ = ~is_wall.ravel()
        inside = np.zeros(open_.size, dtype=bool)
        front = np.ravel_multi_index(((seeds - low) / cell).astype(int).T, num)
        steps = [sign * step for step in (1, num[2], num[1] * num[2]) for sign in (-1, 1)]
        while len(front):
            front = front[open_[front]]
            open_[front] = False
            inside[front] = True
            front = np.unique(np.concatenate([front + step for step in steps]))
        inside = inside.reshape(num)
        assert not inside[0].any(), "the mesh has a hole"
        return cls(low, cell, inside, wall.signed_mm, wall.is_inside)

    def holds_balls(self, middles: Floats, radii: Floats) -> NDArray[np.bool_]:
        """Return for each ball whether the lattice shows that it is inside the lumen."""
        return (self._at(middles).astype(float) - 1.0) * self._cell_mm >= radii

    def depths_mm(self, points: Floats) -> Floats:
        """Return the depth (mm) of points in the wall: 0 in inside cells, infinite outside beyond the reach."""
        is_outside = self._at(points) == 0
        depths = np.zeros(len(points))
        depths[is_outside] = self._signed_mm(points[is_outside])
        # A point beyond the reach, in a cell that is not connected to a seed, may be outside, or in the lumen behind a
        # narrow part.
        for n in np.flatnonzero(np.isinf(depths)):
            cell = tuple(int(v) for v in (points[n] - self._low) // self._cell_mm)
            if cell not in self._is_inside_cell:
                self._is_inside_cell[cell] = self._is_inside(points[n])
            if self._is_inside_cell[cell]:
                depths[n] = 0.0
        return depths

    def _at(self, points: Floats) -> NDArray[np.uint8]:
        at = ((points - self._low) / self._cell_mm).astype(int)
        valid = ((at >= 0) & (at < self._inside.shape)).all(axis=1)
        at[~valid] = 0
        return np.where(valid, self._depth[tuple(at.T)], 0)


def points_on(corners: Floats, apart_mm: float) -> Floats:
    """Cut triangles (n, 3, 3) at their longest edges until no edge exceeds ``apart_mm``, and return all corners."""
    done = []
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        longest = edges.argmax(axis=1)
        small = edges.max(axis=1) <= apart_mm
        done.append(corners[small].reshape(-1, 3))
        turned = corners[~small][np.arange((~small).sum())[:, None], (longest[~small][:, None] + np.arange(3)) % 3]
        a, b, c = np.moveaxis(turned, 1, 0)
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def lattice_of(
    distance_mm: SignedMm, low: Floats, spacing: tuple[float, float, float], shape_zyx: tuple[int, int, int]
) -> NDArray[np.float32]:
    """Return the distance from the wall at the samples of a lattice.

    Blocks far from the wall have that of their middle.
    """
    block = 4
    num = [-(-n // block) for n in shape_zyx]
    at = np.stack(np.meshgrid(*map(np.arange, num), indexing="ij"), axis=-1).reshape(-1, 3) * block
    half = 0.5 * block * np.linalg.norm(spacing)
    middles = distance_mm(low + (at[:, ::-1] + 0.5 * block) * spacing)
    found = np.repeat(np.repeat(np.repeat(middles.reshape(num).astype(np.float32), block, 0), block, 1), block, 2)
    inner = np.stack(np.meshgrid(*[np.arange(block)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    # A wall field stores -2.5 to 4.5 mm. Neighbours of such blocks are computed too, because nothing is known beyond
    # the phantom's box.
    is_near = ((middles > -2.5 - 1.3 * half) & (middles < 4.5 + 1.3 * half)).reshape(num)
    for axis in range(3):
        is_near = is_near | np.roll(is_near, 1, axis) | np.roll(is_near, -1, axis)
    near = at[is_near.ravel()]
    for some in np.array_split(near, max(1, len(near) // 16_000)):
        samples = (some[:, None] + inner).reshape(-1, 3)
        found[tuple(samples.T)] = distance_mm(low + samples[:, ::-1] * spacing)
    nz, ny, nx = shape_zyx
    return np.ascontiguousarray(found[:nz, :ny, :nx])
