"""Tests of camera rotations, including angles near zero and near half a turn."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carina.navigate.rotation import orthonormal, rotation_from_vector, vector_from_rotation, yaw_pitch_roll

unit_vectors = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .map(np.array)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: v / np.linalg.norm(v))
)
angles = st.one_of(st.floats(0.0, np.pi), st.floats(0.0, 1e-5), st.floats(0.0, 1e-5).map(lambda a: np.pi - a))


@given(unit_vectors, angles)
def test_rotation_vector_round_trip_gives_the_same_rotation(axis: np.ndarray, angle: float) -> None:
    rotation = rotation_from_vector(axis * angle)
    again = rotation_from_vector(vector_from_rotation(rotation))
    # The tolerance of 1e-12 is the rounding of some tens of operations on numbers near 1.
    np.testing.assert_allclose(again, rotation, rtol=0, atol=1e-12)
    assert np.linalg.norm(vector_from_rotation(rotation)) <= np.pi + 1e-9


def test_positive_yaw_looks_right_positive_pitch_up_and_positive_roll_is_clockwise() -> None:
    small = 0.1
    assert yaw_pitch_roll(small, 0, 0)[0, 2] > 0.09  # Forward moves to +x, right.
    assert yaw_pitch_roll(0, small, 0)[1, 2] < -0.09  # Forward moves to -y, up.
    assert yaw_pitch_roll(0, 0, small)[1, 0] > 0.09  # The right side moves to +y, down, so the rotation is clockwise.


@given(unit_vectors, st.floats(0, 3), st.lists(st.floats(-1e-3, 1e-3), min_size=9, max_size=9))
def test_orthogonalised_axes_keep_the_forward_direction(axis: np.ndarray, angle: float, noise: list[float]) -> None:
    dented = rotation_from_vector(axis * angle) + np.array(noise).reshape(3, 3)
    square = orthonormal(dented)
    np.testing.assert_allclose(square.T @ square, np.eye(3), atol=1e-12)
    assert np.linalg.det(square) > 0
    np.testing.assert_allclose(square[:, 2], dented[:, 2] / np.linalg.norm(dented[:, 2]), atol=1e-12)
