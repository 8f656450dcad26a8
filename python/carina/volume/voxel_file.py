"""File with the voxels of a volume as they are in memory, written atomically and checked when it is read.

The name of the file states its content (digest, axes, shape), so that two writers of one name write the same content.
The file is read by plain reads and not mapped: a truncated file then raises an error, whereas a map would end the
process (SIGBUS). A checksum for each chunk detects changes on the disk (docs/decisions/0110).
"""

from __future__ import annotations

import io
import math
import os
import re
import struct
import threading
import zlib
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.disk import Draft
from carina.typed_reading import read_json
from carina.volume.progress import Watch

SUFFIX = ".voxels"
_MAGIC = b"CARINACT"
_VERSION = 1
# Magic, version, length of the header, its CRC-32; then the header as JSON, zeros up to a page, the voxels.
_START = struct.Struct("<8sIII")
_PAGE = 4096
_MAX_HEADER_BYTES = 1 << 22
_CHUNK_BYTES = 1 << 20
_POLL_INTERVAL_S = 0.05  # interval between checks for cancellation
_THREADS = min(4, os.cpu_count() or 1)
_NAME = re.compile(r"(?P<digest>[0-9a-f]{64})-(?P<axes>[LRPASI]{3})-(?P<nx>\d{1,9})x(?P<ny>\d{1,9})x(?P<nz>\d{1,9})")


class DamagedFileError(ValueError):
    """Error for a cached file that is truncated, altered, or of another version."""


@dataclass(frozen=True, slots=True)
class VoxelName:
    """The content of a file of voxels, as its name states it, without information about the patient."""

    digest: str
    axes: str
    """Directions of i, j and k: ``LPS``, ``RAS``, ..."""
    shape_zyx: tuple[int, int, int]

    @property
    def file_name(self) -> str:
        """Name of a file with this content."""
        nz, ny, nx = self.shape_zyx
        return f"{self.digest}-{self.axes}-{nx}x{ny}x{nz}{SUFFIX}"

    @property
    def num_bytes(self) -> int:
        """Number of bytes of the voxels."""
        return 2 * math.prod(self.shape_zyx)

    @classmethod
    def of_file(cls, path: Path) -> VoxelName | None:
        """Return the content that a file's name states; None if it is not the name of a file of voxels."""
        match = _NAME.fullmatch(path.name.removesuffix(SUFFIX)) if path.name.endswith(SUFFIX) else None
        if match is None:
            return None
        nx, ny, nz = (int(match[n]) for n in ("nx", "ny", "nz"))
        return cls(match["digest"], match["axes"], (nz, ny, nx))


class _Header(msgspec.Struct, frozen=True):
    """Header of a voxel file: its name, the size of a chunk, and the CRC-32 of each chunk."""

    name: str
    chunk_bytes: int
    crc32: tuple[int, ...]


def draft_voxel_file(
    folder: Path, name: VoxelName, hu_zyx: NDArray[np.int16], *, cancel: Callable[[], bool] | None = None
) -> Draft:
    """Write the voxels of a CT to a draft, an unfinished file that only this user can read.

    The caller commits the draft, which gives the file its final name in the same folder.

    Parameters
    ----------
    folder, name
        Folder of the final file, and the description of the voxels (digest, shape, axes) from which its name is made.
    hu_zyx
        (nz, ny, nx) int16 with the axes that the name states.
    cancel
        Called often; when it returns true, the draft is deleted.

    Returns
    -------
    Draft
        The complete draft.

    Raises
    ------
    DiskError
        If the voxels cannot be written.
    CancelledError
        If ``cancel()`` returned true.
    """
    watch = Watch(None, cancel)
    voxels = np.ascontiguousarray(hu_zyx, dtype="<i2").reshape(-1).view(np.uint8).data
    chunks = [voxels[first : first + _CHUNK_BYTES] for first in range(0, len(voxels), _CHUNK_BYTES)]
    with ThreadPoolExecutor(_THREADS) as pool:
        header = msgspec.json.encode(_Header(name.file_name, _CHUNK_BYTES, tuple(pool.map(zlib.crc32, chunks))))
    draft = Draft(folder / name.file_name, what="the cached CT", needed_bytes=len(voxels), private=True)
    try:
        start = _START.pack(_MAGIC, _VERSION, len(header), zlib.crc32(header)) + header
        draft.file.write(start.ljust(_voxels_offset(len(header)), b"\0"))
        for chunk in chunks:
            watch.step("Caching the CT")
            draft.file.write(chunk)
        # Flushed here, because the caller may hold a lock during the commit and must not wait for the disk.
        draft.file.flush()
        os.fsync(draft.file.fileno())
    except OSError as error:
        draft.discard()
        raise draft.disk_error(error) from error
    except BaseException:
        draft.discard()
        raise
    return draft


def read_voxel_file(path: Path, name: VoxelName, watch: Watch) -> NDArray[np.int16]:
    """Read and check the voxels ``(nz, ny, nx)``.

    Parameters
    ----------
    path
        The file.
    name
        The expected content of the file.
    watch
        Progress and cancellation.

    Raises
    ------
    DamagedFileError
        If the file is truncated, altered, or does not match its name.
    OSError
        If the disk reports an error.
    CancelledError
        If the user cancels.
    """
    with path.open("rb", buffering=0) as file:
        header, begin = _read_header(file, name)
        # Checked before memory of that size is allocated.
        if os.fstat(file.fileno()).st_size != begin + name.num_bytes:
            raise DamagedFileError("its size has changed since it was written")
    out = np.empty(name.shape_zyx, dtype="<i2")
    place = out.reshape(-1).view(np.uint8).data
    count = len(header.crc32)
    stop, num_read = threading.Event(), [0] * _THREADS

    def read(part: int) -> None:
        first, last = part * count // _THREADS, (part + 1) * count // _THREADS
        with path.open("rb", buffering=0) as file:
            file.seek(begin + first * header.chunk_bytes)
            for number in range(first, last):
                if stop.is_set():
                    return
                chunk = place[number * header.chunk_bytes : (number + 1) * header.chunk_bytes]
                _read_full(file, chunk)
                # Checked while the chunk is still in the processor's cache.
                if zlib.crc32(chunk) != header.crc32[number]:
                    raise DamagedFileError(f"chunk {number} of {count} was altered")
                num_read[part] += 1

    watch.step("Reading the cached CT", 0.0)
    with ThreadPoolExecutor(_THREADS) as pool:
        running = [pool.submit(read, part) for part in range(_THREADS)]
        try:
            waiting = set(running)
            while waiting:
                watch.step("Reading the cached CT", sum(num_read) / count)
                done, waiting = wait(waiting, timeout=_POLL_INTERVAL_S, return_when=FIRST_EXCEPTION)
                for future in done:
                    future.result()
        finally:
            stop.set()
    return out.astype(np.int16, copy=False)


def _voxels_offset(header_bytes: int) -> int:
    """Return the offset in bytes of the voxels: the first page after the header."""
    return -(-(_START.size + header_bytes) // _PAGE) * _PAGE


def _read_header(file: io.FileIO, name: VoxelName) -> tuple[_Header, int]:
    """Return the checked header of a voxel file, and the offset of its voxels in bytes."""
    start = file.read(_START.size)
    if len(start) < _START.size:
        raise DamagedFileError("it is truncated")
    magic, version, num_bytes, crc32 = _START.unpack(start)
    if magic != _MAGIC or version != _VERSION or num_bytes > _MAX_HEADER_BYTES:
        raise DamagedFileError("its first bytes were altered, or it was written by another version")
    text = bytearray(num_bytes)
    _read_full(file, memoryview(text))
    if zlib.crc32(text) != crc32:
        raise DamagedFileError("its header was altered")
    try:
        header = read_json(text, _Header)
    except msgspec.MsgspecError as error:
        raise DamagedFileError("its header was written by another version") from error
    if header.name != name.file_name:
        raise DamagedFileError("its content does not match the CT in its name")
    return header, _voxels_offset(num_bytes)


def _read_full(file: io.FileIO, place: memoryview) -> None:
    """Read from a file until a buffer is full; raise an error if the file ends before."""
    while len(place):
        count = file.readinto(place)
        if not count:
            raise DamagedFileError("it is truncated")
        place = place[count:]
