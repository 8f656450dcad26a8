"""A phantom chest, and the same chest with mucus in one of its bronchi."""

from __future__ import annotations

import numpy as np

from carina.volume import Volume

CHEST = {"seed": 1, "spacing_mm": 1.2, "noise_hu": 25.0}


def named(airways, name):
    return next(branch for branch in airways.tree.branches if branch.name == name)


def plugged(volume, branch, length_mm):
    """Return the CT with mucus in the first ``length_mm`` of a branch, from its axis to its wall."""
    values = volume.hu_zyx.copy()
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    chosen = branch.points[(along > 2.0) & (along < 2.0 + length_mm)]
    nz, ny, nx = np.indices(values.shape, sparse=True)
    for point in chosen:
        i, j, k = volume.to_ijk(point)
        sx, sy, sz = volume.spacing_mm
        off = ((nx - i) * sx) ** 2 + ((ny - j) * sy) ** 2 + ((nz - k) * sz) ** 2
        values[off <= (branch.radius.max() + 1.5) ** 2] = 30
    return Volume(values, volume.lps_from_ijk)
