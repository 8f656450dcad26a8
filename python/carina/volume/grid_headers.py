"""What the header of a NIfTI, NRRD or MetaImage file claims, read by ourselves before a library takes memory for it.

A lying header is refused while it is still only text, and the geometry that the library finds must agree with ours.
Sources: nifti1.h (NIfTI-1.1), the NRRD format definition (teem), MetaIO's documentation. Each format has a module of
its own.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from carina.volume.grid_claim import GridHeader, refuse
from carina.volume.header_metaimage import read_metaimage_header
from carina.volume.header_nifti import read_nifti_header
from carina.volume.header_nrrd import read_nrrd_header
from carina.volume.model import SPACING_MM
from carina.volume.unpacking import Unpacker

__all__ = ["GridHeader", "read_grid_header", "sniff_format"]


def _head(path: Path, num_bytes: int) -> bytes:
    with path.open("rb") as file:
        raw = file.read(num_bytes)
        if raw[:2] != b"\x1f\x8b":
            return raw
        file.seek(0)
        head = b""
        try:
            for piece in Unpacker(file, "gzip", chunk_bytes=64):
                head += piece
                if len(head) >= num_bytes:
                    break
        except ValueError:
            pass  # where the stream is damaged further on, its beginning still says what it is
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
        ``import.header`` (does not follow the format; ``.twice``, ``.offset``, ``.scaling``), ``import.not-3d``,
        ``import.single-slice``, ``import.geometry.spacing``, ``.sheared``, ``.orientation-unknown``, ``.ambiguous``,
        ``import.not-supported``, ``import.elsewhere`` or ``import.not-found``.
    """
    try:
        header = _read(path, format)
    except (ValueError, IndexError, KeyError, struct.error, UnicodeError, OverflowError) as error:
        problem = f"its {format} header does not follow the format ({type(error).__name__})"
        raise refuse(
            path, problem, "the file is damaged or not of this format; export it again", "import.header"
        ) from None
    _check(path, header)
    return header


def _read(path: Path, format: str) -> GridHeader:  # noqa: A002 - the word of the field
    if format == "nifti":
        return read_nifti_header(path, _head(path, 1024))
    return read_nrrd_header(path) if format == "nrrd" else read_metaimage_header(path)


def _check(path: Path, header: GridHeader) -> None:
    if len(header.shape_ijk) != 3 or header.num_components != 1:
        values = f" with {header.num_components} values in each voxel" if header.num_components != 1 else ""
        problem = f"expected one volume with three axes, found {header.sizes}{values}"
        raise refuse(path, problem, "save each volume as a separate file", "import.not-3d")
    if min(header.shape_ijk) < 1:
        problem = f"its header claims {header.shape_ijk} voxels; every axis needs at least one"
        raise refuse(path, problem, "the file is damaged; export it again", "import.header")
    if min(header.shape_ijk) < 2:
        problem = f"it is a single image of {header.sizes} voxels; expected a stack of slices"
        raise refuse(path, problem, "open the whole scan", "import.single-slice")
    columns = header.lps_from_ijk[:3, :3]
    spacing = np.linalg.norm(columns, axis=0) if np.isfinite(header.lps_from_ijk).all() else np.array([np.nan])
    if not np.isfinite(spacing).all() or spacing.min() < SPACING_MM[0] or spacing.max() > SPACING_MM[1]:
        found = ", ".join(f"{s:g}" for s in spacing)
        problem = f"its voxel spacing should be between {SPACING_MM[0]:g} and {SPACING_MM[1]:g} mm; found {found} mm"
        raise refuse(path, problem, "export it again with its spacing, in mm", "import.geometry.spacing")
    cosines = (columns / spacing).T @ (columns / spacing)
    skew_deg = float(np.degrees(np.arcsin(min(1.0, np.abs(cosines - np.eye(3)).max()))))
    if skew_deg > 0.2:  # as for the tilt of a DICOM series
        problem = (
            f"its axes are sheared: two of them meet at {90 - skew_deg:.1f} instead of 90 degrees "
            "(possibly an uncorrected gantry tilt)"
        )
        raise refuse(path, problem, "resample it to a rectangular grid first", "import.geometry.sheared")
