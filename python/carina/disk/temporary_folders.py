"""Temporary folders for patient images: readable by this user only, and deleted even after a crash.

A process has one root folder, ``carina-scratch-XXXXXXXX``, created at first use, with one subfolder for each use. The
root folder contains a file ``lock`` that the process keeps locked; the operating system releases the lock when the
process ends, also after a crash. The next process of Carina deletes the root folders whose lock nobody holds.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import os
import re
import shutil
import stat
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from carina.disk.disk_errors import disk_trouble
from carina.disk.locks import try_lock
from carina.display import as_words

PREFIX = "carina-scratch-"
LOCK = "lock"
OLD_AFTER_S = 86_400.0
"""Age in seconds from which a folder without a lock file is deleted.

Such a folder comes from an earlier version of Carina, or from a process that was killed while it created the folder.
"""
_OURS = re.compile(PREFIX + r"[a-z0-9_]{8}")
_OLDER = re.compile(r"carina-(upload-|download-)[a-z0-9_]{8}")
_OLDEST = re.compile(r"carina-[a-z0-9_]{8}")
_OLDEST_FILES = re.compile(r"phone\.pem|pixels\.dcm|volume\.[a-z.]{3,8}")
"""Names of the files in temporary folders of the earliest version of Carina.

A folder with a name like ``_OLDEST`` may belong to the user, so it is deleted only if it contains these files and
no others.
"""
_MAX_SWEPT = 1000


class ScratchFolder:
    """A temporary folder in the process's root folder, readable by this user only; call :meth:`remove` after use."""

    def __init__(self) -> None:
        self.path = _Root.new_folder()

    def __repr__(self) -> str:
        """Return the path of the folder."""
        return f"ScratchFolder({as_words(str(self.path))})"

    def remove(self) -> None:
        """Delete the folder with its content; a missing folder is ignored."""
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Path:
        """Return the path for a ``with`` block."""
        return self.path

    def __exit__(self, *_trouble: object) -> None:
        """Delete the folder at the end of a ``with`` block."""
        self.remove()


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Create a temporary folder and delete it at the end of the block.

    Yields
    ------
    Path
        The folder.

    Raises
    ------
    DiskError
        If the temporary folder cannot be written, or is full.
    """
    try:
        with ScratchFolder() as path:
            yield path
    except OSError as error:
        if error.errno not in {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG, errno.EACCES}:
            raise
        raise disk_trouble(error, "temporary files cannot be stored", None) from error


class _Root:
    """The root folder of this process and its lock."""

    _lock = threading.Lock()
    _path: Path | None = None
    _held: int = -1
    _pid = 0

    @classmethod
    def new_folder(cls) -> Path:
        with cls._lock:
            # A forked child inherits the parent's variables and lock, but must not use the parent's folder.
            if cls._path is None or cls._pid != os.getpid() or not (cls._path / LOCK).exists():
                cls._make_root()
            assert cls._path is not None
            return Path(tempfile.mkdtemp(prefix="", dir=cls._path))

    @classmethod
    def _make_root(cls) -> None:
        """Create and lock the root folder of this process, after a sweep of abandoned folders at the first call."""
        first = cls._pid != os.getpid()
        if first:
            sweep_scratch()
        # mkdtemp always creates a new folder, with mode 0700; it never uses a folder that another user prepared.
        path = Path(tempfile.mkdtemp(prefix=PREFIX)).resolve()
        try:
            # The file is locked before it is renamed to its final name, so another process never sees an unlocked lock
            # file.
            held = os.open(path / "new", os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
            try_lock(held)
            if os.name == "nt":  # pragma: no cover
                os.close(held)  # Windows cannot rename an open file
                (path / "new").replace(path / LOCK)
                held = os.open(path / LOCK, os.O_RDWR)
                try_lock(held)
            else:
                (path / "new").replace(path / LOCK)
        except BaseException:
            shutil.rmtree(path, ignore_errors=True)
            raise
        if first:
            atexit.register(cls.delete_root, os.getpid())
        elif cls._held >= 0:
            with contextlib.suppress(OSError):
                os.close(cls._held)
        cls._path, cls._held, cls._pid = path, held, os.getpid()

    @classmethod
    def delete_root(cls, pid: int) -> None:
        """Delete the root folder at the regular end of the process."""
        if pid != os.getpid() or cls._path is None or cls._pid != pid:
            return
        path, cls._path = cls._path, None
        if os.name == "nt":  # pragma: no cover
            os.close(cls._held)
        shutil.rmtree(path, ignore_errors=True)


def sweep_scratch(folder: Path | None = None, *, now_s: float | None = None) -> int:
    """Delete the temporary folders that killed processes of this user have left, and return the number of folders.

    Folders in use by another process and folders of other users stay, and links are not followed. Errors of the disk
    are ignored.

    Parameters
    ----------
    folder
        Folder for temporary files; None selects that of the system.
    now_s
        Current time in seconds since 1970, for tests.
    """
    try:
        base = Path(tempfile.gettempdir()) if folder is None else folder
        with os.scandir(base) as entries:
            names = [e.name for e in entries if e.name.startswith("carina-")]
    except OSError:
        return 0
    moment_s = time.time() if now_s is None else now_s
    return sum(_sweep_root(base / name, moment_s) for name in sorted(names)[:_MAX_SWEPT])


def _sweep_root(path: Path, now_s: float) -> bool:
    """Delete a temporary folder of this user if no process uses it; return whether the folder was deleted."""
    try:
        if not _is_own_folder(path):
            return False
        if _OURS.fullmatch(path.name) and (path / LOCK).exists():
            return _sweep_locked(path)
        known = _OURS.fullmatch(path.name) or _OLDER.fullmatch(path.name) or _is_oldest(path)
        if not known or now_s - _latest_change_s(path) < OLD_AFTER_S:
            return False
        shutil.rmtree(path)
        return True
    except OSError:
        return False


def _is_own_folder(path: Path) -> bool:
    """Return whether a path is a folder of this user, and not a link."""
    seen = path.lstat()
    return stat.S_ISDIR(seen.st_mode) and (not hasattr(os, "geteuid") or seen.st_uid == os.geteuid())


def _is_oldest(path: Path) -> bool:
    if not _OLDEST.fullmatch(path.name):
        return False
    inside = [e.name for e in os.scandir(path)]
    return bool(inside) and all(_OLDEST_FILES.fullmatch(name) for name in inside)


def _latest_change_s(path: Path) -> float:
    """Return the time of the latest change of a folder or of anything in it, in seconds since 1970."""
    latest_s = path.lstat().st_mtime
    for above, folders, files in os.walk(path):
        for name in (*folders, *files):
            latest_s = max(latest_s, (Path(above) / name).lstat().st_mtime)
    return latest_s


def _sweep_locked(path: Path) -> bool:
    """Delete a root folder if its lock is free; return whether the folder was deleted."""
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    lock = path / LOCK
    if not stat.S_ISREG(lock.lstat().st_mode):
        return False
    descriptor = os.open(lock, flags)
    try:
        # Without support for locks, the use of the folder is unknown, so the folder stays.
        if try_lock(descriptor) is not True:
            return False
        # The lock file is deleted last, so that the next sweep recognises the folder if this sweep is interrupted.
        for entry in list(os.scandir(path)):
            if entry.name == LOCK:
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path)
            else:
                Path(entry.path).unlink()
        if os.name != "nt":
            lock.unlink()
    finally:
        os.close(descriptor)
    if os.name == "nt":  # pragma: no cover
        lock.unlink()
    path.rmdir()
    return True
