"""The lock that shows which window or program has a named case file open."""

from __future__ import annotations

import contextlib
import getpass
import json
import os
import socket
from pathlib import Path

from carina.disk.locks import try_lock

__all__ = ["LockedElsewhereError", "NamedLock", "lock_path"]

MAX_OWNER_BYTES = 400


class LockedElsewhereError(Exception):
    """Another window or program holds the lock; ``owner`` is a short text such as ``anna on ward-3``, or None."""

    def __init__(self, owner: str | None) -> None:
        super().__init__(owner)
        self.owner = owner


def lock_path(path: Path) -> Path:
    """Path of the lock file of a named case file: a hidden file in the same folder.

    The case file itself cannot carry the lock, because each save replaces it by a new file.
    """
    return path.with_name(f".{path.name}.lock")


class NamedLock:
    """An operating-system lock on the lock file of a named case file; it ends with its process."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    @classmethod
    def take(cls, path: Path) -> NamedLock | None:
        """Take the lock of a named case file; never waits.

        Returns
        -------
        NamedLock | None
            None where locks do not work: a network share without locks, or a folder that is not writable.

        Raises
        ------
        LockedElsewhereError
            If another window, program or user holds it.
        """
        beside = lock_path(path)
        while True:
            descriptor = _opened(beside)
            if descriptor is None:
                return None
            held = try_lock(descriptor)
            if held is not True:
                owner = _owner_in(descriptor)
                os.close(descriptor)
                if held is None:
                    return None
                raise LockedElsewhereError(owner)
            with contextlib.suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), beside.stat()):
                    _write_owner(descriptor)
                    return cls(beside, descriptor)
            # The previous owner has just removed this lock file: its lock excludes nobody any more.
            os.close(descriptor)

    def release(self) -> None:
        """Release the lock and remove the lock file; nothing if it was released."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is None:
            return
        # Removed while the lock is held, so that nobody can take a lock on a file that then disappears unnoticed.
        with contextlib.suppress(OSError):
            self._path.unlink()
        os.close(descriptor)
        if os.name == "nt":  # pragma: no cover - Windows removes no open file
            with contextlib.suppress(OSError):
                self._path.unlink()


def _opened(beside: Path) -> int | None:
    """Open the lock file, readable by the other users of a shared folder, who must be able to lock it too."""
    no_link = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        return os.open(beside, os.O_RDWR | os.O_CREAT | no_link, 0o666)
    except PermissionError:
        # The lock file of another user: a local lock needs no right to write.
        with contextlib.suppress(OSError):
            return os.open(beside, os.O_RDONLY | no_link)
    except OSError:
        pass
    return None


def _write_owner(descriptor: int) -> None:
    """Store who holds the lock, for the message that another user gets; failure costs only the name."""
    with contextlib.suppress(OSError, KeyError, AttributeError):
        text = json.dumps({"user": getpass.getuser()[:80], "computer": socket.gethostname()[:80]})
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)


def _owner_in(descriptor: int) -> str | None:
    with contextlib.suppress(OSError, ValueError, RecursionError, AttributeError):
        stored = json.loads(os.pread(descriptor, MAX_OWNER_BYTES, 0))
        user, computer = stored.get("user"), stored.get("computer")
        if isinstance(user, str) and isinstance(computer, str):
            text = "".join(c for c in f"{user} on {computer}" if c.isprintable())
            return text[:170] or None
    return None
