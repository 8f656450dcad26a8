"""Tests of devices over the wire: samples move the tip, connections start and end, and windows receive their state."""

from __future__ import annotations

import math
import socket
import sys
import time

import numpy as np
import pytest

from carina.commands import Command, DeviceControls, GoTo
from carina.errors import UsageError
from carina.navigate.devices.igtl import IgtlPose, IgtlStream, pose_matrix
from carina.navigate.devices.scope_handle import format_line
from carina.server.devices import DeviceConnections
from carina.server.wire import messages as wire
from carina.session import UserMessage
from simulated_serial import WAIT_S, PseudoPort, sending, wait_for
from small_case import session_fixture

if sys.platform == "win32":
    pytest.skip("there are no pseudo-terminals on Windows", allow_module_level=True)

# Time in seconds that the first frame after a rest may count as elapsed.
FIRST_S = 0.1


def stick(time_s: float, *axes: float) -> wire.DeviceSampleMessage:
    return wire.DeviceSampleMessage(
        device="stick",
        time_s=time_s,
        position_mm=None,
        orientation_wxyz=None,
        axes=(*axes, *(0.0,) * (6 - len(axes))),
        buttons=0,
        handle=None,
        advance=0.0,
    )


def pen(time_s: float, at: tuple[float, float, float], buttons: int = 0) -> wire.DeviceSampleMessage:
    return wire.DeviceSampleMessage(
        device="pen",
        time_s=time_s,
        position_mm=at,
        orientation_wxyz=(1.0, 0.0, 0.0, 0.0),
        axes=None,
        buttons=buttons,
        handle=None,
        advance=0.0,
    )


def do(made: DeviceConnections, command: Command) -> None:
    """Execute a command on the session in the way of the server's hub."""
    made._session.do(command)
    made.done(command)


@pytest.fixture
def connections(tmp_path):
    """Return the device connections over the small case, with its session and the messages that it sent."""
    fixture = session_fixture()
    fixture.session._core.clock = time.monotonic  # The thread of the device manager uses the real time.
    fixture.open()
    sent: list[object] = []
    made = DeviceConnections(fixture.session, sent.append, recordings=tmp_path / "recordings")
    made.start()
    yield made, fixture, sent
    made.stop()
    fixture.session.close()


def test_stick_moves_the_tip_while_it_is_deflected(connections):
    made, fixture, _ = connections
    began = time.monotonic()

    def pushed() -> bool:
        made.handle(stick(time.monotonic(), 1.0))
        time.sleep(0.016)  # Of a device with a higher rate the device manager ignores some samples.
        return fixture.session.pose_info().path_mm > 8.0

    wait_for(pushed)
    made.handle(stick(time.monotonic(), 0.0))
    wait_for(lambda: not fixture.session.devices.woken.is_set())
    at = fixture.session.pose_info().path_mm
    assert at < 25.0 * (time.monotonic() - began + FIRST_S), "25 mm/s"
    time.sleep(0.1)
    assert fixture.session.pose_info().path_mm == at


def test_flood_of_device_samples_gives_at_most_one_pose_per_frame(connections):
    made, fixture, _ = connections
    first = fixture.session.pose_info().pose_id
    began, n = time.monotonic(), 0
    while n <= 500 or time.monotonic() - began < 0.5:
        made.handle(stick(time.monotonic(), 1.0))
        n += 1
    poses = fixture.session.pose_info().pose_id - first
    assert poses <= 1.2 * 125 * (time.monotonic() - began) + 2


def test_invalid_device_samples_are_counted_and_reported_once(connections):
    made, fixture, _ = connections
    made.handle(pen(1.0, (0.0, 0.0, 0.0)))
    for n in range(50):
        made.handle(
            wire.DeviceSampleMessage(
                device="pen",
                time_s=1.0 + n,
                position_mm=(1e300, 0.0, 0.0),
                orientation_wxyz=(0.0, 0.0, 0.0, 0.0),
                axes=None,
                buttons=0,
                handle=None,
                advance=0.0,
            )
        )
    message = made.message()
    assert message is not None
    (device,) = message.devices
    assert (device.num_used, device.num_ignored) == (1, 50)
    assert "(50)" in device.ignored_words
    assert sum("ignored" in getattr(e, "message", "") for e in fixture.events) == 1
    wire.encode_message(message)


def test_registration_returns_its_residual_and_refuses_unusable_pairs(connections):
    made, fixture, _ = connections
    made.handle(pen(1.0, (0.0, 0.0, 0.0)))
    points = ((0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (0.0, 50.0, 0.0))
    do(made, wire.Calibrate("pen", points, points))
    assert any("0.0 mm" in event.message for event in fixture.of_type(UserMessage))
    do(made, wire.SetControl("absolute"))
    assert made.message().control == "absolute"
    with pytest.raises(UsageError, match="line"):
        do(made, wire.Calibrate("pen", points[:1] * 3, points))
    assert made.message().devices[0].registered
    do(made, wire.Calibrate("pen", (), ()))
    assert made.message().control == "relative"
    assert fixture.session.pose_info() is not None


def test_pen_button_without_an_active_tool_adds_a_target_at_the_tip(connections):
    made, fixture, _ = connections
    fixture.session.do(GoTo(20.0))
    do(made, wire.ArmPen("target"))
    made.handle(pen(1.0, (0.0, 0.0, 0.0)))
    made.handle(pen(1.1, (0.0, 0.0, 0.0), buttons=1))
    fixture.background.run_all()
    (target,) = fixture.session.snapshot().document.targets
    np.testing.assert_allclose(target.lps, fixture.session.pose_info().pose.position_lps, atol=1e-9)
    do(made, wire.ArmPen(None))


def test_stick_selects_the_branch_at_a_fork_and_changes_the_route(connections):
    made, fixture, _ = connections
    session = fixture.session
    (trachea, *_) = session.snapshot().document.route.spans
    session.do(GoTo(trachea.to_mm - 3.0))
    assert session.snapshot().document.route.branch_id == 3

    def has_turned() -> bool:
        time.sleep(0.016)
        # For an operator at the head the patient's left is on the left of the picture.
        made.handle(stick(time.monotonic(), 1.0, 0.0, 0.0, -1.0))
        return session.snapshot().document.route.branch_id != 3

    wait_for(has_turned)
    assert session.snapshot().document.route.branch_id == 2
    assert session.snapshot().mode == "path"
    assert session.snapshot().undo_label is None, "a flight is no undo step"


def test_scope_handle_is_connected_listed_and_disconnected(connections):
    made, fixture, sent = connections
    port = PseudoPort()
    address = f"handle:{port.path}"
    try:
        made.handle(wire.WatchDevices(True))
        made.handle(wire.ConnectDevice(address))
        with pytest.raises(UsageError, match="already connected"):
            made.handle(wire.ConnectDevice(address))
        before = fixture.session.pose_info().path_mm
        with sending(lambda n: format_line(n, 10 * n, 0.2 * n), port, rate_hz=100.0):
            wait_for(lambda: fixture.session.pose_info().path_mm > before + 5.0)
            wait_for(
                lambda: any(
                    isinstance(m, wire.DevicesMessage) and m.sources and 50 < m.sources[0].rate_hz < 200 for m in sent
                )
            )
        made.handle(wire.DisconnectDevice(address))
        assert made.message().sources == ()
        made.handle(wire.WatchDevices(False))
    finally:
        port.unplug()


@pytest.mark.parametrize("option", ["", "?silence=30"])
def test_tracker_with_or_without_options_is_disconnected_by_its_displayed_name(connections, option):
    made, _, _ = connections
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        made.handle(wire.ConnectDevice(f"openigtlink:127.0.0.1:{port}{option}"))
        (shown,) = made.message().sources
        with pytest.raises(UsageError, match="already connected"):
            made.handle(wire.ConnectDevice(f"openigtlink:127.0.0.1:{port}"))
        made.handle(wire.DisconnectDevice(shown.address))
        assert made.message().sources == ()


def test_tracker_without_a_port_is_disconnected_by_its_displayed_name(connections):
    made, _, _ = connections
    made.handle(wire.ConnectDevice("openigtlink:127.0.0.1"))
    (shown,) = made.message().sources
    made.handle(wire.DisconnectDevice(shown.address))
    assert made.message().sources == ()


def test_unmoved_scope_handle_that_sends_samples_makes_no_new_poses(connections):
    made, fixture, _ = connections
    made.handle(wire.WatchDevices(True))  # While a window watches the devices, frames continue five times a second.

    def send_sample(n: int, insertion_mm: float) -> None:
        handle = (insertion_mm, 0.1, 0.2)
        made.handle(
            wire.DeviceSampleMessage(
                device="handle",
                time_s=0.01 * n,
                position_mm=None,
                orientation_wxyz=None,
                axes=None,
                buttons=0,
                handle=handle,
                advance=0.0,
            )
        )
        wait_for(lambda: not fixture.session.devices.woken.is_set())

    for n in range(100):
        send_sample(n, 0.1 * n)
    # During these samples the filter comes to rest.
    for n in range(100, 180):
        send_sample(n, 9.9)
    assert fixture.session.pose_info().path_mm > 5.0
    rests = fixture.session.pose_info().pose_id
    for n in range(180, 220):
        send_sample(n, 9.9)
    assert fixture.session.pose_info().pose_id == rests
    send_sample(220, 10.4)
    wait_for(lambda: fixture.session.pose_info().pose_id > rests)


def published(port: int) -> IgtlPose:
    """Return the first pose that a client of the port receives, in RAS."""
    stream = IgtlStream()
    with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as peer:
        while True:
            data = peer.recv(4096)
            assert data, "the connection was closed"
            for found in stream.feed(data):
                assert isinstance(found, IgtlPose)
                return found


def test_tip_pose_is_published_and_recordings_are_written(connections, tmp_path):
    made, fixture, _ = connections
    fixture.session.do(GoTo(20.0))
    made.handle(wire.PublishTip(0))
    port = made.message().published_port
    assert port
    tip = fixture.session.pose_info().pose.lps_from_camera
    # 3D Slicer uses RAS, so left and posterior change their signs; coordinates on the wire are f32.
    np.testing.assert_allclose(pose_matrix(published(port)), np.diag([-1.0, -1.0, 1.0, 1.0]) @ tip, atol=1e-4)
    made.handle(wire.PublishTip(None))
    assert made.message().published_port is None
    made.handle(wire.StartRecording())
    assert made.message().recording is not None
    do(made, wire.StopRecording())
    assert made.message().recording is None
    assert len(list((tmp_path / "recordings").glob("*.jsonl"))) == 1


def test_reported_delay_of_the_device_filter_changes_with_its_smoothing(connections):
    made, _, _ = connections
    assert made.message().filter_latency_ms <= 10.0
    do(made, wire.SetControls(DeviceControls(min_cutoff_hz=5.0)))
    assert made.message().filter_latency_ms == pytest.approx(1000 / (2 * math.pi * 5.0), abs=0.01)
    assert made.handle(wire.Undo()) is False


def test_failed_device_frame_is_logged_once_and_later_frames_run(connections, monkeypatch, caplog):
    made, fixture, _ = connections
    frame, num_failed = fixture.session.devices.frame, 0

    def failing():
        nonlocal num_failed
        fixture.session.devices.woken.clear()
        num_failed += 1
        raise RuntimeError("a fault of ours")

    monkeypatch.setattr(fixture.session.devices, "frame", failing)
    for n in range(1, 4):
        fixture.session.devices.woken.set()
        wait_for(lambda n=n: num_failed >= n)
    monkeypatch.setattr(fixture.session.devices, "frame", frame)
    before = fixture.session.pose_info().pose
    made.handle(stick(time.monotonic(), 1.0))
    wait_for(lambda: fixture.session.pose_info().pose is not before)
    assert [
        r.levelname for r in caplog.records if ("processing the device input of one frame failed") in r.message
    ] == ["ERROR"]
