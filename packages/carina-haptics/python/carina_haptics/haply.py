"""Client of the local service of Haply devices (Inverse3): JSON over a WebSocket on this machine.

The service sends the state of all devices in one message and answers each command with the next message. Positions are
metres in the axes of the device (x right, y away from the user, z up); forces are newtons. The client agrees with
published clients of service 3.1 and later and with a simulated service; a test with a device is missing.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError
from carina.scopes import Pose
from carina_haptics.force_loop import ForceLoop

__all__ = ["HAPLY_URL", "HaplyBridge", "HaplyState", "read_haply_message"]

HAPLY_URL = "ws://127.0.0.1:10001"
"""WebSocket address of Haply's service on this machine."""
Status = Literal["connecting", "no device", "running", "stopped"]
Point = tuple[float, float, float]

# Short enough that a user does not notice the pause after the service restarts.
_RETRY_S = 1.0
_SILENCE_S = 1.0
_MAX_BYTES = 65536
# Upper limits of a device's size and of a hand's speed.
_MAX_M, _MAX_M_PER_S = 2.0, 20.0
# A valid quaternion has unit length; the limit only keeps its square finite.
_MAX_QUATERNION = 1e3


@dataclass(frozen=True, slots=True)
class HaplyState:
    """State of one device and of its grip, as the service reports them."""

    device_id: str
    position_m: Point
    velocity_m_s: Point
    orientation_wxyz: tuple[float, float, float, float] | None
    """Orientation of the wireless grip, unit length; None without a grip."""
    buttons: frozenset[str]
    """Names of the buttons that are pressed on the grip."""


def read_haply_message(text: str | bytes) -> HaplyState | None:
    """Return the state of the first device in a message; None for a message without a device.

    Raises
    ------
    ValueError
        If the message is not JSON in the form of the service, or contains impossible numbers.
    """
    found = json.loads(text)
    if not isinstance(found, dict):
        raise ValueError("expected an object")
    devices = found.get("inverse3") or []
    if not isinstance(devices, list) or not all(isinstance(d, dict) for d in devices):
        raise ValueError("expected a list of devices")
    if not devices:
        return None
    device_id, state = devices[0].get("device_id"), devices[0].get("state")
    if not isinstance(device_id, str) or not isinstance(state, dict):
        raise ValueError("expected a device with an id and a state")
    grips = found.get("wireless_verse_grip") or []
    grip = grips[0].get("state", {}) if isinstance(grips, list) and grips and isinstance(grips[0], dict) else {}
    turn = grip.get("orientation") if isinstance(grip, dict) else None
    held = grip.get("buttons") if isinstance(grip, dict) else None
    return HaplyState(
        device_id=device_id,
        position_m=_vector(state.get("cursor_position"), _MAX_M),
        velocity_m_s=_vector(state.get("cursor_velocity"), _MAX_M_PER_S),
        orientation_wxyz=None if not isinstance(turn, dict) else _quaternion(turn),
        buttons=frozenset(name for name, down in held.items() if down is True)
        if isinstance(held, dict)
        else frozenset(),
    )


def _vector(found: object, most: float) -> Point:
    if not isinstance(found, dict):
        raise ValueError("expected x, y, z")
    values = [found.get(axis) for axis in "xyz"]
    if not all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= most for v in values):
        raise ValueError(f"expected x, y, z within {most}")
    x, y, z = (float(v) for v in values if v is not None)
    return x, y, z


def _quaternion(found: dict[str, Any]) -> tuple[float, float, float, float] | None:
    values = [found.get(axis) for axis in "wxyz"]
    # An integer may be too large for a float, and a float for its square.
    if not all(isinstance(v, int | float) and abs(v) <= _MAX_QUATERNION for v in values):
        raise ValueError("expected a quaternion w, x, y, z")
    length = math.sqrt(sum(float(v) ** 2 for v in values if v is not None))
    if length < 0.5:
        # A grip that has not started yet sends zeros.
        return None
    w, x, y, z = (float(v) / length for v in values if v is not None)
    return w, x, y, z


class HaplyBridge:
    """Coupling of a Haply device and a force loop.

    The position of the hand in the first state (or in the first state after `centre`) corresponds to `pose`; from
    there the tip follows the hand, scaled. Right, away and up of the device are right, forward and up of the picture.

    Parameters
    ----------
    loop
        Source of the force. The bridge passes the samples to the loop; no other device may do so.
    pose
        Pose of the tip when the hand is at rest.
    scale
        Movement of the tip (mm) per mm of the hand, 0.05 to 1.
    url
        Address of the service.

    Raises
    ------
    UsageError
        If the scale is out of range (code ``scope.force``).
    """

    def __init__(self, loop: ForceLoop, pose: Pose, *, scale: float = 0.25, url: str = HAPLY_URL) -> None:
        if not 0.05 <= scale <= 1.0:
            raise UsageError(f"expected a scale from 0.05 to 1; found {scale}", code="scope.force")
        self._loop = loop
        self._scale = scale
        self._url = url
        self._status: Status = "stopped"
        self._state: HaplyState | None = None
        self._rest_m: NDArray[np.float64] | None = None
        self._num_refused = 0
        self._num_samples = 0
        self._lps_from_device = np.eye(3)
        self._at_lps = np.zeros(3)
        self.centre(pose)

    @property
    def status(self) -> Status:
        """State of the connection: ``connecting``, ``no device``, ``running`` or ``stopped``."""
        return self._status

    @property
    def state(self) -> HaplyState | None:
        """State of the device that the service reported last; None before the first one."""
        return self._state

    @property
    def num_refused(self) -> int:
        """Number of invalid messages from the service."""
        return self._num_refused

    @property
    def num_samples(self) -> int:
        """Number of states that the bridge passed to the loop."""
        return self._num_samples

    def centre(self, pose: Pose) -> None:
        """Assign this pose to the position of the hand in the next state (a clutch)."""
        matrix = pose.lps_from_camera
        # Right, away and up of the device are +x, +z and -y of the camera.
        self._lps_from_device = np.stack([matrix[:3, 0], matrix[:3, 2], -matrix[:3, 1]], axis=1)
        self._at_lps = matrix[:3, 3].copy()
        self._rest_m = None

    async def run(self) -> None:
        """Connect and serve the device until cancelled; reconnect after a lost connection; release the force last."""
        from websockets.asyncio.client import connect
        from websockets.exceptions import WebSocketException

        try:
            while True:
                self._status = "connecting"
                with contextlib.suppress(OSError, WebSocketException, TimeoutError):
                    async with connect(self._url, max_size=_MAX_BYTES, compression=None, open_timeout=5) as link:
                        await self._serve(link)
                # The hand may have moved before the connection returns.
                self._rest_m = None
                await asyncio.sleep(_RETRY_S)
        finally:
            self._status = "stopped"

    async def _serve(self, link: Any) -> None:
        device_id: str | None = None
        self._status = "no device"
        try:
            while True:
                # `wait_for` of Python 3.11 loses a cancellation that arrives together with a message.
                async with asyncio.timeout(_SILENCE_S):
                    text = await link.recv()
                try:
                    state = read_haply_message(text)
                except (ValueError, AttributeError, RecursionError):
                    self._num_refused += 1
                    state = None
                    if device_id is None:
                        continue
                if state is None:
                    # After an invalid message the commanded force is zero. Commands need the ID of a device.
                    if device_id is None:
                        self._status = "no device"
                        continue
                    await link.send(_command(device_id, (0.0, 0.0, 0.0)))
                    continue
                device_id, self._status, self._state = state.device_id, "running", state
                await link.send(_command(device_id, self.feel(state)))
        finally:
            if device_id is not None:
                with contextlib.suppress(Exception):
                    await link.send(_command(device_id, (0.0, 0.0, 0.0)))

    def feel(self, state: HaplyState) -> Point:
        """Pass a state to the loop and return the loop's latest force (N, axes of the device)."""
        position = np.array(state.position_m)
        if self._rest_m is None:
            self._rest_m = position
        factor = 1000.0 * self._scale
        at = self._at_lps + self._lps_from_device @ (factor * (position - self._rest_m))
        velocity = self._lps_from_device @ (factor * np.array(state.velocity_m_s))
        forward = self._lps_from_device @ _forward(state.orientation_wxyz)
        if not self._loop.put(at.tolist(), velocity.tolist(), forward.tolist()):
            return 0.0, 0.0, 0.0
        self._num_samples += 1
        felt = self._loop.felt()
        if felt.silent:
            return 0.0, 0.0, 0.0
        x, y, z = self._lps_from_device.T @ np.array(felt.force_n)
        return float(x), float(y), float(z)


def _forward(orientation_wxyz: Sequence[float] | None) -> NDArray[np.float64]:
    """Return the direction of the grip in the axes of the device: away from the user, turned like the grip."""
    if orientation_wxyz is None:
        return np.array([0.0, 1.0, 0.0])
    w, x, y, z = orientation_wxyz
    # Second column of the rotation matrix: the image of the y axis.
    return np.array([2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)])


def _command(device_id: str, force_n: Sequence[float]) -> str:
    x, y, z = force_n
    values = {"x": x, "y": y, "z": z}
    return json.dumps({"inverse3": [{"device_id": device_id, "commands": {"set_cursor_force": {"values": values}}}]})
