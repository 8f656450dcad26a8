"""The files that opening a path reads: the path itself, the content of an archive, or the folder of a DICOMDIR file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from carina.errors import CarinaError
from carina.volume.archives import UnpackedArchive, archive_kind, unpacked_archive
from carina.volume.bids_sidecar import only_volume_in
from carina.volume.dicom_signature import looks_like_dicom
from carina.volume.grid_headers import GRID_FORMATS, sniff_format
from carina.volume.message_limits import bounded_message
from carina.volume.model import Note, SeriesInfo, Volume
from carina.volume.progress import Watch

_MEDIA_DIRECTORY = b"1.2.840.10008.1.3.10"


@dataclass(frozen=True, slots=True)
class ScanPlace:
    """A path to read, with the original names of the files of an archive."""

    path: Path
    archive: UnpackedArchive | None = None

    def text(self, words: str) -> str:
        """Return a message with the original names of files."""
        return words if self.archive is None else self.archive.with_original_names(words)

    def note(self, note: Note) -> Note:
        """Return a note with the original names of files."""
        return note if self.archive is None else replace(note, words=self.text(note.words))

    def series(self, info: SeriesInfo) -> SeriesInfo:
        """Return a series whose refusal has the original names of files."""
        if self.archive is None or info.refused is None:
            return info
        return replace(info, refused=self.text(info.refused))

    def volume(self, volume: Volume) -> Volume:
        """Return a volume in whose notes and title the original file names replace the neutral ones."""
        if self.archive is None:
            return volume
        source = volume.source
        named = replace(
            source,
            title=self.text(source.title),
            series=None if source.series is None else self.series(source.series),
            other_series=tuple(map(self.series, source.other_series)),
            notes=tuple(map(self.note, source.notes)),
        )
        reason = None if volume.not_hu_reason is None else self.text(volume.not_hu_reason)
        return Volume(volume.hu_zyx, volume.lps_from_ijk, is_hu=volume.is_hu, not_hu_reason=reason, source=named)


@contextlib.contextmanager
def scan_place(path: Path, watch: Watch) -> Iterator[ScanPlace]:
    """Provide the files of a scan; an archive is unpacked, and its copy is removed at the end of the block.

    Parameters
    ----------
    path
        File or folder that the user chose.
    watch
        Progress and cancellation.

    Yields
    ------
    ScanPlace
        The path to read. Of an archive or a folder with one volume that is not DICOM, the path is the file of this
        volume.

    Raises
    ------
    VolumeImportError
        If an archive cannot be unpacked; see :func:`unpacked_archive`.
    """
    kind = archive_kind(path) if path.is_file() else None
    if kind is None:
        if path.is_dir():
            yield ScanPlace(only_volume_in(path) or path)
        else:
            yield ScanPlace(path.absolute().parent if is_media_directory(path) else path)
        return
    with unpacked_archive(path, kind, watch) as content:
        place = ScanPlace(_scan_in(content.folder, watch), content)
        try:
            yield place
        except CarinaError as error:
            error.args = (bounded_message(place.text(str(error))),)
            raise


def is_media_directory(path: Path) -> bool:
    """Return whether a file is a DICOMDIR, which lists the files beside and below it."""
    if not path.is_file() or not looks_like_dicom(path):
        return False
    with contextlib.suppress(OSError), path.open("rb") as file:
        # The class of the file is among the first elements, before every element of the data set.
        return _MEDIA_DIRECTORY in file.read(512)
    return False


def _scan_in(folder: Path, watch: Watch) -> Path:
    """Return an unpacked folder, or its only volume if that is not DICOM."""
    volumes = []
    for place in sorted(folder.rglob("*")):
        watch.step("Looking for images")
        if place.is_file():
            if looks_like_dicom(place):
                return folder
            if sniff_format(place) in GRID_FORMATS:
                volumes.append(place)
    return volumes[0] if len(volumes) == 1 else folder
