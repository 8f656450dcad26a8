"""Results on disk: whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from carina.errors import CarinaError

__all__ = ["write_whole", "write_whole_by"]


def write_whole(path: Path | str, content: bytes, *, what: str) -> Path:
    """Write a file so that it is either complete or as it was before.

    Raises
    ------
    CarinaError
        If the folder is missing or not writable, or the disk is full (``export.write``); what was there before stays.
    """

    def write(file: BinaryIO) -> None:
        file.write(content)

    return _whole(Path(path), what, lambda draft: _to_handle(draft, write), suffix=".part")


def write_whole_by(path: Path | str, write: Callable[[Path], None], *, what: str) -> Path:
    """The same for a library that writes by name; it is given a draft's name with the same suffix as ``path``."""
    target = Path(path)
    suffix = ".nii.gz" if target.name.lower().endswith(".nii.gz") else target.suffix
    return _whole(target, what, write, suffix=suffix)


def _to_handle(draft: Path, write: Callable[[BinaryIO], None]) -> None:
    with draft.open("wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())


def _whole(target: Path, what: str, write: Callable[[Path], None], *, suffix: str) -> Path:
    try:
        descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=suffix)
        os.close(descriptor)
        draft = Path(name)
        try:
            write(draft)
            # mkstemp makes a file that only its owner reads; a result has the permissions of any new file.
            mask = os.umask(0)
            os.umask(mask)
            draft.chmod(0o666 & ~mask)
            draft.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                draft.unlink()
            raise
    except OSError as error:
        msg = f"cannot write {what} to {target}: {error.strerror or error}"
        raise CarinaError(msg, code="export.write") from error
    return target
