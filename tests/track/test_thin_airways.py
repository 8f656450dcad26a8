"""Tests of the thinnest airways, which the search finds by the blurred profile of their walls."""

from __future__ import annotations

import numpy as np
import pytest

from carina._core import extend_thin_lumen

SHAPE_ZYX = (52, 52, 64)
SPACING_MM = 0.6
AIR, LUNG, WALL = -1000, -865, 20
LIMITS = {
    "air": float(AIR),
    "lung": (-950, -600),
    "brightest": -400,
    "least_wall": -700.0,
    "least_dip": 22.0,
    "least_mean_dip": 20.0,
    "blur_mm": 0.85,
    "min_length_mm": 2.0,
    "min_side_mm": 4.5,
    "most_reached": 1.0,
}


def chest(has_tube: bool):
    """Return lung with an airway along x that ends at 12 mm.

    With ``has_tube`` a tube of 1.2 mm diameter continues to 28 mm.
    """
    fine = 3
    z, y, x = (
        (np.arange(n * fine, dtype=np.float32) + 0.5).reshape(shape) * (SPACING_MM / fine) - SPACING_MM / 2
        for n, shape in zip(SHAPE_ZYX, ((-1, 1, 1), (1, -1, 1), (1, 1, -1)), strict=True)
    )
    off = np.hypot(y - 15.2 - 0.2 * (x - 12.0), z - 15.1 + 0.0 * x)
    hu = np.full(np.broadcast_shapes(off.shape, x.shape), LUNG, dtype=np.float32)
    radius = np.where(x < 12.0, 1.9, 0.6 if has_tube else 0.0)
    wall = np.where(x < 12.0, 0.9, 0.7 if has_tube else 0.0)
    inside = x < 28.0
    hu[inside & (off < radius + wall)] = WALL
    hu[inside & (off < radius)] = AIR
    nz, ny, nx = SHAPE_ZYX
    hu = hu.reshape(nz, fine, ny, fine, nx, fine).mean(axis=(1, 3, 5))
    for axis in range(3):
        hu = 0.76 * hu + 0.12 * (np.roll(hu, 1, axis) + np.roll(hu, -1, axis))
    noisy = hu + np.random.default_rng(4).normal(0.0, 25.0, hu.shape)
    at = (slice(None, None, fine),) * 3
    known = np.broadcast_to((x < 11.5) & (off < 1.6), np.broadcast_shapes(off.shape, x.shape))
    return np.rint(noisy).astype(np.int16), np.ascontiguousarray(known[at]).astype(np.uint8)


def followed(has_tube: bool, limits=LIMITS):
    hu, lumen = chest(has_tube)
    affine = np.diag([SPACING_MM, SPACING_MM, SPACING_MM, 1.0])
    before = lumen.copy()
    found = extend_thin_lumen(hu, affine, lumen, cancel=None, progress=None, **limits)
    assert (lumen[before == 1] == 1).all()
    return found, lumen


def test_tube_two_voxels_wide_is_followed_to_its_end_beyond_the_flood_fill():
    hu, _ = chest(True)
    row = hu[25, :, 34:44].min(axis=0)
    # No voxel of the thin tube is as dark as air, so the flood fill ends before it.
    assert row.min() > -950
    found, lumen = followed(True)
    assert 22.0 < SPACING_MM * np.argwhere(lumen > 1)[:, 2].max() < 29.5
    assert sum(way["length_mm"] for way in found["followed"]) == pytest.approx(16.0, abs=3.0)
    assert all(way["contrast"] > 1.0 for way in found["followed"])


def test_no_lumen_is_added_in_lung_beyond_the_end_of_an_airway():
    found, lumen = followed(False)
    assert found["followed"] == []
    assert lumen.max() == 1


def test_no_thin_lumen_is_added_if_the_search_reaches_more_lung_than_airways_can():
    hu, lumen = chest(True)
    hu, lumen = np.tile(hu, (12, 1, 1)), np.tile(lumen, (12, 1, 1))
    affine = np.diag([SPACING_MM, SPACING_MM, SPACING_MM, 1.0])
    found = extend_thin_lumen(hu, affine, lumen, cancel=None, progress=None, **{**LIMITS, "most_reached": 1e-5})
    assert found["ran_out"] and found["followed"] == []
    assert lumen.max() == 1


def test_lumen_mask_with_another_shape_than_the_volume_is_refused():
    hu, lumen = chest(True)
    with pytest.raises(ValueError, match="lumen_zyx"):
        extend_thin_lumen(hu, np.eye(4), lumen[:-1].copy(), cancel=None, progress=None, **LIMITS)
