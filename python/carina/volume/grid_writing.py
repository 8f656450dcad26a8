"""Writer of arrays on a CT's grid as NIfTI, NRRD or MetaImage files.

ITK's NIfTI writer leaves a truncated file on a full disk, prints a line to stderr and reports success; its other
writers raise errors with unclear messages. This module reports errors of the disk, and a file is replaced only when it
is complete (``disk.drafts``).

References
----------
NIfTI-1 (nifti1.h, Cox et al. 2004); NRRD 4 (Teem); MetaImage (Kitware).
"""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from carina.disk import drafted
from carina.errors import GeometryError, UsageError
from carina.volume.axis_angles import has_right_angles, skew_deg, with_orthogonal_axes

Values = NDArray[Any]
_CHUNK_BYTES = 8 << 20
_NIFTI_TYPES = {"uint8": 2, "int16": 4}
_NRRD_TYPES = {"uint8": "unsigned char", "int16": "short"}
_META_TYPES = {"uint8": "MET_UCHAR", "int16": "MET_SHORT"}
_NIFTI_MAX_VOXELS = 32767  # largest size of an axis: dim is int16


def write_grid(
    path: Path | str,
    values_zyx: Values,
    lps_from_ijk: NDArray[np.float64],
    *,
    what: str,
    note: str | None = None,
    level: int = 6,
    before: NDArray[np.uint8] | None = None,
) -> Path:
    """Write values on a grid atomically, so that other software places them exactly over the CT.

    Parameters
    ----------
    path
        ``.nii.gz``, ``.nii``, ``.nrrd`` or ``.mha``; all but ``.nii`` are compressed.
    values_zyx
        (nz, ny, nx) uint8 or int16.
    lps_from_ijk
        (4, 4), mm, from voxel centres to LPS. Only ``.nrrd`` stores axes that are not at right angles
        (``right_angles``).
    what
        Name of the content for messages: "the mask".
    note
        Note for readers of the file: NIfTI stores it as ``descrip`` (ASCII, truncated to 79 characters), the other
        formats as a field ``note``.
    level
        Compression level, 1 (fast) to 9 (small).
    before
        Bytes that are stored before the values, which other readers skip (``byte skip``); only in ``.nrrd``.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError, GeometryError
        As in :func:`check_grid_fits`; UsageError also for another type of number.
    DiskError
        If the file cannot be written; a former file stays.
    """
    suffix = check_grid_fits(path, values_zyx.shape, lps_from_ijk, what=what)
    with drafted(path, what=what) as file:
        write_grid_to(file, suffix, values_zyx, lps_from_ijk, what=what, note=note, level=level, before=before)
    return Path(path)


def check_grid_fits(
    path: Path | str, shape_zyx: tuple[int, ...], lps_from_ijk: NDArray[np.float64], *, what: str
) -> str:
    """Check, before any long work, that a grid can be written to a file of this name; return the file's suffix.

    Parameters
    ----------
    path
        The file to be written.
    shape_zyx, lps_from_ijk, what
        As in :func:`write_grid`.

    Raises
    ------
    UsageError
        If the suffix is not one of :data:`GRID_SUFFIXES`.
    GeometryError
        ``geometry.sheared`` or ``geometry.shape``, if the format cannot store this grid.
    """
    name = Path(path).name.lower()
    suffix = next((s for s in _WRITERS if name.endswith(s)), None)
    if suffix is None:
        msg = f"{what} must be written as {', '.join(GRID_SUFFIXES)}; found {Path(path).name!r}"
        raise UsageError(msg)
    _check_format(suffix, shape_zyx, lps_from_ijk, what)
    return suffix


def _check_format(suffix: str, shape_zyx: tuple[int, ...], lps_from_ijk: NDArray[np.float64], what: str) -> None:
    """Raise an error if a format cannot store a grid."""
    if suffix == ".nrrd":
        return
    if not has_right_angles(lps_from_ijk, shape_zyx[::-1]):
        msg = (
            f"{what} cannot be written as {suffix}: two axes of the scan meet at {90 - skew_deg(lps_from_ijk):.1f} "
            "instead of 90 degrees (gantry tilt), which this format cannot represent; write it as .nrrd, or resample "
            "the scan"
        )
        raise GeometryError(msg, code="geometry.sheared")
    if suffix != ".mha" and max(shape_zyx) > _NIFTI_MAX_VOXELS:
        msg = (
            f"{what} cannot be written as {suffix}: an axis of the scan has {max(shape_zyx)} voxels, and NIfTI stores "
            f"at most {_NIFTI_MAX_VOXELS}; write it as .nrrd"
        )
        raise GeometryError(msg, code="geometry.shape")


def write_grid_to(
    file: BinaryIO,
    suffix: str,
    values_zyx: Values,
    lps_from_ijk: NDArray[np.float64],
    *,
    what: str,
    note: str | None = None,
    level: int = 6,
    before: NDArray[np.uint8] | None = None,
) -> None:
    """Write values on a grid to an open file; ``suffix`` of :data:`GRID_SUFFIXES` selects the format.

    Parameters
    ----------
    file
        The open file.
    suffix
        One of :data:`GRID_SUFFIXES`.
    values_zyx, lps_from_ijk, what, note, level, before
        As in :func:`write_grid`.

    Raises
    ------
    UsageError, GeometryError
        As in :func:`write_grid`.
    OSError
        If the disk refuses the write.
    """
    if values_zyx.dtype.name not in _NIFTI_TYPES:
        raise UsageError(f"{what} must contain uint8 or int16 values; found {values_zyx.dtype.name}")
    _check_format(suffix, values_zyx.shape, lps_from_ijk, what)
    if before is not None and suffix != ".nrrd":
        msg = f"{what} must be written as .nrrd, because {suffix} cannot store bytes before the values"
        raise UsageError(msg)
    values = np.ascontiguousarray(values_zyx, dtype=values_zyx.dtype.newbyteorder("<"))
    # Joined to one line, because these headers consist of lines of text.
    _WRITERS[suffix](file, _Grid(values, lps_from_ijk, " ".join((note or "").split()), level, before))


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Content of a grid file: little-endian values, their grid, a note of one line, the compression level, and bytes.

    The bytes in ``before`` precede the values.
    """

    values: Values
    lps_from_ijk: NDArray[np.float64]
    note: str
    level: int
    before: NDArray[np.uint8] | None = None


def _chunks(values: Values) -> list[memoryview]:
    flat = values.reshape(-1).view(np.uint8).data
    return [flat[start : start + _CHUNK_BYTES] for start in range(0, len(flat), _CHUNK_BYTES)]


def _nifti(file: BinaryIO, grid: _Grid) -> None:
    file.write(_nifti_header(grid))
    for chunk in _chunks(grid.values):
        file.write(chunk)


def _nifti_gz(file: BinaryIO, grid: _Grid) -> None:
    # The stream contains no name and no time, so that equal content gives equal files.
    with gzip.GzipFile(filename="", mode="wb", compresslevel=grid.level, fileobj=file, mtime=0) as packed:
        packed.write(_nifti_header(grid))
        for chunk in _chunks(grid.values):
            packed.write(chunk)


def _nifti_header(grid: _Grid) -> bytes:
    """Return the header of 348 bytes and four bytes for "no extension".

    The transform is stored as a matrix (sform), which is exact, and as a quaternion (qform). A quaternion has right
    angles only, so the qform is the nearest rotation.
    """
    ras_from_ijk = np.diag([-1.0, -1.0, 1.0, 1.0]) @ grid.lps_from_ijk
    spacing = np.linalg.norm(ras_from_ijk[:3, :3], axis=0)
    turn = with_orthogonal_axes(ras_from_ijk)[:3, :3] / spacing
    qfac = 1.0
    if np.linalg.det(turn) < 0.0:
        # A quaternion cannot mirror, so qfac mirrors the third axis.
        qfac = -1.0
        turn = turn * np.array([1.0, 1.0, -1.0])
    b, c, d = _quaternion(turn)
    nz, ny, nx = grid.values.shape
    dims = (3, nx, ny, nz, 1, 1, 1, 1)
    pixdim = (qfac, *spacing, 0.0, 0.0, 0.0, 0.0)
    header = struct.pack("<i10s18sihcB", 348, b"", b"", 0, 0, b"r", 0)
    header += struct.pack("<8h", *dims)
    header += struct.pack(
        "<3fhhhh", 0.0, 0.0, 0.0, 0, _NIFTI_TYPES[grid.values.dtype.name], grid.values.itemsize * 8, 0
    )
    header += struct.pack("<8f", *pixdim)
    mm_and_s = 2 | 8
    header += struct.pack("<3fhBB4fii", 352.0, 1.0, 0.0, 0, 0, mm_and_s, 0.0, 0.0, 0.0, 0.0, 0, 0)
    header += struct.pack("<80s24s", grid.note.encode("ascii", "replace")[:79], b"")
    header += struct.pack("<hh", 1, 1)
    header += struct.pack("<3f3f", b, c, d, *ras_from_ijk[:3, 3])
    header += struct.pack("<12f", *ras_from_ijk[:3].ravel())
    header += struct.pack("<16s4s4s", b"", b"n+1\0", b"")
    return header


def _quaternion(turn: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return b, c, d of the unit quaternion (a >= 0) of a rotation, computed from its largest part for precision."""
    m = turn
    # Four times the squares of a, b, c, d.
    squares = np.array(
        [
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    rows = np.array(
        [
            [squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], squares[1], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], squares[2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[3]],
        ]
    )
    abcd = rows[largest] / (2.0 * np.sqrt(squares[largest]))
    if abcd[0] < 0.0:
        abcd = -abcd
    return float(abcd[1]), float(abcd[2]), float(abcd[3])


def _nrrd(file: BinaryIO, grid: _Grid) -> None:
    nz, ny, nx = grid.values.shape
    steps = " ".join(f"({','.join(_shortest_decimal(v) for v in column)})" for column in grid.lps_from_ijk[:3, :3].T)
    endian = "endian: little\n" if grid.values.itemsize > 1 else ""
    header = (
        "NRRD0004\n"
        f"type: {_NRRD_TYPES[grid.values.dtype.name]}\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {nx} {ny} {nz}\nspace directions: {steps}\nkinds: domain domain domain\n{endian}encoding: gzip\n"
        f"space origin: ({','.join(_shortest_decimal(v) for v in grid.lps_from_ijk[:3, 3])})\n"
    )
    if grid.before is not None:
        header += f"byte skip: {grid.before.size}\n"
    if grid.note:
        header += f"note:={grid.note}\n"
    file.write((header + "\n").encode())
    with gzip.GzipFile(filename="", mode="wb", compresslevel=grid.level, fileobj=file, mtime=0) as packed:
        # A reader skips bytes of compressed data after it has decompressed them (the NRRD format, "byte skip").
        for chunk in [*([] if grid.before is None else _chunks(grid.before)), *_chunks(grid.values)]:
            packed.write(chunk)


def _meta(file: BinaryIO, grid: _Grid) -> None:
    nz, ny, nx = grid.values.shape
    packer, packed = zlib.compressobj(grid.level), io.BytesIO()
    for chunk in _chunks(grid.values):
        packed.write(packer.compress(chunk))
    packed.write(packer.flush())
    spacing = np.linalg.norm(grid.lps_from_ijk[:3, :3], axis=0)
    columns = (grid.lps_from_ijk[:3, :3] / spacing).T.ravel()
    lines = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "True",
        "CompressedDataSize": str(packed.tell()),
        "TransformMatrix": " ".join(map(_shortest_decimal, columns)),
        "Offset": " ".join(map(_shortest_decimal, grid.lps_from_ijk[:3, 3])),
        "CenterOfRotation": "0 0 0",
        "ElementSpacing": " ".join(map(_shortest_decimal, spacing)),
        "DimSize": f"{nx} {ny} {nz}",
        "ElementType": _META_TYPES[grid.values.dtype.name],
        **({"note": grid.note} if grid.note else {}),
        "ElementDataFile": "LOCAL",
    }
    file.write("".join(f"{name} = {value}\n" for name, value in lines.items()).encode())
    file.write(packed.getvalue())


def _shortest_decimal(value: float) -> str:
    """Return the shortest decimal text from which the same float is read back."""
    return repr(float(value)).removesuffix(".0")


_WRITERS: dict[str, Callable[[BinaryIO, _Grid], None]] = {
    ".nii.gz": _nifti_gz,
    ".nii": _nifti,
    ".nrrd": _nrrd,
    ".mha": _meta,
}
GRID_SUFFIXES = tuple(_WRITERS)
"""Suffixes of the formats that :func:`write_grid` writes."""
