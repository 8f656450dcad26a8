"""A lumen in tiles of 32 voxels a side, one bit a voxel: an edit changes few of them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

__all__ = ["TILE", "TILE_BYTES", "from_tiles", "to_tiles"]

TILE = 32
TILE_BYTES = TILE**3 // 8
# Looked through in words of this many voxels: a lumen is a thousandth of a CT.
_WORD = 8


def grid_of(shape_zyx: tuple[int, int, int]) -> tuple[int, int, int]:
    """How many tiles there are along z, y, x."""
    nz, ny, nx = (-(-n // TILE) for n in shape_zyx)
    return nz, ny, nx


def to_tiles(lumen_zyx: NDArray[np.uint8]) -> list[tuple[int, bytes]]:
    """The tiles that hold lumen, by their places in C order of the tiles, with their bits in C order of the voxels."""
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
    """Tiles of one layer that hold lumen, in order."""
    plane = np.ascontiguousarray(layer).reshape(len(layer), -1)
    if plane.shape[1] % _WORD == 0:
        words = plane.view("<u8")
        at = np.unique(np.nonzero(words)[1]) * _WORD
        # A word may lie across two tiles or two rows.
        at = np.concatenate([at + n for n in range(_WORD)])
        at = at[(plane[:, at] != 0).any(axis=0)] if len(at) else at
    else:
        at = np.flatnonzero((plane != 0).any(axis=0))
    y, x = np.divmod(at, layer.shape[2])
    return [(int(a), int(b)) for a, b in np.unique(np.stack([y // TILE, x // TILE], axis=1), axis=0)]


def from_tiles(shape_zyx: tuple[int, int, int], tiles: Iterable[tuple[int, bytes]]) -> NDArray[np.uint8]:
    """The lumen again, 1 inside, read-only; pages of memory without lumen are never touched."""
    lumen = np.zeros(shape_zyx, dtype=np.uint8)
    _, ny, nx = grid_of(shape_zyx)
    for place, bits in tiles:
        z, rest = divmod(place, ny * nx)
        y, x = divmod(rest, nx)
        there = lumen[z * TILE : (z + 1) * TILE, y * TILE : (y + 1) * TILE, x * TILE : (x + 1) * TILE]
        tile = np.unpackbits(np.frombuffer(bits, dtype=np.uint8)).reshape(TILE, TILE, TILE)
        there[...] = tile[tuple(slice(0, n) for n in there.shape)]
    lumen.flags.writeable = False
    return lumen


def num_tiles(shape_zyx: tuple[int, int, int]) -> int:
    """How many tiles there may be."""
    nz, ny, nx = grid_of(shape_zyx)
    return nz * ny * nx
