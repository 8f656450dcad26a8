"""Tests of the least and largest voxel spacing of the class Volume."""

from __future__ import annotations

import numpy as np
import pytest

from carina.errors import GeometryError
from carina.volume import Volume

VALUES = np.zeros((3, 4, 5), dtype=np.int16)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("spacing_mm", [0.0099, 100.1, 1e-6, 1e6])
def test_voxel_spacing_below_a_hundredth_or_above_100_mm_is_refused(axis, spacing_mm):
    matrix = np.eye(4)
    matrix[axis, axis] = spacing_mm
    with pytest.raises(GeometryError, match=r"between 0.01 and 100 mm") as caught:
        Volume(VALUES, matrix)
    assert caught.value.code == "geometry.spacing"


@pytest.mark.parametrize("spacing_mm", [0.01, 100.0, np.float64(np.float32(0.01)), np.float64(np.float32(100.0))])
def test_voxel_spacing_at_both_limits_is_accepted(spacing_mm):
    assert Volume(VALUES, np.diag([spacing_mm, -spacing_mm, spacing_mm, 1.0])).spacing_mm[0] == spacing_mm
