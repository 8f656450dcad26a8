"""Storage of a workstation on the disk: its cases, and the cache of opened CTs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from carina.case import CaseFile, CaseFileError, SourceFacts
from carina.case.migration import migrate_live
from carina.session.store.find_scan import CaseScans
from carina.session.store.interfaces import CaseFileFunctions, StoredCaseFile, WholeCase
from carina.volume import Volume

if TYPE_CHECKING:
    from carina.case.save_mark import SaveMark
    from carina.disk import Placement
    from carina.session.engines import Cancel, Progress
    from carina.session.scene.shown_case import ShownCase
    from carina.session.store.registry import CaseRecords
    from carina.volume import VolumeCache

VIEW = "tree"
"""Name of the view in the thumbnail: the outside view, because the trees of two patients differ visibly."""
WIDTH, HEIGHT = 320, 240
STEP_VOX = 1.0
QUALITY = 82


def thumbnail(scene: ShownCase) -> bytes:
    """Return a JPEG of the airways from outside, with the current view settings.

    Raises
    ------
    CarinaError
        If the renderer fails.
    """
    import simplejpeg

    picture = scene.renderer.render(scene.spec(VIEW, WIDTH, HEIGHT, STEP_VOX))
    pixels = np.ascontiguousarray(picture.rgb)
    return cast(bytes, simplejpeg.encode_jpeg(pixels, quality=QUALITY, colorspace="RGB", colorsubsampling="420"))


def case_files(cache: VolumeCache | None = None, records: CaseRecords | None = None) -> CaseFileFunctions:
    """Return the functions that store case files on the disk; with a cache, CTs opened before come from the cache."""
    from carina.session.engines import default_parts
    from carina.volume import ct_digest

    def create(path: Path, volume: Volume, digest: str) -> StoredCaseFile:
        return CaseFile.create(path, SourceFacts.of(volume, digest))

    def reopen(path: Path) -> StoredCaseFile:
        try:
            return CaseFile.open(path)
        except CaseFileError as error:
            if error.code != "case.older":
                raise
        migrate_live(path)
        return CaseFile.open(path)

    def write(path: Path, case: WholeCase, ct_place: str | None, save_mark: SaveMark, placement: Placement) -> None:
        with CaseFile.in_memory(SourceFacts.of(case.volume, case.digest)) as file:
            file.save(case.moment)
            for flight in case.flights:
                file.keep_recording(flight.writer())
            file.set_recordings([flight.facts for flight in case.flights])
            file.write_copy(path, ct_place=ct_place, save_mark=save_mark, placement=placement)

    scans = CaseScans(
        cache, records, default_parts().open_demo, advice="put it back, or open the scan from its current location"
    )
    if cache is None:
        return CaseFileFunctions(create, reopen, write, ct_digest, picture=thumbnail, scans=scans)

    def open_ct(path: str, progress: Progress, cancel: Cancel, series: str | None = None) -> Volume:
        return cache.open_and_keep(path, series=series, progress=progress, cancel=cancel)

    return CaseFileFunctions(create, reopen, write, ct_digest, open_ct, cache.close, thumbnail, cache, scans)
