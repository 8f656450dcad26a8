"""What a client sent and Carina has not done yet: movements add up, of wishes the newest counts, others get a turn.

The client of ours sends a movement per screen refresh. A script may send a thousand a second, each of which takes
milliseconds: all else on this machine would wait behind them.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from carina.commands import Command
from carina.server import messages as wire

__all__ = ["Inbox"]

STEER_EVERY_S = 0.004
"""Movements that follow each other faster are one; a screen shows at most 240 a second."""
MAX_WAITING = 64
"""Beyond this nothing is read: the network waits."""
LONGEST_PAUSE_S = 0.1
"""Between two messages of a client with a share of the time, whatever the first of them took."""
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
    wire.AskBranchDetail,
    wire.Layout,
)
"""Of two of them that follow each other, with the same value of ``view`` where they have one, the first is void."""


class Inbox:
    """The messages of one window, in their order; event loop only.

    Parameters
    ----------
    handle
        Does one message, at once; must not raise.
    handled
        Told after each command how many have been done or refused, those included of which a newer one took the place.
    share
        Largest share of the event loop's time that these messages may take, more than 0 and at most 1.
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
        """Each with the number of commands that have come with it, those that went into it included."""
        self._num_commands = 0
        self._num_handled = 0
        self._changed = asyncio.Event()
        self._room = asyncio.Event()
        self._room.set()
        self._steered_s = float("-inf")

    @property
    def num_waiting(self) -> int:
        """How many have not been done."""
        return len(self._waiting)

    async def put(self, message: Any) -> None:
        """One more; waits while there are too many."""
        await self._room.wait()
        self._num_commands += isinstance(message, Command)
        if self._waiting and (merged := _merged(self._waiting[-1][1], message)) is not None:
            self._waiting[-1] = self._num_commands, merged
            return
        self._waiting.append((self._num_commands, message))
        if len(self._waiting) >= MAX_WAITING:
            self._room.clear()
        self._changed.set()

    async def work(self) -> None:
        """Do them until cancelled; whatever else the loop has to do comes in between."""
        loop = asyncio.get_running_loop()
        try:
            await self._work(loop)
        finally:
            self._room.set()

    async def _work(self, loop: asyncio.AbstractEventLoop) -> None:
        while True:
            await self._changed.wait()
            if len(self._waiting) == 1 and self._is_steer_next():
                # Behind it there may be more of the same in a moment; nothing else waits for it.
                soon_s = self._steered_s + STEER_EVERY_S - loop.time()
                if soon_s > 0.0:
                    await asyncio.sleep(soon_s)
            if self._is_steer_next():
                self._steered_s = loop.time()
            begun_s = loop.time()
            self._do_next()
            await asyncio.sleep(min(self._pause_per_s * (loop.time() - begun_s), LONGEST_PAUSE_S))

    def _is_steer_next(self) -> bool:
        return bool(self._waiting) and isinstance(self._waiting[0][1], wire.Steer)

    def drop(self) -> None:
        """Do none of those that are left: the client sent too many."""
        self._waiting.clear()
        self._changed.clear()
        self._room.set()

    def finish(self) -> None:
        """Do all that is left, now: the client has gone, and meant it."""
        while self._waiting:
            self._do_next()

    def _do_next(self) -> None:
        if self._waiting:
            num_commands, message = self._waiting.popleft()
            self._room.set()
            if not self._waiting:
                self._changed.clear()
            self._handle(message)
            if num_commands != self._num_handled:
                self._num_handled = num_commands
                self._handled(num_commands)


def _merged(before: Any, after: Any) -> Any:
    """One message that does what two that follow each other do; None where there is none."""
    if type(before) is not type(after):
        return None
    if isinstance(after, wire.Steer):
        return _sum(before, after)
    if isinstance(after, NEWEST_ONLY) and getattr(before, "view", None) == getattr(after, "view", None):
        return after
    return None


def _sum(a: wire.Steer, b: wire.Steer) -> wire.Steer | None:
    """As the client adds them up; None where the sum is more than one message may say."""
    summed = wire.Steer(
        a.advance_mm + b.advance_mm, a.yaw_rad + b.yaw_rad, a.pitch_rad + b.pitch_rad, a.roll_rad + b.roll_rad
    )
    turns = max(abs(summed.yaw_rad), abs(summed.pitch_rad), abs(summed.roll_rad))
    return summed if abs(summed.advance_mm) <= MAX_ADVANCE_MM and turns <= MAX_TURN_RAD else None
