"""Temporary storage of files that a user drops on the window, limited in size and number.

The file names on disk contain no patient data (``dropped_names.py``). ``disk.scratch`` also deletes the folders that
a crash leaves behind.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from starlette.concurrency import run_in_threadpool

from carina.disk import ScratchFolder, create_folders, disk_trouble
from carina.errors import UsageError
from carina.server.files.dropped_names import DroppedNames

GIB = 1024**3


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one upload in files and bytes, and of the number of uploads."""

    num_files: int = 4096
    total_bytes: int = 4 * GIB
    file_bytes: int = 2 * GIB
    num_uploads: int = 2
    """Maximum number of uploads; beyond it, the oldest upload is deleted."""


def safe_relative_path(name: str) -> Path:
    """Return a safe relative path for a file name that a browser sent; the path is never empty.

    Letters, digits, ``._-`` and spaces stay; every other character becomes ``_``. Leading dots are removed from each
    part, so that the path contains neither ``..`` nor hidden files. Only the last six parts remain.
    """
    parts = []
    for raw in re.split(r"[/\\]+", name):
        part = re.sub(r"[^A-Za-z0-9._ \-]", "_", raw).lstrip(". ").rstrip(". ")
        if part:
            parts.append(part[-100:].lstrip(". ") or "_")
    # Windows reserves its device names in every folder; a prefix makes them usable.
    parts = [f"_{p}" if re.fullmatch(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?", p) else p for p in parts]
    return Path(*parts[-6:]) if parts else Path("file")


def _remove(path: Path) -> None:
    # Not only FileNotFoundError: NotADirectoryError is raised if a part of the path is a file.
    with contextlib.suppress(OSError):
        path.unlink()


@dataclass(slots=True)
class _Upload:
    scratch: ScratchFolder
    tag: str
    folder: Path
    files: dict[Path, tuple[Path, str]] = field(default_factory=dict)
    """For each path on disk: the safe relative path, and the last part of the name that the browser sent."""
    num_files: int = 0
    num_bytes: int = 0
    is_retained: bool = False
    """Whether the upload is deleted only by :meth:`Uploads.discard`, not by further uploads."""


class Uploads:
    """The uploads of one server; each upload has its own temporary folder."""

    def __init__(self, limits: Limits | None = None) -> None:
        self._limits = limits or Limits()
        self._uploads: dict[str, _Upload] = {}
        self.names = DroppedNames()
        """Original names of the dropped files, for messages to the user."""

    def begin(self) -> str:
        """Create an empty upload, and return its ID.

        Raises
        ------
        DiskError
            If the disk is full or not writable.
        """
        try:
            while len(passing := [key for key, one in self._uploads.items() if not one.is_retained]) >= (
                self._limits.num_uploads
            ):
                self.discard(passing[0])
            scratch = ScratchFolder()
        except OSError as error:
            raise disk_trouble(
                error, "the files dropped on the window could not be stored", None, unchanged=_BY_PATH
            ) from error
        tag = secrets.token_hex(4)
        folder = scratch.path / self.names.begin(tag)
        try:
            folder.mkdir(mode=0o700)
        except OSError as error:
            scratch.remove()
            raise disk_trouble(
                error, "the files dropped on the window could not be stored", None, unchanged=_BY_PATH
            ) from error
        upload_id = secrets.token_hex(8)
        self._uploads[upload_id] = _Upload(scratch, tag, folder)
        return upload_id

    async def add(self, upload_id: str, name: str, body: AsyncIterator[bytes]) -> None:
        """Write one file of an upload to disk.

        Raises
        ------
        UsageError
            If the upload was deleted, or a limit is exceeded; the file is then removed.
        DiskError
            If the file cannot be written, for example because the disk is full; the file is then removed.
        """
        upload = self._existing_upload(upload_id)
        if upload.num_files >= self._limits.num_files:
            msg = (
                f"too many files: at most {self._limits.num_files} can be dropped at once; open the folder by "
                "its path instead"
            )
            raise UsageError(msg, code="upload.limit")
        upload.num_files += 1
        path = self._free_path(upload, name)
        written = 0
        try:
            await run_in_threadpool(create_folders, path.parent, private=True)
            with await run_in_threadpool(_open_new, path) as file:
                async for chunk in body:
                    written += len(chunk)
                    upload.num_bytes += len(chunk)
                    if written > self._limits.file_bytes or upload.num_bytes > self._limits.total_bytes:
                        msg = "the dropped files are too large to upload; open the folder by its path instead"
                        raise UsageError(msg, code="upload.limit")
                    await run_in_threadpool(file.write, chunk)
        except OSError as error:
            _remove(path)
            raise disk_trouble(error, "a dropped file cannot be stored", None, unchanged=_BY_PATH) from error
        except BaseException:
            _remove(path)
            raise

    def place(self, upload_id: str) -> Path:
        """Return the path of an upload to open: its only file, its only ``.mhd``/``.nhdr`` header, or its folder."""
        upload = self._existing_upload(upload_id)
        files = sorted(p for p in upload.folder.rglob("*") if p.is_file())
        if not files:
            raise UsageError("nothing was dropped: the upload contains no files", code="upload.empty")
        if len(files) == 1:
            return files[0]
        headers = [p for p in files if p.suffix.lower() in {".mhd", ".nhdr"}]
        return _with_data_file_names(upload, headers[0]) if len(headers) == 1 else upload.folder

    def contains(self, upload_id: str, path: Path | None) -> bool:
        """Return whether a path is that of an upload's folder, or of a file in it."""
        upload = self._uploads.get(upload_id)
        return upload is not None and path is not None and path.is_relative_to(upload.folder)

    def retain(self, upload_id: str) -> None:
        """Store an upload until it is discarded, whatever is uploaded after it; do nothing if it does not exist."""
        upload = self._uploads.get(upload_id)
        if upload is not None:
            upload.is_retained = True

    def discard(self, upload_id: str) -> None:
        """Delete the files of an upload; do nothing if the upload does not exist."""
        upload = self._uploads.pop(upload_id, None)
        if upload is not None:
            upload.scratch.remove()

    def close(self) -> None:
        """Delete all uploads."""
        for upload_id in list(self._uploads):
            self.discard(upload_id)

    def _existing_upload(self, upload_id: str) -> _Upload:
        upload = self._uploads.get(upload_id)
        if upload is None:
            raise UsageError("this upload has expired; drop the files again", code="upload.gone")
        return upload

    def _free_path(self, upload: _Upload, name: str) -> Path:
        relative = safe_relative_path(name)
        place = self.names.neutral_path(upload.tag, PurePosixPath(relative.as_posix()), name)
        while (path := upload.folder / place).exists():
            # Two different names may have the same safe form; both files are stored.
            place = self.names.another_neutral_path(upload.tag, place)
        if not path.resolve().is_relative_to(upload.folder):
            raise UsageError("this file name cannot be used", code="upload.name")
        upload.files[path] = (relative, re.split(r"[/\\]", name)[-1])
        return path


_BY_PATH = "you can also open the scan by its path"
_MAX_HEADER_BYTES = 65_536
_DATA_FILE = re.compile(rb"^(ElementDataFile\s*=|data ?file\s*:)[ \t]*([^\r\n]*?)[ \t]*$", re.IGNORECASE | re.MULTILINE)


def _open_new(path: Path) -> BinaryIO:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
    return os.fdopen(os.open(path, flags, 0o600), "wb")


def _with_data_file_names(upload: _Upload, header: Path) -> Path:
    """Make a header refer to its data files as they are named on disk, and return the path of the header.

    If the header names one file of the upload, the neutral name of this file is written into the header. Otherwise
    the files get the safe form of their original names.

    Raises
    ------
    DiskError
        If a file cannot be read, written or renamed.
    """
    try:
        data = header.read_bytes() if header.stat().st_size <= _MAX_HEADER_BYTES else b""
        named = _DATA_FILE.search(data)
        if named is not None:
            wanted = named[2].decode("utf-8", "replace")
            for path, (_, original_name) in upload.files.items():
                if original_name == wanted and path.parent == header.parent and path != header:
                    header.write_bytes(data[: named.start(2)] + path.name.encode() + data[named.end(2) :])
                    return header
                if path.name == wanted:
                    return header
            if wanted.upper() == "LOCAL":
                return header
        # A header with a list or a number pattern of file names refers to the original names, so they are restored.
        for path, (relative, _) in upload.files.items():
            back = upload.folder / relative
            create_folders(back.parent, private=True)
            if path.is_file() and not back.exists():
                path.replace(back)
                header = back if path == header else header
    except OSError as error:
        raise disk_trouble(error, "a dropped file cannot be stored", None, unchanged=_BY_PATH) from error
    return header
