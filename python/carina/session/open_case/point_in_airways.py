"""Test whether a point is inside the lumen of the airways."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from carina.track import Airways
    from carina.volume import Volume


def in_lumen(volume: Volume, lumen_zyx: Any, point_lps: Any) -> bool:
    """Return whether the voxel that contains a point is lumen.

    Parameters
    ----------
    volume
        The volume of the lumen.
    lumen_zyx
        (nz, ny, nx), nonzero in the lumen.
    point_lps
        (3,) LPS mm; a point outside the volume is not in the lumen.
    """
    i, j, k = np.rint(volume.to_ijk(point_lps)).astype(int)
    nz, ny, nx = volume.shape_zyx
    return 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and bool(lumen_zyx[k, j, i])


def in_airways(volume: Volume, airways: Airways, point_lps: Any) -> bool:
    """Return whether a point is in the lumen, or no farther from the nearest centreline than the branch's radius there.

    The second condition includes a lens that touches the wall.
    """
    if in_lumen(volume, airways.lumen_zyx, point_lps):
        return True
    branch, index, away_mm = airways.tree.nearest_branch(point_lps)
    return bool(away_mm <= branch.radius[index])
