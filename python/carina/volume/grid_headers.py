"""What the header of a NIfTI, NRRD or MetaImage file claims, read by ourselves before a library takes memory for it.

This second reading has two uses: a lying header is refused while it is still only text, and the geometry that the
library finds later must agree with ours. Sources: nifti1.h and nifti2.h (NIfTI-1.1, NIfTI-2), the NRRD format
definition (teem), MetaIO's documentation.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.errors import VolumeImportError

__all__ = ["GridHeader", "read_grid_header", "sniff_format"]

_MAX_TEXT_HEADER_BYTES = 1 << 20
_RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
_AMBIGUOUS = "save it again with its orientation, for example from 3D Slicer, or open the DICOM series"


@dataclass(frozen=True, slots=True)
class GridHeader:
    """A file's claim about its grid."""

    format: str
    """``nifti``, ``nrrd`` or ``metaimage``."""
    shape_ijk: tuple[int, ...]
    num_components: int
    bytes_per_value: int
    lps_from_ijk: NDArray[np.float64]
    data_path: Path
    data_offset: int
    """Where the values begin, after decompression; -1: they are the file's last bytes."""
    compression: str | None
    """``gzip`` (the whole file or the stream at the offset), ``zlib``, ``bzip2`` or None."""
    stream_offset: int = 0
    """Where the compressed stream begins in the file."""

    @property
    def num_bytes(self) -> int:
        """Bytes that the values must have."""
        count = self.num_components * self.bytes_per_value
        for n in self.shape_ijk:
            count *= n
        return count


def _refuse(path: Path, problem: str, way_out: str, code: str) -> VolumeImportError:
    return VolumeImportError(f"reading {path.name}: {problem}; {way_out}", code=code)


def _head(path: Path, num_bytes: int) -> bytes:
    with path.open("rb") as file:
        raw = file.read(num_bytes)
    if raw[:2] != b"\x1f\x8b":
        return raw
    inflater = zlib.decompressobj(zlib.MAX_WBITS | 16)
    head = b""
    try:
        # In small pieces: where the stream is damaged further on, its beginning still says what it is.
        for at in range(0, len(raw), 64):
            head += inflater.decompress(raw[at : at + 64], num_bytes)
            if len(head) >= num_bytes:
                break
    except zlib.error:
        pass
    return head[:num_bytes]


def sniff_format(path: Path) -> str | None:
    """``nifti``, ``nrrd``, ``metaimage``, ``pdf``, ``zip`` or None, from the first bytes and never from the name."""
    head = _head(path, 4096)
    if head[:4] == b"NRRD":
        return "nrrd"
    if head[:4] == b"%PDF":
        return "pdf"
    if head[:4] == b"PK\x03\x04":
        return "zip"
    if head[:4] in (struct.pack("<i", 348), struct.pack(">i", 348), struct.pack("<i", 540), struct.pack(">i", 540)):
        return "nifti"
    if b"ElementDataFile" in head or head.lstrip()[:10] in (b"ObjectType", b"NDims = 3\n"):
        return "metaimage"
    return None


def read_grid_header(path: Path, format: str) -> GridHeader:  # noqa: A002 - the word of the field
    """Read and check the header of one file.

    Raises
    ------
    VolumeImportError
        ``import.header`` (does not follow the format), ``import.not-3d``, ``import.geometry.spacing``, ``.sheared``,
        ``.orientation-unknown``, ``.ambiguous`` or ``import.unsupported``.
    """
    reader = {"nifti": _nifti, "nrrd": _nrrd, "metaimage": _metaimage}[format]
    try:
        header = reader(path)
    except (ValueError, IndexError, KeyError, struct.error, UnicodeError, OverflowError) as error:
        problem = f"its {format} header does not follow the format ({type(error).__name__})"
        raise _refuse(
            path, problem, "the file is damaged or of another kind; export it again", "import.header"
        ) from None
    _check(path, header)
    return header


def _check(path: Path, header: GridHeader) -> None:
    if len(header.shape_ijk) != 3 or header.num_components != 1:
        sizes = " x ".join(str(n) for n in header.shape_ijk)
        values = f" with {header.num_components} values in each voxel" if header.num_components != 1 else ""
        problem = f"expected one volume of three axes, found {sizes}{values}"
        raise _refuse(path, problem, "save one single volume of it in its own file", "import.not-3d")
    if min(header.shape_ijk) < 1:
        problem = f"its header claims {header.shape_ijk} voxels; every axis needs at least one"
        raise _refuse(path, problem, "the file is damaged; export it again", "import.header")
    if min(header.shape_ijk) < 2:
        problem = (
            f"it is a single image of {' x '.join(str(n) for n in header.shape_ijk)} voxels; expected a stack of slices"
        )
        raise _refuse(path, problem, "open the whole scan", "import.single-slice")
    columns = header.lps_from_ijk[:3, :3]
    spacing = np.linalg.norm(columns, axis=0) if np.isfinite(header.lps_from_ijk).all() else np.array([np.nan])
    # 1 m: no voxel of a patient is that large; 1 nm: smaller is a lost unit.
    if not np.isfinite(spacing).all() or spacing.min() < 1e-6 or spacing.max() > 1000:
        problem = f"its voxel spacing should be a positive number of mm; found {', '.join(f'{s:g}' for s in spacing)}"
        raise _refuse(path, problem, "export it again with its spacing", "import.geometry.spacing")
    cosines = (columns / spacing).T @ (columns / spacing)
    skew_deg = float(np.degrees(np.arcsin(min(1.0, np.abs(cosines - np.eye(3)).max()))))
    if skew_deg > 0.2:  # as for the tilt of a DICOM series
        problem = (
            f"its axes are sheared: they stand {90 - skew_deg:.1f} instead of 90 degrees to each other (an "
            "uncorrected gantry tilt?)"
        )
        raise _refuse(path, problem, "resample it to a straight grid first", "import.geometry.sheared")


# --- NIfTI ------------------------------------------------------------------------------------------------------------

_NIFTI_BYTES = {2: 1, 4: 2, 8: 4, 16: 4, 64: 8, 256: 1, 512: 2, 768: 4, 1024: 8, 1280: 8}


def _nifti(path: Path) -> GridHeader:
    head = _head(path, 1024)
    for order in "<>":
        version = {348: 1, 540: 2}.get(struct.unpack_from(f"{order}i", head)[0])
        if version is not None:
            break
    else:
        raise ValueError
    if version == 1:
        magic = head[344:348]
        dim = struct.unpack_from(f"{order}8h", head, 40)
        (datatype,) = struct.unpack_from(f"{order}h", head, 70)
        pixdim = struct.unpack_from(f"{order}8f", head, 76)
        (offset,) = struct.unpack_from(f"{order}f", head, 108)
        units = head[123]
        qform, sform = struct.unpack_from(f"{order}2h", head, 252)
        quaternion = struct.unpack_from(f"{order}6f", head, 256)
        rows = struct.unpack_from(f"{order}12f", head, 280)
    else:
        magic = head[4:8]
        (datatype,) = struct.unpack_from(f"{order}h", head, 12)
        dim = struct.unpack_from(f"{order}8q", head, 16)
        pixdim = struct.unpack_from(f"{order}8d", head, 104)
        (offset,) = struct.unpack_from(f"{order}q", head, 168)
        qform, sform = struct.unpack_from(f"{order}2i", head, 344)
        quaternion = struct.unpack_from(f"{order}6d", head, 352)
        rows = struct.unpack_from(f"{order}12d", head, 400)
        (units,) = struct.unpack_from(f"{order}i", head, 500)
    if magic[:3] not in (b"n+1", b"ni1", b"n+2", b"ni2"):
        problem = "it is an Analyze 7.5 file, which does not say where left and right are"
        raise _refuse(path, problem, _AMBIGUOUS, "import.geometry.orientation-unknown")
    if not 1 <= dim[0] <= 7:
        raise ValueError
    shape = dim[1 : dim[0] + 1]
    while len(shape) > 3 and shape[-1] == 1:  # trailing axes of one entry are written by many programs
        shape = shape[:-1]
    if datatype not in _NIFTI_BYTES:
        kind = {128: "colour", 2304: "colour", 32: "complex", 1792: "complex"}.get(datatype, f"of the type {datatype}")
        problem = f"its values are {kind}; expected whole or real numbers"
        raise _refuse(path, problem, "export it again as 16-bit numbers", "import.unsupported")

    scale = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 0.001}.get(units & 7)
    if scale is None:
        raise ValueError
    unit_scale = np.diag([scale, scale, scale, 1.0])
    forms = []
    if sform > 0:
        forms.append(np.vstack([np.reshape(rows, (3, 4)), [0, 0, 0, 1]]).astype(np.float64))
    if qform > 0:
        forms.append(_nifti_qform(pixdim, quaternion))
    if not forms:
        problem = "neither its qform nor its sform is set, so it does not say where left and right are"
        raise _refuse(path, problem, _AMBIGUOUS, "import.geometry.orientation-unknown")
    lps = [_RAS_TO_LPS @ unit_scale @ form for form in forms]
    if len(lps) == 2 and len(shape) == 3 and np.isfinite(lps[0]).all() and np.isfinite(lps[1]).all():
        # The sheared kind is named below; here both are straight grids in different places.
        corners = np.array([[i, j, k, 1.0] for i in (0, shape[0]) for j in (0, shape[1]) for k in (0, shape[2])])
        apart = np.linalg.norm(corners @ (lps[0] - lps[1]).T, axis=1).max()
        smallest = np.linalg.norm(lps[1][:3, :3], axis=0).min()
        if apart > 0.1 * smallest and _is_straight(lps[0]):
            problem = f"its qform and sform disagree by up to {apart:.2f} mm about where the voxels are"
            raise _refuse(path, problem, "save it again with one of them", "import.geometry.ambiguous")

    with path.open("rb") as file:
        gzipped = file.read(2) == b"\x1f\x8b"
    data_path = path
    if magic[:2] == b"ni":
        stem = path.with_suffix("") if gzipped else path
        siblings = [stem.with_suffix(".img"), stem.with_suffix(".img.gz")]
        data_path = next((candidate for candidate in siblings if candidate.is_file()), siblings[0])
        if not data_path.is_file():
            problem = f"its values should be in {data_path.name} beside it, which is missing"
            raise _refuse(path, problem, "put both files into one folder", "import.not-found")
        gzipped = data_path.suffix == ".gz"
    elif offset < (352 if version == 1 else 544) and offset != 0:
        raise ValueError
    return GridHeader(
        format="nifti",
        shape_ijk=tuple(int(n) for n in shape),
        num_components=1,
        bytes_per_value=_NIFTI_BYTES[datatype],
        lps_from_ijk=lps[0],
        data_path=data_path,
        data_offset=max(0, int(offset)),
        compression="gzip" if gzipped else None,
    )


def _is_straight(lps_from_ijk: NDArray[np.float64]) -> bool:
    columns = lps_from_ijk[:3, :3]
    lengths = np.linalg.norm(columns, axis=0)
    if lengths.min() == 0:
        return False
    return bool(np.abs((columns / lengths).T @ (columns / lengths) - np.eye(3)).max() < 3.5e-3)  # sin 0.2 degrees


def _nifti_qform(pixdim: tuple[float, ...], quaternion: tuple[float, ...]) -> NDArray[np.float64]:
    b, c, d, *offsets = quaternion
    squared = 1.0 - (b * b + c * c + d * d)
    if not np.isfinite([b, c, d, *offsets]).all() or squared < -1e-3:
        raise ValueError
    a = np.sqrt(max(0.0, squared))
    if squared < 1e-7:  # nifti1.h: a half turn, where rounding may leave the vector a little too long
        b, c, d = np.array([b, c, d]) / np.linalg.norm([b, c, d])
        a = 0.0
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    handedness = -1.0 if pixdim[0] < 0 else 1.0
    form = np.eye(4)
    form[:3, :3] = rotation * [pixdim[1], pixdim[2], pixdim[3] * handedness]
    form[:3, 3] = offsets
    return form


# --- NRRD -------------------------------------------------------------------------------------------------------------

_NRRD_BYTES = {
    **dict.fromkeys(["signed char", "int8", "int8_t", "uchar", "unsigned char", "uint8", "uint8_t"], 1),
    **dict.fromkeys(["short", "short int", "signed short", "signed short int", "int16", "int16_t"], 2),
    **dict.fromkeys(["ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"], 2),
    **dict.fromkeys(
        ["int", "signed int", "int32", "int32_t", "uint", "unsigned int", "uint32", "uint32_t", "float"], 4
    ),
    **dict.fromkeys(["longlong", "long long", "long long int", "signed long long", "int64", "int64_t", "double"], 8),
    **dict.fromkeys(["ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"], 8),
}
_NRRD_SPACES = {
    "left-posterior-superior": (1, 1), "lps": (1, 1), "right-anterior-superior": (-1, -1), "ras": (-1, -1),
    "left-anterior-superior": (1, -1), "las": (1, -1),
}  # fmt: skip


def _nrrd(path: Path) -> GridHeader:
    with path.open("rb") as file:
        text = file.read(_MAX_TEXT_HEADER_BYTES)
    end = text.find(b"\n\n")
    end_crlf = text.find(b"\r\n\r\n")
    begin = end + 2 if end >= 0 else len(text)
    if end_crlf >= 0 and (end < 0 or end_crlf < end):
        end, begin = end_crlf, end_crlf + 4
    fields: dict[str, str] = {}
    for line in (text if end < 0 else text[:end]).decode("utf-8", errors="replace").splitlines()[1:]:
        if line.startswith("#") or ":=" in line:
            continue
        name, _, value = line.partition(":")
        fields[name.strip().lower()] = value.strip()
    detached = fields.get("data file", fields.get("datafile"))
    if end < 0 and detached is None:
        raise ValueError

    dimension = int(fields["dimension"])
    shape = tuple(int(n) for n in fields["sizes"].split())
    if len(shape) != dimension:
        raise ValueError
    encoding = fields.get("encoding", "raw").lower()
    compression = {"raw": None, "gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2"}.get(encoding, "?")
    kind = fields["type"].lower()
    if compression == "?" or kind not in _NRRD_BYTES:
        found = f"the encoding {encoding}" if compression == "?" else f"the type {kind}"
        raise _refuse(path, f"it has {found}", "save it again as raw or gzip 16-bit numbers", "import.unsupported")
    # Another dimension is refused by the caller, with its sizes.
    lps_from_ijk = _nrrd_transform(path, fields) if dimension == 3 else np.eye(4)

    data_path, offset = path, begin
    if detached is not None:
        data_path = _beside(path, detached)
        offset = 0
    byte_skip = int(fields.get("byte skip", fields.get("byteskip", "0")))
    if int(fields.get("line skip", fields.get("lineskip", "0"))) != 0 or (byte_skip != 0 and compression is not None):
        raise _refuse(path, "it skips lines or bytes of its data", "save it again without skips", "import.unsupported")
    return GridHeader(
        format="nrrd",
        shape_ijk=shape,
        num_components=1,
        bytes_per_value=_NRRD_BYTES[kind],
        lps_from_ijk=lps_from_ijk,
        data_path=data_path,
        data_offset=0 if compression else (-1 if byte_skip == -1 else offset + byte_skip),
        compression=compression,
        stream_offset=offset,
    )


def _nrrd_vector(text: str) -> list[float]:
    text = text.strip()
    if not (text.startswith("(") and text.endswith(")")):
        raise ValueError
    numbers = [float(number) for number in text[1:-1].split(",")]
    if len(numbers) != 3:
        raise ValueError
    return numbers


def _nrrd_transform(path: Path, fields: dict[str, str]) -> NDArray[np.float64]:
    space = fields.get("space", "").lower()
    if space not in _NRRD_SPACES:
        problem = (
            f"it {'names the space ' + space if space else 'names no space'}, so it does not say where left and right "
            "are"
        )
        raise _refuse(path, problem, _AMBIGUOUS, "import.geometry.orientation-unknown")
    if "space directions" not in fields or "space origin" not in fields:
        missing = "space directions" if "space directions" not in fields else "space origin"
        raise _refuse(path, f"it has no {missing}", _AMBIGUOUS, "import.geometry.orientation-unknown")
    units = {unit for unit in fields.get("space units", "").replace('"', " ").split() if unit}
    if units - {"mm"}:
        raise _refuse(path, f"its unit is {', '.join(sorted(units))}", "save it again in mm", "import.unsupported")
    directions = fields["space directions"].replace(") (", ")|(").replace(")(", ")|(").split("|")
    if len(directions) != 3:
        raise ValueError
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([_nrrd_vector(direction) for direction in directions]).T
    matrix[:3, 3] = _nrrd_vector(fields["space origin"])
    flip_x, flip_y = _NRRD_SPACES[space]
    return np.diag([flip_x, flip_y, 1.0, 1.0]) @ matrix


def _beside(path: Path, name: str) -> Path:
    """The data file that a detached header names; only a plain file in the same folder is followed."""
    simple = name.strip()
    if simple.upper().startswith("LIST") or "%" in simple:
        raise _refuse(path, "its values are spread over many files", "save it again as one file", "import.unsupported")
    if not simple or simple != Path(simple).name or "\\" in simple or simple in (".", ".."):
        raise _refuse(path, "its values are in another folder", "put both files into one folder", "import.unsupported")
    found = path.parent / simple
    if not found.is_file():
        problem = f"its values should be in {simple} beside it, which is missing"
        raise _refuse(path, problem, "put both files into one folder", "import.not-found")
    return found


# --- MetaImage --------------------------------------------------------------------------------------------------------

_MET_BYTES = {
    "MET_CHAR": 1, "MET_UCHAR": 1, "MET_SHORT": 2, "MET_USHORT": 2, "MET_INT": 4, "MET_UINT": 4, "MET_LONG": 4,
    "MET_ULONG": 4, "MET_LONG_LONG": 8, "MET_ULONG_LONG": 8, "MET_FLOAT": 4, "MET_DOUBLE": 8,
}  # fmt: skip


def _metaimage(path: Path) -> GridHeader:
    with path.open("rb") as file:
        text = file.read(_MAX_TEXT_HEADER_BYTES)
    fields: dict[str, str] = {}
    at = 0
    while True:
        line_end = text.find(b"\n", at)
        line = text[at : line_end if line_end >= 0 else len(text)].decode("ascii", errors="replace")
        at = line_end + 1
        name, equals, value = line.partition("=")
        if "ndims" not in fields and name.strip().lower() in ("dimsize", "elementspacing", "elementsize"):
            raise ValueError  # lists cannot be read before their length is known
        if equals:
            fields[name.strip().lower()] = value.strip()
        if name.strip().lower() == "elementdatafile":
            break
        if line_end < 0:
            raise ValueError

    num_axes = int(fields["ndims"])
    shape = tuple(int(n) for n in fields["dimsize"].split())
    if len(shape) != num_axes:
        raise ValueError
    kind = fields["elementtype"].upper()
    if kind not in _MET_BYTES:
        raise _refuse(path, f"it has the type {kind}", "save it again as 16-bit numbers", "import.unsupported")
    if fields.get("binarydata", "True").lower() not in ("true", "1", "t"):
        raise _refuse(path, "its values are written as text", "save it again in binary", "import.unsupported")
    spacing = [float(v) for v in fields.get("elementspacing", fields.get("elementsize", "")).split()]
    if len(spacing) != num_axes:
        raise _refuse(path, "it gives no ElementSpacing", "export it again with its spacing", "import.geometry.spacing")
    if not all(distance > 0 for distance in spacing):  # also for NaN; a negative one would mirror the patient
        problem = f"its ElementSpacing should be positive numbers of mm; found {fields.get('elementspacing')}"
        raise _refuse(path, problem, "export it again with its spacing", "import.geometry.spacing")
    matrix = np.eye(4)
    if num_axes == 3:
        # Each row of three numbers is the direction of one axis; the world is LPS.
        turn = next(
            (fields[name] for name in ("transformmatrix", "rotation", "orientation") if name in fields),
            "1 0 0 0 1 0 0 0 1",
        )
        origin = next((fields[name] for name in ("offset", "position", "origin") if name in fields), "0 0 0")
        matrix[:3, :3] = np.array([float(v) for v in turn.split()]).reshape(3, 3).T * spacing
        matrix[:3, 3] = [float(v) for v in origin.split()]

    data_name = fields["elementdatafile"]
    local = data_name.upper() == "LOCAL"
    data_path = path if local else _beside(path, data_name)
    begin = at if local else 0
    compressed = fields.get("compresseddata", "False").lower() in ("true", "1", "t")
    packed_bytes = int(fields.get("compresseddatasize", "0"))
    if compressed and packed_bytes not in (0, data_path.stat().st_size - begin):
        raise ValueError
    header_size = int(fields.get("headersize", "0"))
    if header_size < -1 or (header_size != 0 and compressed):
        raise ValueError
    return GridHeader(
        format="metaimage",
        shape_ijk=shape,
        num_components=int(fields.get("elementnumberofchannels", "1")),
        bytes_per_value=_MET_BYTES[kind],
        lps_from_ijk=matrix,
        data_path=data_path,
        data_offset=0 if compressed else (-1 if header_size == -1 else begin + header_size),
        compression="zlib" if compressed else None,
        stream_offset=begin,
    )
