"""The boundary of a nodule as a closed surface, for viewers that show no voxels.

References
----------
Gibson, MICCAI 1998 (surface nets), without its relaxation: a vertex in each cell that the boundary passes, at the
middle of its crossings.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError
from carina.plan import Nodule
from carina.track import Mesh

__all__ = ["nodule_surface"]


def nodule_surface(nodule: Nodule) -> Mesh:
    """The surface between a nodule's voxels and those round them, closed, within half a voxel of the boundary.

    Returns
    -------
    Mesh
        Vertices in LPS mm; triangles run counterclockwise seen from outside.

    Raises
    ------
    UsageError
        If it has no voxel (``plan.no-target``).
    """
    at = np.argwhere(nodule.inside_zyx)
    if not len(at):
        raise UsageError("the target has no voxel; mark it again", code="plan.no-target")
    low, high = at.min(axis=0), at.max(axis=0) + 1
    # With a rim of voxels outside, so that no surface is cut open.
    inside = np.pad(nodule.inside_zyx[tuple(map(slice, low, high))], 1)
    vertices, quads = _net(inside)
    ijk = (vertices + low - 1.0)[:, ::-1]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)
    mesh = Mesh(ijk @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3], triangles)
    # The order z, y, x and a mirrored grid turn the triangles over.
    return mesh if mesh.volume_mm3 > 0.0 else Mesh(mesh.vertices_lps, np.ascontiguousarray(triangles[:, ::-1]))


def _net(inside: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Vertices in array indices, (n, 3), and quads of them, (m, 4), all turning the same way about the inside."""
    cells = tuple(size - 1 for size in inside.shape)
    total, count = np.zeros((*cells, 3)), np.zeros(cells)
    crossings = [np.diff(inside.astype(np.int8), axis=axis) for axis in range(3)]
    for axis, across in enumerate(crossings):
        others = [one for one in range(3) if one != axis]
        for shift in itertools.product((0, 1), repeat=2):
            corner = np.zeros(3)
            corner[others] = shift
            corner[axis] = 0.5
            window = tuple(slice(int(c), int(c) + n) for c, n in zip(np.floor(corner), cells, strict=True))
            crossed = across[window] != 0
            total[crossed] += corner
            count += crossed
    mixed = count > 0
    number = np.full(cells, -1, dtype=np.intp)
    number[mixed] = np.arange(int(mixed.sum()))
    vertices = np.argwhere(mixed) + total[mixed] / count[mixed][:, None]
    quads = []
    for axis, across in enumerate(crossings):
        second, third = np.eye(3, dtype=np.intp)[(axis + 1) % 3], np.eye(3, dtype=np.intp)[(axis + 2) % 3]
        for sign in (-1, 1):
            edges = np.argwhere(across == sign)
            round_it = [edges - second - third, edges - third, edges, edges - second][::-sign]
            quads.append(np.stack([number[tuple(cell.T)] for cell in round_it], axis=1))
    return vertices, np.concatenate(quads)
