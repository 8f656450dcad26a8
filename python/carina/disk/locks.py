"""File locks that the operating system releases when the process ends, also after a crash."""

from __future__ import annotations

import errno
import os
import sys

__all__ = ["Held", "try_lock"]

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
