"""Whether a place lies in the airways."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from carina.track import Airways
    from carina.volume import Volume

__all__ = ["in_airways", "in_lumen"]


def in_lumen(volume: Volume, lumen_zyx: Any, point_lps: Any) -> bool:
    """Whether the voxel that a point lies in is lumen."""
    i, j, k = np.rint(volume.to_ijk(point_lps)).astype(int)
    nz, ny, nx = volume.shape_zyx
    return 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and bool(lumen_zyx[k, j, i])


def in_airways(volume: Volume, airways: Airways, point_lps: Any) -> bool:
    """In the lumen, or so near to a branch's middle as its wall: a lens that lies on the wall is half in it."""
    if in_lumen(volume, airways.lumen_zyx, point_lps):
        return True
    branch, index, away_mm = airways.tree.nearest_branch(point_lps)
    return bool(away_mm <= branch.radius[index])
