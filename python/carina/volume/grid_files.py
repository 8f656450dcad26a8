"""Reader of NIfTI, NRRD and MetaImage files; SimpleITK, if installed, must read the same geometry from the header."""

from __future__ import annotations

import functools
import importlib.util
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.disk import library_path, scratch_folder
from carina.display.printable import printable
from carina.errors import VolumeImportError
from carina.volume.axis_angles import skew_deg, with_orthogonal_axes
from carina.volume.dicom_streams import decoder_words
from carina.volume.grid_headers import GridHeader, read_grid_header
from carina.volume.grid_voxels import read_voxels
from carina.volume.header_nifti import head_with_orthogonal_sform
from carina.volume.hu import judge_values, to_int16
from carina.volume.isoregion_bundle import check_bundle, contains_map
from carina.volume.model import Note, Volume, VolumeSource
from carina.volume.padding import without_corner_padding
from carina.volume.progress import Watch

_ITK_READERS = {"nifti": "NiftiImageIO", "nrrd": "NrrdImageIO", "metaimage": "MetaImageIO"}
# Words in the messages that MetaIO, teem and the NIfTI library write to stderr.
_LIBRARY = re.compile(
    rb"Meta(?:Object|Image|IO|Command)|MET_|\bdefin(?:ed|ing)\b|nrrd|nifti|nii_|^\*\*|^\+\+|itk", re.IGNORECASE
)
_MAX_METAIO_LINE = 1000
_LIBRARY_SKEW_DEG = 0.002
"""Skew in degrees from which the header is straightened for ITK, which refuses an sform at about ten times as much."""


@contextmanager
def _library_copy(header: GridHeader, head: bytes) -> Iterator[Path]:
    """Yield a private copy of a header, without values, under a name that the library accepts.

    So the library reads neither the user's path nor a wrong suffix, and does not decompress the values.
    """
    # The NIfTI library and teem require that the file of the values exists, but do not read it.
    stand_in: str | None = None
    suffix = {"nifti": ".nii", "nrrd": ".nrrd", "metaimage": ".mha"}[header.format]
    if header.format == "nifti" and head[344:347] == b"ni1":
        suffix, stand_in = ".hdr", "carina-header.img"
    elif header.format == "nrrd" and header.values_are_elsewhere:
        suffix, stand_in = ".nhdr", header.data_path.name
    elif header.format == "metaimage":
        # MetaIO cannot read long lines; the lines of the geometry are short.
        head = b"".join(text for text in head.splitlines(keepends=True) if len(text) <= _MAX_METAIO_LINE)
    with scratch_folder() as folder:
        named = folder / f"carina-header{suffix}"
        # In NIfTI, four bytes state that no extension follows.
        named.write_bytes(head + bytes(4) if suffix == ".nii" else head)
        if stand_in is not None:
            (folder / stand_in).touch()
        yield named


def _library_grid(path: Path, header: GridHeader, head: bytes) -> NDArray[np.float64]:
    """Return the 4x4 transform from voxel centres to LPS mm as a second library reads it from the header."""
    import SimpleITK as sitk  # slow to load, and the types of a volume do not need it

    reader = sitk.ImageFileReader()
    reader.SetImageIO(_ITK_READERS[header.format])
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    # ITK and its libraries write to stderr; Carina's own checks and messages replace that output.
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        with _library_copy(header, head) as copy, library_path(copy) as name:
            reader.SetFileName(name)
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


@functools.cache
def has_second_reader() -> bool:
    """Return whether SimpleITK is installed (extra ``second-reader``)."""
    return importlib.util.find_spec("SimpleITK") is not None


_NOT_CHECKED = Note(
    "import.not-checked",
    "the geometry in the header was not checked by a second library; carina doctor prints the command that installs it "
    "(SimpleITK)",
)


def _check_agreement(path: Path, header: GridHeader) -> tuple[Note, ...]:
    """Raise an error if a second library reads another geometry from the header; return a note if it is missing."""
    if not has_second_reader():
        return (_NOT_CHECKED,)
    ours, head = header.lps_from_ijk, header.head
    if header.format == "nifti" and skew_deg(ours) > _LIBRARY_SKEW_DEG:
        # ITK reads only an sform with right angles, so it reads the straightened one, and the result is compared with
        # that.
        ours, head = with_orthogonal_axes(ours), head_with_orthogonal_sform(head)
    theirs = _library_grid(path, header, head)
    ni, nj, nk = (n - 1 for n in header.shape_ijk)
    corners = np.array([[i, j, k, 1.0] for i in (0, ni) for j in (0, nj) for k in (0, nk)], dtype=np.float64)
    apart_mm = float(np.linalg.norm(corners @ (ours - theirs).T, axis=1).max())
    # Tolerance of a twentieth of a voxel: float32 headers cause about 1e-4 mm, another interpretation at least a voxel.
    allowed_mm = 0.05 * float(np.linalg.norm(ours[:3, :3], axis=0).min())
    if apart_mm > allowed_mm:
        msg = (
            f"reading {path.name}: two libraries read its header differently and place the voxels {apart_mm:.2f} "
            "mm apart; expected less "
            f"than {allowed_mm:.2f} mm; save it again, for example from 3D Slicer"
        )
        raise VolumeImportError(msg, code="import.geometry.disagree")
    return ()


def read_grid_array(
    path: Path,
    format: str,  # noqa: A002 - the word of the field
    *,
    watch: Watch,
) -> tuple[NDArray[np.generic], GridHeader, tuple[Note, ...]]:
    """Read the numbers of one NIfTI, NRRD or MetaImage file unchanged, with its checked header and notes.

    Parameters
    ----------
    path
        The file.
    format
        ``nifti``, ``nrrd`` or ``metaimage``.
    watch
        Progress and cancellation.

    Returns
    -------
    values, header, notes
        The numbers ``(nz, ny, nx)``, the header and the notes.

    Raises
    ------
    VolumeImportError
        If the header, the data or the geometry cannot be trusted; the message names the file.
    CancelledError
        If the user cancels.
    """
    watch.step("Reading the header")
    header = read_grid_header(path, format)
    values, notes = read_voxels(path, header, watch)
    return values, header, header.notes + notes + _check_agreement(path, header)


def open_grid_file(path: Path, format: str, *, watch: Watch) -> Volume:  # noqa: A002 - the word of the field
    """Open one NIfTI, NRRD or MetaImage file as a volume.

    Raises
    ------
    VolumeImportError
        If the header, the data or the geometry cannot be trusted; the message names the file.
    CancelledError
        If the user cancels.
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
    is_bundle = contains_map(header)
    if is_bundle:
        check_bundle(path, header, converted.values, watch)
    # A scan that was written with its map is stored without padding, and must stay the scan of the map.
    finds_padding = verdict.is_hu and not is_bundle
    hu, padding = without_corner_padding(converted.values) if finds_padding else (converted.values, ())
    watch.step("Converting the values", 1.0)
    return Volume(
        hu,
        header.lps_from_ijk,
        is_hu=reason is None,
        not_hu_reason=reason,
        source=VolumeSource(format=format, title=printable(path.name), notes=notes + converted.notes + padding),
    )
