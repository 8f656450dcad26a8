"""Closing of a WebSocket with a close code of the wire protocol and a readable reason."""

from __future__ import annotations

import contextlib

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from carina.server.wire import messages as wire

MAX_REASON_BYTES = 123
"""Maximum length of a close reason: a close frame has 125 bytes, two of them the code (RFC 6455, section 5.5)."""


async def close_socket(websocket: WebSocket, code: str, reason: str) -> None:
    """Close a WebSocket; do nothing if the socket is closed already.

    Parameters
    ----------
    websocket
        Socket whose connection was accepted.
    code
        Key of :data:`carina.server.wire.messages.CLOSE_CODES`. Any other code counts as ``protocol.malformed``.
    reason
        One sentence. It is truncated to :data:`MAX_REASON_BYTES` bytes of UTF-8, never inside a character.
    """
    if websocket.application_state is not WebSocketState.CONNECTED:
        return
    number = wire.CLOSE_CODES.get(code, wire.CLOSE_CODES["protocol.malformed"])
    short = reason.encode()[:MAX_REASON_BYTES].decode(errors="ignore")
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await websocket.close(number, short)
