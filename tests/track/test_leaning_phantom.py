"""Tests of the phantom with a leaning trachea: voxels and ground truth lean by the same amount."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carina.errors import UsageError
from carina.phantom import generate_phantom


def test_phantom_and_its_ground_truth_lean_only_above_the_carina() -> None:
    options: dict[str, Any] = {
        "seed": 3,
        "spacing_mm": (0.9, 0.9, 4.0),
        "generations": 3,
        "neck": True,
        "noise_hu": 0.0,
    }
    box = ((-80.0, -50.0, -30.0), (30.0, 40.0, 130.0))
    upright = generate_phantom(**options, box_lps=box)
    leaning = generate_phantom(**options, box_lps=box, lean_deg=(-20.0, 10.0))
    assert leaning.volume.shape_zyx == upright.volume.shape_zyx
    np.testing.assert_allclose(leaning.volume.lps_from_ijk, upright.volume.lps_from_ijk, atol=1e-9)
    heights = upright.volume.lps_from_ijk[2, 3] + 4.0 * np.arange(upright.volume.shape_zyx[0])
    np.testing.assert_array_equal(leaning.volume.hu_zyx[heights < -10.0], upright.volume.hu_zyx[heights < -10.0])
    cricoid, before = np.array(leaning.truth["cricoid_lps"]), np.array(upright.truth["cricoid_lps"])
    np.testing.assert_allclose(
        cricoid - before, [-np.tan(np.radians(20.0)) * before[2], np.tan(np.radians(10.0)) * before[2], 0.0]
    )
    # The lumen follows the leaning centreline, and the true radius is that of a section perpendicular to it.
    trachea = leaning.truth["branches"][0]
    points, radius = np.array(trachea["points"]), np.array(trachea["radius"])
    inside, was_inside = np.argwhere(leaning.lumen_zyx > 0), np.argwhere(upright.lumen_zyx > 0)
    for n in range(10, len(points) - 20, 10):
        k = round((points[n][2] - heights[0]) / 4.0)
        voxels, former = inside[inside[:, 0] == k], was_inside[was_inside[:, 0] == k]
        moved = 0.9 * (voxels.mean(axis=0) - former.mean(axis=0))[:0:-1]
        np.testing.assert_allclose(moved, np.tan(np.radians([-20.0, 10.0])) * heights[k], atol=0.35)
        along = points[n + 1] - points[n]
        across_mm2 = 0.81 * len(voxels) * abs(along[2]) / np.linalg.norm(along)
        assert across_mm2 == pytest.approx(np.pi * radius[n] ** 2, rel=0.08)


@pytest.mark.parametrize(
    "options", [{"lean_deg": (40.0, 0.0)}, {"lean_deg": (10.0,)}, {"lean_deg": (10.0, 0.0), "nodule": True}]
)
def test_phantom_with_an_invalid_lean_angle_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="lean"):
        generate_phantom(spacing_mm=6.0, generations=3, **options)
