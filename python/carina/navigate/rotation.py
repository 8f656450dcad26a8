"""Small rotations of the camera's axes: +x right, +y down, +z forward."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def rotation_from_vector(vector_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the 3x3 rotation about a vector; the vector's length is the angle in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector_rad))
    if angle < 1e-12:
        # sin(a)/a = 1 - a^2/6: below 1e-12 the first order is exact in float64.
        return np.eye(3) + _cross_matrix(vector_rad)
    k = _cross_matrix(vector_rad / angle)
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def vector_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vector of a 3x3 rotation, at most pi long.

    The function uses the largest component of the quaternion (Shepperd 1978), so it divides by no small number near
    rotations of 0 or pi, where the skew part of the matrix vanishes.
    """
    r = rotation
    trace = float(np.trace(r))
    # Four times the squares of w, x, y, z.
    squares = np.array([1.0 + trace, *(1.0 - trace + 2.0 * np.diag(r))])
    largest = int(np.argmax(squares))
    w, x, y, z = 0, 1, 2, 3
    products = np.empty((4, 4))
    products[np.diag_indices(4)] = squares
    products[w, x] = products[x, w] = r[2, 1] - r[1, 2]
    products[w, y] = products[y, w] = r[0, 2] - r[2, 0]
    products[w, z] = products[z, w] = r[1, 0] - r[0, 1]
    products[x, y] = products[y, x] = r[1, 0] + r[0, 1]
    products[x, z] = products[z, x] = r[0, 2] + r[2, 0]
    products[y, z] = products[z, y] = r[2, 1] + r[1, 2]
    q_wxyz = products[largest] / (2.0 * math.sqrt(squares[largest]))
    if q_wxyz[0] < 0.0:
        q_wxyz = -q_wxyz
    axis, sine = q_wxyz[1:], float(np.linalg.norm(q_wxyz[1:]))
    if sine < 1e-12:
        # angle = 2 asin(s), 2 s to first order.
        return np.asarray(2.0 * axis, dtype=np.float64)
    return np.asarray(axis * (2.0 * math.atan2(sine, float(q_wxyz[0])) / sine), dtype=np.float64)


def yaw_pitch_roll(yaw_rad: float, pitch_rad: float, roll_rad: float) -> NDArray[np.float64]:
    """Return the 3x3 rotation of the tip: yaw right, then pitch up, then roll clockwise as the operator sees it.

    Multiply the columns of a pose by this matrix from the right to rotate them about the camera's own axes.
    """
    return (
        rotation_from_vector(np.array([0.0, yaw_rad, 0.0]))
        @ rotation_from_vector(np.array([pitch_rad, 0.0, 0.0]))
        @ rotation_from_vector(np.array([0.0, 0.0, roll_rad]))
    )


def orthonormal(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return orthonormal camera axes near the given ones, with the same forward axis.

    This removes accumulated rounding.
    """
    forward = rotation[:, 2] / np.linalg.norm(rotation[:, 2])
    down = rotation[:, 1] - float(rotation[:, 1] @ forward) * forward
    down = down / np.linalg.norm(down)
    return np.column_stack([np.cross(down, forward), down, forward])


def _cross_matrix(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_from_wxyz(wxyz: Sequence[float]) -> NDArray[np.float64]:
    """Return the 3x3 rotation of a quaternion of unit length."""
    w, x, y, z = wxyz
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def wxyz_from_rotation(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return the quaternion of a 3x3 rotation, of unit length and w not negative."""
    vector = vector_from_rotation(rotation)
    angle = float(np.linalg.norm(vector))
    # sin(a/2)/a = 1/2 to first order.
    x, y, z = (float(v) for v in vector * (0.5 if angle < 1e-12 else math.sin(angle / 2.0) / angle))
    w = math.cos(angle / 2.0)
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return w / length, x / length, y / length, z / length
