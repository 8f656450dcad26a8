"""Tests of the camera pose: its up direction, and refused matrices."""

import numpy as np
import pytest

from carina.errors import UsageError
from carina.scopes import Pose, upright


def test_caudal_view_has_anterior_up_and_the_patient_right_on_the_right() -> None:
    pose = Pose.looking([1.0, 2.0, 3.0], [0, 0, -5])
    np.testing.assert_allclose(pose.lps_from_camera[:3, :3], np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]]), atol=1e-12)
    np.testing.assert_array_equal(pose.position_lps, [1, 2, 3])


def test_up_direction_of_an_antero_posterior_view_is_superior() -> None:
    np.testing.assert_allclose(upright(np.array([0.0, 1.0, 0.0])), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(upright(np.array([1.0, 0.0, 0.0])), [0, -1, 0], atol=1e-12)


@pytest.mark.parametrize(
    "matrix",
    [np.diag([-1.0, 1, 1, 1]), np.diag([2.0, 1, 1, 1]), np.full((4, 4), np.nan), np.eye(3)],
    ids=["mirrored", "scaled", "not finite", "3x3"],
)
def test_pose_with_a_non_rigid_matrix_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(UsageError):
        Pose(matrix)


def test_pose_with_an_up_direction_along_the_view_is_refused() -> None:
    with pytest.raises(UsageError, match="parallel"):
        Pose.looking([0, 0, 0], [0, 0, -1], [0, 0, 3])
