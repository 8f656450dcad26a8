"""Files dropped on the window: written to a folder of their own, bounded, and gone when they are no longer needed."""

from __future__ import annotations

import contextlib
import re
import secrets
import shutil
import tempfile
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from starlette.concurrency import run_in_threadpool

from carina.errors import CarinaError, UsageError

__all__ = ["Limits", "Uploads", "safe_relative_path"]

GIB = 1024**3


@dataclass(frozen=True, slots=True)
class Limits:
    """How much one upload may hold."""

    num_files: int = 4096
    total_bytes: int = 4 * GIB
    file_bytes: int = 2 * GIB
    num_uploads: int = 2
    """Beyond this the oldest is given up."""


def safe_relative_path(name: str) -> Path:
    """A relative path made of harmless parts of the name that a browser sent; never empty, never upwards.

    Every part keeps letters, digits, ``._-`` and spaces; leading dots go, so that neither ``..`` nor hidden files
    remain.
    """
    parts = []
    for raw in re.split(r"[/\\]+", name):
        part = re.sub(r"[^A-Za-z0-9._ \-]", "_", raw).lstrip(". ").rstrip(". ")
        if part:
            parts.append(part[-100:].lstrip(". ") or "_")
    # Windows' device names are files everywhere; a prefix makes them ordinary.
    parts = [f"_{p}" if re.fullmatch(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?", p) else p for p in parts]
    return Path(*parts[-6:]) if parts else Path("file")


def _remove(path: Path) -> None:
    # Not only "missing": where a file stands in place of the folder, the way itself is none.
    with contextlib.suppress(OSError):
        path.unlink()


@dataclass(slots=True)
class _Upload:
    folder: Path
    num_files: int = 0
    num_bytes: int = 0


class Uploads:
    """The uploads of one server, below one temporary folder."""

    def __init__(self, limits: Limits | None = None) -> None:
        self._limits = limits or Limits()
        self._root: Path | None = None
        self._uploads: dict[str, _Upload] = {}

    def begin(self) -> str:
        """A new, empty upload; returns its id.

        Raises
        ------
        CarinaError
            ``upload.disk`` if the disk is full or not writable.
        """
        try:
            return self._begin()
        except OSError as trouble:
            msg = f"dropped files cannot be stored: {trouble.strerror}; open the folder by its path instead"
            raise CarinaError(msg, code="upload.disk") from trouble

    def _begin(self) -> str:
        if self._root is None:
            self._root = Path(tempfile.mkdtemp(prefix="carina-upload-")).resolve()
        while len(self._uploads) >= self._limits.num_uploads:
            self.discard(next(iter(self._uploads)))
        upload_id = secrets.token_hex(8)
        folder = self._root / upload_id
        folder.mkdir(mode=0o700)
        self._uploads[upload_id] = _Upload(folder)
        return upload_id

    async def add(self, upload_id: str, name: str, body: AsyncIterator[bytes]) -> None:
        """Write one file.

        Raises
        ------
        UsageError
            If the upload is gone, or a bound is passed; the file is then removed.
        """
        upload = self._needed(upload_id)
        if upload.num_files >= self._limits.num_files:
            msg = (
                f"too many files: at most {self._limits.num_files} can be dropped at once; open the folder by its path"
            )
            raise UsageError(msg, code="upload.limit")
        upload.num_files += 1
        path = self._free_path(upload.folder, safe_relative_path(name))
        written = 0
        try:
            await run_in_threadpool(path.parent.mkdir, parents=True, exist_ok=True)
            with await run_in_threadpool(path.open, "xb") as file:
                async for chunk in body:
                    written += len(chunk)
                    upload.num_bytes += len(chunk)
                    if written > self._limits.file_bytes or upload.num_bytes > self._limits.total_bytes:
                        msg = "the dropped files are too large to copy; open the folder by its path instead"
                        raise UsageError(msg, code="upload.limit")
                    await run_in_threadpool(file.write, chunk)
        except OSError as trouble:
            _remove(path)
            raise CarinaError(
                f"a dropped file could not be stored: {trouble.strerror}", code="upload.disk"
            ) from trouble
        except BaseException:
            _remove(path)
            raise

    def place(self, upload_id: str) -> Path:
        """What to open: the only file, a header file with its data beside it, or the folder."""
        upload = self._needed(upload_id)
        files = sorted(p for p in upload.folder.rglob("*") if p.is_file())
        if not files:
            raise UsageError("nothing was dropped: the upload holds no file", code="upload.empty")
        if len(files) == 1:
            return files[0]
        headers = [p for p in files if p.suffix.lower() in {".mhd", ".nhdr"}]
        return headers[0] if len(headers) == 1 else upload.folder

    def discard(self, upload_id: str) -> None:
        """Remove an upload's files; nothing if it is gone."""
        upload = self._uploads.pop(upload_id, None)
        if upload is not None:
            shutil.rmtree(upload.folder, ignore_errors=True)

    def close(self) -> None:
        """Remove everything."""
        for upload_id in list(self._uploads):
            self.discard(upload_id)
        if self._root is not None:
            shutil.rmtree(self._root, ignore_errors=True)
            self._root = None

    def _needed(self, upload_id: str) -> _Upload:
        upload = self._uploads.get(upload_id)
        if upload is None:
            raise UsageError("this upload is gone; drop the files again", code="upload.gone")
        return upload

    @staticmethod
    def _free_path(folder: Path, relative: Path) -> Path:
        path = folder / relative
        number = 1
        while path.exists():
            # Two names may become one when cleaned; both files count.
            number += 1
            path = folder / relative.with_name(f"{number}-{relative.name}")
        if not path.resolve().is_relative_to(folder):
            raise UsageError("this file name cannot be used", code="upload.name")
        return path
