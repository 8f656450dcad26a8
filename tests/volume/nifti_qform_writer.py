"""NIfTI files with a qform, written from a transform by the formulas of nifti1.h."""

from __future__ import annotations

import struct
from pathlib import Path

import grid_writers as grids
import numpy as np

__all__ = ["nearest_rotation", "with_both_forms", "with_qform"]

_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


def nearest_rotation(lps_from_ijk: np.ndarray) -> np.ndarray:
    """Return the nearest transform with orthogonal axes, the same spacing and the same first voxel."""
    spacing = np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    left, _, right = np.linalg.svd(lps_from_ijk[:3, :3] / spacing)
    out = lps_from_ijk.copy()
    out[:3, :3] = left @ right * spacing
    return out


def _quaternion(lps_from_ijk: np.ndarray) -> tuple[float, tuple[float, float, float]]:
    """Return qfac and the quaternion's components b, c and d; the rotation must not be near 180 degrees."""
    ras = _RAS @ lps_from_ijk
    turn = ras[:3, :3] / np.linalg.norm(ras[:3, :3], axis=0)
    qfac = float(np.sign(np.linalg.det(turn)))
    turn = turn * (1, 1, qfac)
    a = np.sqrt(max(0.0, 1 + np.trace(turn))) / 2
    assert a > 0.01
    b, c, d = (turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    return qfac, (b / (4 * a), c / (4 * a), d / (4 * a))


def with_qform(folder: Path, lps_from_ijk: np.ndarray, values: np.ndarray | None = None, **options) -> Path:
    """Write a NIfTI file with a qform and no sform."""
    qfac, quaternion = _quaternion(lps_from_ijk)
    values = grids.chest() if values is None else values
    return grids.nifti(
        folder, values, lps_from_ijk=lps_from_ijk, forms=(1, 0), qfac=qfac, quaternion=quaternion, **options
    )


def with_both_forms(folder: Path, sform: np.ndarray, qform: np.ndarray) -> Path:
    """Write a NIfTI file with a qform and an sform that state different transforms of the same spacing."""
    path = with_qform(folder, qform)
    data = bytearray(path.read_bytes())
    struct.pack_into("<2h", data, 252, 1, 1)
    struct.pack_into("<12f", data, 280, *(_RAS @ sform)[:3].ravel())
    path.write_bytes(bytes(data))
    return path
