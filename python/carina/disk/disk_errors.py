"""Errors of a disk as messages for the user: the operation, the path, the needed and free space, and a remedy."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from typing import NamedTuple

from carina.errors import CarinaError, DiskError

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_DENIED = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_MISSING = frozenset({errno.ENOENT, errno.ENOTDIR})
_IN_THE_WAY = frozenset({errno.EISDIR, errno.EEXIST, errno.ENOTEMPTY})
_OTHER = frozenset({errno.EIO, errno.EFBIG, errno.ENAMETOOLONG, errno.ELOOP, errno.ESTALE, errno.ENXIO, errno.ENODEV})
_MACHINE = frozenset({errno.EMFILE, errno.ENFILE})


def say_size(num_bytes: int) -> str:
    """Return a number of bytes as a short text: ``0 MB``, ``3.2 MB``, ``41 MB``, ``1.6 GB``."""
    if num_bytes >= 1_000_000_000:
        return f"{num_bytes / 1e9:.1f} GB"
    if num_bytes >= 10_000_000 or num_bytes == 0:
        return f"{num_bytes / 1e6:.0f} MB"
    if num_bytes >= 100_000:
        return f"{num_bytes / 1e6:.1f} MB"
    return f"{max(1, round(num_bytes / 1e3))} kB"


def is_disk_trouble(error: BaseException) -> bool:
    """Return whether an error comes from the disk or the machine, and not from a fault in Carina."""
    known = _FULL | _DENIED | _MISSING | _IN_THE_WAY | _OTHER | _MACHINE
    return isinstance(error, OSError) and not isinstance(error, CarinaError) and error.errno in known


def disk_trouble(
    error: OSError,
    doing: str,
    where: Path | str | None,
    *,
    needed_bytes: int | None = None,
    unchanged: str = "",
) -> DiskError:
    """Return the error that states which operation the disk refused.

    Parameters
    ----------
    error
        The error from the operating system. A :class:`DiskError` is returned unchanged.
    doing
        The operation that failed, such as "cannot write the mask to"; the path follows it in the message.
    where
        File or folder; None if the path would not help the user, such as a temporary folder.
    needed_bytes
        Number of bytes to be written, if known.
    unchanged
        State of the former file, if there is one, such as "the former file is unchanged".

    Returns
    -------
    DiskError
        The code of the error states its kind: ``disk.full``, ``disk.denied``, ``disk.missing``, ``disk.in-the-way``,
        ``disk.failed``, or ``machine.files`` for too many open files.
    """
    if isinstance(error, DiskError):
        return error
    code, why, advice = _reason(error, where, needed_bytes)
    place = "" if where is None else f" {where}"
    words = "; ".join(part for part in (f"{doing}{place}: {why}", advice, unchanged) if part)
    made = DiskError(words, code=code)
    made.errno, made.strerror = error.errno, why
    return made


class _ErrorReason(NamedTuple):
    """Code, reason and remedy of an error of the operating system."""

    code: str
    why: str
    advice: str


def _reason(error: OSError, where: Path | str | None, needed_bytes: int | None) -> _ErrorReason:
    """Return the code, the reason and the remedy for an error of the operating system."""
    place = None if where is None else Path(where)
    elsewhere = "choose another folder"
    or_elsewhere = "" if place is None else " or choose another folder"
    match error.errno:
        case errno.ENOSPC:
            known = [] if needed_bytes is None else [f"about {say_size(needed_bytes)} needed"]
            free = _free_bytes(place)
            known += [] if free is None else [f"{say_size(free)} free"]
            numbers = f" ({', '.join(known)})" if known else ""
            return _ErrorReason("disk.full", f"the disk is full{numbers}", f"free some space{or_elsewhere}")
        case errno.EDQUOT:
            return _ErrorReason("disk.full", "your quota on this disk is exhausted", f"delete files{or_elsewhere}")
        case errno.EFBIG:
            return _ErrorReason("disk.full", "the file would exceed the size limit of this disk or account", elsewhere)
        case errno.EROFS:
            return _ErrorReason("disk.denied", "this disk is read-only", elsewhere)
        case errno.EACCES | errno.EPERM:
            return _ErrorReason("disk.denied", "you do not have permission to write there", elsewhere)
        case errno.ENOENT:
            if place is not None and place.parent.is_dir():
                return _ErrorReason("disk.missing", "there is no such file or folder", "check the path")
            return _ErrorReason("disk.missing", "there is no such folder", "create it, or choose another")
        case errno.ENOTDIR:
            return _ErrorReason("disk.missing", "part of this path is a file, not a folder", elsewhere)
        case errno.EISDIR | errno.EEXIST | errno.ENOTEMPTY:
            return _ErrorReason(
                "disk.in-the-way", "an item with this name already exists", "move it, or choose another name"
            )
        case errno.ENAMETOOLONG:
            return _ErrorReason("disk.failed", "the name is too long for this disk", "choose a shorter one")
        case errno.EMFILE | errno.ENFILE:
            return _ErrorReason(
                "machine.files", "too many files and connections are open", "close other windows and try again"
            )
        case errno.EIO:
            return _ErrorReason("disk.failed", "the disk reported an error", "check the disk, or choose another")
        case _:
            return _ErrorReason("disk.failed", error.strerror or str(error) or type(error).__name__, "")


def _free_bytes(place: Path | None) -> int | None:
    """Return the free space of the disk of a path, or of the folder for temporary files; None if it is unknown."""
    import tempfile

    try:
        folder = Path(tempfile.gettempdir()) if place is None else place
        while not folder.is_dir() and folder != folder.parent:
            folder = folder.parent
        return shutil.disk_usage(os.fspath(folder)).free
    except OSError:
        return None
