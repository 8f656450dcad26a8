"""Archives (zip, tar, tar.gz, tar.xz, tar.bz2, 7z): unpacked into a private temporary folder, which is always removed.

An archive is untrusted input. Its members are streamed to the disk under neutral names, because a name may contain a
path out of the folder or the name of a patient; messages show the original names. The number of bytes that are really
unpacked is limited, whatever the archive states, and so are the number of members, the compression ratio and the depth
of archives in archives. Links and devices are skipped.
"""

from __future__ import annotations

import bz2
import contextlib
import errno
import gzip
import io
import lzma
import os
import re
import shutil
import struct
import tarfile
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Literal, cast

from carina.disk import scratch_folder
from carina.errors import CarinaError, VolumeImportError
from carina.installation import extra_command
from carina.volume import seven_zip
from carina.volume.message_limits import bounded_name
from carina.volume.progress import Watch
from carina.volume.read_limits import MAX_FILES

ArchiveKind = Literal["zip", "tar", "gzip tar", "xz tar", "bzip2 tar", "7z", "rar"]

MAX_UNPACKED_BYTES = 32 << 30
"""Maximum total number of bytes that one archive, with the archives in it, may unpack to."""
MAX_RATIO = 200
"""Maximum ratio of unpacked to packed bytes; CT slices have 2 to 10, also with much air."""
FREE_OF_RATIO_BYTES = 256 << 20
"""Number of unpacked bytes up to which an archive may have any compression ratio."""
MAX_DEPTH = 3
"""Maximum number of archives inside each other."""
_MIN_FREE_BYTES = 512 << 20
_MAX_DIRECTORY_BYTES = 128 << 20
_CHUNK = 1 << 20
_MAX_TAR_HEADER_BYTES = 1 << 20
_ZIP, _EMPTY_ZIP, _SEVEN_ZIP, _RAR = b"PK\x03\x04", b"PK\x05\x06", b"7z\xbc\xaf\x27\x1c", b"Rar!\x1a\x07"
_PACKED = {b"\x1f\x8b": "gzip tar", b"\xfd7zXZ\x00": "xz tar", b"BZh": "bzip2 tar"}
_SUFFIXES = (".zip", ".tar", ".tgz", ".tar.gz", ".txz", ".tar.xz", ".tbz2", ".tar.bz2", ".7z")
_NAMED_FILES = (".mhd", ".nhdr", ".hdr", ".img", ".raw", ".zraw", ".raw.gz", ".img.gz", ".hdr.gz")
"""Suffixes of files that refer to each other by name, so that their names are not replaced."""
_FORMAT_SUFFIXES = (*_NAMED_FILES, ".nii.gz", ".nii", ".nrrd", ".mha", ".dcm", ".ima", ".txt", ".pdf", ".xml", ".jpg")
_UNPACK = "unpack it and open the folder"
_FOLDER = "archive-content"
_TOKEN = re.compile(r"\b[a-z]{3}\d{6}(?:\.[a-z0-9.]*[a-z0-9])?|archive-content")
_UID_NAME = re.compile(r"[\w.-]*\d+(?:\.\d+){4,}[\w.-]*")


def archive_kind(path: Path) -> ArchiveKind | None:
    """Return the kind of an archive by its first bytes, never by its name; None if the file is not an archive."""
    try:
        with path.open("rb") as file:
            head = file.read(512)
    except OSError:
        return None
    if head.startswith((_ZIP, _EMPTY_ZIP)):
        return "zip"
    if head.startswith(_SEVEN_ZIP):
        return "7z"
    if head.startswith(_RAR):
        return "rar"
    if head[128:132] != b"DICM" and _is_tar_header(head):
        return "tar"
    for start, kind in _PACKED.items():
        if head.startswith(start):
            with contextlib.suppress(OSError, EOFError, lzma.LZMAError, zlib.error), path.open("rb") as raw:
                if _is_tar_header(_unpacker(kind, raw).read(512)):
                    return cast("ArchiveKind", kind)
    return None


def _is_tar_header(head: bytes) -> bool:
    """Return whether a block is the header of a tar member, by its checksum."""
    if len(head) < 512 or not head[0]:
        return False
    try:
        stated = int(head[148:156].strip(b" \0"), 8)
    except ValueError:
        return False
    return sum(head[:148]) + 8 * 32 + sum(head[156:]) == stated


def _unpacker(kind: str, raw: BinaryIO) -> BinaryIO:
    if kind == "gzip tar":
        return cast("BinaryIO", gzip.GzipFile(fileobj=raw))
    if kind == "xz tar":
        return cast("BinaryIO", lzma.LZMAFile(raw))
    return cast("BinaryIO", bz2.BZ2File(raw)) if kind == "bzip2 tar" else raw


@dataclass(slots=True)
class UnpackedArchive:
    """The content of an archive in a temporary folder."""

    path: Path
    """The archive."""
    folder: Path
    """Folder of the unpacked files, which have neutral names."""
    names: dict[str, str] = field(default_factory=dict)
    """Original name of each file by its neutral name."""

    def with_original_names(self, text: str) -> str:
        """Return a message in which the original names of files replace the neutral ones."""

        def original(found: re.Match[str]) -> str:
            token = found[0]
            if token == _FOLDER:
                return self.path.name
            known = self.names.get(token)
            if known is None:  # a punctuation mark or a suffix of the message may follow the name
                stem = token.split(".")[0]
                known = self.names.get(stem)
                return token if known is None else known + token[len(stem) :]
            return known

        return _TOKEN.sub(original, text.replace(f"the folder {_FOLDER}", f"the archive {self.path.name}"))


@dataclass(slots=True)
class _Budget:
    """Remaining bytes and files that an archive may unpack to, shared by all archives in it."""

    archive: Path
    folder: Path
    watch: Watch
    packed_bytes: int
    num_bytes: int = 0
    num_members: int = 0

    def add_member(self) -> None:
        self.num_members += 1
        if self.num_members > MAX_FILES:
            raise self.too_large(f"it contains more than {MAX_FILES} files")

    def add_bytes(self, count: int) -> None:
        before = self.num_bytes >> 26
        self.num_bytes += count
        if self.num_bytes > MAX_UNPACKED_BYTES:
            raise self.too_large(f"it unpacks to more than {MAX_UNPACKED_BYTES >> 30} GiB")
        if self.num_bytes > max(FREE_OF_RATIO_BYTES, MAX_RATIO * self.packed_bytes):
            raise self.too_large(f"it unpacks to more than {MAX_RATIO} times its size, as no scan does")
        if self.num_bytes >> 26 != before and shutil.disk_usage(self.folder).free < _MIN_FREE_BYTES:
            raise self.too_large("the disk for temporary files has too little space")

    def too_large(self, problem: str) -> VolumeImportError:
        return _refusal(self.archive, problem, f"{_UNPACK} of the scan", "import.archive.too-large")


def _refusal(archive: Path, problem: str, way_out: str, code: str) -> VolumeImportError:
    return VolumeImportError(f"reading the archive {archive.name}: {problem}; {way_out}", code=code)


@contextlib.contextmanager
def unpacked_archive(path: Path, kind: ArchiveKind, watch: Watch) -> Iterator[UnpackedArchive]:
    """Unpack an archive into a private temporary folder, which is removed at the end of the block.

    Parameters
    ----------
    path
        The archive.
    kind
        Its kind, from :func:`archive_kind`.
    watch
        Progress and cancellation.

    Yields
    ------
    UnpackedArchive
        The folder and the original names.

    Raises
    ------
    VolumeImportError
        ``import.archive.damaged``, ``.encrypted``, ``.not-supported`` or ``.too-large``.
    DiskError
        If the temporary folder cannot be written.
    CancelledError
        If the user cancels; at most 1 MiB is unpacked after that.
    """
    with scratch_folder() as scratch:
        folder = scratch / _FOLDER
        folder.mkdir()
        content = UnpackedArchive(path, folder)
        budget = _Budget(path, folder, watch, path.stat().st_size)
        _Unpacking(content, budget).unpack(path, kind, folder, depth=1)
        yield content


class _Unpacking:
    """Unpacking of one archive and of all archives in it."""

    def __init__(self, content: UnpackedArchive, budget: _Budget) -> None:
        self._content = content
        self._budget = budget
        self._shapes: dict[str, str] = {}

    def unpack(self, path: Path, kind: ArchiveKind, folder: Path, *, depth: int) -> None:
        """Unpack an archive into a folder; archives in the archive get a folder each."""
        shown = self._content.path if depth == 1 else Path(self._content.names.get(path.name, path.name))
        if depth > MAX_DEPTH:
            problem = f"it contains archives in archives, {depth} levels deep; expected at most {MAX_DEPTH}"
            raise self._budget.too_large(problem)
        try:
            if kind == "zip":
                inner = self._unpack_zip(path, shown, folder)
            elif kind == "7z":
                inner = self._unpack_seven_zip(path, shown, folder)
            elif kind == "rar":
                problem = f"{kind} archives are not supported"
                raise _refusal(shown, problem, _UNPACK, "import.archive.not-supported")
            else:
                inner = self._unpack_tar(path, kind, folder)
        except (zipfile.BadZipFile, tarfile.TarError, lzma.LZMAError, zlib.error, EOFError, struct.error) as error:
            raise _damaged(shown, error) from None
        except (gzip.BadGzipFile, UnicodeError, ValueError, OverflowError, IndexError, RecursionError) as error:
            raise _damaged(shown, error) from None
        except OSError as error:
            # A damaged zip directory contains negative positions; seeking to them fails with EINVAL.
            if error.errno not in (None, errno.EINVAL) or isinstance(error, CarinaError):
                raise
            # The decoder of bzip2 reports damaged data by an OSError without a number.
            raise _damaged(shown, error) from None
        for archive in inner:
            own = archive_kind(archive)
            if own is not None:
                below = folder / f"{archive.name.split('.')[0]}-content"
                below.mkdir()
                self.unpack(archive, own, below, depth=depth + 1)
                archive.unlink()

    def _unpack_zip(self, path: Path, shown: Path, folder: Path) -> list[Path]:
        inner = []
        _check_directory_size(path, self._budget)
        with _opened_zip(path, shown) as archive:
            members = [one for one in archive.infolist() if not one.is_dir()]
            total = sum(one.compress_size for one in members) or 1
            done = 0
            for member in members:
                self._budget.add_member()
                name = _zip_name(member)
                place = self._place(folder, name)
                if place is None:
                    continue
                if member.flag_bits & 0x1:
                    problem = "it is protected by a password"
                    way_out = "unpack it with its password and open the folder"
                    raise _refusal(shown, problem, way_out, "import.archive.encrypted")
                try:
                    source = archive.open(member)
                except (NotImplementedError, RuntimeError):
                    problem = f"{_shown_name(name)} is packed by a method that is not supported"
                    raise _refusal(shown, problem, _UNPACK, "import.archive.not-supported") from None
                with source:
                    self._write(source.read, place, lambda: done / total)  # noqa: B023 - called in this turn only
                done += member.compress_size
                if name.lower().endswith(_SUFFIXES):
                    inner.append(place)
        return inner

    def _unpack_seven_zip(self, path: Path, shown: Path, folder: Path) -> list[Path]:
        inner = []
        size = path.stat().st_size or 1
        try:
            for member in seven_zip.members(path):
                self._budget.watch.step("Unpacking the archive")
                self._budget.add_member()
                place = self._place(folder, member.name)
                if place is None:
                    continue
                # libarchive does not state its position in the file, so the share is that of the unpacked bytes.
                self._write_blocks(member.blocks(), place, lambda: self._budget.num_bytes / (3 * size))
                if member.name.lower().endswith(_SUFFIXES):
                    inner.append(place)
        except seven_zip.EncryptedError:
            way_out = "unpack it with its password and open the folder"
            raise _refusal(shown, "it is protected by a password", way_out, "import.archive.encrypted") from None
        except seven_zip.UnknownMethodError:
            problem = "it is packed by a method that is not supported"
            raise _refusal(shown, problem, _UNPACK, "import.archive.not-supported") from None
        except seven_zip.MissingLibraryError:
            problem = "7z archives need the package libarchive-c and the library libarchive, which are not installed"
            way_out = f"{_UNPACK}, or run: {extra_command('sevenzip')}"
            raise _refusal(shown, problem, way_out, "import.archive.not-supported") from None
        except seven_zip.SevenZipError as error:
            raise _damaged(shown, error) from None
        return inner

    def _unpack_tar(self, path: Path, kind: str, folder: Path) -> list[Path]:
        inner = []
        size = path.stat().st_size or 1
        with path.open("rb") as raw:
            source = _ForwardReader(_unpacker(kind, raw), self._budget.watch)
            # ``tarfile`` reads its headers whole, so a reader that refuses long reads bounds the memory.
            with tarfile.open(fileobj=cast("Any", source), mode="r:", errorlevel=2) as archive:
                stored: Any = archive  # the types of the library do not name the lists of headers
                begin = 0
                while (member := archive.next()) is not None:
                    self._budget.watch.step("Unpacking the archive")
                    self._budget.add_member()
                    # The bytes of headers and of skipped members count, too.
                    self._budget.add_bytes(source.tell() - begin)
                    # ``tarfile`` stores every header, which would take memory without a limit.
                    stored.members.clear()
                    stored.pax_headers.clear()
                    begin = source.tell()
                    if not member.isreg():
                        continue
                    place = self._place(folder, member.name)
                    if place is None:
                        continue
                    data = archive.extractfile(member)
                    if data is None:
                        continue
                    self._write(data.read, place, lambda: raw.tell() / size)
                    if member.name.lower().endswith(_SUFFIXES):
                        inner.append(place)
            # ``tarfile`` ends without an error where an archive is cut between two members.
            if not source.is_at_end_mark:
                msg = "no end mark"
                raise tarfile.ReadError(msg)
            while rest := source.read(_CHUNK):  # the checksum of a packed archive is at its end
                self._budget.add_bytes(len(rest))
        return inner

    def _write(self, read: Callable[[int], bytes], place: Path, fraction: Callable[[], float]) -> None:
        self._write_blocks(iter(lambda: read(_CHUNK), b""), place, fraction)

    def _write_blocks(self, blocks: Iterator[bytes], place: Path, fraction: Callable[[], float]) -> None:
        descriptor = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o600)
        with os.fdopen(descriptor, "wb") as file:
            self._budget.watch.step("Unpacking the archive", min(1.0, fraction()))
            for block in blocks:
                self._budget.watch.step("Unpacking the archive", min(1.0, fraction()))
                self._budget.add_bytes(len(block))
                file.write(block)

    def _place(self, folder: Path, name: str) -> Path | None:
        """Return a new neutral path for a member, or None for a file of macOS that is never part of a scan.

        Files that are named alike get names that are alike, so that the search for lost slices works.
        """
        parts = [part for part in re.split(r"[/\\]", name) if part]
        last = parts[-1] if parts else "file"
        if last.startswith("._") or "__MACOSX" in parts:
            return None
        suffix = next((one for one in _FORMAT_SUFFIXES if last.lower().endswith(one)), "")
        if suffix in _NAMED_FILES:
            place = folder / _safe_name(last)
            if not place.exists():
                return place
        shape = re.sub(r"[0-9A-Fa-f]{8,}|\d+", "#", last).casefold()
        letters = self._shapes.setdefault(shape, _letters(len(self._shapes)))
        neutral = f"{letters}{self._budget.num_members:06d}{suffix}"
        self._content.names[neutral] = _shown_name(last)
        hidden = "." if last.startswith(".") else ""
        return folder / f"{hidden}{neutral}"


def _opened_zip(path: Path, shown: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except NotImplementedError:
        problem = "it needs a newer version of the zip format than is supported"
        raise _refusal(shown, problem, _UNPACK, "import.archive.not-supported") from None


def _damaged(archive: Path, error: Exception) -> VolumeImportError:
    problem = f"it is damaged or incomplete ({type(error).__name__})"
    return _refusal(archive, problem, "copy it again", "import.archive.damaged")


def _letters(number: int) -> str:
    """Return three letters for a number; all numbers above 17575 have the last three letters."""
    number = min(number, 26**3 - 1)
    return "".join(chr(ord("a") + number // base % 26) for base in (676, 26, 1))


def _safe_name(name: str) -> str:
    safe = "".join(c if c.isalnum() or c in "._- ()" else "_" for c in name).lstrip(".")
    return safe[-120:] or "file"


def _shown_name(name: str) -> str:
    """Return the last part of a member's name for messages; of a UID only the last characters stay."""
    last = re.split(r"[/\\]", name)[-1]
    last = "".join(c for c in last if unicodedata.category(c)[0] != "C")
    return f"...{last[-8:]}" if _UID_NAME.search(last) else bounded_name(last)


def _zip_name(member: zipfile.ZipInfo) -> str:
    """Return the name of a member; a name without the mark of UTF-8 may still be UTF-8, else it is CP437."""
    if member.flag_bits & 0x800:
        return member.filename
    with contextlib.suppress(UnicodeError):
        return member.orig_filename.encode("cp437").decode("utf-8")
    return member.filename


def _check_directory_size(path: Path, budget: _Budget) -> None:
    """Raise an error if the directory of a zip archive, which is read whole, is implausibly large."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - (1 << 16) - 22))
        tail = file.read()
    at = tail.rfind(_EMPTY_ZIP)
    if at < 0 or at + 20 > len(tail):
        raise zipfile.BadZipFile
    num_entries, num_bytes = struct.unpack_from("<HI", tail, at + 10)
    at64 = tail.rfind(b"PK\x06\x06", 0, at)
    if at64 >= 0 and at64 + 56 <= len(tail):
        num_entries, num_bytes = struct.unpack_from("<QQ", tail, at64 + 32)
    if num_entries > MAX_FILES:
        raise budget.too_large(f"it contains more than {MAX_FILES} files")
    if num_bytes > _MAX_DIRECTORY_BYTES:
        raise budget.too_large(f"its directory has {num_bytes} bytes")


class _ForwardReader(io.RawIOBase):
    """Reader of an unpacked stream for ``tarfile`` that only moves forward and refuses long reads."""

    def __init__(self, source: BinaryIO, watch: Watch) -> None:
        super().__init__()
        self._source = source
        self._watch = watch
        self._at = 0
        self._last = b""

    @property
    def is_at_end_mark(self) -> bool:
        """Whether the last block that was read marks the end of an archive."""
        return self._last == bytes(tarfile.BLOCKSIZE)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        if whence != io.SEEK_SET or offset < self._at:
            msg = "backward seek"
            raise tarfile.ReadError(msg)
        while self._at < offset:
            self._watch.step("Unpacking the archive")
            if not self.read(min(_CHUNK, offset - self._at)):
                break
        return self._at

    def read(self, size: int = -1, /) -> bytes:
        if not 0 <= size <= _MAX_TAR_HEADER_BYTES:
            msg = "a header is too long"
            raise tarfile.ReadError(msg)
        self._last = self._source.read(size)
        self._at += len(self._last)
        return self._last
