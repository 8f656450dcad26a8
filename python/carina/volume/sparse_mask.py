"""Masks that take memory only where they are set: a lumen of a large chest is a hundredth of its grid."""

from __future__ import annotations

import math
import mmap

import numpy as np
from numpy.typing import NDArray

__all__ = ["empty_mask", "sparse_mask"]


def empty_mask(shape_zyx: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Zeros, as many bytes as voxels; pages of memory that are not written take none, and reading changes nothing.

    NumPy asks the system for large pages, and a lumen lies in nearly all of those.
    """
    size = math.prod(shape_zyx)
    if hasattr(mmap, "MAP_PRIVATE"):
        # Pages of a mapping that could be shared are made by reading, too.
        memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        if hasattr(mmap, "MADV_NOHUGEPAGE"):
            memory.madvise(mmap.MADV_NOHUGEPAGE)
    else:
        memory = mmap.mmap(-1, size)
    return np.frombuffer(memory, dtype=np.uint8).reshape(shape_zyx)


def sparse_mask(mask_zyx: NDArray[np.uint8] | NDArray[np.bool_]) -> NDArray[np.uint8]:
    """A copy, read-only: 1 where the mask is not 0.

    Parameters
    ----------
    mask_zyx
        (nz, ny, nx), not empty.
    """
    shape = mask_zyx.shape
    out = empty_mask((shape[0], shape[1], shape[2]))
    for layer, made in zip(mask_zyx, out, strict=True):
        np.copyto(made, np.uint8(1), where=layer != 0)
    out.flags.writeable = False
    return out
