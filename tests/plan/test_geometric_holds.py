"""Tests of the geometric search of holds, the reference of `carina_bench.plan_truth`, in straight tubes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from carina.scopes import scope_preset
from carina_bench.plan_cases import Target, TrueTree
from carina_bench.plan_holds import LumenDepth, find_hold, needle_hits

SCOPE = scope_preset("ultrathin")
REACH_MM = 15.0


def tube(radius_mm: float) -> TrueTree:
    """Return a straight tube downwards, 120 mm long, whose second half is another branch."""
    points = np.linspace(0.0, 120.0, 241)[:, None] * np.array([0.0, 0.0, -1.0])
    radius = np.full(241, radius_mm)
    return TrueTree.of([(points[:121], radius[:121], -1), (points[120:], radius[120:], 0)])


def target(angle_deg: float, radius_mm: float = 4.0, distance_mm: float = 14.0) -> Target:
    """Return a target at an angle to the tube's axis, seen from the middle of the tube's second half."""
    rad = math.radians(angle_deg)
    return Target((distance_mm * math.sin(rad), 0.0, -90.0 - distance_mm * math.cos(rad)), radius_mm)


def test_depth_in_a_tube_is_its_radius_on_the_axis_and_negative_outside() -> None:
    lumen = LumenDepth(tube(4.0), np.array([0.0, 0.0, -60.0]), 20.0)
    found = lumen.at(np.array([[0.0, 0.0, -60.0], [3.0, 0.0, -60.0], [6.0, 0.0, -60.0]]))
    assert found[:2] == pytest.approx([4.0, 1.0], abs=0.4)
    assert found[2] < -1.0


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


def test_only_tips_near_a_given_point_count() -> None:
    far = np.array([0.0, 0.0, -20.0])
    assert find_hold(tube(3.0), target(0.0), SCOPE, REACH_MM, near_lps=far, near_mm=5.0) is None
