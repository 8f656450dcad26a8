"""Set of the three maximum intensity projections side by side (paper 3.1, Figure 2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, instance, lps_point, whole_from
from carina.display import one_line
from carina.render import geometry
from carina.render.picture_text import letter_edges
from carina.render.pictures import mark_tip
from carina.render.renderer import Renderer
from carina.render.view_table import VIEWS
from carina.render.views import Picture, XrayView
from carina.volume import Note, Volume
from carina.volume.anatomical_planes import PLANES, Plane

_PREFIX = "xray-"
XRAY_AXES = tuple(cast(Plane, name.removeprefix(_PREFIX)) for name in VIEWS if name.startswith(_PREFIX))
"""Projections of the set, from left to right: from the front, from the patient's left, from the feet."""
_GAP = 4


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class XraySet:
    """Three X-rays of a volume in one scale, side by side."""

    picture: Picture
    """The whole set; a row of square pictures without geometry."""
    parts: tuple[Picture, ...]
    """The X-rays with their geometry, in the order of :data:`XRAY_AXES`, before they are centred in their squares."""
    mm_per_px: float

    def save(self, path: str | Path, *, badges: Sequence[Note] = ()) -> Path:
        """Write the set as PNG and return the path; see :meth:`carina.render.Picture.save`."""
        return self.picture.save(path, badges=badges)


@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    tip_lps=lps_point(optional=True),
    size=whole_from(32, 2048),
)
def render_xray_set(
    volume: Volume,
    *,
    tip_lps: NDArray[np.float64] | tuple[float, float, float] | None = None,
    size: int = 256,
    window_hu: tuple[float, float] | None = None,
) -> XraySet:
    """Render the X-rays from the front, the left and the feet in one scale, side by side.

    Parameters
    ----------
    volume
        The scan.
    tip_lps
        Position of the tip in mm (LPS), which is marked in all three; None marks nothing.
    size
        Width and height of each X-ray in pixels; the longest side of the scan fills it.
    window_hu
        Width and level in HU; None fits the window to each X-ray.

    Returns
    -------
    XraySet
        The set, with letters of the patient's directions at the edges.
    """
    axes = dict(zip("xyz", geometry.grid_axes(volume), strict=True))
    shape_ijk = volume.shape_zyx[::-1]
    extent_mm = {letter: shape_ijk[axis] * volume.spacing_mm[axis] for letter, (axis, _) in axes.items()}
    mm_per_px = max(extent_mm.values()) / size
    renderer = Renderer(volume)
    parts, squares = [], []
    for axis in XRAY_AXES:
        display = PLANES[axis]
        width, height = (
            min(size, max(1, math.ceil(extent_mm[letters[-1]] / mm_per_px - 1e-6)))
            for letters in (display.right, display.down)
        )
        part = renderer.render(XrayView(axis, width, height, window_hu))
        parts.append(part)
        drawn = letter_edges(part if tip_lps is None else mark_tip(part, np.asarray(tip_lps, dtype=np.float64)))
        square = np.zeros((size, size, 3), np.uint8)
        top, left = (size - height) // 2, (size - width) // 2
        square[top : top + height, left : left + width] = drawn.rgb
        squares += [square, np.zeros((size, _GAP, 3), np.uint8)]
    rgb = np.concatenate(squares[:-1], axis=1)
    whole = Picture(rgb=rgb, view="xray-set", stats=parts[0].stats)
    return XraySet(whole, tuple(parts), mm_per_px)
