"""Clearance along an airway: the largest ball that passes each point of a centreline.

A centreline from voxels is a third of a millimetre off the middle of the lumen, and up to 2 mm at forks, where a ball
round its own point is smaller than the one that passes (docs/decisions/0130). Therefore the ball is moved across the
airway to its best position.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.plan.routes.needle_hits import axes_across
from carina.scopes import WallField
from carina.track import Branch

Points = NDArray[np.float64]

SHIFTS_MM = (0.5, 0.5, 0.5, 0.5, 0.5, 0.25, 0.12, 0.06)
"""Steps in mm of the ball's position while the ball grows, so small that it never passes through a wall.

At a fork the centreline cuts the corner up to 2 mm beside the middle.
"""
NUM_ROUND = 8
HALF_SAMPLE_MM = 0.2
"""Distance in mm at which the wall field is read beside the middle line: half the spacing of its samples.

The distance to the wall has its peak on the middle line of the lumen. A field with samples 0.4 mm apart cuts off some
0.25 mm of this peak, so the distance is measured beside the line.
"""
INWARDS_MM = 0.19
"""Length in mm added to the measured radius, because the nearest wall in eight directions is too near in a round lumen.

Measured on three CTs with known airways (0.55 to 0.9 mm, radii 0.8 to 4 mm): 0.13 to 0.23 mm.
"""
SMOOTH_MM = 1.0
"""Half the length in mm over which the widths along a branch are averaged to reduce noise of the wall."""


def middle_line(branch: Branch, wall: WallField) -> Points:
    """Return for each point of a branch the middle of the largest ball near the point that fits the lumen, (n, 3)."""
    return branch.points.copy() if len(branch.points) < 2 else _middle(branch.points, wall)[0]


def ball_diameters_mm(branch: Branch, wall: WallField | None) -> Points:
    """Return for each point of a branch the diameter of the largest ball near the point that fits the lumen, (n,) mm.

    Parameters
    ----------
    branch
        Branch of the airway tree.
    wall
        Wall field of the lumen. If None, the ball is centred on each point of the centreline. At points outside the
        lumen (a bridge, a drawn branch) the radius of the branch is used.

    Returns
    -------
    numpy.ndarray
        (n,) mm.
    """
    own = 2.0 * branch.wall_distance
    if wall is None or len(branch.points) < 2:
        return own
    points = branch.points
    middle, best, ring = _middle(points, wall)
    # Probe half-way to the wall: towards the nearest wall, distance to the wall plus offset is the radius.
    off = 0.5 * np.maximum(best, 0.0) + HALF_SAMPLE_MM
    tried = middle + off[:, None] * ring
    nearest = (wall.distance_mm(tried.reshape(-1, 3)).reshape(NUM_ROUND, -1) + off).min(axis=0)
    ball = 2.0 * (np.maximum(nearest, best) + INWARDS_MM)
    found = np.where(best > 0.0, np.minimum(ball, 2.0 * branch.radius), own)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    near = np.abs(along[:, None] - along) <= SMOOTH_MM
    smooth: Points = (near @ found) / near.sum(axis=1)
    return smooth


def _middle(points: Points, wall: WallField) -> tuple[Points, Points, Points]:
    """Return the middles of the largest balls near points, their distances to the wall, and directions across the axis.

    Parameters
    ----------
    points
        (n, 3) of a centreline, two or more.
    wall
        Wall field of the lumen.

    Returns
    -------
    tuple
        (n, 3) middles, (n,) distances in mm, and (k, n, 3) unit vectors across the axis.
    """
    ahead = points[-1] - points[0] if len(points) < 3 else np.gradient(points, axis=0)
    ahead = np.broadcast_to(ahead, points.shape)
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    across, up = axes_across(ahead)
    turn = 2.0 * np.pi * np.arange(NUM_ROUND) / NUM_ROUND
    ring = np.cos(turn)[:, None, None] * across + np.sin(turn)[:, None, None] * up
    middle, best = points.copy(), wall.distance_mm(points)
    for shift in SHIFTS_MM:
        tried = middle + shift * ring
        clearance_mm = wall.distance_mm(tried.reshape(-1, 3)).reshape(NUM_ROUND, -1)
        first = clearance_mm.argmax(axis=0)
        rows = np.arange(len(points))
        better = clearance_mm[first, rows] > best
        middle = np.where(better[:, None], tried[first, rows], middle)
        best = np.where(better, clearance_mm[first, rows], best)
    return middle, best, ring
