"""Function ``open_volume``, which opens a file or folder according to its content, not its name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from carina.argument_checks import check_arguments, file_path, function, text_of
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import UsageError, VolumeImportError, check_type
from carina.volume.dicom_signature import looks_like_dicom
from carina.volume.grid_files import open_grid_file
from carina.volume.grid_headers import GRID_FORMATS, sniff_format
from carina.volume.io_errors import guarded
from carina.volume.model import Volume
from carina.volume.opening_preview import OpeningPreview, preview_listener
from carina.volume.progress import Watch
from carina.volume.scan_place import ScanPlace, scan_place

# The DICOM readers are loaded at first use, so that grid files and the start page do not load their libraries.
if TYPE_CHECKING:
    from carina.volume.dicom import FoundSeries
    from carina.volume.dicom_files import FolderContent

_KINDS = (
    "a DICOM folder, NIfTI (.nii, .nii.gz), NRRD (.nrrd), MetaImage (.mha, .mhd) or an archive (.zip, .tar.gz, .7z)"
)
_GRID_SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd", ".vti")


@shows_progress
@check_arguments(path=file_path(), series=text_of(200, optional=True), cancel=function)
def open_volume(
    path: str | Path,
    *,
    series: str | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Volume:
    """Open a chest CT: a DICOM folder (or one of its files), a NIfTI, NRRD or MetaImage file, or an archive of them.

    Parameters
    ----------
    path
        Folders are searched with all their subfolders; files need no extension. One DICOM file selects its series in
        its folder; a DICOMDIR file selects its folder. A zip, tar or 7z archive is opened like a folder: its files are
        unpacked into a private temporary folder, which is removed after reading.
    series
        Key of the DICOM series to open (``SeriesInfo.key``). None opens the largest chest CT, and ``source.notes`` list
        the other series.
    progress
        False, True or ``f(what, fraction)``. True or None shows a progress bar in a terminal or a notebook. The
        fraction is None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Volume
        int16 ``[z, y, x]`` with axes in the file's order, LPS mm. ``is_hu`` is false, with a reason, if the values are
        not HU.

    Raises
    ------
    VolumeImportError
        If the file or series cannot be opened: the message states its name, the expected and the found content, and a
        remedy. The code begins with ``import.``.
    UsageError
        If ``series`` is not the key of a series in the folder.
    CancelledError
        If ``cancel()`` returned true.

    See Also
    --------
    carina.find_airways : find the airways in the volume.
    carina.render_view : render a picture of the volume.

    Examples
    --------
    >>> from carina.volume import demo_patient
    >>> demo_patient().is_hu
    True
    """
    check_type("open_volume", "path", path, (str, Path), "name a folder or a file")
    watch = Watch(progress_function(progress), cancel)
    return guarded(Path(path).expanduser(), lambda where: _open(where, series, watch))


def check_exists(path: Path) -> None:
    """Raise the error of a missing scan if there is no file or folder at its path."""
    if not path.exists():
        msg = f"reading {path.name}: there is no such file or folder; expected {_KINDS}; check the path {path}"
        raise VolumeImportError(msg, code="import.not-found")


def find_in(path: Path, watch: Watch) -> list[FoundSeries] | str:
    """Return the DICOM series at a path, best first, or the format of the grid file at the path.

    Raises
    ------
    VolumeImportError
        If the path contains neither.
    """
    check_exists(path)
    if path.is_dir():
        from carina.volume.dicom import find_series
        from carina.volume.dicom_files import read_folder

        content = read_folder(path, recursive=True, watch=watch)
        if not content.headers:
            raise _no_images(path, content)
        return find_series(content, watch)
    if not path.is_file():
        msg = f"reading {path.name}: it is neither a file nor a folder; expected {_KINDS}"
        raise VolumeImportError(msg, code="import.not-an-image")
    if looks_like_dicom(path):
        return _series_of_file(path, watch)
    kind = sniff_format(path)
    if kind in GRID_FORMATS:
        return kind
    raise VolumeImportError(f"reading {path.name}: {_not_an_image(path, kind)}", code="import.not-an-image")


def _not_an_image(path: Path, kind: str | None) -> str:
    """Return a message that states what a file is instead of an image volume, with a remedy."""
    match kind:
        case "pdf":
            return f"it is a PDF document, not an image volume; open {_KINDS}"
        case "zip":
            return "it is a ZIP archive, which cannot be opened directly; unpack it and open the folder"
        case "gzip tar":
            return "it is a packed archive (.tar.gz), which cannot be opened directly; unpack it and open the folder"
        case "gzip dicom":
            return "it is a DICOM file packed by gzip; unpack the whole series and open its folder"
        case "gzip twice":
            return "it is packed twice by gzip; unpack it once (gunzip) and open the result"
        case "bzip2" | "xz" | "zstd":
            return f"it is packed by {kind}, which is not supported; unpack it and open the result"
    if path.stat().st_size == 0:
        return f"it is empty; open {_KINDS}"
    return f"it is not an image volume in a format that Carina can read; open {_KINDS}"


def _open(path: Path, series: str | None, watch: Watch) -> Volume:
    check_exists(path)
    with scan_place(path, watch) as place:
        return place.volume(_open_place(place, series, watch))


def _open_place(place: ScanPlace, series: str | None, watch: Watch) -> Volume:
    path = place.path
    found = find_in(path, watch)
    if isinstance(found, str):
        refuse_series(path, found, series)
        return open_grid_file(path, found, watch=watch)
    from carina.volume.dicom import choose_series, open_series

    chosen, notes = choose_series(found, key=series, where=place_name(path))
    watch.step("Reading the slices", 0.0)
    _report_preview(place, found, chosen)
    others = [item.info for item in found if item is not chosen]
    return open_series(chosen, others=others, notes=notes, watch=watch)


def _report_preview(place: ScanPlace, found: Sequence[FoundSeries], chosen: FoundSeries) -> None:
    """Pass the series of the folder, and then a slice of the chosen one, to the listener if there is one."""
    listener = preview_listener()
    if listener is None:
        return
    from carina.volume.dicom_series import count_patients
    from carina.volume.series_pictures import preview_slice

    num_patients = count_patients([header for series in found for header in series.slices])
    infos = tuple(place.series(series.info) for series in found)
    preview = OpeningPreview(infos, chosen.info.key, num_patients, tuple(found))
    listener(preview)
    listener(replace(preview, slice=preview_slice(chosen)))


def refuse_series(path: Path, kind: str, series: str | None) -> None:
    """Raise an error if a series is requested from a file that contains one volume.

    Ignoring the request could show another patient's scan.

    Raises
    ------
    UsageError
        ``usage.series``.
    """
    if series is not None:
        msg = f"{path.name} is a single {kind} volume and has no series {series!r}; omit the series"
        raise UsageError(msg, code="usage.series")


def place_name(path: Path) -> str:
    """Return the name of a folder, or of a file's folder, for messages."""
    return f"the folder {(path if path.is_dir() else path.parent).resolve().name}"


def _series_of_file(path: Path, watch: Watch) -> list[FoundSeries]:
    """Return the series of a DICOM file, from the files in its folder."""
    from carina.volume.dicom import find_series
    from carina.volume.dicom_files import read_folder

    content = read_folder(path.parent, recursive=False, watch=watch)
    own = next((header for header in content.headers if header.path.name == path.name), None)
    if own is None:
        msg = (
            f"reading {path.name}: it is a DICOM file without an image (such as a report, structure set or "
            "directory file); "
            "open the folder of the scan"
        )
        raise VolumeImportError(msg, code="import.no-images")
    # The file may be a copy that was removed from the series, so a slice with the same identity counts too.
    return [
        item
        for item in find_series(content, watch)
        if any(h.path == own.path or h.image_key == own.image_key for h in item.slices)
    ]


def _no_images(folder: Path, content: FolderContent) -> VolumeImportError:
    """Return the error for a folder without usable DICOM images."""
    damaged = [file for file in content.unused if file.is_dicom]
    if damaged:
        shown = ", ".join(f"{file.path.name} ({file.reason})" for file in damaged[:4])
        more = f" and {len(damaged) - 4} more" if len(damaged) > 4 else ""
        msg = (
            f"reading the folder {folder.name}: none of its images can be used: {shown}{more}; expected the slices of "
            "a chest CT; copy the folder again"
        )
        return VolumeImportError(msg, code="import.no-images")
    names = sorted(
        entry.name for entry in folder.iterdir() if entry.is_file() and entry.name.lower().endswith(_GRID_SUFFIXES)
    )
    if names:
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        msg = (
            f"reading the folder {folder.name}: it contains no DICOM images, but {shown}; open one of these files "
            "itself"
        )
    else:
        msg = (
            f"reading the folder {folder.name}: it contains no DICOM images; expected the slices of a chest CT; choose "
            "the folder of the scan"
        )
    return VolumeImportError(msg, code="import.no-images")
