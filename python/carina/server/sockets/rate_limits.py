"""Limits on what one client may send: messages per second, and bytes per second, checked before anything is parsed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from carina.server.wire import messages as wire

FLOOD = "protocol.flood"
FLOOD_WORDS = "this page sent too many messages and was disconnected; ask the person at the workstation for a new link"


MAX_DISCARDED_BYTES = 2 * 1024 * 1024
"""Maximum number of bytes accepted after the close frame; a client that sends more is disconnected at once."""
QUIET_S = 0.2
DISCARDS_FOR_S = 1.0
"""Time in s between the close frame and the abort of the connection; bytes received meanwhile are discarded."""


class RateLimit:
    """Token bucket that limits the sustained rate and the burst size.

    Parameters
    ----------
    per_s
        Amount that is allowed per second.
    burst
        Amount that is allowed at once.
    clock
        Monotonic clock, in seconds.
    """

    def __init__(self, per_s: float, burst: float, clock: Callable[[], float]) -> None:
        self._per_s = per_s
        self._burst = burst
        self._clock = clock
        self._left = burst
        self._filled_s = clock()

    def allow(self, amount: float = 1.0) -> bool:
        """Take an amount from the bucket, and return whether it was allowed; nothing is taken if it was not."""
        now_s = self._clock()
        self._left = min(self._burst, self._left + (now_s - self._filled_s) * self._per_s)
        self._filled_s = now_s
        if amount > self._left:
            return False
        self._left -= amount
        return True


class BoundedWebSocket(WebSocketsSansIOProtocol):
    """Uvicorn's WebSocket with a limit on the bytes that a client sends per second, control frames included.

    The library parses a whole block of up to 256 KiB, some thousand small frames, before anything else is done in the
    event loop. A client beyond the limit is disconnected before its block is parsed.
    """

    bytes_per_s = float("inf")
    """Limit of received bytes per s, set by :func:`bounded_websocket`; also the largest burst in bytes."""
    _limit: RateLimit | None = None
    _num_discarded: int | None = None
    """Number of bytes received after the close frame was sent, which are not parsed; None before."""
    _quiet: asyncio.TimerHandle | None = None

    def data_received(self, data: bytes) -> None:
        """Parse a block of received bytes, or disconnect the client if it has exceeded its limit."""
        if self._limit is None:
            self._limit = RateLimit(self.bytes_per_s, self.bytes_per_s, self.loop.time)
        if self._num_discarded is not None:
            self._num_discarded += len(data)
            if self._num_discarded > MAX_DISCARDED_BYTES:
                self.transport.abort()
            else:
                self._close_when_quiet()
        elif self._limit.allow(len(data)):
            super().data_received(data)
        elif self.close_sent or not self.handshake_complete:
            self.transport.abort()
        else:
            self._end_flood()

    def _end_flood(self) -> None:
        code = wire.CLOSE_CODES[FLOOD]
        self.stop_keepalive()
        self.queue.put_nowait({"type": "websocket.disconnect", "code": code, "reason": FLOOD_WORDS})
        self.conn.send_close(code, FLOOD_WORDS)
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        # A connection that is closed with unread bytes is reset, and the client never reads the close frame.
        self._num_discarded = 0
        self.read_paused = False
        self.transport.resume_reading()
        self.close_timer = self.loop.call_later(DISCARDS_FOR_S, self.transport.abort)
        self._close_when_quiet()

    def _close_when_quiet(self) -> None:
        if self._quiet is not None:
            self._quiet.cancel()
        self._quiet = self.loop.call_later(QUIET_S, self.transport.close)


def bounded_websocket(bytes_per_s: float) -> type[BoundedWebSocket]:
    """Return a WebSocket protocol class that limits the bytes received from each client to ``bytes_per_s``."""
    return type("Bounded", (BoundedWebSocket,), {"bytes_per_s": bytes_per_s})
