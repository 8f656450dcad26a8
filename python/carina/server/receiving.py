"""Receiving of text messages from a WebSocket."""

from __future__ import annotations

from starlette.websockets import WebSocket, WebSocketDisconnect

from carina.errors import ProtocolError

__all__ = ["receive_text"]


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
