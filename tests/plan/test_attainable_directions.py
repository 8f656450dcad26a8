"""Tests of the directions that the tip of a scope can take in straight tubes of known width."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from cached_test_data import cached_airways, cached_phantom
from carina.plan.routes.attainable_directions import (
    BEHIND_MM,
    NUM_ON_ARC,
    RADII,
    SHAFT_LACK_MM,
    SMOOTH_MM,
    AttainableTip,
    StandingPlace,
    TipDirections,
)
from carina.scopes import ScopeDrive, ScopePreset, WallField, scope_preset
from carina.track import AirwayTree, Branch, wall_field

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
    """Return the attainable tip at `PLACE` for a target 14 mm away, in a direction at an angle to the tube's axis."""
    tree, field = tube(radius_mm)
    rad = math.radians(angle_deg)
    aim = PLACE.point_lps + 14.0 * (math.cos(rad) * AXIS + math.sin(rad) * np.array([1.0, 0.0, 0.0]))
    return TipDirections(tree, field, scope(tip_mm)).towards(PLACE, aim, target_mm)


def test_direction_along_the_airway_is_attainable_in_every_tube_wide_enough_for_the_scope() -> None:
    for radius_mm in (1.8, 2.5, 4.0, 8.0):
        ahead = towards(radius_mm, 0.0)
        assert ahead is not None and ahead.off_deg == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("radius_mm", [2.0, 2.5, 3.0])
def test_attainable_angle_in_a_narrow_tube_is_limited_by_the_rigid_tip(radius_mm: float) -> None:
    # The 10 mm tip touches both sides of the tube at this angle.
    most_deg = math.degrees(math.asin(2.0 * (radius_mm - 1.5) / 10.0))
    reached = [angle for angle in np.arange(0.0, 60.0, 2.0) if towards(radius_mm, float(angle)) is not None]
    assert reached[0] == 0.0 and max(reached) <= most_deg + 8.0
    assert max(reached) >= 0.5 * most_deg


def test_attainable_angle_increases_with_lumen_and_target_size_and_for_a_thinner_scope() -> None:
    def most(*given: float, **options: float) -> float:
        return max(
            (angle for angle in np.arange(0.0, 90.0, 3.0) if towards(given[0], float(angle), **options) is not None),
            default=-1.0,
        )

    assert most(2.0) < most(3.0) < most(6.0)
    assert most(3.0, tip_mm=4.2) < most(3.0, tip_mm=3.0) < most(3.0, tip_mm=2.0)
    assert most(2.5, target_mm=0.5) < most(2.5, target_mm=6.0)


@pytest.mark.parametrize("radius_mm", [2.2, 3.0, 5.0])
def test_simulated_scope_never_points_far_beyond_the_attainable_directions(radius_mm: float) -> None:
    tree, field = tube(radius_mm)
    drive = ScopeDrive(field, scope(), tree.root.points)
    placed = drive.place(tree.root.points, ALONG_MM)
    held = []
    for flexion_deg in (20.0, 40.0, 80.0, 120.0, 180.0):
        forward = drive.drive(placed.insertion_mm, 0.0, math.radians(flexion_deg), 0.1).pose.lps_from_camera[:3, 2]
        held.append(math.degrees(math.acos(float(np.clip(forward @ AXIS, -1.0, 1.0)))))
    attained = [angle for angle in np.arange(0.0, 90.0, 3.0) if towards(radius_mm, float(angle)) is not None]
    assert max(held) <= max(attained) + 8.0, (max(held), max(attained))


def test_attainable_directions_of_a_scope_with_unknown_bending_section_are_unknown() -> None:
    tree, field = tube(3.0)
    assert not TipDirections(tree, field, scope_preset("ion")).is_known


def bends_slowly(tree: AirwayTree, wall: WallField, preset: ScopePreset, place: StandingPlace, way) -> bool:
    """Return whether an arc leads from a tip at a place back into the airway; one arc and one point at a time."""
    tip = place.point_lps
    points = np.concatenate([branch.points for branch in tree.lineage(place.branch_id)])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

    def direction(mm: float) -> np.ndarray:
        low, high = (
            np.array([np.interp(min(max(end, 0.0), along[-1]), along, points[:, axis]) for axis in range(3)])
            for end in (mm - SMOOTH_MM, mm + SMOOTH_MM)
        )
        return (high - low) / max(float(np.linalg.norm(high - low)), 1e-9)

    assert preset.flexion_deg is not None and preset.bending_mm is not None and preset.rigid_tip_mm is not None
    bending_mm = float(np.mean(preset.bending_mm))
    rear, behind_mm = tip - preset.rigid_tip_mm * way, place.along_mm - preset.rigid_tip_mm
    for times in RADII:
        arc_mm = times * bending_mm / math.radians(max(preset.flexion_deg))
        angle, back = math.acos(np.clip(way @ direction(behind_mm), -1.0, 1.0)), way
        for _ in range(2):
            back = direction(behind_mm - arc_mm * angle)
            angle = math.acos(np.clip(way @ back, -1.0, 1.0))
        side = back - (back @ way) * way
        side /= max(np.linalg.norm(side), 1e-9)
        arc = [
            rear - arc_mm * (math.sin(turn) * way + (1.0 - math.cos(turn)) * side)
            for turn in np.linspace(0.0, angle, NUM_ON_ARC)
        ]
        arc.append(arc[-1] - BEHIND_MM * back)
        clearance_mm = min(float(wall.distance_mm(one[None])[0]) for one in arc)
        if arc_mm * angle <= bending_mm and clearance_mm >= 0.5 * preset.tip_mm - SHAFT_LACK_MM:
            return True
    return False


def test_bend_angles_computed_for_many_directions_equal_those_computed_one_by_one() -> None:
    made = {"seed": 4, "spacing_mm": 1.5, "generations": 4}
    volume, airways = cached_phantom(**made).volume, cached_airways(**made)
    wall, preset = wall_field(volume, airways), scope(2.0)
    directions, rng = TipDirections(airways.tree, wall, preset), np.random.default_rng(3)
    found, expected = [], []
    for branch in [one for one in airways.tree.branches if len(one.points) > 4][::3]:
        along_mm = sum(one.length_mm for one in airways.tree.lineage(branch.id)[:-1]) + 0.5 * branch.length_mm
        at = len(branch.points) // 2
        forward = branch.points[at + 1] - branch.points[at - 1]
        forward /= np.linalg.norm(forward)
        place = StandingPlace(branch.id, along_mm, branch.points[at], forward)
        ways = forward + 0.8 * rng.normal(size=(12, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        found += directions._bends(place, place.point_lps, ways, 1.0).tolist()
        expected += [bends_slowly(airways.tree, wall, preset, place, way) for way in ways]
    assert found == expected and 0.1 < np.mean(found) < 0.9
