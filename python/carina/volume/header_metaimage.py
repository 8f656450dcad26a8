"""Reader of MetaImage headers (MetaIO's documentation), with the values in the same file or in a second one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.display.escaped_text import shown_value
from carina.volume.header_fields import (
    GridHeader,
    HeaderValueError,
    beside,
    real,
    reals,
    refuse,
    take_once,
    whole,
    wholes,
)
from carina.volume.model import Note

_KINDS = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4", "MET_UINT": "u4",
    "MET_LONG": "i4", "MET_ULONG": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}  # fmt: skip
_TRUTH = {"true": True, "t": True, "1": True, "false": False, "f": False, "0": False}
_TURNS = ("TransformMatrix", "Rotation", "Orientation")
_ORIGINS = ("Offset", "Position", "Origin")
_FROM_LETTERS = ("RL", "AP", "IS")  # AnatomicalOrientation names the side from which an axis runs


def read_metaimage_header(path: Path, text: bytes, *, gzipped: bool) -> GridHeader:
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
    fields, at = _fields(path, text)
    num_axes = whole(_required_field(fields, "NDims"), "NDims")
    shape = wholes(_required_field(fields, "DimSize"), "DimSize")
    if len(shape) != num_axes:
        raise HeaderValueError("DimSize", f"{num_axes} whole numbers", fields["dimsize"])
    kind = _required_field(fields, "ElementType").upper()
    if kind not in _KINDS:
        problem = f"it has the type {shown_value(kind)}, which is not supported"
        raise refuse(path, problem, "save it again as 16-bit numbers", "import.not-supported")
    if not _boolean_field(fields, "BinaryData", default=True):
        problem = "its values are written as text, which is not supported"
        raise refuse(path, problem, "save it again in binary", "import.not-supported")
    _refuse_what_others_ignore(path, fields)

    data_name = fields["elementdatafile"]
    local = data_name.upper() == "LOCAL"
    data_path = path if local else beside(path, data_name)
    gzipped = gzipped and local
    begin = at if local else 0
    compressed = _boolean_field(fields, "CompressedData", default=False)
    packed_bytes = whole(fields.get("compresseddatasize", "0"), "CompressedDataSize")
    stored_bytes = data_path.stat().st_size - begin
    if compressed and not gzipped and packed_bytes not in (0, stored_bytes):
        raise HeaderValueError("CompressedDataSize", f"{stored_bytes} (the bytes in the file)", str(packed_bytes))
    header_size = whole(fields.get("headersize", "0"), "HeaderSize")
    if header_size == -1 and gzipped:
        problem = "it is compressed as a whole, and its header counts the data from the end of the file"
        raise refuse(path, problem, "unpack it with gunzip and open the result", "import.not-supported")
    if header_size < -1 or (header_size != 0 and compressed) or (header_size > 0 and local):
        # With LOCAL, programs count HeaderSize from different positions.
        raise HeaderValueError("HeaderSize", "0 (or -1 for uncompressed data)", str(header_size))
    lps_from_ijk = _transform(path, fields, num_axes)
    return GridHeader(
        format="metaimage",
        shape_ijk=shape,
        num_components=whole(fields.get("elementnumberofchannels", "1"), "ElementNumberOfChannels"),
        dtype=np.dtype(_byte_order(path, fields) + _KINDS[kind]),
        lps_from_ijk=lps_from_ijk,
        data_path=data_path,
        data_offset=0 if compressed else (-1 if header_size == -1 else begin + header_size),
        compression="zlib" if compressed else "gzip" if gzipped else None,
        stream_offset=begin if compressed or not gzipped else 0,
        values_are_elsewhere=not local,
        file_is_gzipped=gzipped and compressed,
        head=text[:at],
        notes=_notes(fields, lps_from_ijk),
    )


def _required_field(fields: dict[str, str], name: str) -> str:
    """Return the value of a required field; the KeyError for a missing field contains the format's spelling."""
    try:
        return fields[name.lower()]
    except KeyError:
        raise KeyError(name) from None


def _fields(path: Path, text: bytes) -> tuple[dict[str, str], int]:
    """Return the fields up to ElementDataFile, and the offset of the end of the header's text."""
    fields: dict[str, str] = {}
    at = 0
    while True:
        line_end = text.find(b"\n", at)
        line = text[at : line_end if line_end >= 0 else len(text)].decode("ascii", errors="replace")
        at = line_end + 1
        name, equals, value = line.partition("=")
        name = name.strip().lower()
        if "ndims" not in fields and name in ("dimsize", "elementspacing", "elementsize"):
            # The length of lists must be known before they are read.
            raise HeaderValueError("first list of numbers", "behind NDims", f"{name} before NDims")
        if equals and name != "comment":
            take_once(path, fields, name, value.strip())
        if name == "elementdatafile":
            return fields, at
        if line_end < 0:
            raise KeyError("ElementDataFile")


def _agreeing_numbers(path: Path, fields: dict[str, str], names: tuple[str, ...], default: list[float]) -> list[float]:
    """Return the numbers of the fields of one meaning; refuse a header in which two of them differ."""
    given = {name: reals(fields[name.lower()], name, len(default)) for name in names if name.lower() in fields}
    if len({tuple(numbers) for numbers in given.values()}) > 1:
        problem = f"its {' and '.join(given)} contradict each other"
        way_out = "programs differ in which one they use; export it again"
        raise refuse(path, problem, way_out, "import.geometry.ambiguous")
    return next(iter(given.values()), default)


def _boolean_field(fields: dict[str, str], name: str, *, default: bool) -> bool:
    text = fields.get(name.lower())
    if text is None:
        return default
    if text.lower() not in _TRUTH:
        raise HeaderValueError(name, "True or False", text)
    return _TRUTH[text.lower()]


def _byte_order(path: Path, fields: dict[str, str]) -> str:
    names = ("BinaryDataByteOrderMSB", "ElementByteOrderMSB")
    stated = {_boolean_field(fields, name, default=False) for name in names if name.lower() in fields}
    if len(stated) > 1:
        problem = "its BinaryDataByteOrderMSB and its ElementByteOrderMSB contradict each other"
        raise refuse(path, problem, "its byte order is unknown; export it again", "import.header")
    return ">" if stated == {True} else "<"


def _refuse_what_others_ignore(path: Path, fields: dict[str, str]) -> None:
    """Refuse scaling and units that some programs apply and others ignore, because the right values are unknown."""
    slope = real(fields.get("elementtointensityfunctionslope", "1"), "ElementToIntensityFunctionSlope")
    shift = real(fields.get("elementtointensityfunctionoffset", "0"), "ElementToIntensityFunctionOffset")
    if (slope, shift) != (1.0, 0.0):
        problem = f"its header scales its values by {slope:g} and shifts them by {shift:g}, which is not supported"
        raise refuse(path, problem, "save it again with its final values", "import.not-supported")
    unit = fields.get("distanceunits", "mm").lower()
    if unit not in ("mm", "?", ""):
        problem = f"its unit is {shown_value(unit)}, which is not supported"
        raise refuse(path, problem, "save it again in mm", "import.not-supported")


def _notes(fields: dict[str, str], lps_from_ijk: NDArray[np.float64]) -> tuple[Note, ...]:
    """Return notes on missing values that the format replaces by defaults, and on contradicting values."""
    notes = []
    if not any(name.lower() in fields for name in _TURNS):
        words = "its header does not state where its axes point; they are assumed to point left, posterior and superior"
        notes.append(Note("import.orientation-doubted", words, badge=True))
    else:
        letters = fields.get("anatomicalorientation", "").upper()
        directions = lps_from_ijk[:3, :3] / np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
        for letter, column in zip(letters, directions.T, strict=False):
            axis = int(np.argmax(np.abs(column)))
            expected = _FROM_LETTERS[axis][0 if column[axis] > 0 else 1]
            if abs(column[axis]) > 0.8 and letter in "RLAPIS" and letter != expected:
                words = (
                    f"its AnatomicalOrientation ({letters[:8]}) contradicts its TransformMatrix; the matrix was used"
                )
                notes.append(Note("import.orientation-doubted", words, badge=True))
                break
    if not any(name.lower() in fields for name in _ORIGINS):
        words = (
            "its header does not state the position of its first voxel; segmentations and points "
            "from other programs may not match"
        )
        notes.append(Note("import.position-missing", words))
    return tuple(notes)


def _transform(path: Path, fields: dict[str, str], num_axes: int) -> NDArray[np.float64]:
    """Return the 4x4 transform from voxel centres to LPS mm."""
    name = "ElementSpacing" if "elementspacing" in fields else "ElementSize"
    if name.lower() not in fields:
        raise refuse(path, "it has no ElementSpacing", "export it again with its spacing", "import.geometry.spacing")
    spacing = reals(fields[name.lower()], name, num_axes)
    if not all(distance > 0 for distance in spacing):  # also for NaN; a negative spacing would mirror the patient
        problem = f"its {name} should be positive numbers in mm; found {shown_value(fields[name.lower()])}"
        raise refuse(path, problem, "export it again with its spacing", "import.geometry.spacing")
    matrix = np.eye(4)
    if num_axes != 3:
        return matrix
    # Each row of three numbers is the direction of one axis; the world is LPS.
    turn = _agreeing_numbers(path, fields, _TURNS, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    origin = _agreeing_numbers(path, fields, _ORIGINS, [0.0, 0.0, 0.0])
    directions = np.array(turn).reshape(3, 3)
    lengths = np.linalg.norm(directions, axis=1)
    if not (np.abs(lengths - 1.0) < 0.01).all():  # programs that write three digits cause deviations of 0.001
        found = ", ".join(f"{length:g}" for length in lengths)
        problem = f"the directions in its TransformMatrix should have length 1; found {found}"
        raise refuse(path, problem, "export it again, with its spacing in ElementSpacing", "import.geometry.ambiguous")
    matrix[:3, :3] = directions.T * spacing
    matrix[:3, 3] = origin
    return matrix
