"""Connections that have not shown that they may be here: bounded in number and time, and told of once a minute.

A port of this machine can be reached by every program on it and every page in its browsers. Who holds the cookie or
the secret always finds room: others make room for each other, the longest idle first, long before the process runs out
of file descriptors.
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

__all__ = ["ACCEPT_AT_ONCE", "WAITING_IN_LINE", "Strangers", "num_strangers_allowed", "quieten"]

logger = logging.getLogger(__name__)

ACCEPT_AT_ONCE = 16
"""So many connections are taken before one of them is looked at."""
WAITING_IN_LINE = 512
"""So many more wait in the system, which costs no descriptor."""
RESERVED = 64
"""Descriptors for the person's own connections, the scan's files and uploads."""
MAX_STRANGERS = 128
LIFE_S = 60.0
"""A stranger's connection is ended after so long, whatever it does: a page is sent in seconds."""
TELL_EVERY_S = 60.0
TELL_FROM = 20
"""Fewer are no news: browsers open connections ahead and leave them."""


def num_strangers_allowed() -> int:
    """How many strangers may be connected at once, by the descriptors that are left to this process."""
    if sys.platform == "win32":
        return MAX_STRANGERS
    import resource

    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    try:
        used = len(os.listdir("/proc/self/fd"))  # noqa: PTH208, a list of numbers and no files
    except OSError:
        used = 32
    if limit == resource.RLIM_INFINITY:
        return MAX_STRANGERS
    return max(8, min(MAX_STRANGERS, limit - used - RESERVED))


@dataclass(slots=True, eq=False)
class _Stranger:
    transport: asyncio.Transport
    is_idle: Callable[[], bool]
    end_of_life: asyncio.TimerHandle


class Strangers:
    """The strangers of one server; event loop only.

    Parameters
    ----------
    max_num
        At once; by the descriptors that are left unless told.
    """

    def __init__(self, max_num: int | None = None) -> None:
        self.max_num = num_strangers_allowed() if max_num is None else max_num
        self._all: dict[object, _Stranger] = {}
        self._num_untold = 0
        self._no_descriptors = False
        self._told_s = -TELL_EVERY_S
        self._is_over = False
        self._sockets: WeakKeyDictionary[asyncio.Transport, Any] = WeakKeyDictionary()

    @property
    def num(self) -> int:
        """How many are connected."""
        self._forget_ended()
        return len(self._all)

    def arrived(self, key: object, transport: asyncio.Transport, is_idle: Callable[[], bool]) -> None:
        """One more; if there are too many, one that is idle goes, the oldest first."""
        if self._is_over:
            transport.abort()
            return
        self._sockets[transport] = transport.get_extra_info("socket")
        self._forget_ended()
        if len(self._all) >= self.max_num:
            idle = (k for k, s in self._all.items() if s.is_idle())
            self._end(next(idle, next(iter(self._all))))
        loop = asyncio.get_running_loop()
        self._all[key] = _Stranger(transport, is_idle, loop.call_later(LIFE_S, self._end, key))

    def turn_away(self) -> None:
        """The server ends: whoever comes now came too late."""
        self._is_over = True

    def cut(self, transport: asyncio.Transport) -> None:
        """End a connection, of a stranger or not, that may be closing already, without the other side's farewell.

        An encrypted transport that was closed twice, as uvicorn does, takes no word any more; its socket does.
        """
        sock = self._sockets.get(transport)
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        transport.abort()

    def left(self, key: object) -> None:
        """It has gone, or has shown that it may stay."""
        stranger = self._all.pop(key, None)
        if stranger is not None:
            stranger.end_of_life.cancel()

    def ended(self) -> None:
        """One was ended for what it did not say."""
        self._num_untold += 1
        self._tell()

    def out_of_descriptors(self) -> None:
        """The process can open nothing more: all who are idle go."""
        self._no_descriptors = True
        for key in [k for k, s in self._all.items() if s.is_idle()]:
            self._end(key)
        self._tell()

    def watch(self, loop: asyncio.AbstractEventLoop) -> None:
        """Let a loop that can accept nothing more say so here, and not with a traceback for every try."""

        def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
            if "accept() out of system resource" in str(context.get("message")):
                self.out_of_descriptors()
            else:
                loop.default_exception_handler(context)

        loop.set_exception_handler(handle)

    def _end(self, key: object) -> None:
        stranger = self._all.get(key)
        self.left(key)
        if stranger is not None and not stranger.transport.is_closing():
            # Abort: a farewell would wait for the stranger's.
            stranger.transport.abort()
            self.ended()

    def _forget_ended(self) -> None:
        for key in [k for k, s in self._all.items() if s.transport.is_closing()]:
            self.left(key)

    def _tell(self) -> None:
        now_s = asyncio.get_running_loop().time()
        if now_s - self._told_s < TELL_EVERY_S or (self._num_untold < TELL_FROM and not self._no_descriptors):
            return
        out = "; this process had run out of file descriptors" if self._no_descriptors else ""
        logger.warning("%d unidentified connections were closed%s", self._num_untold, out)
        self._told_s, self._num_untold, self._no_descriptors = now_s, 0, False


class _OnceAMinute(logging.Filter):
    """Of one kind of message, one a minute."""

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__()
        self._clock = clock
        self._told_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        kind = str(record.msg)
        now_s = self._clock()
        if now_s - self._told_s.get(kind, -TELL_EVERY_S) < TELL_EVERY_S:
            return False
        if len(self._told_s) > 100:
            self._told_s.clear()
        self._told_s[kind] = now_s
        return True


def quieten(clock: Callable[[], float]) -> Callable[[], None]:
    """What the library says of each nonsensical request is said once a minute; returns what ends this."""
    quiet = _OnceAMinute(clock)
    library = logging.getLogger("uvicorn.error")
    library.addFilter(quiet)
    return lambda: library.removeFilter(quiet)
