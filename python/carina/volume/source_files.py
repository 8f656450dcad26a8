"""The files that a volume is read from: how many, how large, when they were written. Asked without reading them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from carina.display import one_line
from carina.errors import CarinaError
from carina.volume.dicom_start import looks_like_dicom
from carina.volume.grid_headers import read_grid_header, sniff_format
from carina.volume.header_nifti import data_files
from carina.volume.limits import MAX_FILES

__all__ = ["CtSource", "SourceFiles"]

Reads = Literal["tree", "folder", "files"]
_UNSETTLED_S = 2.0
"""The coarsest clock of a file system (FAT): what was written less than this ago may be written again unnoticed."""


@one_line
@dataclass(frozen=True, slots=True)
class SourceFiles:
    """What tells whether the files of a volume are as they were. Holds no path, and of a grid file two names."""

    reads: Reads
    """Everything below a folder, everything in the folder of a DICOM file, or single files."""
    names: tuple[str, ...]
    """Of single files, in one folder; also of such that would be read if they were there."""
    num_files: int
    num_bytes: int
    newest_ns: int
    """When the newest was written, ns since 1970."""
    fingerprint: str
    """Of all names, sizes and times."""


@one_line
@dataclass(frozen=True, slots=True)
class CtSource:
    """What was opened, and the files that were there. Take it *before* opening: :attr:`is_unchanged` afterwards."""

    path: Path = field(repr=False)
    """Absolute, as it was named: a link stays a link."""
    series: str | None
    files: SourceFiles

    @classmethod
    def of(cls, path: str | Path, *, series: str | None = None) -> CtSource | None:
        """What lies at a path; None where that cannot be said (opening it says why)."""
        place = absolute(path)
        try:
            return cls(place, series, _look(place, *_what_is_read(place)))
        except (OSError, ValueError, CarinaError):
            return None

    def now(self) -> SourceFiles | None:
        """The same files as they are now; None where one cannot be reached."""
        try:
            return _look(self.path, self.files.reads, self.files.names)
        except (OSError, ValueError):
            return None

    @property
    def is_unchanged(self) -> bool:
        """Size, time and number of all files are as they were."""
        return self.now() == self.files

    def is_settled(self, now_s: float) -> bool:
        """Whether a later change of a file shows in its time: not where one was written just now."""
        return not -_UNSETTLED_S < now_s - self.files.newest_ns / 1e9 < _UNSETTLED_S


def absolute(path: str | Path) -> Path:
    """A path as a volume's facts know it: the name that was given, from the root."""
    return Path(path).expanduser().absolute()


def _what_is_read(path: Path) -> tuple[Reads, tuple[str, ...]]:
    """As ``opening.find_in`` decides it.

    Raises
    ------
    OSError, ValueError, CarinaError
        If it cannot be read, or is nothing that is opened.
    """
    if path.is_dir():
        return "tree", ()
    if looks_like_dicom(path):
        return "folder", ()
    kind = sniff_format(path)
    if kind not in ("nifti", "nrrd", "metaimage"):
        raise ValueError
    found = read_grid_header(path, kind).data_path
    if found == path:
        return "files", (path.name,)
    others = data_files(path) if kind == "nifti" else [found]
    return "files", (path.name, *(other.name for other in others))


def _look(path: Path, reads: Reads, names: tuple[str, ...]) -> SourceFiles:
    """The state of the files.

    Raises
    ------
    OSError
        If the path itself is not there, or cannot be read.
    ValueError
        If there are too many.
    """
    path.stat()
    found = hashlib.blake2b(digest_size=20)
    num_files = num_bytes = newest_ns = 0
    for name, place in _list(path, reads, names):
        num_files += 1
        if num_files > MAX_FILES:
            raise ValueError
        try:
            seen = place.stat()
            size, time_ns = seen.st_size, seen.st_mtime_ns
        except OSError:
            size = time_ns = -1  # not there, or a link to nothing: that, too, is a state
        found.update(os.fsencode(name) + f"\0{size}\0{time_ns}\n".encode())
        num_bytes += max(0, size)
        newest_ns = max(newest_ns, time_ns)
    return SourceFiles(reads, names, num_files, num_bytes, newest_ns, found.hexdigest())


def _list(path: Path, reads: Reads, names: tuple[str, ...]) -> Iterator[tuple[str, Path]]:
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
