"""Tests of the clearance along a route where the centreline is off-centre and where the lumen is not circular."""

from __future__ import annotations

import numpy as np
import pytest

from carina.plan.routes.clearance import INWARDS_MM, ball_diameters_mm
from carina.scopes import WallField
from carina.track import Branch

STEP_MM = 0.4


def field(half_x_mm: float, half_y_mm: float) -> WallField:
    """Return the wall field of a straight lumen along z: round, or a slit with round ends."""
    axis = np.arange(-7.0, 7.0 + 1e-9, STEP_MM)
    _, y, x = np.meshgrid(np.arange(0.0, 30.0, STEP_MM), axis, axis, indexing="ij")
    least = min(half_x_mm, half_y_mm)
    off = np.hypot(np.maximum(np.abs(x) - (half_x_mm - least), 0.0), np.maximum(np.abs(y) - (half_y_mm - least), 0.0))
    place = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    place[:3, 3] = [-7.0, -7.0, 0.0]
    return WallField.from_distances((least - off).astype(np.float32), place)


def line(off_mm: float, radius_mm: float) -> Branch:
    points = np.array([[off_mm, 0.0, z] for z in np.arange(3.0, 27.0, 0.5)])
    wall_mm = np.full(len(points), radius_mm - off_mm)
    return Branch(1, 0, (), 1, None, "tracked", points, np.full(len(points), radius_mm), wall_mm=wall_mm)


@pytest.mark.parametrize("radius_mm", [1.2, 1.7, 2.6, 4.0])
@pytest.mark.parametrize("off_mm", [0.0, 0.35, 0.6])
def test_clearance_of_a_round_lumen_does_not_depend_on_the_offset_of_the_centreline(
    radius_mm: float, off_mm: float
) -> None:
    found = ball_diameters_mm(line(off_mm, radius_mm), field(radius_mm, radius_mm))
    # The tolerance covers the interpolation of the field between its samples, which are exact and 0.4 mm apart.
    assert found == pytest.approx(2.0 * radius_mm, abs=0.12)


def test_clearance_of_a_flat_lumen_is_its_narrow_side() -> None:
    found = ball_diameters_mm(line(0.4, 2.4), field(4.0, 1.5))
    assert (found <= 3.0 + 2.0 * INWARDS_MM + 0.05).all() and (found >= 2.9).all()


def test_clearance_outside_the_wall_field_or_without_one_is_the_diameter_of_the_branch() -> None:
    branch = line(0.5, 2.0)
    assert ball_diameters_mm(branch, None) == pytest.approx(3.0)
    aside = Branch(
        1, 0, (), 1, None, "manual", branch.points + np.array([5.0, 0.0, 0.0]), branch.radius, wall_mm=branch.wall_mm
    )
    assert ball_diameters_mm(aside, field(2.0, 2.0)) == pytest.approx(3.0)
