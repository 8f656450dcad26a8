"""NIfTI, NRRD and MetaImage files: the claim is checked, SimpleITK reads, and both must agree about the geometry."""

from __future__ import annotations

import bz2
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from carina.errors import VolumeImportError
from carina.volume.dicom import MAX_VOXELS
from carina.volume.grid_headers import GridHeader, read_grid_header
from carina.volume.hu import judge_values, to_int16
from carina.volume.model import Volume, VolumeSource
from carina.volume.watch import Watch

__all__ = ["open_grid_file", "read_grid_array"]

_CHUNK_BYTES = 1 << 20
_MAX_RATIO = 1100  # deflate packs at most 1032 to 1
_ITK_READERS = {"nifti": "NiftiImageIO", "nrrd": "NrrdImageIO", "metaimage": "MetaImageIO"}
_SUFFIXES = {"nifti": (".nii", ".nii.gz", ".hdr", ".hdr.gz"), "nrrd": (".nrrd", ".nhdr"), "metaimage": (".mha", ".mhd")}


def _lying(path: Path, header: GridHeader, found: str) -> VolumeImportError:
    sizes = " x ".join(str(n) for n in header.shape_ijk)
    msg = (
        f"reading {path.name}: its header claims {sizes} voxels ({header.num_bytes} bytes), but {found}; the file is "
        "incomplete or its header is wrong; copy or export it again"
    )
    return VolumeImportError(msg, code="import.truncated")


def _check_claim(path: Path, header: GridHeader, watch: Watch) -> None:
    """Refuse a header that claims more than its file holds, before anything of that size is allocated."""
    num_voxels = 1
    for n in header.shape_ijk:
        num_voxels *= n
    if num_voxels > MAX_VOXELS:
        sizes = " x ".join(str(n) for n in header.shape_ijk)
        msg = (
            f"reading {path.name}: its header claims {sizes} voxels; at most {MAX_VOXELS} are read; the header is "
            "damaged, or the file is no chest CT; crop or resample it"
        )
        raise VolumeImportError(msg, code="import.too-large")
    size = header.data_path.stat().st_size
    if header.compression is None:
        held = size - max(0, header.data_offset)
        if held < header.num_bytes:
            raise _lying(path, header, f"the file holds {max(0, held)}")
        return
    needed = header.data_offset + header.num_bytes
    if header.compression != "bzip2" and needed > _MAX_RATIO * size:
        raise _lying(path, header, f"the compressed file has only {size}")
    # The stream is unpacked piece by piece and thrown away: a bomb or a cut file is found without memory for its
    # claim, and the
    # person can cancel. It costs about 0.3 s for each 100 MB.
    watch.step("Checking the file", 0.0)
    total = 0
    for piece_bytes, fraction in _unpacked_sizes(path, header, size):
        watch.step("Checking the file", fraction)
        total += piece_bytes
        if total > needed + _CHUNK_BYTES + max(needed, 1 << 26):
            raise _lying(path, header, "it unpacks to far more")
    if total < needed:
        raise _lying(path, header, f"it unpacks to {max(0, total - header.data_offset)}")


def _unpacked_sizes(path: Path, header: GridHeader, size: int) -> Iterator[tuple[int, float]]:
    bits = {"gzip": zlib.MAX_WBITS | 16, "zlib": zlib.MAX_WBITS | 32}
    with header.data_path.open("rb") as file:
        file.seek(header.stream_offset)
        inflater = (
            bz2.BZ2Decompressor()
            if header.compression == "bzip2"
            else zlib.decompressobj(bits[header.compression or ""])
        )
        try:
            while chunk := file.read(_CHUNK_BYTES):
                fraction = min(1.0, file.tell() / size)
                while True:
                    piece = inflater.decompress(chunk, _CHUNK_BYTES)
                    yield len(piece), fraction
                    chunk = b"" if isinstance(inflater, bz2.BZ2Decompressor) else inflater.unconsumed_tail
                    if inflater.eof or (not chunk and len(piece) < _CHUNK_BYTES):
                        break
                if inflater.eof:
                    return  # further members of a stream are not read by the libraries either
        except (zlib.error, OSError):
            raise _lying(path, header, "its compressed stream is damaged") from None
    raise _lying(path, header, "its compressed stream ends too early")


@contextmanager
def _with_known_suffix(path: Path, header: GridHeader) -> Iterator[Path]:
    """The file under a name that the library accepts: some programs write a NIfTI as ``mask.gz``."""
    suffixes = _SUFFIXES[header.format]
    if path.name.lower().endswith(suffixes):
        yield path
        return
    suffix = ".nii.gz" if header.compression == "gzip" and header.format == "nifti" else suffixes[0]
    with tempfile.TemporaryDirectory(prefix="carina-") as folder:
        named = Path(folder) / f"volume{suffix}"
        try:
            named.symlink_to(path.resolve())
        except OSError:  # no links for ordinary users on Windows
            shutil.copyfile(path, named)
        yield named


def _read(path: Path, header: GridHeader) -> tuple[NDArray[np.generic], NDArray[np.float64]]:
    reader = sitk.ImageFileReader()
    reader.SetImageIO(_ITK_READERS[header.format])
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    # ITK writes its warnings straight to stderr, in its own words; what matters of them is checked here and said in
    # ours.
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        with _with_known_suffix(path, header) as named:
            reader.SetFileName(str(named))
            image = reader.Execute()
    except (RuntimeError, MemoryError):
        msg = (
            f"reading {path.name}: its {header.format} data cannot be read, although its header looks right; the file "
            "is damaged or of an unusual kind; export it again"
        )
        raise VolumeImportError(msg, code="import.unreadable") from None
    finally:
        sitk.ProcessObject.SetGlobalWarningDisplay(shown)
    if image.GetSize() != header.shape_ijk or image.GetNumberOfComponentsPerPixel() != 1:
        msg = (
            f"reading {path.name}: expected {header.shape_ijk} voxels, the library finds {image.GetSize()}; export "
            "the file again"
        )
        raise VolumeImportError(msg, code="import.header")
    theirs = np.eye(4)
    theirs[:3, :3] = np.reshape(image.GetDirection(), (3, 3)) * image.GetSpacing()
    theirs[:3, 3] = image.GetOrigin()
    return sitk.GetArrayFromImage(image), theirs


def _check_agreement(path: Path, header: GridHeader, theirs: NDArray[np.float64]) -> None:
    ours = header.lps_from_ijk
    ni, nj, nk = (n - 1 for n in header.shape_ijk)
    corners = np.array([[i, j, k, 1.0] for i in (0, ni) for j in (0, nj) for k in (0, nk)], dtype=np.float64)
    apart_mm = float(np.linalg.norm(corners @ (ours - theirs).T, axis=1).max())
    # A twentieth of a voxel: float32 headers give about 1e-4 mm, another meaning of the header gives whole voxels.
    allowed_mm = 0.05 * float(np.linalg.norm(ours[:3, :3], axis=0).min())
    if apart_mm > allowed_mm:
        msg = (
            f"reading {path.name}: two readings of its header place the voxels {apart_mm:.2f} mm apart; expected less "
            f"than {allowed_mm:.2f} mm; save it again, for example from 3D Slicer"
        )
        raise VolumeImportError(msg, code="import.geometry.disagree")


def read_grid_array(
    path: Path,
    format: str,  # noqa: A002 - the word of the field
    *,
    watch: Watch,
) -> tuple[NDArray[np.generic], GridHeader]:
    """The numbers of one NIfTI, NRRD or MetaImage file as they are, ``(nz, ny, nx)``, and its checked header.

    Raises
    ------
    VolumeImportError
        If the header, the data or the geometry cannot be trusted; the message names the file.
    CancelledError
        If the person cancels.
    """
    watch.step("Reading the header")
    header = read_grid_header(path, format)
    _check_claim(path, header, watch)
    watch.step("Reading the voxels", None)
    values, theirs = _read(path, header)
    _check_agreement(path, header, theirs)
    return values, header


def open_grid_file(path: Path, format: str, *, watch: Watch) -> Volume:  # noqa: A002 - the word of the field
    """Open one NIfTI, NRRD or MetaImage file.

    Raises
    ------
    VolumeImportError
        If the header, the data or the geometry cannot be trusted; the message names the file.
    CancelledError
        If the person cancels.
    """
    values, header = read_grid_array(path, format, watch=watch)
    watch.step("Converting the values", None)
    try:
        converted = to_int16(values)
    except ValueError as error:
        msg = f"reading {path.name}: {error}; the file is damaged; export it again"
        raise VolumeImportError(msg, code="import.values") from None
    if converted.values.min() == converted.values.max():
        msg = (
            f"reading {path.name}: every voxel holds the same number, so there is nothing to see; open the scan itself"
        )
        raise VolumeImportError(msg, code="import.values")
    verdict = judge_values(converted.values)
    reason = verdict.reason
    if converted.stretched is not None:
        reason = f"its values are not Hounsfield units; {converted.stretched}"
    watch.step("Converting the values", 1.0)
    return Volume(
        converted.values,
        header.lps_from_ijk,
        is_hu=verdict.is_hu and converted.stretched is None,
        not_hu_reason=reason,
        source=VolumeSource(format=format, title=path.name, warnings=converted.warnings),
    )
