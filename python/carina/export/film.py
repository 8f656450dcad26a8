"""Video of a flight through the airways, written in one call."""

from __future__ import annotations

import base64
import dataclasses
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, file_path, function, instance, mask_array, number_from
from carina.breathing import MOVED_TEXT
from carina.display import one_line
from carina.display.dot_letters import with_text_lines
from carina.display.html import caption, escaped, figure
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, check_type
from carina.export.video import VideoWriter, even_size, size_notes
from carina.navigate import AutoFlight, FlightPath, KeyFrameFlight
from carina.navigate.auto_flight import frame_times_s
from carina.render import AirwayView, Renderer
from carina.render.saved_picture import with_decoration_word
from carina.track import AirwayTree
from carina.volume import Volume
from carina.volume.inserted_structures import picture_mark

MAX_EMBEDDED_BYTES = 20_000_000
"""Maximum size in bytes of a video that is embedded in a notebook; for a larger video only the file name is shown."""


@one_line
@dataclass(frozen=True, slots=True)
class Film:
    """Video file that `write_film` has written."""

    name: str
    """Name of the video file, without its folder."""
    num_frames: int
    rate_hz: float
    size_px: tuple[int, int]
    """Width and height of the video, in pixels."""
    path: Path = dataclasses.field(repr=False)
    notes: tuple[str, ...] = dataclasses.field(default=(), repr=False)
    """Notes for the user on changes that players need, such as an even size."""

    @property
    def duration_s(self) -> float:
        """Duration of the video, in seconds."""
        return self.num_frames / self.rate_hz

    def _repr_html_(self) -> str:
        """Return a player for the film in a notebook."""
        width, height = self.size_px
        words = [
            f"{self.num_frames} frames of {width} × {height}, {self.duration_s:.1f} s at {self.rate_hz:g} frames/s",
            *self.notes,
        ]
        if not self.path.is_file() or self.path.stat().st_size > MAX_EMBEDDED_BYTES:
            return figure(f"<div>{escaped(self.name)}</div>", caption(words))
        kind = "webm" if self.path.suffix.lower() == ".webm" else "mp4"
        data = base64.b64encode(self.path.read_bytes()).decode("ascii")
        video = (
            f'<video controls="controls" loop="loop" muted="muted" width="{width}" height="{height}" '
            f'src="data:video/{kind};base64,{data}"></video>'
        )
        return figure(video, caption(words))


@shows_progress
@check_arguments(
    path=file_path(),
    volume=instance(Volume, "open a volume with carina.open_volume"),
    view=instance(AirwayView, "a video can only show the airway view", optional=True),
    lumen_zyx=mask_array(optional=True),
    tree=instance(AirwayTree, "get one from carina.find_airways", optional=True),
    rate_hz=number_from(1.0, 240.0),
    speed_mm_s=number_from(0.1, 500.0),
    cancel=function,
)
def write_film(
    path: str | os.PathLike[str],
    volume: Volume,
    flight: FlightPath | AutoFlight | KeyFrameFlight,
    *,
    view: AirwayView | None = None,
    lumen_zyx: NDArray[np.uint8] | None = None,
    tree: AirwayTree | None = None,
    rate_hz: float = 25.0,
    speed_mm_s: float = 20.0,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Film:
    """Render a flight through the airways and write the frames as a video.

    Parameters
    ----------
    path
        The video file, ``.mp4`` or ``.webm``. An existing file is replaced when the video is complete, or not at all.
    volume
        The CT. The frames of a CT with inserted nodules state that they are not the patient's.
    flight
        A path, which is flown at ``speed_mm_s``, or a flight that contains its times.
    view
        Settings of the frames, except the pose; 640 x 480, 100 degrees by default. An odd width or height becomes the
        next even number, because players need even sizes (`Film.notes`). A deformation of the chest carries the tip
        along, and the frames contain the text *simulated breathing*.
    lumen_zyx
        The airway lumen, for the closed wall.
    tree
        The airway tree, with which the *endoscopic* preset shows rings, the membranous wall and ridges of forks.
    rate_hz
        Frames per second, 1 to 240.
    speed_mm_s
        Speed along a path, 0.1 to 500.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Film
        The path and the length of the video; a notebook plays the film.

    Raises
    ------
    UsageError
        If the name, the rate or the speed is out of range.
    CancelledError
        If ``cancel()`` returned true; no file is written.
    CarinaError
        ``export.video`` without PyAV (extra ``video``).

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> path = carina.FlightPath(airways.tree.route_to(airways.tree.root.id))
    >>> view = carina.render.AirwayView(path.pose_at(0.0), width=64, height=48)
    >>> carina.write_film("trachea.mp4", phantom.volume, path, view=view, rate_hz=2.0, speed_mm_s=50.0, progress=False)
    Film(name='trachea.mp4', num_frames=5, rate_hz=2, size_px=(64, 48))
    """
    check_type("write_film", "volume", volume, Volume, "open a volume with carina.open_volume")
    report = progress_function(progress)
    kinds = (FlightPath, AutoFlight, KeyFrameFlight)
    check_type("write_film", "flight", flight, kinds, "create a carina.FlightPath from a route")
    flown = AutoFlight(flight, speed_mm_s=speed_mm_s, pause_s=0.0) if isinstance(flight, FlightPath) else flight
    template = AirwayView(flown.pose_at(0.0), fov_deg=100.0, width=640, height=480) if view is None else view
    check_type("write_film", "view", template, AirwayView, "a video can only show the airway view")
    notes = size_notes(path, template.width, template.height, rate_hz=rate_hz)
    width, height = even_size(template.width, template.height)
    template = dataclasses.replace(template, width=width, height=height)
    times = frame_times_s(flown.duration_s, rate_hz)
    moved = None if template.lps_from_rest is None else MOVED_TEXT
    lines = [line for line in (moved, picture_mark(volume.source)) if line is not None]
    with VideoWriter(path, template.width, template.height, rate_hz=rate_hz) as video:
        renderer = Renderer(volume)
        renderer.set_lumen(lumen_zyx, tree)
        renderer.prepare(report, cancel)
        for number, time_s in enumerate(times):
            if cancel is not None and cancel():
                raise CancelledError("stopped while rendering the video")
            pose = flown.pose_at(float(time_s))
            if template.deformation is not None:
                pose = pose.carried_by(template.deformation)
            rgb = with_decoration_word(renderer.render(dataclasses.replace(template, pose=pose))).rgb
            video.add(with_text_lines(rgb, lines) if lines else rgb)
            if report is not None:
                report("rendering frames", (number + 1) / len(times))
    return Film(Path(path).name, len(times), rate_hz, (width, height), Path(path).resolve(), notes)
