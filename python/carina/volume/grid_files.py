"""Reader of NIfTI, NRRD, MetaImage and VTI files; two readers of the header must find the same geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.display.escaped_text import printable
from carina.errors import VolumeImportError
from carina.volume.bids_sidecar import stated_thickness_mm
from carina.volume.grid_headers import GridHeader, read_grid_header
from carina.volume.grid_second_reader import read_geometry
from carina.volume.grid_voxels import read_voxels
from carina.volume.hu import judge_values, to_int16
from carina.volume.inserted_structures import marked_structures, with_inserted
from carina.volume.isoregion_bundle import check_bundle, contains_map
from carina.volume.model import Note, Volume, VolumeSource
from carina.volume.padding import without_corner_padding
from carina.volume.progress import Watch
from carina.volume.vti_voxels import read_vti_voxels


def _check_agreement(path: Path, header: GridHeader) -> None:
    """Raise an error if the second reader finds another geometry in the header."""
    try:
        shape_ijk, theirs = read_geometry(header.head, header.format)
    except (ValueError, OverflowError):
        msg = (
            f"reading {path.name}: Carina's two readers of {header.format} headers do not both understand its header; "
            "the file is damaged or unusual; export it again"
        )
        raise VolumeImportError(msg, code="import.header.disagree") from None
    if shape_ijk != header.shape_ijk:
        msg = (
            f"reading {path.name}: expected {header.shape_ijk} voxels, but a second reader of the header found "
            f"{shape_ijk}; export the file again"
        )
        raise VolumeImportError(msg, code="import.header.disagree")
    ours = header.lps_from_ijk
    ni, nj, nk = (n - 1 for n in header.shape_ijk)
    corners = np.array([[i, j, k, 1.0] for i in (0, ni) for j in (0, nj) for k in (0, nk)], dtype=np.float64)
    apart_mm = float(np.linalg.norm(corners @ (ours - theirs).T, axis=1).max())
    # Tolerance of a twentieth of a voxel: float32 headers cause about 1e-4 mm, another interpretation at least a voxel.
    allowed_mm = 0.05 * float(np.linalg.norm(ours[:3, :3], axis=0).min())
    if not apart_mm <= allowed_mm:
        msg = (
            f"reading {path.name}: two readers of its header place the voxels {apart_mm:.2f} mm apart; expected less "
            f"than {allowed_mm:.2f} mm; save it again, for example from 3D Slicer"
        )
        raise VolumeImportError(msg, code="import.geometry.disagree")


def read_grid_array(
    path: Path,
    format: str,  # noqa: A002 - the word of the field
    *,
    watch: Watch,
) -> tuple[NDArray[np.generic], GridHeader, tuple[Note, ...]]:
    """Read the numbers of one grid file unchanged, with its checked header and notes.

    Parameters
    ----------
    path
        The file.
    format
        One of ``GRID_FORMATS``.
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
    _check_agreement(path, header)
    if format == "vti":
        return read_vti_voxels(path, header, watch), header, header.notes
    values, notes = read_voxels(path, header, watch)
    return values, header, header.notes + notes


def open_grid_file(path: Path, format: str, *, watch: Watch) -> Volume:  # noqa: A002 - the word of the field
    """Open one grid file as a volume.

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
    source = VolumeSource(
        format=format,
        title=printable(path.name),
        notes=notes + converted.notes + padding,
        slice_thickness_mm=stated_thickness_mm(path),
    )
    return Volume(
        hu,
        header.lps_from_ijk,
        is_hu=reason is None,
        not_hu_reason=reason,
        source=with_inserted(source, marked_structures(header.head)),
    )
