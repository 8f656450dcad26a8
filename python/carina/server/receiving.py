"""What comes on a WebSocket of the wire: text, one message at a time."""

from __future__ import annotations

from starlette.websockets import WebSocket, WebSocketDisconnect

from carina.errors import ProtocolError

__all__ = ["receive_text"]


async def receive_text(websocket: WebSocket, *, who: str) -> str:
    """The next text of the other side, which ``who`` names; raises where it is gone, or sends anything else."""
    message = await websocket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1006), message.get("reason"))
    text = message.get("text")
    if text is None:
        raise ProtocolError(f"the {who} sent a binary message; only text messages are accepted", code="protocol.type")
    return str(text)
