"""Transforms of rotated and anisotropic grids for test volumes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def rotation(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Return the 3x3 matrix of a rotation about x, y and z by these angles, radians."""

    def turn(axis: int, angle: float) -> NDArray[np.float64]:
        a, b = (axis + 1) % 3, (axis + 2) % 3
        m = np.eye(3)
        m[a, a] = m[b, b] = np.cos(angle)
        m[a, b], m[b, a] = -np.sin(angle), np.sin(angle)
        return m

    return turn(0, x) @ turn(1, y) @ turn(2, z)


def place(
    axes: NDArray[np.float64],
    spacing_mm: tuple[float, float, float],
    middle_lps: tuple[float, float, float],
    shape_zyx: tuple[int, int, int],
) -> NDArray[np.float64]:
    """Return ``lps_from_ijk`` of a grid whose middle is at the point ``middle_lps``."""
    m = np.eye(4)
    m[:3, :3] = axes * np.array(spacing_mm)
    m[:3, 3] = np.array(middle_lps) - m[:3, :3] @ ((np.array(shape_zyx[::-1]) - 1) / 2)
    return m
