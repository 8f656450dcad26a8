"""Tests of a tracked pen over the wire: its button marks the pen's tip in every steering mode."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from live_server import SHOWN, open_case

from carina.navigate.rotation import rotation_from_vector, wxyz_from_rotation
from carina.server.wire import messages as wire
from small_case import small_volume

TURN = rotation_from_vector(np.array([0.4, -0.9, 0.2]))
"""Rotation from the coordinates of the tracker to those of the patient."""
AWAY = np.array([120.0, -45.0, 300.0])
"""Position in the patient of the origin of the tracker's coordinates, LPS mm."""
HURRY_MM = 4.0
"""Distance of the pen between two samples, mm: about 200 mm/s, which a filter cannot follow at once."""
SAMPLE_S = 0.02
"""Time between two samples of the pen, s."""


class TrackedPen:
    """Pen that is moved to points of the patient; it sends positions in the coordinates of the tracker."""

    def __init__(self, window, device="openigtlink:192.0.2.7:18944"):
        self.window, self.device = window, device
        self.now_s = itertools.count(1)

    def register(self, points):
        tracker = tuple(self.tracker(p) for p in points)
        patient = tuple(tuple(float(v) for v in p) for p in points)
        self.window.send(wire.Calibrate(self.device, tracker, patient))
        self.window.until(lambda m: isinstance(m, wire.Notice) and "is registered" in m.message)

    def tracker(self, lps):
        return tuple(float(v) for v in TURN.T @ (np.asarray(lps) - AWAY))

    def hold(self, lps, buttons=0):
        wxyz = wxyz_from_rotation(TURN.T @ rotation_from_vector(np.array([0.1, 0.5, -0.3])))
        time_s = SAMPLE_S * next(self.now_s)
        self.window.send(
            wire.DeviceSampleMessage(
                device=self.device,
                time_s=time_s,
                position_mm=self.tracker(lps),
                orientation_wxyz=wxyz,
                axes=None,
                buttons=buttons,
                handle=None,
                advance=0.0,
            )
        )

    def comes_to(self, lps, along=(1.0, 0.0, 0.0)):
        """Move the pen fast and from the side to a point; the last sample is at the point."""
        for n in range(5, -1, -1):
            self.hold(np.asarray(lps) + n * HURRY_MM * np.asarray(along))

    def presses(self, lps):
        self.hold(lps, buttons=1)
        self.hold(lps)


@pytest.fixture
def middle():
    volume = small_volume()
    nz, ny, nx = volume.shape_zyx
    return np.array(volume.to_lps(((nx - 1) / 2, (ny - 1) / 2, (nz - 1) / 2)), dtype=float)


@pytest.fixture
def window(live):
    with live.window() as opened:
        opened.send(SHOWN)
        open_case(opened)
        yield opened


def corners(middle):
    return [middle + offset for offset in ((0, 0, 0), (50, 0, 0), (0, 50, 0), (0, 0, 50))]


def targets(window, num):
    return window.until_state(lambda s: len(s.targets) >= num).targets


def test_button_of_a_registered_pen_marks_the_pen_tip_in_every_mode(window, middle):
    pen = TrackedPen(window)
    pen.hold(middle)
    pen.register(corners(middle))
    window.send(wire.ArmPen("target"))
    errors = {}
    modes = ("path", "relative", "absolute", "path", "absolute", "relative", "absolute")
    for n, control in enumerate(modes, start=1):
        window.send(wire.SetControl(control))
        place = middle + np.array([3.0 * n, -2.0 * n, 4.0 - n])
        pen.comes_to(place, along=((1, 0, 0), (0, 1, 0), (0, 0, 1))[n % 3])
        pen.presses(place)
        marked = np.array(targets(window, n)[-1].lps)
        errors[n, control] = float(np.linalg.norm(marked - place))
    assert max(errors.values()) < 0.1, errors
    # Repeat the test in a free flight that keys began, with the scope's tip at another position.
    window.send(wire.SetMode("free"), wire.Place(tuple(float(v) for v in middle)))
    place = middle + np.array([5.0, 5.0, 5.0])
    pen.comes_to(place)
    pen.presses(place)
    assert np.linalg.norm(np.array(targets(window, len(modes) + 1)[-1].lps) - place) < 0.1


def test_button_of_a_registered_pen_sets_the_root_at_the_pen_tip(window, middle):
    pen = TrackedPen(window)
    pen.hold(middle)
    pen.register(corners(middle))
    before = [m for m in window.seen if isinstance(m, wire.State)][-1].root_lps
    window.send(wire.ArmPen("root"))
    place = middle + np.array([4.0, -3.0, 2.0])
    pen.comes_to(place)
    pen.presses(place)
    state = window.until_state(lambda s: s.root_lps not in {None, before})
    assert np.linalg.norm(np.array(state.root_lps) - place) < 0.1


def test_pen_button_marks_start_and_target_of_a_path_without_airways(window, middle):
    pen = TrackedPen(window)
    pen.hold(middle)
    pen.register(corners(middle))
    window.send(wire.ArmPen("start"))
    first = middle + np.array([4.0, -3.0, 2.0])
    pen.comes_to(first)
    pen.presses(first)
    message = window.until(lambda m: isinstance(m, wire.StartMarkedMessage))
    assert np.linalg.norm(np.array(message.lps) - first) < 0.1
    window.send(wire.ArmPen("target", cost="walls", root_lps=message.lps))
    place = middle + np.array([-6.0, 5.0, -3.0])
    pen.comes_to(place)
    pen.presses(place)
    (target,) = targets(window, 1)
    assert np.linalg.norm(np.array(target.lps) - place) < 0.1
    assert (target.cost, target.root_lps, target.problem) == ("walls", message.lps, None)


def test_position_that_the_pen_button_would_mark_is_reported_before_it_is_pressed(window, middle):
    pen = TrackedPen(window)
    window.send(wire.ArmPen("target"))
    pen.hold(middle)
    message = window.until(lambda m: isinstance(m, wire.Pen))
    assert (message.device, message.tracked, message.lps) == (pen.device, True, None), (
        "not registered: the tip, and it is said"
    )
    pen.register(corners(middle))
    place = middle + np.array([0.0, 7.0, 0.0])
    pen.hold(place)
    message = window.until(lambda m: isinstance(m, wire.Pen) and np.allclose(m.lps or 0.0, place, atol=0.01))
    assert message.off_mm is None
    window.send(wire.DeviceGone(pen.device))
    assert window.until(lambda m: isinstance(m, wire.Pen) and m.device is None).lps is None


def test_button_of_an_unregistered_pen_marks_the_tip_of_the_scope(live, window, middle):
    pen = TrackedPen(window)
    window.send(wire.GoTo(10.0), wire.ArmPen("target"))
    window.until(lambda m: isinstance(m, wire.PoseMessage) and m.path_mm == pytest.approx(10.0))
    pen.hold(middle)
    pen.presses(middle)
    (target,) = targets(window, 1)
    np.testing.assert_allclose(target.lps, live.session.pose_info().pose.position_lps, atol=1e-6)


def test_distance_from_pen_to_tip_is_reported_in_absolute_mode_and_removed_by_the_join_command(live, window, middle):
    pen = TrackedPen(window)
    pen.hold(middle)
    pen.register(corners(middle))
    window.send(wire.JoinPen())
    refused = window.until(lambda m: isinstance(m, wire.Error))
    assert refused.code == "navigate.not-absolute"
    window.send(wire.SetControl("absolute"))
    place = middle + np.array([10.0, 0.0, 0.0])
    pen.hold(place)
    message = window.until(lambda m: isinstance(m, wire.Pen) and m.off_mm is not None and m.off_mm > 1.0)
    tip = live.session.pose_info().pose.position_lps
    assert message.off_mm == pytest.approx(np.linalg.norm(tip - place), abs=10.0)
    window.send(wire.JoinPen())
    joined = window.until(lambda m: isinstance(m, wire.Pen) and m.off_mm == 0.0)
    assert joined.off_deg == 0.0


def test_pen_outside_the_scan_marks_nothing_and_reports_it(window, middle):
    pen = TrackedPen(window)
    pen.hold(middle)
    pen.register(corners(middle))
    window.send(wire.ArmPen("target"))
    pen.presses(middle + np.array([5000.0, 0.0, 0.0]))
    refused = window.until(lambda m: isinstance(m, wire.Error))
    assert "outside" in refused.message
    assert not [s for s in window.seen if isinstance(s, wire.State) and s.targets]


def test_new_window_receives_the_position_of_a_resting_pen(live, window, middle):
    pen = TrackedPen(window)
    pen.hold(middle)
    window.until(lambda m: isinstance(m, wire.Pen) and m.device is not None)
    with live.window() as other:
        assert other.until(lambda m: isinstance(m, wire.Pen)).device == pen.device
