"""What the header of a grid file claims, and the words in which a header is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.model import Note

__all__ = ["AMBIGUOUS", "GridHeader", "beside", "real", "refuse", "take_once", "whole"]

AMBIGUOUS = (
    "open the DICOM series that it was made from, or convert that series again; saving this file again would only "
    "guess left and right"
)
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_REAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class GridHeader:
    """A file's claim about its grid."""

    format: str
    """``nifti``, ``nrrd`` or ``metaimage``."""
    shape_ijk: tuple[int, ...]
    num_components: int
    dtype: np.dtype[np.generic]
    """Of one value, in the file's byte order."""
    lps_from_ijk: NDArray[np.float64]
    data_path: Path
    data_offset: int
    """Where the values begin, after decompression; -1: they are the file's last bytes."""
    compression: str | None
    """``gzip`` (the whole file or the stream at the offset), ``zlib`` or None."""
    stream_offset: int = 0
    """Where the compressed stream begins in the file."""
    scaling: tuple[float, float] | None = None
    """Slope and intercept by which the numbers become values; None where they are the values."""
    notes: tuple[Note, ...] = ()
    """What a person should know about this header."""

    @property
    def num_voxels(self) -> int:
        """Voxels that it claims."""
        count = 1
        for n in self.shape_ijk:
            count *= n
        return count

    @property
    def num_bytes(self) -> int:
        """Bytes that the values must have."""
        return self.num_voxels * self.num_components * self.dtype.itemsize

    @property
    def sizes(self) -> str:
        """The claimed sizes in words."""
        return " x ".join(str(n) for n in self.shape_ijk)


def refuse(path: Path, problem: str, way_out: str, code: str) -> VolumeImportError:
    """A refusal: what is wrong and what a person can do."""
    return VolumeImportError(f"reading {path.name}: {problem}; {way_out}", code=code)


def whole(text: str) -> int:
    """A whole number as formats write it; ``int`` also takes ``1_000`` and digits of other scripts."""
    if not _WHOLE.fullmatch(text.strip()):
        msg = "not a whole number"
        raise ValueError(msg)
    return int(text)


def real(text: str) -> float:
    """A real number as formats write it."""
    if not _REAL.fullmatch(text.strip()):
        msg = "not a number"
        raise ValueError(msg)
    return float(text)


def take_once(path: Path, fields: dict[str, str], name: str, value: str) -> None:
    """Add a field of a text header; a field that is there twice has no one meaning.

    Raises
    ------
    VolumeImportError
        ``import.header.twice``.
    """
    if name in fields and fields[name] != value:
        problem = f"its header contains {name[:40]!r} twice, as {fields[name][:60]!r} and as {value[:60]!r}"
        raise refuse(path, problem, "programs differ in which one they use; export it again", "import.header.twice")
    fields[name] = value


def beside(path: Path, name: str) -> Path:
    """The data file that a detached header names; only a plain file in the same folder is followed.

    Raises
    ------
    VolumeImportError
        ``import.not-supported`` or ``import.not-found``.
    """
    simple = name.strip().removeprefix("./")
    if simple.upper().startswith("LIST") or "%" in simple:
        problem = "its values are split across several files, which is not supported"
        raise refuse(path, problem, "save it again as one file", "import.not-supported")
    if not simple or simple != Path(simple).name or "\\" in simple or simple in (".", ".."):
        problem = "its values are in another folder"
        raise refuse(path, problem, "save the scan again, with both files in one folder", "import.elsewhere")
    found = path.parent / simple
    if not found.is_file():
        problem = f"its values should be in {simple}, which is not in the same folder"
        raise refuse(path, problem, "put both files into one folder", "import.not-found")
    return found
