"""Flights for videos: the frames of a route, of key frames or of a recording, and the captions of the frames.

``carina fly`` and the window's videos read their flights from this module.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carina import commands as c
from carina import plan, track
from carina.case.route_distances import scale_of_route
from carina.case.routes import ChosenRoute
from carina.display import one_line
from carina.errors import NoResultError, TrackingError, UsageError, VolumeImportError
from carina.export.film_captions import FilmCaptions
from carina.export.flight_film import check_num_frames
from carina.navigate import AutoFlight, KeyFrameFlight, Recording
from carina.navigate.auto_flight import frame_times_s, num_frames
from carina.navigate.recording import ReplayedPose, read_recording, sampled
from carina.plan.routes.main_carina import ROOT
from carina.plan.turns.from_route import branch_turns
from carina.render import Renderer, transfer_preset
from carina.scopes import WallField
from carina.session.command_registry import CommandHandlers, answers
from carina.session.flights.key_frames import key_file
from carina.session.flights.recorded_flights import needed_flight
from carina.session.flights.tip_commands import view_words
from carina.track import Airways, edits_from_json
from carina.version import VERSION
from carina.volume import Volume

if TYPE_CHECKING:
    from carina.session.core import SessionCore

Progress = Callable[[str, float | None], None]
Note = Callable[[str], None]
POSES_PER_REPORT = 100
"""Number of computed poses between two reports of progress, at which a job can be stopped."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class CaptionRoute:
    """Route of a flight, whose captions state distances along it, and its turns if it was searched in the airways."""

    route: ChosenRoute
    cost: c.PathCost = "lumen"
    """Cost by which the path of the route was searched; only routes of the cost ``lumen`` have turns."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class FilmFlight:
    """A flight of a case for a video, independent of later changes of the case."""

    volume: Volume
    airways: Airways | None
    caption_route: CaptionRoute | None
    """Route of the flight for the captions; None for key frames and recordings."""
    make_renderer: Callable[[], Any]
    """Function that creates a renderer of the volume on this machine, independent of those of the windows."""
    frames: Callable[[Progress, Note], list[ReplayedPose]]
    """Function that returns the frames; the replay of a recording can take minutes.

    It raises UsageError (``export.video-length``) before the computation of poses if there are too many frames.
    """


class FilmHandlers(CommandHandlers):
    """Questions about the flights of a case for videos.

    Parameters
    ----------
    core
        Core of the session.
    text
        Returns the lines of a flight by its number; the call may wait for the disk.
    """

    def __init__(self, core: SessionCore, text: Callable[[int], str]) -> None:
        super().__init__(core)
        self._text = text

    @answers(c.FlightToFilm)
    def flight_to_film(self, question: c.FlightToFilm) -> FilmFlight:
        """Return a flight for a video: along the chosen route, through the key frames, or of a recording."""
        case = self.core.needed_case()
        with self.core.lock:
            document, volume, sight = case.document, case.info.volume, case.sights.of(question.window)
            if question.flight == "recording":
                if question.number is None:
                    raise UsageError("choose a recorded flight for the video", code="session.flights")
                needed_flight(case, question.number)
        airways = document.airways

        def make_renderer() -> Any:
            return self.core.job_renderer_factory(volume, transfer_preset("endoscopic"))

        if question.flight == "recording":
            return FilmFlight(volume, airways, None, make_renderer, self._recorded(question, volume, airways))
        view = view_words(document, sight)
        flight: AutoFlight | KeyFrameFlight
        if question.flight == "key_frames":
            flight = key_file(volume, document, sight).flight()
        elif document.route is None:
            raise NoResultError("there is no route yet: choose a branch or mark a target", code="session.route")
        else:
            flight = AutoFlight(document.route.path, speed_mm_s=question.speed_mm_s, pause_s=question.pause_s)
        own = None
        if question.flight == "route" and document.route is not None:
            own = CaptionRoute(document.route, document.cost_of(document.route))
        return FilmFlight(
            volume,
            airways,
            own,
            make_renderer,
            lambda progress, _note: frames_of_flight(flight, view, question.rate_hz, progress=progress),
        )

    def _recorded(
        self, question: c.FlightToFilm, volume: Volume, airways: Airways | None
    ) -> Callable[[Progress, Note], list[ReplayedPose]]:
        number, rate_hz = question.number, question.rate_hz
        assert number is not None

        def frames(progress: Progress, note: Note) -> list[ReplayedPose]:
            recorded = read_recording(io.StringIO(self._text(number)), Path(f"flight {number}"))
            recorded.check(volume, carina=VERSION)
            times = checked_times_s(recorded.length_s, rate_hz)
            walls = wall_builder(volume, progress, known=airways)
            moments, _ = replay_recording(recorded, walls, volume, note, progress=progress)
            return sampled(moments, times)

        return frames


def checked_times_s(duration_s: float, rate_hz: float) -> NDArray[np.float64]:
    """Return the times of the frames of a flight, s.

    Raises
    ------
    UsageError
        ``export.video-length``: if there are too many frames, before memory for the frames is used.
    """
    check_num_frames(num_frames(duration_s, rate_hz))
    return frame_times_s(duration_s, rate_hz)


def frames_of_flight(
    flight: AutoFlight | KeyFrameFlight, view: dict[str, Any], rate_hz: float, *, progress: Progress
) -> list[ReplayedPose]:
    """Return the frames of a flight along a route or through key frames, all with the same view settings.

    Parameters
    ----------
    flight
        The flight.
    view
        View settings of all frames.
    rate_hz
        Frames per second.
    progress
        ``f(what, fraction)``; an exception that it raises stops the computation.

    Raises
    ------
    UsageError
        ``export.video-length``: if there are too many frames.
    """
    turned = view.get("operator") == "facing"
    times = checked_times_s(flight.duration_s, rate_hz)
    frames: list[ReplayedPose] = []
    for n, time_s in enumerate(times.tolist()):
        if n % POSES_PER_REPORT == 0:
            progress("computing the poses", n / len(times))
        frames.append(ReplayedPose(time_s, flight.pose_at(time_s), view, turned))
    return frames


def flight_captions(
    volume: Volume, airways: Airways | None, own: CaptionRoute | None, renderer: Renderer | None
) -> FilmCaptions:
    """Return the captions of a flight.

    Parameters
    ----------
    volume, airways
        The CT and its airways; None without airways.
    own
        Route of the flight; None for key frames and recordings.
    renderer
        Renderer of the volume with the lumen of its airways, in whose pictures the clock hours are measured; its
        transfer function is changed. None measures them on the tubes of the tree.
    """
    origin = None if airways is None else plan.distance_origin(volume, airways)
    tree = None if airways is None else airways.tree
    if own is None or not own.route.spans:
        return FilmCaptions(tree, origin)
    route = own.route
    scale = scale_of_route(airways, route, cost=own.cost, origin=origin or ROOT)

    def place(path_mm: float) -> str:
        past_mm = scale.origin.past_mm(float(np.interp(path_mm, route.cumulative_mm, scale.along_mm)))
        return scale.origin.words(past_mm)

    # The turns come from the airway tree, so they do not describe a path that was searched with another cost.
    if airways is None or origin is None or own.cost != "lumen":
        return FilmCaptions(tree, origin, path=route.path, place=place)
    if renderer is not None:
        renderer.set_transfer(transfer_preset("endoscopic"))
    turns = branch_turns(airways.tree, route.spans[-1].branch_id, origin, renderer=renderer)
    return FilmCaptions(tree, origin, path=route.path, place=place, turns=turns.turns)


def replay_recording(
    recorded: Recording,
    build_wall: Callable[[dict[str, Any]], WallField],
    volume: Volume,
    note: Callable[[str], None],
    *,
    progress: Progress,
) -> tuple[list[ReplayedPose], dict[str, Any]]:
    """Return the poses of a recording, and facts on the replay.

    Parameters
    ----------
    recorded
        The recording, which belongs to the volume.
    build_wall
        Builds the wall of a scope in the lumen (`wall_builder`).
    volume
        The CT.
    note
        Called with each note for the user.
    progress
        ``f(what, fraction)``; an exception that it raises stops the replay.

    Raises
    ------
    NoResultError
        If the recording contains no poses.
    """
    moments: list[ReplayedPose] = []
    different = 0
    length_s = recorded.length_s
    for moment, same in recorded.replay(volume, wall=build_wall if recorded.needs_wall else None):
        if len(moments) % POSES_PER_REPORT == 0:
            progress("replaying the recording", moment.time_s / length_s if length_s > 0.0 else None)
        moments.append(moment)
        different += not same
    if not moments:
        raise NoResultError("the recording contains no poses")
    if different:
        note(
            f"note: {different} of {len(moments)} poses differ from the recorded ones; the recording was probably "
            "made with another build of Carina"
        )
    if not recorded.complete:
        note("note: the recording is incomplete; the replay stops where it ends")
    return moments, {"num_moments": len(moments), "num_different": different, "complete": recorded.complete}


def wall_builder(
    volume: Volume, progress: Progress, *, known: Airways | None = None
) -> Callable[[dict[str, Any]], WallField]:
    """Return a function that rebuilds the airway wall of a recording by repeating its airway search and its edits.

    Parameters
    ----------
    volume
        The CT of the recording.
    progress
        ``f(what, fraction)``.
    known
        Airways whose wall is tried before the search is repeated.
    """
    walls: dict[str, WallField] = {}

    def build_wall(stored: dict[str, Any]) -> WallField:
        digest = str(stored.get("digest", ""))
        if digest in walls:
            return walls[digest]
        if known is not None and digest:
            wall = track.wall_field(volume, known, progress=progress)
            walls[wall.digest()] = wall
            if digest in walls:
                return wall
        searches: list[dict[str, Any]] = [{}]
        if stored.get("root_lps") is not None:
            # The recording does not state which of these the user gave: search with neither, threshold, both.
            searches += [
                {"lumen_threshold": stored.get("lumen_threshold")},
                {"root_lps": stored["root_lps"], "lumen_threshold": stored.get("lumen_threshold")},
            ]
        edits = () if stored.get("edits") is None else edits_from_json(stored["edits"])
        for search in searches:
            try:
                airways = track.find_airways(volume, **search, progress=progress)
                for edit in edits:
                    airways = track.edit_airways(volume, airways, edit, progress=progress)
                made = track.wall_field(volume, airways, progress=progress)
            except (TrackingError, UsageError):
                # This search can fail (no root) or give airways without the edited branches; try the next one.
                if search is searches[-1] and not digest:
                    raise
                continue
            if digest in {"", made.digest()}:
                walls[digest] = made
                return made
        raise VolumeImportError(
            "the airways that guided the scope in this recording differ from those found here, probably because they "
            "came from an imported segmentation or from another build of Carina; replay the recording with the "
            "segmentation and the build that it was made with",
            code="navigate.recording",
        )

    return build_wall
