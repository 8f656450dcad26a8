"""Folder of a retrieval: images are collected in a hidden folder that gets its name only when the series is complete.

An interrupted retrieval therefore never opens as a whole series, and continues with the images that are missing.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from pydicom.dataset import FileMetaDataset
from pydicom.filebase import DicomBytesIO
from pydicom.filewriter import write_file_meta_info
from pydicom.uid import PYDICOM_IMPLEMENTATION_UID, UID

from carina.disk import disk_trouble, make_folder, sync_folder, write_whole
from carina.errors import PacsError, UsageError
from carina.pacs.limits import MAX_IMAGE_BYTES, MAX_SERIES_BYTES, too_large

__all__ = ["RetrievalFolder", "part10"]

_MIN_FREE_BYTES = 512 << 20


class RetrievalFolder:
    """The images of one series that have arrived.

    Parameters
    ----------
    folder
        Folder to create when the series is complete; it must not exist.
    series_uid
        UID of the series; the hidden folder of another series is not continued.
    max_image_bytes
        Largest image.

    Raises
    ------
    UsageError
        ``pacs.folder``: the folder exists.
    """

    def __init__(self, folder: Path, series_uid: str, *, max_image_bytes: int = MAX_IMAGE_BYTES) -> None:
        if os.path.lexists(folder):
            raise UsageError(f"pacs: {folder} exists; name a new folder", code="pacs.folder")
        self.target = folder
        self.max_image_bytes = max_image_bytes
        mark = hashlib.sha256(series_uid.encode()).hexdigest()[:12]
        self._part = folder.with_name(f".{folder.name[:80]}.{mark}.incomplete")
        make_folder(self._part, what="the images", private=True)
        self._names = {path.name for path in self._part.iterdir() if path.suffix == ".dcm"}
        self._num_bytes = sum((self._part / name).stat().st_size for name in self._names)

    @staticmethod
    def _name(sop_uid: str) -> str:
        return f"{hashlib.sha256(sop_uid.encode()).hexdigest()[:32]}.dcm"

    def __contains__(self, sop_uid: str) -> bool:
        """Return whether an image has arrived."""
        return self._name(sop_uid) in self._names

    def __len__(self) -> int:
        """Return the number of images that have arrived."""
        return len(self._names)

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

        Raises
        ------
        DiskError
            If the folder cannot be renamed.
        """
        try:
            for name in self._names - set(map(self._name, images)):
                (self._part / name).unlink()
            self._part.rename(self.target)
            sync_folder(self.target.parent)
        except OSError as error:
            raise disk_trouble(error, "cannot create the folder", self.target) from None

    def discard(self) -> None:
        """Remove the hidden folder with all images."""
        shutil.rmtree(self._part, ignore_errors=True)

    def discard_if_empty(self) -> None:
        """Remove the hidden folder if no image has arrived."""
        if not self._names:
            self.discard()


def part10(sop_class: str, sop_uid: str, syntax: str, dataset: bytes) -> bytes:
    """Return the file of an encoded data set: preamble, file meta information and the data set as it was received."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = UID(sop_class), UID(sop_uid)
    meta.TransferSyntaxUID, meta.ImplementationClassUID = UID(syntax), PYDICOM_IMPLEMENTATION_UID
    head = DicomBytesIO()
    head.write(bytes(128) + b"DICM")
    write_file_meta_info(head, meta, enforce_standard=True)
    return head.getvalue() + dataset
