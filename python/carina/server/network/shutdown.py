"""Shutdown of the HTTP server within its grace period, without error messages if no data were lost."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from typing import Any

import uvicorn

from carina.server.network.connection_limits import UnauthenticatedConnections

CLOSE_TIMEOUT_S = 0.5
"""Seconds that a client has to read the remaining data and finish the closing handshake of a closed connection."""
POLL_INTERVAL_S = 0.02


class TimedShutdownServer(uvicorn.Server):
    """Uvicorn server that aborts connections whose client does not finish the closing handshake in time.

    A busy or suspended browser can delay the closing handshake by half a minute. Uvicorn would wait for its grace
    period and then log an error. This class aborts such a connection :data:`CLOSE_TIMEOUT_S` seconds after it was
    closed. Requests that are still being answered have the full grace period.

    Parameters
    ----------
    config
        Configuration of uvicorn; ``timeout_graceful_shutdown`` is the grace period in seconds.
    unauthenticated
        Unauthenticated connections of this server; new ones are aborted during the shutdown.
    """

    def __init__(self, config: uvicorn.Config, unauthenticated: UnauthenticatedConnections) -> None:
        super().__init__(config)
        self._unauthenticated = unauthenticated

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Install the handler for failed ``accept`` calls and open the listening sockets."""
        self._unauthenticated.watch(asyncio.get_running_loop())
        await super().startup(sockets=sockets)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close all connections and shut the application down, also after a second interrupt."""
        servers, self.servers = self.servers, []
        for server in servers:
            server.close()
        # A connection may be accepted, or in its TLS handshake, and not yet be registered with the server.
        self._unauthenticated.refuse_new()
        await self._end_connections()
        # From Python 3.12 on, wait_closed() of a listener waits for every TLS handshake that the listener began.
        for server in servers:
            with contextlib.suppress(AttributeError):
                server.abort_clients()  # type: ignore[attr-defined]
        await super().shutdown(sockets=sockets)
        if self.force_exit:
            # After a second interrupt, uvicorn would cancel the application instead, with a traceback.
            await self.lifespan.shutdown()

    async def _end_connections(self) -> None:
        """Request every connection to close, and abort those that only wait for their client."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + (self.config.timeout_graceful_shutdown or 0)
        requested: set[Any] = set()
        closing_since: dict[Any, float] = {}
        while self.server_state.connections and not self.force_exit:
            now_s = loop.time()
            for connection in list(self.server_state.connections):
                transport = connection.transport
                if connection not in requested and not transport.is_closing():
                    # After an upgrade to WebSocket the connection is a new object: it must be shut down as well.
                    requested.add(connection)
                    connection.shutdown()
                if not transport.is_closing():
                    # The server is still sending a response on this connection: abort it only after the grace period.
                    if now_s >= end_s:
                        self._unauthenticated.abort(transport)
                elif now_s - closing_since.setdefault(connection, now_s) >= CLOSE_TIMEOUT_S:
                    self._unauthenticated.abort(transport)
            await asyncio.sleep(POLL_INTERVAL_S)
