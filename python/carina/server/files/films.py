"""Videos of flights, rendered by a job that windows display and can stop, with the code of ``carina fly``."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree
from typing import Any, cast

from starlette.responses import JSONResponse, Response

from carina.commands import FlightToFilm
from carina.errors import CancelledError, CarinaError, UsageError
from carina.export import VIDEO_SUFFIXES, VideoWriter
from carina.export.flight_film import FrameOptions, write_frames
from carina.export.video import even_size, size_notes, video_problem
from carina.render import Renderer
from carina.render.saved_picture import FULL_STEP_VOX
from carina.scopes import DEFAULT_SCOPE
from carina.server.files.job_results import set_failure, set_result
from carina.server.files.one_shot_file import StoredFileResponse, new_folder
from carina.session import Session
from carina.session.flights.film_flights import FilmFlight, flight_captions
from carina.session.jobs.background_jobs import Job
from carina.volume.inserted_structures import picture_mark

WAIT_S = 15.0
"""Maximum time in s until a request for a video is answered; the answer then states that the video is not ready."""
STEMS = {"route": "flight", "key_frames": "key-frames", "recording": "recording"}
"""Beginning of the file name by kind of flight; it contains neither the patient nor the case."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmOrder:
    """A requested video: flight, format and size."""

    flight: FlightToFilm
    suffix: str
    size: tuple[int, int]
    captions: bool

    @classmethod
    def of_query(cls, query: Mapping[str, str]) -> FilmOrder:
        """Return the requested video (flight, format, size) from the parameters of a request.

        Raises
        ------
        UsageError
            If a parameter is missing or out of range.
        """
        suffix = f".{query.get('format', 'mp4')}"
        if suffix not in VIDEO_SUFFIXES:
            raise UsageError(f"a video can be {' or '.join(VIDEO_SUFFIXES)}; found {suffix!r}", code="export.suffix")
        kind = query.get("flight", "")
        if kind not in STEMS:
            raise UsageError(f"flight: expected {', '.join(STEMS)}; found {kind!r}", code="export.video")
        number = query.get("number")
        flight = FlightToFilm(
            cast(Any, kind),
            number=None if number is None else int(_number(query, "number")),
            speed_mm_s=_number(query, "speed_mm_s", 20.0),
            rate_hz=_number(query, "rate_hz", 30.0),
            window=int(_number(query, "window", 0.0)),
        )
        size = even_size(int(_number(query, "width")), int(_number(query, "height")))
        size_notes(f"video{suffix}", *size, rate_hz=flight.rate_hz)
        return cls(flight=flight, suffix=suffix, size=size, captions=query.get("captions", "on") == "on")

    @property
    def file_name(self) -> str:
        """Name of the file."""
        number = "" if self.flight.number is None else f"-{self.flight.number}"
        return f"{STEMS[self.flight.flight]}{number}{self.suffix}"


def _number(query: Mapping[str, str], name: str, usual: float | None = None) -> float:
    text = query.get(name)
    if text is None and usual is not None:
        return usual
    try:
        value = float(text or "")
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9:
        raise UsageError(f"{name}: expected a number; found {text!r}", code="export.video")
    return value


def _reported(error: BaseException, job: Job) -> CarinaError:
    """Return the error of a video's job as the answer to the request for the video."""
    if isinstance(error, CancelledError):
        if job.stop_reason is not None:
            return CarinaError(f"the video was cancelled because {job.stop_reason}", code="export.video-lost")
        return CarinaError("the video was cancelled", code="export.video-stopped")
    if isinstance(error, CarinaError):
        return error
    return CarinaError("the video could not be saved: internal error in Carina", code="carina.fault")


@dataclass(slots=True)
class _Film:
    """Video that a window has requested, with its job and its file."""

    done: Future[Path] = field(default_factory=Future)
    num_readers: int = 0
    """Number of responses that are sending the file."""


class Films:
    """Creator of videos of the open case's flights, one at a time.

    A finished video is stored until a window has the whole file, another video is requested, or the server stops.
    After a broken connection a window can therefore request the file again.

    Parameters
    ----------
    session
        Session with the open case.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._films: dict[str, _Film] = {}
        """Requested videos by the ID of their job."""

    def start(self, query: Mapping[str, str]) -> Response:
        """Start the job of a video, and return a response with the ID of the job.

        Raises
        ------
        CarinaError
            If PyAV is missing, the case has no such flight, a parameter is out of range, or another video is being
            rendered.
        """
        problem = video_problem()
        if problem is not None:
            raise CarinaError(problem, code="export.video")
        order = FilmOrder.of_query(query)
        with self._lock:
            if any(not film.done.done() for film in self._films.values()):
                raise CarinaError(
                    "another video is being rendered: wait until it is complete, or cancel it", code="export.video-busy"
                )
            self._forget()
            flight: FilmFlight = self._session.ask(order.flight)
            film = _Film()
            path = new_folder() / order.file_name
            try:
                job_id = self._session.jobs.start(
                    "film", "saving the video", lambda job: self._work(job, path, order, flight, film.done)
                )
            except BaseException:
                rmtree(path.parent, ignore_errors=True)
                raise
            self._films[job_id] = film
        return JSONResponse({"job_id": job_id}, 201)

    async def answer(self, job_id: str) -> Response:
        """Return a response with a finished video, or with status 202 if it is not finished after :data:`WAIT_S`.

        Raises
        ------
        CarinaError
            If the job has failed or was stopped, or no such video exists.
        """
        film = self._films.get(job_id)
        if film is None:
            raise CarinaError("this video is no longer stored: save it again", code="export.video-gone")
        try:
            path = await asyncio.wait_for(asyncio.shield(asyncio.wrap_future(film.done)), WAIT_S)
        except TimeoutError:
            return JSONResponse({"job_id": job_id}, 202, headers={"cache-control": "no-store"})
        except CarinaError:
            self._films.pop(job_id, None)
            raise
        film.num_readers += 1

        def ended(complete: bool) -> None:
            film.num_readers -= 1
            if complete:
                self._delete(job_id)

        return StoredFileResponse(path, ended=ended, headers={"cache-control": "no-store"})

    def close(self) -> None:
        """Delete all videos that no window has read; the session has stopped its jobs."""
        with self._lock:
            for job_id, film in list(self._films.items()):
                if film.done.done():
                    self._delete(job_id)

    def _forget(self) -> None:
        """Delete the finished videos that no response is sending."""
        for job_id, film in list(self._films.items()):
            if film.done.done() and film.num_readers == 0:
                self._delete(job_id)

    def _delete(self, job_id: str) -> None:
        """Delete a finished video; a video that is no longer stored is ignored."""
        film = self._films.pop(job_id, None)
        if film is not None and film.done.exception() is None:
            rmtree(film.done.result().parent, ignore_errors=True)

    def _work(self, job: Job, path: Path, order: FilmOrder, flight: FilmFlight, done: Future[Path]) -> None:
        try:
            self._write(job, path, order, flight)
        except BaseException as error:
            rmtree(path.parent, ignore_errors=True)
            set_failure(done, _reported(error, job))
            raise
        set_result(done, path)

    def _write(self, job: Job, path: Path, order: FilmOrder, flight: FilmFlight) -> None:
        job.check()
        with VideoWriter(path, *order.size, rate_hz=order.flight.rate_hz) as video:
            frames = flight.frames(job.progress, lambda _note: None)
            renderer = flight.make_renderer()
            if flight.volume.is_hu and flight.airways is not None:
                renderer.set_lumen(flight.airways.lumen_zyx, flight.airways.tree)
            captions = None
            if order.captions:
                job.progress("finding the turns", None)
                own = renderer if isinstance(renderer, Renderer) else None
                captions = flight_captions(flight.volume, flight.airways, flight.caption_route, own).lines
            write_frames(
                video,
                renderer,
                frames,
                FrameOptions(order.size, DEFAULT_SCOPE, FULL_STEP_VOX),
                captions=captions,
                mark=picture_mark(flight.volume.source),
                progress=job.progress,
                cancel=job.cancel,
            )
