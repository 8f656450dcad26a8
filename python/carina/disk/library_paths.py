"""File names that are passed to C and C++ libraries, which accept UTF-8 only."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from carina.disk.temporary_folders import scratch_folder
from carina.errors import DiskError


@contextlib.contextmanager
def library_path(path: Path) -> Iterator[str]:
    """Yield a UTF-8 name of a file for a C++ library: its own name, or a link to the file in a private folder.

    C++ libraries refuse a name that is not UTF-8, or end the process, so every name passes through this function.

    Parameters
    ----------
    path
        A file that exists, or a file to be written in a temporary folder of Carina.

    Raises
    ------
    DiskError
        If the name of the folder for temporary files is not UTF-8 either.
    """
    if _is_utf8(path):
        yield str(path)
        return
    with scratch_folder() as folder:
        # The library selects its reader by the suffix.
        suffix = path.suffix if path.suffix.isascii() else ""
        link = folder / f"file{suffix}"
        if not _is_utf8(link):
            msg = (
                f"the name of the folder for temporary files, {folder.parent}, is not valid UTF-8; "
                "set TMPDIR to a folder with a UTF-8 name"
            )
            raise DiskError(msg, code="disk.failed")
        try:
            link.symlink_to(path.absolute())
        except OSError:  # Windows does not allow links for ordinary users
            shutil.copyfile(path, link)
        yield str(link)


def _is_utf8(path: Path) -> bool:
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True
