"""Geometry and pictures of the views along a path (Kanitsar et al., IEEE Visualization 2002)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.render.views import PathView, Picture, PictureLines, RenderStats
from carina.volume import Volume

Points = NDArray[np.float64]

HALF_WIDTH_MM = 40.0
"""Half the width of a straightened airway, mm: farther out, the planes of a bend would intersect."""
# Margin in mm that a curved reformation shows beyond each end of a completely shown path.
END_MM = 8.0


def cast_path_view(volume: Volume, view: PathView, *, rows: tuple[int, int] | None = None) -> Picture:
    """Return the picture of a straightened airway or a curved reformation.

    Its ``lines`` cover all rows, also for a strip.
    """
    lines, through = _straightened_lines(view) if view.kind == "straightened" else _curved_lines(view)
    table = np.hstack([lines.start_lps, lines.step_lps, through])
    table = np.ascontiguousarray(table if rows is None else table[slice(*rows)])
    grey, _ = _core.sample_lines(
        volume.hu_zyx,
        volume.lps_from_ijk,
        table,
        width=view.width,
        window_hu=view.window_hu,
        slab=None if view.slab is None else (view.slab.thickness_mm, view.slab.kind),
    )
    if view.kind == "straightened":
        across_mm = np.abs(np.arange(view.width) + 0.5 - view.width / 2) * lines.mm_per_px
        grey[:, across_mm > HALF_WIDTH_MM] = 0
    stats = RenderStats("lines", view.width, grey.shape[0], *(grey.size,) * 2, 0, 0, 0, 0, 0, 0.0)
    return Picture(rgb=np.repeat(grey[:, :, None], 3, axis=2), view=view.kind, stats=stats, lines=lines)


def _straightened_lines(view: PathView) -> tuple[PictureLines, Points]:
    path = view.path
    mm_per_px = view.mm_per_px or (path.length_mm + 2 * END_MM) / view.height
    centre_mm = view.centre_mm if view.mm_per_px else float(path.path_mm[0] + path.path_mm[-1]) / 2
    rows_mm = np.asarray(centre_mm + (np.arange(view.height) + 0.5 - view.height / 2) * mm_per_px, dtype=np.float64)
    points, axes = path.at(rows_mm)
    turn = np.deg2rad(view.turn_deg)
    # At 0 degrees the left side of the picture shows the patient's right, as in a coronal slice; at 90 degrees the
    # sides are those of a sagittal slice. The direction is therefore mirrored relative to a camera that looks down the
    # airway with anterior up.
    across = np.sin(turn) * axes[:, :, 1] - np.cos(turn) * axes[:, :, 0]
    through = np.cos(turn) * axes[:, :, 1] + np.sin(turn) * axes[:, :, 0]
    step = across * mm_per_px
    beyond = (rows_mm < path.path_mm[0]) | (rows_mm > path.path_mm[-1])
    lines = PictureLines(
        start_lps=points - step * (view.width / 2),
        step_lps=step,
        path_mm=np.where(beyond, np.nan, rows_mm),
        path_column=np.full(view.height, view.width / 2),
        mm_per_px=mm_per_px,
    )
    return lines, through


def _curved_lines(view: PathView) -> tuple[PictureLines, Points]:
    path = view.path
    turn = np.deg2rad(view.turn_deg)
    across = np.array([np.cos(turn), np.sin(turn), 0.0])
    points = path.points_lps
    steps = np.diff(points, axis=0)
    steps -= (steps @ across)[:, None] * across
    # Length of the unrolled surface. It does not grow where the path runs along the sweeping line; the small increment
    # keeps rows and positions in the same order.
    unrolled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    unrolled += 1e-6 * (path.path_mm - path.path_mm[0])
    sideways = points @ across
    if view.mm_per_px:
        mm_per_px = view.mm_per_px
        middle = float(np.interp(view.centre_mm, path.path_mm, unrolled))
        centre = float(np.interp(view.centre_mm, path.path_mm, sideways))
    else:
        down_mm, across_mm = float(unrolled[-1]) + 2 * END_MM, float(np.ptp(sideways)) + 2 * END_MM
        mm_per_px = max(down_mm / view.height, across_mm / view.width)
        middle, centre = float(unrolled[-1]) / 2, float(sideways.min() + sideways.max()) / 2
    rows = middle + (np.arange(view.height) + 0.5 - view.height / 2) * mm_per_px
    inside = np.clip(rows, 0.0, unrolled[-1])
    at = np.stack([np.interp(inside, unrolled, points[:, axis]) for axis in range(3)], axis=1)
    # Beyond an end the surface continues at a right angle to the sweeping line.
    ways = [_first_nonzero_direction(steps, forward=forward) for forward in (True, False)]
    at += np.clip(rows, None, 0.0)[:, None] * ways[0] + (rows - np.clip(rows, None, unrolled[-1]))[:, None] * ways[1]
    here = at @ across
    step = np.broadcast_to(across * mm_per_px, (view.height, 3)).copy()
    start = at + (centre - here)[:, None] * across - step * (view.width / 2)
    down = np.gradient(at - here[:, None] * across, axis=0)
    through = np.cross(across, down)
    length = np.linalg.norm(through, axis=1)[:, None]
    through = np.where(length > 1e-9, through / np.maximum(length, 1e-9), np.cross(across, ways[0]))
    lines = PictureLines(
        start_lps=start,
        step_lps=step,
        path_mm=np.where(rows == inside, np.interp(inside, unrolled, path.path_mm), np.nan),
        path_column=(here - centre) / mm_per_px + view.width / 2,
        mm_per_px=mm_per_px,
    )
    return lines, through


def _first_nonzero_direction(steps: Points, *, forward: bool) -> Points:
    """Return the direction (3,) of the first (last) step of non-zero length; caudal if all steps have length 0."""
    for step in steps if forward else steps[::-1]:
        length = float(np.linalg.norm(step))
        if length > 1e-9:
            return np.asarray(step / length)
    return np.array([0.0, 0.0, -1.0])
