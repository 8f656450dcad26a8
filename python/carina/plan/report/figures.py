"""Drawings of a report: slices with outlines, the needle path as a bar, and the airway tree from two sides."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.plan.instruments.tools import Tool
from carina.plan.report.colours import ACCENT, INK, LEG, ON_CT, PALE, QUIET, TREE, WARNING
from carina.plan.report.drawing import Disc, Drawing, Label, LineStyle, Place, Raster, Shape, Stroke
from carina.plan.report.plan_sheet import Fork
from carina.plan.report.slices import SlicePicture
from carina.plan.report.tree_shape import TreeShape
from carina.plan.report.wording import text_width
from carina.plan.routes.last_leg import CrossedTissue, LastLeg, Tissue

Points = NDArray[np.float64]
FILLS: dict[Tissue, str] = {
    "lumen": "#ffffff",
    "airway wall": "#8b949c",
    "lung": "#e6ebef",
    "fissure": "#00796b",
    "vessel": "#7b1fa2",
    "target": LEG,
    "mediastinum or chest wall": "#6d4c41",
    "not examined": "#ffffff",
}
SIDES = {
    "front": (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]), ("R", "L")),
    "left": (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0]), ("A", "P")),
}
"""Right and down directions (LPS) of each view, and its letters.

In the front view the patient's right is on the left; in the view from the patient's left, anterior is on the left.
"""


SMALL, FORK_DISC = 8.6, 6.2
"""Font size of fork numbers and of the scale of a tree, and radius of the disc behind a number, in points on paper."""


def slice_drawing(one: SlicePicture) -> Drawing:
    """Return a slice with the outlines of target, airways and needle, orientation letters and a scale."""
    width, height = float(one.width_px), float(one.height_px)
    shapes: list[Shape] = [Raster((0.0, 0.0), (width, height), one.png)]
    shapes += [Stroke(line, LineStyle(ON_CT["lumen"], 1.4)) for line in one.lumen]
    shapes += [Stroke(line, LineStyle(ON_CT["target"], 2.2), closed=True) for line in one.target]
    for piece, lies_in in one.needle:
        shapes.append(Stroke(piece, LineStyle(ON_CT["leg"], 3.0, dash=None if lies_in else (2.0, 6.0))))
    if one.tip is not None:
        shapes.append(Disc(one.tip, 4.5, LineStyle("#000000", 1.2, fill=ON_CT["leg"])))
    if one.cross is not None:
        x, y = one.cross
        for a, b in (((-16, 0), (-7, 0)), ((7, 0), (16, 0)), ((0, -16), (0, -7)), ((0, 7), (0, 16))):
            shapes.append(Stroke(((x + a[0], y + a[1]), (x + b[0], y + b[1])), LineStyle(ON_CT["leg"], 2.2)))
    left, right, upper, lower = one.letters
    shapes += [
        _on_ct((9.0, height / 2 + 7), left, "start"),
        _on_ct((width - 9, height / 2 + 7), right, "end"),
        _on_ct((width / 2, 24.0), upper, "middle"),
        _on_ct((width / 2, height - 10), lower, "middle"),
        _on_ct((9.0, 24.0), one.title, "start"),
    ]
    bar_px = 10.0 / one.mm_per_px
    end = width - 14.0
    shapes.append(Stroke(((end - bar_px, height - 14), (end, height - 14)), LineStyle("#000000", 6.0)))
    shapes.append(Stroke(((end - bar_px, height - 14), (end, height - 14)), LineStyle(ON_CT["text"], 3.0)))
    shapes.append(_on_ct((end, height - 24), "10 mm", "end"))
    says = f"{one.title} slice, {left} on the left, {right} on the right"
    return Drawing(width, height, (*shapes, _frame(width, height)), says)


def _on_ct(at: Place, text: str, anchor: str) -> Label:
    side = {"start": "start", "end": "end"}.get(anchor, "middle")
    return Label(at, text, 19.0, ON_CT["text"], side, bold=True, halo=ON_CT["halo"])  # type: ignore[arg-type]


def _frame(width: float, height: float) -> Stroke:
    return Stroke(((0, 0), (width, 0), (width, height), (0, height)), LineStyle("#000000", 1.0), closed=True)


def needle_bar(leg: LastLeg, tool: Tool, *, width: float = 520.0) -> Drawing:
    """Return the tissues on the needle path as a bar in mm from the scope's tip, with the reach of the needle.

    Parameters
    ----------
    leg, tool
        Needle path and its tool.
    width
        Width of the drawing.
    """
    total = max(leg.crossed[-1].end_mm, tool.reach_mm) if leg.crossed else tool.reach_mm
    scale = (width - 20.0) / total
    rows = _label_rows(leg.crossed, scale, width)
    top = 14.0 * (max(rows, default=0) + 1) + 6.0
    bar, left = 22.0, 10.0
    shapes: list[Shape] = []
    for one, row in zip(leg.crossed, rows, strict=True):
        x0, x1 = left + one.start_mm * scale, left + one.end_mm * scale
        dash = (3.0, 2.0) if one.tissue == "not examined" else None
        box = ((x0, top), (x1, top), (x1, top + bar), (x0, top + bar))
        shapes.append(Stroke(box, LineStyle(INK, 0.7, fill=FILLS[one.tissue], dash=dash), closed=True))
        base = top - 6.0 - 14.0 * row
        middle = x0 + 0.5 * (x1 - x0)
        if row > 0:
            shapes.append(Stroke(((middle, top), (middle, base + 2.0)), LineStyle(QUIET, 0.5)))
        shapes.append(_bar_label(one, middle, base, left, width))
    reach = left + tool.reach_mm * scale
    shapes.append(Stroke(((reach, top - 3), (reach, top + bar + 3)), LineStyle(ACCENT, 1.8)))
    words = f"the needle reaches {tool.reach_mm:g} mm"
    half = 0.5 * text_width(words, 8.0)
    shapes.append(Label((min(reach, width - half), top + bar + 26), words, 8.0, ACCENT, "middle"))
    step = 5 if total <= 50 else 10
    for mm in range(0, int(total) + 1, step):
        x = left + mm * scale
        shapes.append(Stroke(((x, top + bar), (x, top + bar + 4)), LineStyle(INK, 0.7)))
        shapes.append(Label((x, top + bar + 13), f"{mm}", 8.0, QUIET, "middle"))
    text = ", ".join(f"{one.tissue} {one.length_mm:.1f} mm" for one in leg.crossed)
    return Drawing(width, top + bar + 31.0, tuple(shapes), f"Needle path from the tip: {text}")


def _bar_label(one: CrossedTissue, middle: float, base: float, left: float, width: float) -> Label:
    text = _bar_words(one)
    half = 0.5 * text_width(text, 8.5)
    at = min(max(middle, left + half), width - half)
    colour = INK if one.tissue in {"lumen", "lung", "not examined", "airway wall"} else FILLS[one.tissue]
    return Label((at, base), text, 8.5, colour, "middle", bold=one.tissue in {"target", "vessel"})


def _bar_words(one: CrossedTissue) -> str:
    return f"{one.tissue} {one.length_mm:.1f}"


def _label_rows(crossed: Sequence[CrossedTissue], scale: float, width: float) -> list[int]:
    """Return for each label of a needle bar the row above the bar, so that labels do not overlap."""
    ends: list[float] = []
    rows = []
    for one in crossed:
        half = 0.5 * text_width(_bar_words(one), 8.5)
        middle = 10.0 + (one.start_mm + 0.5 * one.length_mm) * scale
        start = min(max(middle - half, 10.0), width - 2.0 * half)
        row = next((n for n, end in enumerate(ends) if end + 5.0 <= start), len(ends))
        if row == len(ends):
            ends.append(0.0)
        ends[row] = start + 2.0 * half
        # Lower rows are filled first, so that no line to a higher label crosses a lower label.
        rows.append(row)
    return rows


def tree_drawing(shape: TreeShape, forks: Sequence[Fork], side: str, *, width: float, height: float) -> Drawing:
    """Return a drawing of the airway tree from the front or the patient's left, with route, forks and target.

    Parameters
    ----------
    shape, forks
        Shape of the tree with the route, and the numbered forks of the route.
    side
        ``front`` or ``left``.
    width, height
        Size of the drawing.
    """
    right, down, (left_letter, right_letter) = SIDES[side]
    everything = np.concatenate([*(one.points_lps for one in shape.branches), shape.vertices_lps])
    flat = np.stack([everything @ right, everything @ down], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    margin = 16.0
    scale = float(min((width - 2 * margin) / (high[0] - low[0]), (height - 2 * margin) / (high[1] - low[1])))
    shift = 0.5 * (np.array([width, height]) - scale * (low + high))

    def placed(points: Points) -> tuple[Place, ...]:
        at = np.stack([points @ right, points @ down], axis=1) * scale + shift
        return tuple((float(x), float(y)) for x, y in at)

    shapes: list[Shape] = []
    inwards = np.cross(right, down)
    by_depth = sorted(shape.branches, key=lambda one: -float((one.points_lps @ inwards).mean()))
    for one in by_depth:
        wide = max(2.0 * float(np.median(one.radius_mm)) * scale, 0.8)
        pen = LineStyle(TREE, wide) if one.is_found else LineStyle(WARNING, wide, dash=(3.0, 2.0))
        shapes.append(Stroke(placed(one.points_lps), pen))
    if len(shape.route_lps):
        shapes.append(Stroke(placed(shape.route_lps), LineStyle(ACCENT, 2.4)))
    for one in shape.branches:
        if one.on_route and not one.is_found:
            shapes.append(Stroke(placed(one.points_lps), LineStyle("#ffffff", 3.0)))
            shapes.append(Stroke(placed(one.points_lps), LineStyle(WARNING, 2.4, dash=(4.0, 3.5))))
    if len(shape.vertices_lps):
        shapes.append(
            Stroke(_hull(placed(shape.vertices_lps)), LineStyle(LEG, 1.0, fill=LEG, opacity=0.55), closed=True)
        )
    if len(shape.needle_lps):
        shapes.append(Stroke(placed(shape.needle_lps), LineStyle(LEG, 2.0)))
    taken: list[Place] = []
    for fork in forks:
        (at,) = placed(np.array([fork.place_lps]))
        # A fork hidden by another one has no number here; the list of turns contains it.
        if any(math.dist(at, other) < 2.0 * FORK_DISC for other in taken):
            continue
        taken.append(at)
        shapes.append(Disc(at, FORK_DISC, LineStyle(ACCENT, 0.9, fill="#ffffff")))
        shapes.append(Label((at[0], at[1] + 3.1), str(fork.number), SMALL, ACCENT, "middle", bold=True))
    shapes += [
        Label((3.0, height / 2), left_letter, 11.0, INK, "start", bold=True),
        Label((width - 3.0, height / 2), right_letter, 11.0, INK, "end", bold=True),
    ]
    says = f"Airway tree from the {'front' if side == 'front' else 'patient left side'}, {left_letter} on the left"
    return Drawing(width, height, (*shapes, *_scale_bar(scale, width, height)), says)


def _scale_bar(scale: float, width: float, height: float) -> tuple[Shape, ...]:
    end, base = width - 8.0, height - 5.0
    return (
        Stroke(((end - 20.0 * scale, base), (end, base)), LineStyle(INK, 1.2)),
        Label((end, base - 4.0), "20 mm", SMALL, QUIET, "end"),
        Stroke(((0.0, 0.0), (width, 0.0), (width, height), (0.0, height)), LineStyle(PALE, 0.6), closed=True),
    )


def _hull(places: Sequence[Place]) -> tuple[Place, ...]:
    """Return the convex hull of positions in a drawing, in order (Andrew's monotone chain)."""
    ordered = sorted(set(places))
    if len(ordered) < 3:
        return tuple(ordered)

    def half(row: Sequence[Place]) -> list[Place]:
        hull: list[Place] = []
        for x, y in row:
            while len(hull) > 1 and _turn(hull[-2], hull[-1], (x, y)) <= 0.0:
                hull.pop()
            hull.append((x, y))
        return hull[:-1]

    return tuple(half(ordered) + half(ordered[::-1]))


def _turn(a: Place, b: Place, c: Place) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
