"""Drawing as a value: lines, circles, text and images; the HTML page shows it as SVG, the PDF as vector graphics."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from carina.display import one_line
from carina.display.html import escaped

Place = tuple[float, float]
"""Type of a position in a drawing: right and down from the upper left corner, in the drawing's own unit."""
Anchor = Literal["start", "middle", "end"]


@one_line
@dataclass(frozen=True, slots=True)
class LineStyle:
    """Style of a shape; colours are ``#rrggbb``, and None omits the line or the fill."""

    line: str | None = "#000000"
    width: float = 1.0
    fill: str | None = None
    dash: tuple[float, float] | None = None
    opacity: float = 1.0


@one_line
@dataclass(frozen=True, slots=True)
class Stroke:
    """Polyline of a drawing, or polygon if ``closed``."""

    places: tuple[Place, ...]
    pen: LineStyle
    closed: bool = False


@one_line
@dataclass(frozen=True, slots=True)
class Disc:
    """Circle of a drawing."""

    middle: Place
    radius: float
    pen: LineStyle


@one_line
@dataclass(frozen=True, slots=True)
class Label:
    """Line of text in a drawing; ``at`` is the anchor on the baseline of the text."""

    at: Place
    text: str
    size: float = 9.0
    colour: str = "#000000"
    anchor: Anchor = "start"
    bold: bool = False
    halo: str | None = None
    """Colour of an outline that keeps the text legible on an image."""


@one_line
@dataclass(frozen=True, slots=True)
class Raster:
    """Image in a rectangle of a drawing."""

    corner: Place
    size: Place
    png: bytes


Shape = Stroke | Disc | Label | Raster


@one_line
@dataclass(frozen=True, slots=True)
class Drawing:
    """Drawing: shapes on a sheet, later shapes in front; ``says`` is the text alternative for screen readers."""

    width: float
    height: float
    shapes: tuple[Shape, ...]
    says: str


def svg(drawing: Drawing) -> str:
    """Return the drawing as an SVG element without style attributes, which the page's security policy forbids."""
    inner = "".join(_element(shape) for shape in drawing.shapes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {drawing.width:g} {drawing.height:g}" role="img" '
        f'aria-label="{escaped(drawing.says)}">{inner}</svg>'
    )


def _element(shape: Shape) -> str:
    match shape:
        case Stroke(places=places, pen=pen, closed=closed):
            points = _points(places)
            return f'<{"polygon" if closed else "polyline"} points="{points}"{_pen(pen)}/>'
        case Disc(middle=(x, y), radius=radius, pen=pen):
            return f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{radius:.2f}"{_pen(pen)}/>'
        case Label():
            return _text(shape)
        case Raster(corner=(x, y), size=(width, height), png=png):
            data = base64.b64encode(png).decode("ascii")
            return (
                f'<image x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" '
                f'href="data:image/png;base64,{data}"/>'
            )


def _text(label: Label) -> str:
    x, y = label.at
    weight = ' font-weight="bold"' if label.bold else ""
    halo = (
        ""
        if label.halo is None
        else f' stroke="{label.halo}" stroke-width="{0.22 * label.size:.2f}" paint-order="stroke" '
        'stroke-linejoin="round"'
    )
    return (
        f'<text x="{x:.2f}" y="{y:.2f}" font-size="{label.size:g}" fill="{label.colour}" '
        f'text-anchor="{label.anchor}"{weight}{halo}>{escaped(label.text)}</text>'
    )


def _points(places: Sequence[Place]) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in places)


def _pen(pen: LineStyle) -> str:
    parts = [f' fill="{pen.fill or "none"}"']
    if pen.line is not None:
        parts.append(f' stroke="{pen.line}" stroke-width="{pen.width:g}" stroke-linecap="round"')
        parts.append(' stroke-linejoin="round"')
        if pen.dash is not None:
            parts.append(f' stroke-dasharray="{pen.dash[0]:g} {pen.dash[1]:g}"')
    if pen.opacity < 1.0:
        parts.append(f' opacity="{pen.opacity:g}"')
    return "".join(parts)
