"""Moves and copies of files that never replace another file."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from pathlib import Path

from carina.disk.atomic_files import sync_folder

_NO_HARD_LINKS = frozenset(
    {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK, errno.EXDEV, errno.EINVAL}
)
"""Error numbers with which FAT, exFAT and many network shares refuse a hard link."""


def move_to_new_name(source: Path, target: Path) -> None:
    """Move a file within its folder; fail if the target exists.

    A plain rename replaces the target on POSIX systems. A hard link does not, so the file is linked to its new name
    first. Where the file system has no hard links, an empty file reserves the name.

    Raises
    ------
    FileExistsError
        If a file has the target's name; both files stay unchanged.
    OSError
        If the disk refuses the move.
    """
    if os.name == "nt":  # pragma: no cover - os.rename fails on Windows if the target exists
        source.rename(target)
        return
    try:
        os.link(source, target)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        reserved = os.fstat(descriptor)
        os.close(descriptor)
        try:
            source.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                _remove_reservation(target, reserved)
            raise
    else:
        source.unlink()


def _remove_reservation(target: Path, reserved: os.stat_result) -> None:
    """Delete the empty file that reserves a name; a file with other content stays.

    A network share may report a failed move although the move succeeded, and another program may have used the name
    meanwhile.
    """
    found = target.lstat()
    if found.st_size == 0 and os.path.samestat(found, reserved):
        target.unlink()


def copy_to_new_name(source: Path, target: Path) -> None:
    """Give the content of a file a second name on the same disk; fail if the target exists.

    A hard link is used if the file system supports it: both names then share the content without a copy, and a file
    that replaces one name does not affect the other. Otherwise the content is copied and flushed to the disk.

    Raises
    ------
    FileExistsError
        If a file has the target's name; that file stays unchanged.
    OSError
        If the disk refuses the copy; nothing is left at the target.
    """
    try:
        os.link(source, target)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o600)
        try:
            with os.fdopen(descriptor, "wb") as copy, source.open("rb") as original:
                shutil.copyfileobj(original, copy, 1 << 20)
                copy.flush()
                os.fsync(copy.fileno())
            shutil.copymode(source, target)
        except BaseException:
            with contextlib.suppress(OSError):
                target.unlink()
            raise
    sync_folder(target.parent)
