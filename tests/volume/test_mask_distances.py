"""Tests of distances inside and outside a mask against the distance map of SimpleITK."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carina.volume.mask_distances import ball_distance, distance_from


def expected(mask: NDArray[np.bool_], step_mm: float) -> NDArray[np.float64]:
    """Return the distance in mm from each mask voxel to the nearest outside voxel, less half a voxel; 0 outside."""
    image = sitk.GetImageFromArray((~mask).astype(np.uint8))
    image.SetSpacing([step_mm] * 3)
    far = sitk.SignedMaurerDistanceMap(image, insideIsPositive=False, squaredDistance=False, useImageSpacing=True)
    away = sitk.GetArrayFromImage(far).astype(np.float64)
    return np.where(mask, np.maximum(away - 0.5 * step_mm, 0.25 * step_mm), 0.0)


@settings(max_examples=60)
@given(
    st.tuples(*[st.integers(1, 14)] * 3),
    st.integers(0, 10_000),
    st.floats(0.02, 0.98),
    st.floats(0.3, 2.0),
    st.sampled_from([np.inf, 0.4, 1.7, 5.0]),
)
def test_mask_distances_equal_those_of_simpleitk_up_to_the_given_reach(
    shape: tuple[int, int, int], seed: int, share: float, step_mm: float, reach_mm: float
) -> None:
    mask = np.random.default_rng(seed).random(shape) < share
    if mask.all():
        return
    found, whole = ball_distance(mask, step_mm, reach_mm), expected(mask, step_mm)
    # Distances are rounded to a thousandth of a millimetre.
    sure = np.abs(whole - reach_mm) > 1e-3
    near = sure & (whole <= reach_mm)
    assert np.abs(found[near] - whole[near]).max(initial=0.0) < 1.1e-3
    assert np.isinf(found[sure & (whole > reach_mm)]).all()
    if mask.any():
        outside = distance_from(mask, step_mm, min(reach_mm, 5.0))
        assert (outside[mask] == 0.0).all()
        beyond = expected(~mask, step_mm)
        near = ~mask & (beyond <= min(reach_mm, 5.0) - 1e-3)
        assert np.abs(outside[near] - beyond[near]).max(initial=0.0) < 1.1e-3


def test_mask_without_an_outside_voxel_has_infinite_distances_and_an_empty_mask_has_none() -> None:
    assert np.isinf(ball_distance(np.ones((3, 4, 5), dtype=bool), 1.0)).all()
    assert (ball_distance(np.zeros((3, 4, 5), dtype=bool), 1.0) == 0.0).all()
    assert np.isinf(distance_from(np.zeros((3, 4, 5), dtype=bool), 1.0, 2.0)).all()


def test_distance_inside_a_mask_is_measured_to_the_nearest_outside_voxel_and_not_to_a_volume_face() -> None:
    mask = np.ones((1, 1, 5), dtype=bool)
    mask[0, 0, 0] = False
    assert ball_distance(mask, 0.8)[0, 0] == pytest.approx([0.0, 0.4, 1.2, 2.0, 2.8])
