"""Temporary folders that hold a patient's images: for this person alone, and gone even after a crash.

A process has one folder, ``carina-scratch-XXXXXXXX``, made when it is first needed, and parts of it for each use. It
holds a file ``lock``, which is locked as long as the process lives: the operating system frees it however the process
ends. The next Carina removes the folders that nobody holds.
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

from carina.disk.locks import try_lock
from carina.disk.trouble import disk_trouble
from carina.display import as_words

__all__ = ["ScratchFolder", "scratch_folder", "sweep_scratch"]

PREFIX = "carina-scratch-"
LOCK = "lock"
OLD_AFTER_S = 86_400.0
"""A folder without a lock is of an older Carina, or was being made when it was killed."""
_OURS = re.compile(PREFIX + r"[a-z0-9_]{8}")
_OLDER = re.compile(r"carina-(upload-|download-)[a-z0-9_]{8}")
_OLDEST = re.compile(r"carina-[a-z0-9_]{8}")
_OLDEST_FILES = re.compile(r"phone\.pem|pixels\.dcm|volume\.[a-z.]{3,8}")
"""Such a short name may be a person's own: only a folder with nothing but these is known to be ours."""
_MAX_SWEPT = 1000


class ScratchFolder:
    """A folder in this process's own one, readable by this person alone; :meth:`remove` it when it is not needed."""

    def __init__(self) -> None:
        self.path = _Root.new_folder()

    def __repr__(self) -> str:
        return f"ScratchFolder({as_words(str(self.path))})"

    def remove(self) -> None:
        """Remove it with all that it holds; nothing if it is gone."""
        shutil.rmtree(self.path, ignore_errors=True)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_trouble: object) -> None:
        self.remove()


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """A folder for the time of a block.

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
    """This process's folder and its lock."""

    _lock = threading.Lock()
    _path: Path | None = None
    _held: int = -1
    _pid = 0

    @classmethod
    def new_folder(cls) -> Path:
        with cls._lock:
            # A child of this process has the parent's variables and its lock, but not its folder.
            if cls._path is None or cls._pid != os.getpid() or not (cls._path / LOCK).exists():
                cls._make()
            assert cls._path is not None
            return Path(tempfile.mkdtemp(prefix="", dir=cls._path))

    @classmethod
    def _make(cls) -> None:
        first = cls._pid != os.getpid()
        if first:
            sweep_scratch()
        # mkdtemp: a new folder, never one that somebody has laid out for us, with mode 0700.
        path = Path(tempfile.mkdtemp(prefix=PREFIX)).resolve()
        try:
            # Locked before it has its name: who sees the name can trust the lock.
            held = os.open(path / "new", os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
            try_lock(held)
            if os.name == "nt":  # pragma: no cover
                os.close(held)  # an open file cannot be renamed there
                (path / "new").replace(path / LOCK)
                held = os.open(path / LOCK, os.O_RDWR)
                try_lock(held)
            else:
                (path / "new").replace(path / LOCK)
        except BaseException:
            shutil.rmtree(path, ignore_errors=True)
            raise
        if first:
            atexit.register(cls.end, os.getpid())
        elif cls._held >= 0:
            with contextlib.suppress(OSError):
                os.close(cls._held)
        cls._path, cls._held, cls._pid = path, held, os.getpid()

    @classmethod
    def end(cls, pid: int) -> None:
        """Remove the folder when the process ends as it should."""
        if pid != os.getpid() or cls._path is None or cls._pid != pid:
            return
        path, cls._path = cls._path, None
        if os.name == "nt":  # pragma: no cover
            os.close(cls._held)
        shutil.rmtree(path, ignore_errors=True)


def sweep_scratch(folder: Path | None = None, *, now_s: float | None = None) -> int:
    """Remove what a Carina of this person that was killed has left in the temporary folder; returns how many folders.

    Never one that another Carina uses, never another person's, and nothing that a link leads to. Trouble costs
    nothing but the sweep.

    Parameters
    ----------
    folder
        The temporary folder; the system's unless told.
    now_s
        Seconds since 1970, for tests.
    """
    try:
        base = Path(tempfile.gettempdir()) if folder is None else folder
        with os.scandir(base) as entries:
            names = [e.name for e in entries if e.name.startswith("carina-")]
    except OSError:
        return 0
    moment_s = time.time() if now_s is None else now_s
    return sum(_sweep(base / name, moment_s) for name in sorted(names)[:_MAX_SWEPT])


def _sweep(path: Path, now_s: float) -> bool:
    try:
        if not _is_mine(path):
            return False
        if _OURS.fullmatch(path.name) and (path / LOCK).exists():
            return _sweep_locked(path)
        known = _OURS.fullmatch(path.name) or _OLDER.fullmatch(path.name) or _is_oldest(path)
        if not known or now_s - _newest_s(path) < OLD_AFTER_S:
            return False
        shutil.rmtree(path)
        return True
    except OSError:
        return False


def _is_mine(path: Path) -> bool:
    """Whether it is a folder (no link to one) of this person."""
    seen = path.lstat()
    return stat.S_ISDIR(seen.st_mode) and (not hasattr(os, "geteuid") or seen.st_uid == os.geteuid())


def _is_oldest(path: Path) -> bool:
    if not _OLDEST.fullmatch(path.name):
        return False
    inside = [e.name for e in os.scandir(path)]
    return bool(inside) and all(_OLDEST_FILES.fullmatch(name) for name in inside)


def _newest_s(path: Path) -> float:
    """When something in a folder was last written."""
    newest = path.lstat().st_mtime
    for above, folders, files in os.walk(path):
        for name in (*folders, *files):
            newest = max(newest, (Path(above) / name).lstat().st_mtime)
    return newest


def _sweep_locked(path: Path) -> bool:
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    lock = path / LOCK
    if not stat.S_ISREG(lock.lstat().st_mode):
        return False
    descriptor = os.open(lock, flags)
    try:
        # Where nothing can be locked, nobody knows whether it is in use: it stays.
        if try_lock(descriptor) is not True:
            return False
        # The lock goes last: if this sweep is cut short, the next one still knows the folder.
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
