"""Closed surface of a nodule, for viewers that do not show voxels."""

from __future__ import annotations

import numpy as np

from carina.errors import UsageError
from carina.plan import Nodule
from carina.track import Mesh, mask_mesh


def nodule_surface(nodule: Nodule) -> Mesh:
    """Return the closed surface between a nodule's voxels and the voxels outside, within half a voxel of the boundary.

    Returns
    -------
    Mesh
        Vertices in LPS mm; triangles are counterclockwise as seen from outside.

    Raises
    ------
    UsageError
        If the nodule has no voxel (``plan.no-target``).
    """
    at = np.argwhere(nodule.inside_zyx)
    if not len(at):
        raise UsageError("the target has no voxel; mark it again", code="plan.no-target")
    low, high = at.min(axis=0), at.max(axis=0) + 1
    lps_from_ijk = np.array(nodule.lps_from_ijk, dtype=np.float64)
    lps_from_ijk[:3, 3] += lps_from_ijk[:3, :3] @ low[::-1]
    return mask_mesh(nodule.inside_zyx[tuple(map(slice, low, high))], lps_from_ijk)
