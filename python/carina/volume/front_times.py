"""Arrival times of a front that spreads through voxels with different speeds (fast-marching method)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina import _core


def arrival_times(speed: NDArray[np.float32], starts_zyx: ArrayLike) -> NDArray[np.float32]:
    """Return the time at which a front reaches each voxel; infinite where it does not.

    Parameters
    ----------
    speed
        (nz, ny, nx) speed in voxels per unit of time; the front does not enter voxels of speed 0.
    starts_zyx
        (n, 3) indices (z, y, x) of the voxels that the front leaves at time 0.
    """
    starts = [(int(i), int(j), int(k)) for k, j, i in np.asarray(starts_zyx).reshape(-1, 3)]
    return _core.arrival_times(np.ascontiguousarray(speed, dtype=np.float32), starts)
