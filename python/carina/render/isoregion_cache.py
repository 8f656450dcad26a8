"""Disk cache of IsoRegion maps, keyed by the data from which a map is built and checked on reading.

The cache folder can be deleted at any time. On most machines building a map is faster than reading it, so only maps
that were slow to build are stored (docs/decisions/0104).
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.disk import drafted, make_folder
from carina.volume.code_digest import compiled_code_digest

logger = logging.getLogger(__name__)

# Increment this number if the map of the same input or the file's layout changes.
MAP_VERSION = 2
SLOW_NS_PER_VOXEL = 5.0
"""Build time above which a map is stored, ns per voxel: three times the cost of hashing, reading and checking a map."""
DEFAULT_MAX_BYTES = 2 << 30
_MAGIC = b"CARINAMP"
# Start of a file: magic, version, length of the JSON header. The header and its arrays follow.
_START = struct.Struct("<8sII")
_MAX_HEADER_BYTES = 1 << 20
_ABANDONED_S = 3600.0

Arrays = tuple[NDArray[np.uint8], ...]


@dataclass(frozen=True, slots=True)
class MapName:
    """Key of a stored radius map: voxel values and classes. It contains nothing about the patient."""

    values_zyx: NDArray[np.int16]
    classes: Any
    """Kind of the map and its classes, as plain values; the key uses their ``repr``."""

    @property
    def stem(self) -> str:
        """First part of the map's file name, from the classes, the shape and the code that builds maps.

        The first part is computed without reading the voxels.
        """
        text = repr((MAP_VERSION, compiled_code_digest(), self.values_zyx.shape, self.classes))
        return hashlib.blake2b(text.encode(), digest_size=10).hexdigest()

    def full(self) -> str:
        """Return the complete file name of the map, which contains a digest of every voxel."""
        return self.stem + _core.content_digest(np.ascontiguousarray(self.values_zyx))[:40]


@dataclass(frozen=True, slots=True)
class CachedMap:
    """IsoRegion map: arrays ``(nz, ny, nx)`` uint8 of the volume's shape, and JSON values that describe the map."""

    arrays: Arrays
    meaning: Any = None


class MapCache:
    """Folder of maps with a size limit; several processes may use it, and it may be deleted while in use.

    An incomplete or altered file counts as missing and is removed. A disk error is logged, and the map is built again;
    no picture fails. A separate thread writes the files.
    """

    def __init__(self, folder: Path, *, max_bytes: int = DEFAULT_MAX_BYTES) -> None:
        self._folder = Path(folder)
        self._max_bytes = max_bytes
        self._storing: list[threading.Thread] = []

    def get_or_build(self, name: MapName, build: Callable[[], CachedMap]) -> CachedMap:
        """Return the map of this name from disk, else from ``build``; a map that was slow to build is then stored."""
        # The full name needs a read of the whole volume, so it is computed only if a file matches the first part.
        if any(self._folder.glob(f"{name.stem}*.isoregion")):
            found = self._load(name)
            if found is not None:
                return found
        began_s = time.perf_counter()
        built = build()
        if (time.perf_counter() - began_s) * 1e9 > SLOW_NS_PER_VOXEL * name.values_zyx.size:
            thread = threading.Thread(target=self._store, args=(name, built), name="carina-map-store")
            self._storing = [t for t in self._storing if t.is_alive()] + [thread]
            thread.start()
        return built

    def wait_stored(self) -> None:
        """Wait until no map is being stored."""
        for thread in self._storing:
            thread.join()

    def _path(self, name: MapName) -> Path:
        return self._folder / f"{name.full()}.isoregion"

    def _load(self, name: MapName) -> CachedMap | None:
        path = self._path(name)
        try:
            with path.open("rb") as file:
                found = _read(file, name.values_zyx.shape)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            logger.warning("a cached IsoRegion map could not be read and will be rebuilt: %s", type(error).__name__)
            logger.debug("reading a cached map", exc_info=error)
            _remove(path)
            return None
        try:
            os.utime(path)
        except OSError:
            logger.debug("the age of a cached map could not be renewed")
        return found

    def _store(self, name: MapName, built: CachedMap) -> None:
        """Write a map completely or not at all, then delete the oldest maps beyond the size limit."""
        header = json.dumps(
            {
                "shape_zyx": list(name.values_zyx.shape),
                "digests": [_core.content_digest(a) for a in built.arrays],
                "meaning": built.meaning,
            }
        ).encode()
        if sum(a.nbytes for a in built.arrays) + len(header) + _START.size > self._max_bytes:
            return
        try:
            make_folder(self._folder, what="IsoRegion maps", private=True)
            with drafted(self._path(name), what="an IsoRegion map", private=True) as out:
                out.write(_START.pack(_MAGIC, MAP_VERSION, len(header)))
                out.write(header)
                for array in built.arrays:
                    out.write(array.data)
            self._trim()
        except OSError as error:
            logger.warning("an IsoRegion map could not be cached: %s", error.strerror)

    def _trim(self) -> None:
        """Delete the least recently used maps beyond the size limit, and temporary files of killed processes."""
        ages = []
        for path in self._folder.iterdir():
            try:
                stat = path.stat()
            except OSError:
                continue  # Another process has deleted the file.
            if path.suffix == ".isoregion":
                ages.append((stat.st_mtime, stat.st_size, path))
            elif path.suffix == ".part" and time.time() - stat.st_mtime > _ABANDONED_S:
                _remove(path)
        total = 0
        for _, size, path in sorted(ages, reverse=True):
            total += size
            if total > self._max_bytes:
                _remove(path)


def _read(file: Any, shape_zyx: tuple[int, ...]) -> CachedMap:
    """Read the IsoRegion map that an open cache file contains.

    Raises
    ------
    ValueError, KeyError, TypeError
        If the file is damaged, or of another version or shape.
    """
    magic, version, header_bytes = _START.unpack(file.read(_START.size).ljust(_START.size, b"\0"))
    if magic != _MAGIC or version != MAP_VERSION or header_bytes > _MAX_HEADER_BYTES:
        raise ValueError("a map from another version")
    header = json.loads(file.read(header_bytes))
    digests = list(header["digests"])
    count = int(np.prod(shape_zyx))
    # The size is checked before a large allocation.
    body_bytes = os.fstat(file.fileno()).st_size - _START.size - header_bytes
    if tuple(header["shape_zyx"]) != shape_zyx or body_bytes != count * len(digests):
        raise ValueError("a map with a different shape")
    arrays = []
    for digest in digests:
        array = np.empty(shape_zyx, dtype=np.uint8)
        if file.readinto(array.data.cast("B")) != count or _core.content_digest(array) != digest:
            raise ValueError("incomplete or altered")
        arrays.append(array)
    return CachedMap(tuple(arrays), header["meaning"])


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        # The file is in use (Windows) or not writable; it stays until the next clean-up.
        logger.debug("a cached map could not be removed", exc_info=error)
