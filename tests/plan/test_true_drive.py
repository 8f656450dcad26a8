"""Tests of the true wall and the scope of `carina_bench.plan_true_drive`."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina.scopes import ScopeDrive, scope_preset
from carina_bench.plan_cases import Target, TrueTree
from carina_bench.plan_true_drive import LACK_MM, WIDE_MM, needle_hits_from, scope_in_truth, strikes, wall_along

SCOPE = scope_preset("ultrathin")
OBLIQUE = np.array([0.48, 0.36, -0.8])
PATH = np.linspace(0.0, 60.0, 121)[:, None] * OBLIQUE


def tube(radius_mm: float) -> TrueTree:
    """Return an oblique straight tube, 60 mm long."""
    return TrueTree.of([(PATH, np.full(len(PATH), radius_mm), -1)])


def test_wall_of_a_tube_is_too_narrow_by_no_more_than_the_stated_lack() -> None:
    found = wall_along(tube(1.7), PATH).distance_mm(PATH[20:-20])
    assert (found <= 1.7 + 0.01).all()
    assert (found >= 1.7 - 0.5 * LACK_MM - 0.02).all()


def test_lumen_far_from_the_path_counts_as_closed() -> None:
    wall = wall_along(tube(1.7), PATH[:40])
    assert wall.distance_mm(PATH[30:31])[0] > 1.0
    assert wall.distance_mm(PATH[100:101])[0] < 0.0


def test_scope_in_a_narrow_airway_is_thinner_by_the_lack_of_the_sampled_wall() -> None:
    assert scope_in_truth(SCOPE, SCOPE.tip_mm - 0.01) is None
    assert scope_in_truth(SCOPE, SCOPE.tip_mm + WIDE_MM) is SCOPE
    narrow = scope_in_truth(SCOPE, SCOPE.tip_mm + 0.1)
    assert narrow is not None
    assert narrow.tip_mm == pytest.approx(SCOPE.tip_mm - LACK_MM)


def test_scope_passes_an_airway_that_it_fits_and_stops_in_a_narrower_one() -> None:
    for radius_mm, passes in ((0.5 * SCOPE.tip_mm + 0.05, True), (0.5 * SCOPE.tip_mm - 0.35, False)):
        driven = dataclasses.replace(SCOPE, tip_mm=SCOPE.tip_mm - LACK_MM)
        radius = np.where(np.arange(len(PATH)) < 60, 3.0, radius_mm)
        wall = wall_along(TrueTree.of([(PATH, radius, -1)]), PATH)
        drive = ScopeDrive(wall, driven, PATH)
        drive.place(PATH, 20.0)
        for mm in range(21, 51):
            drive.drive(float(mm), 0.0, 0.0, 0.1)
        assert (drive.state.insertion_mm > 48.0) is passes


def test_needle_strikes_a_ball_ahead_and_not_one_beside_or_beyond_its_reach() -> None:
    pose = np.eye(4)
    ahead, beside = Target((0.0, 0.0, 12.0), 4.0), Target((9.0, 0.0, 12.0), 4.0)
    assert needle_hits_from(pose, ahead, 15.0) > 0.9
    assert strikes(pose, ahead, 15.0)
    assert not strikes(pose, beside, 15.0)
    assert not strikes(pose, ahead, 7.0)
