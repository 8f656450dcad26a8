"""Simulated serial devices: a pseudo-terminal that sends records, fails or is unplugged."""

from __future__ import annotations

import contextlib
import os
import pty
import threading
import time
import tty
from collections.abc import Callable, Iterator

__all__ = ["PseudoPort", "wait_for"]


class PseudoPort:
    """Both ends of a pseudo-terminal; ``path`` is the name of the serial port."""

    def __init__(self) -> None:
        self.master, self._slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)

    def send(self, data: bytes) -> None:
        os.write(self.master, data)

    def received(self) -> bytes:
        """Return the bytes that the host program has sent to the device so far."""
        os.set_blocking(self.master, False)
        with contextlib.suppress(BlockingIOError, OSError):
            return os.read(self.master, 4096)
        return b""

    def unplug(self) -> None:
        """Close the device's end of the pseudo-terminal, so that reads of the host program fail."""
        for end in (self.master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)


@contextlib.contextmanager
def sending(records: Callable[[int], bytes], port: PseudoPort, *, rate_hz: float = 120.0) -> Iterator[None]:
    """Send ``records(n)`` for n = 0, 1, ... at ``rate_hz`` until the block ends."""
    ended = threading.Event()

    def run() -> None:
        began, n = time.monotonic(), 0
        while not ended.wait(max(0.0, began + n / rate_hz - time.monotonic())):
            with contextlib.suppress(OSError):
                port.send(records(n))
            n += 1

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


WAIT_S = 120.0
"""Upper limit of every wait, in seconds, so that a hanging test fails."""


def wait_for(what: Callable[[], object], seconds: float = WAIT_S) -> object:
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "the condition was not met in time"
        threading.Event().wait(0.005)
    return found
