"""NIfTI, NRRD and MetaImage files: header and numbers are read here, and SimpleITK must agree about the geometry."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.disk import scratch_folder
from carina.errors import VolumeImportError
from carina.volume.dicom_streams import decoder_words
from carina.volume.grid_headers import GridHeader, read_grid_header
from carina.volume.grid_voxels import read_voxels
from carina.volume.hu import judge_values, to_int16
from carina.volume.model import Note, Volume, VolumeSource
from carina.volume.padding import without_corner_padding
from carina.volume.watch import Watch

__all__ = ["open_grid_file", "read_grid_array"]

_ITK_READERS = {"nifti": "NiftiImageIO", "nrrd": "NrrdImageIO", "metaimage": "MetaImageIO"}
# What MetaIO, teem and the NIfTI library write to stderr.
_LIBRARY = re.compile(
    rb"Meta(?:Object|Image|IO|Command)|MET_|\bdefin(?:ed|ing)\b|nrrd|nifti|nii_|^\*\*|^\+\+|itk", re.IGNORECASE
)
_SUFFIXES = {"nifti": (".nii", ".nii.gz", ".hdr", ".hdr.gz"), "nrrd": (".nrrd", ".nhdr"), "metaimage": (".mha", ".mhd")}


@contextmanager
def _with_known_suffix(path: Path, header: GridHeader) -> Iterator[Path]:
    """The file under a name that the library accepts: some programs write a NIfTI as ``mask.gz``."""
    suffixes = _SUFFIXES[header.format]
    if path.name.endswith(suffixes):
        yield path
        return
    detached = header.data_path != path
    if header.format == "nifti":
        suffix = ".hdr" if detached else ".nii.gz" if header.compression else ".nii"
    else:
        suffix = suffixes[1 if detached else 0]
    with scratch_folder() as folder:
        named = folder / f"volume{suffix}"
        links = {named: path}
        if detached:
            paired = f"volume.img{'.gz' if header.compression else ''}"
            links[named.with_name(paired if header.format == "nifti" else header.data_path.name)] = header.data_path
        for link, file in links.items():
            try:
                link.symlink_to(file.resolve())
            except OSError:  # no links for ordinary users on Windows
                shutil.copyfile(file, link)
        yield named


def _library_grid(path: Path, header: GridHeader) -> NDArray[np.float64]:
    """Where the library places the voxels, LPS mm, from its own reading of the header."""
    import SimpleITK as sitk  # slow to load, and the types of a volume do not need it

    reader = sitk.ImageFileReader()
    reader.SetImageIO(_ITK_READERS[header.format])
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    # ITK and what it calls write straight to stderr, in their own words; what matters of them is checked here and said
    # in ours.
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        with _with_known_suffix(path, header) as named:
            reader.SetFileName(str(named))
            with decoder_words(_LIBRARY):
                reader.ReadImageInformation()
    except (RuntimeError, MemoryError):
        msg = (
            f"reading {path.name}: Carina can read its {header.format} header but a second library cannot; the "
            "file is damaged or unusual; export it again"
        )
        raise VolumeImportError(msg, code="import.header.disagree") from None
    finally:
        sitk.ProcessObject.SetGlobalWarningDisplay(shown)
    size = tuple(reader.GetSize())
    if size != header.shape_ijk or reader.GetNumberOfComponents() != 1:
        msg = (
            f"reading {path.name}: expected {header.shape_ijk} voxels, but a second library found {size}; export "
            "the file "
            "again"
        )
        raise VolumeImportError(msg, code="import.header.disagree")
    theirs = np.eye(4)
    theirs[:3, :3] = np.reshape(reader.GetDirection(), (3, 3)) * reader.GetSpacing()
    theirs[:3, 3] = reader.GetOrigin()
    return theirs


def _check_agreement(path: Path, header: GridHeader) -> None:
    ours, theirs = header.lps_from_ijk, _library_grid(path, header)
    ni, nj, nk = (n - 1 for n in header.shape_ijk)
    corners = np.array([[i, j, k, 1.0] for i in (0, ni) for j in (0, nj) for k in (0, nk)], dtype=np.float64)
    apart_mm = float(np.linalg.norm(corners @ (ours - theirs).T, axis=1).max())
    # A twentieth of a voxel: float32 headers give about 1e-4 mm, another meaning of the header gives whole voxels.
    allowed_mm = 0.05 * float(np.linalg.norm(ours[:3, :3], axis=0).min())
    if apart_mm > allowed_mm:
        msg = (
            f"reading {path.name}: two libraries read its header differently and place the voxels {apart_mm:.2f} "
            "mm apart; expected less "
            f"than {allowed_mm:.2f} mm; save it again, for example from 3D Slicer"
        )
        raise VolumeImportError(msg, code="import.geometry.disagree")


def read_grid_array(
    path: Path,
    format: str,  # noqa: A002 - the word of the field
    *,
    watch: Watch,
) -> tuple[NDArray[np.generic], GridHeader, tuple[Note, ...]]:
    """The numbers of one NIfTI, NRRD or MetaImage file as they are, ``(nz, ny, nx)``, its checked header, and notes.

    Raises
    ------
    VolumeImportError
        If the header, the data or the geometry cannot be trusted; the message names the file.
    CancelledError
        If the person cancels.
    """
    watch.step("Reading the header")
    header = read_grid_header(path, format)
    values, notes = read_voxels(path, header, watch)
    _check_agreement(path, header)
    return values, header, header.notes + notes


def open_grid_file(path: Path, format: str, *, watch: Watch) -> Volume:  # noqa: A002 - the word of the field
    """Open one NIfTI, NRRD or MetaImage file.

    Raises
    ------
    VolumeImportError
        If the header, the data or the geometry cannot be trusted; the message names the file.
    CancelledError
        If the person cancels.
    """
    values, header, notes = read_grid_array(path, format, watch=watch)
    watch.step("Converting the values", None)
    try:
        converted = to_int16(values)
    except ValueError as error:
        msg = f"reading {path.name}: {error}; the file is damaged; export it again"
        raise VolumeImportError(msg, code="import.no-numbers") from None
    if converted.values.min() == converted.values.max():
        msg = f"reading {path.name}: every voxel has the same value, so it contains no image; open the scan itself"
        raise VolumeImportError(msg, code="import.values")
    verdict = judge_values(converted.values)
    reason = verdict.reason
    if converted.stretched is not None:
        reason = f"its values are not Hounsfield units; {converted.stretched}"
    elif verdict.is_hu:
        reason = converted.doubt
    hu, padding = without_corner_padding(converted.values) if verdict.is_hu else (converted.values, ())
    watch.step("Converting the values", 1.0)
    return Volume(
        hu,
        header.lps_from_ijk,
        is_hu=reason is None,
        not_hu_reason=reason,
        source=VolumeSource(format=format, title=path.name, notes=notes + converted.notes + padding),
    )
