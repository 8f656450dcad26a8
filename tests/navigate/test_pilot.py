"""Tests of the control of the tip by devices: three modes, changes between modes without jumps, and invalid input."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carina import commands as c
from carina.commands import DeviceControls
from carina.errors import UsageError
from carina.navigate import AxesSample, HandleSample, Navigator, Pilot, PoseSample
from carina.navigate import moves as m
from carina.navigate.rotation import rotation_from_vector, wxyz_from_rotation
from carina.scopes import Pose

PLAIN = DeviceControls(filter_on=False)
DOWN = [(0.0, 0.0, -float(z)) for z in range(61)]
"""Points of a trachea of 60 mm from the origin to the feet, LPS mm."""
RIGHT = (-math.sin(0.7), 0.0, -math.cos(0.7))
"""Direction of the right main bronchus, LPS."""
LEFT = (math.sin(0.7), 0.0, -math.cos(0.7))
"""Direction of the left main bronchus, LPS."""
PATH = m.SetPath(
    tuple(DOWN + [(RIGHT[0] * n, 0.0, -60.0 + RIGHT[2] * n) for n in range(1, 41)]),
    forks_mm=(60.0,),
    lookouts_mm=(50.0,),
    ways=(m.PathFork(60.0, (m.PathWay(1, RIGHT), m.PathWay(2, LEFT)), 1),),
)
"""Path down the trachea and into the right main bronchus, with the left main bronchus as the other branch."""


class Hand:
    """Pilot with a device that sends 100 samples per second."""

    def __init__(self, *, path: bool = False, controls: DeviceControls = PLAIN) -> None:
        self.pilot = Pilot(Navigator(Pose.looking([0.0, 0.0, -5.0], [0.0, 0.0, -1.0])))
        self.pilot.apply(c.SetControls(controls))
        if path:
            self.pilot.apply(PATH)
        self.now = 0.0

    @property
    def pose(self) -> Pose:
        return self.pilot.navigator.pose

    def send(self, sample, device: str = "pen") -> None:
        self.now += 0.01
        sample = type(sample)(self.now, *[getattr(sample, f) for f in sample.__struct_fields__[1:]])
        self.pilot.apply(m.DeviceSaid(device, sample, self.now))
        self.pilot.apply(m.Frame(self.now))

    def pen(self, at=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), buttons: int = 0) -> None:
        wxyz = wxyz_from_rotation(rotation_from_vector(np.array(turn, dtype=float)))
        self.send(PoseSample(0.0, tuple(float(v) for v in at), wxyz, buttons))

    def stick(self, *axes: float) -> None:
        self.send(AxesSample(0.0, (*axes, *(0.0,) * (6 - len(axes)))), "stick")


def moved(a: Pose, b: Pose) -> float:
    return float(np.linalg.norm(a.position_lps - b.position_lps))


def test_relative_mode_moves_the_tip_by_the_movement_of_the_hand():
    hand = Hand()
    start = hand.pose
    hand.pen((100.0, 50.0, 25.0), (0.3, 0.2, 0.1))
    assert moved(hand.pose, start) == 0.0, "the first sample only sets the position of the hand"
    turn = rotation_from_vector(np.array([0.3, 0.2, 0.1]))
    forward_4mm = np.array([100.0, 50.0, 25.0]) + turn @ [0.0, 0.0, 4.0]
    hand.pen(forward_4mm, (0.3, 0.2, 0.1))
    np.testing.assert_allclose(hand.pose.position_lps, [0.0, 0.0, -9.0], atol=1e-9)


def test_gain_scales_the_hand_movement_and_the_clutch_button_suspends_it():
    hand = Hand(controls=DeviceControls(gain_mm=2.0, filter_on=False))
    hand.pen()
    hand.pen((0.0, 0.0, 3.0))
    np.testing.assert_allclose(hand.pose.position_lps, [0.0, 0.0, -11.0], atol=1e-9)
    hand.pen((0.0, 0.0, 3.0), buttons=2)
    hand.pen((0.0, 0.0, -30.0), buttons=2)
    hand.pen((0.0, 0.0, -30.0))
    hand.pen((0.0, 0.0, -29.0))
    np.testing.assert_allclose(hand.pose.position_lps, [0.0, 0.0, -13.0], atol=1e-9)


def test_absolute_mode_needs_a_registration_and_moves_the_tip_to_the_pen_gradually():
    hand = Hand()
    hand.pen((10.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="register the pen first"):
        hand.pilot.apply(c.SetControl("absolute"))
    hand.pilot.apply(m.Register("pen", tuple(np.eye(4).ravel())))
    before = hand.pose
    hand.pilot.apply(c.SetControl("absolute"))
    hand.pen((10.0, 0.0, 0.0))
    np.testing.assert_array_equal(hand.pose.lps_from_camera, before.lps_from_camera)
    steps = []
    for n in range(1, 400):
        last = hand.pose
        hand.pen((10.0 + 0.5 * n, 0.0, 0.0))
        steps.append(moved(hand.pose, last))
    # The hand moves half a millimetre, and easing adds at most half as much.
    assert max(steps) < 0.76
    np.testing.assert_allclose(hand.pose.position_lps, [10.0 + 0.5 * 399, 0.0, 0.0], atol=0.1)
    pen = hand.pilot.pen_pose("pen")
    assert pen is not None
    np.testing.assert_allclose(hand.pose.lps_from_camera, pen.lps_from_camera, atol=0.1)


def test_mode_button_of_a_pen_cycles_through_the_three_modes_without_a_jump():
    hand = Hand(path=True)
    hand.pilot.apply(m.Register("pen", tuple(np.eye(4).ravel())))
    hand.pen((3.0, 1.0, -4.0))
    seen = []
    for n in range(7):
        before = hand.pose
        hand.pen((3.0, 1.0, -4.0), buttons=1)
        hand.pen((3.0, 1.0, -4.0), buttons=0)
        seen.append(hand.pilot.control)
        assert moved(hand.pose, before) < 1e-9, n
        np.testing.assert_allclose(hand.pose.lps_from_camera, before.lps_from_camera, atol=1e-9)
        # After the change the tip continues to follow the hand smoothly.
        hand.pen((3.0, 1.0, -4.0 + 0.1))
        assert moved(hand.pose, before) < 0.3
        hand.pen((3.0, 1.0, -4.0))
    assert seen == ["path", "absolute", "relative", "path", "absolute", "relative", "path"]


def test_hand_in_path_mode_advances_the_tip_along_the_path_and_its_rotation_turns_the_view():
    hand = Hand(path=True)
    hand.pilot.apply(c.SetControl("path"))
    hand.pen()
    hand.pen((5.0, -5.0, 10.0), (0.0, 0.4, 0.0))
    assert hand.pilot.navigator.path_mm == pytest.approx(15.0)
    assert hand.pilot.navigator.look_offset_rad[0] == pytest.approx(0.4)


def test_stick_direction_at_a_fork_requests_the_branch_on_that_side():
    # The camera looks down the trachea with anterior up, so the patient's right is on the right of the picture.
    for yaw, wanted in ((1.0, None), (0.0, None), (-1.0, 2)):
        hand = Hand(path=True)
        hand.pilot.apply(c.SetControl("path"))
        hand.pilot.apply(c.GoTo(59.0))
        calls = []
        for _ in range(12):
            hand.stick(1.0, yaw)
            calls.append(hand.pilot.take_wanted_way())
        assert [way for way in calls if way is not None] == ([] if wanted is None else [wanted]), yaw
        if wanted is not None:
            at = calls.index(wanted)
            assert at > 0, "the branch is requested at the fork and not before"
    # The tip waits one frame at the fork, in which the route may change.
    hand = Hand(path=True)
    hand.pilot.apply(c.SetControl("path"))
    hand.pilot.apply(c.GoTo(59.95))
    hand.stick(1.0, -1.0)
    hand.stick(1.0, -1.0)
    assert hand.pilot.take_wanted_way() == 2
    assert hand.pilot.navigator.path_mm == 60.0


def test_stick_speed_is_independent_of_device_rate_and_frame_rate():
    def far(samples_hz: int, frames_hz: int) -> float:
        hand = Hand()
        for n in range(samples_hz * frames_hz):  # One second in time steps that are multiples of both periods.
            at = n / (samples_hz * frames_hz)
            if n % frames_hz == 0:
                hand.pilot.apply(m.DeviceSaid("stick", AxesSample(at, (1.0, 0, 0, 0, 0, 0)), at))
            if n % samples_hz == 0:
                hand.pilot.apply(m.Frame(at))
        return float(np.linalg.norm(hand.pose.position_lps - [0, 0, -5.0]))

    distances = [far(20, 30), far(250, 30), far(60, 120)]
    # The distance is that of 25 mm/s over one second without the first frame, which has no previous frame.
    assert distances == pytest.approx([25.0] * 3, abs=1.0)


def test_tip_stops_if_a_stick_sends_nothing_and_does_not_jump_after_a_pause():
    hand = Hand()
    hand.stick(1.0)
    hand.stick(1.0)
    before = hand.pose
    hand.pilot.apply(m.Frame(hand.now + 5.0))
    assert moved(hand.pose, before) == 0.0
    hand.now += 60.0
    hand.stick(1.0)
    assert moved(hand.pose, before) <= 2.5


def test_pen_reconnected_at_another_position_causes_no_jump():
    hand = Hand()
    hand.pen()
    hand.pen((0.0, 0.0, 1.0))
    before = hand.pose
    hand.pilot.apply(c.DeviceGone("pen"))
    hand.pen((400.0, -20.0, 7.0), (1.0, 1.0, 1.0))
    np.testing.assert_array_equal(hand.pose.lps_from_camera, before.lps_from_camera)
    hand.pen((400.0, -20.0, 7.5), (1.0, 1.0, 1.0))
    assert 0.0 < moved(hand.pose, before) < 0.51


def test_scope_handle_advances_and_rolls_and_lever_down_lifts_the_tip():
    hand = Hand()
    hand.send(HandleSample(0.0, 100.0, 0.0, 0.0), "handle")
    hand.send(HandleSample(0.0, 104.0, 0.0, 0.0), "handle")
    np.testing.assert_allclose(hand.pose.position_lps, [0.0, 0.0, -9.0], atol=1e-9)
    hand.send(HandleSample(0.0, 104.0, 0.0, 0.5), "handle")
    assert hand.pose.forward_lps[1] < -0.4, "up is anterior"
    inverted = Hand(controls=DeviceControls(lever_inverted=True, filter_on=False))
    inverted.send(HandleSample(0.0, 0.0, 0.0, 0.0), "handle")
    inverted.send(HandleSample(0.0, 0.0, 0.0, 0.5), "handle")
    assert inverted.pose.forward_lps[1] > 0.4


def test_button_of_a_pen_with_an_active_tool_marks_a_point_and_does_not_change_the_mode():
    hand = Hand(path=True)
    hand.pilot.apply(c.ArmPen("target"))
    hand.pen(buttons=0)
    hand.pen(buttons=1)
    hand.pen(buttons=1)
    hand.pen(buttons=0)
    assert hand.pilot.control == "relative"
    assert hand.pilot.take_marks() == (("pen", "target"),)
    assert hand.pilot.take_marks() == ()


def test_keyboard_and_a_device_move_the_same_tip_without_jumps():
    hand = Hand()
    hand.pen((0.0, 0.0, 0.0))
    hand.pilot.apply(c.Steer(10.0, 0.0, 0.0, 0.0))
    before = hand.pose
    hand.pen((0.0, 0.0, 0.2))
    assert moved(hand.pose, before) <= 0.2
    np.testing.assert_allclose(hand.pose.position_lps[2], -15.0, atol=0.21)


NUMBER = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([math.nan, math.inf, 0.0, 1e308, -1e-320]))
SAMPLE = st.one_of(
    st.builds(
        PoseSample,
        NUMBER,
        st.one_of(st.none(), st.tuples(NUMBER, NUMBER, NUMBER)),
        st.tuples(NUMBER, NUMBER, NUMBER, NUMBER),
        st.integers(-3, 7),
    ),
    st.builds(AxesSample, NUMBER, st.tuples(*[st.floats(-1.5, 1.5)] * 6), st.integers(-3, 7)),
    st.builds(HandleSample, NUMBER, NUMBER, NUMBER, st.floats(-2, 2), st.integers(-3, 7)),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["a", "b"]), SAMPLE), max_size=40))
def test_pose_matrix_stays_rigid_for_any_device_input(samples):
    hand = Hand(path=True, controls=DeviceControls())
    hand.pilot.apply(m.Register("a", tuple(np.eye(4).ravel())))
    for n, (device, sample) in enumerate(samples):
        hand.pilot.apply(m.DeviceSaid(device, sample, n * 0.1))
        hand.pilot.apply(m.Frame(n * 0.1))
    Pose(hand.pose.lps_from_camera)  # Pose refuses an invalid matrix.


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 6), min_size=1, max_size=30), st.integers(0, 2))
def test_moves_read_from_json_give_the_same_poses_bit_for_bit(pushes, presses):
    made: list[str] = []
    first = Hand(path=True, controls=DeviceControls())
    state = first.pilot.navigator.state()
    first.pilot.on_move = lambda move, dt_s: made.append(json.dumps(m.move_to_json(move, dt_s), allow_nan=False))
    first.pilot.apply(c.SetControls(DeviceControls(gain_mm=1.7)))
    for n, push in enumerate(pushes):
        first.pen(np.cumsum(push[:3]), push[3:], buttons=int(n < presses))
        first.stick(*push)
    second = Hand(path=True, controls=DeviceControls())
    second.pilot.navigator.restore(state, second.pilot.navigator.path)
    for line in made:
        move, dt_s = m.move_from_json(json.loads(line))
        second.pilot.apply(move, dt_s=dt_s)
    np.testing.assert_array_equal(second.pose.lps_from_camera, first.pose.lps_from_camera)
    assert second.pilot.control == first.pilot.control


@pytest.mark.parametrize(
    "value",
    [
        {},
        {"move": "Jump"},
        {"move": "GoTo"},
        {"move": "GoTo", "path_mm": 1, "x": 2},
        {"move": "DeviceSaid", "sample": 3},
        {"move": "SetControls", "controls": {"gain_mm": 1}},
        {"move": 7},
    ],
)
def test_move_with_invalid_json_is_refused(value):
    with pytest.raises(UsageError) as refused:
        m.move_from_json(value)
    assert refused.value.code == "navigate.recording"


def step(hand: Hand, sample, now_s: float) -> None:
    hand.pilot.apply(m.DeviceSaid("pen", sample, now_s))
    hand.pilot.apply(m.Frame(now_s))


def test_withdrawing_the_scope_handle_withdraws_the_tip_unless_the_device_was_silent_before():
    for silent_s, expected_mm in ((0.02, 15.0), (1.0, 20.0)):
        hand = Hand(path=True)
        hand.pilot.apply(c.GoTo(20.0))
        step(hand, HandleSample(1.0, 215.0, 0.0, 0.0), 1.0)
        # A key press moves the tip, and a frame passes before the next sample of the handle.
        hand.pilot.apply(c.GoTo(20.0))
        hand.pilot.apply(m.Frame(1.5))
        step(hand, HandleSample(1.0 + silent_s, 210.0, 0.0, 0.0), 2.0)
        assert hand.pilot.navigator.path_mm == pytest.approx(expected_mm)


@pytest.mark.parametrize(
    "made",
    [
        lambda time_s, mm: HandleSample(time_s, mm, 0.0, 0.0),
        lambda time_s, mm: PoseSample(time_s, (0.0, 0.0, mm), (1.0, 0.0, 0.0, 0.0)),
    ],
)
def test_restarted_device_at_another_position_does_not_move_the_tip(made):
    hand = Hand()
    step(hand, made(100.0, 300.0), 1.0)
    step(hand, made(100.01, 301.0), 1.01)
    at = hand.pose
    # Clock and origin of the device restart; the gate accepts its samples after half a second.
    for n in range(60):
        step(hand, made(0.01 * n, 0.0), 1.02 + 0.01 * n)
    assert moved(hand.pose, at) == 0.0
    step(hand, made(0.6, 2.0), 1.63)
    assert moved(hand.pose, at) == pytest.approx(2.0)


def test_pen_after_a_gap_does_not_move_the_tip():
    hand = Hand()
    for control in ("relative", "absolute"):
        hand.pilot.apply(m.Register("pen", tuple(np.eye(4).ravel())))
        hand.pilot.apply(c.SetControl(control))
        hand.pen()
        hand.pen((0.0, 0.0, 1.0))
        at = hand.pose
        hand.now += 0.4
        hand.pen((200.0, 0.0, 1.0))
        assert moved(hand.pose, at) == 0.0
        hand.pen((200.0, 0.0, 2.0))
        assert 0.5 < moved(hand.pose, at) < 2.0
        hand.now += 1.0


def test_sample_that_is_repeated_or_late_is_not_applied_again():
    hand = Hand()
    for n in range(5):
        hand.pen((0.0, 0.0, float(n)))
        for _ in range(3):
            hand.pilot.apply(m.Frame(hand.now))
    np.testing.assert_allclose(hand.pose.position_lps, [0.0, 0.0, -9.0], atol=1e-9)


def test_number_of_devices_that_the_pilot_stores_is_limited():
    hand = Hand()
    hand.pilot.apply(m.Register("registered", tuple(np.eye(4).ravel())))
    sample = PoseSample(0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    for n in range(1000):
        hand.now += 1.0
        hand.send(sample, f"pen {n}")
    for n in range(1000):
        hand.pilot.apply(c.TakeDevice(f"stick {n}"))
    assert len(hand.pilot.devices()) <= 65
    hand.send(sample, "pen")
    hand.now += 1.0
    hand.send(sample, "pen")
    assert {"registered", "pen"} <= {device.device for device in hand.pilot.devices()}
    numbers = tuple(np.eye(4).ravel())
    for n in range(127 - len(hand.pilot.devices())):
        hand.pilot.apply(m.Register(f"tracker {n}", numbers))
    hand.pilot.apply(m.Register("the last", numbers))
    with pytest.raises(UsageError, match="registration"):
        hand.pilot.apply(m.Register("one too many", numbers))


@pytest.mark.parametrize("path", [True, False])
def test_orientation_only_pen_advances_by_its_key_and_turns(path):
    hand = Hand(path=path)
    start = hand.pose
    for n in range(50):
        turn = wxyz_from_rotation(rotation_from_vector(np.array([0.0, 0.01 * n, 0.0])))
        hand.send(PoseSample(0.0, None, turn, 0, 1.0))
    # The first frame starts the clock.
    went = moved(hand.pose, start)
    assert went == pytest.approx(25.0 * 0.49, rel=0.06), "in free mode the rotation gives an arc"
    assert hand.pilot.is_moving
    cosine = float(hand.pose.forward_lps @ start.forward_lps)
    assert cosine == pytest.approx(math.cos(0.49), abs=1e-6)
    # The device is disconnected while its key is down, so the tip stops after a quarter of a second.
    for _ in range(100):
        hand.now += 0.01
        hand.pilot.apply(m.Frame(hand.now))
    after = hand.pose
    assert moved(after, start) < went + 25.0 * 0.26
    hand.send(PoseSample(0.0, None, (1.0, 0.0, 0.0, 0.0), 2, -1.0))
    assert (after.position_lps - hand.pose.position_lps) @ after.forward_lps > 0.2, "backwards, also with the clutch"
    hand.send(PoseSample(0.0, None, (1.0, 0.0, 0.0, 0.0), 2, 0.0))
    assert not hand.pilot.is_moving


# The tracker's coordinates are rotated against those of the patient about two axes.
TRACKER_POSE = np.eye(4)
TRACKER_POSE[:3, :3] = rotation_from_vector(np.array([0.4, -0.9, 0.2]))
TRACKER_POSE[:3, 3] = (120.0, -45.0, 300.0)


def registered(*, path: bool = False, controls: DeviceControls = PLAIN) -> Hand:
    hand = Hand(path=path, controls=controls)
    hand.pilot.apply(m.Register("pen", tuple(TRACKER_POSE.ravel())))
    return hand


def in_tracker(lps) -> tuple[float, ...]:
    return tuple(np.linalg.inv(TRACKER_POSE[:3, :3]) @ (np.array(lps) - TRACKER_POSE[:3, 3]))


def test_position_of_a_registered_pen_is_known_in_every_mode_and_at_high_speed():
    hand = registered(path=True, controls=DeviceControls())
    for n, control in enumerate(("path", "relative", "absolute", "path", "absolute")):
        hand.pilot.apply(c.SetControl(control))
        for step in range(10):
            at = (20.0 * step, -30.0 + 7.0 * n, 40.0 - 25.0 * step)
            hand.pen(in_tracker(at))
            np.testing.assert_allclose(hand.pilot.pen_lps("pen"), at, atol=1e-9)
            assert hand.pilot.pen().lps == pytest.approx(at, abs=1e-9)
    assert hand.pilot.pen_lps("another") is None


def test_unregistered_pen_or_pen_without_position_data_has_no_position():
    hand = Hand()
    assert hand.pilot.pen() is None
    hand.pen((1.0, 2.0, 3.0))
    assert (hand.pilot.pen_lps("pen"), hand.pilot.pen().lps, hand.pilot.pen().is_tracked) == (None, None, True)
    hand.pilot.apply(m.Register("pen", tuple(TRACKER_POSE.ravel())))
    assert hand.pilot.pen().lps is not None
    hand.send(PoseSample(0.0, None, (1.0, 0.0, 0.0, 0.0)), "pen")
    assert (hand.pilot.pen_lps("pen"), hand.pilot.pen().is_tracked) == (None, False)
    hand.pilot.apply(c.DeviceGone("pen"))
    assert hand.pilot.pen() is None


def test_distance_between_pen_and_tip_is_reported_in_absolute_mode_until_it_is_zero():
    hand = registered(path=True)
    hand.pen(in_tracker((30.0, 0.0, -20.0)))
    assert hand.pilot.pen().off_mm is None, "in other modes no distance is reported"
    hand.pilot.apply(c.SetControl("absolute"))
    assert hand.pilot.pen().off_mm == pytest.approx(moved(hand.pose, hand.pilot.pen_pose("pen")))
    assert hand.pilot.pen().off_mm > 30.0
    left = []
    for n in range(300):
        hand.pen(in_tracker((30.0 + 0.5 * n, 0.0, -20.0)))
        left.append(hand.pilot.pen().off_mm)
    assert all(b <= a + 1e-9 for a, b in itertools.pairwise(left)), "the value never increases"
    assert left[-1] < 0.05


def test_join_pen_command_moves_the_tip_to_the_pen_immediately_and_the_tip_then_follows_exactly():
    hand = registered(path=True)
    hand.pen(in_tracker((30.0, 10.0, -20.0)), (0.3, -0.2, 0.5))
    with pytest.raises(UsageError, match="absolute") as refused:
        hand.pilot.apply(c.JoinPen())
    assert refused.value.code == "navigate.not-absolute"
    hand.pilot.apply(c.SetControl("absolute"))
    hand.pen(in_tracker((30.0, 10.0, -20.0)), (0.3, -0.2, 0.5))
    assert hand.pilot.pen().off_mm > 30.0
    hand.pilot.apply(c.JoinPen())
    assert hand.pilot.pen().off_mm == pytest.approx(0.0, abs=1e-9)
    assert hand.pilot.pen().off_rad == pytest.approx(0.0, abs=1e-6)
    for n in range(20):
        at = (30.0 + 0.3 * n, 10.0, -20.0 - 0.2 * n)
        hand.pen(in_tracker(at), (0.3, -0.2 + 0.01 * n, 0.5))
        np.testing.assert_allclose(hand.pose.position_lps, at, atol=1e-9)
    assert m.move_from_json(m.move_to_json(c.JoinPen())) == (c.JoinPen(), 0.0)


def test_join_pen_command_removes_the_delay_of_the_filter():
    hand = registered(controls=DeviceControls())
    hand.pilot.apply(c.SetControl("absolute"))
    for n in range(10):
        at = (30.0 + 2.0 * n, 10.0, -20.0)
        hand.pen(in_tracker(at))
    assert moved(hand.pilot.pen_pose("pen"), Pose.looking(at, [0.0, 0.0, -1.0])) > 0.1, "the filter lags behind"
    hand.pilot.apply(c.JoinPen())
    np.testing.assert_allclose(hand.pose.position_lps, at, atol=1e-9)
    hand.pen(in_tracker(at))
    np.testing.assert_allclose(hand.pose.position_lps, at, atol=1e-9)
