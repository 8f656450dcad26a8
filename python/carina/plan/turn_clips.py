"""The stretch to each turn as a short clip, which ends in the picture of the turn.

A clip is a strip of frames for a page without software: few, small, and drawn like the still pictures, without the
mottling and micro relief that are not the patient's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, NoResultError, UsageError, check_type
from carina.plan.fork_view import Operator
from carina.plan.routes import PlannedRoute
from carina.plan.turn_flight import turn_flight
from carina.plan.turn_pictures import turn_view
from carina.plan.turns import Turn, TurnList
from carina.render import Renderer, letter_edges
from carina.scopes import Pose
from carina.track import Airways
from carina.volume import Volume

__all__ = ["MOST_FRAMES", "TurnClip", "turn_clips"]

MOST_FRAMES = 24
"""A strip of 24 pictures of 256 pixels is 0.08 MB: ten forks leave a report that can be sent by mail."""
SIZES_PX = (64, 512)
LONGEST_S = 4.0
"""A longer flight is shown faster: with so few frames it would stutter."""
QUALITY = 70
"""Of the JPEG. The still beside the clip, which proves the opening, is a PNG."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TurnClip:
    """How one stretch looks on the way."""

    turn: Turn
    operator: Operator
    frames: tuple[NDArray[np.uint8], ...] = field(repr=False)
    """(size, size, 3) each; the last is the turn's own picture, unmarked."""
    cameras: tuple[Pose, ...] = field(repr=False)
    """As many."""
    duration_s: float
    """From the first frame to the last."""

    @property
    def size_px(self) -> int:
        """Width and height of a frame."""
        return int(self.frames[0].shape[0])

    def strip(self) -> bytes:
        """All frames below one another, as one JPEG."""
        return bytes(
            simplejpeg.encode_jpeg(
                np.concatenate(self.frames), quality=QUALITY, colorspace="RGB", colorsubsampling="420"
            )
        )


@shows_progress
def turn_clips(
    volume: Volume,
    airways: Airways,
    planned: PlannedRoute,
    turns: TurnList,
    *,
    operator: Operator = "head",
    size_px: int = 256,
    num_frames: int = MOST_FRAMES,
    renderer: Renderer | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> tuple[TurnClip | None, ...]:
    """A clip of each stretch of a route.

    Parameters
    ----------
    volume, airways, planned
        The CT, its airways, and the route that was planned in them.
    turns
        Its list of turns, of `carina.plan.turn_list`.
    operator
        Which way up.
    size_px
        Width and height of a frame, 64 to 512.
    num_frames
        Of each clip, 2 to 24.
    renderer
        One that shows this volume with these airways, where it is at hand; else it is made.
    progress
        False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction is
        None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    tuple
        In the order of the turns; None for a stretch without length, as between two forks that are one.

    Raises
    ------
    UsageError
        If a size or number is out of range.
    NoResultError
        If a turn does not say where it is seen from.
    CancelledError
        If ``cancel()`` said so.
    """
    check_type("turn_clips", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("turn_clips", "airways", airways, Airways, "get airways from carina.find_airways")
    check_type("turn_clips", "planned", planned, PlannedRoute, "it is one of the routes of carina.plan_route")
    check_type("turn_clips", "turns", turns, TurnList, "make it with carina.plan.turn_list")
    for name, value, (least, most) in (("size_px", size_px, SIZES_PX), ("num_frames", num_frames, (2, MOST_FRAMES))):
        if not least <= value <= most:
            raise UsageError(f"{name}: expected {least} to {most}; found {value}", code="plan.range")
    if renderer is None and turns.turns:
        renderer = Renderer(volume)
        renderer.set_lumen(airways.lumen_zyx)
        renderer.prepare()
    report = progress_function(progress)
    made: list[TurnClip | None] = []
    for index, turn in enumerate(turns.turns):
        turn.camera(operator)  # refuses a turn that is seen from nowhere, which is no stretch without length
        try:
            times, poses = turn_flight(airways.tree, planned, turns, index, operator=operator)
        except NoResultError:
            made.append(None)
            continue
        chosen = np.rint(np.linspace(0, len(poses) - 1, min(num_frames, len(poses)))).astype(int)
        cameras = tuple(poses[n] for n in chosen)
        frames: list[NDArray[np.uint8]] = []
        for camera in cameras:
            if cancel is not None and cancel():
                raise CancelledError("the clips of the turns were cancelled")
            assert renderer is not None
            picture = letter_edges(renderer.render(turn_view(renderer, camera, size_px)))
            frames.append(picture.rgb)
            if report is not None:
                report("rendering the clips of the turns", (index + len(frames) / len(cameras)) / len(turns.turns))
        made.append(TurnClip(turn, operator, tuple(frames), cameras, min(float(times[-1]), LONGEST_S)))
    return tuple(made)
