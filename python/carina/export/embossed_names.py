"""Names of branches as raised dots on the outer surface of a printed airway wall."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carina.display.dot_letters import text_dots
from carina.scopes import WallField
from carina.track import Airways, Branch

Points = NDArray[np.float64]

DOT_MM, DOT_PITCH_MM = 0.55, 0.75
"""Radius of the embossed dots of branch names, and distance between dots, mm."""


def name_dots(
    airways: Airways, wall: WallField, wall_mm: float, *, branches: frozenset[int] | None = None
) -> tuple[Points, tuple[str, ...], tuple[str, ...]]:
    """Return the dots (n, 3) of all names that fit, the names, and the names that do not fit.

    Parameters
    ----------
    airways
        Airways with named branches.
    wall
        Distance to the printed lumen.
    wall_mm
        Thickness of the wall.
    branches
        IDs of the branches whose names are written; None for all.
    """
    found: list[Points] = []
    written: list[str] = []
    left_out: list[str] = []
    for branch in airways.tree.branches:
        if branch.name is None or branch.name in written or (branches is not None and branch.id not in branches):
            continue
        dots = _dots_on(branch, wall, wall_mm)
        if dots is None:
            left_out.append(branch.name)
        else:
            found.append(dots)
            written.append(branch.name)
    every = np.concatenate(found) if found else np.empty((0, 3))
    return every, tuple(written), tuple(dict.fromkeys(one for one in left_out if one not in written))


def _dots_on(branch: Branch, wall: WallField, wall_mm: float) -> Points | None:
    """Return the dots of a branch's name on its outer surface, (n, 3) LPS mm; None if the name does not fit."""
    dots = text_dots(str(branch.name))
    rows, columns = np.nonzero(dots)
    length = dots.shape[1] * DOT_PITCH_MM
    steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    middle_mm = 0.5 * float(along[-1])
    outer = float(np.median(branch.radius)) + wall_mm
    # A name may be as high as the outer diameter, because a reader sees only one side of the airway.
    if length > along[-1] - 2.0 or dots.shape[0] * DOT_PITCH_MM > 2.0 * outer:
        return None
    at = middle_mm - 0.5 * length + (columns + 0.5) * DOT_PITCH_MM
    line = np.stack([np.interp(at, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    ahead = np.stack([np.interp(at + 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    behind = np.stack([np.interp(at - 1.0, along, branch.points[:, axis]) for axis in range(3)], axis=1)
    tangent = ahead - behind
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    for turn in range(12):
        # The front is tried first, because a person usually looks at the model from the front.
        side = np.array([math.sin(turn * math.pi / 6.0), -math.cos(turn * math.pi / 6.0), 0.0])
        out = side - (tangent @ side)[:, None] * tangent
        lengths = np.linalg.norm(out, axis=1, keepdims=True)
        if lengths.min() < 0.3:
            continue
        out /= lengths
        up = np.cross(out, tangent)
        angle = (rows - 0.5 * (dots.shape[0] - 1)) * DOT_PITCH_MM / outer
        ray = np.cos(angle)[:, None] * out + np.sin(angle)[:, None] * up
        placed = _outer_points(line, ray, wall, wall_mm, outer)
        if placed is not None:
            return placed
    return None


def _outer_points(line: Points, ray: Points, wall: WallField, wall_mm: float, outer_mm: float) -> Points | None:
    """Return the points at which rays from a centreline leave the wall; None if a ray leaves it at another distance."""
    reach = np.arange(0.0, outer_mm + 3.0, 0.1)
    points = line[:, None] + reach[None, :, None] * ray[:, None]
    away = wall.distance_mm(points.reshape(-1, 3)).reshape(len(line), len(reach))
    beyond = away < -wall_mm
    if not beyond.any(axis=1).all():
        return None
    first = np.argmax(beyond, axis=1)
    places = reach[first]
    if np.abs(places - np.median(places)).max() > 1.5:
        return None
    # The space outside the wall must be free, because the letters would merge with a neighbouring wall.
    free = wall.distance_mm(line + (places + 1.0)[:, None] * ray)
    if (free > -min(2.45, wall_mm + 0.2)).any():
        return None
    found: Points = line + places[:, None] * ray
    return found
