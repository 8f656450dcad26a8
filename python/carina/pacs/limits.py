"""Limits of the data that a PACS may send: bytes of an answer, an image and a series, and number of images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from carina.errors import PacsError

__all__ = [
    "MAX_ANSWER_BYTES",
    "MAX_IMAGE_BYTES",
    "MAX_PDU_BYTES",
    "MAX_PREVIEW_BYTES",
    "MAX_SERIES_BYTES",
    "MAX_SERIES_IMAGES",
    "limit_socket",
    "too_large",
]

MAX_ANSWER_BYTES = 64 << 20
"""Maximum size in bytes of the answers to a search; 20,000 images have 6 MB."""
MAX_IMAGE_BYTES = 2 << 30
"""Maximum size in bytes of an image; an enhanced file contains a whole series."""
MAX_PREVIEW_BYTES = 32 << 20
"""Maximum size in bytes of an image that is retrieved for the picture of a series."""
MAX_SERIES_BYTES = 8 << 30
"""Maximum size in bytes of a series on the disk: twice the voxels that Carina opens, because some files have 32
bits."""
MAX_SERIES_IMAGES = 20_000
"""Maximum number of images of one series; a 4D chest CT has a few thousand."""
MAX_PDU_BYTES = 1 << 20
"""Maximum size in bytes of a message part (PDU) that this machine offers to receive."""


def too_large(name: str, what: str) -> PacsError:
    """Return the error for a series above a limit."""
    return PacsError(
        f"{name}: {what}, which is more than one chest CT can have; nothing was stored; choose another series",
        code="pacs.too-large",
    )


def limit_socket(association: Any, count: Callable[[int], None]) -> None:
    """Check the number of bytes before each read of an association's socket.

    pynetdicom collects a message of any length in memory, so the check precedes the read.

    Parameters
    ----------
    association
        The association, when its connection opens.
    count
        Called with the number of bytes that will be read; it raises OSError to close the connection.
    """
    transport = association.dul.socket
    read = transport.recv

    def limited(num_bytes: int) -> Any:
        # A PDU has a header of 6 bytes.
        if num_bytes > MAX_PDU_BYTES + 6:
            raise OSError("the PACS sent a longer PDU than this machine accepts")
        count(num_bytes)
        return read(num_bytes)

    transport.recv = limited
