"""File locks that the operating system releases when the process ends, also after a crash."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["Held", "lock_file", "try_lock"]

_MAX_TRIES = 100

Held = bool | None
"""Result of :func:`try_lock`.

True: this process now holds the lock. False: another process holds it. None: the file system has no locks.
"""

if sys.platform == "win32":
    import msvcrt

    # A lock on Windows blocks reads and writes of the locked bytes, so the locked byte is far behind any content.
    _FAR = 1 << 62

    def try_lock(descriptor: int) -> Held:
        """Lock an open file for this process until it is closed, without waiting; return the result as :data:`Held`."""
        here = os.lseek(descriptor, 0, os.SEEK_CUR)
        try:
            os.lseek(descriptor, _FAR, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            return True
        except OSError as error:
            return False if error.errno in {errno.EACCES, errno.EDEADLK} else None
        finally:
            os.lseek(descriptor, here, os.SEEK_SET)

else:
    import fcntl

    def try_lock(descriptor: int) -> Held:
        """Lock an open file for this process until it is closed, without waiting; return the result as :data:`Held`."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except OSError as error:
            return False if error.errno in {errno.EWOULDBLOCK, errno.EACCES} else None


@contextlib.contextmanager
def lock_file(path: Path) -> Iterator[bool]:
    """Create and lock a file for the block, without waiting; yield False if another job or process holds the lock.

    The file is deleted at the end of the block. On a file system without locks the result is True.

    Raises
    ------
    OSError
        If the file cannot be created.
    """
    descriptor = _lock_existing(path)
    if descriptor is None:
        yield False
        return
    try:
        yield True
    finally:
        # The file is deleted before its lock is released, so that no process locks a file that then disappears.
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(descriptor)
        if os.name == "nt":  # pragma: no cover - Windows does not delete an open file
            with contextlib.suppress(OSError):
                path.unlink()


def _lock_existing(path: Path) -> int | None:
    """Return the descriptor of a locked file that the folder contains; None if another job or process has locked it."""
    for _ in range(_MAX_TRIES):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
        held = try_lock(descriptor)
        if held is None:
            return descriptor
        if held:
            with contextlib.suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), path.lstat()):
                    return descriptor
            # The previous owner has just deleted this file, so a lock on it excludes no other process.
        os.close(descriptor)
        if not held:
            return None
    return None
