"""HTTP for strangers: a connection that asks for nothing is ended, since there is a limit to how many are open."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

__all__ = ["ImpatientProtocol"]

FIRST_REQUEST_WITHIN_S = 10.0


class ImpatientProtocol(H11Protocol):
    """Uvicorn's, which waits for a first request for ever; between later ones it has a limit of its own."""

    _patience: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._patience = self.loop.call_later(FIRST_REQUEST_WITHIN_S, self._end_if_silent)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._patience is not None:
            self._patience.cancel()
        super().connection_lost(exc)

    def _end_if_silent(self) -> None:
        # A WebSocket has another protocol by then, of whose end this one is not told: of what is closed an encrypted
        # transport does not know the protocol any more. Abort: a farewell would wait for the stranger's.
        if self.cycle is None and not self.transport.is_closing() and self.transport.get_protocol() is self:
            self.transport.abort()
