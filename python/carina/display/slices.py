"""Three orthogonal slices through the middle of a volume, for a notebook."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Right and down directions of the image as LPS axes with their signs, in radiological display: patient right on
# screen left, and the sagittal slice with anterior on the left.
PLANES = {"axial": ((0, 1), (1, 1)), "coronal": ((0, 1), (2, -1)), "sagittal": ((1, 1), (2, -1))}


def middle_slices(
    values_zyx: NDArray[np.int16], lps_from_ijk: NDArray[np.float64], window: tuple[float, float], *, height_px: int
) -> dict[str, NDArray[np.uint8]]:
    """Return the axial, coronal and sagittal middle slices, each (rows, columns, 3) uint8, at one scale.

    ``window`` is width and level in the unit of the volume. The highest image has ``height_px`` rows. The pixels are
    nearest voxels on a grid along the LPS axes, and black outside the volume.
    """
    nz, ny, nx = values_zyx.shape
    ends = [(i, j, k, 1.0) for i in (-0.5, nx - 0.5) for j in (-0.5, ny - 0.5) for k in (-0.5, nz - 0.5)]
    corners = (np.array(ends) @ lps_from_ijk.T)[:, :3]
    size_mm = np.ptp(corners, axis=0)
    mm_per_px = size_mm[1:].max() / height_px
    ijk_from_lps = np.linalg.inv(lps_from_ijk)
    width, level = window
    pictures = {}
    for name, ((across, across_sign), (down, down_sign)) in PLANES.items():
        columns, rows = (max(1, int(np.ceil(size_mm[axis] / mm_per_px))) for axis in (across, down))
        points = np.tile(corners.mean(axis=0), (rows, columns, 1))
        points[:, :, across] += across_sign * (np.arange(columns) + 0.5 - columns / 2) * mm_per_px
        points[:, :, down] += (down_sign * (np.arange(rows) + 0.5 - rows / 2) * mm_per_px)[:, None]
        ijk = points @ ijk_from_lps[:3, :3].T + ijk_from_lps[:3, 3]
        i, j, k = np.moveaxis(np.rint(ijk).astype(int), -1, 0)
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny) & (k >= 0) & (k < nz)
        values = values_zyx[np.clip(k, 0, nz - 1), np.clip(j, 0, ny - 1), np.clip(i, 0, nx - 1)]
        grey = np.clip((values - (level - width / 2)) / width * 255.0, 0, 255)
        pictures[name] = np.repeat(np.where(inside, grey, 0).astype(np.uint8)[:, :, None], 3, axis=2)
    return pictures
