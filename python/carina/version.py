"""Which Carina this is, for whoever writes it into a file."""

from __future__ import annotations

__all__ = ["VERSION", "WIRE_VERSION"]

VERSION = "0.1.0"
WIRE_VERSION = 3
"""Of the messages between Carina and its window, a phone, and programs that join (``protocol/README.md``)."""
