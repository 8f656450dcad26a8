"""Reader of VTI headers (VTK XML image data): geometry, and the place and coding of the values.

Source: VTK File Formats (Kitware), section *XML File Formats*. Tags are found in the bytes, without an XML parser,
because the file may contain gigabytes of binary data, which is not XML.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from carina.display.escaped_text import shown_value
from carina.volume.header_fields import GridHeader, HeaderValueError, reals, refuse, take_once, wholes
from carina.volume.model import Note

__all__ = ["VtiData", "read_vti_data", "read_vti_header"]

_KINDS = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
    "UInt64": "u8", "Float32": "f4", "Float64": "f8",
}  # fmt: skip
_TAG = re.compile(rb"<(/?)([A-Za-z][\w:.-]*)((?:\s+[\w:.-]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*)\s*(/?)>", re.DOTALL)
_ATTRIBUTE = re.compile(r"([\w:.-]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
_MAX_TAGS = 4096
_MAX_OTHER = 64
"""Maximum number of texts that begin like a tag and are none; each is searched once, which limits the time."""
_MAX_TAG_BYTES = 1 << 16
_MAX_HEAD_BYTES = 1 << 20
_AGAIN = "save it again, for example from ParaView"


@dataclass(frozen=True, slots=True)
class VtiData:
    """Position and encoding of the values in a VTI file."""

    coding: Literal["ascii", "base64", "raw"]
    begin: int
    """Offset in bytes of the first character or byte of the values."""
    end: int
    """Offset of the end of the values, or of the file if the values state their own length."""
    is_compressed: bool
    word: np.dtype[np.unsignedinteger]
    """Type of the numbers that precede the values."""


@dataclass(slots=True)
class _Tag:
    name: str
    attributes: dict[str, str]
    is_end: bool
    end: int


def read_vti_header(path: Path, content: mmap.mmap | bytes) -> GridHeader:
    """Return the header of a file; see :func:`read_vti_data` for its values.

    Raises
    ------
    ValueError, KeyError
        If the header does not follow the format.
    VolumeImportError
        ``import.not-supported``, ``import.not-3d``.
    """
    return _read(path, content)[0]


def read_vti_data(path: Path, content: mmap.mmap | bytes) -> VtiData:
    """Return the place and coding of the values of a file; raise the same errors as :func:`read_vti_header`."""
    return _read(path, content)[1]


def _read(path: Path, content: mmap.mmap | bytes) -> tuple[GridHeader, VtiData]:
    tags = _tags(path, content)
    file = _first(tags, "VTKFile")
    if file.attributes.get("type") != "ImageData":
        problem = f"it is a VTK file of the type {shown_value(file.attributes.get('type', ''))}, not an image"
        raise refuse(path, problem, "open the image volume (.vti)", "import.not-supported")
    image = _first(tags, "ImageData")
    pieces = [tag for tag in tags if tag.name == "Piece" and not tag.is_end]
    extent = wholes(image.attributes["WholeExtent"], "WholeExtent")
    if len(pieces) != 1 or wholes(pieces[0].attributes["Extent"], "Extent") != extent:
        problem = "its values are divided into several pieces, which is not supported"
        raise refuse(path, problem, "save it again as one piece", "import.not-supported")
    if len(extent) != 6:
        raise HeaderValueError("WholeExtent", "6 whole numbers", image.attributes["WholeExtent"])
    array, of_points = _values_tag(path, tags)
    if array.end > _MAX_HEAD_BYTES:
        raise refuse(path, "other arrays precede its image", "save the image alone", "import.not-supported")
    order = file.attributes.get("byte_order", "LittleEndian")
    if order not in ("LittleEndian", "BigEndian"):
        raise HeaderValueError("byte_order", "LittleEndian or BigEndian", order)
    sign = "<" if order == "LittleEndian" else ">"
    kind = array.attributes["type"]
    if kind not in _KINDS:
        problem = f"its values have the type {shown_value(kind)}, which is not supported"
        raise refuse(path, problem, "save it again as 16-bit numbers", "import.not-supported")
    lps_from_ijk, shape = _grid(image, extent, of_points=of_points)
    header = GridHeader(
        format="vti",
        shape_ijk=shape,
        num_components=int(array.attributes.get("NumberOfComponents") or 1),
        dtype=np.dtype(sign + _KINDS[kind]),
        lps_from_ijk=lps_from_ijk,
        data_path=path,
        data_offset=0,
        compression=None,
        head=bytes(content[: array.end]),
        notes=_notes(image),
    )
    return header, _data(path, content, array, tags, sign)


def _tags(path: Path, content: mmap.mmap | bytes) -> list[_Tag]:
    """Return the tags up to the appended data; a document type, which may define entities, is refused."""
    found: list[_Tag] = []
    at = 0
    for match in _matches(path, content):
        if len(found) > _MAX_TAGS:
            raise refuse(path, "it has too many or too long XML tags", _AGAIN, "import.header")
        attributes: dict[str, str] = {}
        for name, quoted, other in _ATTRIBUTE.findall(match[3].decode("utf-8", errors="replace")):
            take_once(path, attributes, name, quoted or other)
        tag = _Tag(match[2].decode(), attributes, bool(match[1]), match.end())
        found.append(tag)
        at = match.end()
        if tag.name == "AppendedData":
            break
    if b"<!DOCTYPE" in bytes(content[: min(at, 4096)]):
        raise refuse(path, "it has a document type declaration, which is not supported", _AGAIN, "import.header")
    return found


def _matches(path: Path, content: mmap.mmap | bytes) -> Iterator[re.Match[bytes]]:
    """Yield the tags, without those in comments, in a time that grows linearly with the size of the file."""
    at = others = 0
    while (at := content.find(b"<", at)) >= 0:
        if content[at : at + 4] == b"<!--":
            end = content.find(b"-->", at + 4)
            if end < 0:
                return
            at = end + 3
            continue
        match = _TAG.match(content, at, min(at + _MAX_TAG_BYTES, len(content)))
        if match is not None:
            yield match
            at = match.end()
            continue
        others += 1
        if others > _MAX_OTHER:
            raise refuse(path, "it has too many or too long XML tags", _AGAIN, "import.header")
        at += 1


def _first(tags: list[_Tag], name: str) -> _Tag:
    found = next((tag for tag in tags if tag.name == name and not tag.is_end), None)
    if found is None:
        raise KeyError(name)
    return found


def _values_tag(path: Path, tags: list[_Tag]) -> tuple[_Tag, bool]:
    """Return the tag of the values, and whether they belong to points (or to cells)."""
    for parent, of_points in (("PointData", True), ("CellData", False)):
        begin = next((n for n, tag in enumerate(tags) if tag.name == parent and not tag.is_end), None)
        if begin is None:
            continue
        arrays = []
        for tag in tags[begin + 1 :]:
            if tag.name == parent:
                break
            if tag.name == "DataArray" and not tag.is_end:
                arrays.append(tag)
        wanted = tags[begin].attributes.get("Scalars")
        named = [tag for tag in arrays if wanted and tag.attributes.get("Name") == wanted]
        found = (named or arrays)[:1]
        if found and (len(arrays) == 1 or named):
            return found[0], of_points
        if arrays:
            problem = f"it contains {len(arrays)} arrays of values, and does not state which one is the image"
            raise refuse(path, problem, "save the image alone", "import.not-3d")
    raise KeyError("DataArray")


def _grid(image: _Tag, extent: tuple[int, ...], *, of_points: bool) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return the transform from voxel centres to LPS mm, and the numbers of voxels."""
    origin = np.array(reals(image.attributes.get("Origin", "0 0 0"), "Origin", 3))
    spacing = np.array(reals(image.attributes["Spacing"], "Spacing", 3))
    if not (spacing > 0).all():  # also for NaN; a negative spacing would mirror the patient
        raise HeaderValueError("Spacing", "positive numbers in mm", image.attributes["Spacing"])
    turn = np.array(reals(image.attributes.get("Direction", "1 0 0 0 1 0 0 0 1"), "Direction", 9)).reshape(3, 3)
    if not (np.abs(np.linalg.norm(turn, axis=0) - 1.0) < 0.01).all():
        raise HeaderValueError("Direction", "directions of length 1", image.attributes["Direction"])
    first = np.array(extent[::2], dtype=np.float64) + (0.0 if of_points else 0.5)
    matrix = np.eye(4)
    matrix[:3, :3] = turn * spacing
    matrix[:3, 3] = origin + matrix[:3, :3] @ first
    points = 1 if of_points else 0
    return matrix, tuple(high - low + points for low, high in zip(extent[::2], extent[1::2], strict=True))


def _notes(image: _Tag) -> tuple[Note, ...]:
    stated = "" if "Direction" in image.attributes else " and no directions of its axes"
    words = (
        f"a VTI file states no patient axes{stated}; its coordinates are assumed to point left, posterior and superior"
    )
    return (Note("import.orientation-doubted", words, badge=True),)


def _data(path: Path, content: mmap.mmap | bytes, array: _Tag, tags: list[_Tag], sign: str) -> VtiData:
    file = _first(tags, "VTKFile")
    compressor = file.attributes.get("compressor", "")
    if compressor not in ("", "vtkZLibDataCompressor"):
        problem = f"its values are compressed by {shown_value(compressor)}, which is not supported"
        raise refuse(path, problem, "save it again with zlib or without compression", "import.not-supported")
    word_name = file.attributes.get("header_type", "UInt32")
    if word_name not in ("UInt32", "UInt64"):
        raise HeaderValueError("header_type", "UInt32 or UInt64", word_name)
    word = np.dtype(f"{sign}u{4 if word_name == 'UInt32' else 8}")
    form = array.attributes.get("format", "ascii")
    if form == "appended":
        appended = _first(tags, "AppendedData")
        mark = bytes(content[appended.end : appended.end + 256]).find(b"_")
        if mark < 0:
            raise KeyError("_")
        (offset,) = wholes(array.attributes["offset"], "offset")
        if offset < 0:
            raise HeaderValueError("offset", "a number of bytes", array.attributes["offset"])
        begin = appended.end + mark + 1 + offset
        coding: Literal["base64", "raw"] = "raw" if appended.attributes.get("encoding") == "raw" else "base64"
        return VtiData(coding, begin, len(content), bool(compressor), word)
    if form not in ("ascii", "binary"):
        raise HeaderValueError("format", "ascii, binary or appended", form)
    closing = next((tag for tag in tags if tag.end > array.end), None)
    if closing is None:
        raise KeyError("/DataArray")
    end = closing.end - len(f"</{closing.name}>")
    if form == "ascii":
        return VtiData("ascii", array.end, end, False, word)
    return VtiData("base64", array.end, end, bool(compressor), word)
