"""Marks in pictures that are saved as files: tip, letters, scale, names of branches, and the word *decorated*.

The command line and the window finish their pictures with `finish_picture`, so that equal settings give equal files.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.dot_letters import TEXT_RGB, glyph_size, text_height, text_width, write_on
from carina.render.picture_text import DRAWN_RGB, QUIET_RGB, PathSpan, letter_edges, mark_path
from carina.render.pictures import mark_tip
from carina.render.view_table import VIEWS
from carina.render.views import Picture

FULL_STEP_VOX = 0.5
"""Step along the rays in voxels for saved pictures and videos, in the window and in the command line."""
DECORATED = "decorated"
"""Word printed in every picture that shows drawn features (decoration), which do not come from the CT."""
SCALE_MM = (1, 2, 5, 10, 20, 50, 100, 200)
"""Lengths of a scale bar, mm."""
SCALE_SHARE = 0.25
"""Maximum length of a scale bar as a share of the picture's width; the longest round length below it is drawn."""

Point = NDArray[np.float64] | tuple[float, float, float]


@one_line
@dataclass(frozen=True, slots=True, kw_only=True)
class PictureMarks:
    """Marks that the user selects for a saved picture; a view ignores marks that it cannot show."""

    letters: bool = True
    """Whether orientation letters (such as R and L) are written at the edges of the picture."""
    scale: bool = True
    """Whether a scale bar in mm is drawn, or the axis with distances in a view along a path."""
    names: bool = True
    """Whether names of branches are written into the picture."""


def default_marks(view: str) -> PictureMarks:
    """Return the marks that ``carina render`` draws by default: letters, and axis and names in views along a path."""
    row = VIEWS[view]
    along_path = "route" in row.needs
    return PictureMarks(letters=row.lettered, scale=along_path, names=along_path)


@one_line
@dataclass(frozen=True, slots=True)
class NamedPlace:
    """Name of a branch, and the point in LPS mm where the name is written."""

    text: str
    lps: tuple[float, float, float]
    doubtful: bool = False
    """Whether the CT shows no airway here (drawn by hand, or a bridge); its name has another colour."""


def finish_picture(
    picture: Picture,
    marks: PictureMarks,
    *,
    tip_lps: Point | None = None,
    places: Iterable[NamedPlace] = (),
    title: str | None = None,
    spans: Sequence[PathSpan] = (),
    radius_mm: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> Picture:
    """Return a copy of a picture with its marks.

    Parameters
    ----------
    picture
        The picture as rendered.
    marks
        Marks that the user selected.
    tip_lps
        Position of the tip, LPS mm, for views that mark it; None if it is unknown.
    places
        Names of branches with their points, the most important first; a name that would cover another is omitted.
    title
        Name of the tip's branch, which is written in a corner of the airway view.
    spans, radius_mm
        Branches along the path and radii of its lumen, for views along a path (`mark_path`).
    """
    row = VIEWS[picture.view]
    along_path = picture.lines is not None
    if row.marks_tip and tip_lps is not None:
        picture = mark_tip(picture, tip_lps)
    if along_path and (marks.scale or marks.names):
        picture = mark_path(
            picture,
            spans=spans if marks.names else (),
            radius_mm=radius_mm if marks.scale else None,
            axis=marks.scale,
        )
    if along_path and tip_lps is not None:
        picture = mark_tip(picture, tip_lps)
    if marks.letters:
        picture = letter_edges(picture)
    if marks.scale and row.scaled and not along_path:
        picture = with_scale_bar(picture)
    if marks.names and row.named and not along_path:
        picture = with_names(picture, places, title)
    return with_decoration_word(picture)


def with_scale_bar(picture: Picture) -> Picture:
    """Return a copy of a planar picture with a scale bar at the lower left; unchanged if it has no scale in mm."""
    if picture.lps_from_pixel is None:
        return picture
    rgb = picture.rgb.copy()
    height, width = rgb.shape[:2]
    size = glyph_size(rgb)
    px_mm = float(np.linalg.norm(picture.lps_from_pixel[:3, 0]))
    fitting = [mm for mm in SCALE_MM if mm / px_mm <= SCALE_SHARE * width]
    if not fitting:
        return picture
    length = round(fitting[-1] / px_mm)
    left, bottom = 4 * size, height - 4 * size
    _draw_bar(rgb, left, bottom, length, size)
    write_on(rgb, f"{fitting[-1]} mm", left, bottom - 4 * size - text_height(size), size=size)
    return dataclasses.replace(picture, rgb=rgb)


def _draw_bar(rgb: NDArray[np.uint8], left: int, bottom: int, length: int, size: int) -> None:
    """Draw a horizontal bar with a tick at each end, light on a dark rim."""
    ticks = [(left, 4 * size, size), (left + length - size, 4 * size, size)]
    parts = [(left, size, length), *ticks]
    for rim, colour in ((1, (8, 10, 12)), (0, TEXT_RGB)):
        for column, tall, wide in parts:
            top = max(bottom - tall - rim, 0)
            rgb[top : bottom + rim, max(column - rim, 0) : column + wide + rim] = colour


def with_names(picture: Picture, places: Iterable[NamedPlace], title: str | None = None) -> Picture:
    """Return a copy of a picture with names beside their points; a name that would cover another is omitted.

    Parameters
    ----------
    picture
        A picture with pixel geometry.
    places
        The names, the most important first.
    title
        Text in the upper left corner; None writes nothing there.
    """
    rgb = picture.rgb.copy()
    height, width = rgb.shape[:2]
    size = glyph_size(rgb)
    high, gap = text_height(size) + 2 * size, 3 * size
    taken: list[tuple[int, int, int, int]] = []
    if title:
        write_on(rgb, title, gap, gap + high // 2, size=size)
        taken.append((0, 0, gap + text_width(title, size), gap + high))
    for place in places:
        at = picture.pixel_of(place.lps)
        if at is None or not (0 <= at[0] < width and 0 <= at[1] < height):
            continue
        wide = text_width(place.text, size)
        left = int(at[0]) + gap
        if left + wide > width - gap:
            left = int(at[0]) - gap - wide
        row = min(max(int(at[1]), gap + high // 2), height - gap - high // 2)
        box = (left - size, row - high // 2, left + wide + size, row + high // 2)
        if left < 0 or any(_overlap(box, other) for other in taken):
            continue
        write_on(rgb, place.text, left, row, size=size, rgb_of=DRAWN_RGB if place.doubtful else TEXT_RGB)
        taken.append(box)
    return dataclasses.replace(picture, rgb=rgb)


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def with_decoration_word(picture: Picture) -> Picture:
    """Return a copy of a decorated picture with the word *decorated*; return other pictures unchanged.

    In a picture of less than about 160 pixels the word would cover the lumen, so it is omitted.
    """
    height, width = picture.rgb.shape[:2]
    size = glyph_size(picture.rgb)
    if not picture.decorated or width < 3 * text_width(DECORATED, size):
        return picture
    rgb = picture.rgb.copy()
    row = height - 3 * size - text_height(size) // 2
    write_on(rgb, DECORATED, width - 3 * size, row, align=1.0, size=size, rgb_of=QUIET_RGB)
    return dataclasses.replace(picture, rgb=rgb)
