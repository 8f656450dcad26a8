"""Conversion of errors of the disk and of memory during an import to Carina's errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from carina.disk import special_kind
from carina.errors import CarinaError, GeometryError, VolumeImportError
from carina.volume.message_limits import MAX_MESSAGE_CHARS, bounded_message

T = TypeVar("T")


def guarded(path: Path, action: Callable[[Path], T]) -> T:
    """Run an import, and convert errors of the disk and of memory to import errors with a remedy.

    Parameters
    ----------
    path
        The file or folder to import.
    action
        The import, called with the path.

    Returns
    -------
    object
        The result of ``action``.

    Raises
    ------
    VolumeImportError
        If the path is a pipe, a socket or a device, cannot be read, or needs too much memory.
    """
    # Libraries open the path themselves, and a pipe would block them for ever.
    special = special_kind(path)
    if special is not None:
        msg = f"reading {path.name}: expected a file or a folder; found {special}; choose the scan's files"
        raise VolumeImportError(msg, code="import.not-an-image")
    try:
        return action(path)
    except CarinaError as error:
        if isinstance(error, GeometryError):
            msg = bounded_message(f"reading {path.name}: {error}; export it again")
            code = "import.geometry.spacing" if error.code == "geometry.spacing" else "import.geometry"
            raise VolumeImportError(msg, code=code) from None
        if len(str(error)) > MAX_MESSAGE_CHARS:
            error.args = (bounded_message(str(error)),)
        raise
    except PermissionError:
        msg = (
            f"reading {path.name}: you do not have permission to read it; change its permissions or copy it to a "
            "folder of your own"
        )
        raise VolumeImportError(msg, code="import.unreadable") from None
    except OSError as error:
        msg = (
            f"reading {path.name}: the disk reported an error ({error.strerror or type(error).__name__}); check "
            "the disk "
            "or copy the files"
        )
        raise VolumeImportError(msg, code="import.unreadable") from None
    except MemoryError:
        msg = (
            f"reading {path.name}: this machine does not have enough memory for it; close other programs, or crop or "
            "resample the volume"
        )
        raise VolumeImportError(msg, code="import.too-large") from None
