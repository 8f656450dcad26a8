"""Tolerances for the angles between the axes of a grid, used by all readers and writers of grid files."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

MAX_SKEW_DEG = 0.2
"""Maximum accepted deviation, in degrees, of the angle between two axes of a grid from 90 degrees."""
MAX_LEAN_MM = 0.1
"""Maximum shift in mm, over the shorter of two axes, of axes that are not perpendicular; it allows stacks of few
slices."""
_ROUNDING = 1e-9  # relative; rounding of 0.2 degrees when computed from a matrix


def skew_deg(lps_from_ijk: NDArray[np.float64]) -> float:
    """Return the largest deviation from 90 degrees between two axes of a grid; NaN if an axis has no direction."""
    lengths = np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    if not (np.isfinite(lengths).all() and lengths.min() > 0):
        return math.nan
    return max(math.degrees(math.asin(min(1.0, sine))) for sine in _pair_sines(lps_from_ijk).values())


def has_right_angles(lps_from_ijk: NDArray[np.float64], shape_ijk: tuple[int, ...]) -> bool:
    """Return whether the axes of a grid are at right angles within ``MAX_SKEW_DEG`` or ``MAX_LEAN_MM``.

    Parameters
    ----------
    lps_from_ijk
        (4, 4), mm; every axis has a length.
    shape_ijk
        Voxels along i, j and k.
    """
    spacing = np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    extents_mm = [float(step) * (n - 1) for step, n in zip(spacing, shape_ijk, strict=True)]
    largest = math.sin(math.radians(MAX_SKEW_DEG)) * (1 + _ROUNDING)
    return all(
        sine <= largest or sine * min(extents_mm[one], extents_mm[other]) <= MAX_LEAN_MM * (1 + _ROUNDING)
        for (one, other), sine in _pair_sines(lps_from_ijk).items()
    )


def with_orthogonal_axes(transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transform with the nearest orthogonal axes, the same spacing and the same first voxel.

    The NIfTI library and nibabel derive a qform from an sform in the same way (polar decomposition of the directions).
    """
    spacing = np.linalg.norm(transform[:3, :3], axis=0)
    left, _, right = np.linalg.svd(transform[:3, :3] / spacing)
    out = np.array(transform, dtype=np.float64)
    out[:3, :3] = (left @ right) * spacing
    return out


def _pair_sines(lps_from_ijk: NDArray[np.float64]) -> dict[tuple[int, int], float]:
    """Return, for each pair of axes, the sine of the deviation of their angle from 90 degrees."""
    directions = lps_from_ijk[:3, :3] / np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    return {(a, b): abs(float(directions[:, a] @ directions[:, b])) for a, b in ((0, 1), (0, 2), (1, 2))}
