"""HTTP for strangers: a connection that asks for nothing, or never to the end, is ended; their number is limited."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import h11
from starlette.datastructures import Headers
from uvicorn.protocols.http.h11_impl import H11Protocol

from carina.server.strangers import Strangers

__all__ = ["ImpatientProtocol", "impatient"]

FIRST_REQUEST_WITHIN_S = 10.0
"""From the connection, or from the first byte of a later request, to the last byte of its headers."""
BODY_WITHIN_S = 30.0
"""Between two parts of a body, while it is read as fast as it comes."""


class ImpatientProtocol(H11Protocol):
    """Uvicorn's, which waits for a request for ever; only between two of them it has a limit of its own."""

    strangers: Strangers
    """Set by :func:`impatient`."""
    authorised: Callable[[Mapping[str, str]], bool] | None = None
    """Whether a request shows that it may; None where an upgrade to a WebSocket ends what is watched here."""

    _patience: asyncio.TimerHandle | None = None
    _waits_for = ""
    _is_known = False
    _looked_at: Any = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.strangers.arrived(self, transport, self._is_idle)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        self.strangers.left(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._wait()

    def handle_events(self) -> None:
        super().handle_events()
        self._look()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._look()
        self._stop_waiting()
        if self.authorised is None:
            self.strangers.left(self)
        super().handle_websocket_upgrade(event)

    def on_response_complete(self) -> None:
        super().on_response_complete()
        # Until the next byte comes the library's own limit counts, which says farewell.
        if self._waits_for == "body":
            self._stop_waiting()

    def _look(self) -> None:
        """Whether the newest request shows that whoever sent it may be here."""
        if self._is_known or self.authorised is None or self.headers is None or self.headers is self._looked_at:
            return
        self._looked_at = self.headers
        if self.authorised(Headers(raw=self.headers)):
            self._is_known = True
            self.strangers.left(self)

    def _is_idle(self) -> bool:
        """Nothing is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def _wait(self) -> None:
        """What is waited for now: the end of a request's headers since they began, the next part of a body, nothing."""
        if self.transport.get_protocol() is not self or self.transport.is_closing():
            self._stop_waiting()
        elif self._is_idle():
            if self._waits_for != "request":
                self._wait_for("request", FIRST_REQUEST_WITHIN_S)
        elif self.cycle.more_body:
            self._wait_for("body", BODY_WITHIN_S)
        else:
            self._stop_waiting()

    def _wait_for(self, what: str, within_s: float) -> None:
        self._stop_waiting()
        self._waits_for = what
        self._patience = self.loop.call_later(within_s, self._end)

    def _stop_waiting(self) -> None:
        self._waits_for = ""
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def _end(self) -> None:
        # A WebSocket has another protocol by then, of whose end this one is not told: of what is closed an encrypted
        # transport does not know the protocol any more.
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            return
        if self._waits_for == "body" and (self._is_idle() or self.flow.read_paused):
            self._wait_for("body", BODY_WITHIN_S)  # it is we who are slow
            return
        # Abort: a farewell would wait for the stranger's.
        self.strangers.ended()
        self.transport.abort()


def impatient(
    strangers: Strangers, authorised: Callable[[Mapping[str, str]], bool] | None = None
) -> type[ImpatientProtocol]:
    """The protocol of one server.

    Parameters
    ----------
    strangers
        Those of this server.
    authorised
        Whether a request's headers show that it may; None where the WebSocket finds that out by itself.
    """
    found = None if authorised is None else staticmethod(authorised)
    return type("Impatient", (ImpatientProtocol,), {"strangers": strangers, "authorised": found})
