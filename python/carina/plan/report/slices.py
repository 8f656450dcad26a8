"""Slices through a target and along its needle, with the outlines to be drawn over them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.png import png_bytes
from carina.plan.report.outline import boundary_in_plane
from carina.plan.routes.last_leg import LastLeg
from carina.plan.targets.grow_nodule import Nodule
from carina.render import CutPlaneView, Picture, Renderer, SliceView, View
from carina.render.picture_text import letters_of
from carina.scopes import Pose
from carina.track import LumenOutline
from carina.volume.anatomical_planes import Plane

Points = NDArray[np.float64]
Line = tuple[tuple[float, float], ...]

LUNG_HU = (1500.0, -600.0)
"""Width and level of the lung window, HU."""
WIDTH_PX = 440
MIN_MM, ROOM_MM = 70.0, 50.0
"""Minimum width of a slice in mm, and minimum excess in mm of the width over the length of the target."""
PROOF_MM = 44.0
THICK_MM = 1.5
"""Maximum distance in mm of a line from a slice at which the line is drawn as in the plane of the slice."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class SlicePicture:
    """Picture of a slice with the lines drawn over it; positions are columns and rows in corner coordinates."""

    title: str
    """Name of the plane if it is along the patient's axes, else empty."""
    png: bytes = field(repr=False)
    width_px: int
    height_px: int
    mm_per_px: float
    letters: tuple[str, str, str, str]
    """Orientation letters at the left, right, upper and lower edge of the slice."""
    target: tuple[Line, ...]
    """Lines in which the plane of the slice cuts the target."""
    lumen: tuple[Line, ...]
    """Lines in which the plane of the slice cuts airways."""
    needle: tuple[tuple[Line, bool], ...]
    """Pieces of the last leg from tip to aim, each with whether it is in the slice's plane.

    Other pieces are projected.
    """
    tip: tuple[float, float] | None
    cross: tuple[float, float] | None = None
    """Position of a marker in the slice; None for no marker."""


@dataclass(frozen=True, slots=True, eq=False)
class _Over:
    """Structures (target, needle, lumen) whose lines are drawn over each slice."""

    nodule: Nodule
    leg: LastLeg | None
    lumen: LumenOutline


def target_slices(
    renderer: Renderer, nodule: Nodule, leg: LastLeg | None, lumen: LumenOutline
) -> tuple[SlicePicture, ...]:
    """Return axial, coronal and sagittal slices through the middle of a target, at one scale.

    Parameters
    ----------
    renderer
        Renderer of the CT.
    nodule, leg, lumen
        Target, needle path (None without a route) and outline of the airways.
    """
    centre = np.array(nodule.centre_lps)
    extent = max(MIN_MM, nodule.long_mm + ROOM_MM)
    if leg is not None:
        extent = max(extent, 2.4 * float(np.abs(np.array(leg.tip_lps) - centre).max()))
    over = _Over(nodule, leg, lumen)
    return tuple(_slice(renderer, plane, nodule.centre_lps, extent, over) for plane in get_args(Plane))


def place_slices(
    renderer: Renderer, place_lps: tuple[float, float, float], nodule: Nodule, lumen: LumenOutline
) -> tuple[SlicePicture, ...]:
    """Return three close-up slices through a place, without a needle and with a marker.

    Parameters
    ----------
    renderer
        Renderer of the CT.
    place_lps
        (3,) LPS mm.
    nodule, lumen
        Target, and outline of the airways.
    """
    over = _Over(nodule, None, lumen)
    return tuple(_slice(renderer, plane, place_lps, PROOF_MM, over, cross_lps=place_lps) for plane in get_args(Plane))


def needle_slice(
    renderer: Renderer, nodule: Nodule, leg: LastLeg, forward: Sequence[float], lumen: LumenOutline
) -> SlicePicture:
    """Return the slice through the needle and, if possible, the airway's axis; the needle points to the right.

    Parameters
    ----------
    renderer
        Renderer of the CT.
    nodule, leg, lumen
        Target, needle path and outline of the airways.
    forward
        (3,) direction of the airway at the tip, LPS.
    """
    tip, aim = np.array(leg.tip_lps), np.array(leg.aim_lps)
    way = aim - tip
    length = float(np.linalg.norm(way))
    axis = np.asarray(forward, dtype=np.float64)
    right = way / length if length > 1e-6 else axis / float(np.linalg.norm(axis))
    beside = axis - (axis @ right) * right
    if np.linalg.norm(beside) < 0.05:
        # A needle along the airway's axis defines no plane with the axis, so any plane through the needle is used.
        beside = np.cross(right, np.eye(3)[int(np.argmin(np.abs(right)))])
    # With this downward direction the airway enters the picture from the upper left.
    down = beside / float(np.linalg.norm(beside))
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, down, np.cross(right, down)], axis=1)
    matrix[:3, 3] = 0.5 * (tip + aim)
    extent = max(44.0, 1.6 * length + nodule.long_mm)
    height = round(0.62 * WIDTH_PX)
    view = CutPlaneView(Pose(matrix), extent_mm=extent, width=WIDTH_PX, height=height, window_hu=LUNG_HU)
    return _picture(renderer, view, "", _Over(nodule, leg, lumen))


def _slice(
    renderer: Renderer,
    plane: Plane,
    centre: tuple[float, float, float],
    extent_mm: float,
    over: _Over,
    *,
    cross_lps: tuple[float, float, float] | None = None,
) -> SlicePicture:
    view = SliceView(plane, centre, mm_per_px=extent_mm / WIDTH_PX, width=WIDTH_PX, height=WIDTH_PX, window_hu=LUNG_HU)
    return _picture(renderer, view, plane.capitalize(), over, cross_lps=cross_lps)


def _picture(
    renderer: Renderer,
    view: View,
    title: str,
    over: _Over,
    *,
    cross_lps: tuple[float, float, float] | None = None,
) -> SlicePicture:
    shown = renderer.render(view)
    matrix = shown.lps_from_pixel
    assert matrix is not None
    height, width = shown.rgb.shape[:2]
    lines = over.lumen.lines(matrix, width, height) or ()
    right, down = matrix[:3, 0], matrix[:3, 1]
    needle, tip = ((), None) if over.leg is None else _needle(shown, over.leg)
    return SlicePicture(
        title=title,
        png=png_bytes(np.ascontiguousarray(shown.rgb)),
        width_px=width,
        height_px=height,
        mm_per_px=float(np.linalg.norm(right)),
        letters=(letters_of(-right), letters_of(right), letters_of(-down), letters_of(down)),
        target=tuple(_line(one) for one in boundary_in_plane(over.nodule, matrix, width, height)),
        lumen=tuple(_line(one) for one in lines),
        needle=needle,
        tip=tip,
        cross=None if cross_lps is None else shown.pixel_of(cross_lps),
    )


def _needle(shown: Picture, leg: LastLeg) -> tuple[tuple[tuple[Line, bool], ...], tuple[float, float]]:
    """Return the pieces of the last leg, each with whether it is in a slice's plane, and the tip's position."""
    assert shown.lps_from_pixel is not None
    tip, aim = np.array(leg.tip_lps), np.array(leg.aim_lps)
    normal = np.cross(shown.lps_from_pixel[:3, 0], shown.lps_from_pixel[:3, 1])
    normal /= np.linalg.norm(normal)
    num = max(math.ceil(float(np.linalg.norm(aim - tip)) / 0.25), 1) + 1
    points = tip + np.linspace(0.0, 1.0, num)[:, None] * (aim - tip)
    is_near = np.abs((points - shown.lps_from_pixel[:3, 3]) @ normal) <= THICK_MM
    pixels = [shown.pixel_of(point) or (0.0, 0.0) for point in points]
    pieces: list[tuple[Line, bool]] = []
    start = 0
    for n in range(1, num):
        if n == num - 1 or is_near[n] != is_near[start]:
            pieces.append(((pixels[start], pixels[n]), bool(is_near[start])))
            start = n
    return tuple(pieces), pixels[0]


def _line(points: Points) -> Line:
    return tuple((float(x), float(y)) for x, y in points)
