"""State of the files of a volume: number, size and time of change, obtained without reading the files."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from carina.display import one_line
from carina.errors import CarinaError
from carina.volume.archives import archive_kind
from carina.volume.dicom_signature import looks_like_dicom
from carina.volume.grid_headers import GRID_FORMATS, read_grid_header, sniff_format
from carina.volume.header_nifti import data_files
from carina.volume.read_limits import MAX_FILES
from carina.volume.scan_place import is_media_directory

Reads = Literal["tree", "folder", "files", "tree around"]
_UNSETTLED_S = 2.0
"""Resolution of file times on FAT, the coarsest file system; a later change within this time may be undetected."""


@one_line
@dataclass(frozen=True, slots=True)
class SourceFiles:
    """State of a volume's files for the detection of changes; contains no path, and names only for single files."""

    reads: Reads
    """``tree``: all files below a folder; ``folder``: all files beside a DICOM file; ``files``: single files.

    ``tree around``: all files beside a DICOMDIR file, and below its folder.
    """
    names: tuple[str, ...]
    """Names of single files in one folder, including missing files that would be read if they existed."""
    num_files: int
    num_bytes: int
    newest_ns: int
    """Time of the latest change of a file, ns since 1970."""
    fingerprint: str
    """Digest of all names, sizes and times."""


@one_line
@dataclass(frozen=True, slots=True)
class CtSource:
    """A path that was opened, with the state of its files.

    The object is created *before* opening, and :attr:`is_unchanged` is read afterwards.
    """

    path: Path = field(repr=False)
    """Absolute path as given by the caller; links are not resolved."""
    series: str | None
    files: SourceFiles

    @classmethod
    def of(cls, path: str | Path, *, series: str | None = None) -> CtSource | None:
        """Return the current state of a path; None if it cannot be read, in which case opening reports the reason.

        Parameters
        ----------
        path
            File or folder of the volume.
        series
            Key of the DICOM series; None for the default series.
        """
        place = absolute(path)
        try:
            return cls(place, series, _file_state(place, *_what_is_read(place)))
        except (OSError, ValueError, CarinaError):
            return None

    def now(self) -> SourceFiles | None:
        """Return the current state of the same files; None if they cannot be accessed."""
        try:
            return _file_state(self.path, self.files.reads, self.files.names)
        except (OSError, ValueError):
            return None

    @property
    def is_unchanged(self) -> bool:
        """Whether size, time and number of all source files are as they were when the CT was read."""
        return self.now() == self.files

    def is_settled(self, now_s: float) -> bool:
        """Return whether the files are so old that any later change changes their time.

        A file that was written less than 2 s ago may change again without a new time.

        Parameters
        ----------
        now_s
            Current time in seconds since 1970.
        """
        return not -_UNSETTLED_S < now_s - self.files.newest_ns / 1e9 < _UNSETTLED_S


def absolute(path: str | Path) -> Path:
    """Return the absolute path of a name without resolving links."""
    return Path(path).expanduser().absolute()


def _what_is_read(path: Path) -> tuple[Reads, tuple[str, ...]]:
    """Return the kind of files that opening a path would read (``Reads``), and the names of single files.

    Raises
    ------
    OSError, ValueError, CarinaError
        If the path cannot be read, or is not a volume.
    """
    if path.is_dir():
        return "tree", ()
    if is_media_directory(path):
        return "tree around", ()
    if looks_like_dicom(path):
        return "folder", ()
    if archive_kind(path) is not None:
        return "files", (path.name,)
    kind = sniff_format(path)
    if kind not in GRID_FORMATS:
        raise ValueError
    found = read_grid_header(path, kind).data_path
    if found == path:
        return "files", (path.name,)
    others = data_files(path) if kind == "nifti" else [found]
    return "files", (path.name, *(other.name for other in others))


def _file_state(path: Path, reads: Reads, names: tuple[str, ...]) -> SourceFiles:
    """Return the current number, sizes and times of the files that opening a path reads.

    Raises
    ------
    OSError
        If the path is missing or cannot be read.
    ValueError
        If there are too many files.
    """
    path.stat()
    found = hashlib.blake2b(digest_size=20)
    num_files = num_bytes = newest_ns = 0
    for name, place in _list_files(path, reads, names):
        num_files += 1
        if num_files > MAX_FILES:
            raise ValueError
        try:
            seen = place.stat()
            size, time_ns = seen.st_size, seen.st_mtime_ns
        except OSError:
            size = time_ns = -1  # a missing file or broken link has this state
        found.update(os.fsencode(name) + f"\0{size}\0{time_ns}\n".encode())
        num_bytes += max(0, size)
        newest_ns = max(newest_ns, time_ns)
    return SourceFiles(reads, names, num_files, num_bytes, newest_ns, found.hexdigest())


def _list_files(path: Path, reads: Reads, names: tuple[str, ...]) -> Iterator[tuple[str, Path]]:
    if reads == "files":
        yield from ((name, path.with_name(name)) for name in names)
        return

    def refused(error: OSError) -> None:
        raise error

    base = path if reads == "tree" else path.parent
    for root, folders, files in os.walk(base, onerror=refused):
        folders.sort()
        if reads == "folder":
            folders.clear()
        for name in sorted(files):
            place = Path(root) / name
            yield str(place.relative_to(base)), place
