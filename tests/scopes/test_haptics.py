"""Force feedback from Python: the loop, its packets, a Haply service that is simulated."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from carina.errors import UsageError
from carina.scopes import (
    FORCE_LIMIT_N,
    FORCE_SLEW_N_PER_MS,
    ForceLaw,
    ForceLoop,
    Pose,
    WallField,
    picture_threads,
    rumble,
)
from carina.scopes.haply import HaplyBridge, read_haply_message
from carina.scopes.haptic_packets import decode_force, encode_sample

RADIUS = 8.0
REACH = RADIUS - ForceLaw().tip_radius_mm
"""How far from the axis the tip's centre is free."""


@pytest.fixture(scope="module")
def tube() -> WallField:
    """A straight airway along z."""
    z, y, x = np.mgrid[0:80, -24:25, -24:25].astype(np.float64)
    matrix = np.diag([0.5, 0.5, 0.5, 1.0])
    matrix[:3, 3] = (-12.0, -12.0, -40.0)
    return WallField.from_distances((RADIUS - 0.5 * np.hypot(x, y) + 0.0 * z).astype(np.float32), matrix)


def until(is_so: Callable[[], bool]) -> None:
    """Wait for another thread, as long as a loaded machine may take."""
    end = time.monotonic() + 20.0
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_the_loop_gives_no_force_in_the_free_and_the_walls_in_it(tube: WallField) -> None:
    with ForceLoop(tube, ForceLaw(friction=0.0)) as loop:
        until(lambda: loop.put((0.0, 0.0, -20.0)) and loop.felt().at_lps == (0.0, 0.0, -20.0))
        assert loop.felt().force_n == (0.0, 0.0, 0.0)
        assert not loop.felt().touches
        # 1 mm deep.
        until(lambda: loop.put((REACH + 1.0, 0.0, -20.0)) and loop.felt().force_n[0] < -0.38)
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


def test_a_bridge_over_udp_is_answered_by_its_number(tube: WallField) -> None:
    with ForceLoop(tube, udp_port=0) as loop, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", loop.port))
        link.settimeout(20.0)
        force, asked = (0.0, 0.0, 0.0), time.monotonic()
        for number in range(1, 60):
            deep = 0.0 if number == 1 else REACH + 1.0
            before, asked = asked, time.monotonic()
            link.send(encode_sample(number, 7 * number, (0.0, deep, -20.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
            reply = decode_force(link.recv(256))
            assert reply is not None
            assert (reply.number, reply.device_us) == (number, 7 * number)
            change = math.dist(reply.force_n, force)
            force = reply.force_n
            # Ticks lie between the answers of a bridge that is held up: one a millisecond, and one begun at each end.
            num_ticks = 1000.0 * (time.monotonic() - before) + 2.0
            assert change <= FORCE_SLEW_N_PER_MS * num_ticks
        assert force[1] < -0.2
        until(lambda: loop.figures().num_samples >= 59)
        assert 0.0 < loop.figures().max_change_n <= FORCE_SLEW_N_PER_MS + 1e-12
        for broken in (b"", b"CARH", bytes(96), encode_sample(1, 1, (math.nan,) * 3, (0,) * 3, (0, 0, -1))):
            link.send(broken)
        until(lambda: loop.figures().num_refused == 4)


def test_packets_lie_as_the_guide_says() -> None:
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


def test_laws_ports_and_spaces_out_of_range_are_refused(tube: WallField) -> None:
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


def test_a_gamepad_rumbles_with_the_depth_of_contact() -> None:
    assert rumble(0.0) == (0.0, 0.0)
    weak, strong = rumble(1.0), rumble(8.0)
    assert weak[0] < strong[0] <= 1.0
    assert 0.2 < weak[1] < strong[1] <= 1.0
    assert rumble(math.nan) == (0.0, 0.0)


def message(x: float, y: float, z: float, **more: Any) -> dict[str, Any]:
    """A message of the service; metres."""
    state = {"cursor_position": {"x": x, "y": y, "z": z}, "cursor_velocity": {"x": 0.0, "y": 0.0, "z": 0.0}}
    return {"inverse3": [{"device_id": "0417", "state": state}], **more}


def test_a_message_of_the_service_is_read_and_a_broken_one_refused() -> None:
    grip = {"orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 2.0}, "buttons": {"a": True, "b": False}}
    state = read_haply_message(json.dumps(message(0.1, -0.2, 0.3, wireless_verse_grip=[{"state": grip}])))
    assert state is not None
    assert (state.device_id, state.position_m, state.orientation_wxyz) == ("0417", (0.1, -0.2, 0.3), (1, 0, 0, 0))
    assert state.buttons == {"a"}
    assert read_haply_message('{"inverse3": []}') is None
    good = json.dumps(message(0.1, -0.2, 0.3))
    huge = [{"state": {"orientation": {"w": 10**400, "x": 0, "y": 0, "z": 0}}}]
    long = [{"state": {"orientation": {"w": 1e200, "x": 0, "y": 0, "z": 0}}}]
    for broken in (
        "",
        "[]",
        json.dumps(message(0.1, -0.2, 0.3, wireless_verse_grip=huge)),
        json.dumps(message(0.1, -0.2, 0.3, wireless_verse_grip=long)),
        good[:-2],
        good.replace("0.1", "NaN"),
        good.replace("0.1", "1e9"),
        good.replace("0.1", "[]"),
    ):
        with pytest.raises(ValueError, match=r"expected|Expecting|JSON"):
            read_haply_message(broken)


def test_a_haply_service_is_served_survives_nonsense_and_comes_back(tube: WallField) -> None:
    from websockets.asyncio.server import ServerConnection, serve

    forces: list[tuple[float, float, float]] = []
    num_connections = 0

    async def service(link: ServerConnection) -> None:
        """Sends a state, takes a force, as the service does; the hand goes 40 mm to its right and stays."""
        nonlocal num_connections
        num_connections += 1
        await link.send(json.dumps({"inverse3": []}))
        await link.send("nonsense")
        for n in range(400):
            await link.send(json.dumps(message(0.1 * min(1.0, n / 100), -0.2, 0.3)))
            command = json.loads(await link.recv())["inverse3"][0]
            assert command["device_id"] == "0417"
            values = command["commands"]["set_cursor_force"]["values"]
            forces.append((values["x"], values["y"], values["z"]))
            await asyncio.sleep(0.001)
        await link.close()

    async def drive() -> HaplyBridge:
        # Looking down the airway: right is the patient's right.
        pose = Pose(np.array([[-1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, -1.0, -20.0], [0, 0, 0, 1.0]]))
        with ForceLoop(tube, ForceLaw(friction=0.0)) as loop:
            async with serve(service, "127.0.0.1", 0) as server:
                port = server.sockets[0].getsockname()[1]
                bridge = HaplyBridge(loop, pose, scale=0.08, url=f"ws://127.0.0.1:{port}")
                task = asyncio.create_task(bridge.run())
                try:
                    async with asyncio.timeout(60):
                        while num_connections < 2 or len(forces) < 420:
                            await asyncio.sleep(0.01)
                    assert bridge.status == "running"
                finally:
                    # Also where it took too long: a bridge that goes on keeps the service from ending.
                    task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
            return bridge

    bridge = asyncio.run(drive())
    assert bridge.status == "stopped"
    assert bridge.num_refused == 2
    assert forces[0] == (0.0, 0.0, 0.0)
    # 100 mm of the hand are 8 mm: 2.45 mm into the wall at 0.4 N/mm, back to the left of the hand.
    assert forces[395] == pytest.approx((-0.4 * (8.0 - REACH), 0.0, 0.0), abs=0.05)
    # Back again, it starts free where the hand is.
    assert forces[400] == (0.0, 0.0, 0.0)


def test_a_scale_out_of_range_is_refused(tube: WallField) -> None:
    with ForceLoop(tube) as loop, pytest.raises(UsageError):
        HaplyBridge(loop, Pose(np.eye(4)), scale=5.0)


def test_a_force_loop_leaves_itself_a_thread_and_gives_it_back() -> None:
    _, y, x = np.mgrid[0:20, -10:11, -10:11].astype(np.float32)
    matrix = np.diag([1.0, 1.0, 1.0, 1.0])
    matrix[:3, 3] = (-10.0, -10.0, 0.0)
    field = WallField.from_distances(6.0 - np.hypot(x, y), matrix)
    before = picture_threads()
    with ForceLoop(field) as loop:
        assert picture_threads() == max(1, before - 1)
        # Two leave no more than one.
        with ForceLoop(field):
            assert picture_threads() == max(1, before - 1)
        assert picture_threads() == max(1, before - 1)
        loop.stop()
        assert picture_threads() == before
    assert picture_threads() == before


def test_a_loop_says_how_it_kept_time(tube: WallField) -> None:
    with ForceLoop(tube) as loop:
        until(lambda: loop.figures().num_ticks >= 200)
        figures = loop.figures()
    assert figures.is_real_time in {False, True}
    assert 0 <= figures.num_missed < figures.num_ticks
    assert figures.work_us[0] <= figures.work_us[1] <= max(figures.work_us[2], 1.0)
