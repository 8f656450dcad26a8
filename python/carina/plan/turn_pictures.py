"""A still picture of each turn: levelled, from before the fork, with the right opening outlined.

The outline is the edge of what belongs to the branch among the first walls that the picture shows, so it ends where a
wall is in front. Mottling and micro relief, which are not the patient's, are off.
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
from carina.plan.fork_view import Operator
from carina.plan.turn_marks import draw_clock, draw_edge
from carina.plan.turn_words import hour_words
from carina.plan.turns import Turn, TurnList
from carina.render import AirwayView, Picture, Renderer, letter_edges
from carina.render.png_text import KEYWORD
from carina.scopes import Lens, Pose
from carina.track import Airways, AirwayTree, Branch
from carina.volume import Volume

__all__ = ["TurnPicture", "turn_pictures", "turn_view"]

Points = NDArray[np.float64]
Field = NDArray[np.float64]

FOV_DEG = 120.0
"""As wide as the instruments of the library look, so that an opening beside the axis is in the picture too."""
SIZES_PX = (128, 2048)
LINE_PX = 2.5
"""Width of the outline in a picture of 512 pixels."""
SMOOTH_PX = 2.0
"""The first walls' noise that the outline does not follow, in a picture of 512 pixels."""
LEAST_SHARE = 2e-4
"""Of the picture: a smaller patch of an opening is not outlined, and the opening is told to be out of view."""
ROUTE_RGB = (79, 211, 230)
DOUBTFUL_RGB = (244, 180, 76)
"""Of an opening into a branch that the CT does not show for certain."""
NEAR_MM = 80.0
"""Walls are told apart by the branches within this distance of the fork."""
PLACES_MM = 0.7
"""Of a centreline, for distances to its tube."""
COARSE = 2
"""Walls are told apart at every second pixel both ways: their edge is smoothed in any case."""
BESIDE_MM = 4.0
"""A wall farther outside a tube than this is not the tube's."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TurnPicture:
    """What is seen before one turn."""

    turn: Turn
    operator: Operator
    picture: Picture
    """With outline, hours and letters drawn in; it knows where its pixels are."""
    in_view: bool
    """The opening is seen from there, and outlined; else a fold of the wall hides it and only its hour is marked."""
    outline: NDArray[np.bool_]
    """(height, width), what is seen of the branch that is entered: inside its outline."""

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """(height, width, 3)."""
        return self.picture.rgb

    @property
    def camera(self) -> Pose:
        """Where it is seen from."""
        return self.turn.camera(self.operator)

    @property
    def words(self) -> str:
        """What is below the picture."""
        seen = "" if self.in_view else "; the opening itself is not in view from here"
        return f"{self.turn.to_branch}, {hour_words(self.turn.hour(self.operator))}{seen}"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``rgb`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.rgb, dtype=dtype, copy=copy)

    def png(self) -> bytes:
        """The picture as a PNG that says where its camera was (`carina.render.read_png_pose`)."""
        place = json.dumps(self.picture.place(), allow_nan=False)
        return png_bytes(np.ascontiguousarray(self.rgb), {KEYWORD: place})

    def _repr_png_(self) -> bytes:
        """The picture in a notebook."""
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
    """One picture of each turn of a route.

    Parameters
    ----------
    volume, airways
        The CT and the airways that the route was planned in.
    turns
        Of `carina.plan.turn_list`; `examples/05_turns` shows all of it.
    operator
        Which way up.
    size_px
        Width and height, 128 to 2048.
    marked
        Off leaves out outline, clock and letters.
    renderer
        One that shows this volume with these airways, where it is at hand; else it is made.
    progress
        False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction is
        None where it is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    tuple of TurnPicture
        In the order of the turns.

    Raises
    ------
    UsageError
        If the size is out of range.
    NoResultError
        If a turn does not say where it is seen from.
    CancelledError
        If ``cancel()`` said so.
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
    """What stills and clips of the turns show from a place: nothing in it is decoration."""
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
    """Which first walls (h, w, 3) are those of the branch that is entered or of what lies beyond it; and which others'.

    A wall belongs to the tube whose surface is nearest: least distance from the centreline, less the radius. The branch
    begins where its middle has left the lumen of all others: what is before that is the fork's.
    """
    below = {turn.to_branch_id}
    # Parents come first.
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
    """How far outside the nearest of some tubes points lie; infinite where that is more than :data:`BESIDE_MM`."""
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
    """Even places of a centreline (n, 3), and the radii (n,) there."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], max(2, math.ceil(along[-1] / PLACES_MM) + 1))
    line = np.stack([np.interp(at, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    return line, np.interp(at, along, branch.radius)


def _to_surface_mm(points: Points, line: Points, radius: Field) -> Field:
    """How far outside a tube points lie: distance from a place of its line, less the radius there; the least."""
    middle = line.mean(axis=0)
    away, line = points - middle, line - middle
    squared = (away**2).sum(axis=1)[:, None] + (line**2).sum(axis=1) - 2.0 * away @ line.T
    found: Field = (np.sqrt(np.maximum(squared, 0.0)) - radius).min(axis=1)
    return found


def _seed(picture: Picture, turn: Turn) -> tuple[float, float]:
    """Where the middle of the opening falls in the picture; its nearest edge where it falls outside."""
    height, width = picture.rgb.shape[:2]
    at = None if turn.opening_lps is None else picture.pixel_of(turn.opening_lps)
    if at is None:
        return width / 2.0, height / 2.0
    return min(max(at[0], 0.0), width - 1.0), min(max(at[1], 0.0), height - 1.0)


def _connected(mask: NDArray[np.bool_], others: NDArray[np.bool_], seed: tuple[float, float]) -> NDArray[np.bool_]:
    """The patch of a mask that is nearest to a place (column, row), without holes that are nobody else's."""
    if not mask.any():
        return mask
    # Slips of its wall round a corner hang on by a few pixels and are no part of the opening.
    core = _shrunk(mask)
    core = core if core.any() else mask
    rows, columns = np.nonzero(core)
    nearest = int(np.argmin((columns + 0.5 - seed[0]) ** 2 + (rows + 0.5 - seed[1]) ** 2))
    start = np.zeros_like(mask)
    start[rows[nearest], columns[nearest]] = True
    patch = _filled_from(start, core)
    if core is not mask:
        patch = ~_shrunk(~patch) & mask
    # A hole cannot be reached from the border. Far down the lumen walls are no branch's.
    border = np.zeros_like(mask)
    border[[0, -1], :] = border[:, [0, -1]] = True
    hole = ~patch & ~_filled_from(border & ~patch, ~patch)
    return patch | (hole & ~others)


def _shrunk(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask without what lies within two pixels of its edge; beyond the picture it goes on."""
    found = mask
    for step in range(2):
        padded = np.pad(found, 1, mode="edge")
        crossed = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:] & found
        if step:
            crossed &= padded[:-2, :-2] & padded[2:, 2:] & padded[:-2, 2:] & padded[2:, :-2]
        found = crossed
    return found


def _filled_from(start: NDArray[np.bool_], within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """All of a mask that can be reached from a start by steps to a side: whole runs of rows and columns in turn."""
    found = start & within
    while True:
        before = int(found.sum())
        for axis in (0, 1):
            for turned in (False, True):
                found = _swept(found, within, axis=axis, backwards=turned)
        if int(found.sum()) == before:
            return found


def _swept(found: NDArray[np.bool_], within: NDArray[np.bool_], *, axis: int, backwards: bool) -> NDArray[np.bool_]:
    """Each run of ``within`` along an axis filled from its first found place onwards."""
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
    """A Gaussian over a picture; the edge goes on outside."""
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
