"""Radius maps on disk: found by what they were made from, checked when read, safe to delete."""

from __future__ import annotations

import hashlib
import logging
import os
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["MapCache", "content_key"]

logger = logging.getLogger(__name__)

# Raised when the map of the same input would come out different, or the file's layout changes.
MAP_VERSION = 1
_MAGIC = b"CARINAMP"
_HEADER = struct.Struct("<8sIIIII")
DEFAULT_MAX_BYTES = 2 << 30


def content_key(values_zyx: NDArray[np.int16], classes: list[tuple[int, int]]) -> str:
    """Name of a volume's map under transparent classes: made from voxel values alone, nothing about the patient."""
    digest = hashlib.blake2b(digest_size=20)
    digest.update(repr((MAP_VERSION, values_zyx.shape, classes)).encode())
    digest.update(np.ascontiguousarray(values_zyx).data)
    return digest.hexdigest()


class MapCache:
    """A folder of maps of bounded size.

    A file that is cut short or altered is taken for missing and removed. Trouble with the disk costs time, never a
    picture: it is logged and the map is built again.
    """

    def __init__(self, folder: Path, *, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self._folder = Path(folder)
        self._max_bytes = max_bytes

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.isoregion"

    def load(self, key: str, shape_zyx: tuple[int, int, int]) -> NDArray[np.uint8] | None:
        """The map of this name, or None."""
        path = self._path(key)
        try:
            raw = path.read_bytes()
        except OSError:
            return None
        count = int(np.prod(shape_zyx))
        if len(raw) == _HEADER.size + count:
            magic, version, nz, ny, nx, checksum = _HEADER.unpack_from(raw)
            body = memoryview(raw)[_HEADER.size :]
            same = magic == _MAGIC and version == MAP_VERSION and (nz, ny, nx) == shape_zyx
            if same and zlib.crc32(body) == checksum:
                try:
                    os.utime(path)
                except OSError:
                    logger.debug("the age of a cached map could not be renewed")
                return np.frombuffer(body, dtype=np.uint8).reshape(shape_zyx)
        logger.warning("a cached IsoRegion map was damaged; it is built again")
        path.unlink(missing_ok=True)
        return None

    def store(self, key: str, radius_zyx: NDArray[np.uint8]) -> None:
        """Write a map whole or not at all, then drop the oldest beyond the bound."""
        nz, ny, nx = radius_zyx.shape
        body = np.ascontiguousarray(radius_zyx).data
        header = _HEADER.pack(_MAGIC, MAP_VERSION, nz, ny, nx, zlib.crc32(body))
        if len(header) + body.nbytes > self._max_bytes:
            return
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self._folder, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as out:
                    out.write(header)
                    out.write(body)
                Path(name).replace(self._path(key))
            except BaseException:
                Path(name).unlink(missing_ok=True)
                raise
            self._trim()
        except OSError as error:
            logger.warning("an IsoRegion map could not be cached: %s", error.strerror)

    def _trim(self) -> None:
        files = sorted(self._folder.glob("*.isoregion"), key=lambda path: path.stat().st_mtime, reverse=True)
        total = 0
        for path in files:
            total += path.stat().st_size
            if total > self._max_bytes:
                path.unlink(missing_ok=True)
