"""Export of a mask on a CT's grid as NIfTI, NRRD or MetaImage."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.errors import GeometryError, UsageError
from carina.export.header_notes import badge_lines
from carina.volume import GRID_SUFFIXES, Note, Volume, check_grid_fits, write_grid

MASK_SUFFIXES = GRID_SUFFIXES


def check_mask_file(path: Path | str, volume: Volume) -> None:
    """Check, before the airways are searched, that their mask can be written to a file of this name.

    Parameters
    ----------
    path
        File name.
    volume
        The CT.

    Raises
    ------
    UsageError
        If the suffix is not one of :data:`MASK_SUFFIXES`.
    GeometryError
        If the format cannot store the volume's grid; the message names a format that can.
    """
    if not Path(path).name.lower().endswith(MASK_SUFFIXES):
        msg = f"saving a mask: expected a file name that ends in {', '.join(MASK_SUFFIXES)}; found {Path(path).name!r}"
        raise UsageError(msg)
    check_grid_fits(path, volume.shape_zyx, volume.lps_from_ijk, what="the mask")


def write_mask(
    path: Path | str,
    mask_zyx: NDArray[np.uint8],
    volume: Volume,
    *,
    note: str | None = None,
    badges: Sequence[Note] = (),
) -> Path:
    """Write a mask on the grid of a volume, so that other software places the mask exactly over the CT.

    Parameters
    ----------
    path
        ``.nii.gz``, ``.nii``, ``.nrrd`` or ``.mha``.
    mask_zyx
        Array (nz, ny, nx) on the volume's grid; values other than 0 are written as 1.
    volume
        The CT.
    note
        Information for readers, such as the part that was drawn by hand. NIfTI stores the note as ``descrip`` (80
        bytes, the rest is cut off), the other formats as a field ``note``.
    badges
        The lasting notes of the case, in the same field: their codes, then ``note``, then their texts.

    Raises
    ------
    UsageError
        If the suffix is not one of :data:`MASK_SUFFIXES`.
    GeometryError
        If the mask is not on the volume's grid, or the format cannot store that grid.
    DiskError
        If the file cannot be written; a former file stays unchanged.
    """
    check_mask_file(path, volume)
    if mask_zyx.shape != volume.shape_zyx:
        msg = f"the mask must be on the volume's grid: expected shape {volume.shape_zyx}, found {mask_zyx.shape}"
        raise GeometryError(msg, code="geometry.shape")
    # The codes of the notes come first, because NIfTI has no space for whole sentences.
    parts = [*(badge.code for badge in badges), *([] if note is None else [note]), *badge_lines(badges)]
    values = (mask_zyx != 0).astype(np.uint8)
    return write_grid(path, values, volume.lps_from_ijk, what="the mask", note="; ".join(parts) or None)
