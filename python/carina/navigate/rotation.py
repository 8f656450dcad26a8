"""Small rotations of the camera's axes: +x right, +y down, +z forward."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["orthonormal", "rotation_from_vector", "vector_from_rotation", "yaw_pitch_roll"]


def rotation_from_vector(vector_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation about a vector by its length in radians (Rodrigues), 3x3."""
    angle = float(np.linalg.norm(vector_rad))
    if angle < 1e-12:
        # sin(a)/a = 1 - a^2/6: below 1e-12 the first order is exact in float64.
        return np.eye(3) + _cross_matrix(vector_rad)
    k = _cross_matrix(vector_rad / angle)
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


def vector_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation vector of a 3x3 rotation, at most pi long."""
    skew = 0.5 * np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine = float(np.linalg.norm(skew))
    cosine = 0.5 * (float(np.trace(rotation)) - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        return skew * (angle / sine)
    if cosine > 0.0:
        return skew
    # Half a turn: the sine vanishes, the axis is the column of R + 1 that has the largest diagonal.
    symmetric = 0.5 * (rotation + np.eye(3))
    column = int(np.argmax(np.diag(symmetric)))
    axis = symmetric[:, column] / np.linalg.norm(symmetric[:, column])
    # Just off half a turn the sign still matters.
    if float(axis @ skew) < 0.0:
        axis = -axis
    return np.asarray(axis * angle, dtype=np.float64)


def yaw_pitch_roll(yaw_rad: float, pitch_rad: float, roll_rad: float) -> NDArray[np.float64]:
    """A turn of the tip: yaw to the right, then pitch up, then roll clockwise as the operator sees it, 3x3.

    Columns of a pose multiplied by it from the right are turned about the camera's own axes.
    """
    return (
        rotation_from_vector(np.array([0.0, yaw_rad, 0.0]))
        @ rotation_from_vector(np.array([pitch_rad, 0.0, 0.0]))
        @ rotation_from_vector(np.array([0.0, 0.0, roll_rad]))
    )


def orthonormal(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The axes made square again, forward kept: rounding of many small turns adds up."""
    forward = rotation[:, 2] / np.linalg.norm(rotation[:, 2])
    down = rotation[:, 1] - float(rotation[:, 1] @ forward) * forward
    down = down / np.linalg.norm(down)
    return np.column_stack([np.cross(down, forward), down, forward])


def _cross_matrix(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
