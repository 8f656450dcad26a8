"""Facts and picture of a series in a PACS, from its middle image, and the choice of the likeliest chest CT."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from carina.disk import scratch_folder
from carina.display import one_line
from carina.errors import PacsError
from carina.pacs.answer_values import text_value, whole_value
from carina.pacs.client import client_of
from carina.pacs.connections import PacsConnection
from carina.pacs.limits import MAX_PREVIEW_BYTES, MAX_SERIES_IMAGES
from carina.pacs.results import PacsSeries
from carina.pacs.retrieval_folder import RetrievalFolder
from carina.volume.dicom import find_series as series_in
from carina.volume.dicom_files import read_folder
from carina.volume.model import SeriesInfo
from carina.volume.progress import Watch
from carina.volume.series_pictures import slice_picture

__all__ = ["SeriesPreview", "likeliest_series", "preview_series"]

_CHEST = re.compile(r"chest|thora|lung|pulmo", re.IGNORECASE)
_FEWEST_IMAGES = 20
"""Minimum number of images of a series that is proposed; fewer are a scout or a part."""


@one_line
@dataclass(frozen=True, slots=True)
class SeriesPreview:
    """Properties of a series that only its images state, read from the middle image."""

    info: SeriesInfo | None = None
    """Thickness, kernel, phase and date, and no number of slices; None if the image cannot be read."""
    picture: bytes | None = field(default=None, repr=False)
    """PNG of the middle slice, at most 96 pixels wide and high."""


def preview_series(
    connection: PacsConnection, series: PacsSeries, *, cancel: Callable[[], bool] | None = None
) -> SeriesPreview:
    """Retrieve the middle image of a series, and return its facts and a picture; the image is deleted.

    Parameters
    ----------
    connection
        The connection.
    series
        The series, from :func:`carina.pacs.find_series`.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    SeriesPreview
        Empty facts for a series without a readable image of at most 32 MiB.

    Raises
    ------
    PacsError
        If the PACS cannot be reached or refuses the request.
    CancelledError
        If ``cancel()`` returned true.
    """
    watch = Watch(None, cancel)
    client = client_of(connection)
    keys = {
        "StudyInstanceUID": series.study_uid, "SeriesInstanceUID": series.uid, "SOPInstanceUID": "",
        "InstanceNumber": "",
    }  # fmt: skip
    found = client.find("IMAGE", keys, limit=MAX_SERIES_IMAGES, watch=watch)
    images = sorted((whole_value(one, "InstanceNumber") or 0, text_value(one, "SOPInstanceUID")) for one in found)
    images = [image for image in images if image[1]]
    if not images:
        return SeriesPreview()
    middle = images[len(images) // 2][1]
    with scratch_folder() as folder:
        place = RetrievalFolder(Path(folder) / "image", series.uid, max_image_bytes=MAX_PREVIEW_BYTES)
        with place:
            try:
                client.retrieve(series.study_uid, series.uid, [middle], place, watch, are_all=len(images) == 1)
            except PacsError as error:
                if error.code == "pacs.too-large":
                    return SeriesPreview()
                raise
            if middle not in place:
                return SeriesPreview()
            place.complete([middle])
        content = read_folder(place.target, recursive=False, watch=watch)
        if not content.headers:
            return SeriesPreview()
        one = series_in(content, watch)[0]
        return SeriesPreview(
            info=one.info,
            picture=slice_picture(one.slices[len(one.slices) // 2]),
        )


def likeliest_series(
    series: Sequence[PacsSeries], previews: Mapping[str, SeriesPreview]
) -> tuple[PacsSeries | None, str]:
    """Return the series that is most likely the chest CT, and the reason as text; None without a candidate.

    The score is that of a folder: number of slices times covered height, four times as much for a series whose
    description names the chest.

    Parameters
    ----------
    series
        The series of a study.
    previews
        Previews by UID of the series, as far as they are known.

    Examples
    --------
    >>> thin = PacsSeries("1.2", "1", "CT", "Lung 1.0", 2, 300)
    >>> scout = PacsSeries("1.3", "1", "CT", "Scout", 1, 1)
    >>> chosen, reason = likeliest_series([scout, thin], {})
    >>> chosen is thin, reason
    (True, 'the likeliest chest CT: 300 images, named as a chest')
    """

    def thickness_mm(one: PacsSeries) -> float | None:
        preview = previews.get(one.uid)
        return None if preview is None or preview.info is None else preview.info.thickness_mm

    def score(one: PacsSeries) -> float:
        images = one.num_images or 0
        step_mm = thickness_mm(one) or 1.0
        return images * images * step_mm * (4.0 if _CHEST.search(one.description) else 1.0)

    candidates = [one for one in series if one.modality == "CT" and (one.num_images or 0) >= _FEWEST_IMAGES]
    if not candidates:
        return None, ""
    best = max(candidates, key=score)
    slice_mm = thickness_mm(best)
    thickness = "" if slice_mm is None else f" of {slice_mm:.3g} mm"
    named = ", named as a chest" if _CHEST.search(best.description) else ""
    return best, f"the likeliest chest CT: {best.num_images} images{thickness}{named}"
