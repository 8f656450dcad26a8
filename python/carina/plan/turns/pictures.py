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
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.picture_marks import draw_clock, draw_edge
from carina.plan.turns.texts import hour_words
from carina.plan.turns.turn_list import Turn, TurnList
from carina.render import AirwayView, Picture, Renderer, letter_edges
from carina.render.png_text import KEYWORD
from carina.scopes import Lens, Pose
from carina.track import Airways, AirwayTree, Branch
from carina.volume import Volume

__all__ = ["TurnPicture", "turn_pictures", "turn_view"]

Points = NDArray[np.float64]
Field = NDArray[np.float64]

FOV_DEG = 120.0
"""Field of view of the pictures in degrees, as wide as that of the library's scopes."""
SIZES_PX = (128, 2048)
LINE_PX = 2.5
"""Width of the outline in pixels of a picture of 512 pixels."""
SMOOTH_PX = 2.0
"""Sigma of the smoothing of the outline, in pixels of a picture of 512 pixels."""
LEAST_SHARE = 2e-4
"""Least share of the picture's pixels for an opening that is outlined; a smaller opening counts as out of view."""
ROUTE_RGB = (79, 211, 230)
DOUBTFUL_RGB = (244, 180, 76)
"""Colour of an opening into a branch that the CT does not show with certainty."""
NEAR_MM = 80.0
"""Distance in mm from the fork within which branches are considered when walls are assigned to branches."""
PLACES_MM = 0.7
"""Distance in mm between the centreline points from which the distance to a branch's surface is computed."""
COARSE = 2
"""Step in pixels at which pixels of wall are assigned to branches."""
BESIDE_MM = 4.0
"""Largest distance in mm of a wall outside a branch's surface that still belongs to the branch."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TurnPicture:
    """Picture before one turn."""

    turn: Turn
    operator: Operator
    picture: Picture
    """Picture with outline, hours and letters, and the positions of its pixels."""
    in_view: bool
    """Whether the opening of the branch to enter is visible and outlined.

    If not, a fold of the wall hides the opening, and only its hour is marked.
    """
    outline: NDArray[np.bool_]
    """(height, width) mask of the visible wall of the branch to enter."""

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """Pixels of the picture, (height, width, 3)."""
        return self.picture.rgb

    @property
    def camera(self) -> Pose:
        """Pose of the camera."""
        return self.turn.camera(self.operator)

    @property
    def words(self) -> str:
        """Caption of the picture as text."""
        seen = "" if self.in_view else "; the opening itself is not in view from here"
        return f"{self.turn.to_branch}, {hour_words(self.turn.hour(self.operator))}{seen}"

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
        False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction is
        None where it is unknown.
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


def turn_view(renderer: Renderer, camera: Pose, size_px: int) -> AirwayView:
    """Return the view of the still pictures and clips from a camera, without artificial texture."""
    return AirwayView(
        camera,
        fov_deg=FOV_DEG,
        width=size_px,
        height=size_px,
        lens=Lens.equidistant(),
        method="leap" if renderer.prepared else "brute",
        texture=False,
    )


def _picture(
    renderer: Renderer, tree: AirwayTree, turn: Turn, operator: Operator, size_px: int, *, marked: bool
) -> TurnPicture:
    view = turn_view(renderer, turn.camera(operator), size_px)
    picture = renderer.render(view)
    coarse = replace(view, width=-(-size_px // COARSE), height=-(-size_px // COARSE))
    column, row = _seed(picture, turn)
    walls = renderer.surface(coarse).position_lps
    ours = _connected(*_belongs(tree, turn, walls), (column / COARSE, row / COARSE))
    fine = np.repeat(np.repeat(ours, COARSE, axis=0), COARSE, axis=1)[:size_px, :size_px]
    seen = _smoothed(fine.astype(np.float64), max(SMOOTH_PX * size_px / 512, 0.8 * COARSE))
    inside = seen > 0.5
    in_view = float(inside.mean()) >= LEAST_SHARE
    if marked:
        rgb = picture.rgb.copy()
        colour = DOUBTFUL_RGB if turn.doubts else ROUTE_RGB
        if in_view:
            draw_edge(rgb, seen, LINE_PX * size_px / 512, colour)
        draw_clock(rgb, turn, operator, colour)
        picture = letter_edges(replace(picture, rgb=rgb))
    return TurnPicture(turn, operator, picture, in_view, inside & in_view)


def _belongs(tree: AirwayTree, turn: Turn, walls_lps: Points) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the masks of the walls (h, w, 3) of the branch to enter or its descendants, and of other branches.

    A wall belongs to the branch with the nearest surface: least distance from the centreline, less the radius. The
    branch to enter begins where its centreline leaves the lumen of all other branches.
    """
    below = {turn.to_branch_id}
    # Parents precede their children in the tree.
    for branch in tree.branches:
        if branch.parent in below:
            below.add(branch.id)
    fork = np.array(turn.fork_lps)
    ours: list[tuple[Points, Field]] = []
    others: list[tuple[Points, Field]] = []
    for branch in tree.branches:
        line, radius = _places(branch)
        near = np.linalg.norm(line - fork, axis=1) <= NEAR_MM
        if near.any():
            (ours if branch.id in below else others).append((line[near], radius[near]))
    all_others = np.concatenate([line for line, _ in others]), np.concatenate([radius for _, radius in others])
    for n, (line, radius) in enumerate(ours):
        apart = _to_surface_mm(line, *all_others) >= 0.0
        if not apart.all():
            others.append((line[~apart], radius[~apart]))
            ours[n] = line[apart], radius[apart]
    points = walls_lps.reshape(-1, 3)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    points = np.where(known[:, None], points, np.inf)
    gap, other_gap = (_least_gap_mm(points, tubes) for tubes in (ours, others))
    shape = walls_lps.shape[:2]
    return (known & (gap < other_gap)).reshape(shape), (known & (other_gap < gap)).reshape(shape)


def _least_gap_mm(points: Points, tubes: list[tuple[Points, Field]]) -> Field:
    """Return the distance of points outside the nearest of several tubes; infinite if it exceeds :data:`BESIDE_MM`."""
    found = np.full(len(points), np.inf)
    for line, radius in tubes:
        if not len(line):
            continue
        reach = (radius + BESIDE_MM)[:, None]
        low, high = (line - reach).min(axis=0), (line + reach).max(axis=0)
        close = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        if close.size:
            found[close] = np.minimum(found[close], _to_surface_mm(points[close], line, radius))
    return np.where(found <= BESIDE_MM, found, np.inf)


def _places(branch: Branch) -> tuple[Points, Field]:
    """Return evenly spaced points (n, 3) of a branch's centreline and the radii (n,) at these points."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(2, math.ceil(along[-1] / PLACES_MM) + 1))
    line = np.stack([np.interp(at, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    return line, np.interp(at, along, branch.radius)


def _to_surface_mm(points: Points, line: Points, radius: Field) -> Field:
    """Return the least distance of points outside a tube: distance from a point of its line, less the radius there."""
    middle = line.mean(axis=0)
    away, line = points - middle, line - middle
    squared = (away**2).sum(axis=1)[:, None] + (line**2).sum(axis=1) - 2.0 * away @ line.T
    found: Field = (np.sqrt(np.maximum(squared, 0.0)) - radius).min(axis=1)
    return found


def _seed(picture: Picture, turn: Turn) -> tuple[float, float]:
    """Return the position (column, row) of the opening's middle, clamped to the picture."""
    height, width = picture.rgb.shape[:2]
    at = None if turn.opening_lps is None else picture.pixel_of(turn.opening_lps)
    if at is None:
        return width / 2.0, height / 2.0
    return min(max(at[0], 0.0), width - 1.0), min(max(at[1], 0.0), height - 1.0)


def _connected(mask: NDArray[np.bool_], others: NDArray[np.bool_], seed: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the part of a mask nearest to a position (column, row), without holes except those of other branches."""
    if not mask.any():
        return mask
    # Slivers of the wall behind a corner are connected by a few pixels and are not part of the opening.
    core = _shrunk(mask)
    core = core if core.any() else mask
    rows, columns = np.nonzero(core)
    nearest = int(np.argmin((columns + 0.5 - seed[0]) ** 2 + (rows + 0.5 - seed[1]) ** 2))
    start = np.zeros_like(mask)
    start[rows[nearest], columns[nearest]] = True
    patch = _filled_from(start, core)
    if core is not mask:
        patch = ~_shrunk(~patch) & mask
    # A hole cannot be reached from the border. Far walls in the lumen belong to no branch and count as holes.
    border = np.zeros_like(mask)
    border[[0, -1], :] = border[:, [0, -1]] = True
    hole = ~patch & ~_filled_from(border & ~patch, ~patch)
    return patch | (hole & ~others)


def _shrunk(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Erode a mask by two pixels; the mask is continued beyond the edges of the picture."""
    found = mask
    for step in range(2):
        padded = np.pad(found, 1, mode="edge")
        crossed = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:] & found
        if step:
            crossed &= padded[:-2, :-2] & padded[2:, 2:] & padded[:-2, 2:] & padded[2:, :-2]
        found = crossed
    return found


def _filled_from(start: NDArray[np.bool_], within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the part of a mask that is connected to a start by sides, by alternate sweeps over rows and columns."""
    found = start & within
    while True:
        before = int(found.sum())
        for axis in (0, 1):
            for turned in (False, True):
                found = _swept(found, within, axis=axis, backwards=turned)
        if int(found.sum()) == before:
            return found


def _swept(found: NDArray[np.bool_], within: NDArray[np.bool_], *, axis: int, backwards: bool) -> NDArray[np.bool_]:
    """Fill each run of ``within`` along an axis from its first found pixel onwards."""
    a = np.moveaxis(found, axis, 1)
    w = np.moveaxis(within, axis, 1)
    if backwards:
        a, w = a[:, ::-1], w[:, ::-1]
    place = np.arange(a.shape[1])
    last_found = np.maximum.accumulate(np.where(a, place, -1), axis=1)
    last_gap = np.maximum.accumulate(np.where(w, -1, place), axis=1)
    filled = w & (last_found > last_gap)
    if backwards:
        filled = filled[:, ::-1]
    return np.ascontiguousarray(np.moveaxis(filled, 1, axis))


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
