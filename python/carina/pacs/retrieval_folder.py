"""Folder of a retrieval: images are collected in a hidden folder that gets its name only when the series is complete.

An interrupted retrieval therefore never opens as a whole series, and continues with the images that are missing. A lock
file beside the folder excludes other jobs and processes.

A folder that is replaced has a hidden name until the files of the user that it contains are in the new folder. The next
use of the folder completes or undoes a replacement that a crash has interrupted. Only files that Carina wrote are
deleted: images and drafts.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Self

from pydicom.dataset import FileMetaDataset
from pydicom.filebase import DicomBytesIO
from pydicom.filewriter import write_file_meta_info
from pydicom.uid import PYDICOM_IMPLEMENTATION_UID, UID

from carina.disk import disk_trouble, make_folder, sync_folder, write_whole
from carina.disk.locks import lock_file
from carina.errors import PacsError, UsageError
from carina.pacs.limits import MAX_IMAGE_BYTES, MAX_SERIES_BYTES, too_large

__all__ = ["RetrievalFolder", "delete_retrieved", "part10"]

_MIN_FREE_BYTES = 512 << 20
_IMAGE = re.compile(r"[0-9a-f]{32}\.dcm")
_WRITTEN = re.compile(rf"{_IMAGE.pattern}|\.carina-[0-9a-f]+\.draft")
_HIDDEN = re.compile(r"\.(?P<target>.+?)(\.[0-9a-f]{12}\.(incomplete|replaced)|\.lock)")
_MAX_STEM_BYTES = 180  # a file name has at most 255 bytes


class RetrievalFolder:
    """The images of one series that have arrived; a context manager that holds the lock of the folder.

    Parameters
    ----------
    folder
        Folder to create when the series is complete.
    series_uid
        UID of the series; the hidden folder of another series is not continued.
    max_image_bytes
        Largest image.
    replaces
        Whether the folder may exist; its images are then replaced when the series is complete.

    Raises
    ------
    UsageError
        ``pacs.folder``: the folder exists, at the begin of the block.
    PacsError
        ``pacs.busy``: another job or process holds the lock, at the begin of the block.
    """

    def __init__(
        self, folder: Path, series_uid: str, *, max_image_bytes: int = MAX_IMAGE_BYTES, replaces: bool = False
    ) -> None:
        self.target = folder
        self.max_image_bytes = max_image_bytes
        self._replaces = replaces
        mark = hashlib.sha256(series_uid.encode()).hexdigest()[:12]
        self._part = folder.with_name(f".{_stem(folder)}.{mark}.incomplete")
        self._replaced = folder.with_name(f".{_stem(folder)}.{mark}.replaced")
        self._names: set[str] = set()
        self._num_bytes = 0
        self._lock = contextlib.ExitStack()

    def __enter__(self) -> Self:
        """Take the lock, recover from an interrupted replacement, and find the images of an interrupted retrieval."""
        with contextlib.ExitStack() as stack:
            stack.enter_context(_locked(self.target))
            _recover(self.target)
            is_folder = self.target.is_dir() and not self.target.is_symlink()
            if os.path.lexists(self.target) and not (self._replaces and is_folder):
                raise UsageError(f"pacs: {self.target} exists; name a new folder", code="pacs.folder")
            make_folder(self._part, what="the images", private=True)
            self._names = _images_in(self._part)
            self._num_bytes = sum((self._part / name).stat().st_size for name in self._names)
            self._lock = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the hidden folder if no image has arrived, and release the lock."""
        with self._lock:
            if not _images_in(self._part):
                self.discard()

    @staticmethod
    def _name(sop_uid: str) -> str:
        return f"{hashlib.sha256(sop_uid.encode()).hexdigest()[:32]}.dcm"

    def __contains__(self, sop_uid: str) -> bool:
        """Return whether an image has arrived."""
        return self._name(sop_uid) in self._names

    def __len__(self) -> int:
        """Return the number of images that have arrived."""
        return len(self._names)

    def is_up_to_date(self, images: Iterable[str]) -> bool:
        """Return whether the folder exists and its images on the disk are those with these UIDs, and no others."""
        return _images_in(self.target) == set(map(self._name, images))

    def add(self, sop_uid: str, content: bytes) -> None:
        """Store an image; it is complete on the disk or absent.

        Raises
        ------
        PacsError
            ``pacs.too-large`` if the series exceeds its limit of bytes, ``pacs.disk-full`` if the disk is almost full.
        DiskError
            If the disk is full or cannot be written.
        """
        self._num_bytes += len(content)
        if self._num_bytes > MAX_SERIES_BYTES:
            raise too_large("PACS", f"the series has more than {MAX_SERIES_BYTES >> 30} GiB")
        if shutil.disk_usage(self._part).free < max(_MIN_FREE_BYTES, 2 * len(content)):
            raise PacsError(
                f"storing the images: the disk of {self.target} is almost full; free some space and retrieve again",
                code="pacs.disk-full",
            )
        name = self._name(sop_uid)
        write_whole(self._part / name, content, what="an image", private=True)
        self._names.add(name)

    def complete(self, images: Iterable[str]) -> None:
        """Give the folder its name; images of an earlier retrieval that the PACS no longer lists are deleted.

        The files on the disk decide whether the series is complete.

        Raises
        ------
        PacsError
            ``pacs.incomplete``: an image is missing.
        DiskError
            If the folder cannot be renamed.
        """
        wanted = set(map(self._name, images))
        missing = wanted - _images_in(self._part)
        if missing:
            raise PacsError(
                f"retrieving the series: {len(missing)} of {len(wanted)} images did not arrive; retrieve again to "
                "continue with the missing images",
                code="pacs.incomplete",
            )
        try:
            for path in self._part.iterdir():
                if _WRITTEN.fullmatch(path.name) and path.name not in wanted:
                    path.unlink()
            self._place()
            sync_folder(self.target.parent)
        except OSError as error:
            raise disk_trouble(error, "cannot create the folder", self.target) from None

    def _place(self) -> None:
        """Rename the hidden folder to its name, in place of an existing folder; files of the user stay in it."""
        if os.path.lexists(self.target):
            self.target.rename(self._replaced)
        try:
            self._part.rename(self.target)
        except OSError:
            _recover(self.target)
            raise
        sync_folder(self.target.parent)
        _recover(self.target)

    def discard(self) -> None:
        """Remove the hidden folder with all images."""
        with contextlib.suppress(OSError):
            _delete_written(self._part)


def delete_retrieved(folder: Path, check: Callable[[], None]) -> None:
    """Delete every series in the folder of the retrieved series, complete or not; files of the user stay.

    Parameters
    ----------
    folder
        Folder of the retrieved series; it may be missing.
    check
        Called before each deletion, while the lock of the series is held; it raises an error if a job uses a series.

    Raises
    ------
    PacsError
        ``pacs.busy``: another job or process retrieves a series; the series before it have been deleted.
    DiskError
        If a folder cannot be deleted.
    """
    try:
        entries = sorted(folder.iterdir())
    except FileNotFoundError:
        return
    except OSError as error:
        raise disk_trouble(error, "cannot delete the retrieved series", folder) from error
    for path in entries:
        hidden = _HIDDEN.fullmatch(path.name)
        target = folder / (path.name if hidden is None else hidden["target"])
        with _locked(target):  # the end of the block deletes a lock file that a crash has left
            check()
            _recover(target)
            try:
                for place in (target, path):
                    if place.is_dir() and not place.is_symlink():
                        _delete_written(place)
            except OSError as error:
                raise disk_trouble(error, "cannot delete the retrieved series", path) from error


@contextlib.contextmanager
def _locked(target: Path) -> Iterator[None]:
    """Hold the lock of a retrieval folder during the block.

    Raises
    ------
    PacsError
        ``pacs.busy``: another job or process holds the lock.
    DiskError
        If the lock file cannot be created.
    """
    make_folder(target.parent, what="the images", private=True)
    with contextlib.ExitStack() as stack:
        try:
            is_held = stack.enter_context(lock_file(target.with_name(f".{_stem(target)}.lock")))
        except OSError as error:
            raise disk_trouble(error, "cannot lock the folder", target) from error
        if not is_held:
            raise PacsError(
                "another job of Carina retrieves or deletes this series; wait until that job has ended, then try again",
                code="pacs.busy",
            )
        yield


def _images_in(folder: Path) -> set[str]:
    """Return the names of the images on the disk; none if the folder is missing."""
    try:
        return {path.name for path in folder.iterdir() if _IMAGE.fullmatch(path.name)}
    except (FileNotFoundError, NotADirectoryError):
        return set()


def _stem(target: Path) -> str:
    """Return the part that all hidden names of a folder share: its name, shortened if it is very long."""
    name = os.fsencode(target.name)
    if len(name) <= _MAX_STEM_BYTES:
        return target.name
    return f"{name[:150].decode(errors='ignore')}-{hashlib.sha256(name).hexdigest()[:12]}"


def _recover(target: Path) -> None:
    """Complete a replacement of a folder, or undo it if the new folder is missing; the caller holds the lock.

    Raises
    ------
    DiskError
        If a file of the user cannot be moved; it stays where it is, and the next call tries again.
    """
    try:
        found = [(path, _HIDDEN.fullmatch(path.name)) for path in target.parent.iterdir()]
        for replaced, hidden in found:
            if hidden is None or hidden[3] != "replaced" or hidden["target"] != _stem(target):
                continue
            if not os.path.lexists(target):
                replaced.rename(target)
                continue
            for path in replaced.iterdir():
                if not _WRITTEN.fullmatch(path.name):
                    path.rename(_free_place(target, path))
            sync_folder(target)
            with contextlib.suppress(OSError):  # an image is open (Windows): the next call deletes it
                _delete_written(replaced)
    except OSError as error:
        raise disk_trouble(error, "cannot restore the files of the folder", target) from error


def _free_place(folder: Path, path: Path) -> Path:
    """Return a place for a file in a folder: its own name, or one with a number if the folder has such a file."""
    numbered = (path.name if n == 1 else f"{path.stem} ({n}){path.suffix}" for n in itertools.count(1))
    return next(place for name in numbered if not os.path.lexists(place := folder / name))


def _delete_written(folder: Path) -> None:
    """Delete the images and drafts of a folder, and the folder itself if it contains nothing else."""
    for path in folder.iterdir():
        if _WRITTEN.fullmatch(path.name):
            path.unlink(missing_ok=True)
    try:
        folder.rmdir()
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise


def part10(sop_class: str, sop_uid: str, syntax: str, dataset: bytes) -> bytes:
    """Return the file of an encoded data set: preamble, file meta information and the data set as it was received."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = UID(sop_class), UID(sop_uid)
    meta.TransferSyntaxUID, meta.ImplementationClassUID = UID(syntax), PYDICOM_IMPLEMENTATION_UID
    head = DicomBytesIO()
    head.write(bytes(128) + b"DICM")
    write_file_meta_info(head, meta, enforce_standard=True)
    return head.getvalue() + dataset
