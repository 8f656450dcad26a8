"""Still picture of each turn: level, from before the fork, with the opening to enter outlined.

The outline is the edge of the visible wall of the branch, so it ends where another wall is in front. The artificial
mottling and micro relief are off.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from carina.display import one_line
from carina.display.png import png_bytes
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, UsageError, check_type
from carina.plan.turns.fork_view import MIN_SHARE, Operator, turn_view
from carina.plan.turns.opening_walls import ForkWalls, opening_pixels
from carina.plan.turns.picture_marks import draw_clock, draw_edge, text_size
from carina.plan.turns.turn_list import Turn, TurnList
from carina.render import Picture, Renderer
from carina.render.picture_text import letters_at_edges
from carina.render.png_text import KEYWORD
from carina.scopes import Pose
from carina.track import Airways, AirwayTree
from carina.volume import Volume

Field = NDArray[np.float64]

SIZES_PX = (128, 2048)
LINE_PX = 2.5
"""Width in pixels of the outline round an opening, in a picture of 512 pixels; it grows with the picture."""
SMOOTH_PX = 2.0
"""Sigma of the smoothing of the outline, in pixels of a picture of 512 pixels."""
ROUTE_RGB = (79, 211, 230)
DOUBTFUL_RGB = (244, 180, 76)
"""Colour of an opening into a branch that the CT does not show with certainty."""
COARSE = 2
"""Step in pixels of the coarser picture in which each pixel of wall is assigned to a branch."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TurnPicture:
    """Picture of the airway in front of one turn, with the opening to take outlined."""

    turn: Turn
    operator: Operator
    picture: Picture
    """Picture with outline, hours and letters, and the positions of its pixels."""
    in_view: bool
    """Whether the opening of the branch to enter is visible and outlined.

    If not, a fold of the wall hides the opening.
    """
    outline: NDArray[np.bool_]
    """(height, width) mask of the visible wall of the branch to enter."""

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """Pixels of the picture, (height, width, 3)."""
        return self.picture.rgb

    @property
    def camera(self) -> Pose:
        """Pose of the camera that renders the picture."""
        return self.turn.camera(self.operator)

    @property
    def words(self) -> str:
        """Caption of the picture as text."""
        seen = "" if self.in_view else "; the opening itself is not in view from here"
        return f"{self.turn.to_branch}, {self.turn.direction(self.operator)}{seen}"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``rgb`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.rgb, dtype=dtype, copy=copy)

    def png(self) -> bytes:
        """Return the picture as a PNG that contains the pose of the camera (`carina.render.read_png_pose`)."""
        place = json.dumps(self.picture.place(), allow_nan=False)
        return png_bytes(np.ascontiguousarray(self.rgb), {KEYWORD: place})

    def _repr_png_(self) -> bytes:
        """Return the picture as PNG, which a notebook displays."""
        return self.png()


@shows_progress
def turn_pictures(
    volume: Volume,
    airways: Airways,
    turns: TurnList,
    *,
    operator: Operator = "head",
    size_px: int = 512,
    marked: bool = True,
    renderer: Renderer | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> tuple[TurnPicture, ...]:
    """Render one picture of each turn of a route.

    Parameters
    ----------
    volume, airways
        The CT and the airways that the route was planned in.
    turns
        List of turns (`carina.plan.turn_list`); `examples/05_turns` shows a complete example.
    operator
        Position of the operator, which determines the orientation of the picture.
    size_px
        Width and height, 128 to 2048.
    marked
        Whether to draw outline, clock and letters.
    renderer
        Renderer of this volume with these airways; created if None.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    tuple of TurnPicture
        Pictures in the order of the turns.

    Raises
    ------
    UsageError
        If the size is out of range.
    NoResultError
        If a turn has no camera position.
    CancelledError
        If ``cancel()`` returned True.
    """
    check_type("turn_pictures", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("turn_pictures", "airways", airways, Airways, "get airways from carina.find_airways")
    check_type("turn_pictures", "turns", turns, TurnList, "make it with carina.plan.turn_list")
    if not SIZES_PX[0] <= size_px <= SIZES_PX[1]:
        raise UsageError(f"size_px: expected {SIZES_PX[0]} to {SIZES_PX[1]}; found {size_px}", code="plan.range")
    if renderer is None and turns.turns:
        renderer = Renderer(volume)
        renderer.set_lumen(airways.lumen_zyx)
    report = progress_function(progress)
    made: list[TurnPicture] = []
    for turn in turns.turns:
        if cancel is not None and cancel():
            raise CancelledError("the pictures of the turns were cancelled")
        assert renderer is not None
        made.append(_picture(renderer, airways.tree, turn, operator, size_px, marked=marked))
        if report is not None:
            report("rendering the pictures of the turns", len(made) / len(turns.turns))
    return tuple(made)


def _picture(
    renderer: Renderer, tree: AirwayTree, turn: Turn, operator: Operator, size_px: int, *, marked: bool
) -> TurnPicture:
    view = turn_view(renderer, turn.camera(operator), size_px)
    picture = renderer.render(view)
    coarse = replace(view, width=-(-size_px // COARSE), height=-(-size_px // COARSE))
    column, row = _seed(picture, turn)
    walls = ForkWalls(tree, np.array(turn.fork_lps), (turn.to_branch_id, *(one.branch_id for one in turn.others)))
    owners = walls.owners(renderer.surface(coarse).position_lps)
    ours = opening_pixels(owners, 0, (column / COARSE, row / COARSE))
    fine = np.repeat(np.repeat(ours, COARSE, axis=0), COARSE, axis=1)[:size_px, :size_px]
    seen = _smoothed(fine.astype(np.float64), max(SMOOTH_PX * size_px / 512, 0.8 * COARSE))
    inside = seen > 0.5
    in_view = float(inside.mean()) >= MIN_SHARE
    if marked:
        rgb = picture.rgb.copy()
        colour = DOUBTFUL_RGB if turn.cautions else ROUTE_RGB
        if in_view:
            draw_edge(rgb, seen, LINE_PX * size_px / 512, colour)
        draw_clock(rgb, turn, operator, colour)
        picture = letters_at_edges(replace(picture, rgb=rgb), text_size(rgb))
    return TurnPicture(turn, operator, picture, in_view, inside & in_view)


def _seed(picture: Picture, turn: Turn) -> tuple[float, float]:
    """Return the position (column, row) of the opening's middle, clamped to the picture."""
    height, width = picture.rgb.shape[:2]
    at = None if turn.opening_lps is None else picture.pixel_of(turn.opening_lps)
    if at is None:
        return width / 2.0, height / 2.0
    return min(max(at[0], 0.0), width - 1.0), min(max(at[1], 0.0), height - 1.0)


def _smoothed(field: Field, sigma_px: float) -> Field:
    """Smooth a picture by a Gaussian; the values of the edge are continued outside."""
    reach = max(1, math.ceil(3.0 * sigma_px))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_px) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        padded = np.pad(field, [(reach, reach) if n == axis else (0, 0) for n in (0, 1)], mode="edge")
        length = field.shape[axis]
        field = sum(
            (w * np.take(padded, np.arange(n, n + length), axis=axis) for n, w in enumerate(weights)),
            start=np.zeros_like(field),
        )
    return field
