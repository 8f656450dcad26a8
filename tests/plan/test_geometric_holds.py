"""Tests of the geometric search of holds, the reference of `carina_bench.plan_truth`, in straight tubes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from carina.scopes import scope_preset
from carina_bench.plan_cases import Target, TrueTree
from carina_bench.plan_holds import YIELD_MM, LumenDepth, find_hold, needle_hits

SCOPE = scope_preset("ultrathin")
REACH_MM = 15.0


DOWN = np.array([0.0, 0.0, -1.0])
OBLIQUE = np.array([0.48, 0.36, -0.8])


def tube(radius_mm: float, *, end_mm: float | None = None, along: NDArray[np.float64] = DOWN) -> TrueTree:
    """Return a straight tube, 120 mm long, whose second half is another branch with the radius ``end_mm``."""
    points = np.linspace(0.0, 120.0, 241)[:, None] * along
    radius = np.full(241, radius_mm)
    radius[120:] = radius_mm if end_mm is None else end_mm
    return TrueTree.of([(points[:121], radius[:121], -1), (points[120:], radius[120:], 0)])


def target(angle_deg: float, radius_mm: float = 4.0, distance_mm: float = 14.0) -> Target:
    """Return a target at an angle to the tube's axis, seen from the middle of the tube's second half."""
    rad = math.radians(angle_deg)
    return Target((distance_mm * math.sin(rad), 0.0, -90.0 - distance_mm * math.cos(rad)), radius_mm)


def test_depth_in_a_tube_is_its_radius_on_the_axis_and_negative_outside() -> None:
    lumen = LumenDepth(tube(4.0), np.array([0.0, 0.0, -60.0]), 20.0)
    found = lumen.at(np.array([[0.0, 0.0, -60.0], [3.0, 0.0, -60.0], [6.0, 0.0, -60.0]]))
    # The balls of the centreline are 0.3 mm apart, so a point between two of them is at most 0.02 mm less deep.
    assert found[:2] == pytest.approx([4.0, 1.0], abs=0.02)
    assert found[2] < -1.0


def test_depth_is_exact_between_the_corners_of_the_grid() -> None:
    lumen = LumenDepth(tube(1.7, along=OBLIQUE), 60.0 * OBLIQUE, 20.0)
    axis = np.linspace(50.0, 70.0, 97)[:, None] * OBLIQUE
    assert lumen.at(axis) == pytest.approx(1.7, abs=0.02)


def test_hold_is_found_for_a_target_ahead() -> None:
    found = find_hold(tube(3.0), target(0.0), SCOPE, REACH_MM)
    assert found is not None
    assert needle_hits(found.tip_lps, found.forward, target(0.0), REACH_MM) >= 0.5


def test_target_beside_a_narrow_tube_has_no_hold_and_beside_a_wide_tube_has_one() -> None:
    beside = target(90.0, distance_mm=16.0)
    assert find_hold(tube(2.5), beside, SCOPE, REACH_MM) is None
    assert find_hold(tube(11.0), beside, SCOPE, REACH_MM) is not None


def test_target_has_no_hold_in_a_tube_that_the_scope_does_not_fit() -> None:
    assert find_hold(tube(1.6), target(0.0), SCOPE, REACH_MM) is None
    assert find_hold(tube(1.6), target(0.0), dataclasses.replace(SCOPE, tip_mm=2.0), REACH_MM) is not None


def test_hold_is_found_in_a_narrow_tube_by_small_changes_of_the_grid() -> None:
    ahead = Target((0.0, 0.0, -104.0), 3.0)
    aside = Target((2.2, 0.0, -104.0), 3.0)
    for one in (ahead, aside):
        found = find_hold(tube(1.8), one, SCOPE, REACH_MM)
        assert found is not None
        assert needle_hits(found.tip_lps, found.forward, one, REACH_MM) >= 0.5
        clearance_mm = LumenDepth(tube(1.8), found.tip_lps, 20.0).at(
            found.tip_lps - np.array([[2.0], [9.0]]) * found.forward
        )
        assert (clearance_mm >= 0.5 * SCOPE.tip_mm - YIELD_MM).all()


def test_tip_cannot_be_held_in_a_branch_narrower_than_the_scope_needs() -> None:
    beyond = Target((0.0, 0.0, -110.0), 4.0)
    assert find_hold(tube(3.0, end_mm=1.75), beyond, SCOPE, REACH_MM) is not None
    # The stated diameter of 3 mm passes this branch, but the diameter with its excess of 0.4 mm does not.
    assert find_hold(tube(3.0, end_mm=1.6), beyond, SCOPE, REACH_MM) is None


def test_only_tips_near_a_given_point_count() -> None:
    far = np.array([0.0, 0.0, -20.0])
    assert find_hold(tube(3.0), target(0.0), SCOPE, REACH_MM, near_lps=far, near_mm=5.0) is None
