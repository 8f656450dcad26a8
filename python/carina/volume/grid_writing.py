"""Arrays on a CT's grid as NIfTI, NRRD or MetaImage, written by ourselves.

ITK's NIfTI writer on a full disk leaves a file that is cut short, prints a line to stderr and reports success; the
others fail in words of their own. Here each byte goes through a file that says what the disk says, and a draft that
takes its place only when it is whole (``disk.drafts``).

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
from carina.volume.right_angles import has_right_angles, skew_deg, straightened

__all__ = ["GRID_SUFFIXES", "check_grid_fits", "write_grid", "write_grid_to"]

Values = NDArray[Any]
_CHUNK_BYTES = 8 << 20
_NIFTI_TYPES = {"uint8": 2, "int16": 4}
_NRRD_TYPES = {"uint8": "unsigned char", "int16": "short"}
_META_TYPES = {"uint8": "MET_UCHAR", "int16": "MET_SHORT"}
_NIFTI_MAX_VOXELS = 32767  # of one axis: dim is int16


def write_grid(
    path: Path | str,
    values_zyx: Values,
    lps_from_ijk: NDArray[np.float64],
    *,
    what: str,
    note: str | None = None,
    level: int = 6,
) -> Path:
    """Write values on a grid, whole or not at all, so that other tools lay them exactly over the CT.

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
        What it is, for messages: "the mask".
    note
        What a reader must know: NIfTI has it as ``descrip`` (ASCII, 79 characters, the rest is cut off), the others as
        a field ``note``.
    level
        Of the compression, 1 (fast) to 9 (small).

    Raises
    ------
    UsageError, GeometryError
        As :func:`check_grid_fits`; or the kind of number is another.
    DiskError
        If it cannot be written; what was there before stays.
    """
    suffix = check_grid_fits(path, values_zyx.shape, lps_from_ijk, what=what)
    with drafted(path, what=what) as file:
        write_grid_to(file, suffix, values_zyx, lps_from_ijk, what=what, note=note, level=level)
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
        As of :func:`write_grid`.

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
) -> None:
    """Write values on a grid to an open file; ``suffix`` of :data:`GRID_SUFFIXES` selects the format.

    Raises
    ------
    UsageError, GeometryError
        As :func:`write_grid`.
    OSError
        What the disk says.
    """
    if values_zyx.dtype.name not in _NIFTI_TYPES:
        raise UsageError(f"{what} must contain uint8 or int16 values; found {values_zyx.dtype.name}")
    _check_format(suffix, values_zyx.shape, lps_from_ijk, what)
    values = np.ascontiguousarray(values_zyx, dtype=values_zyx.dtype.newbyteorder("<"))
    # One line: these headers are lines of text.
    _WRITERS[suffix](file, _Grid(values, lps_from_ijk, " ".join((note or "").split()), level))


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """What is written: little-endian values, where they lie, one line to the reader, and the compression's level."""

    values: Values
    lps_from_ijk: NDArray[np.float64]
    note: str
    level: int


def _chunks(values: Values) -> list[memoryview]:
    flat = values.reshape(-1).view(np.uint8).data
    return [flat[start : start + _CHUNK_BYTES] for start in range(0, len(flat), _CHUNK_BYTES)]


def _nifti(file: BinaryIO, grid: _Grid) -> None:
    file.write(_nifti_header(grid))
    for chunk in _chunks(grid.values):
        file.write(chunk)


def _nifti_gz(file: BinaryIO, grid: _Grid) -> None:
    # No name and no time inside: equal content makes equal files.
    with gzip.GzipFile(filename="", mode="wb", compresslevel=grid.level, fileobj=file, mtime=0) as packed:
        packed.write(_nifti_header(grid))
        for chunk in _chunks(grid.values):
            packed.write(chunk)


def _nifti_header(grid: _Grid) -> bytes:
    """Return 348 bytes and four for "no extension", with the transform as a matrix (sform) and a quaternion (qform).

    The sform is exact. A quaternion has right angles only, so the qform is the nearest rotation.
    """
    ras_from_ijk = np.diag([-1.0, -1.0, 1.0, 1.0]) @ grid.lps_from_ijk
    spacing = np.linalg.norm(ras_from_ijk[:3, :3], axis=0)
    turn = straightened(ras_from_ijk)[:3, :3] / spacing
    qfac = 1.0
    if np.linalg.det(turn) < 0.0:
        # A quaternion turns, and does not mirror: the third axis is mirrored by qfac.
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
    """b, c, d of the unit quaternion (a >= 0) of a rotation; its largest part is found first, for precision."""
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
    steps = " ".join(f"({','.join(_digits(v) for v in column)})" for column in grid.lps_from_ijk[:3, :3].T)
    endian = "endian: little\n" if grid.values.itemsize > 1 else ""
    header = (
        "NRRD0004\n"
        f"type: {_NRRD_TYPES[grid.values.dtype.name]}\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {nx} {ny} {nz}\nspace directions: {steps}\nkinds: domain domain domain\n{endian}encoding: gzip\n"
        f"space origin: ({','.join(_digits(v) for v in grid.lps_from_ijk[:3, 3])})\n"
    )
    if grid.note:
        header += f"note:={grid.note}\n"
    file.write((header + "\n").encode())
    with gzip.GzipFile(filename="", mode="wb", compresslevel=grid.level, fileobj=file, mtime=0) as packed:
        for chunk in _chunks(grid.values):
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
        "TransformMatrix": " ".join(map(_digits, columns)),
        "Offset": " ".join(map(_digits, grid.lps_from_ijk[:3, 3])),
        "CenterOfRotation": "0 0 0",
        "ElementSpacing": " ".join(map(_digits, spacing)),
        "DimSize": f"{nx} {ny} {nz}",
        "ElementType": _META_TYPES[grid.values.dtype.name],
        **({"note": grid.note} if grid.note else {}),
        "ElementDataFile": "LOCAL",
    }
    file.write("".join(f"{name} = {value}\n" for name, value in lines.items()).encode())
    file.write(packed.getvalue())


def _digits(value: float) -> str:
    """As many digits as give the number back."""
    return repr(float(value)).removesuffix(".0")


_WRITERS: dict[str, Callable[[BinaryIO, _Grid], None]] = {
    ".nii.gz": _nifti_gz,
    ".nii": _nifti,
    ".nrrd": _nrrd,
    ".mha": _meta,
}
GRID_SUFFIXES = tuple(_WRITERS)
"""Suffixes that :func:`write_grid` knows."""
