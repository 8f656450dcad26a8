"""Tests of interpolated wall distances in lumens of known width."""

from __future__ import annotations

import numpy as np
import pytest

from carina.errors import UsageError
from carina.scopes import WallField

STEP_MM = 0.4


def tubes(radius_mm: float, axis: np.ndarray, *middles: np.ndarray) -> WallField:
    """Return the wall field of parallel tubes, exact at samples 0.4 mm apart."""
    num = int(2.0 * (radius_mm + 2.2) / STEP_MM) + 3
    low = -0.5 * (num - 1) * STEP_MM
    k, j, i = np.indices((num, num, num)) * STEP_MM + low
    distance = np.full(i.shape, -np.inf)
    for middle in middles:
        off = np.stack([i, j, k], axis=-1) - middle
        square = np.maximum((off * off).sum(axis=-1) - (off @ axis) ** 2, 0.0)
        distance = np.maximum(distance, radius_mm - np.sqrt(square))
    place = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    place[:3, 3] = low
    return WallField.from_distances(distance.astype(np.float32), place)


@pytest.mark.parametrize("diameter_mm", [1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
@pytest.mark.parametrize("off_mm", [0.0, 0.15, 0.3])
def test_inscribed_ball_in_a_tube_has_the_tube_diameter_in_every_direction_and_position(
    diameter_mm: float, off_mm: float
) -> None:
    rng = np.random.default_rng(int(10 * diameter_mm))
    ways = np.concatenate([np.eye(3), rng.normal(size=(9, 3))])
    biases = []
    for axis in ways / np.linalg.norm(ways, axis=1, keepdims=True):
        middle = rng.uniform(-0.5 * STEP_MM, 0.5 * STEP_MM, 3)
        across = np.cross(axis, rng.normal(size=3))
        across /= np.linalg.norm(across)
        at = middle + off_mm * across + rng.uniform(-0.4, 0.4, 40)[:, None] * axis
        biases.append(2.0 * (tubes(0.5 * diameter_mm, axis, middle).ball_mm(at) - (0.5 * diameter_mm - off_mm)))
    assert np.abs(biases).max() <= 0.1
    assert abs(np.mean(biases)) <= 0.07


def test_inscribed_ball_beside_a_thin_wall_is_limited_by_that_wall_and_not_by_the_next_lumen() -> None:
    axis = np.array([0.0, 0.0, 1.0])
    left, right = np.array([-0.9, 0.1, 0.0]), np.array([1.8, 0.1, 0.0])
    field = tubes(1.0, axis, left, right)
    for off_mm in (0.0, 0.4, 0.8, 0.95):
        at = left + np.array([off_mm, 0.0, 0.0])
        assert field.ball_mm(at)[0] == pytest.approx(1.0 - off_mm, abs=0.06)


def test_inscribed_ball_radius_is_the_wall_distance_outside_and_deep_inside_the_lumen() -> None:
    field = tubes(1.0, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    outside = np.array([[1.5, 0.0, 0.0], [0.0, 2.0, 0.3], [99.0, 0.0, 0.0]])
    assert field.ball_mm(outside).tolist() == field.distance_mm(outside).tolist()
    wide = tubes(6.0, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert wide.ball_mm([0.0, 0.0, 0.0]).tolist() == [4.5]
    assert len(wide.ball_mm(np.empty((0, 3)))) == 0


def test_wall_fields_with_equal_distances_are_stored_as_equal_bytes() -> None:
    axis, middle = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    wall = tubes(2.0, axis, middle)
    assert wall.to_bytes() == tubes(2.0, axis, middle).to_bytes()
    assert wall.to_bytes() != tubes(2.1, axis, middle).to_bytes()
    assert len(wall.to_bytes()) > wall.num_bytes


def test_tube_has_its_full_radius_on_its_axis_and_never_narrows_the_lumen() -> None:
    axis, middle = np.array([0.0, 0.0, 1.0]), np.array([0.2, 0.2, 0.0])
    wall = tubes(1.5, axis, middle)
    ends = middle + np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    # Interpolation cuts off the peak of the sampled distance on the axis.
    assert wall.distance_mm(middle)[0] < 1.4
    wide = wall.with_tube(ends, [1.6, 1.8])
    assert wide.distance_mm([middle, middle + np.array([0.5, 0.0, 0.0])]) == pytest.approx([1.7, 1.2], abs=0.01)
    around = middle + np.random.default_rng(3).uniform(-1.5, 1.5, size=(500, 3))
    assert (wide.distance_mm(around) >= wall.distance_mm(around)).all()
    thin = wall.with_tube(ends, [0.3, 0.3])
    assert thin.distance_mm(around[:, :]) == pytest.approx(wall.distance_mm(around), abs=0.25)
    assert wide.digest() not in {wall.digest(), thin.digest()}
    with pytest.raises(UsageError, match="tube"):
        wide.to_bytes()


@pytest.mark.parametrize("radius_mm", [[1.0], [1.0, 0.0], [1.0, np.nan], [1.0, 1.0, 1.0]])
def test_tube_with_a_wrong_radius_is_refused(radius_mm: list[float]) -> None:
    wall = tubes(1.5, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    with pytest.raises(UsageError):
        wall.with_tube([(0.0, 0.0, 0.0), (0.0, 0.0, 1.0)], radius_mm)
