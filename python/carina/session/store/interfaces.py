"""Interfaces of the storage of cases and CTs, so that tests can replace disks by memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from carina.display import one_line

if TYPE_CHECKING:
    from carina.case.recordings import RecordingFacts, RecordingWriter, WholeRecording
    from carina.case.save_mark import SaveMark
    from carina.case.stored_state import Moment
    from carina.disk import Placement
    from carina.session.scene.shown_case import ShownCase
    from carina.session.store.find_scan import CaseScans
    from carina.volume import Volume


class StoredCaseFile(Protocol):
    """Interface of a case file, as :class:`carina.case.CaseFile` implements it."""

    def save(self, moment: Moment) -> None:
        """Write the parts of a case state that are not in the file yet."""

    def load(self, volume: Volume) -> Moment:
        """Return the case state that was written last; CaseFileError ``case.empty`` if none was written."""

    def keep_recording(self, recording: RecordingWriter) -> None:
        """Write the lines that were recorded since the last call."""

    def recordings(self) -> tuple[RecordingFacts, ...]:
        """Return the recordings in the file, in their order."""

    def set_recordings(self, wanted: Sequence[RecordingFacts], *, removed: Collection[int]) -> None:
        """Set names, descriptions and order of the recordings, and delete the removed ones."""

    def recording_text(self, recording_id: int) -> str:
        """Return the lines of a recording."""

    def write_copy(
        self,
        path: Path,
        *,
        ct_place: str | None = None,
        save_mark: SaveMark | None = None,
        placement: Placement | None = None,
    ) -> None:
        """Write the case as one whole file at another path, with the relative path from that file to its CT."""

    def close(self) -> None:
        """Close the file; nothing can be written afterwards."""


class CachedCtSource(Protocol):
    """Interface of an entry of the CT cache."""

    @property
    def digest(self) -> str:
        """Digest that identifies the CT."""

    @property
    def num_bytes(self) -> int:
        """Size of the cached CT on the disk."""


class CtCache(Protocol):
    """Interface of the cache of opened CTs, as :class:`carina.volume.VolumeCache` implements it."""

    @property
    def is_on(self) -> bool:
        """Whether the cache stores CTs."""

    @property
    def can_be_on(self) -> bool:
        """Whether the cache can be switched on."""

    def sizes(self) -> Sequence[CachedCtSource]:
        """Return the cached CTs with their sizes."""

    def forget(self, digest: str) -> int:
        """Delete a cached CT, and return the number of bytes deleted."""

    def empty(self) -> int:
        """Delete every cached CT, and return the number of bytes deleted."""

    def switch(self, on: bool) -> None:
        """Switch the cache on or off; switching it off deletes the cached CTs."""


@one_line
@dataclass(frozen=True, slots=True)
class WholeCase:
    """The whole content of a case file, in memory."""

    volume: Volume
    digest: str
    moment: Moment
    flights: Sequence[WholeRecording]


def _nothing() -> None:
    """Do nothing, because no CT is cached."""


@one_line
@dataclass(frozen=True, slots=True)
class CaseFileFunctions:
    """Functions that create, open and write case files, and identify and cache CTs."""

    create: Callable[[Path, Volume, str], StoredCaseFile]
    """``create(path, volume, digest)`` creates a case file."""
    open: Callable[[Path], StoredCaseFile]
    write: Callable[[Path, WholeCase, str | None, SaveMark, Placement], None]
    """``write(path, case, ct_place, save_mark, placement)`` writes a case from memory as one whole file."""
    digest: Callable[[Volume], str]
    """Returns the digest that identifies a CT."""
    open_ct: Callable[..., Volume] | None = None
    """``open_ct(path, progress, cancel, series=None)`` opens a CT, from the cache if the CT was opened before.

    None without a cache.
    """
    close: Callable[[], None] = _nothing
    """Closes the cache of CTs."""
    picture: Callable[[ShownCase], bytes] | None = None
    """Renders a thumbnail of a scene as JPEG; None stores no thumbnails."""
    cache: CtCache | None = None
    """The cache of CTs; None without a cache."""
    scans: CaseScans | None = None
    """Search for the CTs of case files; None if case files cannot be opened."""
