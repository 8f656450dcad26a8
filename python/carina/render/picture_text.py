"""Letters, scale ticks and branch names in pictures that are saved as files; the window draws its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.dot_letters import DOTS_HIGH, TEXT_RGB, glyph_size, write_on
from carina.errors import UsageError
from carina.render.view_table import VIEWS
from carina.render.views import Picture, PictureLines

QUIET_RGB, _AXIS_RGB, _RADIUS_RGB = (169, 177, 184), (79, 211, 230), (79, 211, 230)
DRAWN_RGB = (244, 180, 76)
_DASH_ROWS = 10

# Number of picture rows over which the direction of the path at an end is measured.
LOCAL_ROWS = 12

_LETTERS = (("L", "R"), ("P", "A"), ("S", "I"))


@one_line
@dataclass(frozen=True, slots=True)
class PathSpan:
    """Part of a path inside one branch, with the branch's name to print."""

    name: str
    from_mm: float
    to_mm: float
    drawn: bool = False
    """Whether the CT shows no airway here (drawn by hand, or a bridge); its lines are dashed and of another colour."""


def letters_of(direction_lps: NDArray[np.float64]) -> str:
    """Return the anatomical letters of a direction, dominant first.

    A direction that is oblique by 12 degrees or more has two letters.
    """
    unit = np.asarray(direction_lps, dtype=np.float64) / float(np.linalg.norm(direction_lps))
    order = np.argsort(-np.abs(unit), kind="stable")[:2]
    return "".join(
        _LETTERS[axis][0 if unit[axis] >= 0 else 1] for n, axis in enumerate(order) if n == 0 or abs(unit[axis]) >= 0.2
    )


def letter_edges(picture: Picture) -> Picture:
    """Return a copy of a picture with the patient's directions at its four edges, from the picture's geometry.

    Raises
    ------
    UsageError
        If the picture has no geometry of its pixels.
    """
    return letters_at_edges(picture, glyph_size(picture.rgb))


def letters_at_edges(picture: Picture, size: int) -> Picture:
    """Return a copy of a picture with the patient's directions at its edges, in glyphs of ``size`` pixels per dot."""
    rgb = picture.rgb.copy()
    height, width = rgb.shape[:2]
    lines = picture.lines
    if lines is not None:
        # Along a bent path the direction changes, so each letter shows the direction at its own end of the path.
        known = np.flatnonzero(np.isfinite(lines.path_mm))
        first, last = (int(known[0]), int(known[-1])) if known.size > 1 else (0, height - 1)
        right = lines.step_lps[first]
        up, down = (
            -_row_difference(lines, first, min(first + LOCAL_ROWS, last)),
            _row_difference(lines, max(last - LOCAL_ROWS, first), last),
        )
    else:
        matrix = picture.lps_from_pixel if picture.lps_from_pixel is not None else picture.lps_from_camera
        if matrix is None:
            raise UsageError("orientation letters need an image with pixel geometry, which this one lacks")
        right, up, down = matrix[:3, 0], -matrix[:3, 1], matrix[:3, 1]
    inset = 3 * size
    sides = (inset, width - inset, height // 2)
    if lines is not None:
        # The axis occupies the left edge and the names the right edge.
        sides = (width // 4, width - width // 4, inset + DOTS_HIGH * size // 2)
    for direction, column, row, align in (
        (-right, sides[0], sides[2], 0.0),
        (right, sides[1], sides[2], 1.0),
        (up, width // 2, inset + DOTS_HIGH * size // 2, 0.5),
        (down, width // 2, height - inset - DOTS_HIGH * size // 2, 0.5),
    ):
        write_on(rgb, letters_of(direction), column, row, align=align, size=size)
    return dataclasses.replace(picture, rgb=rgb)


def _row_difference(lines: PictureLines, first: int, last: int) -> NDArray[np.float64]:
    """Return the vector from one row of a picture to another row along the displayed path, LPS mm."""
    ends = [lines.lps_of(float(lines.path_column[row]), row + 0.5) for row in (first, last)]
    return ends[1] - ends[0] if last > first else np.array([0.0, 0.0, -1.0])


def mark_path(
    picture: Picture,
    *,
    spans: Sequence[PathSpan] = (),
    radius_mm: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    axis: bool = True,
) -> Picture:
    """Return a copy of a view along a path with its axis: distances in mm, names of the branches, outline of the lumen.

    Parameters
    ----------
    picture
        A ``straightened`` or ``curved`` picture.
    spans
        Branches along the path; a name is omitted if it would overlap another.
    radius_mm
        Positions (n,) along the path and lumen radii (n,), mm. They are drawn as two dotted lines in the straightened
        picture, except along branches that were drawn by hand.
    axis
        Whether the axis with its distances is drawn.

    Raises
    ------
    UsageError
        If the picture is not a view along a path.
    """
    lines = picture.lines
    if lines is None:
        raise UsageError("only views along a path have a position axis")
    rgb = picture.rgb.copy()
    height, width = rgb.shape[:2]
    size = glyph_size(rgb)
    known = np.isfinite(lines.path_mm)
    rows = np.flatnonzero(known)
    if rows.size == 0:
        return dataclasses.replace(picture, rgb=rgb)
    drawn = np.zeros(rows.size, dtype=bool)
    for span in spans:
        if span.drawn:
            drawn |= (lines.path_mm[rows] >= span.from_mm) & (lines.path_mm[rows] <= span.to_mm)
    if radius_mm is not None and VIEWS[picture.view].straight:
        reach = np.interp(lines.path_mm[rows], radius_mm[0], radius_mm[1]) / lines.mm_per_px
        for side in (-1.0, 1.0):
            columns = (lines.path_column[rows] + side * reach).astype(int)
            shown = ~drawn & (rows // size % 4 < 2) & (columns >= 0) & (columns < width)
            rgb[rows[shown], columns[shown]] = _RADIUS_RGB

    def row_of(place_mm: float) -> int | None:
        if not lines.path_mm[rows[0]] <= place_mm <= lines.path_mm[rows[-1]]:
            return None
        return round(float(np.interp(place_mm, lines.path_mm[rows], rows)))

    if axis:
        _draw_axis(rgb, picture, drawn, row_of)
    taken = -height
    for span in spans:
        start = row_of(span.from_mm) if span.from_mm > lines.path_mm[rows[0]] else int(rows[0])
        end = row_of(span.to_mm) if span.to_mm < lines.path_mm[rows[-1]] else int(rows[-1])
        if start is None or end is None:
            continue
        right = width - 3 * size
        rgb[start : start + size, max(right - 5 * size, 0) : right] = QUIET_RGB
        row = (start + end) // 2
        if row - taken > (DOTS_HIGH + 2) * size:
            write_on(rgb, span.name, right, row, align=1.0, size=size, rgb_of=DRAWN_RGB if span.drawn else TEXT_RGB)
            taken = row
    return dataclasses.replace(picture, rgb=rgb)


def _draw_axis(
    rgb: NDArray[np.uint8],
    picture: Picture,
    drawn: NDArray[np.bool_],
    row_of: Callable[[float], int | None],
) -> None:
    """Draw the axis of a path at the left edge, with distances in mm; a part that was drawn by hand is dashed."""
    lines = picture.lines
    assert lines is not None
    rows = np.flatnonzero(np.isfinite(lines.path_mm))
    size = glyph_size(rgb)
    left = 3 * size
    rgb[rows[0] : rows[-1] + 1, left : left + size] = _AXIS_RGB
    gaps = rows[drawn] % (_DASH_ROWS * size) >= _DASH_ROWS * size // 2
    rgb[rows[drawn], left : left + size] = np.where(
        gaps[:, None, None], picture.rgb[rows[drawn], left : left + size], DRAWN_RGB
    )
    per_px = (lines.path_mm[rows[-1]] - lines.path_mm[rows[0]]) / max(rows[-1] - rows[0], 1)
    tick_mm = next(mm for mm in (1, 2, 5, 10, 20, 50, 100, 1000) if mm / max(per_px, 1e-6) >= 3 * DOTS_HIGH * size)
    first = int(np.ceil(lines.path_mm[rows[0]] / tick_mm - 1e-3))
    for place_mm in np.arange(first, lines.path_mm[rows[-1]] / tick_mm + 1e-3) * tick_mm:
        row = row_of(float(np.clip(place_mm, lines.path_mm[rows[0]], lines.path_mm[rows[-1]])))
        if row is not None:
            rgb[row : row + size, left : left + 5 * size] = _AXIS_RGB
            write_on(rgb, f"{place_mm:.0f} mm", left + 7 * size, row, size=size)
