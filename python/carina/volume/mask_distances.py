"""Distances inside and outside a mask of cubic voxels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carina import _core

Mask = NDArray[np.bool_]


def ball_distance(mask: Mask, step_mm: float, reach_mm: float = math.inf) -> NDArray[np.float32]:
    """Return the distance in mm from each mask voxel to the nearest outside voxel, less half a voxel; 0 outside.

    Voxels beyond the faces of the box do not count as outside.

    Parameters
    ----------
    mask
        (nz, ny, nx) mask of cubic voxels.
    step_mm
        Voxel size.
    reach_mm
        Largest distance that is computed; larger ones are infinite.
    """
    found = np.zeros(mask.shape, dtype=np.float32)
    if mask.any():
        # A margin of one voxel round the mask suffices for its distances.
        part = extent(mask, 1)
        inner = np.ascontiguousarray(mask[part])
        away = _core.ball_distances(inner, step_mm=step_mm, reach_mm=reach_mm)
        found[part] = np.where(away <= reach_mm, away, np.inf)
    return found


def distance_from(mask: Mask, step_mm: float, reach_mm: float) -> NDArray[np.float32]:
    """Return the distance in mm of each outside voxel to a mask, less half a voxel; infinite beyond ``reach_mm``.

    Parameters
    ----------
    mask
        (nz, ny, nx) mask of cubic voxels.
    step_mm
        Voxel size.
    reach_mm
        Largest distance that is computed.
    """
    found = np.full(mask.shape, np.inf, dtype=np.float32)
    if mask.any():
        part = extent(mask, int(np.ceil(reach_mm / step_mm)) + 2)
        found[part] = ball_distance(~mask[part], step_mm, reach_mm)
    return found


def signed_distance(mask: Mask) -> NDArray[np.float64]:
    """Return the distance in voxels of each voxel to the outermost voxels of a mask, positive inside, negative outside.

    The outermost voxels, of distance 0, have one of their 26 (in a plane 8) neighbours outside the mask.

    Parameters
    ----------
    mask
        (nz, ny, nx) or (ny, nx) mask with at least one voxel inside and one outside.
    """
    whole = np.ascontiguousarray(mask.reshape((1,) * (3 - mask.ndim) + mask.shape))
    deep = whole.copy()
    for axis in range(3):
        # A voxel beyond the faces of the grid does not count as outside.
        padded = np.pad(deep, [(int(n == axis),) * 2 for n in range(3)], constant_values=True)
        size = deep.shape[axis]
        for first in (0, 2):
            deep &= padded.take(range(first, first + size), axis)
    away = np.sqrt(_core.squared_distances(~(whole & ~deep)).astype(np.float64))
    found: NDArray[np.float64] = np.where(whole, away, -away).reshape(mask.shape)
    return found


def extent(mask: Mask, margin: int) -> tuple[slice, slice, slice]:
    """Return the slices of an array that contain a mask and a margin of ``margin`` voxels."""
    found = []
    for axis in range(3):
        filled = np.flatnonzero(mask.any(axis=tuple(n for n in range(3) if n != axis)))
        found.append(slice(max(int(filled[0]) - margin, 0), int(filled[-1]) + 1 + margin))
    return found[0], found[1], found[2]
