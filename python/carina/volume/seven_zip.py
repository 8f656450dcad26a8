"""Members of a 7z archive by libarchive (extra ``sevenzip``), as streams of blocks."""

from __future__ import annotations

import contextlib
import ctypes
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["EncryptedError", "MissingLibraryError", "SevenZipError", "SevenZipMember", "UnknownMethodError", "members"]

_BLOCK_BYTES = 1 << 16
# The library logs names of members and damage, which this module reports as errors.
logging.getLogger("libarchive").setLevel(logging.CRITICAL + 1)


class SevenZipError(Exception):
    """Archive that is damaged."""


class EncryptedError(SevenZipError):
    """Archive that needs a password."""


class UnknownMethodError(SevenZipError):
    """Archive that is packed by a method that libarchive does not know."""


class MissingLibraryError(SevenZipError):
    """Package ``libarchive-c`` or the library libarchive that is not installed."""


class SevenZipMember(NamedTuple):
    """A file of the archive; its blocks must be read before the next member."""

    name: str
    blocks: Callable[[], Iterator[bytes]]


def members(path: Path) -> Iterator[SevenZipMember]:
    """Yield the regular files of an archive in their order; folders, links and devices are skipped.

    Raises
    ------
    SevenZipError
        If the archive cannot be read.
    """
    library = _library()
    with _as_own_errors(library), library.file_reader(str(path), format_name="7zip", filter_name="none") as archive:
        for entry in archive:
            if entry.isfile:
                yield SevenZipMember(str(entry.pathname or "file"), _reader(library, entry))


def _reader(library: Any, entry: Any) -> Callable[[], Iterator[bytes]]:
    def blocks() -> Iterator[bytes]:
        # `ArchiveEntry.get_blocks` treats a wrong checksum, which is a warning of libarchive, as data.
        buffer, num_bytes = ctypes.create_string_buffer(_BLOCK_BYTES), 0
        with _as_own_errors(library):
            while size := library.ffi.read_data(entry._archive_p, buffer, _BLOCK_BYTES):
                if size < 0:
                    raise SevenZipError
                num_bytes += size
                yield buffer.raw[:size]
        if entry.size is not None and num_bytes != entry.size:
            raise SevenZipError

    return blocks


def _library() -> Any:
    try:
        import libarchive
    except (ImportError, OSError, AttributeError, TypeError):  # the package, or the library that it loads
        raise MissingLibraryError from None
    return libarchive


@contextlib.contextmanager
def _as_own_errors(library: Any) -> Iterator[None]:
    """Convert the errors of libarchive, which has one class for all reasons."""
    try:
        yield
    except library.exception.ArchiveError as error:
        reason = str(getattr(error, "msg", "") or "").lower()
        if "encrypt" in reason or "passphrase" in reason:
            raise EncryptedError from None
        if "unsupported" in reason or "unknown codec" in reason or "not supported" in reason:
            raise UnknownMethodError from None
        raise SevenZipError from None
