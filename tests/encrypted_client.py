"""Encrypted WebSocket client for tests, which reads and writes in one event loop.

The synchronous client of the ``websockets`` library reads in one thread and writes in another. OpenSSL does not allow
both at once, and Python 3.11 does not prevent it. In about one of a hundred connections a TLS 1.3 session ticket, which
the server sends after the handshake, collides with the request, and the client reports the end of the connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import threading
from collections.abc import Coroutine, Iterator
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

__all__ = ["EncryptedSocket", "connected"]


class EncryptedSocket:
    """One encrypted connection, with the methods of :mod:`websockets.sync.client`.

    Parameters
    ----------
    loop
        Event loop of the connection, which runs in a separate thread.
    connection
        Asynchronous connection of the library.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, connection: ClientConnection) -> None:
        self._loop = loop
        self._connection = connection

    def send(self, message: str | bytes) -> None:
        """Send one message over the connection."""
        _await(self._loop, self._connection.send(message))

    def ping(self, data: bytes, num: int) -> None:
        """Send ``num`` control frames as fast as possible, without waiting for the answers."""
        _await(self._loop, self._ping(data, num))

    async def _ping(self, data: bytes, num: int) -> None:
        for n in range(num):
            await self._connection.ping(data + n.to_bytes(4, "big"))

    def recv(self, timeout: float | None = None) -> str | bytes:
        """Return the next message that arrives on the connection.

        Raises
        ------
        TimeoutError
            If no message arrives within ``timeout`` seconds.
        ConnectionClosed
            If the connection is closed.
        """
        return _await(self._loop, asyncio.wait_for(self._connection.recv(), timeout))


@contextlib.contextmanager
def connected(uri: str, *, origin: str, context: ssl.SSLContext, within_s: float) -> Iterator[EncryptedSocket]:
    """Connect to ``uri`` (``wss://…``) and close the connection at the end of the block.

    Raises
    ------
    InvalidHandshake
        If the server refuses the connection.
    OSError
        If no server listens.
    """
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="encrypted client")
    thread.start()
    try:
        connection = _await(loop, _connect(uri, origin, context, within_s))
        try:
            yield EncryptedSocket(loop, connection)
        finally:
            _await(loop, connection.close())
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _connect(uri: str, origin: str, context: ssl.SSLContext, within_s: float) -> ClientConnection:
    return await connect(uri, origin=origin, ssl=context, compression=None, open_timeout=within_s)


def _await(loop: asyncio.AbstractEventLoop, what: Coroutine[Any, Any, Any]) -> Any:
    return asyncio.run_coroutine_threadsafe(what, loop).result()
