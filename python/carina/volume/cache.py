"""Cache of opened CTs on the disk; a cached CT is opened by reading one file, without decoding.

The folder contains two kinds of files, which are written atomically, never changed, and readable by this user only:

- ``DIGEST-LPS-512x512x600.voxels``: the voxels (``voxel_file``), shared by all sources with these voxels;
- ``HASH.source``: for one path and series, all other fields of :class:`Volume`, and the state of the files that it was
  read from. The hash is that of the path; no file name contains the name of a file, a folder or a patient.

A cached volume is identical to one that is read from its files. Errors of the cache cost time but never change a voxel:
a file that is truncated, altered, or written by another version of Carina is not used (docs/decisions/0110).
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.disk import make_folder, say_size, sweep_drafts, write_whole
from carina.disk.locks import try_lock
from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, CarinaError
from carina.typed_reading import read_json
from carina.volume.code_digest import reader_digest
from carina.volume.digest import canonical_axes, ct_digest
from carina.volume.io_errors import guarded
from carina.volume.model import Volume, VolumeSource
from carina.volume.progress import Watch
from carina.volume.quality import Quality, quality_gate
from carina.volume.source_files import CtSource, absolute
from carina.volume.voxel_file import DamagedFileError, VoxelName, draft_voxel_file, read_voxel_file

logger = logging.getLogger(__name__)

MAX_BYTES = 20_000_000_000
"""Maximum size of all cached CTs in bytes; a tenth of the free disk is a second limit."""
MAX_AGE_S = 90 * 86_400.0
"""Time in s after its last use from which a cached CT is deleted."""
_SHARE_OF_FREE = 0.1
_SOURCE = ".source"
_SOURCE_NAME = re.compile(r"[0-9a-f]{40}\.source")
_LOCK = "lock"
# Age in seconds below which a voxel file without a source file is not deleted: its source may be about to be written.
_FOUND_FOR_S = 3600.0
_MAX_RECORD_BYTES = 1 << 24

Cancel = Callable[[], bool]
State = Literal["unchanged", "changed", "missing"]


class _Record(msgspec.Struct, frozen=True):
    """All fields of a volume except its voxels, and the source that it was read from."""

    made_by: str
    voxels: VoxelName
    lps_from_ijk: tuple[tuple[float, ...], ...]
    is_hu: bool
    not_hu_reason: str | None
    volume_source: VolumeSource
    value_range: tuple[int, int]
    quality: Quality
    source: CtSource


@one_line
@dataclass(frozen=True, slots=True)
class CachedSize:
    """Size and last use of one cached CT, for a list."""

    digest: str
    num_bytes: int
    last_used_s: float
    """Last use, in seconds since 1970."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class OpenedCt:
    """Volume that was opened, with the state whether it came from the cache."""

    volume: Volume
    source: CtSource | None
    """The source that the volume was read from, for storing in the cache; None if it is unknown or the cache is off."""
    from_cache: bool


class CachedCt:
    """A CT in the cache whose voxels are not read yet."""

    def __init__(self, cache: VolumeCache, record: _Record) -> None:
        self._cache, self._record = cache, record
        self.digest = record.voxels.digest
        """Digest of the voxels; see :func:`ct_digest`."""
        self.shape_zyx = record.voxels.shape_zyx
        self.lps_from_ijk: NDArray[np.float64] = np.array(record.lps_from_ijk, dtype=np.float64)
        self.source = record.source
        """Path from which the CT was opened, and the state of its files at that time."""

    def __repr__(self) -> str:
        """Return a text with the digest and the shape of the CT."""
        return f"CachedCt(digest={self.digest[:12]}..., shape_zyx={self.shape_zyx})"

    @property
    def state(self) -> State:
        """Whether the files from which the CT was read are unchanged, changed or missing.

        If the state is ``changed``, the caller opens the files and compares digests. The state is ``missing`` if a file
        cannot be accessed.
        """
        now = self.source.now()
        return "missing" if now is None else "unchanged" if now == self.source.files else "changed"

    @shows_progress
    def load(self, *, progress: ProgressChoice = None, cancel: Cancel | None = None) -> Volume | None:
        """Read the cached volume; return None if its voxel file is missing, or is damaged and was therefore deleted.

        Parameters
        ----------
        progress
            See :func:`open_volume`.
        cancel
            Called repeatedly; a true result cancels the reading.

        Raises
        ------
        CancelledError
            If ``cancel()`` returned true.
        """
        values = self._cache._read(self._record, Watch(progress_function(progress), cancel))
        return None if values is None else _volume_of(self._record, values)


class VolumeCache:
    """A folder of opened CTs with limited size and age.

    Several processes may use the folder at the same time, and the folder may be deleted during use.

    Parameters
    ----------
    folder
        Created when the first CT is stored.
    max_bytes
        Largest size of all voxels; 0 switches the cache off, and :meth:`sweep` then empties it. None selects the
        smaller of :data:`MAX_BYTES` and a tenth of the free disk.
    max_age_s
        Time in seconds for which a CT is stored after its last use.
    clock
        Returns the current time in seconds since 1970.
    """

    def __init__(
        self,
        folder: Path,
        *,
        max_bytes: int | None = None,
        max_age_s: float = MAX_AGE_S,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._folder = Path(folder)
        self._max_bytes = self._configured_max_bytes = max_bytes
        self._max_age_s = max_age_s
        self._clock = clock
        self._lock = threading.Lock()
        self._forgotten: dict[str, int] = {}
        """Number of calls of :meth:`forget` by digest; a CT that is being written during a call is discarded."""
        self._ending = threading.Event()
        self._keeping: list[threading.Thread] = []

    def __repr__(self) -> str:
        """Return the number and the size of the cached CTs."""
        sizes = self.sizes()
        return f"VolumeCache({len(sizes)} CTs, {say_size(sum(size.num_bytes for size in sizes))})"

    @property
    def is_on(self) -> bool:
        """Whether the cache stores the CTs that are opened."""
        return self._max_bytes != 0

    @property
    def can_be_on(self) -> bool:
        """Whether :meth:`switch` can switch the cache on: it was not created with 0 bytes."""
        return self._configured_max_bytes != 0

    def switch(self, on: bool) -> None:
        """Switch the cache on, or switch it off and delete the stored CTs."""
        self._max_bytes = self._configured_max_bytes if on else 0
        if not on:
            self.empty()

    @shows_progress
    def open(
        self,
        path: str | Path,
        *,
        series: str | None = None,
        progress: ProgressChoice = None,
        cancel: Cancel | None = None,
    ) -> OpenedCt:
        """Open a CT from the cache if its files are unchanged, otherwise with :func:`open_volume`.

        A CT that was read from its files is not stored yet; the caller passes the result to :meth:`keep` later.

        Parameters
        ----------
        path, series, progress, cancel
            As in :func:`open_volume`.

        Raises
        ------
        VolumeImportError, UsageError, CancelledError
            As in :func:`open_volume`.
        """
        found = self.find(path, series=series)
        if found is not None and found.state == "unchanged":
            volume = guarded(absolute(path), lambda _path: found.load(progress=progress, cancel=cancel))
            if volume is not None:
                return OpenedCt(volume, found.source, from_cache=True)
        from carina.volume.opening import open_volume  # slow to load, and not needed for a cached CT

        source = CtSource.of(path, series=series) if self.is_on else None
        volume = open_volume(path, series=series, progress=progress, cancel=cancel)
        return OpenedCt(volume, source, from_cache=False)

    def keep(self, opened: OpenedCt, *, cancel: Cancel | None = None) -> bool:
        """Store a CT that was read from its files, and return whether the cache now contains it.

        The method reads and writes all voxels, so the caller runs it in the background.

        Raises
        ------
        CancelledError
            If ``cancel()`` returned true.
        """
        if opened.from_cache or opened.source is None:
            return opened.from_cache
        return self.put(opened.volume, opened.source, cancel=cancel)

    @shows_progress
    def open_and_keep(
        self,
        path: str | Path,
        *,
        series: str | None = None,
        progress: ProgressChoice = None,
        cancel: Cancel | None = None,
    ) -> Volume:
        """Open a CT as :meth:`open` does; a background thread stores a CT that was read from its files.

        Raises
        ------
        VolumeImportError, UsageError, CancelledError
            As in :func:`open_volume`.
        """
        opened = self.open(path, series=series, progress=progress, cancel=cancel)
        if not opened.from_cache and not self._ending.is_set():
            # A daemon thread: the end of Carina does not wait for it, and the next process deletes its draft.
            thread = threading.Thread(
                target=self._store_in_background, args=(opened,), name="carina-ct-keep", daemon=True
            )
            with self._lock:
                self._keeping = [*(t for t in self._keeping if t.is_alive()), thread]
            thread.start()
        return opened.volume

    def _store_in_background(self, opened: OpenedCt) -> None:
        with contextlib.suppress(CancelledError):
            self.keep(opened, cancel=self._ending.is_set)

    def wait_stored(self) -> None:
        """Wait until the background threads have stored their CTs."""
        with self._lock:
            threads = list(self._keeping)
        for thread in threads:
            thread.join()

    def close(self) -> None:
        """Cancel the background threads, and start no more of them."""
        self._ending.set()
        self.wait_stored()

    def find(self, path: str | Path, *, series: str | None = None) -> CachedCt | None:
        """Return the cached CT of a path and series, without a check whether the files are unchanged."""
        if not self.is_on:
            return None
        place = absolute(path)
        record = self._record(self._folder / _source_name(place, series))
        if record is None or (record.source.path, record.source.series) != (place, series):
            return None
        return self._cached_ct(record)

    def find_digest(self, digest: str) -> CachedCt | None:
        """Return the cached CT with a digest, wherever its files are now; the source used last has priority."""
        if not self.is_on:
            return None
        newest_first = sorted(self._sources(), key=lambda one: -one[1].st_mtime)
        records = (self._record(path) for path, _ in newest_first)
        found = (self._cached_ct(record) for record in records if record is not None and record.voxels.digest == digest)
        return next((cached for cached in found if cached is not None), None)

    @shows_progress
    def get(
        self,
        path: str | Path,
        *,
        series: str | None = None,
        progress: ProgressChoice = None,
        cancel: Cancel | None = None,
    ) -> Volume | None:
        """Return the volume of a path and series if its files are unchanged, otherwise None.

        Raises
        ------
        CancelledError
            If ``cancel()`` returned true.
        """
        found = self.find(path, series=series)
        if found is None or found.state != "unchanged":
            return None
        return found.load(progress=progress, cancel=cancel)

    def put(self, volume: Volume, source: CtSource, *, cancel: Cancel | None = None) -> bool:
        """Store a volume. If the cache contains its voxels already, only the source is written.

        Parameters
        ----------
        volume
            The volume as opened from the source.
        source
            The source as recorded before the volume was opened.
        cancel
            Called repeatedly; a true result cancels the operation.

        Returns
        -------
        bool
            Whether the volume is stored. False if the files changed during or shortly before reading, if there is no
            space, if the disk refuses (this is logged), or if :meth:`forget` deleted the CT meanwhile.

        Raises
        ------
        CancelledError
            If ``cancel()`` returned true.
        """
        if not self.is_on or not source.is_settled(self._clock()) or not source.is_unchanged:
            return False
        digest = ct_digest(volume, cancel=cancel)
        with self._lock:
            forgotten = self._forgotten.get(digest, 0)
        record = _record_of(volume, source)
        name = record.voxels

        def is_wanted() -> bool:
            return self._forgotten.get(digest, 0) == forgotten

        try:
            make_folder(self._folder, what="cached CTs", private=True)
            place = self._folder / name.file_name
            if not self._is_whole(place, name):
                if not self._reserve_space(name.num_bytes):
                    return False
                draft = draft_voxel_file(self._folder, name, volume.hu_zyx, cancel=cancel)
                with self._lock:
                    if not is_wanted():
                        draft.discard()
                        return False
                    draft.commit()
            with self._lock:
                if not is_wanted():
                    return False
                self._touch(place)
                target = self._folder / _source_name(source.path, source.series)
                write_whole(target, _pack_record(record), what="the cached CT", private=True)
                self._touch(target)
        except OSError as error:
            logger.warning("a CT could not be cached: %s", error.strerror)
            return False
        except UnicodeEncodeError:
            return False  # a file name that is not valid text
        self.sweep()
        return True

    def sizes(self) -> tuple[CachedSize, ...]:
        """Return the cached CTs with their sizes, the CT used last first."""
        found: dict[str, list[tuple[int, float]]] = {}
        for _, name, seen in self._voxels():
            found.setdefault(name.digest, []).append((seen.st_size, seen.st_mtime))
        sizes = [
            CachedSize(digest, sum(size for size, _ in files), max(used_s for _, used_s in files))
            for digest, files in found.items()
        ]
        return tuple(sorted(sizes, key=lambda one: -one.last_used_s))

    def forget(self, digest: str) -> int:
        """Delete all files of a CT, also those that this cache is writing; return the number of bytes deleted."""
        with self._lock:
            self._forgotten[digest] = self._forgotten.get(digest, 0) + 1
            freed = 0
            for path, _ in self._sources():
                record = self._record(path)
                # A record that cannot be read may belong to this CT, so it is deleted too.
                if record is None or record.voxels.digest == digest:
                    freed += _remove(path)
            for path, name, _ in self._voxels():
                if name.digest == digest:
                    freed += _remove(path)
            return freed

    def empty(self) -> int:
        """Delete every CT; return the number of bytes deleted."""
        return sum(self.forget(one.digest) for one in self.sizes())

    def sweep(self) -> int:
        """Delete CTs that are too old, exceed the size limit or are damaged; return the number of bytes deleted.

        Nothing is deleted while another process sweeps. Files with other names stay.
        """
        return self._sweep_if_alone(0)

    def _sweep_if_alone(self, needed_bytes: int) -> int:
        sweep_drafts(self._folder)
        with self._sweep_lock() as alone:
            return self._sweep(needed_bytes) if alone else 0

    def _sweep(self, needed_bytes: int) -> int:
        """Delete files that are too old, damaged or without a counterpart, then the oldest CTs above the size limit."""
        now_s, freed = self._clock(), 0
        records: dict[str, list[Path]] = {}
        for path, seen in self._sources():
            record = self._record(path)
            if record is None or now_s - seen.st_mtime > self._max_age_s:
                freed += _remove(path)
            else:
                records.setdefault(record.voxels.file_name, []).append(path)
        left: list[tuple[float, int, Path]] = []
        for path, _, seen in self._voxels():
            if path.name not in records and now_s - seen.st_mtime > _FOUND_FOR_S:
                freed += _remove(path)
            else:
                left.append((seen.st_mtime, seen.st_size, path))
        bound = self._size_limit(sum(size for _, size, _ in left)) - needed_bytes
        total = 0
        for _, size, path in sorted(left, reverse=True):
            total += size
            if total > bound:
                freed += _remove(path)
                for record_path in records.pop(path.name, ()):
                    freed += _remove(record_path)
        for name, paths in records.items():
            if not (self._folder / name).exists():
                freed += sum(map(_remove, paths))
        return freed

    def _reserve_space(self, num_bytes: int) -> bool:
        """Delete the oldest CTs if necessary, and return whether a CT of this size can be stored."""
        if num_bytes > self._size_limit(sum(seen.st_size for _, _, seen in self._voxels())):
            logger.info("a CT was not cached, because it is larger than the size limit of the cache")
            return False
        self._sweep_if_alone(num_bytes)
        return True

    def _size_limit(self, held_bytes: int) -> float:
        """Return the size limit of the cache in bytes, which depends on the free space of its disk."""
        if self._max_bytes is not None:
            return self._max_bytes
        try:
            # The size of the cache counts as free space; otherwise the cache would shrink because of its own size.
            free = shutil.disk_usage(self._folder).free + held_bytes
        except OSError:
            return MAX_BYTES
        return min(MAX_BYTES, _SHARE_OF_FREE * free)

    @contextlib.contextmanager
    def _sweep_lock(self) -> Iterator[bool]:
        """Lock the cache for the deletion of old CTs; yield whether the lock was free.

        Without support for locks two processes may sweep at once; they delete the same files.
        """
        try:
            descriptor = os.open(self._folder / _LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
        except OSError:
            yield self._folder.is_dir()
            return
        try:
            yield try_lock(descriptor) is not False
        finally:
            os.close(descriptor)

    def _is_whole(self, place: Path, name: VoxelName) -> bool:
        """Return whether the voxel file of a CT can be read and is intact; a damaged file is deleted."""
        try:
            read_voxel_file(place, name, Watch())
        except FileNotFoundError:
            return False
        except (OSError, ValueError) as error:
            self._handle_damage(place, error)
            return False
        return True

    def _read(self, record: _Record, watch: Watch) -> NDArray[np.int16] | None:
        """Read the voxels of a record; return None if their file is missing or damaged."""
        place = self._folder / record.voxels.file_name
        try:
            values = read_voxel_file(place, record.voxels, watch)
        except FileNotFoundError:
            return None
        except CarinaError:
            raise
        except (OSError, ValueError) as error:
            self._handle_damage(place, error)
            return None
        self._touch(place)
        self._touch(self._folder / _source_name(record.source.path, record.source.series))
        return values

    def _handle_damage(self, place: Path, error: Exception) -> None:
        why = str(error) if isinstance(error, DamagedFileError) else type(error).__name__
        logger.warning("a cached CT could not be used (%s); reading the original files", why)
        if not isinstance(error, OSError):
            _remove(place)

    def _cached_ct(self, record: _Record) -> CachedCt | None:
        if record.made_by != reader_digest() or not (self._folder / record.voxels.file_name).is_file():
            return None
        return CachedCt(self, record)

    def _record(self, path: Path) -> _Record | None:
        try:
            with path.open("rb") as file:
                return _unpack_record(file.read(_MAX_RECORD_BYTES))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            logger.warning("the record of a cached CT could not be read (%s)", type(error).__name__)
            return None

    def _voxels(self) -> list[tuple[Path, VoxelName, os.stat_result]]:
        named = ((path, VoxelName.of_file(path), seen) for path, seen in self._files())
        return [(path, name, seen) for path, name, seen in named if name is not None]

    def _sources(self) -> list[tuple[Path, os.stat_result]]:
        return [(path, seen) for path, seen in self._files() if _SOURCE_NAME.fullmatch(path.name)]

    def _files(self) -> list[tuple[Path, os.stat_result]]:
        found = []
        try:
            with os.scandir(self._folder) as entries:
                for entry in entries:
                    with contextlib.suppress(OSError):  # another process has deleted the file
                        if entry.is_file(follow_symlinks=False):
                            found.append((Path(entry.path), entry.stat(follow_symlinks=False)))
        except OSError:
            return []
        return found

    def _touch(self, path: Path) -> None:
        """Set the modification time of a cached file to now, which records its last use."""
        now_s = self._clock()
        with contextlib.suppress(OSError):
            os.utime(path, (now_s, now_s))


def _source_name(path: Path, series: str | None) -> str:
    found = hashlib.blake2b(os.fsencode(path), digest_size=20, person=b"carina source")
    found.update(b"" if series is None else b"\0" + series.encode())
    return found.hexdigest() + _SOURCE


def _record_of(volume: Volume, source: CtSource) -> _Record:
    return _Record(
        made_by=reader_digest(),
        voxels=VoxelName(ct_digest(volume), canonical_axes(volume.lps_from_ijk).letters, volume.shape_zyx),
        lps_from_ijk=tuple(tuple(row) for row in volume.lps_from_ijk.tolist()),
        is_hu=volume.is_hu,
        not_hu_reason=volume.not_hu_reason,
        volume_source=volume.source,
        value_range=volume.value_range,
        quality=quality_gate(volume),
        source=source,
    )


def _volume_of(record: _Record, values: NDArray[np.int16]) -> Volume:
    volume = Volume(
        values,
        np.array(record.lps_from_ijk, dtype=np.float64),
        is_hu=record.is_hu,
        not_hu_reason=record.not_hu_reason,
        source=record.volume_source,
    )
    # Stored values: computing them again would take longer than reading the voxels.
    object.__setattr__(volume, "_range", record.value_range)
    object.__setattr__(volume, "_quality", record.quality)
    object.__setattr__(volume, "_digest", record.voxels.digest)
    return volume


def _encode(value: Any) -> Any:
    if isinstance(value, Path):
        return os.fsencode(value).hex()  # a file name need not be valid text
    raise TypeError


def _decode(kind: type, value: Any) -> Any:
    if kind is Path or issubclass(kind, Path):
        return Path(os.fsdecode(bytes.fromhex(value)))
    raise TypeError


def _pack_record(record: _Record) -> bytes:
    """Return a record as JSON after its digest, so that altered records are detected."""
    body = msgspec.json.encode(record, enc_hook=_encode)
    return hashlib.blake2b(body, digest_size=16).hexdigest().encode() + b"\n" + body


def _unpack_record(content: bytes) -> _Record:
    """Return the record that the content of a ``.source`` file describes.

    Raises
    ------
    ValueError
        If the file is truncated, altered, or written by another version.
    """
    head, _, body = content.partition(b"\n")
    if head != hashlib.blake2b(body, digest_size=16).hexdigest().encode():
        raise DamagedFileError("truncated or altered")
    try:
        return read_json(body, _Record, _decode)
    except msgspec.MsgspecError as error:
        raise DamagedFileError("written by another version") from error


def _remove(path: Path) -> int:
    """Delete a cached file; return the number of bytes deleted, 0 if the file stays."""
    try:
        size = path.stat().st_size
        path.unlink()
    except OSError as error:
        # The file is in use (Windows), gone, or cannot be deleted; the next sweep tries again.
        logger.debug("a cached file could not be removed", exc_info=error)
        return 0
    return size
