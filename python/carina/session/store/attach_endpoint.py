"""Connection details with which the user's programs join a case that is open in Carina: a private file.

The file is beside the lock of the case and contains an address and a token. The lock alone decides who owns the case,
so a file that a crash left is harmless. The details are never part of a case file or of an exported file.
"""

from __future__ import annotations

import contextlib
import json
import logging
from pathlib import Path

import msgspec

from carina.disk import read_regular_text, write_whole
from carina.display import as_words
from carina.typed_reading import read_plain
from carina.value import FrozenValue

logger = logging.getLogger(__name__)

ENDPOINT_FILE = "door.json"
FORMAT, VERSION = "carina-door", 1
MAX_BYTES = 1 << 16


class AttachEndpoint(FrozenValue, frozen=True):
    """Address of a running Carina process on this machine and its access token; both are None if it has none."""

    url: str | None = None
    """WebSocket address, such as ``ws://127.0.0.1:8000/join``."""
    token: str | None = None

    def __repr__(self) -> str:
        """Describe the address without the token."""
        return f"AttachEndpoint({as_words(self.url)})"


def write_endpoint(folder: Path, endpoint: AttachEndpoint) -> None:
    """Write the address of a case's owner into the case's folder; if the disk refuses, no program can join."""
    plain = {"format": FORMAT, "version": VERSION, **msgspec.structs.asdict(endpoint)}
    try:
        write_whole(
            folder / ENDPOINT_FILE,
            (json.dumps(plain, allow_nan=False) + "\n").encode(),
            what="the connection details of this case",
            private=True,
        )
    except OSError as error:
        logger.warning("no program can join this case: %s", type(error).__name__)


def delete_endpoint(folder: Path) -> None:
    """Delete the address file of a case, or one that a crash left, before another process may own the case."""
    with contextlib.suppress(OSError):
        (folder / ENDPOINT_FILE).unlink()


def read_endpoint(folder: Path) -> AttachEndpoint | None:
    """Return the connection details in a case's folder; None without a readable file.

    The owner may have ended since.
    """
    with contextlib.suppress(OSError, ValueError, RecursionError, msgspec.ValidationError):
        plain = json.loads(read_regular_text(folder / ENDPOINT_FILE, max_bytes=MAX_BYTES))
        if isinstance(plain, dict) and plain.pop("format", None) == FORMAT and plain.pop("version", None) == VERSION:
            return read_plain(plain, AttachEndpoint)
    return None
