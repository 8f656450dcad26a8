"""Short clip of the flight to each turn, which ends with the picture of the turn.

A clip is a strip of few, small frames, which an HTML page plays without other software. The frames are rendered like
the still pictures, without the artificial mottling and micro relief.
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
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.turns.flight import turn_flight
from carina.plan.turns.fork_view import Operator, turn_view
from carina.plan.turns.turn_list import Turn, TurnList
from carina.render import Renderer, letter_edges
from carina.scopes import Pose
from carina.track import Airways
from carina.volume import Volume

MAX_FRAMES = 24
"""Maximum number of frames of a clip of the flight to a turn; a request for more is refused."""
SIZES_PX = (64, 512)
LONGEST_S = 4.0
"""Maximum duration of a clip in s; a longer flight is played faster."""
QUALITY = 70
"""JPEG quality of the strip of frames, 0 to 100."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TurnClip:
    """Clip of a simulated flight along the part of a route that ends in front of one turn."""

    turn: Turn
    operator: Operator
    frames: tuple[NDArray[np.uint8], ...] = field(repr=False)
    """Frames of (size, size, 3) each; the last one is the picture of the turn without marks."""
    cameras: tuple[Pose, ...] = field(repr=False)
    """Pose of the camera for each frame."""
    duration_s: float
    """Time from the first frame of the clip to the last, s."""

    @property
    def size_px(self) -> int:
        """Width and height of a frame in pixels."""
        return int(self.frames[0].shape[0])

    def strip(self) -> bytes:
        """Return all frames of the clip below one another as one JPEG image."""
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
    num_frames: int = MAX_FRAMES,
    renderer: Renderer | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> tuple[TurnClip | None, ...]:
    """Render a clip of the flight to each turn of a route.

    Parameters
    ----------
    volume, airways, planned
        The CT, its airways, and the route that was planned in them.
    turns
        List of turns of the route (`carina.plan.turn_list`).
    operator
        Position of the operator, which determines the orientation of the picture.
    size_px
        Width and height of a frame, 64 to 512.
    num_frames
        Number of frames of each clip, 2 to 24.
    renderer
        Renderer of this volume with these airways; created if None.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    tuple
        Clips in the order of the turns; None for a turn at the place of the turn before it, to which nothing is flown.

    Raises
    ------
    UsageError
        If a size or number is out of range.
    NoResultError
        If a turn has no camera position.
    CancelledError
        If ``cancel()`` returned True.
    """
    check_type("turn_clips", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("turn_clips", "airways", airways, Airways, "get airways from carina.find_airways")
    check_type("turn_clips", "planned", planned, PlannedRoute, "it is one of the routes of carina.plan_route")
    check_type("turn_clips", "turns", turns, TurnList, "make it with carina.plan.turn_list")
    for name, value, (least, most) in (("size_px", size_px, SIZES_PX), ("num_frames", num_frames, (2, MAX_FRAMES))):
        if not least <= value <= most:
            raise UsageError(f"{name}: expected {least} to {most}; found {value}", code="plan.range")
    if renderer is None and turns.turns:
        renderer = Renderer(volume)
        renderer.set_lumen(airways.lumen_zyx)
        renderer.prepare()
    report = progress_function(progress)
    made: list[TurnClip | None] = []
    for index, turn in enumerate(turns.turns):
        # raises if the turn has no camera position; the except clause handles only flights without length
        turn.camera(operator)
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
