"""Masks that need memory only for the part that is set; a lumen fills about a hundredth of a large chest's grid."""

from __future__ import annotations

import math
import mmap
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


def empty_mask(shape_zyx: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Return an array of zeros whose unwritten pages take no memory, also after reading.

    NumPy requests large pages from the system, and a lumen would touch nearly all of them.
    """
    size = math.prod(shape_zyx)
    if hasattr(mmap, "MAP_PRIVATE"):
        # In a shared mapping, reading a page would allocate memory, too.
        memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
        if hasattr(mmap, "MADV_NOHUGEPAGE"):
            memory.madvise(mmap.MADV_NOHUGEPAGE)
    else:
        memory = mmap.mmap(-1, size)
    return np.frombuffer(memory, dtype=np.uint8).reshape(shape_zyx)


def sparse_mask(mask_zyx: NDArray[np.uint8] | NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a read-only copy of a mask that takes memory only where the mask is set; values other than 0 become 1.

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


@dataclass(frozen=True, slots=True)
class PackedMask:
    """A mask of 0 and 1 in few bytes: one bit per voxel of its bounding box, compressed with Deflate.

    Examples
    --------
    >>> import numpy as np
    >>> mask = np.zeros((20, 30, 40), dtype=np.uint8)
    >>> mask[5:8, 6:9, 7:10] = 1
    >>> bool((PackedMask.of(mask).mask_zyx() == mask).all())
    True
    """

    shape_zyx: tuple[int, int, int]
    first_zyx: tuple[int, int, int]
    """Index (z, y, x) of the bounding box's first voxel."""
    box_zyx: tuple[int, int, int]
    """Shape (z, y, x) of the bounding box, in voxels."""
    bits: bytes

    @classmethod
    def of(cls, mask_zyx: NDArray[np.uint8]) -> PackedMask:
        """Pack a mask (nz, ny, nx); every value but 0 becomes 1."""
        slices = np.flatnonzero([layer.any() for layer in mask_zyx])
        shape = (mask_zyx.shape[0], mask_zyx.shape[1], mask_zyx.shape[2])
        if not len(slices):
            return cls(shape, (0, 0, 0), (0, 0, 0), b"")
        part = mask_zyx[slices[0] : slices[-1] + 1]
        rows, columns = np.flatnonzero(part.any(axis=(0, 2))), np.flatnonzero(part.any(axis=(0, 1)))
        box = part[:, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] != 0
        first = (int(slices[0]), int(rows[0]), int(columns[0]))
        size = (box.shape[0], box.shape[1], box.shape[2])
        return cls(shape, first, size, zlib.compress(np.packbits(box).tobytes(), 1))

    def mask_zyx(self) -> NDArray[np.uint8]:
        """Return the mask (nz, ny, nx) uint8, read-only."""
        mask = empty_mask(self.shape_zyx)
        if self.bits:
            bits = np.frombuffer(zlib.decompress(self.bits), dtype=np.uint8)
            (k, j, i), (nz, ny, nx) = self.first_zyx, self.box_zyx
            inside = np.unpackbits(bits, count=nz * ny * nx).reshape(self.box_zyx) != 0
            np.copyto(mask[k : k + nz, j : j + ny, i : i + nx], np.uint8(1), where=inside)
        mask.flags.writeable = False
        return mask
