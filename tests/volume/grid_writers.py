"""Writers of NIfTI, NRRD and MetaImage files byte by byte, so that a test can change one value of a header."""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk

__all__ = ["AIR", "FORMS", "LPS_FROM_IJK", "SHAPE_ZYX", "bgzip", "chest", "metaimage", "nifti", "nifti_bytes", "nrrd"]

SHAPE_ZYX = (12, 20, 24)
AIR = 3
"""Number of air voxels around the body on each side of a slice."""
SPACING_MM = (0.7, 0.9, 1.25)
"""Spacing along i, j and k, mm; all differ, so that a test with exchanged axes fails."""
DIRECTIONS = np.reshape((0.8, -0.36, -0.48, 0.6, 0.48, 0.64, 0.0, -0.8, 0.6), (3, 3))
"""Directions of the axes in columns, LPS; they are oblique, so that a test with exchanged signs fails."""
LPS_FROM_IJK = np.eye(4)
LPS_FROM_IJK[:3, :3] = DIRECTIONS * SPACING_MM
LPS_FROM_IJK[:3, 3] = (-31.5, 12.25, 140.0)
_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
_NIFTI_KINDS = {"u1": 2, "i2": 4, "i4": 8, "f4": 16, "f8": 64, "i1": 256, "u2": 512, "u4": 768, "i8": 1024, "u8": 1280}
_NRRD_KINDS = {"i2": "short", "u2": "ushort", "i4": "int", "i8": "int64", "f4": "float", "f8": "double"}
_MET_KINDS = {"i2": "SHORT", "u2": "USHORT", "i4": "INT", "i8": "LONG_LONG", "f4": "FLOAT", "f8": "DOUBLE"}


def chest() -> np.ndarray:
    """Return HU [z, y, x] of a box of tissue in air, with two lungs and some bone; rows and slices differ."""
    values = np.full(SHAPE_ZYX, -1000, dtype=np.int16)
    inner = values[:, AIR:-AIR, AIR:-AIR]
    inner[...] = np.arange(inner.size).reshape(inner.shape) % 97 - 20
    for left in (6, 13):
        values[2:-2, 6:-6, left : left + 5] = -860
    values[:, 4, 8:12] = 1200
    return values


def bgzip(data: bytes, piece: int = 700) -> bytes:
    """Return the data compressed as several gzip members of ``piece`` bytes each."""
    return b"".join(gzip.compress(data[at : at + piece]) for at in range(0, len(data), piece))


def _order(values: np.ndarray) -> str:
    return ">" if values.dtype.str.startswith(">") else "<"


def nifti_bytes(
    values: np.ndarray,
    *,
    lps_from_ijk: np.ndarray = LPS_FROM_IJK,
    magic: bytes = b"n+1\0",
    offset: float = 352.0,
    scale: tuple[float, float] = (1.0, 0.0),
    units: int = 2,
    dim: Sequence[int] | None = None,
    forms: tuple[int, int] = (0, 1),
    qfac: float = 1.0,
    quaternion: Sequence[float] = (0, 0, 0),
    datatype: int | None = None,
    bits: int | None = None,
) -> tuple[bytes, bytes]:
    """Return the 348 bytes of a NIfTI header and the bytes of the values."""
    order, kind = _order(values), values.dtype.str[1:]
    ras = _RAS @ lps_from_ijk
    spacing = np.linalg.norm(ras[:3, :3], axis=0)
    shape = dim or values.shape[::-1]
    header = bytearray(348)
    struct.pack_into(f"{order}i", header, 0, 348)
    struct.pack_into(f"{order}8h", header, 40, len(shape), *shape, *([1] * (7 - len(shape))))
    known = _NIFTI_KINDS[kind] if datatype is None else datatype
    struct.pack_into(f"{order}2h", header, 70, known, bits or 8 * values.itemsize)
    struct.pack_into(f"{order}8f", header, 76, qfac, *spacing, 1, 1, 1, 1)
    struct.pack_into(f"{order}3f", header, 108, offset, *scale)
    header[123] = units
    struct.pack_into(f"{order}2h", header, 252, *forms)
    struct.pack_into(f"{order}6f", header, 256, *quaternion, *ras[:3, 3])
    struct.pack_into(f"{order}12f", header, 280, *ras[:3].ravel())
    header[344:348] = magic
    return bytes(header), values.tobytes()


def nifti(folder: Path, values: np.ndarray, *, behind: bytes = b"", name: str = "ct.nii", **options: Any) -> Path:
    """Write a NIfTI file in one piece, with zeros between header and values, and with ``behind`` after the values."""
    header, numbers = nifti_bytes(values, **options)
    gap = bytes(max(0, int(options.get("offset", 352)) - 348)) if np.isfinite(options.get("offset", 352)) else b""
    path = folder / name
    path.write_bytes(header + gap + numbers + behind)
    return path


def _nifti_packed(pack: Callable[[bytes], bytes]) -> Callable[[Path, np.ndarray], Path]:
    def write(folder: Path, values: np.ndarray) -> Path:
        plain = nifti(folder, values)
        path = folder / "ct.nii.gz"
        path.write_bytes(pack(plain.read_bytes()))
        plain.unlink()
        return path

    return write


def _nifti_pair(folder: Path, values: np.ndarray) -> Path:
    header, numbers = nifti_bytes(values, magic=b"ni1\0", offset=0)
    (folder / "ct.hdr").write_bytes(header)
    (folder / "ct.img").write_bytes(numbers)
    return folder / "ct.hdr"


def _itk_nifti(folder: Path, values: np.ndarray) -> Path:
    image = sitk.GetImageFromArray(values.astype(values.dtype.newbyteorder("=")))
    image.SetSpacing(SPACING_MM)
    image.SetDirection(DIRECTIONS.ravel())
    image.SetOrigin(LPS_FROM_IJK[:3, 3])
    sitk.WriteImage(image, str(folder / "ct.nii.gz"))
    return folder / "ct.nii.gz"


def _vector(numbers: Sequence[float]) -> str:
    return f"({','.join(repr(float(v)) for v in numbers)})"


def nrrd(
    folder: Path,
    values: np.ndarray,
    *,
    encoding: str = "raw",
    detached: str | None = None,
    lps_from_ijk: np.ndarray = LPS_FROM_IJK,
    edit: Callable[[list[str]], None] | None = None,
    newline: str = "\n",
    begin: bytes = b"",
    pack: Callable[[bytes], bytes] | None = None,
) -> Path:
    """Write an NRRD file; ``edit`` changes its header lines."""
    lines = [
        "NRRD0004",
        "# made by a test",
        f"type: {_NRRD_KINDS[values.dtype.str[1:]]}",
        "dimension: 3",
        "space: left-posterior-superior",
        f"sizes: {' '.join(str(n) for n in values.shape[::-1])}",
        f"space directions: {' '.join(_vector(lps_from_ijk[:3, axis]) for axis in range(3))}",
        "kinds: domain domain domain",
        f"endian: {'big' if _order(values) == '>' else 'little'}",
        f"encoding: {encoding}",
        f"space origin: {_vector(lps_from_ijk[:3, 3])}",
    ]
    if detached is not None:
        lines.append(f"data file: {detached}")
    if edit is not None:
        edit(lines)
    data = values.tobytes()
    data = pack(data) if pack is not None else gzip.compress(data) if encoding == "gzip" else data
    text = begin + newline.join([*lines, "", ""]).encode()
    if detached is None:
        path = folder / "ct.nrrd"
        path.write_bytes(text + data)
        return path
    (folder / Path(detached).name).write_bytes(data)
    (folder / "ct.nhdr").write_bytes(text)
    return folder / "ct.nhdr"


def metaimage(
    folder: Path,
    values: np.ndarray,
    *,
    compressed: bool = False,
    data_file: str = "LOCAL",
    edit: Callable[[list[str]], None] | None = None,
    newline: str = "\n",
) -> Path:
    """Write a MetaImage file; ``edit`` changes its header lines."""
    data = zlib.compress(values.tobytes()) if compressed else values.tobytes()
    lines = [
        "ObjectType = Image",
        "NDims = 3",
        "BinaryData = True",
        f"BinaryDataByteOrderMSB = {_order(values) == '>'}",
        f"CompressedData = {compressed}",
        f"TransformMatrix = {' '.join(repr(float(v)) for v in DIRECTIONS.T.ravel())}",
        f"Offset = {' '.join(repr(float(v)) for v in LPS_FROM_IJK[:3, 3])}",
        f"ElementSpacing = {' '.join(str(v) for v in SPACING_MM)}",
        f"DimSize = {' '.join(str(n) for n in values.shape[::-1])}",
        f"ElementType = MET_{_MET_KINDS[values.dtype.str[1:]]}",
        f"ElementDataFile = {data_file}",
    ]
    if edit is not None:
        edit(lines)
    text = newline.join([*lines, ""]).encode()
    if data_file == "LOCAL":
        (folder / "ct.mha").write_bytes(text + data)
        return folder / "ct.mha"
    (folder / "ct.raw").write_bytes(data)
    (folder / "ct.mhd").write_bytes(text)
    return folder / "ct.mhd"


FORMS: dict[str, Callable[[Path, np.ndarray], Path]] = {
    "nifti": nifti,
    "nifti gzip": _nifti_packed(gzip.compress),
    "nifti bgzip": _nifti_packed(bgzip),
    "nifti pair": _nifti_pair,
    "itk nifti": _itk_nifti,
    "nrrd": nrrd,
    "nrrd gzip": lambda folder, values: nrrd(folder, values, encoding="gzip"),
    "nrrd detached": lambda folder, values: nrrd(folder, values, detached="ct.raw"),
    "nrrd detached gzip": lambda folder, values: nrrd(folder, values, encoding="gzip", detached="ct.raw.gz"),
    "metaimage": metaimage,
    "metaimage compressed": lambda folder, values: metaimage(folder, values, compressed=True),
    "metaimage detached": lambda folder, values: metaimage(folder, values, data_file="ct.raw"),
}
"""Writers of one array in every supported form of a grid file, by name."""
