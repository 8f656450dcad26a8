"""Content of a grid file's header, parsing of numbers in text headers, and errors about headers."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.display.escaped_text import printable, shown_value
from carina.errors import VolumeImportError
from carina.volume.model import Note

AMBIGUOUS = (
    "open the DICOM series that it was made from, or convert that series again; saving this file again would only "
    "guess left and right"
)
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_REAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[0-9],[0-9]")
_MAX_PROBLEM_CHARS = 400
_MAX_NAME_BYTES = 255  # limit of all common file systems


class HeaderValueError(ValueError):
    """Error for a field of a header whose value does not follow the format; the message names both."""

    def __init__(self, name: str, expected: str, found: str) -> None:
        comma = ", with a decimal point (a comma is not accepted)" if _DECIMAL_COMMA.search(found) else ""
        given = shown_value(found) if found.strip() else "no value"
        super().__init__(f"its {name} should be {expected}{comma}; found {given}")


@dataclass(frozen=True, slots=True)
class GridHeader:
    """The properties of a grid according to the header of its file."""

    format: str
    """Format of the file: ``nifti``, ``nrrd`` or ``metaimage``."""
    shape_ijk: tuple[int, ...]
    num_components: int
    dtype: np.dtype[np.generic]
    """Type of one value, in the file's byte order."""
    lps_from_ijk: NDArray[np.float64]
    data_path: Path
    data_offset: int
    """Offset of the values after decompression; -1 if they are the last bytes of the file."""
    compression: str | None
    """Compression of the values: ``gzip`` (the whole file or the stream at ``stream_offset``), ``zlib`` or None."""
    stream_offset: int = 0
    """Offset in bytes of the compressed stream in the file."""
    values_are_elsewhere: bool = False
    """Whether the values are in another file than the header."""
    file_is_gzipped: bool = False
    """Whether gzip compresses the whole data file in addition to the compression of the values."""
    head: bytes = field(default=b"", repr=False)
    """The header itself, decompressed, for the second reader."""
    scaling: tuple[float, float] | None = None
    """Slope and intercept that convert the stored numbers to values; None if no conversion is needed."""
    notes: tuple[Note, ...] = ()
    """Notes about the header for the user."""

    @property
    def num_voxels(self) -> int:
        """Number of voxels according to the header."""
        count = 1
        for n in self.shape_ijk:
            count *= n
        return count

    @property
    def num_bytes(self) -> int:
        """Number of bytes that the values must have."""
        return self.num_voxels * self.num_components * self.dtype.itemsize

    @property
    def sizes(self) -> str:
        """Numbers of voxels along the axes, as text for messages."""
        return " x ".join(str(n) for n in self.shape_ijk)


def refuse(path: Path, problem: str, way_out: str, code: str) -> VolumeImportError:
    """Return the error for a header, with the file, the problem (shortened if it is long) and the remedy."""
    short = printable(problem)
    if len(short) > _MAX_PROBLEM_CHARS:
        short = f"{short[: _MAX_PROBLEM_CHARS - 1]}…"
    return VolumeImportError(f"reading {path.name}: {short}; {way_out}", code=code)


def whole(text: str, name: str = "number") -> int:
    """Return the whole number in the field ``name``; unlike ``int``, refuse ``1_000`` and digits of other scripts.

    Raises
    ------
    HeaderValueError
        If the text is not a whole number.
    """
    if not _WHOLE.fullmatch(text.strip()):
        raise HeaderValueError(name, "a whole number", text)
    return int(text)


def wholes(text: str, name: str) -> tuple[int, ...]:
    """Return the whole numbers in the field ``name``, separated by white space.

    Raises
    ------
    HeaderValueError
        If one of them is not a whole number.
    """
    if not all(_WHOLE.fullmatch(part) for part in text.split()):
        raise HeaderValueError(name, "whole numbers", text)
    return tuple(int(part) for part in text.split())


def real(text: str, name: str = "number") -> float:
    """Return the real number in the field ``name``.

    Raises
    ------
    HeaderValueError
        If the text is not a number.
    """
    if not _REAL.fullmatch(text.strip()):
        raise HeaderValueError(name, "a number", text)
    return float(text)


def reals(text: str, name: str, count: int) -> list[float]:
    """Return the real numbers in the field ``name``, separated by white space.

    Parameters
    ----------
    text
        Value of the field.
    name
        Name of the field for messages.
    count
        Expected count of numbers.

    Raises
    ------
    HeaderValueError
        If there are not ``count`` numbers.
    """
    parts = text.split()
    if len(parts) != count or not all(_REAL.fullmatch(part) for part in parts):
        raise HeaderValueError(name, f"{count} numbers", text)
    return [float(part) for part in parts]


def take_once(path: Path, fields: dict[str, str], name: str, value: str) -> None:
    """Add a field of a text header; a field with two different values is ambiguous and refused.

    Parameters
    ----------
    path
        The file.
    fields
        Values of the fields by name; the field is added here.
    name, value
        Name and value of the field.

    Raises
    ------
    VolumeImportError
        ``import.header.twice``.
    """
    if name in fields and fields[name] != value:
        problem = (
            f"its header contains {shown_value(name, 40)} twice, as {shown_value(fields[name], 60)} and as "
            f"{shown_value(value, 60)}"
        )
        raise refuse(path, problem, "programs differ in which one they use; export it again", "import.header.twice")
    fields[name] = value


def beside(path: Path, name: str) -> Path:
    """Return the data file that a detached header names; only a file in the same folder is accepted.

    Parameters
    ----------
    path
        The header's file.
    name
        Name of the data file in the header.

    Raises
    ------
    VolumeImportError
        ``import.not-supported``, ``import.elsewhere`` or ``import.not-found``.
    HeaderValueError
        If the name is too long.
    """
    simple = name.strip().removeprefix("./")
    if simple.upper().startswith("LIST") or "%" in simple:
        problem = "its values are split across several files, which is not supported"
        raise refuse(path, problem, "save it again as one file", "import.not-supported")
    if len(os.fsencode(simple)) > _MAX_NAME_BYTES:
        raise HeaderValueError("name of the data file", f"at most {_MAX_NAME_BYTES} bytes long", simple)
    if not simple or simple != Path(simple).name or "\\" in simple or simple in (".", ".."):
        problem = "its values are in another folder"
        raise refuse(path, problem, "save the scan again, with both files in one folder", "import.elsewhere")
    found = path.parent / simple
    if not found.is_file():
        problem = f"its values should be in {shown_value(simple)}, which is not in the same folder"
        raise refuse(path, problem, "put both files into one folder", "import.not-found")
    return found
