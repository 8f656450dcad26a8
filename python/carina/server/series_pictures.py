"""Thumbnails of the series of a folder or archive, open or being opened, for the window that lists the series."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from carina.commands import OpeningPreviewOf, SeriesFiles
from carina.server.wire import messages as wire
from carina.session import Session
from carina.session.jobs.background_jobs import Job
from carina.volume.progress import Watch

if TYPE_CHECKING:
    from carina.volume.dicom import FoundSeries


def _kind(window: int) -> str:
    return f"series-pictures-{window}"


def start_series_pictures(
    session: Session, window: int, send: Callable[[Any], None], list_id: str | None = None
) -> None:
    """Start the job that sends a picture of each series to a window; without the files of the series do nothing.

    Parameters
    ----------
    session
        Session with the open CT.
    window
        Number of the window; a job of another window continues.
    send
        Sends a message to the window; callable from any thread.
    list_id
        List of a CT that is being opened, whose headers are read; None for the open CT.
    """
    path: Path | None = None
    found: Sequence[FoundSeries] = ()
    if list_id is None:
        path = session.ask(SeriesFiles())
    else:
        opening = session.ask(OpeningPreviewOf())
        if opening is not None and opening.list_id == list_id:
            found = opening.preview.found
    if path is None and not found:
        return

    def work(job: Job) -> None:
        from carina.volume.opening import find_in  # pydicom is slow to import
        from carina.volume.scan_place import scan_place
        from carina.volume.series_pictures import series_pictures

        def send_pictures(series: Sequence[FoundSeries]) -> None:
            for key, picture in series_pictures(series, watch):
                job.check()
                send(wire.SeriesPictureMessage(key, base64.b64encode(picture).decode(), list_id))

        watch = Watch(job.progress, job.cancel)
        if path is None:
            send_pictures(found)
            return
        with scan_place(path, watch) as place:
            series = find_in(place.path, watch)
            if not isinstance(series, str):
                send_pictures(series)

    session.jobs.start(_kind(window), "making the thumbnails", work)


def stop_series_pictures(session: Session, window: int) -> None:
    """Stop the job of a window, because the window has closed the list of series or has left."""
    session.jobs.cancel_kinds(_kind(window))
