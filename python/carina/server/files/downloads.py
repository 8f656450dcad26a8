"""Downloads of the open case as files made on request: airways, key frames, flights, logs of scored flights."""

from __future__ import annotations

import asyncio
import io
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path
from shutil import rmtree
from typing import Any

from starlette.responses import JSONResponse, Response

from carina.commands import AirwaysQuery, FlightFileQuery, KeyFrameFileQuery, LearnerFiles, ScoreOf
from carina.errors import CarinaError
from carina.export import EXPORT_SUFFIXES, export_airways
from carina.server.files.one_shot_file import OneShotFileResponse, new_folder
from carina.session import Session
from carina.training import Score, flight_log

FILE_STEM = "airways"
"""Stem of every file name, which contains neither the patient nor the case."""
KEYS_NAME = "key-frames.json"
FLIGHT_STEM = "flight"
"""Beginning of the file name of a flight, before its number; the recording's own name could identify the patient."""


class Downloads:
    """Creator of download files, one at a time, because a surface takes seconds and all cores.

    Parameters
    ----------
    session
        Session with the open case.
    export
        Function that writes the airways to a file; tests replace this function.
    """

    def __init__(self, session: Session, export: Callable[..., Path] = export_airways) -> None:
        self._session = session
        self._export = export
        self._one_at_a_time = asyncio.Lock()

    async def answer(self, suffix: str) -> Response:
        """Return a response with the airways as a file of this suffix (``.json``, ``.stl``, ...).

        The temporary file is deleted after the response.

        Raises
        ------
        CarinaError
            If Carina does not write files of this suffix, the case has no airways, or the disk refuses writes.
        """
        if suffix not in EXPORT_SUFFIXES:
            msg = f"Carina can write {', '.join(EXPORT_SUFFIXES)}; found {suffix!r}"
            raise CarinaError(msg, code="export.suffix")
        volume, airways = self._session.ask(AirwaysQuery())
        async with self._one_at_a_time:
            folder = new_folder()
            is_cancelled = threading.Event()
            try:
                path = await asyncio.to_thread(
                    self._make, folder / f"{FILE_STEM}{suffix}", volume, airways, is_cancelled
                )
            except BaseException:
                # The request may also be cancelled by a shutdown; the export thread checks is_cancelled and stops.
                is_cancelled.set()
                rmtree(folder, ignore_errors=True)
                raise
        return OneShotFileResponse(path, filename=path.name, headers={"cache-control": "no-store"})

    async def key_frames(self) -> Response:
        """Return a response with the key frames of the open case, in the format that ``carina fly`` reads.

        Raises
        ------
        CarinaError
            If the case has no key frames.
        """
        document = await asyncio.to_thread(lambda: self._session.ask(KeyFrameFileQuery()).to_json())
        disposition = f'attachment; filename="{KEYS_NAME}"'
        return JSONResponse(document, headers={"cache-control": "no-store", "content-disposition": disposition})

    async def flight(self, number: int) -> Response:
        """Return a response with a recorded flight of the open case, in the format that ``carina fly`` reads.

        Raises
        ------
        CarinaError
            If the case has no flight of this number, or the flight is not on the disk yet.
        """
        text = await asyncio.to_thread(self._session.ask, FlightFileQuery(number))
        disposition = f'attachment; filename="{FLIGHT_STEM}-{number}.jsonl"'
        headers = {"cache-control": "no-store", "content-disposition": disposition}
        return Response(text, media_type="application/x-ndjson", headers=headers)

    async def flight_log(self, number: int) -> Response:
        """Return a response with the log of a scored flight as a zip file: CSV files and xAPI statements.

        Raises
        ------
        CarinaError
            If the flight has no score.
        """
        score = self._session.ask(ScoreOf(number))
        content = await asyncio.to_thread(_zipped_log, score)
        disposition = f'attachment; filename="{FLIGHT_STEM}-{number}-log.zip"'
        headers = {"cache-control": "no-store", "content-disposition": disposition}
        return Response(content, media_type="application/zip", headers=headers)

    async def learner(self, name: str) -> Response:
        """Return a response with the attempts of a learner as a zip file: CSV and xAPI statements.

        Raises
        ------
        CarinaError
            If there is no such learner.
        """
        texts = await asyncio.to_thread(self._session.ask, LearnerFiles(name))
        headers = {"cache-control": "no-store", "content-disposition": 'attachment; filename="learner.zip"'}
        return Response(_zipped(texts), media_type="application/zip", headers=headers)

    def _make(self, path: Path, volume: Any, airways: Any, is_cancelled: threading.Event) -> Path:
        try:
            return self._export(path, volume, airways)
        finally:
            if is_cancelled.is_set():
                rmtree(path.parent, ignore_errors=True)


def _zipped_log(score: Score) -> bytes:
    return _zipped(flight_log(score))


def _zipped(texts: dict[str, str]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in texts.items():
            archive.writestr(name, text)
    return content.getvalue()
