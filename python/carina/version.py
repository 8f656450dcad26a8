"""Version numbers of Carina and of its wire protocol."""

from __future__ import annotations

__all__ = ["VERSION", "WIRE_VERSION"]

VERSION = "0.1.0"
WIRE_VERSION = 7
"""Version of the messages between Carina and its window, a phone, and client programs (``protocol/README.md``)."""
