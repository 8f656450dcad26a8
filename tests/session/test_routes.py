"""Tests of targets and routes of a session: tracking, choice, undo, stops before forks, and scopes that fit."""

from __future__ import annotations

import numpy as np
import pytest

from carina.case.routes import RouteSpan, lookouts_mm, route_to_branch
from carina.commands import AddTarget, ChooseRoute, GoTo, NextFork, PreviousFork, RemoveTarget, SetLumenThreshold
from carina.errors import NoResultError, UsageError
from carina.session import UserMessage
from carina.track import AirwayTree, Branch
from small_case import (
    LEFT_TIP,
    OUTSIDE_LUMEN,
    RIGHT_TIP,
    session_fixture,
)


def test_adding_a_target_is_undone_and_redone_with_its_route():
    fixture = session_fixture()
    fixture.open()
    default_route = fixture.session.snapshot().document.route
    fixture.session.do(AddTarget(LEFT_TIP))
    fixture.background.run_all()
    snapshot = fixture.session.snapshot()
    (target,) = snapshot.document.targets
    assert target.problem is None
    assert target.length_mm == pytest.approx(snapshot.document.route.length_mm)
    assert snapshot.document.route.target_id == target.target_id
    assert snapshot.undo_label == "add Target 1"

    fixture.session.undo()
    snapshot = fixture.session.snapshot()
    assert snapshot.document.targets == ()
    assert snapshot.document.route is default_route
    assert (snapshot.undo_label, snapshot.redo_label) == (None, "add Target 1")

    fixture.session.redo()
    assert fixture.session.snapshot().document.targets == (target,)
    assert fixture.session.snapshot().document.route.target_id == target.target_id


def test_target_beside_the_lumen_gets_a_path_into_the_lumen_with_a_message():
    fixture = session_fixture()
    fixture.open()
    beside = (LEFT_TIP[0], LEFT_TIP[1] + 2.0, LEFT_TIP[2])
    fixture.session.do(AddTarget(beside))
    fixture.background.run_all()
    (target,) = fixture.session.snapshot().document.targets
    assert target.snapped_mm == pytest.approx(2.0)
    assert target.lps == beside
    assert UserMessage("Target 1 was moved 2.0 mm into the nearest lumen") in fixture.events


def test_target_far_from_the_lumen_is_stored_without_a_path_and_with_the_reason():
    fixture = session_fixture()
    fixture.open()
    route = fixture.session.snapshot().document.route
    fixture.session.do(AddTarget(OUTSIDE_LUMEN))
    fixture.background.run_all()
    document = fixture.session.snapshot().document
    (target,) = document.targets
    assert "nearest lumen is" in target.problem
    assert target.route is None
    assert target.used_lps is None
    assert document.route is route
    with pytest.raises(NoResultError, match="no path to Target 1"):
        fixture.session.do(ChooseRoute(target_id=target.target_id))


def test_target_outside_the_volume_is_refused():
    fixture = session_fixture()
    fixture.open()
    with pytest.raises(UsageError, match=r"the point 5000,0,0 lies outside the scan, which lies within x"):
        fixture.session.do(AddTarget((5000.0, 0.0, 0.0)))


def test_removing_a_target_removes_its_route_and_undo_restores_both():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(AddTarget(LEFT_TIP))
    fixture.background.run_all()
    fixture.session.do(RemoveTarget("target-1"))
    document = fixture.session.snapshot().document
    assert (document.targets, document.route) == ((), None)
    assert fixture.session.snapshot().mode == "free"
    fixture.session.undo()
    assert fixture.session.snapshot().document.route.target_id == "target-1"


def test_choosing_a_branch_makes_it_the_route_and_an_unknown_branch_is_refused():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(ChooseRoute(branch_id=2))
    route = fixture.session.snapshot().document.route
    assert route.title == "LMB"
    fixture.session.do(GoTo(route.length_mm))
    np.testing.assert_allclose(fixture.session.pose_info().pose.position_lps, LEFT_TIP, atol=0.6)
    with pytest.raises(UsageError, match="no branch 77"):
        fixture.session.do(ChooseRoute(branch_id=77))


def test_paths_to_targets_are_searched_again_in_new_airways():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(AddTarget(LEFT_TIP))
    fixture.background.run_all()
    old = fixture.session.snapshot().document.targets[0]
    fixture.session.do(SetLumenThreshold(-850.0))
    fixture.background.run_all()
    document = fixture.session.snapshot().document
    assert document.lumen_threshold == -850.0
    assert document.targets[0].route is not old.route
    assert document.route is document.targets[0].route


def test_tip_of_a_right_branch_has_a_lower_lps_x_than_that_of_a_left_branch():
    assert RIGHT_TIP[0] < LEFT_TIP[0]


def test_flight_stops_before_each_fork_in_both_directions():
    fixture = session_fixture()
    fixture.open()
    route = fixture.session.snapshot().document.route
    assert len(route.lookouts_mm) == len(route.forks_mm) == 2
    for stop_mm, fork_mm, span in zip(route.lookouts_mm, route.forks_mm, route.spans, strict=False):
        assert (span.from_mm + fork_mm) / 2.0 - 1e-9 <= stop_mm < fork_mm
    # The trachea of the small case is 12 mm wide and much longer than two diameters.
    assert route.lookouts_mm[0] == pytest.approx(route.forks_mm[0] - 12.0)
    stops = []
    for _ in range(3):
        fixture.session.do(NextFork())
        stops.append(fixture.session.pose_info().path_mm)
    assert stops == pytest.approx([*route.lookouts_mm, route.length_mm])
    fixture.session.do(PreviousFork())
    fixture.session.do(PreviousFork())
    assert fixture.session.pose_info().path_mm == pytest.approx(route.lookouts_mm[0])


def test_flight_stop_of_a_short_branch_is_in_its_middle_and_stops_are_in_order():
    cumulative_mm = np.arange(0.0, 61.0)
    spans = tuple(
        RouteSpan(n, None, n, from_mm, to_mm)
        for n, (from_mm, to_mm) in enumerate([(0, 40), (40, 44), (44, 44), (44, 60)])
    )
    stops = lookouts_mm((40.0, 44.0, 44.0), spans, cumulative_mm, np.full(61, 5.0))
    # The lumen is 10 mm wide: the first stop is one diameter before its fork, the second in the middle of the 4 mm
    # branch, the third at the fork.
    assert stops == (30.0, 42.0, 44.0)


def test_route_states_the_wall_distance_besides_the_lumen_radius():
    along = np.linspace(0.0, 40.0, 41)
    points = np.stack([0 * along, 0 * along, -along], axis=1)
    flat = np.where(np.abs(along - 20.0) < 5.0, 1.0, 3.0)
    # The middle is a slit, whose area equals that of the other sections, but through which no thick scope passes.
    tree = AirwayTree((Branch(0, None, (), 0, "Trachea", "tracked", points, np.full(41, 3.0), wall_mm=flat),))
    route = route_to_branch(tree, 0)
    assert len(route.wall_mm) == len(route.points_lps)
    middle = np.abs(route.cumulative_mm - 20.0) < 4.0
    assert middle.any()
    assert (route.wall_mm[middle] == 1.0).all()
    assert (route.wall_mm[route.cumulative_mm < 14.0] == 3.0).all()
    assert (route.radius_mm == 3.0).all()


def test_selecting_another_route_moves_the_tip_to_the_end_of_the_last_common_branch():
    fixture = session_fixture()
    fixture.open()
    session = fixture.session
    session.do(AddTarget(RIGHT_TIP))
    fixture.background.run_all()
    session.do(AddTarget(LEFT_TIP))
    fixture.background.run_all()
    right, left = session.snapshot().document.targets
    session.do(ChooseRoute(target_id=right.target_id))
    session.do(GoTo(1e4))
    assert session.pose_info().path_mm == pytest.approx(right.route.path.length_mm)
    session.do(ChooseRoute(target_id=left.target_id))
    common = left.route.spans[0]
    assert session.pose_info().mode == "path"
    assert session.pose_info().path_mm == pytest.approx(common.to_mm, abs=0.5)
    # In the common part of both routes the tip does not move.
    session.do(GoTo(0.5 * common.to_mm))
    before = session.pose_info().pose.position_lps
    session.do(ChooseRoute(target_id=right.target_id))
    assert np.linalg.norm(session.pose_info().pose.position_lps - before) < 0.5
