"""Check whether a file begins like DICOM, in a module that does not load a DICOM library."""

from __future__ import annotations

from pathlib import Path

from carina.disk import open_regular


def looks_like_dicom(path: Path) -> bool:
    """Return whether the first bytes are a DICOM preamble, or a bare data set as old archives write it."""
    try:
        with open_regular(path) as file:
            return starts_like_dicom(file.read(132))
    except OSError:
        return False


def starts_like_dicom(head: bytes) -> bool:
    """Return whether the first 132 bytes of a file begin like DICOM."""
    if head[128:132] == b"DICM":
        return True
    # Without a preamble, the group of the first element is 0002 or 0008 (little or big endian) and its element is
    # small.
    groups = {b"\x02\x00", b"\x08\x00", b"\x00\x02", b"\x00\x08"}
    return len(head) == 132 and head[:2] in groups and 0 in head[2:4]
