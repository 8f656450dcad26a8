"""The client of the Haply service, against a simulated service."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import numpy as np
import pytest

from carina.errors import UsageError
from carina.scopes import Pose, WallField
from carina_haptics import ForceLaw, ForceLoop, HaplyBridge, read_haply_message


def message(x: float, y: float, z: float, **more: Any) -> dict[str, Any]:
    """Return a message of the service with a position in metres."""
    state = {"cursor_position": {"x": x, "y": y, "z": z}, "cursor_velocity": {"x": 0.0, "y": 0.0, "z": 0.0}}
    return {"inverse3": [{"device_id": "0417", "state": state}], **more}


def test_haply_message_is_read_and_an_invalid_one_is_refused() -> None:
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


def test_haply_bridge_continues_after_invalid_messages_and_reconnects(tube: WallField, reach_mm: float) -> None:
    from websockets.asyncio.server import ServerConnection, serve

    forces: list[tuple[float, float, float]] = []
    num_connections = 0

    async def service(link: ServerConnection) -> None:
        """Simulate the service: send a state, receive a force; the hand moves 100 mm to its right and stays."""
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
        # The view is down the airway, so that right in the picture is the patient's right.
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
                    # A running bridge would keep the service open, also after a timeout.
                    task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
            return bridge

    bridge = asyncio.run(drive())
    assert bridge.status == "stopped"
    assert bridge.num_refused == 2
    assert forces[0] == (0.0, 0.0, 0.0)
    # 100 mm of the hand are 8 mm of the tip: 2.45 mm into the wall at 0.4 N/mm, pushed to the left of the hand.
    assert forces[395] == pytest.approx((-0.4 * (8.0 - reach_mm), 0.0, 0.0), abs=0.05)
    # After the new connection the tip starts free at the position of the hand.
    assert forces[400] == (0.0, 0.0, 0.0)


def test_haply_bridge_refuses_a_scale_out_of_range(tube: WallField) -> None:
    with ForceLoop(tube) as loop, pytest.raises(UsageError):
        HaplyBridge(loop, Pose(np.eye(4)), scale=5.0)
