"""The wall of the lumen, written into a copy of the volume (docs/decisions/0002-wall-in-the-volume.md)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.render.transfer import TransferFunction

__all__ = ["bounding_box", "grow_one_voxel", "wall_value", "with_wall"]


def grow_one_voxel(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask and all 26 neighbours of its voxels."""
    grown = mask.copy()
    for axis in range(3):
        before = grown.copy()
        lower: list[slice] = [slice(None)] * 3
        upper: list[slice] = [slice(None)] * 3
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        grown[tuple(upper)] |= before[tuple(lower)]
        grown[tuple(lower)] |= before[tuple(upper)]
    return grown


def bounding_box(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice, slice] | None:
    """The box of the true voxels and ``margin`` more on each side, or None for an empty mask."""
    slices = []
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        hits = np.flatnonzero(mask.any(axis=others))
        if len(hits) == 0:
            return None
        slices.append(slice(max(int(hits[0]) - margin, 0), int(hits[-1]) + 1 + margin))
    z, y, x = slices
    return z, y, x


def with_wall(hu_zyx: NDArray[np.int16], lumen_zyx: NDArray[np.uint8], wall_value: int) -> NDArray[np.int16]:
    """A copy in which the one-voxel shell round the lumen is at least ``wall_value``.

    Parameters
    ----------
    hu_zyx
        (nz, ny, nx) int16. Not modified.
    lumen_zyx
        The lumen on the same grid, not 0 inside.
    wall_value
        A value that the transfer function shows as opaque.
    """
    out = hu_zyx.copy()
    lumen = lumen_zyx != 0
    box = bounding_box(lumen, 1)
    if box is None:
        return out
    inside = lumen[box]
    shell = grow_one_voxel(inside) & ~inside
    part = out[box]
    part[shell] = np.maximum(part[shell], np.int16(wall_value))
    return out


def wall_value(transfer: TransferFunction) -> int:
    """The value that a wall must have at least: the lowest point of the transfer function that is as good as opaque."""
    alphas = transfer.points[:, 4]
    opaque = np.flatnonzero(alphas >= 0.9 * alphas.max())
    return int(np.clip(np.ceil(transfer.points[opaque[0], 0]), -32768, 32767))
