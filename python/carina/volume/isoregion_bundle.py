"""NRRD files that contain a scan and its IsoRegion map: their identification, and the checks when they are opened.

Paper 4.2: "the results can be bundled with the volume". The map is stored before the voxels, and the header tells
readers to skip it (``byte skip``), so that every program opens the file as the scan.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import VolumeImportError
from carina.volume.grid_voxels import read_bytes_before_voxels
from carina.volume.header_fields import GridHeader
from carina.volume.progress import Watch

MAP_FORMAT = "1"
"""Version of the file format of IsoRegion maps (radii of cubes of equal labels)."""
MAP_TAG = "carina-isoregion"
MAP_NOTE = re.compile(rb"carina-isoregion (\d{1,9})(?: ([0-9a-f]{12}) ([0-9a-f]{12}) ([0-9a-f]{12}))?")
"""Note of a map: version of the format, and digests of volume, labels and radii."""
_DIGITS = 12


def short_digest(values: NDArray[np.generic]) -> str:
    """Return the digest of an array as it is written in the note of a map."""
    return str(_core.content_digest(np.ascontiguousarray(values)))[:_DIGITS]


def contains_map(header: GridHeader) -> bool:
    """Return whether the file with this header contains a scan and its IsoRegion map."""
    is_packed = header.format == "nrrd" and header.compression == "gzip" and not header.file_is_gzipped
    has_bytes = not header.values_are_elsewhere and header.data_offset == header.num_voxels
    return is_packed and has_bytes and MAP_NOTE.search(header.head) is not None


def read_bundled_map(path: Path, header: GridHeader, watch: Watch) -> NDArray[np.uint8]:
    """Return the radii (nz, ny, nx) of the IsoRegion map in the file of a scan.

    Raises
    ------
    VolumeImportError
        ``import.truncated``, if the file is damaged.
    CancelledError
        If the user cancels.
    """
    return read_bytes_before_voxels(path, header, watch).reshape(header.shape_ijk[::-1])


def check_bundle(path: Path, header: GridHeader, values_zyx: NDArray[np.int16], watch: Watch) -> None:
    """Check that the voxels and the IsoRegion map of a file are those that were written together.

    A map of a later format is not checked, because its note may have another meaning.

    Raises
    ------
    VolumeImportError
        ``import.isoregion-map``, if voxels or map were changed; ``import.truncated``, if the file is damaged.
    CancelledError
        If the user cancels.
    """
    note = MAP_NOTE.search(header.head)
    assert note is not None
    version, of_volume, _, of_radii = (part.decode() if part else "" for part in note.groups())
    if version != MAP_FORMAT:
        return
    if short_digest(values_zyx) != of_volume:
        problem = "its voxels are not those from which its IsoRegion map was computed"
    elif short_digest(read_bundled_map(path, header, watch)) != of_radii:
        problem = "its IsoRegion map was changed after it was written"
    else:
        return
    msg = (
        f"reading {path.name}: {problem}, so the file is damaged; open the scan from which it was written, or write "
        f"it again with: carina isoregion SCAN -o {path.name} --with-scan"
    )
    raise VolumeImportError(msg, code="import.isoregion-map")
