"""The right to write a file that a person named."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from carina.disk.locks import try_lock

__all__ = ["NamedLock"]


class NamedLock:
    """The right to write a file, by a lock of the system on another beside it: the file itself is replaced when it is
    written, and SQLite has locks of its own there."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    @classmethod
    def take(cls, path: Path) -> NamedLock | None:
        """None where another has it, or where nothing can be locked or written."""
        beside = path.with_name(f".{path.name}.lock")
        while True:
            try:
                descriptor = os.open(beside, os.O_RDWR | os.O_CREAT, 0o600)
            except OSError:
                return None
            lock = cls(beside, descriptor)
            if try_lock(descriptor) is not True:
                os.close(descriptor)
                return None
            with contextlib.suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), beside.stat()):
                    return lock
            # Its owner has just removed it.
            os.close(descriptor)

    @staticmethod
    def is_taken(path: Path) -> bool:
        """Whether another has the right to write a file; where nothing can be locked, nobody has."""
        try:
            descriptor = os.open(path.with_name(f".{path.name}.lock"), os.O_RDWR)
        except OSError:
            return False
        try:
            return try_lock(descriptor) is False
        finally:
            os.close(descriptor)

    def release(self) -> None:
        """Another may have it now; nothing stays beside the file."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is None:
            return
        # While it is still ours; Windows removes no file that is open.
        with contextlib.suppress(OSError):
            self._path.unlink()
        os.close(descriptor)
        if os.name == "nt":
            with contextlib.suppress(OSError):
                self._path.unlink()
