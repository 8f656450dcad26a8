"""Detection of padding: the constant value of a rotated or cropped volume where nothing was scanned."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from carina.volume.model import Volume

REACH_MM = 30.0
"""Maximum distance in mm from the trachea at which padding (voxels without data) is searched."""
BLOCK_KJI = (3, 5, 5)
"""Size in voxels (k, j, i) of the smallest block of one value that counts as padding; noise produces no such block."""
MIN_MM3 = 60_000.0
"""Minimum volume of padding in mm3: larger than a wide trachea, whose air values a scanner may have clipped."""
MAX_EQUAL = 0.25
"""Maximum share of equal neighbours in the lower trachea; with more, its air has no noise and looks like padding."""


def padding_near(volume: Volume, trachea: list[tuple[int, int, int]]) -> NDArray[np.bool_] | None:
    """Return the padding near the trachea.

    A volume that was rotated has one value in its corners, often that of air. A trachea that is cut by such a corner
    would continue into it.

    Parameters
    ----------
    volume
        The original CT, with its noise.
    trachea
        Voxels (i, j, k) of the trachea's air, from the top down. The upper ones may be padding.

    Returns
    -------
    ndarray or None
        (nz, ny, nx), True in padding within :data:`REACH_MM` of the trachea and in the voxels beside it, whose values
        are interpolated; None if there is no padding.

    Examples
    --------
    >>> import numpy as np
    >>> from carina.volume.model import Volume
    >>> values = np.random.default_rng(1).normal(-1000.0, 20.0, (20, 20, 20)).astype(np.int16)
    >>> values[12:] = -1000
    >>> padding = padding_near(Volume(values, np.diag([3.0, 3.0, 3.0, 1.0])), [(10, 10, 15), (10, 10, 5), (10, 10, 2)])
    >>> int(padding.any(axis=(1, 2)).argmax())
    11
    """
    voxels = np.array(trachea)
    reach = [int(np.ceil(REACH_MM / mm)) for mm in volume.spacing_mm]
    low, high = np.maximum(voxels.min(axis=0) - reach, 0), voxels.max(axis=0) + reach + 1
    box = tuple(slice(a, b) for a, b in zip(low[::-1], high[::-1], strict=True))
    values = volume.hu_zyx[box]
    if any(n < size for n, size in zip(values.shape, BLOCK_KJI, strict=True)):
        return None
    least = most = values
    for axis, size in enumerate(BLOCK_KJI):
        least = sliding_window_view(least, size, axis=axis).min(axis=-1)
        most = sliding_window_view(most, size, axis=axis).max(axis=-1)
    has_one_value = least == most
    if not has_one_value.any():
        return None
    if _share_of_equal_neighbours(volume, voxels[len(voxels) // 2 :]) > MAX_EQUAL:
        return None
    padding = _mark_blocks(has_one_value, BLOCK_KJI, 0)
    if padding.sum() * abs(float(np.linalg.det(volume.lps_from_ijk[:3, :3]))) < MIN_MM3:
        return None
    mask = np.zeros(volume.shape_zyx, dtype=np.bool_)
    mask[box] = padding
    mask[box] = _mark_blocks(mask[box], (3, 3, 3), 1)
    return mask


def _share_of_equal_neighbours(volume: Volume, voxels: NDArray[np.int64]) -> float:
    """Return the share of voxels (n, 3) of (i, j, k) with the same value as the next voxel along i or along j."""
    _, ny, nx = volume.shape_zyx
    i, j, k = voxels.T
    values = volume.hu_zyx
    along_i = values[k, j, i] == values[k, j, np.minimum(i + 1, nx - 1)]
    along_j = values[k, j, i] == values[k, np.minimum(j + 1, ny - 1), i]
    return float(np.mean(along_i | along_j))


def _mark_blocks(mask: NDArray[np.bool_], block: tuple[int, int, int], before: int) -> NDArray[np.bool_]:
    """Return the union of the blocks whose first voxel, or voxel at offset ``before``, is in a mask.

    Parameters
    ----------
    mask
        (nz, ny, nx) mask.
    block
        Size of a block along each axis, in voxels.
    before
        Number of voxels of a block before the mask's voxel along each axis; the block is cut off at the border. With
        0 the result is larger than the mask by the block size less 1.
    """
    for axis, size in enumerate(block):
        width = [(0, 0)] * 3
        width[axis] = (before, before) if before else (size - 1, size - 1)
        mask = np.asarray(sliding_window_view(np.pad(mask, width), size, axis=axis).any(axis=-1))
    return mask
