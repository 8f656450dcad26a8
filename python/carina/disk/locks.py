"""Locks that the operating system frees when their owner dies, however it dies."""

from __future__ import annotations

import errno
import os
import sys

__all__ = ["Held", "try_lock"]

Held = bool | None
"""True: the lock is ours now. False: another process has it. None: this file system knows no locks."""

if sys.platform == "win32":
    import msvcrt

    # Windows' locks keep others from reading and writing the bytes: one far behind every content.
    _FAR = 1 << 62

    def try_lock(descriptor: int) -> Held:
        """Lock an open file for this process until it is closed; never waits."""
        here = os.lseek(descriptor, 0, os.SEEK_CUR)
        try:
            os.lseek(descriptor, _FAR, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            return True
        except OSError as trouble:
            return False if trouble.errno in {errno.EACCES, errno.EDEADLK} else None
        finally:
            os.lseek(descriptor, here, os.SEEK_SET)

else:
    import fcntl

    def try_lock(descriptor: int) -> Held:
        """Lock an open file for this process until it is closed; never waits."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except OSError as trouble:
            return False if trouble.errno in {errno.EWOULDBLOCK, errno.EACCES} else None
