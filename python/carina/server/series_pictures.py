"""Thumbnails of the series in the open CT's folder or archive, rendered for the window that lists the series."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

from carina.commands import SeriesFiles
from carina.server.wire import messages as wire
from carina.session import Session
from carina.session.jobs.background_jobs import Job
from carina.volume.progress import Watch


def _kind(window: int) -> str:
    return f"series-pictures-{window}"


def start_series_pictures(session: Session, window: int, send: Callable[[Any], None]) -> None:
    """Start the job that sends a picture of each series to a window; without the files of the series do nothing.

    Parameters
    ----------
    session
        Session with the open CT.
    window
        Number of the window; a job of another window continues.
    send
        Sends a message to the window; callable from any thread.
    """
    path: Path | None = session.ask(SeriesFiles())
    if path is None:
        return

    def work(job: Job) -> None:
        from carina.volume.opening import find_in  # pydicom is slow to import
        from carina.volume.scan_place import scan_place
        from carina.volume.series_pictures import series_pictures

        watch = Watch(job.progress, job.cancel)
        with scan_place(path, watch) as place:
            found = find_in(place.path, watch)
            if isinstance(found, str):
                return
            for key, picture in series_pictures(found, watch):
                job.check()
                send(wire.SeriesPictureMessage(key, base64.b64encode(picture).decode()))

    session.jobs.start(_kind(window), "making the thumbnails", work)


def stop_series_pictures(session: Session, window: int) -> None:
    """Stop the job of a window, because the window has closed the list of series or has left."""
    session.jobs.cancel_kinds(_kind(window))
