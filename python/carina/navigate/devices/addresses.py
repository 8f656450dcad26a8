"""Addresses of devices: ``fastrak:/dev/ttyUSB0``, ``handle:COM3``, ``openigtlink:localhost:18944``.

``openigtlink:localhost:18944?silence=5`` opens the connection again after 5 s without data.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from carina.errors import UsageError
from carina.navigate.devices.igtl_peers import DEFAULT_PORT, IgtlClient
from carina.navigate.devices.serial_source import FastrakSource, HandleSource
from carina.navigate.devices.source import Listener, Source

KINDS = ("fastrak:PORT", "fastrak-binary:PORT", "handle:PORT", "openigtlink:HOST[:PORT][?silence=S]")


def open_source(address: str, listener: Listener, *, clock: Callable[[], float] = time.monotonic) -> Source:
    """Return the connection to the device of an address; the caller starts the connection.

    Raises
    ------
    UsageError
        ``devices.address``: if the address is invalid.
    """
    kind, _, place = address.partition(":")
    if place and kind in {"fastrak", "fastrak-binary"}:
        return FastrakSource(place, listener, binary=kind == "fastrak-binary", clock=clock)
    if place and kind == "handle":
        return HandleSource(place, listener, clock=clock)
    if place and kind == "openigtlink":
        place, _, option = place.partition("?")
        silence_s = _silence_s(option)
        host, _, port_text = place.rpartition(":") if ":" in place else (place, "", str(DEFAULT_PORT))
        known = silence_s is not None or not option
        if known and host and port_text.isascii() and port_text.isdigit() and 0 < int(port_text) < 65536:
            return IgtlClient(host, int(port_text), listener, silence_s=silence_s, clock=clock)
    raise UsageError(f"expected a device address such as {', '.join(KINDS)}; found {address!r}", code="devices.address")


def _silence_s(option: str) -> float | None:
    """Return S, in seconds, of the option ``silence=S`` of a device address, 0.1 to 3,600; None for any other text."""
    name, _, text = option.partition("=")
    try:
        seconds = float(text)
    except ValueError:
        return None
    return seconds if name == "silence" and 0.1 <= seconds <= 3600.0 else None
