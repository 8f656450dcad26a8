"""Values of a volume on the voxels of another grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.volume.model import Volume


def resampled(
    volume: Volume, lps_from_voxel: NDArray[np.float64], shape_zyx: tuple[int, int, int], *, outside: float
) -> NDArray[np.float32]:
    """Return the trilinear values of a volume on another grid.

    The volume extends half a voxel beyond the centres of its outer voxels, where the values of its edge are repeated.

    Parameters
    ----------
    volume
        The volume.
    lps_from_voxel
        (4, 4) transform from the voxels of the other grid to LPS mm.
    shape_zyx
        Number of voxels of the other grid on each axis.
    outside
        Value outside the volume.
    """
    return _core.resampled(
        np.ascontiguousarray(volume.hu_zyx),
        volume.lps_from_ijk,
        lps_from_voxel=lps_from_voxel,
        shape_zyx=shape_zyx,
        outside=outside,
    )
