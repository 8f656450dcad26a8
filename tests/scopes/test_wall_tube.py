"""Tests of the tube that a wall field adds to its lumen."""

from __future__ import annotations

import numpy as np
import pytest

from carina.errors import UsageError
from carina.scopes import WallField

STEP_MM = 0.4
AXIS = np.stack(
    [0.6 * np.sin(np.arange(-9.0, 9.0, 0.7)), 0.4 * np.cos(np.arange(-9.0, 9.0, 0.7)), np.arange(-9.0, 9.0, 0.7)],
    axis=1,
)
RADIUS_MM = 1.4 + 0.3 * np.cos(AXIS[:, 2])


def tube_mm(points: np.ndarray) -> np.ndarray:
    """Return the distances of points to the wall of the tube, computed with every part of the tube's axis."""
    start, along = AXIS[:-1], np.diff(AXIS, axis=0)
    off = points[:, None] - start
    share = np.clip((off * along).sum(axis=-1) / (along * along).sum(axis=-1), 0.0, 1.0)
    away = np.linalg.norm(off - share[..., None] * along, axis=-1)
    return (RADIUS_MM[:-1] + share * np.diff(RADIUS_MM) - away).max(axis=1)


def wall() -> WallField:
    """Return the wall of a straight lumen with a radius of 1.5 mm along z, in oblique samples."""
    _, j, i = (np.indices((61, 41, 41)) - np.array([30, 20, 20])[:, None, None, None]) * STEP_MM
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
    place = np.eye(4)
    place[:3, :3] = STEP_MM * turn
    place[:3, 3] = -STEP_MM * turn @ [20.0, 20.0, 30.0]
    return WallField.from_distances((1.5 - np.hypot(i, j)).astype(np.float32), place)


def test_distance_in_a_lumen_with_a_tube_is_the_larger_one_of_both() -> None:
    points = np.random.default_rng(3).uniform([-2.2, -2.2, -9.5], [2.2, 2.2, 9.5], (4000, 3))
    tube = tube_mm(points)
    both = wall().with_tube(AXIS, RADIUS_MM).distance_mm(points)
    expected = np.maximum(wall().distance_mm(points), tube)
    # The wall field may leave out the distance to the tube at points more than 1 mm outside the tube.
    near = tube > -1.0
    assert near.sum() > 2000
    assert both[near] == pytest.approx(expected[near], abs=1e-9)


def test_excess_moves_the_sampled_wall_inwards_and_leaves_the_tube_unchanged() -> None:
    points = np.random.default_rng(4).uniform([-1.4, -1.4, -8.0], [1.4, 1.4, 8.0], (2000, 3))
    field = wall()
    thin = np.full(len(AXIS), 0.2)
    found = field.with_tube(AXIS, thin, excess_mm=np.full(len(AXIS), 0.5)).distance_mm(points)
    before = field.distance_mm(points)
    off = np.linalg.norm(points[:, None] - AXIS, axis=2).min(axis=1)
    beside = off > 0.8
    assert found[beside] == pytest.approx(before[beside] - 0.5, abs=1e-9)
    wide = field.with_tube(AXIS, RADIUS_MM, excess_mm=np.full(len(AXIS), 0.5)).distance_mm(points)
    inside = tube_mm(points) > 0.0
    assert (wide[inside] >= tube_mm(points)[inside] - 1e-9).all()


@pytest.mark.parametrize("excess", [[0.1], [-0.1] * len(AXIS), [np.nan] * len(AXIS)])
def test_excess_that_is_negative_or_has_another_length_is_rejected(excess: list[float]) -> None:
    with pytest.raises(UsageError):
        wall().with_tube(AXIS, RADIUS_MM, excess_mm=excess)


def test_ridges_are_part_of_the_wall_also_inside_a_tube_and_have_no_bytes() -> None:
    points = np.random.default_rng(5).uniform([-2.0, -2.0, -8.0], [2.0, 2.0, 8.0], (3000, 3))
    field = wall().with_tube(AXIS, RADIUS_MM)
    plate = np.array([[[0.2, 0.1, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]]])
    found = field.with_ridges(plate, half_mm=0.3)
    off = np.abs(points - plate[0, 0]) - [0.0, 1.0, 2.0]
    away = np.linalg.norm(np.maximum(off, 0.0), axis=1)
    assert found.distance_mm(points) == pytest.approx(np.minimum(field.distance_mm(points), away - 0.3), abs=1e-9)
    assert found.digest() != field.digest()
    with pytest.raises(UsageError, match="tube or ridges"):
        found.to_bytes()
    for bad in (plate[:, [0, 1, 1]], np.repeat(plate, 33, axis=0)):
        with pytest.raises(UsageError):
            field.with_ridges(bad, half_mm=0.3)
