"""Tests of flights between turns: each flight leads from the picture of one turn to that of the next, without jumps."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from fork_trees import random_tree, route_in
from hypothesis import given, settings
from hypothesis import strategies as st

from carina.errors import NoResultError, UsageError
from carina.plan import turn_flight, turn_list
from carina.scopes import Pose, upright

SEEDS = st.integers(0, 10_000)
quick = settings(max_examples=12, deadline=None)


def angle_deg(one: Pose, other: Pose) -> float:
    turned = one.lps_from_camera[:3, :3].T @ other.lps_from_camera[:3, :3]
    return math.degrees(math.acos(float(np.clip((np.trace(turned) - 1.0) / 2.0, -1.0, 1.0))))


def away_mm(points: np.ndarray, line: np.ndarray) -> float:
    """Return the largest distance of the points from a polyline, mm."""
    a, b = line[:-1], line[1:]
    along = b - a
    squared = (along**2).sum(axis=1)
    a, along, squared = a[squared > 0.0], along[squared > 0.0], squared[squared > 0.0]
    share = np.clip(((points[:, None] - a) * along).sum(axis=2) / squared, 0.0, 1.0)
    return float(np.linalg.norm(points[:, None] - a - share[..., None] * along, axis=2).min(axis=1).max())


@quick
@given(SEEDS, st.sampled_from(["head", "facing"]))
def test_flight_between_turns_begins_and_ends_with_the_camera_poses_of_their_pictures(seed: int, operator: str) -> None:
    tree = random_tree(seed)
    route = route_in(tree, tree.tips()[seed % len(tree.tips())].id)
    found = turn_list(tree, route)
    line = np.concatenate([branch.points for branch in tree.lineage(route.branch_id)])
    for index in range(len(found.turns) + 1):
        times, poses = turn_flight(tree, route, found, index, operator=operator)  # type: ignore[arg-type]
        assert len(times) == len(poses) and times[0] == 0.0 and (np.diff(times) > 0.0).all()
        if index > 0:
            start = found.turns[index - 1].camera(operator)  # type: ignore[arg-type]
            assert np.allclose(poses[0].lps_from_camera, start.lps_from_camera, atol=1e-6)
        if index < len(found.turns):
            end = found.turns[index].camera(operator)  # type: ignore[arg-type]
            assert np.allclose(poses[-1].lps_from_camera, end.lps_from_camera, atol=1e-6)
        else:
            assert np.linalg.norm(poses[-1].position_lps - np.array(route.leg.tip_lps)) < 0.6
        sign = 1.0 if operator == "head" else -1.0
        for pose in (poses[0], poses[-1]):
            assert np.allclose(-pose.down_lps, sign * upright(pose.forward_lps), atol=1e-6)
        # The tolerance is the smoothing of the path plus the offset at its ends.
        assert away_mm(np.array([pose.position_lps for pose in poses]), line) < 1.1
        assert max(angle_deg(a, b) for a, b in itertools.pairwise(poses)) < 12.0


@quick
@given(SEEDS)
def test_flight_to_a_turn_for_an_operator_facing_the_patient_is_rotated_by_180_degrees(seed: int) -> None:
    tree = random_tree(seed)
    route = route_in(tree, tree.tips()[0].id)
    found = turn_list(tree, route)
    for index in (0, 1, len(found.turns)):
        times, head = turn_flight(tree, route, found, index)
        other, facing = turn_flight(tree, route, found, index, operator="facing")
        assert np.allclose(times, other)
        for one, two in zip(head, facing, strict=True):
            assert np.allclose(one.position_lps, two.position_lps, atol=1e-6)
            assert np.allclose(one.right_lps, -two.right_lps, atol=1e-5)


def test_consecutive_flights_between_turns_of_a_route_join_without_a_jump() -> None:
    tree = random_tree(7)
    route = route_in(tree, tree.tips()[2].id)
    found = turn_list(tree, route)
    flights = [turn_flight(tree, route, found, index)[1] for index in range(len(found.turns) + 1)]
    for before, after in itertools.pairwise(flights):
        assert np.allclose(before[-1].lps_from_camera, after[0].lps_from_camera, atol=1e-6)


def test_flight_to_a_turn_has_the_requested_speed_and_frame_rate() -> None:
    tree = random_tree(1)
    route = route_in(tree, tree.tips()[0].id)
    times, poses = turn_flight(tree, route, turn_list(tree, route), 0, speed_mm_s=10.0, rate_hz=50.0)
    assert np.diff(times) == pytest.approx(0.02, rel=0.02)
    steps = [float(np.linalg.norm(b.position_lps - a.position_lps)) for a, b in itertools.pairwise(poses)]
    assert max(steps) <= 10.0 * 0.02 * 1.1


def test_flight_to_a_turn_with_invalid_arguments_is_refused() -> None:
    tree = random_tree(1)
    route = route_in(tree, tree.tips()[0].id)
    found = turn_list(tree, route)
    for change in ({"speed_mm_s": 0.0}, {"rate_hz": math.nan}):
        with pytest.raises(UsageError):
            turn_flight(tree, route, found, 0, **change)
    for index in (-1, len(found.turns) + 1):
        with pytest.raises(UsageError):
            turn_flight(tree, route, found, index)
    still = route_in(tree, 0, share=0.6)
    object.__setattr__(still, "along_mm", 0.0)
    with pytest.raises(NoResultError):
        turn_flight(tree, still, turn_list(tree, still), 0)
