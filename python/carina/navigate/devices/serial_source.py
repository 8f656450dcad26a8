"""Devices at a serial port, with pyserial (extra ``devices``)."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from carina.errors import CarinaError
from carina.installation import extra_command
from carina.navigate.devices.fastrak import RATE_HZ, FastrakStream, setup_commands
from carina.navigate.devices.scope_handle import HandleStream
from carina.navigate.devices.source import Listener, Source, StampSpreader
from carina.navigate.samples import PoseSample

BAUD = 115_200
# Timeout of a read in seconds; after a read without data the setup commands are sent again.
READ_S = 0.05
SILENT_S = 2.0


def _pyserial() -> Any:
    try:
        import serial
    except ImportError:
        raise CarinaError(
            f"serial devices need pyserial, which is not installed; install it with: {extra_command('devices')}",
            code="devices.extra",
        ) from None
    return serial


def serial_ports() -> list[dict[str, str]]:
    """Return the serial ports of this machine as ``{"port", "title"}``.

    Raises
    ------
    CarinaError
        ``devices.extra`` without pyserial.
    """
    _pyserial()
    from serial.tools import list_ports

    return [{"port": str(port.device), "title": str(port.description or "")} for port in list_ports.comports()]


def found_ports() -> tuple[list[dict[str, str]], str | None]:
    """Return :func:`serial_ports` and None, or an empty list and the error text if the ports cannot be listed."""
    try:
        return serial_ports(), None
    except CarinaError as error:
        return [], str(error)


class _SerialSource(Source):
    """Connection that reads a device at a serial port and opens the port again after it was lost."""

    def __init__(
        self,
        address: str,
        title: str,
        listener: Listener,
        *,
        port: str,
        baud: int = BAUD,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(address, title, listener, clock=clock)
        self._port_name = port
        self._baud = baud

    def _connect_and_read(self) -> None:
        serial = _pyserial()
        with serial.Serial(self._port_name, self._baud, timeout=READ_S, write_timeout=1.0) as port:
            port.write(self._setup_bytes())
            self._reset_stream()
            heard_s = self._clock()
            while not self._stopping.is_set():
                # Read all available bytes, else wait for one byte, so that no sample waits for a full buffer.
                data = port.read(port.in_waiting or 1)
                if data:
                    heard_s = self._clock()
                    self._handle_bytes(data)
                elif self._clock() - heard_s > SILENT_S:
                    self._words = "the port is open, but no data is arriving"
                    port.write(self._setup_bytes())
                    heard_s = self._clock()
            port.write(self._stop_bytes())

    def _setup_bytes(self) -> bytes:
        raise NotImplementedError

    def _stop_bytes(self) -> bytes:
        return b""

    def _reset_stream(self) -> None:
        raise NotImplementedError

    def _handle_bytes(self, data: bytes) -> None:
        raise NotImplementedError


class FastrakSource(_SerialSource):
    """Source of a Polhemus FASTRAK; the switch of its stylus is button 0.

    Parameters
    ----------
    port
        Name of the serial port.
    binary
        Whether to request binary records, of 34 bytes instead of 62.
    """

    def __init__(
        self,
        port: str,
        listener: Listener,
        *,
        binary: bool = False,
        baud: int = BAUD,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(f"fastrak:{port}", "Polhemus FASTRAK", listener, port=port, baud=baud, clock=clock)
        self._binary = binary

    def _setup_bytes(self) -> bytes:
        return setup_commands(binary=self._binary)

    def _stop_bytes(self) -> bytes:
        return b"c"

    def _reset_stream(self) -> None:
        self._stream = FastrakStream(binary=self._binary)
        self._stream.num_bad = self.num_bad
        self._spread = StampSpreader(1.0 / RATE_HZ)

    def _handle_bytes(self, data: bytes) -> None:
        records = [record for record in self._stream.feed(data) if record.station == 1]
        for record, at_s in zip(records, self._spread.stamps(len(records), self._clock()), strict=True):
            self._set_live()
            sample = PoseSample(at_s, record.position_mm, record.orientation_wxyz, int(record.button))
            self._publish_sample(self.address, sample)


class HandleSource(_SerialSource):
    """Source of a scope handle (``docs/scope-handle.md``)."""

    def __init__(
        self, port: str, listener: Listener, *, baud: int = BAUD, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(f"handle:{port}", "Scope handle", listener, port=port, baud=baud, clock=clock)

    def _setup_bytes(self) -> bytes:
        return b"?\nG\n"

    def _stop_bytes(self) -> bytes:
        return b"H\n"

    def _reset_stream(self) -> None:
        self._stream = HandleStream()
        self._stream.num_bad = self.num_bad

    def _handle_bytes(self, data: bytes) -> None:
        for sample in self._stream.feed(data):
            self._set_live()
            self._publish_sample(self.address, sample)
