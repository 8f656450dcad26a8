"""Opening of files that a user names; pipes, sockets and devices are refused without waiting for them."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final, TextIO

from carina.errors import VolumeImportError

AnyPath = str | os.PathLike[str]
NOT_A_FILE: Final = "disk.not-a-file"
_KINDS: Final = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe (FIFO)"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
# O_NONBLOCK: a pipe without a writer would block open(2) for ever. O_NOCTTY: a terminal must not become the controlling
# terminal.
_FLAGS: Final = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)


def special_kind(path: AnyPath) -> str | None:
    """Return the kind of a pipe, a socket or a device at a path; None for a file, a folder or a missing path."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):
        return None
    return None if stat.S_ISREG(mode) or stat.S_ISDIR(mode) else _kind_of_mode(mode)


def check_regular(path: AnyPath) -> None:
    """Refuse a pipe, a socket or a device before a library opens the path itself; this function opens nothing.

    Files, folders and missing paths pass, because the library reports errors about them more exactly.

    Raises
    ------
    VolumeImportError
        ``disk.not-a-file``.
    """
    found = special_kind(path)
    if found is not None:
        raise _refusal(path, found)


def open_regular(path: AnyPath, *, buffering: int = -1) -> BinaryIO:
    """Open a regular file for reading bytes; the call never waits for a writer or a device.

    The type of the file is checked on the path, so that no device is opened, and again on the open file, in case
    another process replaced the file between the two checks.

    Parameters
    ----------
    path
        The file.
    buffering
        As in ``open``.

    Returns
    -------
    BinaryIO
        The open file.

    Raises
    ------
    VolumeImportError
        ``disk.not-a-file``: if the path is a folder, a pipe, a socket or a device.
    OSError
        If the file is missing or cannot be read.
    """
    mode = Path(path).stat().st_mode
    if not stat.S_ISREG(mode):
        raise _refusal(path, _kind_of_mode(mode))
    try:
        descriptor = os.open(path, _FLAGS)
    except OSError as error:
        if error.errno in {errno.ENXIO, errno.ENODEV}:  # a socket or a device replaced the file after the check
            raise _refusal(path, "a socket or a device") from error
        raise
    try:
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            raise _refusal(path, _kind_of_mode(mode))
        return os.fdopen(descriptor, "rb", buffering)
    except BaseException:
        os.close(descriptor)
        raise


def open_regular_text(path: AnyPath, *, encoding: str = "utf-8") -> TextIO:
    """Open a regular file for reading text; see :func:`open_regular`."""
    import io

    return io.TextIOWrapper(open_regular(path), encoding=encoding)


def read_regular_text(path: AnyPath, *, max_bytes: int, encoding: str = "utf-8") -> str:
    """Read a whole text file of bounded size.

    Parameters
    ----------
    path
        The file.
    max_bytes
        Largest accepted size of the file.
    encoding
        Encoding of the text.

    Returns
    -------
    str
        The text.

    Raises
    ------
    VolumeImportError
        ``disk.not-a-file`` as :func:`open_regular`; ``disk.too-large`` if the file has more than ``max_bytes``.
    UnicodeDecodeError
        If the bytes are not text in this encoding.
    """
    with open_regular(path) as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise VolumeImportError(
            f"{path}: this file cannot be read: it is larger than {max_bytes} bytes; choose another file",
            code="disk.too-large",
        )
    return content.decode(encoding)


def _kind_of_mode(mode: int) -> str:
    return next((name for test, name in _KINDS if test(mode)), "a special file")


def _refusal(path: AnyPath, found: str) -> VolumeImportError:
    return VolumeImportError(f"{path}: expected a file; found {found}; choose a file", code=NOT_A_FILE)
