"""Devices that are connected to this machine: trackers over TCP, pens and handles at serial ports."""

from carina.navigate.devices.addresses import KINDS, open_source
from carina.navigate.devices.igtl_peers import IgtlClient, IgtlServer
from carina.navigate.devices.serial_source import FastrakSource, HandleSource, found_ports, serial_ports
from carina.navigate.devices.source import Listener, Source, SourceStatus

__all__ = [
    "KINDS",
    "FastrakSource",
    "HandleSource",
    "IgtlClient",
    "IgtlServer",
    "Listener",
    "Source",
    "SourceStatus",
    "found_ports",
    "open_source",
    "serial_ports",
]
