"""Reader of NRRD headers (teem's definition of the format), attached and detached."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.display.escaped_text import shown_value
from carina.volume.header_fields import (
    AMBIGUOUS,
    GridHeader,
    HeaderValueError,
    beside,
    reals,
    refuse,
    take_once,
    whole,
    wholes,
)

_KINDS = {
    **dict.fromkeys(["signed char", "int8", "int8_t"], "i1"),
    **dict.fromkeys(["uchar", "unsigned char", "uint8", "uint8_t"], "u1"),
    **dict.fromkeys(["short", "short int", "signed short", "signed short int", "int16", "int16_t"], "i2"),
    **dict.fromkeys(["ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"], "u2"),
    **dict.fromkeys(["int", "signed int", "int32", "int32_t"], "i4"),
    **dict.fromkeys(["uint", "unsigned int", "uint32", "uint32_t"], "u4"),
    **dict.fromkeys(
        ["longlong", "long long", "long long int", "signed long long", "signed long long int", "int64", "int64_t"],
        "i8",
    ),
    **dict.fromkeys(["ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"], "u8"),
    "float": "f4",
    "double": "f8",
}
_SPACES = {
    "left-posterior-superior": (1, 1), "lps": (1, 1), "right-anterior-superior": (-1, -1), "ras": (-1, -1),
    "left-anterior-superior": (1, -1), "las": (1, -1),
}  # fmt: skip
_VECTOR = re.compile(r"\(([^()]*)\)")
_SAME_FIELD = {
    "datafile": "data file", "lineskip": "line skip", "byteskip": "byte skip", "oldmin": "old min", "oldmax": "old max",
}  # fmt: skip


def read_nrrd_header(path: Path, text: bytes, *, gzipped: bool) -> GridHeader:
    """Return the header of one file; raise ValueError or KeyError if it does not follow the format.

    Parameters
    ----------
    path
        The file.
    text
        First bytes of the file, decompressed.
    gzipped
        Whether gzip compresses the whole file.

    Raises
    ------
    ValueError, KeyError
        If the header does not follow the format.
    VolumeImportError
        See ``read_grid_header``.
    """
    fields, begin = _fields(path, text)
    detached = fields.get("data file")
    if begin is None and detached is None:
        raise HeaderValueError("end of the header", "an empty line", "no empty line")
    dimension = whole(fields["dimension"], "dimension")
    shape = wholes(fields["sizes"], "sizes field")
    if len(shape) != dimension:
        raise HeaderValueError("sizes field", f"{dimension} whole numbers", fields["sizes"])
    encoding = fields["encoding"].lower()
    kind = fields["type"].lower()
    if encoding in ("bzip2", "bz2"):
        problem = "its values are compressed with bzip2, which is not supported"
        raise refuse(path, problem, "save it again with gzip, or without compression", "import.not-supported")
    if encoding not in ("raw", "gzip", "gz") or kind not in _KINDS:
        found = (
            f"the type {shown_value(kind)}"
            if encoding in ("raw", "gzip", "gz")
            else f"the encoding {shown_value(encoding)}"
        )
        problem = f"it has {found}, which is not supported"
        raise refuse(path, problem, "save it again as 16-bit numbers, raw or gzip", "import.not-supported")
    compressed = encoding != "raw"
    data_path = path if detached is None else beside(path, detached)
    offset = 0 if detached is not None else (begin or 0)
    byte_skip = whole(fields.get("byte skip", "0"), "byte skip")
    gzipped = gzipped and detached is None
    # The position of values at the end of a compressed file is unknown before the file is decompressed.
    if gzipped and byte_skip == -1:
        problem = "it is compressed as a whole, and its header counts the data from the end of the file"
        raise refuse(path, problem, "unpack it with gunzip and open the result", "import.not-supported")
    if whole(fields.get("line skip", "0"), "line skip") != 0 or byte_skip < (0 if compressed else -1):
        problem = "its header skips lines of the data, or a number of bytes below 0, which is not supported"
        raise refuse(path, problem, "save it again without skips", "import.not-supported")
    axis_kinds = fields.get("kinds", "").lower().split()
    if dimension == 3 and "none" in fields.get("space directions", "").lower():
        listed = shown_value(", ".join(axis_kinds)) if axis_kinds else "kinds not given"
        problem = f"expected one volume with three axes, found two axes and a list ({listed})"
        raise refuse(path, problem, "save each volume as a separate file", "import.not-3d")
    return GridHeader(
        format="nrrd",
        shape_ijk=shape,
        num_components=1,
        dtype=np.dtype(_byte_order(path, fields, kind) + _KINDS[kind]),
        # The caller refuses other dimensions and names the sizes.
        lps_from_ijk=_transform(path, fields) if dimension == 3 else np.eye(4),
        data_path=data_path,
        # Bytes of compressed values are skipped after decompression.
        data_offset=byte_skip if compressed or byte_skip == -1 else offset + byte_skip,
        compression="gzip" if compressed or gzipped else None,
        stream_offset=offset if compressed or not gzipped else 0,
        values_are_elsewhere=detached is not None,
        file_is_gzipped=gzipped and compressed,
        head=text if begin is None else text[:begin],
    )


def _fields(path: Path, text: bytes) -> tuple[dict[str, str], int | None]:
    """Return the fields and the offset of the values; the offset is None if the file ends with the header."""
    fields: dict[str, str] = {}
    at = text.find(b"\n") + 1
    while at > 0 and at < len(text):
        line_end = text.find(b"\n", at)
        raw = text[at : line_end if line_end >= 0 else len(text)].rstrip(b"\r")
        at = line_end + 1
        if not raw:
            return fields, at if line_end >= 0 else None
        line = raw.decode("utf-8", errors="replace")
        name, _, value = line.partition(":")
        if line.startswith("#") or value.startswith("="):  # a comment, or a key defined by the writer
            continue
        name = name.strip().lower()
        take_once(path, fields, _SAME_FIELD.get(name, name), value.strip())
        if line_end < 0:
            break
    return fields, None


def _byte_order(path: Path, fields: dict[str, str], kind: str) -> str:
    order = {"little": "<", "big": ">"}.get(fields.get("endian", "").lower())
    if order is None:
        if _KINDS[kind].endswith("1"):
            return "<"
        problem = f"its endian field should be little or big; found {shown_value(fields.get('endian', ''))}"
        raise refuse(path, problem, "its byte order is unknown; export it again", "import.header")
    return order


def _vectors(text: str, name: str, count: int) -> list[list[float]]:
    """Return the vectors of a field such as ``(1,0,0) (0,1,0) (0,0,1)``."""
    found = _VECTOR.findall(text)
    if len(found) != count or _VECTOR.sub("", text).strip():
        expected = f"{count} vectors of three numbers" if count > 1 else "a vector of three numbers"
        raise HeaderValueError(name, expected, text)
    try:
        return [reals(" ".join(part.strip() or "?" for part in vector.split(",")), name, 3) for vector in found]
    except HeaderValueError:
        expected = f"{count} vectors of three numbers" if count > 1 else "a vector of three numbers"
        raise HeaderValueError(name, expected, text) from None


def _transform(path: Path, fields: dict[str, str]) -> NDArray[np.float64]:
    """Return the 4x4 transform from voxel centres to LPS mm."""
    space = fields.get("space", "").lower()
    if space not in _SPACES:
        problem = f"its space is {shown_value(space) if space else 'not given'}, so left and right are unknown"
        raise refuse(path, problem, AMBIGUOUS, "import.geometry.orientation-unknown")
    if "space directions" not in fields or "space origin" not in fields:
        missing = "space directions" if "space directions" not in fields else "space origin"
        raise refuse(path, f"it has no {missing}", AMBIGUOUS, "import.geometry.orientation-unknown")
    units = {unit for unit in fields.get("space units", "").replace('"', " ").split() if unit}
    if units - {"mm"}:
        problem = f"its unit is {shown_value(', '.join(sorted(units)))}, which is not supported"
        raise refuse(path, problem, "save it again in mm", "import.not-supported")
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(_vectors(fields["space directions"], "space directions field", 3)).T
    matrix[:3, 3] = _vectors(fields["space origin"], "space origin field", 1)[0]
    flip_x, flip_y = _SPACES[space]
    return np.diag([flip_x, flip_y, 1.0, 1.0]) @ matrix
