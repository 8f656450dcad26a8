"""HTTP protocol with request timeouts and a limit on the number of unauthenticated connections."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import h11
from starlette.datastructures import Headers
from uvicorn.protocols.http.h11_impl import H11Protocol

from carina.server.network.connection_limits import UnauthenticatedConnections

FIRST_REQUEST_WITHIN_S = 10.0
"""Maximum time in s from the connection, or from the first byte of a later request, to the end of its headers."""
BODY_WITHIN_S = 30.0
"""Maximum time in s between two parts of a request body; the time in which the server reads slowly is excluded."""


class TimeoutProtocol(H11Protocol):
    """HTTP/1.1 protocol of uvicorn with timeouts for request headers and bodies.

    Uvicorn itself has only a timeout between two requests of a connection.
    """

    unauthenticated: UnauthenticatedConnections
    """Registry of unauthenticated connections; set by :func:`timeout_protocol`."""
    authorised: Callable[[Mapping[str, str]], bool] | None = None
    """Returns whether request headers are authorised; None if the WebSocket handler authenticates its client itself.

    If None, the upgrade to a WebSocket removes the connection from the registry.
    """

    _patience: asyncio.TimerHandle | None = None
    _waits_for = ""
    _is_known = False
    _looked_at: Any = None

    def connection_made(self, transport: Any) -> None:
        """Register the connection as unauthenticated and start the timeout of its first request."""
        super().connection_made(transport)
        self.unauthenticated.register(self, transport, self._is_idle)
        self._update_timeout()

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the timeout and remove the connection from the registry."""
        self._cancel_timeout()
        self.unauthenticated.remove(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Process the bytes and set the timeout for the next part of the request."""
        super().data_received(data)
        self._update_timeout()

    def handle_events(self) -> None:
        """Handle the parsed events and check the authorisation of a new request."""
        super().handle_events()
        self._check_authorisation()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Check the authorisation, cancel the timeout and pass the connection to the WebSocket protocol."""
        self._check_authorisation()
        self._cancel_timeout()
        if self.authorised is None:
            self.unauthenticated.remove(self)
        super().handle_websocket_upgrade(event)

    def on_response_complete(self) -> None:
        """Finish the response and cancel a timeout for the request body."""
        super().on_response_complete()
        # Until the next byte, the keep-alive timeout of uvicorn applies, which closes the connection normally.
        if self._waits_for == "body":
            self._cancel_timeout()

    def _check_authorisation(self) -> None:
        """Remove the connection from the unauthenticated ones if its latest request has valid credentials."""
        if self._is_known or self.authorised is None or self.headers is None or self.headers is self._looked_at:
            return
        self._looked_at = self.headers
        if self.authorised(Headers(raw=self.headers)):
            self._is_known = True
            self.unauthenticated.remove(self)

    def _is_idle(self) -> bool:
        """Return whether the connection has no request in progress."""
        return self.cycle is None or self.cycle.response_complete

    def _update_timeout(self) -> None:
        """Start or cancel the timeout according to the state of the request: headers, body or neither."""
        if self.transport.get_protocol() is not self or self.transport.is_closing():
            self._cancel_timeout()
        elif self._is_idle():
            if self._waits_for != "request":
                self._start_timeout("request", FIRST_REQUEST_WITHIN_S)
        elif self.cycle.more_body:
            self._start_timeout("body", BODY_WITHIN_S)
        else:
            self._cancel_timeout()

    def _start_timeout(self, what: str, within_s: float) -> None:
        self._cancel_timeout()
        self._waits_for = what
        self._patience = self.loop.call_later(within_s, self._close_after_timeout)

    def _cancel_timeout(self) -> None:
        self._waits_for = ""
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _close_after_timeout(self) -> None:
        # After an upgrade the transport belongs to a WebSocket protocol, and this object gets no connection_lost(). A
        # closed TLS transport has no protocol, so is_closing() is checked first.
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            return
        if self._waits_for == "body" and (self._is_idle() or self.flow.read_paused):
            self._start_timeout("body", BODY_WITHIN_S)  # the server, not the client, causes the delay
            return
        # abort() and not close(): a TLS close waits for the answer of the peer.
        self.unauthenticated.count_closed()
        self.transport.abort()


def timeout_protocol(
    unauthenticated: UnauthenticatedConnections, authorised: Callable[[Mapping[str, str]], bool] | None = None
) -> type[TimeoutProtocol]:
    """Return the HTTP protocol class for one server.

    Parameters
    ----------
    unauthenticated
        Registry of the unauthenticated connections of this server.
    authorised
        Returns whether request headers are authorised; None if the WebSocket handler authenticates its client itself.
    """
    found = None if authorised is None else staticmethod(authorised)
    return type("ServerTimeoutProtocol", (TimeoutProtocol,), {"unauthenticated": unauthenticated, "authorised": found})
