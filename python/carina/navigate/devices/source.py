"""Base class of device connections: a named source that passes samples to a listener until it is stopped."""

from __future__ import annotations

import errno
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from carina.navigate.samples import Sample

State = Literal["connecting", "live", "lost", "stopped"]

WORDS = {
    errno.ENOENT: "no such port; check that the device is plugged in and switched on",
    errno.EACCES: "no permission to open the port; on Linux, add your account to the dialout group",
    errno.EBUSY: "another program is using the port",
    errno.ECONNREFUSED: "no response; start the tracker's software, and check the host and port",
    errno.EHOSTUNREACH: "the machine cannot be reached; check the network and the address",
    errno.ENETUNREACH: "the machine cannot be reached; check the network and the address",
}
"""Texts for the user about error numbers of the operating system."""


@dataclass(frozen=True, slots=True)
class Listener:
    """Callbacks of a source from any thread: ``receive_sample(device, sample)`` and ``disconnected(device)``."""

    receive_sample: Callable[[str, Sample], None]
    disconnected: Callable[[str], None]


@dataclass(frozen=True, slots=True)
class SourceStatus:
    """State of a device connection, for display."""

    address: str
    title: str
    state: State
    words: str
    num_samples: int
    num_bad: dict[str, int]
    rate_hz: float


class Source(ABC):
    """Connection to a device in a thread, which reconnects after a loss.

    Parameters
    ----------
    address
        Address of the device: ``fastrak:/dev/ttyUSB0``.
    title
        Name for display.
    listener
        Callbacks for samples and for a lost connection.
    clock
        Function that returns monotonic seconds.
    """

    RETRY_S = 1.0

    def __init__(
        self, address: str, title: str, listener: Listener, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.address = address
        self.title = title
        self._listener = listener
        self._clock = clock
        self._stopping = threading.Event()
        self._state: State = "connecting"
        self._reason_text = ""
        self._num_samples = 0
        self._recent: list[float] = []
        self.num_bad: Counter[str] = Counter()
        self._thread = threading.Thread(target=self._run, name=f"carina-{address}", daemon=True)

    def start(self) -> None:
        """Start the thread that connects to the device and reads it."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the connection and wait for the end of its thread."""
        self._stopping.set()
        self._wake_connection()
        if self._thread.is_alive():
            self._thread.join()
        self._state = "stopped"

    def status(self) -> SourceStatus:
        """Return the state of the connection to the device."""
        recent = tuple(self._recent)
        now = self._clock()
        lively = [at for at in recent if now - at < 1.0]
        return SourceStatus(
            self.address,
            self.title,
            self._state,
            self._reason_text,
            self._num_samples,
            dict(self.num_bad),
            float(len(lively)),
        )

    @abstractmethod
    def _connect_and_read(self) -> None:
        """Connect to the device and read until the connection is lost; then raise OSError or ProtocolError."""

    def _wake_connection(self) -> None:  # noqa: B027 - most sources need none
        """Wake a waiting connection so that it checks ``_stopping``."""

    def _publish_sample(self, device: str, sample: Sample) -> None:
        self._num_samples += 1
        self._recent = [*self._recent[-255:], self._clock()]
        self._listener.receive_sample(device, sample)

    def _set_live(self, words: str = "") -> None:
        self._state, self._reason_text = "live", words

    def _run(self) -> None:
        from carina.errors import CarinaError

        while not self._stopping.is_set():
            self._state = "connecting"
            try:
                self._connect_and_read()
                words = "the connection was closed"
            except (OSError, CarinaError) as error:
                words = _reason_text(error)
            except Exception as error:
                # After a programming error or an invalid name the source continues and shows the error in its state.
                words = f"{type(error).__name__}: {error}"
            if self._stopping.is_set():
                break
            self._state, self._reason_text = "lost", words
            self._listener.disconnected(self.address)
            self._stopping.wait(self.RETRY_S)


def _reason_text(trouble: Exception) -> str:
    """Return the reason of a lost connection, as text for the user."""
    if isinstance(trouble, socket.gaierror):
        return "no machine with this name was found; check the name"
    number = trouble.errno if isinstance(trouble, OSError) else None
    return WORDS.get(number or 0) or str(trouble) or "no response in time"


class StampSpreader:
    """Generator of times for records that have no time: records that arrive together are spaced by one period."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._last_s = float("-inf")

    def stamps(self, number: int, now_s: float) -> list[float]:
        """Return increasing times in seconds for records that arrived together; the last time is at least ``now_s``."""
        found = []
        for n in range(number):
            at = now_s - (number - 1 - n) * self._period_s
            # At least half a period after the last record: serial ports deliver records in bursts.
            at = max(at, self._last_s + 0.5 * self._period_s)
            self._last_s = at
            found.append(at)
        return found
