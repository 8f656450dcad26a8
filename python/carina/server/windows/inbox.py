"""Queue of received messages of one window, which merges movements and drops superseded settings.

The web client sends one movement per screen refresh. A script can send a thousand a second, each of which takes
milliseconds; without merging, all other work of the server would wait.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from carina.commands import Command
from carina.server.wire import messages as wire

STEER_EVERY_S = 0.004
"""Seconds between two movements below which they are merged; a screen shows at most 240 pictures a second."""
MAX_WAITING = 64
"""Number of queued messages above which the server stops reading from the socket."""
LONGEST_PAUSE_S = 0.1
"""Maximum pause in s before the next message of a client that may use only a share of the event loop's time."""
MAX_ADVANCE_MM = 1000.0
MAX_TURN_RAD = 7.0
NEWEST_ONLY = (
    wire.SetOrbit,
    wire.SetZoom,
    wire.SetCarm,
    wire.SetReformation,
    wire.SetSlab,
    wire.SetCrosshair,
    wire.SetWindow,
    wire.SetFov,
    wire.GoTo,
    wire.Probe,
    wire.AskLivePath,
    wire.AskTargetMark,
    wire.AskBranchDetail,
    wire.Layout,
)
"""Types of messages that replace the message before, if it has the same type and (where they have one) ``view``."""


class Inbox:
    """Queue of the messages of one window, in order; used from the event loop only.

    Parameters
    ----------
    handle
        Handles one message synchronously; must not raise.
    handled
        Called after each command with the number of commands that were executed, refused or superseded so far.
    share
        Maximum share of the event loop's time for these messages, more than 0 and at most 1.
    """

    def __init__(
        self,
        handle: Callable[[Any], None],
        handled: Callable[[int], None] = lambda _number: None,
        *,
        share: float = 1.0,
    ) -> None:
        self._handle = handle
        self._handled = handled
        self._pause_per_s = 1.0 / share - 1.0
        self._waiting: deque[tuple[int, Any]] = deque()
        """Queued messages, each with the number of commands received up to it, merged commands included."""
        self._num_commands = 0
        self._num_handled = 0
        self._changed = asyncio.Event()
        self._has_space = asyncio.Event()
        self._has_space.set()
        self._steered_s = float("-inf")

    @property
    def num_waiting(self) -> int:
        """Number of queued messages."""
        return len(self._waiting)

    async def put(self, message: Any) -> None:
        """Queue a message, or merge it into the last one; wait while the queue is full."""
        await self._has_space.wait()
        self._num_commands += isinstance(message, Command)
        if self._waiting and (merged := _merge(self._waiting[-1][1], message)) is not None:
            self._waiting[-1] = self._num_commands, merged
            return
        self._waiting.append((self._num_commands, message))
        if len(self._waiting) >= MAX_WAITING:
            self._has_space.clear()
        self._changed.set()

    async def run(self) -> None:
        """Handle messages until cancelled, and yield to the event loop after each message."""
        loop = asyncio.get_running_loop()
        try:
            await self._handle_messages(loop)
        finally:
            self._has_space.set()

    async def _handle_messages(self, loop: asyncio.AbstractEventLoop) -> None:
        while True:
            await self._changed.wait()
            if len(self._waiting) == 1 and self._is_steer_next():
                # The wait lets further movements arrive, which are merged; no other message of this window is delayed
                # by it.
                soon_s = self._steered_s + STEER_EVERY_S - loop.time()
                if soon_s > 0.0:
                    await asyncio.sleep(soon_s)
            if self._is_steer_next():
                self._steered_s = loop.time()
            begun_s = loop.time()
            self._handle_next()
            await asyncio.sleep(min(self._pause_per_s * (loop.time() - begun_s), LONGEST_PAUSE_S))

    def _is_steer_next(self) -> bool:
        return bool(self._waiting) and isinstance(self._waiting[0][1], wire.Steer)

    def clear(self) -> None:
        """Drop all queued messages, after a client has sent too many."""
        self._waiting.clear()
        self._changed.clear()
        self._has_space.set()

    def handle_all(self) -> None:
        """Handle all queued messages now, after the client has disconnected."""
        while self._waiting:
            self._handle_next()

    def _handle_next(self) -> None:
        if self._waiting:
            num_commands, message = self._waiting.popleft()
            self._has_space.set()
            if not self._waiting:
                self._changed.clear()
            self._handle(message)
            if num_commands != self._num_handled:
                self._num_handled = num_commands
                self._handled(num_commands)


def _merge(before: Any, after: Any) -> Any:
    """Return one message with the effect of two consecutive messages; None if they cannot be merged."""
    if type(before) is not type(after):
        return None
    if isinstance(after, wire.Steer):
        return _sum_movements(before, after)
    if isinstance(after, NEWEST_ONLY) and getattr(before, "view", None) == getattr(after, "view", None):
        return after
    return None


def _sum_movements(a: wire.Steer, b: wire.Steer) -> wire.Steer | None:
    """Return the sum of two movements; None if the sum exceeds the limits of one message."""
    summed = wire.Steer(
        a.advance_mm + b.advance_mm, a.yaw_rad + b.yaw_rad, a.pitch_rad + b.pitch_rad, a.roll_rad + b.roll_rad
    )
    turns = max(abs(summed.yaw_rad), abs(summed.pitch_rad), abs(summed.roll_rad))
    return summed if abs(summed.advance_mm) <= MAX_ADVANCE_MM and turns <= MAX_TURN_RAD else None
