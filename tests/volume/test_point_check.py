"""Tests of the check that a point lies inside the scan."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carina.errors import UsageError
from carina.volume import Volume
from carina.volume.point_check import check_in_volume


def a_volume():
    """Return a scan that lies right of the patient's middle, between x -110.5 and -90.5."""
    moved = np.eye(4)
    moved[:3, 3] = (-110.0, 20.0, -300.0)
    return Volume(np.zeros((10, 20, 20), np.int16), moved)


def test_point_is_accepted_up_to_half_a_voxel_beyond_the_outer_voxels():
    check_in_volume(a_volume(), (-110.4, 20.0, -300.0), "the target")
    with pytest.raises(UsageError):
        check_in_volume(a_volume(), (-110.6, 20.0, -300.0), "the target")


def test_message_about_a_point_outside_the_scan_states_the_point_and_the_bounds_of_the_scan():
    with pytest.raises(UsageError) as refused:
        check_in_volume(a_volume(), (0.0, 0.0, 0.04), "the target", code="plan.point")
    assert str(refused.value) == (
        "the target 0,0,0 lies outside the scan, which lies within "
        "x -110.5 to -90.5, y 19.5 to 39.5, z -300.5 to -290.5 mm (LPS)"
    )
    assert refused.value.code == "plan.point"


def test_message_about_a_point_given_in_ras_states_the_lps_point():
    with pytest.raises(UsageError, match=r"in RAS coordinates, as in 3D Slicer, give -100,30,-295$"):
        check_in_volume(a_volume(), (100.0, -30.0, -295.0), "the target")


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_coordinate_that_is_not_finite_is_refused(bad):
    with pytest.raises(UsageError, match="lies outside the scan"):
        check_in_volume(a_volume(), (bad, 30.0, -295.0), "the target")
