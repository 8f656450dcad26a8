"""An encrypted WebSocket for tests that wait for their messages in turn.

The library's own client of this kind reads its connection in one thread and writes it in another, which OpenSSL does
not allow and Python 3.11 does not prevent: once in some hundred connections what the server says after the handshake
(TLS 1.3 gives tickets there) meets the request and is taken for the end. A loop reads and writes in one thread.
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
    """One connection, as :mod:`websockets.sync.client` gives it.

    Parameters
    ----------
    loop
        In which it lives, in a thread of its own.
    connection
        The library's.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, connection: ClientConnection) -> None:
        self._loop = loop
        self._connection = connection

    def send(self, message: str | bytes) -> None:
        """Send one."""
        _await(self._loop, self._connection.send(message))

    def ping(self, data: bytes, num: int) -> None:
        """Send control frames as fast as possible, without waiting for the answers.

        Raises
        ------
        ConnectionClosed
            If the other side has ended the connection.
        """
        _await(self._loop, self._ping(data, num))

    async def _ping(self, data: bytes, num: int) -> None:
        for n in range(num):
            await self._connection.ping(data + n.to_bytes(4, "big"))

    def recv(self, timeout: float | None = None) -> str | bytes:
        """The next message.

        Raises
        ------
        TimeoutError
            If there is none within ``timeout`` seconds.
        ConnectionClosed
            If none will come.
        """
        return _await(self._loop, asyncio.wait_for(self._connection.recv(), timeout))


@contextlib.contextmanager
def connected(uri: str, *, origin: str, context: ssl.SSLContext, within_s: float) -> Iterator[EncryptedSocket]:
    """A connection to ``uri`` (``wss://…``), closed at the end.

    Raises
    ------
    InvalidHandshake
        If the server refuses it.
    OSError
        If nobody listens.
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
