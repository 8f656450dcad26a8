"""Reader of NIfTI, NRRD, MetaImage and VTI headers, which are checked before a library allocates memory for them.

A false header is refused before any allocation, and the geometry that the library reads must agree with the result.
Sources: nifti1.h (NIfTI-1.1), the NRRD format definition (teem), MetaIO's documentation. Each format has its own
module.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

import numpy as np

from carina.display.escaped_text import shown_value
from carina.volume.axis_angles import has_right_angles, skew_deg
from carina.volume.gzip_stream import Unpacker
from carina.volume.header_fields import GridHeader, HeaderValueError, refuse
from carina.volume.header_metaimage import read_metaimage_header
from carina.volume.header_nifti import read_nifti_header
from carina.volume.header_nrrd import read_nrrd_header
from carina.volume.header_vti import read_vti_header
from carina.volume.model import SPACING_MM

__all__ = ["GRID_FORMATS", "GridHeader", "read_grid_header", "sniff_format"]

GRID_FORMATS = ("nifti", "nrrd", "metaimage", "vti")
"""Names, as :func:`sniff_format` returns them, of the file formats that contain a single volume."""

_GZIP = b"\x1f\x8b"
_MAX_TEXT_HEADER_BYTES = 1 << 20
_OTHER_FORMATS = {
    b"%PDF": "pdf",
    b"PK\x03\x04": "zip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\x00": "xz",
    b"\x28\xb5\x2f\xfd": "zstd",
}


def _head(path: Path, num_bytes: int) -> tuple[bytes, bool]:
    """Return the first bytes of a file, decompressed, and whether gzip compresses the file."""
    with path.open("rb") as file:
        raw = file.read(num_bytes)
        if raw[:2] != _GZIP:
            return raw, False
        file.seek(0)
        head = bytearray()
        try:
            for piece in Unpacker(file, "gzip", chunk_bytes=max(64, num_bytes >> 8)):
                head += piece
                if len(head) >= num_bytes:
                    break
        except ValueError:
            pass  # a stream that is damaged farther on can still be identified by its beginning
    return bytes(head[:num_bytes]), True


def sniff_format(path: Path) -> str | None:
    """Return the format of a file from its first bytes, never from its name; None if the format is unknown.

    The formats in ``GRID_FORMATS`` can be read, all but ``vti`` with or without gzip. Others are returned for
    messages: ``pdf``, ``zip``, ``bzip2``, ``xz``, ``zstd``, ``gzip twice``, ``gzip dicom`` and ``gzip tar`` (an
    archive).
    """
    head, gzipped = _head(path, 4096)
    for start, name in _OTHER_FORMATS.items():
        if head.startswith(start):
            return name
    if head[:4] == b"NRRD":
        return "nrrd"
    if head[:4] in (struct.pack("<i", 348), struct.pack(">i", 348), struct.pack("<i", 540), struct.pack(">i", 540)):
        return "nifti"
    if gzipped and head[:2] == _GZIP:
        return "gzip twice"
    if gzipped and head[128:132] == b"DICM":
        return "gzip dicom"
    if gzipped and head[257:262] == b"ustar":
        return "gzip tar"
    if not gzipped and b"<VTKFile" in head[:1024]:
        return "vti"
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
    except HeaderValueError as error:
        raise refuse(path, str(error), "correct the header, or export it again", "import.header") from None
    except KeyError as error:
        problem = f"its {format} header has no field {shown_value(str(error.args[0]), 40)}"
        raise refuse(path, problem, "correct the header, or export it again", "import.header") from None
    except (ValueError, IndexError, struct.error, OverflowError) as error:
        problem = f"its {format} header does not follow the format ({type(error).__name__})"
        raise refuse(
            path, problem, "the file is damaged or not of this format; export it again", "import.header"
        ) from None
    _check(path, header)
    return header


def _read(path: Path, format: str) -> GridHeader:  # noqa: A002 - the word of the field
    if format == "nifti":
        return read_nifti_header(path, _head(path, 1024)[0])
    if format == "vti":
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            return read_vti_header(path, content)
    text, gzipped = _head(path, _MAX_TEXT_HEADER_BYTES)
    read = read_nrrd_header if format == "nrrd" else read_metaimage_header
    return read(path, text, gzipped=gzipped)


def _check(path: Path, header: GridHeader) -> None:
    """Raise an error if a grid file's header does not describe one rectangular volume with a plausible spacing."""
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
    if not has_right_angles(header.lps_from_ijk, header.shape_ijk):
        problem = (
            f"its axes are sheared: two of them meet at {90 - skew_deg(header.lps_from_ijk):.1f} instead of 90 degrees "
            "(possibly an uncorrected gantry tilt)"
        )
        raise refuse(path, problem, "resample it to a rectangular grid first", "import.geometry.sheared")
