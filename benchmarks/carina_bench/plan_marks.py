"""Measurement of the arrow and the outlined opening in rendered pictures of turns.

The marks are found by their colour in the pixels of a picture; no number that drew them is used. The hour of the arrow
is the direction of its widest part on the clock's ring, the hour of the opening that of the middle of the area that the
outline encloses.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

__all__ = ["Marks", "apart", "marks_in", "marks_summary"]

Mask = NDArray[np.bool_]
Rgb = NDArray[np.uint8]

COLOURS = ((79, 211, 230), (244, 180, 76))
"""Colours of the marks of a route and of a route over doubtful airways."""
GLYPH_EDGE = (8, 10, 12)
"""Colour round letters and hours, which are drawn over an outline that leaves the picture."""
NEAR_RGB = 90
"""Maximum sum of the channel differences between a pixel and the colour of a mark that it shows."""
RING = 0.8
"""Radius of the circle on which the arrow is widest, as a share of half the picture."""
MIN_ARROW, MAX_ARROW = 0.03, 0.11
"""Minimum and maximum width of the arrow on that circle, as a share of half the picture."""
MIN_AREA = 1e-3
"""Minimum share of the picture of an area, enclosed by marks, that counts as an outlined opening."""
AGREE_HOURS = 0.25
"""Maximum difference in hours between arrow and outlined opening that agree."""


@dataclass(frozen=True, slots=True)
class Marks:
    """Arrow and outlined opening as seen in a picture."""

    arrow_clock_hour: float | None
    """Clock hour to which the arrow in the picture points; None if the picture has no arrow."""
    ostium_clock_hour: float | None
    """Clock hour, seen from the picture's centre, of the outlined ostium's middle; None if no ostium is outlined."""
    is_centre_inside: bool
    """Whether the middle of the picture is in the outlined ostium."""

    @property
    def apart_hours(self) -> float | None:
        """Difference in hours between the directions of the arrow and of the ostium; None if one of them is missing."""
        if self.arrow_clock_hour is None or self.ostium_clock_hour is None:
            return None
        return apart(self.arrow_clock_hour, self.ostium_clock_hour)


def marks_in(rgb: Rgb) -> Marks:
    """Return the marks of a square picture (n, n, 3)."""
    size = rgb.shape[0]
    off = np.array([np.abs(rgb.astype(int) - colour).sum(axis=2) for colour in COLOURS])
    # All marks of a picture have one of two colours: that with most exact pixels. Light walls resemble the other.
    marked = off[int(np.argmax((off == 0).sum(axis=(1, 2))))] < NEAR_RGB
    opening = _enclosed(marked | (rgb == GLYPH_EDGE).all(axis=2))
    half = size // 2
    hours = None
    if opening.any():
        rows, columns = np.nonzero(opening)
        hours = _hours(columns.mean() + 0.5 - size / 2, rows.mean() + 0.5 - size / 2)
    return Marks(_arrow(marked), hours, bool(opening[half - 1 : half + 1, half - 1 : half + 1].any()))


def _enclosed(marked: Mask) -> Mask:
    """Return the mask of the largest area that marks separate from the rest of the picture."""
    size = marked.shape[0]
    # Thickening by a pixel closes gaps where the line is blended with the picture.
    line = marked.copy()
    for axis in (0, 1):
        for step in (1, -1):
            line |= np.roll(marked, step, axis=axis)
    parts = sitk.GetArrayFromImage(sitk.ConnectedComponent(sitk.GetImageFromArray((~line).astype(np.uint8))))
    areas = np.bincount(parts.reshape(-1))
    areas[0] = 0
    if np.count_nonzero(areas) < 2:
        return np.zeros_like(marked)
    areas[int(np.argmax(areas))] = 0
    found = int(np.argmax(areas))
    if areas[found] < MIN_AREA * size * size:
        return np.zeros_like(marked)
    inside: Mask = np.equal(parts, found)
    return inside


def _arrow(marked: Mask) -> float | None:
    """Return the clock hour of the arrow; None if not exactly one group of marked pixels on the ring has its width."""
    size = marked.shape[0]
    num = 8 * size
    angle = np.arange(num) / num * math.tau
    radius = RING * size / 2
    columns = np.floor(size / 2 + radius * np.sin(angle)).astype(int)
    rows = np.floor(size / 2 - radius * np.cos(angle)).astype(int)
    on = marked[rows, columns]
    if on.all() or not on.any():
        return None
    start = int(np.flatnonzero(~on)[0])
    on = np.roll(on, -start)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    runs = edges.reshape(-1, 2)
    width = (runs[:, 1] - runs[:, 0]) / num * math.tau * RING
    wide = runs[(width >= MIN_ARROW) & (width <= MAX_ARROW)]
    if len(wide) != 1:
        return None
    middle = (start + 0.5 * (wide[0].sum() - 1)) / num * 12.0
    return float(middle % 12.0)


def _hours(right: float, down: float) -> float:
    return (math.atan2(right, -down) / math.tau * 12.0) % 12.0


def apart(one: float, other: float) -> float:
    """Return the difference of two clock hours, 0 to 6."""
    gap = abs(one - other) % 12.0
    return min(gap, 12.0 - gap)


def marks_summary(pictures: Iterable[tuple[Rgb, float | None, bool]]) -> dict[str, Any]:
    """Return how many pictures have marks that agree with each other and with the caption.

    Parameters
    ----------
    pictures
        Picture, unrounded clock hour of its turn (None if none is given), and whether the turn is straight ahead.
    """
    found = [(marks_in(rgb), hours, ahead) for rgb, hours, ahead in pictures]
    with_hour = [(marks, hours) for marks, hours, _ in found if hours is not None]
    ahead = [marks for marks, _, is_ahead in found if is_ahead]
    gaps = [marks.apart_hours for marks, _ in with_hour if marks.apart_hours is not None]
    return {
        "pictures": len(found),
        "with an hour": len(with_hour),
        "arrow and outline measured": len(gaps),
        "agree": sum(gap <= AGREE_HOURS for gap in gaps),
        "most apart, hours": round(max(gaps, default=math.nan), 3),
        "outline within half an hour of the hour": sum(
            marks.ostium_clock_hour is not None and apart(marks.ostium_clock_hour, hours) <= 0.5
            for marks, hours in with_hour
        ),
        "straight ahead": len(ahead),
        "straight ahead, centre inside, no arrow": sum(
            marks.is_centre_inside and marks.arrow_clock_hour is None for marks in ahead
        ),
        "arrow without an hour": sum(marks.arrow_clock_hour is not None and hours is None for marks, hours, _ in found),
    }
