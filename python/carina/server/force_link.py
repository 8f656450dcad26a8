"""Bridges to force devices over the WebSocket ``/force``: the wall near a place as a plane, 100 times a second.

For bridges that cannot ask 1,000 times a second (``docs/haptics.md``). Each has a socket beside the window's.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

import carina
from carina.commands import WallNear
from carina.errors import CarinaError, ProtocolError
from carina.scopes import LeftThread
from carina.server import messages as wire
from carina.server.closing import close_socket
from carina.server.senders import start_sender
from carina.session import Session

__all__ = ["MAX_BRIDGES", "ForceLink"]

MAX_BRIDGES = 4
HELLO_WITHIN_S = 20.0
BETWEEN_S = 0.001
"""Answers are at least so far apart; of questions that come faster only the newest is answered."""


class ForceLink:
    """Answers bridges. While one is connected, the renderer leaves a thread to it.

    Parameters
    ----------
    session
        Whose wall it is.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._num_bridges = 0

    async def serve(self, socket: WebSocket) -> None:
        """One bridge, from its hello to its end; the socket is accepted and authorised."""
        if self._num_bridges >= MAX_BRIDGES:
            await close_socket(socket, "protocol.order", f"at most {MAX_BRIDGES} bridges are served at once")
            return
        self._num_bridges += 1
        left = LeftThread()
        try:
            await self._converse(socket)
        except ProtocolError as trouble:
            await close_socket(socket, trouble.code, str(trouble))
        except TimeoutError:
            await close_socket(socket, "protocol.order", "no hello came")
        except WebSocketDisconnect:
            pass
        finally:
            left.release()
            self._num_bridges -= 1

    async def _converse(self, socket: WebSocket) -> None:
        async with asyncio.timeout(HELLO_WITHIN_S):
            hello = await _receive(socket)
        if not isinstance(hello, wire.ClientHello):
            raise ProtocolError("the first message must be hello", code="protocol.order")
        if hello.wire_version != wire.FORCE_VERSION:
            words = f"this bridge speaks version {hello.wire_version} and Carina version {wire.FORCE_VERSION}"
            raise ProtocolError(words, code="protocol.version")
        await socket.send_text(wire.encode_message(wire.ServerHello(wire.FORCE_VERSION, carina.__version__)))
        # A bridge that comes back may ask again for a wall whose measuring was stopped.
        self._session.devices.want_wall_again()
        asked: asyncio.Queue[wire.AskContact] = asyncio.Queue(maxsize=1)
        answering = start_sender(socket, "a bridge", self._answer(socket, asked))
        try:
            while True:
                message = await _receive(socket)
                if not isinstance(message, wire.AskContact):
                    raise ProtocolError("a bridge asks for contact, and says hello once", code="protocol.order")
                if asked.full():
                    asked.get_nowait()
                asked.put_nowait(message)
        finally:
            answering.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await answering

    async def _answer(self, socket: WebSocket, asked: asyncio.Queue[wire.AskContact]) -> None:
        while True:
            question = await asked.get()
            await socket.send_text(wire.encode_message(self._contact(question)))
            await asyncio.sleep(BETWEEN_S)

    def _contact(self, question: wire.AskContact) -> wire.LocalContact:
        try:
            found = self._session.ask(WallNear(question.lps))
        except CarinaError:
            # A bridge cannot read words: it lets go.
            return wire.LocalContact(question.number, "none", None, None)
        plane = found.plane
        return wire.LocalContact(
            question.number,
            found.state,
            found.lps,
            None
            if plane is None
            else wire.ForcePlane(
                plane.point_lps,
                plane.normal_lps,
                plane.stiffness_n_per_mm,
                plane.damping_ns_per_mm,
                plane.friction,
                plane.valid_mm,
            ),
        )


async def _receive(socket: WebSocket) -> Any:
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1006), message.get("reason"))
    text = message.get("text")
    if text is None:
        raise ProtocolError("a bridge sends text, no binary messages", code="protocol.type")
    return wire.parse_force_message(text)


def _three(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
