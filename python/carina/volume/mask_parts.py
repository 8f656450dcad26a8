"""Connected parts of a mask, numbered by position or by size, and a morphological opening."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from carina import _core

Mask = NDArray[np.bool_]


def numbered_parts(mask: Mask, *, corners: bool = False) -> NDArray[np.uint32]:
    """Return the number, from 1, of the connected part of a mask that contains each voxel; 0 outside the mask.

    The parts are numbered in the order of their first voxels.

    Parameters
    ----------
    mask
        (nz, ny, nx) or (ny, nx) mask.
    corners
        True if voxels that share only an edge or a corner are connected; otherwise they must share a face.
    """
    whole = np.ascontiguousarray(mask, dtype=np.bool_)
    found, _ = _core.numbered_parts(whole.reshape((1,) * (3 - whole.ndim) + whole.shape), corners=corners)
    return found.reshape(whole.shape)


def parts_by_size(mask: Mask, *, corners: bool = False, least_voxels: int = 1) -> NDArray[np.uint32]:
    """Return the connected parts of a mask as `numbered_parts` does, the largest part first.

    Parts of equal size are in the order of their first voxels. Parts of fewer than ``least_voxels`` get the number 0.
    """
    found = numbered_parts(mask, corners=corners)
    sizes = np.bincount(found.reshape(-1))
    sizes[0] = 0
    order = np.argsort(-sizes[1:], kind="stable") + 1
    order = order[sizes[order] >= least_voxels]
    number = np.zeros(len(sizes), dtype=np.uint32)
    number[order] = np.arange(1, len(order) + 1, dtype=np.uint32)
    return number[found]


def opened(mask: Mask) -> Mask:
    """Return the parts of a mask that contain a voxel with its 18 neighbours by faces and edges, by such blocks.

    Voxels beyond the faces of the grid count as inside the mask for the first step, and as outside for the second.
    """
    steps = [(z, y, x) for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1) if abs(z) + abs(y) + abs(x) < 3]
    nz, ny, nx = mask.shape

    def shifted(values: Mask, beyond: bool) -> Iterator[Mask]:
        padded = np.pad(values, 1, constant_values=beyond)
        for z, y, x in steps:
            yield padded[1 + z : 1 + z + nz, 1 + y : 1 + y + ny, 1 + x : 1 + x + nx]

    cores = np.ones_like(mask)
    for near in shifted(mask, beyond=True):
        cores &= near
    found = np.zeros_like(mask)
    for near in shifted(cores, beyond=False):
        found |= near
    return found
