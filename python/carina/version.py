"""Which Carina this is, for whoever writes it into a file."""

from __future__ import annotations

__all__ = ["VERSION"]

VERSION = "0.1.0"
