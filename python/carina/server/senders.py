"""Tasks that send on a socket beside the one that reads it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Coroutine

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from carina.session.jobs import log_fault

__all__ = ["start_sender"]

logger = logging.getLogger(__name__)

INTERNAL_ERROR = 1011
"""RFC 6455, 7.4.1; who gets it may come back."""


def start_sender(websocket: WebSocket, who: str, sending: Coroutine[None, None, None]) -> asyncio.Task[None]:
    """A task that sends until it is cancelled or the other side is gone; it raises nothing but its cancelling.

    A fault of ours ends the connection: else the other side would wait for ever, with an old picture or force.

    Parameters
    ----------
    who
        The other side, for the log.
    """

    async def send() -> None:
        try:
            await sending
        except WebSocketDisconnect:
            pass
        except Exception as trouble:
            if websocket.application_state is not WebSocketState.CONNECTED:
                return  # closed from elsewhere, which sending does not take
            log_fault(logger, f"sending to {who} failed; its connection is closed", trouble)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close(INTERNAL_ERROR, "this connection failed: internal error in Carina")

    return asyncio.create_task(send())
