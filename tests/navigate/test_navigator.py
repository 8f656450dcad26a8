"""Tests of the tip's movement: free, on a path, between both modes, and the up direction of the view."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carina.errors import UsageError
from carina.navigate import FlightPath, Navigator
from carina.scopes import Pose
from carina.volume import Volume

ROUTE = np.array([[0, 0, 100], [0, 0, 60], [0, 0, 30], [10, 2, 10], [30, 5, 0], [60, 8, -5]], dtype=float)


def oblique_volume() -> Volume:
    """Return a small oblique volume with different sizes and spacings, so that a test fails if axes are exchanged."""
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn @ np.diag([0.7, 0.9, 2.0])
    matrix[:3, 3] = [-20.0, 13.0, 40.0]
    return Volume(np.zeros((17, 40, 50), dtype=np.int16), matrix)


def angle_deg(a: Pose, b: Pose) -> float:
    trace = np.trace(a.lps_from_camera[:3, :3].T @ b.lps_from_camera[:3, :3])
    return float(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))))


def on_path(at_mm: float = 20.0) -> Navigator:
    path = FlightPath(ROUTE, forks_mm=[40.0, 70.0])
    tip = Navigator(path.pose_at(0.0))
    tip.set_path(path)
    tip.go_to(at_mm)
    return tip


# Up direction of the view


def test_caudal_view_from_the_head_end_has_patient_right_on_the_right() -> None:
    # In docs/conventions.md the view is inferior, up is anterior and right is the patient's right; in LPS +x is left
    # and +y posterior.
    tip = Navigator(Pose.looking([0, 0, 0], [0, 0, -1]))
    np.testing.assert_allclose(tip.pose.right_lps, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(-tip.pose.down_lps, [0, -1, 0], atol=1e-12)


def test_picture_for_an_operator_facing_the_patient_is_rotated_by_180_degrees() -> None:
    tip = Navigator(Pose.looking([1, 2, 3], [0, 0, -1]))
    tip.set_operator("facing")
    # The membranous (posterior) wall is at 12 o'clock, and the patient's right is on the left of the picture.
    np.testing.assert_allclose(-tip.pose.down_lps, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(tip.pose.right_lps, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(tip.pose.forward_lps, [0, 0, -1], atol=1e-12)
    tip.set_operator("facing")
    np.testing.assert_allclose(-tip.pose.down_lps, [0, 1, 0], atol=1e-12)
    tip.set_operator("head")
    np.testing.assert_allclose(-tip.pose.down_lps, [0, -1, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("look", "up"), [([0.2, 0.1, -1], [0, -1, 0]), ([0, -1, 0], [0, 0, 1]), ([1, 0, 0], [0, -1, 0])]
)
@pytest.mark.parametrize("mode", ["free", "path"])
def test_levelled_picture_has_anterior_up_or_superior_up_in_antero_posterior_views(
    look: list[float], up: list[float], mode: str
) -> None:
    look_dir = np.array(look) / np.linalg.norm(look)
    tip = Navigator(Pose.looking([0, 0, 0], look_dir, [0.3, 0.2, 0.9] if look[2] == 0 else [1, 0.2, 0]))
    if mode == "path":
        tip.set_path(FlightPath([[0, 0, 0], 20 * look_dir, 50 * look_dir]))
        tip.go_to(10.0)
        tip.steer(roll_rad=1.1)
    tip.level_horizon()
    wanted = np.array(up) - np.dot(up, look_dir) * look_dir
    np.testing.assert_allclose(-tip.pose.down_lps, wanted / np.linalg.norm(wanted), atol=1e-9)
    tip.set_operator("facing")
    tip.level_horizon()
    np.testing.assert_allclose(tip.pose.down_lps, wanted / np.linalg.norm(wanted), atol=1e-9)


def test_levelled_view_on_a_path_stays_level_while_the_tip_advances() -> None:
    tip = on_path(5.0)
    tip.set_operator("facing")
    tip.steer(advance_mm=20.0)
    np.testing.assert_allclose(tip.pose.down_lps, [0, -1, 0], atol=1e-2)


# Free movement


def test_free_steering_turns_about_camera_axes_and_advances_along_the_view() -> None:
    tip = Navigator(Pose.looking([0, 0, 0], [0, 0, -1]))
    tip.steer(yaw_rad=np.pi / 2)  # to the patient's right, -x
    tip.steer(advance_mm=3.0)
    np.testing.assert_allclose(tip.pose.position_lps, [-3, 0, 0], atol=1e-12)
    tip.steer(pitch_rad=np.pi / 2)  # to anterior, -y
    tip.steer(advance_mm=2.0)
    np.testing.assert_allclose(tip.pose.position_lps, [-3, -2, 0], atol=1e-12)
    tip.steer(advance_mm=-2.0)
    np.testing.assert_allclose(tip.pose.position_lps, [-3, 0, 0], atol=1e-12)


@pytest.mark.parametrize("num_turns", [4000, pytest.param(100_000, marks=pytest.mark.soak)])
def test_pose_is_rigid_after_thousands_of_random_turns(rng: np.random.Generator, num_turns: int) -> None:
    tip = Navigator(Pose.looking([0, 0, 0], [0.3, 0.2, -1]), volume=oblique_volume())
    amounts = rng.normal(0.0, 0.2, size=(num_turns, 4))
    for advance, yaw, pitch, roll in amounts:
        tip.steer(advance, yaw, pitch, roll)
    r = tip.pose.lps_from_camera[:3, :3]
    # The tolerance is 1e-14: each step makes the matrix orthogonal again, so errors do not accumulate.
    assert np.abs(r.T @ r - np.eye(3)).max() < 1e-14
    assert np.linalg.det(r) > 0


@given(st.lists(st.tuples(st.floats(-60, 60), st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3)), max_size=12))
def test_free_tip_stops_at_the_border_of_the_volume_and_this_is_reported(moves: list[tuple[float, ...]]) -> None:
    volume = oblique_volume()
    tip = Navigator(Pose.looking(volume.centre_lps, [0, 0, -1]), volume=volume)
    for move in moves:
        start = tip.pose.position_lps
        tip.steer(*move)
        assert volume.contains_lps(tip.pose.position_lps)
        went = float(np.linalg.norm(tip.pose.position_lps - start))
        ijk = volume.to_ijk(tip.pose.position_lps)
        at_face = np.abs(np.concatenate([ijk + 0.5, np.array([50, 40, 17]) - 0.5 - ijk])).min() < 1e-4
        assert at_face if tip.limit == "volume" else abs(went - abs(move[0])) < 1e-9
        # The tip stops on its line of movement and does not slide along the face of the volume.
        along = np.sign(move[0]) * tip.pose.forward_lps
        np.testing.assert_allclose(tip.pose.position_lps, start + went * along, atol=1e-4)


def test_tip_placed_outside_the_volume_is_moved_to_its_border_and_this_is_reported() -> None:
    volume = oblique_volume()
    tip = Navigator(Pose.looking(volume.centre_lps, [0, 0, -1]), volume=volume)
    tip.place_at(volume.to_lps(np.array([70.0, 20.0, 8.0])))
    assert tip.limit == "volume"
    np.testing.assert_allclose(volume.to_ijk(tip.pose.position_lps), [49.5, 20.0, 8.0], atol=1e-5)
    tip.place_at(volume.centre_lps)
    assert tip.limit == "none"
    np.testing.assert_array_equal(tip.pose.forward_lps, [0, 0, -1])


# Movement on a path


def test_tip_that_advances_follows_the_path_and_stops_at_its_ends() -> None:
    tip = on_path(0.0)
    assert tip.path is not None
    tip.steer(advance_mm=12.5)
    assert tip.path_mm == 12.5
    np.testing.assert_array_equal(tip.pose.position_lps, tip.path.pose_at(12.5).position_lps)
    tip.steer(advance_mm=-100.0)
    assert (tip.path_mm, tip.limit) == (0.0, "path start")
    tip.steer(advance_mm=1e4)
    assert (tip.path_mm, tip.limit) == (tip.path.length_mm, "path end")
    tip.steer(advance_mm=-1.0)
    assert tip.limit == "none"


def test_looking_around_on_a_path_leaves_the_position_unchanged_and_lasts_until_reset() -> None:
    tip, plain = on_path(), on_path()
    tip.steer(yaw_rad=0.5)
    tip.steer(pitch_rad=0.2)
    tip.steer(advance_mm=15.0)
    plain.steer(advance_mm=15.0)
    np.testing.assert_array_equal(tip.pose.position_lps, plain.pose.position_lps)
    np.testing.assert_allclose(tip.look_offset_rad, [0.5, 0.2, 0.0], atol=1e-12)
    assert angle_deg(tip.pose, plain.pose) > 25
    tip.reset_look()
    np.testing.assert_array_equal(tip.pose.lps_from_camera, plain.pose.lps_from_camera)


def test_next_fork_and_previous_fork_move_the_tip_to_each_fork_in_turn() -> None:
    tip = on_path(0.0)
    assert [tip.next_fork() for _ in range(3)] == [40.0, 70.0, pytest.approx(tip.path.length_mm)]  # type: ignore[union-attr]
    assert [tip.previous_fork() for _ in range(3)] == [70.0, 40.0, 0.0]


def test_next_fork_from_free_mode_goes_to_the_fork_after_the_nearest_path_position() -> None:
    tip = on_path(0.0)
    tip.set_mode("free")
    tip.place_at([3.0, 0.0, 55.0])
    assert tip.next_fork() == pytest.approx(70.0)
    assert tip.mode == "path"


# Changes between free movement and a path


def test_leaving_the_path_leaves_the_pose_exactly_unchanged() -> None:
    tip = on_path(33.0)
    tip.steer(2.0, 0.3, -0.1, 0.7)
    before = tip.pose
    assert tip.toggle_mode() == "free"
    np.testing.assert_array_equal(tip.pose.lps_from_camera, before.lps_from_camera)
    assert tip.path_mm is None


@given(
    st.floats(0, 120),
    st.tuples(*[st.floats(-4, 4)] * 3),
    st.tuples(*[st.floats(-3, 3)] * 3),
    st.sampled_from(["head", "facing"]),
)
def test_entering_a_nearby_path_approaches_it_gradually_without_a_jump(
    path_mm: float, away: tuple[float, ...], turn: tuple[float, ...], operator: str
) -> None:
    tip = on_path(path_mm)
    tip.set_operator(operator)  # type: ignore[arg-type]
    tip.toggle_mode()
    tip.place_at(tip.pose.position_lps + np.array(away))
    tip.steer(0.0, *turn)
    before = tip.pose
    assert tip.toggle_mode() == "path"
    np.testing.assert_array_equal(tip.pose.lps_from_camera, before.lps_from_camera)
    tip.steer()  # Without a movement only rounding may differ.
    np.testing.assert_allclose(tip.pose.lps_from_camera, before.lps_from_camera, atol=1e-7)
    # The limit per 0.1 mm is 4 degrees per mm of easing plus the rotation of the path, below 7 degrees per mm on this
    # route.
    direction = 1.0 if tip.path_mm < 60.0 else -1.0  # type: ignore[operator]
    for _ in range(20):
        last = tip.pose
        tip.steer(advance_mm=0.1 * direction)
        assert angle_deg(last, tip.pose) < 1.1
        assert np.linalg.norm(last.position_lps - tip.pose.position_lps) < 0.16
    tip.steer(advance_mm=-1e3)
    tip.steer(advance_mm=1e3)
    assert tip.path is not None
    end = tip.path.pose_at(tip.path.length_mm)
    np.testing.assert_allclose(tip.pose.position_lps, end.position_lps, atol=1e-6)
    np.testing.assert_allclose(tip.pose.forward_lps, end.forward_lps, atol=1e-6)


def test_approach_to_a_path_is_independent_of_the_step_size() -> None:
    tips = [on_path(10.0), on_path(10.0)]
    for tip in tips:
        tip.toggle_mode()
        tip.place_at([6.0, 0.0, 88.0])
        tip.steer(yaw_rad=2.5, pitch_rad=0.3)
        tip.toggle_mode()
    tips[0].steer(advance_mm=25.0)
    for _ in range(50):
        tips[1].steer(advance_mm=0.5)
    # The tolerance of 1e-9 is the rounding of 50 steps.
    np.testing.assert_allclose(tips[0].pose.lps_from_camera, tips[1].pose.lps_from_camera, atol=1e-9)


def test_entering_a_distant_path_moves_the_tip_to_its_nearest_position_and_looks_along_it() -> None:
    tip = on_path(10.0)
    tip.toggle_mode()
    tip.place_at([40.0, 0.0, 70.0])
    tip.toggle_mode()
    assert tip.path is not None
    np.testing.assert_allclose(tip.pose.lps_from_camera, tip.path.pose_at(30.0).lps_from_camera, atol=1e-9)


def test_tip_changes_to_a_new_nearby_path_without_a_jump_and_to_free_mode_if_the_path_is_removed() -> None:
    tip = on_path(20.0)
    tip.steer(yaw_rad=0.2)
    before = tip.pose
    other = ROUTE * np.array([-1.0, 1.0, 1.0])
    tip.set_path(FlightPath(other))
    assert tip.mode == "path"
    np.testing.assert_array_equal(tip.pose.lps_from_camera, before.lps_from_camera)
    tip.set_path(None)
    assert tip.mode == "free"
    np.testing.assert_array_equal(tip.pose.lps_from_camera, before.lps_from_camera)


def test_movements_without_a_path_or_with_invalid_values_are_refused_without_effect() -> None:
    tip = Navigator(Pose.looking([0, 0, 0], [0, 0, -1]))
    before = tip.pose
    for wrong in (
        tip.toggle_mode,
        lambda: tip.go_to(3.0),
        tip.next_fork,
        lambda: tip.steer(float("nan")),
        lambda: tip.set_mode("sideways"),  # type: ignore[arg-type]
        lambda: tip.set_operator("above"),  # type: ignore[arg-type]
        lambda: tip.place_at([0.0, float("inf"), 0.0]),
    ):
        with pytest.raises(UsageError):
            wrong()
        assert tip.mode == "free"
        assert tip.pose is before
