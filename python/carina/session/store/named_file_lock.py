"""Locks that show which window or program has a named case file open."""

from __future__ import annotations

import contextlib
import getpass
import json
import os
import socket
from pathlib import Path

from carina.disk.locks import try_lock

MAX_OWNER_BYTES = 400
MAX_TRIES = 100


class LockedElsewhereError(Exception):
    """Another window or program holds the lock; ``owner`` is a short text such as ``anna on ward-3``, or None."""

    def __init__(self, owner: str | None) -> None:
        super().__init__(owner)
        self.owner = owner


def lock_path(path: Path) -> Path:
    """Return the path of the lock file of a named case file: a hidden file in the same folder.

    The lock is on a separate file, because each save replaces the case file by a new file.
    """
    return path.with_name(f".{path.name}.lock")


class NamedLock:
    """An operating-system lock on the lock file of a named case file; the lock ends with its process."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    @classmethod
    def take(cls, path: Path) -> NamedLock | None:
        """Take the lock of a named case file, without waiting.

        Returns
        -------
        NamedLock | None
            None if locks do not work, as on a network share without locks or in a folder that is not writable.

        Raises
        ------
        LockedElsewhereError
            If another window, program or user has the lock.
        """
        beside = lock_path(path)
        for _ in range(MAX_TRIES):
            descriptor = _open_lock_file(beside)
            if descriptor is None:
                return None
            held = try_lock(descriptor)
            if held is not True:
                owner = _read_owner(descriptor)
                os.close(descriptor)
                if held is None:
                    return None
                raise LockedElsewhereError(owner)
            with contextlib.suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), beside.stat()):
                    _write_owner(descriptor)
                    return cls(beside, descriptor)
            # The previous owner has just removed this lock file, so a lock on it excludes no other process.
            os.close(descriptor)
        # The network share reports another file number at each call, so lock files cannot be identified.
        return None

    def release(self) -> None:
        """Release the lock and remove the lock file; a second call has no effect."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is None:
            return
        # The file is removed before the lock is released, so that no process locks a file that then disappears.
        with contextlib.suppress(OSError):
            self._path.unlink()
        os.close(descriptor)
        if os.name == "nt":  # pragma: no cover - Windows does not remove an open file
            with contextlib.suppress(OSError):
                self._path.unlink()


def _open_lock_file(beside: Path) -> int | None:
    """Open the lock file so that the other users of a shared folder can read and lock it."""
    no_link = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        return os.open(beside, os.O_RDWR | os.O_CREAT | no_link, 0o666)
    except PermissionError:
        # The lock file may belong to another user; a local lock needs no write permission.
        with contextlib.suppress(OSError):
            return os.open(beside, os.O_RDONLY | no_link)
    except OSError:
        pass
    return None


def _write_owner(descriptor: int) -> None:
    """Store the owner's name for the message to another user; after a failure the message has no name."""
    with contextlib.suppress(OSError, KeyError, AttributeError):
        text = json.dumps({"user": getpass.getuser()[:80], "computer": socket.gethostname()[:80]})
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text.encode(), 0)


def _read_owner(descriptor: int) -> str | None:
    with contextlib.suppress(OSError, ValueError, RecursionError, AttributeError):
        stored = json.loads(os.pread(descriptor, MAX_OWNER_BYTES, 0))
        user, computer = stored.get("user"), stored.get("computer")
        if isinstance(user, str) and isinstance(computer, str):
            text = "".join(c for c in f"{user} on {computer}" if c.isprintable())
            return text[:170] or None
    return None
