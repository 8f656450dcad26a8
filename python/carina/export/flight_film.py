"""Frames of a flight as a video: the views of a flight's poses, and the writing of their images.

``carina fly`` and the window write their videos with this module, so that equal settings give equal frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from carina.breathing import MOVED_TEXT, ChestMotion
from carina.display.dot_letters import with_text_lines
from carina.errors import CancelledError, UsageError
from carina.export.video import VideoWriter
from carina.navigate.recording import ReplayedPose
from carina.render import AirwayView, Picture, TransferFunction, transfer_preset
from carina.render.saved_picture import with_decoration_word
from carina.scopes import ImageField, scope_preset

MAX_FRAMES = 100_000
"""Maximum number of frames of a video, about an hour at 30 frames per second."""

Rgb = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class FrameOptions:
    """Options for the rendering of the frames."""

    size: tuple[int, int]
    scope: str | None
    """Instrument of frames whose view has none; None for a pinhole camera of 90 degrees."""
    step_vox: float
    motion: ChestMotion | None = None
    """Breathing of the patient; None shows that of the recording, or the CT at rest if the recording has none."""

    def motion_of(self, frame: ReplayedPose) -> ChestMotion | None:
        """Return the breathing of the patient in a frame; None if the frame shows the CT as it is."""
        return frame.motion if self.motion is None else self.motion


@dataclass(frozen=True, slots=True, eq=False)
class FrameImage:
    """Description of one image to render."""

    transfer: Any
    """Transfer function as JSON; None for the default."""
    view: AirwayView


class FrameRenderer(Protocol):
    """Methods of a renderer that frames need."""

    def render(self, view: Any, /) -> Picture:
        """Render one frame of the video."""

    def set_transfer(self, transfer: TransferFunction, /) -> None:
        """Set the transfer function of the following frames."""

    def prepare(self) -> None:
        """Build the data for fast rendering."""


RenderFrames = Callable[..., Iterator[tuple[int, Picture]]]
"""Function that renders views in order: ``render_frames(renderer, views, first=)`` yields number and picture."""


class FrameStore(Protocol):
    """Store of frames from which an interrupted video continues."""

    num: int

    def store_frame(self, number: int, picture: Picture) -> None:
        """Store a frame of the video under its number."""

    def load(self, number: int, size: tuple[int, int]) -> Rgb:
        """Return the frame with a number that was stored earlier."""


def check_num_frames(num_frames: int) -> None:
    """Raise an error for a video with too many frames.

    Raises
    ------
    UsageError
        ``export.video-length``.
    """
    if num_frames > MAX_FRAMES:
        raise UsageError(
            f"this video would have {num_frames} frames; at most {MAX_FRAMES} are possible: fly faster, or use fewer "
            "frames per second",
            code="export.video-length",
        )


def distinct_images(frames: Sequence[ReplayedPose], options: FrameOptions) -> tuple[list[FrameImage], list[int]]:
    """Return the distinct images of a flight, with the number of frames for which each is shown."""
    images: list[FrameImage] = []
    times_shown: list[int] = []
    last: tuple[int, int] | None = None
    for frame in frames:
        same = (id(frame.pose), id(frame.view))
        if same == last and options.motion_of(frame) is None:
            times_shown[-1] += 1
            continue
        last = same
        images.append(FrameImage(frame.view.get("transfer"), frame_view(frame, options)))
        times_shown.append(1)
    return images, times_shown


def frame_view(frame: ReplayedPose, options: FrameOptions) -> AirwayView:
    """Return the airway view of a frame: its own view settings, else those of the options."""
    view = frame.view
    settings: dict[str, Any] = {"width": options.size[0], "height": options.size[1], "step_vox": options.step_vox}
    settings |= {name: view[name] for name in ("shading", "texture", "fov_deg") if name in view}
    motion = options.motion_of(frame)
    if motion is not None:
        deformation = motion.at(frame.time_s)
        frame = replace(frame, pose=frame.pose.carried_by(deformation))
        settings["deformation"] = deformation
    scope = view.get("scope", options.scope)
    outline = view.get("mask")
    if scope is None:
        field = ImageField() if outline is None else ImageField(outline)
        settings.setdefault("fov_deg", 90.0)
        return AirwayView(frame.pose, field=field, **settings)
    preset = scope_preset(scope)
    if outline is not None:
        settings["field"] = replace(preset.field, outline=outline)
    return AirwayView.of_scope(preset, frame.pose, picture_turned=frame.picture_turned, **settings)


def write_frames(
    video: VideoWriter,
    renderer: FrameRenderer,
    frames: Sequence[ReplayedPose],
    options: FrameOptions,
    *,
    captions: Callable[[ReplayedPose, float], Iterable[str]] | None = None,
    mark: str | None = None,
    stored: FrameStore | None = None,
    render_frames: RenderFrames | None = None,
    progress: Callable[[str, float | None], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> int:
    """Render the frames of a flight, add them to a video, and return the number of images from ``stored``.

    Parameters
    ----------
    video
        Open video of the size of the frames.
    renderer
        Renderer of the CT with the lumen of its airways.
    frames
        Poses and views of the frames, in order.
    options
        Size and optics of the frames.
    captions
        Returns the lines of text in a frame at a time, s; None writes no text. A decorated frame contains the word
        *decorated* in either case.
    mark
        Line of text in every frame (``carina.volume.inserted_structures.picture_mark``); None for none. Frames of a
        patient that breathes contain the text *simulated breathing*.
    stored
        Store of finished images, which are not rendered again; new images are added.
    render_frames
        Function that renders the images in order; None uses one renderer.
    progress
        ``f(what, fraction)``.
    cancel
        Called for each frame; the work stops when it returns True.

    Raises
    ------
    CancelledError
        If ``cancel()`` returned True.
    """
    images, times_shown = distinct_images(frames, options)
    num_stored = 0 if stored is None else min(stored.num, len(images))
    for number, rgb in _images(renderer, images, stored, options.size, render_frames or _render_in_order):
        for _ in range(times_shown[number]):
            if cancel is not None and cancel():
                raise CancelledError("stopped while rendering the video")
            frame = frames[video.num_frames]
            lines = () if captions is None else tuple(captions(frame, video.duration_s))
            lines = lines if mark is None else (mark, *lines)
            lines = lines if options.motion_of(frame) is None else (MOVED_TEXT, *lines)
            video.add(with_text_lines(rgb, lines) if lines else rgb)
        if progress is not None:
            progress("rendering frames", video.num_frames / len(frames))
    return num_stored


def _render_in_order(
    renderer: FrameRenderer, views: Iterable[AirwayView], *, first: int
) -> Iterator[tuple[int, Picture]]:
    for number, view in enumerate(views):
        if number >= first:
            yield number, renderer.render(view)


def _images(
    renderer: FrameRenderer,
    images: Sequence[FrameImage],
    stored: FrameStore | None,
    size: tuple[int, int],
    render_frames: RenderFrames,
) -> Iterator[tuple[int, Rgb]]:
    """Yield all images with their numbers, in order: first the stored images, then newly rendered images."""
    first = 0 if stored is None else min(stored.num, len(images))
    for number in range(first):
        assert stored is not None
        yield number, stored.load(number, size)
    start = 0
    for transfer, run in itertools.groupby(images, key=lambda image: image.transfer):
        views = [image.view for image in run]
        end = start + len(views)
        if end > first:
            renderer.set_transfer(
                transfer_preset("endoscopic") if transfer is None else TransferFunction.from_json(transfer)
            )
            renderer.prepare()
            for n, picture in render_frames(renderer, views, first=max(0, first - start)):
                finished = with_decoration_word(picture)
                if stored is not None:
                    stored.store_frame(start + n, finished)
                yield start + n, finished.rgb
        start = end
