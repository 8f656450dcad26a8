"""HTTPS server for one page in the local network, separate from the server of the workstation."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterator
from functools import partial

import uvicorn
from starlette.applications import Starlette

from carina.server.network.certificate import Certificate
from carina.server.network.connection_limits import ACCEPT_AT_ONCE, UnauthenticatedConnections
from carina.server.network.request_timeouts import timeout_protocol
from carina.server.network.shutdown import TimedShutdownServer
from carina.server.sockets.rate_limits import bounded_websocket

HANDSHAKE_WITHIN_S = 10.0
MAX_CONNECTIONS = 32
PING_EVERY_S = 5.0
GRACE_S = 1


class LanServer(TimedShutdownServer):
    """HTTPS server that limits connections, message sizes and times, because any machine of the network can connect.

    Parameters
    ----------
    app
        Application that answers the requests.
    certificate
        TLS certificate of the server.
    max_message_bytes
        Largest message of a client.
    max_bytes_per_s
        Bytes that a client may send per second, and at once; a client that sends more is disconnected.
    on_started
        Callback that is called once the server accepts connections.
    """

    def __init__(
        self,
        app: Starlette,
        certificate: Certificate,
        *,
        max_message_bytes: int,
        on_started: Callable[[], None],
        max_bytes_per_s: float = float("inf"),
    ) -> None:
        unauthenticated = UnauthenticatedConnections(MAX_CONNECTIONS - 1)
        config = uvicorn.Config(
            app,
            http=timeout_protocol(unauthenticated),
            backlog=ACCEPT_AT_ONCE,
            ssl_context_factory=lambda _config, _default: certificate.context,
            ws=bounded_websocket(max_bytes_per_s),
            ws_per_message_deflate=False,
            ws_max_size=max_message_bytes,
            ws_ping_interval=PING_EVERY_S,
            ws_ping_timeout=PING_EVERY_S,
            access_log=False,
            log_config=None,
            log_level="error",
            lifespan="off",
            server_header=False,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_graceful_shutdown=GRACE_S,
        )
        super().__init__(config, unauthenticated)
        self._on_started = on_started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to listen, with a time limit for the TLS handshake."""
        loop = asyncio.get_running_loop()
        plain = loop.create_server
        # uvicorn has no setting for this limit; a client that never completes the handshake would occupy a descriptor.
        loop.create_server = partial(plain, ssl_handshake_timeout=HANDSHAKE_WITHIN_S)  # type: ignore[method-assign]
        try:
            await super().startup(sockets=sockets)
        finally:
            loop.create_server = plain  # type: ignore[method-assign]
        self._on_started()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Install no signal handlers, because the workstation handles Ctrl-C."""
        yield
