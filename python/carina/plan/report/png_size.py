"""How large a PNG is, from its header (PNG specification, third edition: 5.3, 11.2.1)."""

from __future__ import annotations

import struct

from carina.display.png import SIGNATURE
from carina.errors import UsageError

__all__ = ["png_size"]


def png_size(png: bytes) -> tuple[int, int]:
    """Width and height in pixels.

    Raises
    ------
    UsageError
        If the bytes are no PNG.
    """
    if not png.startswith(SIGNATURE) or len(png) < 24 or png[12:16] != b"IHDR":
        raise UsageError("report: expected the bytes of a PNG picture", code="plan.pictures")
    width, height = struct.unpack(">II", png[16:24])
    return int(width), int(height)
