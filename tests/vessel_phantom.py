"""Test volume without airways: a bright vessel in dark tissue on an oblique, anisotropic grid."""

from __future__ import annotations

import numpy as np

from carina.volume.model import Volume


def bent_vessel():
    """Return a bright vessel with a bend of 90 degrees in darker tissue with noise, as in MR.

    The results are the volume, the voxels of the vessel, and the vessel's start, corner and end (LPS mm).
    """
    rng = np.random.default_rng(5)
    k, j, i = np.indices((26, 44, 38))
    x, y, z = 0.9 * i, 0.7 * j, 1.4 * k
    along_y = (np.hypot(x - 9.0, z - 17.0) < 4.0) & (y > 4.0) & (y < 26.0)
    along_x = (np.hypot(y - 22.0, z - 17.0) < 4.0) & (x > 6.0) & (x < 31.0)
    inside = along_y | along_x
    values = np.where(inside, 1200, 300) + rng.normal(0.0, 12.0, inside.shape)
    turn = np.deg2rad(20.0)
    lps_from_ijk = np.eye(4)
    lps_from_ijk[:3, :3] = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, -1.0]]
    ) @ np.diag([0.9, 0.7, 1.4])
    lps_from_ijk[:3, 3] = [11.0, -7.0, 120.0]
    volume = Volume(np.ascontiguousarray(values, dtype=np.int16), lps_from_ijk)
    root, corner, end = volume.to_lps(np.array([[10.0, 9.0, 12.0], [10.0, 31.0, 12.0], [31.0, 31.0, 12.0]]))
    return volume, inside, root, corner, end
