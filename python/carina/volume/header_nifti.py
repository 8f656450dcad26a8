"""Reader of NIfTI-1 headers as defined in nifti1.h."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.volume.axis_angles import has_right_angles, with_orthogonal_axes
from carina.volume.header_fields import AMBIGUOUS, GridHeader, HeaderValueError, refuse
from carina.volume.model import Note

_RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
_KINDS = {
    2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8",
}  # fmt: skip
_OTHER_KINDS = {128: "colour", 2304: "colour", 32: "complex", 1792: "complex", 2048: "complex", 1: "1-bit"}
_SAME_FORM = 0.1  # largest difference of sform and qform in voxels, for rounding
_SMALLEST_OFFSET = 352  # smallest vox_offset of a single file: 348 bytes of header, 4 for extensions


def read_nifti_header(path: Path, head: bytes) -> GridHeader:
    """Return the header of one file from its first bytes, decompressed.

    Raises
    ------
    ValueError, struct.error
        If the header is malformed.
    VolumeImportError
        See ``read_grid_header``.
    """
    order, version = next(
        ((order, size) for order in "<>" for size in (348, 540) if struct.unpack_from(f"{order}i", head)[0] == size),
        ("", 0),
    )
    if version == 0 or len(head) < 348:
        raise ValueError
    if version == 540:
        problem = "it is a NIfTI-2 file, which is not supported"
        raise refuse(path, problem, "save it as NIfTI-1, for example from 3D Slicer", "import.not-supported")
    magic = head[344:348]
    if magic[:3] not in (b"n+1", b"ni1"):
        problem = "it is an Analyze 7.5 file, which does not record left and right"
        raise refuse(path, problem, AMBIGUOUS, "import.geometry.orientation-unknown")
    dim = struct.unpack_from(f"{order}8h", head, 40)
    datatype, bits = struct.unpack_from(f"{order}2h", head, 70)
    pixdim = struct.unpack_from(f"{order}8f", head, 76)
    offset, slope, intercept = struct.unpack_from(f"{order}3f", head, 108)
    if not 1 <= dim[0] <= 7:
        raise HeaderValueError("dim[0] (the number of axes)", "1 to 7", str(dim[0]))
    shape = dim[1 : dim[0] + 1]
    while len(shape) > 3 and shape[-1] == 1:  # many programs write trailing axes of length 1
        shape = shape[:-1]
    if datatype not in _KINDS:
        known = _OTHER_KINDS.get(datatype)
        found = f"values of the type {datatype}" if known is None else f"{known} values"
        problem = f"it contains {found}, which are not supported"
        raise refuse(path, problem, "export it again as 16-bit numbers", "import.not-supported")
    dtype = np.dtype(order + _KINDS[datatype])
    if bits not in (0, 8 * dtype.itemsize):
        problem = f"its values have {8 * dtype.itemsize} bits according to datatype but {bits} according to bitpix"
        raise refuse(path, problem, "one of them is wrong; export it again", "import.header")
    data_path = _data_file(path, single=magic[:2] == b"n+")
    # In a single file this also refuses an offset of 0, which programs interpret as "behind the header" or as 348.
    lowest = _SMALLEST_OFFSET if data_path == path else 0
    if not np.isfinite(offset) or offset < lowest or offset != int(offset):
        problem = f"its values should begin at byte {lowest} or later, but vox_offset is {offset:g}"
        raise refuse(path, problem, "the header is damaged; export it again", "import.header.offset")
    scaling, notes = _scaling(path, slope, intercept)
    header = GridHeader(
        format="nifti",
        shape_ijk=tuple(int(n) for n in shape),
        num_components=1,
        dtype=dtype,
        lps_from_ijk=_transform_of(path, head, order, shape, pixdim),
        data_path=data_path,
        data_offset=int(offset),
        compression=None,
        values_are_elsewhere=data_path != path,
        scaling=scaling,
        head=head[:348],
        notes=notes,
    )
    return replace(header, compression="gzip") if _is_gzipped(path, header) else header


def _scaling(path: Path, slope: float, intercept: float) -> tuple[tuple[float, float] | None, tuple[Note, ...]]:
    """Return slope and intercept, or None if the stored numbers are the values, and notes.

    According to nifti1.h, a slope of 0 means that the numbers are the values, whatever the intercept is.
    """
    if slope == 0.0:
        return None, ()
    if not np.isfinite(slope):
        words = f"its rescale slope is not finite ({slope}), so its values were used as stored, without the intercept"
        return None, (Note("import.scaling", words, badge=True),)
    if not np.isfinite(intercept):
        problem = f"its header scales its values by {slope:g} and shifts them by {intercept}, which is not finite"
        raise refuse(path, problem, "the header is damaged; export it again", "import.header.scaling")
    return (None if (slope, intercept) == (1.0, 0.0) else (float(slope), float(intercept))), ()


def data_files(path: Path) -> list[Path]:
    """Return the possible data files of a header without values; the first that exists is used."""
    stem = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    return [stem.with_suffix(suffix) for suffix in (".img", ".img.gz", ".IMG", ".IMG.GZ")]


def _data_file(path: Path, *, single: bool) -> Path:
    """Return the path of the file that contains the voxel values of a NIfTI header."""
    if single:
        return path
    siblings = data_files(path)
    found = next((candidate for candidate in siblings if candidate.is_file()), None)
    if found is None:
        problem = f"its values should be in {siblings[0].name}, which is not in the same folder"
        raise refuse(path, problem, "put both files into one folder", "import.not-found")
    return found


def _is_gzipped(path: Path, header: GridHeader) -> bool:
    """Return whether gzip compresses the file of the values, whatever its name is."""
    with header.data_path.open("rb") as file:
        packed = file.read(3) == b"\x1f\x8b\x08"
    # Uncompressed values may begin with these bytes; a file of exactly their size is uncompressed.
    whole = header.values_are_elsewhere and header.data_path.stat().st_size == header.data_offset + header.num_bytes
    return packed and not whole


def _transform_of(
    path: Path, head: bytes, order: str, shape: tuple[int, ...], pixdim: tuple[float, ...]
) -> NDArray[np.float64]:
    """Return the 4x4 transform from voxel centres to LPS mm, from the sform or the qform."""
    qform, sform = struct.unpack_from(f"{order}2h", head, 252)
    scale = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 0.001}.get(head[123] & 7)
    if scale is None:
        raise HeaderValueError("unit of length (xyzt_units)", "0 to 3", str(head[123] & 7))
    forms = []
    if sform > 0:
        rows = struct.unpack_from(f"{order}12f", head, 280)
        forms.append(np.vstack([np.reshape(rows, (3, 4)), [0, 0, 0, 1]]).astype(np.float64))
    if qform > 0:
        forms.append(_qform(pixdim, struct.unpack_from(f"{order}6f", head, 256)))
    if not forms:
        problem = "neither its qform nor its sform is set, so left and right are unknown"
        raise refuse(path, problem, AMBIGUOUS, "import.geometry.orientation-unknown")
    _refuse_two_handed_pixdim(path, pixdim, qform_alone=sform <= 0)
    lps = [_RAS_TO_LPS @ np.diag([scale, scale, scale, 1.0]) @ form for form in forms]
    if len(lps) == 2 and len(shape) == 3 and np.isfinite(lps[0]).all() and np.isfinite(lps[1]).all():
        # The caller refuses a sheared sform; only forms that are rectangular grids are compared here.
        apart_mm = min(
            _corner_distance_mm(lps[0], lps[1], shape),
            _corner_distance_mm(_with_orthogonal_sform(lps[0]), lps[1], shape),
        )
        smallest_mm = np.linalg.norm(lps[1][:3, :3], axis=0).min()
        if apart_mm > _SAME_FORM * smallest_mm and _is_rectangular(lps[0], shape):
            problem = f"its qform and sform disagree by up to {apart_mm:.2f} mm about where the voxels are"
            raise refuse(path, problem, "save it again with only one of them", "import.geometry.ambiguous")
    return np.asarray(lps[0], dtype=np.float64)


def _refuse_two_handed_pixdim(path: Path, pixdim: tuple[float, ...], *, qform_alone: bool) -> None:
    """Refuse signs of pixdim that programs interpret in different ways, because some would mirror the patient.

    nifti1.h: pixdim[1..3] are positive, and pixdim[0] (qfac) is -1 or 1; 0 means 1. The NIfTI library multiplies by a
    negative pixdim[1..3] and interprets any negative qfac as -1; nibabel uses the magnitude and 1.
    """
    negative = [axis for axis in (1, 2, 3) if pixdim[axis] < 0]
    if negative:
        axis = negative[0]
        problem = (
            f"its pixdim[{axis}] is {pixdim[axis]:g}, but a voxel spacing should be positive; some programs mirror the "
            "image and others ignore the sign, so left and right are unknown"
        )
        raise refuse(path, problem, AMBIGUOUS, "import.geometry.ambiguous")
    # An sform is complete without qfac.
    if qform_alone and not (pixdim[0] >= 0 or pixdim[0] == -1):
        problem = (
            f"its pixdim[0] (qfac) is {pixdim[0]:g}, but it should be 1 or -1; some programs mirror the image and "
            "others ignore the sign, so left and right are unknown"
        )
        raise refuse(path, problem, AMBIGUOUS, "import.geometry.ambiguous")


def _corner_distance_mm(one: NDArray[np.float64], other: NDArray[np.float64], shape: tuple[int, ...]) -> float:
    """Return the largest distance in mm between the corners of a grid with two transforms."""
    corners = np.array([[i, j, k, 1.0] for i in (0, shape[0]) for j in (0, shape[1]) for k in (0, shape[2])])
    return float(np.linalg.norm(corners @ (one - other).T, axis=1).max())


def _with_orthogonal_sform(transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sform as programs convert it to a qform; an sform without directions is returned unchanged."""
    return with_orthogonal_axes(transform) if np.linalg.norm(transform[:3, :3], axis=0).min() > 0 else transform


def _is_rectangular(lps_from_ijk: NDArray[np.float64], shape: tuple[int, ...]) -> bool:
    return bool(np.linalg.norm(lps_from_ijk[:3, :3], axis=0).min() > 0) and has_right_angles(lps_from_ijk, shape)


def _qform(pixdim: tuple[float, ...], quaternion: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the 4x4 transform of a qform, from voxel centres to RAS in the unit of the file."""
    b, c, d, *offsets = quaternion
    squared = 1.0 - (b * b + c * c + d * d)
    if not np.isfinite([b, c, d, *offsets]).all() or squared < -1e-3:
        raise ValueError
    a = np.sqrt(max(0.0, squared))
    # nifti1.h: a = 0 is a half turn. Rounding may have made (b, c, d) longer than 1, so it is normalised.
    if squared < 1e-7:
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
