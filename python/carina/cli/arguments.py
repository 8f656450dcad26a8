"""Parsing and checks of command-line arguments: points, directions, sizes, ranges, paths."""

from __future__ import annotations

import errno
import math
import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.disk import disk_trouble
from carina.display.escaped_text import printable
from carina.errors import UsageError, VolumeImportError


def parse_point(text: str, what: str) -> NDArray[np.float64]:
    """Parse ``x,y,z`` in mm (LPS), each with an optional sign."""
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        msg = f"{what}: expected three numbers x,y,z in mm (LPS), such as -12.5,30,41; found {text!r}"
        raise UsageError(msg)
    return np.array(values)


def check_range(option: str, value: float | None, least: float, most: float, unit: str = "") -> None:
    """Refuse a number outside a range before the work begins; None is not checked.

    Raises
    ------
    UsageError
        If the number is not finite or outside the range.
    """
    if value is not None and not least <= value <= most:
        expected = f"a number from {least:g} to {most:g}{f' {unit}' if unit else ''}"
        raise UsageError(f"{option}: expected {expected}; found {value:g}", code="usage.range")


def check_needs(why: str, **given: object) -> None:
    """Refuse options that have no effect in this combination.

    Parameters
    ----------
    why
        End of the message *--OPTION only applies to*.
    **given
        The options, with ``_`` for ``-``; False and None mean that an option was not given.

    Raises
    ------
    UsageError
        ``usage.ignored``, for the first option that was given.
    """
    for name, value in given.items():
        if value is not None and value is not False:
            raise UsageError(f"--{name.replace('_', '-')} only applies to {why}", code="usage.ignored")


def parse_size(text: str) -> tuple[int, int]:
    """Parse ``WxH`` in pixels."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not match or not all(1 <= int(side) <= 8192 for side in match.groups()):
        raise UsageError(f"--size: expected WxH from 1x1 to 8192x8192 pixels, such as 512x512; found {text!r}")
    return int(match[1]), int(match[2])


def check_output_file(path: Path, *suffixes: str, what: str = "-o") -> None:
    """Refuse the path of a result before the work begins, and not after the work.

    Raises
    ------
    UsageError
        If the suffix is wrong, the folder does not exist, or the path is a folder.
    DiskError
        If the user may not write in the folder.
    """
    if suffixes and not path.name.lower().endswith(suffixes):
        raise UsageError(f"{what}: expected a file name that ends in {', '.join(suffixes)}; found {path.name[:80]!r}")
    if not path.parent.is_dir():
        raise UsageError(f"{what}: the folder {path.parent} does not exist")
    if path.is_dir():
        raise UsageError(f"{what}: expected a file; {path} is a folder")
    _check_writable(path.parent)


def check_window_path(path: Path | None) -> None:
    """Refuse a path that is not UTF-8 or has control characters, because no JSON message can carry it to the window.

    Raises
    ------
    VolumeImportError
        If the path is not UTF-8 or contains control characters.
    """
    if path is not None and printable(str(path)) != str(path):
        msg = (
            f"{path}: the window cannot open a file or folder whose name is not valid UTF-8 or contains control "
            "characters; rename it"
        )
        raise VolumeImportError(msg, code="import.unreadable")


def check_output_folder(path: Path) -> None:
    """Check a folder for results before the work; a missing folder is created later."""
    if path.exists() and not path.is_dir():
        raise UsageError(f"-o: expected a folder; {path} is a file")
    above = path
    while not above.exists():
        above = above.parent
    if not above.is_dir():
        raise UsageError(f"-o: expected a folder; {above} is a file")
    _check_writable(above)


def _check_writable(folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise disk_trouble(PermissionError(errno.EACCES, os.strerror(errno.EACCES)), "-o: cannot write to", folder)
