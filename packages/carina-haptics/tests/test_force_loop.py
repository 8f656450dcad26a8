"""The force loop in process and over UDP, its packets, and the vibration of gamepads."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Callable

import numpy as np
import pytest

from carina.errors import UsageError
from carina.render import picture_threads
from carina.scopes import WallField
from carina_haptics import (
    FORCE_LIMIT_N,
    FORCE_SLEW_N_PER_MS,
    ForceLaw,
    ForceLoop,
    _force,
    decode_force,
    encode_sample,
    forces_along,
    rumble,
)


def until(is_so: Callable[[], bool]) -> None:
    """Wait until another thread has reached a state; the limit suits a busy machine."""
    end = time.monotonic() + 20.0
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_force_is_zero_in_the_lumen_and_directed_into_the_lumen_in_the_wall(tube: WallField, reach_mm: float) -> None:
    with ForceLoop(tube, ForceLaw(friction=0.0)) as loop:
        until(lambda: loop.put((0.0, 0.0, -20.0)) and loop.felt().at_lps == (0.0, 0.0, -20.0))
        assert loop.felt().force_n == (0.0, 0.0, 0.0)
        assert not loop.felt().touches
        # 1 mm deep.
        until(lambda: loop.put((reach_mm + 1.0, 0.0, -20.0)) and loop.felt().force_n[0] < -0.38)
        felt = loop.felt()
        assert felt.touches
        assert felt.force_n == pytest.approx((-0.4, 0.0, 0.0), abs=0.02)
        until(lambda: loop.felt().silent and loop.felt().force_n == (0.0, 0.0, 0.0))
        figures = loop.figures()
        assert figures.max_force_n <= FORCE_LIMIT_N
        assert figures.max_change_n <= FORCE_SLEW_N_PER_MS + 1e-12
        until(lambda: loop.figures().num_samples > 0)
        assert not loop.put((math.nan, 0.0, 0.0))
        assert loop.figures().num_refused == 1
    loop.stop()


def test_udp_reply_has_the_number_of_its_sample(tube: WallField, reach_mm: float) -> None:
    with ForceLoop(tube, udp_port=0) as loop, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", loop.port))
        link.settimeout(20.0)
        force, requested = (0.0, 0.0, 0.0), time.monotonic()
        for number in range(1, 60):
            deep = 0.0 if number == 1 else reach_mm + 1.0
            before, requested = requested, time.monotonic()
            link.send(encode_sample(number, 7 * number, (0.0, deep, -20.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
            reply = decode_force(link.recv(256))
            assert reply is not None
            assert (reply.number, reply.device_us) == (number, 7 * number)
            change = math.dist(reply.force_n, force)
            force = reply.force_n
            # Between two replies to a late bridge there is one tick per millisecond, and one at each end.
            num_ticks = 1000.0 * (time.monotonic() - before) + 2.0
            assert change <= FORCE_SLEW_N_PER_MS * num_ticks
        assert force[1] < -0.2
        until(lambda: loop.figures().num_samples >= 59)
        assert 0.0 < loop.figures().max_change_n <= FORCE_SLEW_N_PER_MS + 1e-12
        for broken in (b"", b"CARH", bytes(96), encode_sample(1, 1, (math.nan,) * 3, (0,) * 3, (0, 0, -1))):
            link.send(broken)
        until(lambda: loop.figures().num_refused == 4)


def test_udp_packets_have_the_byte_layout_of_the_documentation() -> None:
    sample = encode_sample(5, 1_000_000, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (0.0, 0.0, -1.0), buttons=3)
    assert len(sample) == 96
    assert sample[:8] == b"CARH\x01\x01\x03\x00"
    assert struct.unpack_from("<I", sample, 8) == (5,)
    assert struct.unpack_from("<Q", sample, 16) == (1_000_000,)
    assert struct.unpack_from("<9d", sample, 24) == (1, 2, 3, 4, 5, 6, 0, 0, -1)
    reply = b"CARH\x01\x02\x05\x00" + struct.pack("<IIQ6d", 5, 0, 9, 0.1, 0.2, 0.3, 4, 5, 6)
    found = decode_force(reply)
    assert found is not None
    assert (found.number, found.device_us, found.force_n) == (5, 9, (0.1, 0.2, 0.3))
    assert (found.touches, found.limited, found.silent) == (True, False, True)
    assert decode_force(reply[:-1]) is None
    assert decode_force(b"XARH" + reply[4:]) is None


def test_force_loop_refuses_a_force_law_port_or_workspace_out_of_range(tube: WallField) -> None:
    for law in (ForceLaw(stiffness_n_per_mm=9.0), ForceLaw(watchdog_ms=math.inf), ForceLaw(tip_radius_mm=math.nan)):
        with pytest.raises(UsageError) as refused:
            ForceLoop(tube, law)
        assert refused.value.code == "scope.force"
    with pytest.raises(UsageError):
        ForceLoop(tube, udp_port=70000)
    with pytest.raises(UsageError):
        ForceLoop(tube, lps_from_device=np.diag([1.0, 1.0, 0.5, 1.0]))
    with pytest.raises(UsageError, match="mirrored") as refused:
        ForceLoop(tube, lps_from_device=np.diag([-0.5, 0.5, 0.5, 1.0]))
    assert refused.value.code == "scope.force"
    with ForceLoop(tube, udp_port=0) as loop, pytest.raises(UsageError, match="could not be opened"):
        ForceLoop(tube, udp_port=loop.port)


def test_gamepad_vibration_increases_with_the_depth_of_contact() -> None:
    assert rumble(0.0) == (0.0, 0.0)
    weak, strong = rumble(1.0), rumble(8.0)
    assert weak[0] < strong[0] <= 1.0
    assert 0.2 < weak[1] < strong[1] <= 1.0
    assert rumble(math.nan) == (0.0, 0.0)


def test_running_force_loop_reduces_the_rendering_threads_by_one() -> None:
    _, y, x = np.mgrid[0:20, -10:11, -10:11].astype(np.float32)
    matrix = np.diag([1.0, 1.0, 1.0, 1.0])
    matrix[:3, 3] = (-10.0, -10.0, 0.0)
    field = WallField.from_distances(6.0 - np.hypot(x, y), matrix)
    before = picture_threads()
    with ForceLoop(field) as loop:
        assert picture_threads() == max(1, before - 1)
        # A second loop takes no further thread.
        with ForceLoop(field):
            assert picture_threads() == max(1, before - 1)
        assert picture_threads() == max(1, before - 1)
        loop.stop()
        assert picture_threads() == before
    assert picture_threads() == before


def test_statistics_of_the_force_loop_count_steps_and_missed_steps(tube: WallField) -> None:
    with ForceLoop(tube) as loop:
        until(lambda: loop.figures().num_ticks >= 200)
        figures = loop.figures()
    assert figures.is_real_time in {False, True}
    assert 0 <= figures.num_missed < figures.num_ticks
    assert figures.work_us[0] <= figures.work_us[1] <= max(figures.work_us[2], 1.0)


def test_repr_of_a_force_loop_is_one_line_with_its_force_law(tube: WallField) -> None:
    with ForceLoop(tube) as loop:
        assert repr(loop).startswith("ForceLoop(ForceLaw(")
        assert "\n" not in repr(loop)
        assert len(repr(loop)) <= 160


def test_forces_of_a_recorded_movement_repeat_exactly(tube: WallField, reach_mm: float) -> None:
    samples = np.zeros((100, 9))
    samples[:, 0] = np.linspace(0.0, reach_mm + 2.0, 100)
    samples[:, 2] = -20.0
    samples[:, 8] = -1.0
    forces = forces_along(tube, samples)
    assert (forces[:50] == 0.0).all()
    assert forces[-1, 0] < -0.3
    np.testing.assert_array_equal(forces_along(tube, samples), forces)
    with pytest.raises(UsageError) as refused:
        forces_along(tube, samples[:, :8])
    assert refused.value.code == "scope.force"


def test_force_loop_refuses_damaged_wall_field_bytes(tube: WallField) -> None:
    good = tube.to_bytes()
    samples = np.zeros((1, 9))
    assert _force.forces_along(good, ForceLaw().numbers, samples).shape == (1, 3)
    for broken in (b"", good[:-1], good[:200], b"\xff" * 120 + good[120:]):
        with pytest.raises(UsageError) as refused:
            _force.forces_along(broken, ForceLaw().numbers, samples)
        assert refused.value.code == "scope.wall"


def test_force_loop_refuses_a_path_and_a_workspace_of_wrong_shape(tube: WallField) -> None:
    for options in ({"path_lps": np.zeros((2, 2))}, {"lps_from_device": np.eye(3)}):
        with pytest.raises(UsageError) as refused:
            ForceLoop(tube, **options)
        assert refused.value.code == "scope.force"
