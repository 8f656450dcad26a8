"""How a WebSocket is ended: with a code of the wire and one sentence that a person can read."""

from __future__ import annotations

import contextlib

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from carina.server import messages as wire

__all__ = ["MAX_REASON_BYTES", "close_socket"]

MAX_REASON_BYTES = 123
"""A close frame holds 125 bytes, two of them the code (RFC 6455, section 5.5)."""


async def close_socket(websocket: WebSocket, code: str, reason: str) -> None:
    """End a socket; nothing where it has ended already.

    Parameters
    ----------
    websocket
        Accepted.
    code
        Of :data:`carina.server.messages.CLOSE_CODES`. Any other, such as that of an error which ends no socket, counts
        as ``protocol.malformed``.
    reason
        A sentence. What does not fit into a close frame is cut off, never in the middle of a character.
    """
    if websocket.application_state is not WebSocketState.CONNECTED:
        return
    number = wire.CLOSE_CODES.get(code, wire.CLOSE_CODES["protocol.malformed"])
    short = reason.encode()[:MAX_REASON_BYTES].decode(errors="ignore")
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await websocket.close(number, short)
