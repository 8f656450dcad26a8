"""Small plots as SVG that are readable on light and dark pages: lines, timelines and reliability diagrams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from xml.sax.saxutils import escape

__all__ = ["line_plot", "reliability_plot", "timeline"]

COLOURS = ("#3b82c4", "#d97a2b", "#4a9b5c", "#b0509a", "#8a7a2f", "#2aa5a5", "#c23b5e", "#777777")
"""Colours of lines and boxes, in the order of their use."""
INK = "#777777"
"""Colour of axes and texts of a plot."""
WIDTH, HEIGHT = 640, 400
"""Width and height of a plot in pixels of the SVG."""
LEFT, RIGHT, TOP, BOTTOM = 64, 168, 40, 48
"""Margins around the area of the plot, pixels."""


def _text(x: float, y: float, words: str, *, anchor: str = "start", colour: str = INK) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{escape(words)}</text>'


def _line(a: tuple[float, float], b: tuple[float, float], colour: str, width: float = 1.0) -> str:
    return (
        f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" stroke="{colour}" '
        f'stroke-width="{width:g}"/>'
    )


def _svg(title: str, parts: Sequence[str], width: int = WIDTH, height: int = HEIGHT) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="13" role="img"><title>{escape(title)}</title>'
    )
    return "\n".join([head, _text(LEFT, 22, title), *parts, "</svg>", ""])


def line_plot(
    title: str,
    places: Sequence[float],
    lines: Mapping[str, Sequence[float]],
    *,
    across: str,
    up: str,
) -> str:
    """Return a plot of lines with a mark at each position; both axes start at 0.

    Parameters
    ----------
    title
        Title of the plot.
    places
        Positions of the marks on the horizontal axis, increasing.
    lines
        Values of each line at the positions, by the line's name.
    across, up
        Labels of the horizontal and the vertical axis, with units.
    """
    top = max(max(values) for values in lines.values()) * 1.05 or 1.0
    step = next(s for s in (b * 10**e for e in range(-3, 7) for b in (1, 2, 5)) if top / s <= 6)
    inner_w, inner_h = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def at(x: float, y: float) -> tuple[float, float]:
        return LEFT + x / places[-1] * inner_w, TOP + (1.0 - y / top) * inner_h

    parts = [_line(at(0, 0), at(places[-1], 0), INK), _line(at(0, 0), at(0, top), INK)]
    for n in range(int(top / step) + 1):
        x, y = at(0, n * step)
        parts += [_line((x - 4, y), (x, y), INK), _text(x - 8, y + 4, f"{n * step:g}", anchor="end")]
    for place in places:
        x, y = at(place, 0)
        parts += [_line((x, y), (x, y + 4), INK), _text(x, y + 18, f"{place:g}", anchor="middle")]
    parts += [_text(LEFT + inner_w / 2, HEIGHT - 8, across, anchor="middle"), _text(LEFT, TOP - 4, up, anchor="end")]
    for n, (name, values) in enumerate(lines.items()):
        colour = COLOURS[n % len(COLOURS)]
        points = [at(x, y) for x, y in zip(places, values, strict=True)]
        joined = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        parts.append(f'<polyline points="{joined}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in points]
        parts.append(_text(WIDTH - RIGHT + 12, TOP + 16 + 20 * n, name, colour=colour))
    return _svg(title, parts)


def timeline(title: str, jobs: Mapping[str, Sequence[tuple[float, float, int]]]) -> str:
    """Return a timeline: a row of boxes for each name.

    A box is (start in ms, end in ms, number); boxes of one number have one colour.
    """
    begin = min(job[0] for row in jobs.values() for job in row)
    end = max(job[1] for row in jobs.values() for job in row)
    height = TOP + 30 * len(jobs) + BOTTOM
    inner_w = WIDTH - LEFT - 24

    def x_of(ms: float) -> float:
        return LEFT + (ms - begin) / max(end - begin, 1e-9) * inner_w

    parts = []
    for n, (name, row) in enumerate(jobs.items()):
        y = TOP + 30 * n
        parts.append(_text(LEFT - 8, y + 17, name, anchor="end"))
        for start, stop, number in row:
            x, w = x_of(start), max(1.0, x_of(stop) - x_of(start) - 0.8)
            colour = COLOURS[number % len(COLOURS)]
            parts.append(f'<rect x="{x:.1f}" y="{y}" width="{w:.1f}" height="24" rx="2" fill="{colour}"/>')
            if w > 18:
                parts.append(_text(x + w / 2, y + 17, str(number), anchor="middle", colour="#ffffff"))
    foot = TOP + 30 * len(jobs)
    parts.append(_line((LEFT, foot), (LEFT + inner_w, foot), INK))
    span = end - begin
    step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000) if span / s <= 8)
    for n in range(int(span / step) + 1):
        x = x_of(begin + n * step)
        parts += [_line((x, foot), (x, foot + 4), INK), _text(x, foot + 18, f"{n * step:g}", anchor="middle")]
    parts.append(_text(LEFT + inner_w / 2, foot + 38, "ms; numbers and colours are frames", anchor="middle"))
    return _svg(title, parts, height=height)


def reliability_plot(
    title: str, judged: Mapping[str, Sequence[tuple[float, bool]]], *, num_bins: int = 10, least: int = 5
) -> str:
    """Return a reliability diagram: the share of true cases over the stated confidence, in bins.

    Points on the diagonal show that the confidence is a probability.

    Parameters
    ----------
    title
        Title of the plot.
    judged
        (confidence, is true) of each case, by the name of a line.
    num_bins
        Number of bins.
    least
        Number of cases below which a bin is not drawn.
    """
    inner_w, inner_h = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def at(x: float, y: float) -> tuple[float, float]:
        return LEFT + x * inner_w, TOP + inner_h - y * inner_h

    parts = [_line(at(0.0, 0.0), at(1.0, 1.0), INK)]
    for k in range(0, 11, 2):
        parts.append(_text(at(k / 10, 0.0)[0], HEIGHT - BOTTOM + 18, f"{k / 10:.1f}", anchor="middle"))
        parts.append(_text(LEFT - 8, at(0.0, k / 10)[1] + 4, f"{k / 10:.1f}", anchor="end"))
    parts += [_line(at(0.0, 0.0), at(1.0, 0.0), INK), _line(at(0.0, 0.0), at(0.0, 1.0), INK)]
    parts.append(_text(LEFT + inner_w / 2, HEIGHT - 10, "confidence", anchor="middle"))
    parts.append(_text(LEFT, TOP - 4, "share that is true"))
    for number, (name, members) in enumerate(judged.items()):
        colour = COLOURS[number % len(COLOURS)]
        bins: list[list[tuple[float, bool]]] = [[] for _ in range(num_bins)]
        for share, hit in members:
            bins[min(int(share * num_bins), num_bins - 1)].append((share, hit))
        places = [
            at(sum(s for s, _ in inside) / len(inside), sum(h for _, h in inside) / len(inside))
            for inside in bins
            if len(inside) >= least
        ]
        parts += [_line(a, b, colour, 2.0) for a, b in pairwise(places)]
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in places]
        parts.append(_text(WIDTH - RIGHT + 12, TOP + 16 + 20 * number, name, colour=colour))
    return _svg(title, parts)
