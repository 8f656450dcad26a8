"""Tests of the path of a flight: positions, camera frames and forks."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carina.errors import UsageError
from carina.navigate import FlightPath
from carina.track import AirwayTree, Branch, TrackedPath
from carina.track.tree.airway_tree import Route


def bent_path() -> np.ndarray:
    """Return a path (LPS mm) down the trachea and then 60 degrees to the left, with uneven steps like a real route."""
    down = [[2.0, -5.0, 120.0 - z] for z in (0.0, 7.0, 20.0, 55.0, 80.0)]
    aside = np.array([np.sin(np.radians(60.0)), 0.1, -np.cos(np.radians(60.0))])
    corner = np.array(down[-1])
    return np.array([*down, *(corner + s * aside / np.linalg.norm(aside) for s in (3.0, 9.0, 25.0, 40.0))])


def test_path_positions_in_millimetres_are_lengths_along_the_given_points() -> None:
    points = bent_path()
    path = FlightPath(points)
    cumulative = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    assert path.length_mm == pytest.approx(cumulative[-1], abs=1e-9)
    for point, mm in zip(points, cumulative, strict=True):
        # Tolerance 0.5 mm: the documented deviation.
        assert np.linalg.norm(path.pose_at(mm).position_lps - point) <= 0.5
        assert path.nearest_mm(point) == pytest.approx(mm, abs=0.5)


def test_head_end_view_has_anterior_up_and_patient_right_on_the_right() -> None:
    pose = FlightPath(bent_path()).pose_at(10.0)
    np.testing.assert_allclose(pose.forward_lps, [0, 0, -1], atol=1e-6)
    np.testing.assert_allclose(-pose.down_lps, [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(pose.right_lps, [-1, 0, 0], atol=1e-6)


def test_view_turns_towards_the_next_bend_before_the_tip_reaches_it_without_jumps() -> None:
    path = FlightPath(bent_path())
    before = path.pose_at(78.0)
    assert np.degrees(np.arccos(-before.forward_lps[2])) > 10.0
    steps = [path.pose_at(mm) for mm in np.arange(0.0, path.length_mm, 0.5)]
    turns = [
        np.degrees(
            np.arccos(np.clip((np.trace(a.lps_from_camera[:3, :3].T @ b.lps_from_camera[:3, :3]) - 1) / 2, -1, 1))
        )
        for a, b in itertools.pairwise(steps)
    ]
    # The path bends by 60 degrees, and directions are smoothed by a Gaussian of 4 mm, so the view turns by at most
    # 60 / (4 sqrt(2 pi)) = 6 degrees per mm: 3 degrees per step of 0.5 mm.
    assert max(turns) < 3.1


@given(st.lists(st.tuples(*[st.floats(-5, 5)] * 3), min_size=2, max_size=30), st.floats(-10, 500))
def test_every_pose_is_rigid_on_any_path(steps: list[tuple[float, float, float]], path_mm: float) -> None:
    points = np.cumsum(np.array(steps), axis=0)
    try:
        path = FlightPath(points)
    except UsageError:
        return  # all points the same
    path.pose_at(path_mm)  # Pose refuses a matrix that is not rigid


def test_next_and_previous_fork_of_a_path_are_found() -> None:
    path = FlightPath(bent_path(), forks_mm=[80.0, 30.0])
    assert path.forks_mm == (30.0, 80.0)
    assert path.next_fork_mm(0.0) == 30.0
    assert path.next_fork_mm(30.0) == 80.0
    assert path.next_fork_mm(100.0) == path.length_mm
    assert path.previous_fork_mm(80.0) == 30.0
    assert path.previous_fork_mm(30.0) == 0.0


@pytest.mark.parametrize(
    ("points", "options", "says"),
    [
        ([[0, 0, 0]], {}, "at least two different points"),
        ([[0, 0], [1, 1]], {}, r"shape \(n, 3\)"),
        ([[0, 0, 0], [0, np.nan, 9]], {}, "not finite"),
        ([[0, 0, 0], [0, 0, 9]], {"up_lps": [0, 0, 1]}, "up direction"),
        ([[0, 0, 0], [0, 0, 9]], {"max_deviation_mm": 0.0}, "between 0.2 and 10"),
        ([[0, 0, 0], [0, 0, 9]], {"forks_mm": [11.0]}, "forks must lie on the path"),
    ],
)
def test_flight_path_with_invalid_points_is_refused_with_the_reason(points: list, options: dict, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        FlightPath(points, **options)


def route() -> Route:
    """Return the route to the second of two branches, with one fork."""
    points = bent_path()
    trunk = Branch(0, None, (1,), 0, "Trachea", "tracked", points[:5], np.full(5, 8.0))
    child = Branch(1, 0, (), 1, "LMB", "tracked", points[4:], np.full(5, 5.0))
    return AirwayTree((trunk, child)).route_to(1)


def test_flight_path_of_a_route_has_the_points_and_forks_of_the_route() -> None:
    path, by_points = FlightPath(route()), FlightPath(route().points_lps)
    assert path.forks_mm == tuple(route().forks_mm) and len(path.forks_mm) == 1
    assert path.lookouts_mm == path.forks_mm
    np.testing.assert_array_equal(path.points_lps, by_points.points_lps)
    assert by_points.forks_mm == ()
    assert FlightPath(route(), forks_mm=[30.0]).forks_mm == (30.0,)


def test_flight_path_of_a_tracked_path_has_its_points() -> None:
    points = bent_path()
    empty = np.zeros(len(points))
    tracked = TrackedPath(points, empty, empty, 1.0, 1.0, empty, empty, points, 0, 0.0)
    np.testing.assert_array_equal(FlightPath(tracked).source_lps, points)


def test_flight_path_of_an_object_without_points_is_refused() -> None:
    with pytest.raises(UsageError, match="FlightPath: points_lps: expected finite numbers"):
        FlightPath(object())
