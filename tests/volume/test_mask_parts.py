"""Tests of parts, openings, distances, fronts and resampling against the filters of ITK."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK as sitk

from carina.volume import Volume, VolumeSource
from carina.volume.front_times import arrival_times
from carina.volume.mask_distances import signed_distance
from carina.volume.mask_parts import numbered_parts, opened, parts_by_size
from carina.volume.resampling import resampled


def itk(mask):
    return sitk.GetImageFromArray(mask.astype(np.uint8))


@pytest.mark.parametrize("shape", [(7, 9, 11), (12, 20, 17), (24, 31), (1, 5, 5)])
@pytest.mark.parametrize("share", [0.05, 0.3, 0.5])
@pytest.mark.parametrize("corners", [False, True])
def test_parts_and_their_order_equal_those_of_itk(rng, shape, share, corners):
    mask = rng.random(shape) < share
    theirs = sitk.ConnectedComponent(itk(mask), corners)
    np.testing.assert_array_equal(numbered_parts(mask, corners=corners), sitk.GetArrayFromImage(theirs))
    large = sitk.GetArrayFromImage(sitk.RelabelComponent(theirs, minimumObjectSize=3))
    np.testing.assert_array_equal(parts_by_size(mask, corners=corners, least_voxels=3), large)


def test_empty_and_full_masks_have_no_part_and_one_part():
    empty = np.zeros((3, 4, 5), dtype=bool)
    assert numbered_parts(empty).max() == parts_by_size(empty).max() == 0
    assert (numbered_parts(~empty) == 1).all()


def test_parts_of_a_view_with_other_strides_equal_those_of_its_copy(rng):
    mask = (rng.random((9, 8, 14)) < 0.4)[::-1, :, ::2]
    np.testing.assert_array_equal(numbered_parts(mask), numbered_parts(mask.copy()))


@pytest.mark.parametrize("share", [0.6, 0.9, 0.97])
def test_opening_equals_that_of_itk(rng, share):
    mask = rng.random((9, 14, 11)) < share
    theirs = sitk.GetArrayFromImage(sitk.BinaryMorphologicalOpening(itk(mask), [1, 1, 1])) != 0
    np.testing.assert_array_equal(opened(mask), theirs)


@pytest.mark.parametrize("shape", [(8, 11, 9), (24, 31)])
def test_signed_distance_equals_that_of_itk(rng, shape):
    mask = rng.random(shape) < 0.4
    theirs = sitk.SignedMaurerDistanceMap(
        itk(mask), insideIsPositive=True, squaredDistance=False, useImageSpacing=False
    )
    # ITK computes the roots in float32.
    np.testing.assert_allclose(signed_distance(mask), sitk.GetArrayFromImage(theirs), atol=1e-6)


def test_arrival_times_equal_those_of_itk(rng):
    speed = (0.2 + rng.random((12, 15, 18))).astype(np.float32)
    speed[:, 7, 3:] = 0.0
    starts = np.array([[2, 3, 4], [9, 12, 16], [2, 4, 4]])
    march = sitk.FastMarchingImageFilter()
    march.SetTrialPoints([(int(i), int(j), int(k)) for k, j, i in starts])
    theirs = sitk.GetArrayFromImage(march.Execute(sitk.GetImageFromArray(speed)))
    ours = arrival_times(speed, starts)
    reached = theirs < 1e6
    np.testing.assert_array_equal(np.isfinite(ours), reached)
    # The result is float32; each step rounds once.
    np.testing.assert_allclose(ours[reached], theirs[reached], rtol=1e-6)


def test_start_outside_the_grid_is_refused():
    with pytest.raises(ValueError, match="starts_ijk"):
        arrival_times(np.ones((2, 3, 4), dtype=np.float32), [[0, 0, 4]])


@pytest.mark.parametrize("mirrored", [False, True])
def test_resampled_values_equal_those_of_itk(rng, mirrored):
    values = rng.integers(-1000, 1000, (8, 9, 10)).astype(np.int16)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * (0.7, 0.8, 2.5)
    matrix[:3, 3] = (10.0, -20.0, 30.0)
    image = sitk.GetImageFromArray(values)
    image.SetSpacing((0.7, 0.8, 2.5))
    image.SetOrigin((10.0, -20.0, 30.0))
    image.SetDirection(turn.reshape(-1).tolist())
    if mirrored:
        # The same voxels with the slices stored in reverse order.
        values = np.ascontiguousarray(values[::-1])
        flip = np.diag([1.0, 1.0, -1.0, 1.0])
        flip[2, 3] = len(values) - 1.0
        matrix = matrix @ flip
    volume = Volume(values, matrix, is_hu=True, source=VolumeSource(format="test", title="test"))
    low = np.array([5.0, -25.0, 25.0])
    to = sitk.ResampleImageFilter()
    to.SetSize([20, 21, 22])
    to.SetOutputSpacing([1.0] * 3)
    to.SetOutputOrigin(low.tolist())
    to.SetInterpolator(sitk.sitkLinear)
    to.SetDefaultPixelValue(-4096.0)
    to.SetOutputPixelType(sitk.sitkFloat32)
    theirs = sitk.GetArrayFromImage(to.Execute(image))
    voxels = np.eye(4)
    voxels[:3, 3] = low
    ours = resampled(volume, voxels, (22, 21, 20), outside=-4096.0)
    assert 100 < np.count_nonzero(theirs > -4096.0) < theirs.size
    # float32 has 24 bits: 1e-4 HU at 1000 HU.
    np.testing.assert_allclose(ours, theirs, atol=2e-3)
