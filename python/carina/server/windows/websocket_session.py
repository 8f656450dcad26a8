"""WebSocket session of one browser window, from its hello message to the close of its socket."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from starlette.websockets import WebSocket, WebSocketDisconnect

import carina
from carina.errors import ProtocolError
from carina.server.sockets.close_codes import close_socket
from carina.server.sockets.rate_limits import FLOOD
from carina.server.sockets.socket_io import receive_text, start_sender
from carina.server.windows.window import Window
from carina.server.wire import messages as wire

HELLO_WITHIN_S = 20.0


async def serve_window(websocket: WebSocket, attach: Callable[[wire.ClientHello], Awaitable[Window]]) -> int | None:
    """Serve one window until its socket closes, and return the close code.

    Parameters
    ----------
    websocket
        Socket whose connection was accepted.
    attach
        Creates the server's window for a hello message, or raises ProtocolError.

    Returns
    -------
    int or None
        Close code of the socket; None if there is none, for example after a missing hello message.
    """
    window: Window | None = None
    sender: asyncio.Task[None] | None = None
    worker: asyncio.Task[None] | None = None
    try:
        async with asyncio.timeout(HELLO_WITHIN_S):
            hello = wire.parse_client_message(await receive_text(websocket, who="client"))
        if not isinstance(hello, wire.ClientHello):
            raise ProtocolError("the first message must be hello", code="protocol.order")
        if hello.wire_version != wire.WIRE_VERSION:
            msg = (
                f"this page uses protocol version {hello.wire_version} and Carina uses version "
                f"{wire.WIRE_VERSION}; reload the page"
            )
            raise ProtocolError(msg, code="protocol.version")
        window = await attach(hello)
        greeting = wire.ServerHello(
            wire.WIRE_VERSION, carina.__version__, window.watches, window.number, window.at_machine
        )
        await websocket.send_text(wire.encode_message(greeting))
        sender = start_sender(websocket, "the window", _send_all(websocket, window))
        worker = asyncio.create_task(window.inbox.run())
        while not worker.done():
            text = await receive_text(websocket, who="client")
            await window.admit()
            await window.inbox.put(wire.parse_client_message(text))
        worker.result()
    except ProtocolError as error:
        await close_socket(websocket, error.code, str(error))
        return wire.CLOSE_CODES.get(error.code)
    except TimeoutError:
        await close_socket(websocket, "protocol.order", "the client sent no hello message")
    except WebSocketDisconnect as ended:
        if window is not None and ended.code == wire.CLOSE_CODES[FLOOD]:
            window.inbox.clear()
        return ended.code
    finally:
        if worker is not None:
            worker.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await worker
        if window is not None:
            window.inbox.handle_all()
            window.leave()
        if sender is not None:
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await sender
    return None


async def _send_all(websocket: WebSocket, window: Window) -> None:
    outbox = window.outbox
    while True:
        await outbox.wait_until_filled()
        if outbox.overflowed:
            await close_socket(websocket, "protocol.slow-client", "this window could not keep up with the data")
            return
        topics, texts, pictures = outbox.take_all()
        # All topics are encoded before the first await, so that "handled" never reports a command whose result is
        # missing from the other topics.
        reported = [(topic, window.topic_text(topic)) for topic in topics]
        ended = window.end_reason
        if ended is not None:
            await close_socket(websocket, "protocol.watching-ended", ended)
            return
        for topic, text in reported:
            if text is not None and outbox.record_if_changed(topic, text):
                await websocket.send_text(window.with_original_names(text))
        for text in texts:
            await websocket.send_text(window.with_original_names(text))
        for picture in pictures:
            await websocket.send_bytes(picture)
