"""A mask on a CT's grid: NIfTI, NRRD or MetaImage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from carina.errors import CarinaError, GeometryError, UsageError
from carina.export.files import write_whole_by
from carina.volume import Volume

__all__ = ["MASK_SUFFIXES", "write_mask"]

MASK_SUFFIXES = (".nii.gz", ".nii", ".nrrd", ".mha")


def write_mask(path: Path | str, mask_zyx: NDArray[np.uint8], volume: Volume) -> Path:
    """Write a mask on the grid of a volume, so that other tools lay it exactly over the CT.

    Parameters
    ----------
    path
        ``.nii.gz``, ``.nii``, ``.nrrd`` or ``.mha``.
    mask_zyx
        (nz, ny, nx) of the volume; what is not 0 is written as 1.
    volume
        The CT.

    Raises
    ------
    UsageError
        If the suffix is another.
    GeometryError
        If the mask is not on the volume's grid, or the grid is sheared, which these formats cannot all say.
    CarinaError
        If it cannot be written; what was there before stays.
    """
    if not Path(path).name.lower().endswith(MASK_SUFFIXES):
        msg = f"a mask is written as {', '.join(MASK_SUFFIXES)}; found {Path(path).name!r}"
        raise UsageError(msg)
    if mask_zyx.shape != volume.shape_zyx:
        msg = f"the mask must be on the volume's grid: expected shape {volume.shape_zyx}, found {mask_zyx.shape}"
        raise GeometryError(msg, code="geometry.shape")
    image = sitk.GetImageFromArray((mask_zyx != 0).astype(np.uint8))
    spacing = np.array(volume.spacing_mm)
    direction = volume.lps_from_ijk[:3, :3] / spacing
    if not np.allclose(direction.T @ direction, np.eye(3), atol=1e-4):
        msg = (
            "the scan's axes are not at right angles (a tilted gantry): a mask file cannot hold that; resample the scan"
        )
        raise GeometryError(msg, code="geometry.sheared")
    image.SetSpacing(spacing.tolist())
    image.SetDirection(direction.ravel().tolist())
    image.SetOrigin(volume.lps_from_ijk[:3, 3].tolist())

    def write(draft: Path) -> None:
        try:
            sitk.WriteImage(image, str(draft), useCompression=True)
        except RuntimeError:
            # Its words name the draft; the usual reason is a full disk.
            msg = f"cannot write the mask to {path}: the library could not write it; is the disk full?"
            raise CarinaError(msg, code="export.write") from None

    return write_whole_by(path, write, what="the mask")
