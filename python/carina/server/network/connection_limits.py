"""Limits on the number and lifetime of unauthenticated connections, with at most one log line a minute.

Every program on this machine, and every page in its browsers, can connect to the port. Connections with the cookie or
the secret are not limited. At the limit, a new unauthenticated connection replaces the oldest idle one, so that the
process keeps free file descriptors.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

logger = logging.getLogger(__name__)

ACCEPT_AT_ONCE = 16
"""Maximum number of connections that the server accepts before it handles the first of them."""
WAITING_IN_LINE = 512
"""Backlog of the listening socket: connections that wait in the operating system and use no file descriptor."""
RESERVED = 64
"""File descriptors reserved for authenticated connections, the files of the scan and uploads."""
MAX_UNAUTHENTICATED = 128
LIFE_S = 60.0
"""Maximum lifetime in seconds of an unauthenticated connection; sending a page takes only seconds."""
LOG_EVERY_S = 60.0
LOG_FROM = 20
"""Minimum number of closed connections for a log line; browsers open spare connections that they never use."""


def unauthenticated_limit() -> int:
    """Return the limit of simultaneous unauthenticated connections, from the free file descriptors of the process."""
    if sys.platform == "win32":
        return MAX_UNAUTHENTICATED
    import resource

    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    try:
        used = len(os.listdir("/proc/self/fd"))  # noqa: PTH208, a list of numbers and no files
    except OSError:
        used = 32
    if limit == resource.RLIM_INFINITY:
        return MAX_UNAUTHENTICATED
    return max(8, min(MAX_UNAUTHENTICATED, limit - used - RESERVED))


@dataclass(slots=True, eq=False)
class _UnauthenticatedConnection:
    transport: asyncio.Transport
    is_idle: Callable[[], bool]
    end_of_life: asyncio.TimerHandle


class UnauthenticatedConnections:
    """Registry and limit of the unauthenticated connections of one server; used from the event loop only.

    Parameters
    ----------
    max_num
        Maximum number of simultaneous connections; if None, :func:`unauthenticated_limit` computes it.
    """

    def __init__(self, max_num: int | None = None) -> None:
        self.max_num = unauthenticated_limit() if max_num is None else max_num
        self._all: dict[object, _UnauthenticatedConnection] = {}
        self._num_unlogged = 0
        self._no_descriptors = False
        self._last_log_s = -LOG_EVERY_S
        self._is_over = False
        self._sockets: WeakKeyDictionary[asyncio.Transport, Any] = WeakKeyDictionary()

    @property
    def num(self) -> int:
        """Number of connections that are open and not authenticated yet."""
        self._drop_old_counts()
        return len(self._all)

    def register(self, key: object, transport: asyncio.Transport, is_idle: Callable[[], bool]) -> None:
        """Register a new connection; at the limit, close the oldest idle connection first.

        If no connection is idle, the oldest connection is closed. After :meth:`refuse_new` the new connection itself is
        aborted.

        Parameters
        ----------
        key
            Identifies the connection in :meth:`remove`.
        transport
            Transport of the connection.
        is_idle
            Returns whether the connection is idle now.
        """
        if self._is_over:
            transport.abort()
            return
        self._sockets[transport] = transport.get_extra_info("socket")
        self._drop_old_counts()
        if len(self._all) >= self.max_num:
            idle = (k for k, s in self._all.items() if s.is_idle())
            self._close_connection(next(idle, next(iter(self._all))))
        loop = asyncio.get_running_loop()
        self._all[key] = _UnauthenticatedConnection(
            transport, is_idle, loop.call_later(LIFE_S, self._close_connection, key)
        )

    def refuse_new(self) -> None:
        """Abort every connection that arrives after this call, because the server shuts down."""
        self._is_over = True

    def abort(self, transport: asyncio.Transport) -> None:
        """Abort any connection, authenticated or not, without waiting for the closing handshake of the peer.

        The connection may be closing already. The socket is shut down too, because uvicorn closes a TLS transport
        twice, and such a transport ignores ``abort``.
        """
        sock = self._sockets.get(transport)
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        transport.abort()

    def remove(self, key: object) -> None:
        """Remove a connection that was closed or has authenticated itself; an unknown key is ignored."""
        connection = self._all.pop(key, None)
        if connection is not None:
            connection.end_of_life.cancel()

    def count_closed(self) -> None:
        """Count an unauthenticated connection that the server closed, and write a log line if one is due."""
        self._num_unlogged += 1
        self._log_counts()

    def close_idle(self) -> None:
        """Close all idle unauthenticated connections, because the process has no free file descriptor."""
        self._no_descriptors = True
        for key in [k for k, s in self._all.items() if s.is_idle()]:
            self._close_connection(key)
        self._log_counts()

    def watch(self, loop: asyncio.AbstractEventLoop) -> None:
        """Set an exception handler on the loop that calls :meth:`close_idle` if ``accept`` fails.

        Without the handler, asyncio logs a traceback for every failed ``accept``.
        """

        def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
            if "accept() out of system resource" in str(context.get("message")):
                self.close_idle()
            else:
                loop.default_exception_handler(context)

        loop.set_exception_handler(handle)

    def _close_connection(self, key: object) -> None:
        connection = self._all.get(key)
        self.remove(key)
        if connection is not None and not connection.transport.is_closing():
            # abort() and not close(): a TLS close waits for the answer of the peer.
            connection.transport.abort()
            self.count_closed()

    def _drop_old_counts(self) -> None:
        for key in [k for k, s in self._all.items() if s.transport.is_closing()]:
            self.remove(key)

    def _log_counts(self) -> None:
        now_s = asyncio.get_running_loop().time()
        if now_s - self._last_log_s < LOG_EVERY_S or (self._num_unlogged < LOG_FROM and not self._no_descriptors):
            return
        out = "; this process had run out of file descriptors" if self._no_descriptors else ""
        logger.warning("%d unidentified connections were closed%s", self._num_unlogged, out)
        self._last_log_s, self._num_unlogged, self._no_descriptors = now_s, 0, False


class _MinuteLogFilter(logging.Filter):
    """Log filter that passes each message template at most once a minute."""

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__()
        self._clock = clock
        self._last_log_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        kind = str(record.msg)
        now_s = self._clock()
        if now_s - self._last_log_s.get(kind, -LOG_EVERY_S) < LOG_EVERY_S:
            return False
        if len(self._last_log_s) > 100:
            self._last_log_s.clear()
        self._last_log_s[kind] = now_s
        return True


def limit_log_rate(clock: Callable[[], float]) -> Callable[[], None]:
    """Limit each message of uvicorn's error log to one a minute, and return a function that removes the limit."""
    quiet = _MinuteLogFilter(clock)
    library = logging.getLogger("uvicorn.error")
    library.addFilter(quiet)
    return lambda: library.removeFilter(quiet)
