"""Search of a folder for slices, and for files that look like slices and could not be used.

If an empty, truncated or unreadable file is the first or last slice of a stack, the stack shows no gap. Every unused
file is therefore recorded with the reason, and ``LostFiles`` finds those that look like a part of a series. Reports,
directory files, documents and slices of other series do not count as lost.
"""

from __future__ import annotations

import os
import re
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pydicom.dataset import Dataset

from carina.disk import special_kind
from carina.errors import VolumeImportError
from carina.volume.dicom_header_batches import headers_in_batches
from carina.volume.dicom_headers import SliceHeader, read_image_headers
from carina.volume.dicom_signature import starts_like_dicom
from carina.volume.message_limits import bounded_name
from carina.volume.progress import Watch
from carina.volume.read_limits import MAX_FILES

_MAX_COMPARISONS = (
    1_000_000  # Largest number of comparisons of lost files with slices, for all series; it limits the time.
)
_MAX_SAID = 100

# Many exporters use UIDs as file names. A volume contains no UID, not even in a message.
_UID_NAME = re.compile(r"[\w.-]*\d+(?:\.\d+){4,}[\w.-]*")
_RUNS = re.compile(r"[0-9A-Fa-f]{8,}|\d+")
_IMAGE_CLASSES = tuple(
    f"1.2.840.10008.5.1.4.1.1.{kind}" for kind in ("2", "2.1", "2.2", "4", "4.1", "4.4", "7", "20", "128", "130")
)
_SCAN_MODALITIES = ("CT", "MR", "PT", "NM")
# First bytes of documents and archives; such a file counts as lost only if it is named like a slice.
_KNOWN_STARTS = (b"%PDF", b"PK\x03\x04", b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"\x1f\x8b", b"BM", b"<", b"{", b"NRRD")


@dataclass(frozen=True, slots=True)
class UnusedFile:
    """A file that is not a slice, or could not be read as one; never logged, because it may contain a UID."""

    path: Path
    reason: str
    """Reason why the file was not used, for messages, such as "empty" or "truncated header"."""
    size: int
    is_dicom: bool
    """Whether the file begins like a DICOM file, or its beginning could not be recognised."""
    known: bool = False
    """Whether the file begins like a document or an archive of a known format."""
    series_uid: str = field(default="", repr=False)
    """UID of the series; empty if it could not be read."""


@dataclass(frozen=True, slots=True)
class FolderContent:
    """The images of a folder, and the files that could not be used."""

    headers: tuple[SliceHeader, ...]
    unused: tuple[UnusedFile, ...]


def _walk(folder: Path, unused: list[UnusedFile], *, recursive: bool, watch: Watch) -> Iterator[Path]:
    """Yield the paths of all files in a folder; add folders and links that cannot be read to ``unused``."""
    count = 0

    def refused(error: OSError) -> None:
        unused.append(UnusedFile(Path(error.filename), "a folder that cannot be opened", 0, is_dicom=True))

    # followlinks is off, because a link to a parent folder would cause an endless loop.
    for root, folders, files in os.walk(folder, onerror=refused):
        watch.step("Looking for images")
        folders.sort()
        if not recursive:
            folders.clear()
        for name in sorted(files):
            count += 1
            if count > MAX_FILES:
                msg = (
                    f"reading the folder {folder.name}: it contains more than {MAX_FILES} files; expected those of "
                    "one scan; choose the folder of the scan itself"
                )
                raise VolumeImportError(msg, code="import.too-many-files")
            path = Path(root) / name
            if path.is_file():
                yield path
            elif path.is_symlink():
                unused.append(UnusedFile(path, "a link to a missing file", 0, is_dicom=False))


def files_below(path: Path, *, watch: Watch) -> Iterator[Path]:
    """Yield a file, or all files in a folder and its subfolders; links to missing files are left out."""
    if path.is_file():
        yield path
    else:
        yield from _walk(path, [], recursive=True, watch=watch)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _holds_no_scan(dataset: Dataset) -> bool:
    """Return whether a DICOM file states that it is not a slice: a report, a plan, a segmentation, a directory."""
    meta = getattr(dataset, "file_meta", None)
    kind = str(dataset.get("SOPClassUID") or getattr(meta, "MediaStorageSOPClassUID", "") or "")
    if kind:
        return kind not in _IMAGE_CLASSES
    return str(dataset.get("Modality") or "CT") not in _SCAN_MODALITIES


def _read(path: Path) -> list[SliceHeader] | UnusedFile:
    """Return the headers of a file's images, or the reason why a file is unusable.

    The list is empty for a DICOM file without an image.
    """
    if special_kind(path) is not None:
        return UnusedFile(path, "not a file", 0, is_dicom=False)
    try:
        with path.open("rb") as file:
            head = file.read(132)
    except PermissionError:
        return UnusedFile(path, "no permission to read it", _size(path), is_dicom=False)
    except OSError as error:
        return UnusedFile(
            path, (f"the disk reported an error: {error.strerror or 'unknown'}"), _size(path), is_dicom=False
        )
    if not starts_like_dicom(head):
        reason = "empty" if not head else "not DICOM"
        return UnusedFile(path, reason, _size(path), is_dicom=False, known=head.startswith(_KNOWN_STARTS))
    try:
        headers, dataset = read_image_headers(path)
        if headers or _holds_no_scan(dataset):
            return headers
        uid = str(dataset.get("SeriesInstanceUID") or "")
    except Exception:
        # ``read_image_headers`` raises ValueError, and pydicom raises various errors for a damaged value.
        return UnusedFile(path, "damaged DICOM file", _size(path), is_dicom=True)
    return UnusedFile(path, "truncated header", _size(path), is_dicom=True, series_uid=uid)


def read_folder(folder: Path, *, recursive: bool, watch: Watch) -> FolderContent:
    """Read the headers of all DICOM images in a folder, and record every file that was not used.

    Parameters
    ----------
    folder
        The folder to search.
    recursive
        Whether to search the subfolders too.
    watch
        Progress and cancellation.

    Raises
    ------
    VolumeImportError
        If the folder contains implausibly many files.
    CancelledError
        If the user cancels.
    """
    headers: list[SliceHeader] = []
    unused: list[UnusedFile] = []
    paths = list(_walk(folder, unused, recursive=recursive, watch=watch))
    for index, (path, header) in enumerate(headers_in_batches(paths)):
        watch.step("Reading the headers", index / len(paths))
        found = _read(path) if header is None else [header]
        if isinstance(found, UnusedFile):
            unused.append(found)
        else:
            headers.extend(found)
    return FolderContent(tuple(headers), tuple(unused))


def read_headers(folder: Path, *, recursive: bool, watch: Watch) -> list[SliceHeader]:
    """Return the headers of a folder's slices; all other files are ignored."""
    return list(read_folder(folder, recursive=recursive, watch=watch).headers)


def _shape(name: str) -> str:
    """Return a file name with its numbers replaced, so that ``IM003.dcm`` and ``IM104.dcm`` give the same result."""
    return _RUNS.sub("#", name).casefold()


def _suffix(name: str) -> str:
    suffix = Path(name).suffix.casefold()
    return suffix if any(c.isalpha() for c in suffix) else ""


class LostFiles:
    """The unused files of a folder, with a search for those that belong to a series."""

    def __init__(self, content: FolderContent) -> None:
        self._by_folder: dict[Path, list[UnusedFile]] = {}
        self._by_parent: dict[Path, list[UnusedFile]] = {}
        for file in content.unused:
            self._by_folder.setdefault(file.path.parent, []).append(file)
            self._by_parent.setdefault(file.path.parent.parent, []).append(file)
        self._comparisons_left = _MAX_COMPARISONS
        self._closed = [file for file in content.unused if file.path.is_dir()]
        self._shapes = {_shape(header.path.name) for header in content.headers} if content.unused else set()

    def files_like(self, slices: Sequence[SliceHeader]) -> list[UnusedFile]:
        """Return the unused files that look like a part of a series, sorted by name.

        Such a file is in a folder of the series (or, if the series has several folders, in one next to them), and
        begins like DICOM, is named like the slices, or has their size. A file that is named like another series belongs
        to that series.
        """
        if not self._by_folder:
            return []
        folders = {header.path.parent for header in slices}
        near = [file for folder in folders for file in self._by_folder.get(folder, ())]
        if len(folders) > 1:
            near += [file for parent in {f.parent for f in folders} for file in self._by_parent.get(parent, ())]
        if not near:
            return list(self._closed)
        self._comparisons_left -= len(near)
        # With thousands of series in one folder, too many files are reported rather than none.
        if self._comparisons_left < 0:
            return [*self._closed, *near[:_MAX_SAID]]
        uids = {header.series_uid for header in slices}
        shapes = {_shape(header.path.name) for header in slices}
        suffixes = {_suffix(header.path.name) for header in slices} - {""}
        size = statistics.median(_size(header.path) for header in slices)

        def belongs(file: UnusedFile) -> bool:
            name = file.path.name
            if name.startswith(".") or (file.series_uid and file.series_uid not in uids):
                return False
            shape = _shape(name)
            if shape in shapes or shape in self._shapes:
                return shape in shapes
            if file.is_dicom or _suffix(name) in suffixes:
                return True
            return not file.known and file.size > 2048 and abs(file.size - size) <= 0.01 * size

        # The content of an unreadable folder is unknown, so the folder is always reported.
        found = {file.path: file for file in (*self._closed, *filter(belongs, near))}
        return [found[path] for path in sorted(found)]


def shown_name(path: Path) -> str:
    """Return a file's name in the form that a volume may contain; of a UID only the last characters stay."""
    name = path.name
    return f"...{name[-8:]}" if _UID_NAME.search(name) else bounded_name(name)


def name_files(files: Sequence[tuple[Path, str]], *, at_most: int = 4) -> str:
    """Return the names of the first few files with a reason each: "IM012 (empty), IM013 (not DICOM) and 7 more".

    A file with several frames is named once.
    """
    files = list(dict.fromkeys(files))
    shown = [f"{shown_name(path)} ({word})" if word else shown_name(path) for path, word in files[:at_most]]
    more = len(files) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")
