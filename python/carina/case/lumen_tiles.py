"""A lumen as tiles of 32 voxels per side with one bit per voxel; an edit changes few tiles."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from carina.volume.sparse_mask import empty_mask

TILE = 32
TILE_BYTES = TILE**3 // 8


def grid_of(shape_zyx: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return the number of tiles along z, y, x that cover a mask of a given shape."""
    nz, ny, nx = (-(-n // TILE) for n in shape_zyx)
    return nz, ny, nx


def to_tiles(lumen_zyx: NDArray[np.uint8]) -> list[tuple[int, bytes]]:
    """Return the tiles of a mask that contain lumen, as pairs of tile number and packed bits.

    Tiles are numbered in C order; the bits of a tile are the voxels in C order, one bit per voxel.

    Parameters
    ----------
    lumen_zyx
        (nz, ny, nx) uint8; every value but 0 is lumen.
    """
    found = []
    nz, ny, nx = grid_of(lumen_zyx.shape)
    for z in range(nz):
        layer = lumen_zyx[z * TILE : (z + 1) * TILE]
        for y, x in _with_lumen(layer):
            cut = layer[:, y * TILE : (y + 1) * TILE, x * TILE : (x + 1) * TILE] != 0
            if cut.shape != (TILE, TILE, TILE):
                cut = np.pad(cut, [(0, TILE - n) for n in cut.shape])
            found.append(((z * ny + y) * nx + x, np.packbits(cut).tobytes()))
    return found


def _with_lumen(layer: NDArray[np.uint8]) -> list[tuple[int, int]]:
    """Return the indices (y, x) of the tiles that contain lumen in one layer of tiles, in ascending order."""
    seen = np.bitwise_or.reduce(layer, axis=0)
    if not seen.any():
        return []
    _, ny, nx = grid_of(layer.shape)
    padded = np.zeros((ny * TILE, nx * TILE), dtype=np.uint8)
    padded[: seen.shape[0], : seen.shape[1]] = seen
    found = padded.reshape(ny, TILE, nx, TILE).any(axis=(1, 3))
    return [(int(y), int(x)) for y, x in np.argwhere(found)]


def from_tiles(shape_zyx: tuple[int, int, int], tiles: Iterable[tuple[int, bytes]]) -> NDArray[np.uint8]:
    """Return the lumen mask that tiles contain, as a read-only array, 1 inside.

    Parameters
    ----------
    shape_zyx
        Shape of the volume.
    tiles
        Numbers and bits of the tiles, as :func:`to_tiles` returns them.

    Raises
    ------
    ValueError
        If a tile contains lumen outside the volume.
    """
    lumen = empty_mask(shape_zyx)
    voxels = lumen.ravel()
    _, num_y, num_x = grid_of(shape_zyx)
    nz, ny, nx = shape_zyx
    for place, bits in tiles:
        at = np.flatnonzero(np.unpackbits(np.frombuffer(bits, dtype=np.uint8)))
        z, y, x = at // TILE**2, at // TILE % TILE, at % TILE
        tile_z, rest = divmod(place, num_y * num_x)
        tile_y, tile_x = divmod(rest, num_x)
        z, y, x = z + tile_z * TILE, y + tile_y * TILE, x + tile_x * TILE
        if len(at) and (z[-1] >= nz or y.max() >= ny or x.max() >= nx):
            raise ValueError("a tile contains lumen outside the volume")
        # Only the lumen voxels are written: writing whole tiles would touch ten times as many pages of memory.
        voxels[(z * ny + y) * nx + x] = 1
    lumen.flags.writeable = False
    return lumen


def num_tiles(shape_zyx: tuple[int, int, int]) -> int:
    """Return the number of tiles of a volume, which is the largest possible number of stored tiles."""
    nz, ny, nx = grid_of(shape_zyx)
    return nz * ny * nx
