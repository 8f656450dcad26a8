"""Tests of the exported mask: the voxels inside the surface at the half-maximum of the wall edge."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import carina
from cached_test_data import MASKED_CHEST, SMALL_CHEST, cached_airways, cached_phantom
from carina.track import lumen_mask, lumen_mesh


def dice(found, truth):
    return 2.0 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


@pytest.mark.parametrize("chest", [SMALL_CHEST, MASKED_CHEST], ids=["small", "masked"])
def test_exported_mask_ends_at_the_true_wall_of_the_lumen(chest):
    made, airways = cached_phantom(**chest), cached_airways(**chest)
    truth, found, mask = made.lumen_zyx != 0, airways.lumen_zyx != 0, lumen_mask(made.volume, airways) != 0
    assert dice(mask, truth) > 0.96
    assert dice(mask, truth) > dice(found, truth) + 0.02
    assert not (found & ~mask).any()


def test_exported_mask_has_the_volume_of_the_mesh():
    made, airways = cached_phantom(**MASKED_CHEST), cached_airways(**MASKED_CHEST)
    voxel_mm3 = float(np.prod(made.volume.spacing_mm))
    mask_mm3 = np.count_nonzero(lumen_mask(made.volume, airways)) * voxel_mm3
    assert mask_mm3 == pytest.approx(lumen_mesh(made.volume, airways).volume_mm3, rel=0.03)


def test_mask_from_another_tool_is_exported_unchanged():
    made = cached_phantom(**SMALL_CHEST)
    airways = carina.find_airways(made.volume, lumen_zyx=made.lumen_zyx)
    assert np.array_equal(lumen_mask(made.volume, airways), airways.lumen_zyx)


def tube(wall_hu, lung_hu):
    """Return a tube of air along k with a wall of two voxels in lung, and the lumen of its inner part."""
    off = np.hypot(*(np.mgrid[:24, :24] - 11.5))
    plane = np.where(off < 5.0, -1000, np.where(off < 7.0, wall_hu, lung_hu))
    return np.repeat(plane[None].astype(np.int16), 12, axis=0), np.repeat((off < 4.0)[None], 12, axis=0)


def in_tube(wall_hu, lung_hu):
    made, airways = cached_phantom(**SMALL_CHEST), cached_airways(**SMALL_CHEST)
    values, lumen = tube(wall_hu, lung_hu)
    volume = dataclasses.replace(made.volume, hu_zyx=values)
    return lumen, lumen_mask(volume, dataclasses.replace(airways, lumen_zyx=lumen.astype(np.uint8))) != 0


def test_air_voxels_beside_a_wall_are_added_to_the_exported_mask():
    lumen, mask = in_tube(-100, -870)
    off = np.hypot(*(np.mgrid[:24, :24] - 11.5))
    assert np.count_nonzero(mask) > 1.3 * np.count_nonzero(lumen)
    assert not mask[:, off >= 5.0].any()


def test_no_voxel_is_added_to_the_exported_mask_without_a_visible_wall():
    """Use a tube whose wall is as dark as lung: the search ended inside the tube for another reason than a wall."""
    lumen, mask = in_tube(-1000, -1000)
    assert np.array_equal(mask, lumen)
