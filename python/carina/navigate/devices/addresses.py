"""Devices by name: ``fastrak:/dev/ttyUSB0``, ``handle:COM3``, ``openigtlink:localhost:18944``."""

from __future__ import annotations

import time
from collections.abc import Callable

from carina.errors import UsageError
from carina.navigate.devices.igtl_peers import DEFAULT_PORT, IgtlClient
from carina.navigate.devices.serial_source import FastrakSource, HandleSource
from carina.navigate.devices.source import Listener, Source

__all__ = ["KINDS", "open_source"]

KINDS = ("fastrak:PORT", "fastrak-binary:PORT", "handle:PORT", "openigtlink:HOST[:PORT]")


def open_source(address: str, listener: Listener, *, clock: Callable[[], float] = time.monotonic) -> Source:
    """A connection to a device, not started yet.

    Raises
    ------
    UsageError
        ``devices.address``: if the name is none.
    """
    kind, _, place = address.partition(":")
    if place and kind in {"fastrak", "fastrak-binary"}:
        return FastrakSource(place, listener, binary=kind == "fastrak-binary", clock=clock)
    if place and kind == "handle":
        return HandleSource(place, listener, clock=clock)
    if place and kind == "openigtlink":
        host, _, port_text = place.rpartition(":") if ":" in place else (place, "", str(DEFAULT_PORT))
        if host and port_text.isascii() and port_text.isdigit() and 0 < int(port_text) < 65536:
            return IgtlClient(host, int(port_text), listener, clock=clock)
    raise UsageError(f"a device is named {', '.join(KINDS)}; found {address!r}", code="devices.address")
