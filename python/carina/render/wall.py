"""Wall of the lumen, written into a copy of the volume (docs/decisions/0105)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.render.transfer_function import TransferFunction

# Least value of a voxel in the copy with a closed wall (the *cap*), as a function of the smoothed lumen (1 deep inside,
# 0 outside), in units of the ramp from clear (0) to opaque (1). At a flat wall the smoothed lumen is 3/4 in the last
# voxel inside and 1/4 in the first voxel outside, so the wall becomes opaque about one voxel outside.
CAP_LUMEN = (0.0, 0.3, 0.6, 1.0)
CAP_HEIGHT = (7 / 6, 1.0, -1 / 3, -1.0)
# Minimum cap of the shell (the voxels next to the lumen); without it the wall would have holes at corners where most
# neighbours are lumen.
LOWEST_SHELL = 2 / 3


def grow_one_voxel(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask with all 26 neighbours of its voxels added."""
    grown = mask.copy()
    for axis in range(3):
        before = grown.copy()
        lower: list[slice] = [slice(None)] * 3
        upper: list[slice] = [slice(None)] * 3
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        grown[tuple(upper)] |= before[tuple(lower)]
        grown[tuple(lower)] |= before[tuple(upper)]
    return grown


def bounding_box(mask: NDArray[np.bool_] | NDArray[np.uint8], margin: int) -> tuple[slice, slice, slice] | None:
    """Return the box that contains all true voxels of a mask, extended by ``margin`` voxels on each side.

    None if empty.
    """
    slices = []
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        hits = np.flatnonzero(mask.any(axis=others))
        if len(hits) == 0:
            return None
        slices.append(slice(max(int(hits[0]) - margin, 0), int(hits[-1]) + 1 + margin))
    z, y, x = slices
    return z, y, x


def wall_levels(transfer: TransferFunction) -> tuple[int, int]:
    """Return the highest voxel value that is shown as clear, and the lowest that is nearly opaque."""
    alphas = transfer.points[:, 4]
    opaque = int(np.flatnonzero(alphas >= 0.9 * alphas.max())[0])
    clear = max(opaque - 1, 0)
    low, high = transfer.points[clear, 0], transfer.points[opaque, 0]
    return int(np.floor(low)), int(max(np.ceil(high), np.floor(low) + 1))


def with_wall(hu_zyx: NDArray[np.int16], lumen_zyx: NDArray[np.uint8], levels: tuple[int, int]) -> NDArray[np.int16]:
    """Return a copy of the volume whose lumen has a closed opaque wall and an unchanged open inside.

    Values are only raised. Where the scan shows the wall, its values are higher than the written ones and stay.

    Parameters
    ----------
    hu_zyx
        (nz, ny, nx) int16. Not modified.
    lumen_zyx
        The lumen on the same grid, non-zero inside.
    levels
        The highest value of the airway that the transfer function shows as clear, and the lowest that it shows as
        opaque.
    """
    out = hu_zyx.copy()
    box = bounding_box(lumen_zyx, 4)
    if box is None:
        return out
    clear, opaque = levels
    ramp = opaque - clear
    # Heights by the smoothed lumen, 0 to 1024, for lumen, shell and the voxels behind the shell. The lumen stays clear
    # even in a branch of one voxel. The shell has a second voxel behind it: one voxel of a small size would let a third
    # of the light through.
    cap = np.interp(np.arange(1025) / 1024, CAP_LUMEN, [clear + h * ramp for h in CAP_HEIGHT])
    caps = (
        np.minimum(cap, clear),
        np.maximum(cap, clear + LOWEST_SHELL * ramp),
        np.full(1025, opaque + 0.5 * ramp),
    )
    heights = [np.clip(np.rint(c), -32768, 32767).astype(np.int16).tolist() for c in caps]
    # A lumen that was found with a low threshold ends inside the blurred edge. Its wall starts at the half height of
    # that edge; otherwise the steps of the mask would be visible.
    part = [(s.start, min(s.stop, n)) for s, n in zip(box, out.shape, strict=True)]
    _core.raise_wall(out, lumen_zyx, part, clear + ramp // 2, heights)
    return out
