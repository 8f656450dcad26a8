"""Drawing of centrelines, seen from the front, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display.html import escaped

MARGIN_PX = 22
MAX_POINTS = 40
"""Maximum number of points of a line in the drawing."""
COLOURS = ("#e6e8ea", "#8fd3e8", "#7fc8a9", "#c9d77e", "#e8c07d", "#d99a8b")
DRAWN_COLOUR = "#f4b44c"
"""Colour of branches that the user drew by hand, as in the window."""


def generation_colour(generation: int) -> str:
    """Return the colour of a generation: light for the trachea, then one colour for each next generation."""
    return COLOURS[min(generation, len(COLOURS) - 1)]


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Line of the drawing, such as a branch or a route."""

    points_lps: NDArray[np.float64]
    """Points of the line, shape (n, 3), LPS, mm."""
    width_mm: float
    colour: str
    title: str
    """Tooltip of the line."""


def ways_svg(ways: Sequence[Way], *, height_px: int, alt: str) -> str:
    """Return an SVG of lines projected to the coronal plane, patient right on the left, head up.

    Each line is drawn with its true width, but at least 1 pixel wide. Later lines cover earlier ones.
    """
    points = np.concatenate([way.points_lps for way in ways])
    low, high = points.min(axis=0), points.max(axis=0)
    # The scale fills the height unless the drawing would be more than twice as wide as high.
    px_per_mm = (height_px - 2 * MARGIN_PX) / max(high[2] - low[2], (high[0] - low[0]) / 2.0, 1.0)
    width = int(np.ceil((high[0] - low[0]) * px_per_mm)) + 2 * MARGIN_PX
    lines = []
    for way in ways:
        remaining = way.points_lps[np.unique(np.linspace(0, len(way.points_lps) - 1, MAX_POINTS).astype(int))]
        x = MARGIN_PX + (remaining[:, 0] - low[0]) * px_per_mm
        y = MARGIN_PX + (high[2] - remaining[:, 2]) * px_per_mm
        drawn = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        lines.append(
            f'<polyline points="{drawn}" fill="none" stroke="{way.colour}" '
            f'stroke-width="{max(1.0, way.width_mm * px_per_mm):.1f}" stroke-linecap="round" stroke-linejoin="round">'
            f"<title>{escaped(way.title)}</title></polyline>"
        )
    letters = "".join(
        f'<text x="{x}" y="{height_px // 2}" fill="#a9b1b8" font-family="sans-serif" font-size="14" '
        f'text-anchor="middle">{letter}</text>'
        for letter, x in (("R", 10), ("L", width - 10))
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{escaped(alt)}" width="{width}" '
        f'height="{height_px}" style="background:#101418;vertical-align:top;margin-right:12px">'
        f"{''.join(lines)}{letters}</svg>"
    )
