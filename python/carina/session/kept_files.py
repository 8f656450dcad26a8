"""Interfaces of the storage of cases and CTs, so that tests can replace disks by memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from carina.display import one_line

if TYPE_CHECKING:
    from carina.case.moment import Moment
    from carina.case.recordings import RecordingFacts, RecordingWriter, WholeRecording
    from carina.case.save_mark import SaveMark
    from carina.disk import Placement
    from carina.session.case_scan import CaseScans
    from carina.session.parts import Cancel, Progress
    from carina.session.scene import ShownCase
    from carina.volume import Volume

__all__ = ["CtCache", "KeptCt", "KeptFile", "KeptFiles", "WholeCase"]


class KeptFile(Protocol):
    """A case file: :class:`carina.case.CaseFile`."""

    def save(self, moment: Moment) -> None:
        """Write what is new."""

    def load(self, volume: Volume) -> Moment:
        """Return the moment that was written last; CaseFileError ``case.empty`` where nothing was."""

    def keep_recording(self, recording: RecordingWriter) -> None:
        """Write what was recorded since the last call."""

    def recordings(self) -> tuple[RecordingFacts, ...]:
        """Those that it holds, in their order."""

    def set_recordings(self, wanted: Sequence[RecordingFacts], *, removed: Collection[int]) -> None:
        """Have them called, described and ordered so, without the removed ones."""

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
        """Nothing more is written."""


class KeptCt(Protocol):
    """A CT that is kept to open faster."""

    @property
    def digest(self) -> str:
        """What it is known by."""

    @property
    def num_bytes(self) -> int:
        """On the disk."""


class CtCache(Protocol):
    """CTs that are kept to open faster: :class:`carina.volume.VolumeCache`."""

    @property
    def is_on(self) -> bool:
        """It may keep something."""

    @property
    def can_be_on(self) -> bool:
        """It may be switched on."""

    def sizes(self) -> Sequence[KeptCt]:
        """Return the cached CTs with their sizes."""

    def forget(self, digest: str) -> int:
        """Remove a CT; returns the bytes removed."""

    def empty(self) -> int:
        """Remove every CT; returns the bytes removed."""

    def switch(self, on: bool) -> None:
        """Keep CTs from now on, or none and also not those that are kept."""


@one_line
@dataclass(frozen=True, slots=True)
class WholeCase:
    """All that a case file holds, in memory."""

    volume: Volume
    digest: str
    moment: Moment
    flights: Sequence[WholeRecording]


def _nothing() -> None:
    """Of a CT nothing is kept."""


@one_line
@dataclass(frozen=True, slots=True)
class KeptFiles:
    """How case files are made and opened, and how a CT is known again."""

    create: Callable[[Path, Volume, str], KeptFile]
    """``create(path, volume, digest)``."""
    open: Callable[[Path], KeptFile]
    write: Callable[[Path, WholeCase, str | None, SaveMark, Placement], None]
    """``write(path, case, ct_place, save_mark, placement)`` writes a case from memory as one whole file."""
    digest: Callable[[Volume], str]
    """What a CT is known by."""
    open_ct: Callable[[str, Progress, Cancel], Volume] | None = None
    """``open_ct(path, progress, cancel)`` gives a CT that was opened before from what was kept of it; None: nothing
    is kept of CTs."""
    close: Callable[[], None] = _nothing
    """No more CT is kept."""
    picture: Callable[[ShownCase], bytes] | None = None
    """A small JPEG of what is shown; None makes none."""
    cache: CtCache | None = None
    """The CTs that are kept, to be looked after."""
    scans: CaseScans | None = None
    """Looks for the CTs of case files; None opens none."""
