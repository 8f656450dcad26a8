"""Tests of the directions that the tip of a scope can take in straight tubes of known width."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from carina.plan.routes.attainable_directions import AttainableTip, StandingPlace, TipDirections
from carina.scopes import ScopeDrive, ScopePreset, WallField, scope_preset
from carina.track import AirwayTree, Branch

ALONG_MM = 80.0
AXIS = np.array([0.0, 0.0, -1.0])
PLACE = StandingPlace(0, ALONG_MM, ALONG_MM * AXIS, AXIS)


@cache
def tube(radius_mm: float) -> tuple[AirwayTree, WallField]:
    """Return a straight tube downwards, 100 mm long."""
    points = np.linspace(0.0, 100.0, 201)[:, None] * AXIS
    tree = AirwayTree((Branch(0, None, (), 0, "Trachea", "tracked", points, np.full(201, radius_mm)),))
    half = math.ceil(2.5 * radius_mm)
    _, y, x = np.mgrid[0 : 2 * 110 + 1, -half : half + 1, -half : half + 1].astype(np.float32) * 0.5
    place = np.diag([0.5, 0.5, 0.5, 1.0])
    place[:3, 3] = -0.5 * half, -0.5 * half, -105.0
    return tree, WallField.from_distances(radius_mm - np.hypot(x, y), place)


def scope(tip_mm: float = 3.0) -> ScopePreset:
    return dataclasses.replace(scope_preset("thin"), tip_mm=tip_mm, tube_mm=None)


def towards(radius_mm: float, angle_deg: float, target_mm: float = 0.5, tip_mm: float = 3.0) -> AttainableTip | None:
    """Return the attainable tip for a target 14 mm from the place, at an angle to the axis of the tube."""
    tree, field = tube(radius_mm)
    rad = math.radians(angle_deg)
    aim = PLACE.point_lps + 14.0 * (math.cos(rad) * AXIS + math.sin(rad) * np.array([1.0, 0.0, 0.0]))
    return TipDirections(tree, field, scope(tip_mm)).towards(PLACE, aim, target_mm)


def test_direction_of_the_airway_is_attainable_in_every_tube_that_the_scope_fits() -> None:
    for radius_mm in (1.8, 2.5, 4.0, 8.0):
        ahead = towards(radius_mm, 0.0)
        assert ahead is not None and ahead.off_deg == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("radius_mm", [2.0, 2.5, 3.0])
def test_tilt_in_a_narrow_tube_is_limited_by_the_rigid_tip(radius_mm: float) -> None:
    # The 10 mm tip touches both sides of the tube at this angle.
    most_deg = math.degrees(math.asin(2.0 * (radius_mm - 1.5) / 10.0))
    reached = [angle for angle in np.arange(0.0, 60.0, 2.0) if towards(radius_mm, float(angle)) is not None]
    assert reached[0] == 0.0 and max(reached) <= most_deg + 8.0
    assert max(reached) >= 0.5 * most_deg


def test_wider_tube_or_thinner_scope_attains_more_and_a_larger_target_needs_less() -> None:
    def most(*given: float, **options: float) -> float:
        return max(
            (angle for angle in np.arange(0.0, 90.0, 3.0) if towards(given[0], float(angle), **options) is not None),
            default=-1.0,
        )

    assert most(2.0) < most(3.0) < most(6.0)
    assert most(3.0, tip_mm=4.2) < most(3.0, tip_mm=3.0) < most(3.0, tip_mm=2.0)
    assert most(2.5, target_mm=0.5) < most(2.5, target_mm=6.0)


@pytest.mark.parametrize("radius_mm", [2.2, 3.0, 5.0])
def test_no_hold_of_the_simulated_scope_points_far_beyond_the_attainable_directions(radius_mm: float) -> None:
    tree, field = tube(radius_mm)
    drive = ScopeDrive(field, scope(), tree.root.points)
    placed = drive.place(tree.root.points, ALONG_MM)
    held = []
    for flexion_deg in (20.0, 40.0, 80.0, 120.0, 180.0):
        forward = drive.drive(placed.insertion_mm, 0.0, math.radians(flexion_deg), 0.1).pose.lps_from_camera[:3, 2]
        held.append(math.degrees(math.acos(float(np.clip(forward @ AXIS, -1.0, 1.0)))))
    attained = [angle for angle in np.arange(0.0, 90.0, 3.0) if towards(radius_mm, float(angle)) is not None]
    assert max(held) <= max(attained) + 8.0, (max(held), max(attained))


def test_directions_of_a_scope_with_unknown_bending_section_are_not_known() -> None:
    tree, field = tube(3.0)
    assert not TipDirections(tree, field, scope_preset("ion")).is_known
