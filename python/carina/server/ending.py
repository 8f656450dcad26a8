"""How a server ends: within its grace, whatever the other sides do, and without a word where nothing was lost."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from typing import Any

import uvicorn

from carina.server.strangers import Strangers

__all__ = ["FAREWELL_S", "EndingServer"]

FAREWELL_S = 0.5
"""How long the other side of a connection that we have closed may take to read what is on its way and say farewell."""
LOOK_EVERY_S = 0.02


class EndingServer(uvicorn.Server):
    """Uvicorn's, which asks its connections to close and then waits for the other sides.

    An encrypted connection is closed when the other side has said farewell too, any connection when what was sent has
    been read; a browser that is busy, or asleep, does neither for half a minute. The library waits for its grace and
    reports an error in which nothing is wrong. Here such a connection is cut: we have said all we had to say. What
    stays the library's is to wait for answers that are being made.

    Parameters
    ----------
    config
        The library's; ``timeout_graceful_shutdown`` is the grace.
    strangers
        Of this server: who comes while it ends is turned away.
    """

    def __init__(self, config: uvicorn.Config, strangers: Strangers) -> None:
        super().__init__(config)
        self._strangers = strangers

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen."""
        self._strangers.watch(asyncio.get_running_loop())
        await super().startup(sockets=sockets)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the connections and the application, also after a second interrupt."""
        servers, self.servers = self.servers, []
        for server in servers:
            server.close()
        # A connection may have been taken, or its encryption be under way, and nobody have been told of it yet.
        self._strangers.turn_away()
        await self._end_connections()
        # From 3.12 on a closed listener is waited for until the last handshake that it began has ended.
        for server in servers:
            with contextlib.suppress(AttributeError):
                server.abort_clients()  # type: ignore[attr-defined]
        await super().shutdown(sockets=sockets)
        if self.force_exit:
            # After a second interrupt, uvicorn would cancel the application instead, with a traceback.
            await self.lifespan.shutdown()

    async def _end_connections(self) -> None:
        """Ask all to close, and cut off those that wait for nothing but the other side."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + (self.config.timeout_graceful_shutdown or 0)
        asked: set[Any] = set()
        closing_since: dict[Any, float] = {}
        while self.server_state.connections and not self.force_exit:
            now_s = loop.time()
            for connection in list(self.server_state.connections):
                transport = connection.transport
                if connection not in asked and not transport.is_closing():
                    # Also who was an HTTP request before and is a WebSocket now.
                    asked.add(connection)
                    connection.shutdown()
                if not transport.is_closing():
                    # Being answered. After the grace it is cut, and what answers notices.
                    if now_s >= end_s:
                        self._strangers.cut(transport)
                elif now_s - closing_since.setdefault(connection, now_s) >= FAREWELL_S:
                    self._strangers.cut(transport)
            await asyncio.sleep(LOOK_EVERY_S)
