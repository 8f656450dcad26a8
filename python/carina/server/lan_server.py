"""An encrypted server for one page that the local network reaches, beside the workstation's own."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Iterator
from functools import partial

import uvicorn
from starlette.applications import Starlette

from carina.server.certificate import Certificate
from carina.server.ending import EndingServer
from carina.server.impatient import impatient
from carina.server.message_limits import bounded_websocket
from carina.server.strangers import ACCEPT_AT_ONCE, Strangers

__all__ = ["LanServer"]

HANDSHAKE_WITHIN_S = 10.0
MAX_CONNECTIONS = 32
PING_EVERY_S = 5.0
GRACE_S = 1


class LanServer(EndingServer):
    """Bounded in connections, message sizes and time: anybody of the network may knock.

    Parameters
    ----------
    app
        What it answers.
    certificate
        What it shows.
    max_message_bytes
        Largest message of a client.
    max_bytes_per_s
        Bytes that a client may send per second, and at once; a client that sends more is disconnected.
    on_started
        Told once it answers.
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
        strangers = Strangers(MAX_CONNECTIONS - 1)
        config = uvicorn.Config(
            app,
            http=impatient(strangers),
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
        super().__init__(config, strangers)
        self._told_started = on_started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen."""
        loop = asyncio.get_running_loop()
        plain = loop.create_server
        # The library has no setting for it: a stranger who never ends the handshake holds a descriptor.
        loop.create_server = partial(plain, ssl_handshake_timeout=HANDSHAKE_WITHIN_S)  # type: ignore[method-assign]
        try:
            await super().startup(sockets=sockets)
        finally:
            loop.create_server = plain  # type: ignore[method-assign]
        self._told_started()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """None: Ctrl-C is the workstation's."""
        yield
