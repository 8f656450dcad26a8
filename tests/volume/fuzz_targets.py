"""Functions that the import fuzzer calls with mutated bytes: each answers with a scan or with an error of Carina.

Any other exception is a finding. ``tools/fuzz_import.py`` mutates the bytes; ``test_fuzz_corpus.py`` repeats the stored
inputs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from carina.errors import CarinaError
from carina.volume.archives import archive_kind, unpacked_archive
from carina.volume.dicom_geometry import grid_from_slices
from carina.volume.dicom_headers import read_image_headers
from carina.volume.dicom_pixels import decode_slice, is_compressed
from carina.volume.grid_files import open_grid_file
from carina.volume.grid_headers import GRID_FORMATS, sniff_format
from carina.volume.progress import Watch

__all__ = ["TARGETS", "fuzz_archives", "fuzz_dicom", "fuzz_grids"]

_MAX_FRAMES = 8


def fuzz_grids(data: bytes, folder: Path) -> None:
    """Open a NIfTI, NRRD, MetaImage or VTI file."""
    path = folder / "scan"
    path.write_bytes(data)
    try:
        kind = sniff_format(path)
        if kind in GRID_FORMATS:
            open_grid_file(path, kind, watch=Watch(None, None))
    except CarinaError:
        return


def fuzz_dicom(data: bytes, folder: Path) -> None:
    """Read the headers of a DICOM file, the grid of its frames, and their uncompressed pixels.

    Compressed pixels are decoded by GDCM, whose code this fuzzer does not examine.
    """
    path = folder / "scan"
    path.write_bytes(data)
    try:
        headers, _ = read_image_headers(path)
        good = [header for header in headers if header.problem is None]
        if good:
            grid_from_slices(good, what="reading a series")
    except CarinaError:
        good = []
    except ValueError:
        return  # the caller lists the file as unreadable
    for header in good[:_MAX_FRAMES]:
        if not is_compressed(header):
            try:
                decode_slice(header)
            except CarinaError:
                return


def fuzz_archives(data: bytes, folder: Path) -> None:
    """Unpack an archive."""
    path = folder / "scan.bin"
    path.write_bytes(data)
    kind = archive_kind(path)
    if kind is None:
        return
    try:
        with unpacked_archive(path, kind, Watch(None, None)):
            pass
    except CarinaError:
        return


Target = Callable[[bytes, Path], None]
TARGETS: dict[str, Target] = {"grids": fuzz_grids, "dicom": fuzz_dicom, "archives": fuzz_archives}
"""Functions by the name of their corpus, ``fuzz_corpus/NAME.zip``."""


def once(target: str, data: bytes) -> None:
    """Call a target with an empty folder, which is removed."""
    with tempfile.TemporaryDirectory(prefix="carina-fuzz-") as folder:
        TARGETS[target](data, Path(folder))
