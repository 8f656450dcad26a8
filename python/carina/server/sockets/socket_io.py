"""Reading and sending on a WebSocket: text messages in, and a task that sends beside the reader."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Coroutine

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from carina.errors import ProtocolError
from carina.session.jobs.background_jobs import log_fault

logger = logging.getLogger(__name__)


async def receive_text(websocket: WebSocket, *, who: str) -> str:
    """Return the next text message of a WebSocket.

    Parameters
    ----------
    websocket
        The connection.
    who
        Name of the client in the error message.

    Raises
    ------
    WebSocketDisconnect
        If the client has closed the connection.
    ProtocolError
        With code ``protocol.type`` if the client sent a binary message.
    """
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1006), message.get("reason"))
    text = message.get("text")
    if text is None:
        raise ProtocolError(f"the {who} sent a binary message; only text messages are accepted", code="protocol.type")
    return str(text)


INTERNAL_ERROR = 1011
"""WebSocket close code for an internal error (RFC 6455, 7.4.1); the client may connect again."""


def start_sender(websocket: WebSocket, who: str, sending: Coroutine[None, None, None]) -> asyncio.Task[None]:
    """Start a task that runs ``sending`` until it is cancelled or the client disconnects, and return the task.

    The task raises only ``CancelledError``. An internal error closes the connection; otherwise the client would wait
    without end and show an old frame or apply an old force.

    Parameters
    ----------
    websocket
        The connection on which ``sending`` sends.
    who
        Name of the client, for the log.
    sending
        Coroutine that sends the messages.
    """

    async def send() -> None:
        try:
            await sending
        except WebSocketDisconnect:
            pass
        except Exception as error:
            if websocket.application_state is not WebSocketState.CONNECTED:
                return  # another task closed the connection, so sending failed
            log_fault(logger, f"sending to {who} failed; its connection is closed", error)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):
                await websocket.close(INTERNAL_ERROR, "this connection failed: internal error in Carina")

    return asyncio.create_task(send())
