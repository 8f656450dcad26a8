"""Closed mesh of a solid that a function describes, by marching cubes over samples of the function."""

from __future__ import annotations

import itertools
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.track.surface.mesh import Mesh, mask_mesh
from carina.volume.mask_parts import numbered_parts

Points = NDArray[np.float64]

SAMPLE_MM = 0.4
"""Distance in mm of the samples of a solid."""
BLOCK = 8
"""Number of samples along the side of a block; only blocks near the surface are computed."""
BLOCKS_AT_ONCE, GROUP = 256, 128
"""Number of blocks that are computed together, and number of vertices of a group."""


def norms(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths (...) of vectors (..., 3); faster than ``numpy.linalg.norm`` along the last axis."""
    found: NDArray[np.float64] = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return found


class Solid(Protocol):
    """Body that a signed depth describes."""

    def inside_mm(self, groups: Points) -> NDArray[np.float64]:
        """Return how deep points (n, m, 3) are inside the solid, (n, m) mm; negative outside, exact near the surface.

        Points of one group are neighbours.
        """
        ...


def solid_mesh(
    solid: Solid,
    low: Points,
    high: Points,
    near: list[tuple[Points, Points]],
    *,
    what: str,
    report: Any,
    is_large: bool = False,
) -> Mesh:
    """Return the closed mesh of the largest piece of a solid.

    Parameters
    ----------
    solid
        Solid inside the box from ``low`` to ``high``.
    low, high
        (3,) corners of the box, LPS mm.
    near
        Pairs of points (n, 3) and reaches (n,) in mm: the solid is sampled within the boxes of twice the reach around
        the points.
    what
        Name of the step for the progress.
    report
        Function ``f(what, fraction)`` for the progress; None for none.
    is_large
        Whether the solid reaches beyond these boxes. There its depth must be at most the distance to its surface: the
        depth in the middle of a block decides whether the block is sampled, inside or outside.

    Raises
    ------
    NoResultError
        ``print.no-lumen``: no sample is inside the solid.
    """
    num = np.ceil((high - low) / (SAMPLE_MM * BLOCK)).astype(int)
    active = np.zeros(num[::-1], dtype=np.bool_)
    inside = np.zeros(tuple(num[::-1] * BLOCK), dtype=np.bool_)
    nz, ny, nx = active.shape
    of_block = inside.reshape(nz, BLOCK, ny, BLOCK, nx, BLOCK)
    block_mm = SAMPLE_MM * BLOCK
    for points, reaches in near:
        first = np.maximum(np.floor((points - reaches[:, None] - low) / block_mm).astype(int), 0)
        last = np.minimum(np.floor((points + reaches[:, None] - low) / block_mm).astype(int) + 1, num)
        # Neighbouring points have the same blocks.
        for i, j, k, end_i, end_j, end_k in np.unique(np.hstack([first, last]), axis=0):
            active[k:end_k, j:end_j, i:end_i] = True
    if is_large:
        rest = np.argwhere(~active)
        for n in range(0, len(rest), GROUP * BLOCKS_AT_ONCE):
            some = rest[n : n + GROUP * BLOCKS_AT_ONCE]
            middles = low + block_mm * (some[:, ::-1] + 0.5) - 0.5 * SAMPLE_MM
            depth = solid.inside_mm(middles[:, None])[:, 0]
            # The corners of a block are 0.87 of its side away from its middle.
            active[tuple(some[np.abs(depth) < 0.9 * block_mm].T)] = True
            k, j, i = some[depth >= 0.9 * block_mm].T
            of_block[k, :, j, :, i, :] = True
    cell = np.stack(np.meshgrid(*(np.arange(BLOCK),) * 3, indexing="ij")[::-1], axis=-1).reshape(-1, 3)
    blocks = np.argwhere(active)
    for n in range(0, len(blocks), BLOCKS_AT_ONCE):
        if report is not None:
            report(what, n / len(blocks))
        some = blocks[n : n + BLOCKS_AT_ONCE]
        points = low + SAMPLE_MM * (some[:, None, ::-1] * BLOCK + cell)
        part = (solid.inside_mm(points) > 0.0).reshape(-1, BLOCK, BLOCK, BLOCK)
        of_block[some[:, 0], :, some[:, 1], :, some[:, 2], :] = part
    if not inside.any():
        raise NoResultError("the airway lumen is empty", code="print.no-lumen")
    pieces = numbered_parts(inside)
    # The number 0 stands for the samples outside.
    sizes = np.bincount(pieces.reshape(-1))
    sizes[0] = 0
    inside = pieces == int(np.argmax(sizes))
    matrix = np.diag([SAMPLE_MM] * 3 + [1.0])
    matrix[:3, 3] = low
    rough = mask_mesh(inside, matrix)
    return Mesh(_at_the_surface(rough, solid, low), rough.triangles)


def _at_the_surface(rough: Mesh, solid: Solid, low: Points) -> Points:
    """Return the vertices of a mesh of samples, each moved along its grid edge to the surface of the solid."""
    ijk = (rough.vertices_lps - low) / SAMPLE_MM
    halves = np.abs(ijk - np.rint(ijk)) > 0.25
    on_edge = halves.sum(axis=1) == 1
    lower, upper = np.floor(ijk + 1e-6), np.ceil(ijk - 1e-6)
    a, b = np.where(halves, lower, np.rint(ijk)), np.where(halves, upper, np.rint(ijk))
    moved = rough.vertices_lps.copy()
    # Neighbouring vertices form groups, so that few groups are near a cut or a name.
    cell = np.floor(ijk / BLOCK).astype(np.int64)
    edges = np.flatnonzero(on_edge)
    edges = edges[np.lexsort(cell[edges].T)]
    for first in range(0, len(edges), GROUP * BLOCKS_AT_ONCE):
        part = edges[first : first + GROUP * BLOCKS_AT_ONCE]
        # The last group is filled with its last vertex.
        whole = np.concatenate([part, np.repeat(part[-1:], -len(part) % GROUP)]).reshape(-1, GROUP)
        at_a, at_b = low + SAMPLE_MM * a[part], low + SAMPLE_MM * b[part]
        deep_a, deep_b = (solid.inside_mm(low + SAMPLE_MM * ends[whole]).reshape(-1)[: len(part)] for ends in (a, b))
        share = deep_a / np.where(np.abs(deep_a - deep_b) < 1e-9, 1.0, deep_a - deep_b)
        # The depth bends where two branches meet, so one step of regula falsi follows the linear estimate.
        middle = at_a + share[:, None] * (at_b - at_a)
        filled = np.concatenate([middle, np.repeat(middle[-1:], -len(part) % GROUP, axis=0)]).reshape(-1, GROUP, 3)
        deep = solid.inside_mm(filled).reshape(-1)[: len(part)]
        same = (deep > 0.0) == (deep_a > 0.0)
        begin, end = np.where(same, share, 0.0), np.where(same, 1.0, share)
        deep_begin, deep_end = np.where(same, deep, deep_a), np.where(same, deep_b, deep)
        change = deep_begin - deep_end
        share = begin + (end - begin) * deep_begin / np.where(np.abs(change) < 1e-9, 1.0, change)
        # The limits keep neighbouring vertices apart, so that no triangle has an area of 0.
        share = np.clip(share, 0.04, 0.96)
        moved[part] = at_a + share[:, None] * (at_b - at_a)
    rest = np.flatnonzero(~on_edge)
    if len(rest):
        # Middles of rings: the mean of the neighbours, which have moved.
        total, count = np.zeros((len(moved), 3)), np.zeros(len(moved))
        for first, second in itertools.permutations(range(3), 2):
            to, of = rough.triangles[:, first], rough.triangles[:, second]
            chosen = ~on_edge[to] & on_edge[of]
            np.add.at(total, to[chosen], moved[of[chosen]])
            np.add.at(count, to[chosen], 1.0)
        known = rest[count[rest] > 0]
        moved[known] = total[known] / count[known, None]
    return moved
