"""Function ``inspect_path``, which returns facts about a file or folder from its headers, without reading pixels.

The function also describes a file that cannot be opened as a volume.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, file_path, function, text_of
from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CarinaError
from carina.volume.dicom import choose_series
from carina.volume.grid_headers import read_grid_header
from carina.volume.io_errors import guarded
from carina.volume.message_limits import bounded_message
from carina.volume.model import Note, SeriesInfo
from carina.volume.opening import check_exists, find_in, place_name, refuse_series
from carina.volume.progress import Watch
from carina.volume.scan_place import scan_place


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """Content of a file or folder, without pixels, patient names or UIDs."""

    format: str
    """Format of the files: ``dicom``, ``nifti``, ``nrrd`` or ``metaimage``."""
    series: tuple[SeriesInfo, ...]
    """All DICOM series found, the largest chest CT first; empty for other formats."""
    chosen: SeriesInfo | None
    """The series that would be opened; None if there is none."""
    shape_zyx: tuple[int, int, int] | None
    lps_from_ijk: NDArray[np.float64] | None
    """Transform (4x4) from voxel centres to LPS mm; None if nothing can be opened."""
    notes: tuple[Note, ...]
    refused: str | None
    """Reason why nothing can be opened; None if it can."""
    refused_code: str | None

    @property
    def spacing_mm(self) -> tuple[float, float, float] | None:
        """Distance of voxel centres along i, j, k in mm; None if nothing can be opened."""
        if self.lps_from_ijk is None:
            return None
        sx, sy, sz = np.linalg.norm(self.lps_from_ijk[:3, :3], axis=0)
        return float(sx), float(sy), float(sz)

    @property
    def axes(self) -> str | None:
        """Directions of i, j and k, one letter each: L or R, P or A, S or I.

        A letter is lower case if its axis is more than 1 degree oblique.
        """
        if self.lps_from_ijk is None:
            return None
        letters = []
        for column in self.lps_from_ijk[:3, :3].T:
            at = int(np.argmax(np.abs(column)))
            letter = ("LR", "PA", "SI")[at][0 if column[at] > 0 else 1]
            straight = abs(column[at]) >= math.cos(math.radians(1)) * float(np.linalg.norm(column))
            letters.append(letter if straight else letter.lower())
        return "".join(letters)

    def to_json(self) -> dict[str, Any]:
        """Return the facts as plain JSON types, as ``carina info --json`` prints them."""
        return {
            "format": self.format,
            "series": [info.to_json() for info in self.series],
            "chosen": None if self.chosen is None else self.chosen.key,
            "shape_zyx": None if self.shape_zyx is None else list(self.shape_zyx),
            "spacing_mm": None if self.spacing_mm is None else list(self.spacing_mm),
            "axes": self.axes,
            "lps_from_ijk": None if self.lps_from_ijk is None else self.lps_from_ijk.tolist(),
            "warnings": [note.words for note in self.notes],
            "notes": [note.to_json() for note in self.notes],
            "refused": self.refused,
            "refused_code": self.refused_code,
        }


@shows_progress
@check_arguments(path=file_path(), series=text_of(200, optional=True), cancel=function)
def inspect_path(
    path: str | Path,
    *,
    series: str | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Inspection:
    """Return the content of a file or folder according to its headers; takes the same arguments as ``open_volume``.

    Parameters
    ----------
    path, series
        As in ``open_volume``.
    progress
        False, True or ``f(what, fraction)``. True or None shows a progress bar in a terminal or a notebook. The
        fraction is None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Inspection
        The content. For a series that cannot be opened, ``refused`` states the reason.

    Raises
    ------
    VolumeImportError
        If the path contains no image.
    UsageError
        If ``series`` is not the key of a series in the folder.
    CancelledError
        If ``cancel()`` returned true.

    Examples
    --------
    >>> from carina.volume.demo import CASE_PATH
    >>> inspect_path(CASE_PATH).axes
    'LPS'
    """
    watch = Watch(progress_function(progress), cancel)
    return guarded(Path(path).expanduser(), lambda where: _inspect(where, series, watch))


def _inspect(path: Path, key: str | None, watch: Watch) -> Inspection:
    check_exists(path)
    with scan_place(path, watch) as place:
        found = _inspect_place(place.path, key, watch)
        return replace(
            found,
            series=tuple(map(place.series, found.series)),
            notes=tuple(map(place.note, found.notes)),
            refused=None if found.refused is None else place.text(found.refused),
        )


def _inspect_place(path: Path, key: str | None, watch: Watch) -> Inspection:
    found = find_in(path, watch)
    if isinstance(found, str):
        refuse_series(path, found, key)
        header = read_grid_header(path, found)
        ni, nj, nk = header.shape_ijk
        return Inspection(found, (), None, (nk, nj, ni), header.lps_from_ijk, header.notes, None, None)
    infos = tuple(item.info for item in found)
    try:
        chosen, notes = choose_series(found, key=key, where=place_name(path))
    except CarinaError as error:
        if not error.code.startswith("import."):
            raise
        return Inspection("dicom", infos, None, None, None, (), bounded_message(str(error)), error.code)
    return Inspection("dicom", infos, chosen.info, chosen.info.shape_zyx, chosen.lps_from_ijk, notes, None, None)
