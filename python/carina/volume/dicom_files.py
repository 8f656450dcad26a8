"""Which files of a folder are slices, and which look like slices and could not be used.

A file that is empty, cut, unreadable or not allowed to be read vanishes from a stack without a trace when it lies at an
end. So everything that was not used is kept with its reason, and ``LostFiles`` says which of it looks like a part
of a series. Reports, directory files, documents and slices of other series are no such files.
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
from carina.volume.dicom_headers import SliceHeader, read_header
from carina.volume.dicom_start import starts_like_dicom
from carina.volume.limits import MAX_FILES
from carina.volume.message_limits import bounded_name
from carina.volume.watch import Watch

__all__ = ["FolderContent", "LostFiles", "UnusedFile", "name_files", "read_folder", "read_headers", "shown_name"]

_MAX_LOOKS = 1_000_000  # at lost files for all series together; the time must not grow with their product
_MAX_SAID = 100

# Many exporters name files by their UID; a volume carries none, not even inside a sentence.
_UID_NAME = re.compile(r"[\w.-]*\d+(?:\.\d+){4,}[\w.-]*")
_RUNS = re.compile(r"[0-9A-Fa-f]{8,}|\d+")
_IMAGE_CLASSES = tuple(
    f"1.2.840.10008.5.1.4.1.1.{kind}" for kind in ("2", "2.1", "2.2", "4", "4.1", "7", "20", "128", "130")
)
_SCAN_MODALITIES = ("CT", "MR", "PT", "NM")
# What a document or an archive begins with; of these only a file named like a slice counts as a lost one.
_KNOWN_STARTS = (b"%PDF", b"PK\x03\x04", b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"\x1f\x8b", b"BM", b"<", b"{", b"NRRD")


@dataclass(frozen=True, slots=True)
class UnusedFile:
    """A file that is no slice, or could not be read as one. Never printed: it may hold a UID."""

    path: Path
    reason: str
    """For a message, such as "empty" or "truncated header"."""
    size: int
    is_dicom: bool
    """It begins like DICOM, or is a folder of which nothing is known."""
    known: bool = False
    """It begins like a document or an archive."""
    series_uid: str = field(default="", repr=False)
    """Where this much could be read."""


@dataclass(frozen=True, slots=True)
class FolderContent:
    """The images of a folder and what else may have been one."""

    headers: tuple[SliceHeader, ...]
    unused: tuple[UnusedFile, ...]


def _walk(folder: Path, unused: list[UnusedFile], *, recursive: bool, watch: Watch) -> Iterator[Path]:
    count = 0

    def refused(error: OSError) -> None:
        unused.append(UnusedFile(Path(error.filename), "a folder that cannot be opened", 0, is_dicom=True))

    # followlinks stays off: a link to a parent would never end.
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


def _read(path: Path) -> SliceHeader | UnusedFile | None:
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
        header, dataset = read_header(path)
        if header is not None or _holds_no_scan(dataset):
            return header
        uid = str(dataset.get("SeriesInstanceUID") or "")
    except Exception:
        # ``read_header`` raises ValueError, and pydicom many kinds on a damaged value.
        return UnusedFile(path, "damaged DICOM file", _size(path), is_dicom=True)
    return UnusedFile(path, "truncated header", _size(path), is_dicom=True, series_uid=uid)


def read_folder(folder: Path, *, recursive: bool, watch: Watch) -> FolderContent:
    """Read the headers of all DICOM images in a folder, and remember every file that was not used.

    Raises
    ------
    VolumeImportError
        If the folder holds implausibly many files.
    CancelledError
        If the person cancels.
    """
    headers: list[SliceHeader] = []
    unused: list[UnusedFile] = []
    paths = list(_walk(folder, unused, recursive=recursive, watch=watch))
    for index, path in enumerate(paths):
        watch.step("Reading the headers", index / len(paths))
        found = _read(path)
        if isinstance(found, SliceHeader):
            headers.append(found)
        elif found is not None:
            unused.append(found)
    return FolderContent(tuple(headers), tuple(unused))


def read_headers(folder: Path, *, recursive: bool, watch: Watch) -> list[SliceHeader]:
    """Return the headers of a folder's slices alone; all other files are skipped."""
    return list(read_folder(folder, recursive=recursive, watch=watch).headers)


def _shape(name: str) -> str:
    """Return a name without its numbers: ``IM003.dcm`` and ``IM104.dcm`` are alike."""
    return _RUNS.sub("#", name).casefold()


def _suffix(name: str) -> str:
    suffix = Path(name).suffix.casefold()
    return suffix if any(c.isalpha() for c in suffix) else ""


class LostFiles:
    """The files of a folder that could not be used, ready to be asked which of them belong to a series."""

    def __init__(self, content: FolderContent) -> None:
        self._by_folder: dict[Path, list[UnusedFile]] = {}
        self._by_parent: dict[Path, list[UnusedFile]] = {}
        for file in content.unused:
            self._by_folder.setdefault(file.path.parent, []).append(file)
            self._by_parent.setdefault(file.path.parent.parent, []).append(file)
        self._looks_left = _MAX_LOOKS
        self._closed = [file for file in content.unused if file.path.is_dir()]
        self._shapes = {_shape(header.path.name) for header in content.headers} if content.unused else set()

    def beside(self, slices: Sequence[SliceHeader]) -> list[UnusedFile]:
        """Return the files that look like a part of a series, in the order of their names.

        They lie in its folder (or, where it lies in several, in one beside these) and begin like DICOM, or are named
        like its slices, or are as large as these. A name like that of another series is that one's.
        """
        if not self._by_folder:
            return []
        folders = {header.path.parent for header in slices}
        near = [file for folder in folders for file in self._by_folder.get(folder, ())]
        if len(folders) > 1:
            near += [file for parent in {f.parent for f in folders} for file in self._by_parent.get(parent, ())]
        if not near:
            return list(self._closed)
        self._looks_left -= len(near)
        if self._looks_left < 0:  # thousands of series in one folder: better too many said than none
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

        # Nobody knows what is in a folder that cannot be opened.
        found = {file.path: file for file in (*self._closed, *filter(belongs, near))}
        return [found[path] for path in sorted(found)]


def shown_name(path: Path) -> str:
    """Return a file's name as a volume may have it; a name made of a UID is reduced to its last digits."""
    name = path.name
    return f"...{name[-8:]}" if _UID_NAME.search(name) else bounded_name(name)


def name_files(files: Sequence[tuple[Path, str]], *, at_most: int = 4) -> str:
    """Return the first few files with a word each: "IM012 (empty), IM013 (not DICOM) and 7 more"."""
    shown = [f"{shown_name(path)} ({word})" if word else shown_name(path) for path, word in files[:at_most]]
    more = len(files) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")
