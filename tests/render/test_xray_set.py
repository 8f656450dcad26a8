"""Tests of the three X-rays side by side (paper 3.1, Figure 2)."""

from __future__ import annotations

import numpy as np
import pytest

import carina as product
from carina.render import XRAY_AXES, XrayView, render_xray_set
from carina.volume import Volume


@pytest.fixture(scope="module")
def volume():
    """Return a box of 60 x 80 x 120 mm with one bright voxel at (10, 20, 30) mm."""
    values = np.full((60, 40, 30), -1000, np.int16)
    values[15, 10, 5] = 3000
    return Volume(values, np.diag([2.0, 2.0, 2.0, 1.0]))


def test_three_xrays_are_side_by_side_in_one_scale(volume):
    found = render_xray_set(volume, size=120)
    assert found.picture.rgb.shape == (120, 3 * 120 + 2 * 4, 3)
    assert [part.view for part in found.parts] == [f"xray-{axis}" for axis in XRAY_AXES]
    assert [part.rgb.shape[:2] for part in found.parts] == [(120, 60), (120, 80), (80, 60)]
    assert found.mm_per_px == pytest.approx(1.0)
    for part in found.parts:
        column, row = part.pixel_of((10.0, 20.0, 30.0))
        assert part.rgb[int(row), int(column)].min() == 255
        assert np.linalg.norm(part.lps_from_pixel[:3, 0]) == pytest.approx(1.0)


def test_tip_is_marked_in_all_three_xrays(volume):
    plain = render_xray_set(volume, size=120)
    marked = render_xray_set(volume, size=120, tip_lps=(30.0, 40.0, 60.0))
    changed = (plain.picture.rgb != marked.picture.rgb).any(axis=2)
    for n in range(3):
        columns = np.flatnonzero(changed[:, n * 124 : n * 124 + 120].any(axis=0))
        # The tip is in the middle of the volume, so its mark is in the middle of each square.
        assert columns.size and abs(columns.mean() - 60.0) < 2.0


def test_window_of_the_set_applies_to_each_xray(volume):
    found = render_xray_set(volume, size=64, window_hu=(1500.0, -600.0))
    for axis, part in zip(XRAY_AXES, found.parts, strict=True):
        height, width = part.rgb.shape[:2]
        alone = product.Renderer(volume).render(XrayView(axis, width, height, (1500.0, -600.0)))
        assert np.array_equal(part.rgb, alone.rgb)
