"""True narrowest diameter of a route through painted airways: that of the largest ball that passes.

Painted lumens are tubes whose unions are rounded (:mod:`carina_bench.paint_tubes`). The wall is sampled as points on
the tubes that no other tube covers. The ball at a point of a centreline is moved perpendicular to the airway to the
position where it is largest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina_bench.paint_tubes import MERGE_SHARE
from carina_bench.track_truth import TrueBranch

__all__ = ["largest_balls_mm", "lumen_wall", "widest_tubes_mm"]

Floats = NDArray[np.float64]

NUM_ROUND, NUM_CAP = 48, 9
"""Number of points around a tube, and number of rings of points on a round end."""
INSIDE_MM = 0.03
"""Depth inside another tube beyond which a point of a tube's surface is not on the wall, mm."""
MERGED_MM = 0.05
"""Depth inside the rounded union of lumens beyond which a point is not on the wall, mm."""
SHIFTS_MM = (0.5, 0.5, 0.5, 0.25, 0.12, 0.06, 0.03, 0.015)
"""Shifts of the ball perpendicular to the airway, in the order in which they are tried, mm."""
TRIES = 3
"""Maximum number of repetitions of each shift; a shift is repeated as long as the ball grows."""
AROUND_MM = 12.0
"""Half side of the box around a point in which wall points limit the ball, mm."""
CONTAINS = 0.9
"""Share of a tube's radius; a point nearer to the tube's axis than this share counts as inside the tube."""
PART = 2000
"""Number of points whose distances are computed in one step; it limits the memory."""


def lumen_wall(branches: Sequence[TrueBranch]) -> Floats:
    """Return points (n, 3) on the wall of painted airways, LPS mm."""
    tubes = [one for one in branches if len(one.points) >= 2]
    low = [(one.points - one.radius_mm[:, None]).min(axis=0) for one in tubes]
    high = [(one.points + one.radius_mm[:, None]).max(axis=0) for one in tubes]
    found = []
    for n, tube in enumerate(tubes):
        wall, outwards = _surface(tube)
        others = [
            k
            for k in range(len(tubes))
            if k != n and not ((low[k] > wall.max(axis=0)).any() or (high[k] < wall.min(axis=0)).any())
        ]
        for k in others:
            near = np.flatnonzero(((wall > low[k]) & (wall < high[k])).all(axis=1))
            covered = near[_outside_mm(tubes[k], wall[near]) < -INSIDE_MM]
            wall, outwards = np.delete(wall, covered, axis=0), np.delete(outwards, covered, axis=0)
        if others and len(wall):
            wall = _merged(wall, outwards, [tubes[k] for k in sorted([n, *others])])
        found.append(wall)
    return np.concatenate(found)


def largest_balls_mm(points: Floats, wall: Floats) -> Floats:
    """Return the diameter (n,) of the largest ball near each point of a centreline, mm."""
    ahead = np.gradient(points, axis=0) if len(points) > 2 else np.broadcast_to(points[-1] - points[0], points.shape)
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    near = wall[((wall > points.min(axis=0) - AROUND_MM) & (wall < points.max(axis=0) + AROUND_MM)).all(axis=1)]
    found = np.full(len(points), np.nan)
    if not len(near):
        return found
    angles = 2.0 * np.pi * np.arange(8) / 8
    for n, (point, forward) in enumerate(zip(points, ahead, strict=True)):
        across, up = _axes_across(forward)
        ring = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * up
        own = near[(np.abs(near - point) < AROUND_MM).all(axis=1)]
        if not len(own):
            continue
        middle, best = point, float(_nearest_mm(own, point[None])[0])
        for shift in SHIFTS_MM:
            for _ in range(TRIES):
                tried = middle + shift * ring
                clearance_mm = _nearest_mm(own, tried)
                first = int(clearance_mm.argmax())
                if clearance_mm[first] <= best:
                    break
                middle, best = tried[first], float(clearance_mm[first])
        found[n] = 2.0 * best
    return found


def widest_tubes_mm(points: Floats, branches: Sequence[TrueBranch]) -> Floats:
    """Return the diameter (n,) of the widest tube that contains each point, mm; NaN for a point outside all tubes."""
    axis = np.concatenate([one.points for one in branches])
    radius = np.concatenate([one.radius_mm for one in branches])
    own = np.concatenate([np.full(len(one.points), n) for n, one in enumerate(branches)])
    found = np.full(len(points), np.nan)
    for n, point in enumerate(points):
        away = np.linalg.norm(axis - point, axis=1)
        inside = np.flatnonzero(away < CONTAINS * radius)
        if len(inside):
            tube = np.flatnonzero(own == own[inside[int(radius[inside].argmax())]])
            found[n] = 2.0 * radius[tube[int(away[tube].argmin())]]
    return found


def _axes_across(forward: Floats) -> tuple[Floats, Floats]:
    """Return two perpendicular unit vectors (..., 3) for each direction (..., 3), both perpendicular to it."""
    helper = np.where(np.abs(forward[..., :1]) < 0.8, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    across = np.cross(forward, helper)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return across, np.cross(forward, across)


def _surface(tube: TrueBranch) -> tuple[Floats, Floats]:
    """Return points (n, 3) of the surface of a tube with round ends, and their outward unit normals."""
    points, radius = tube.points, tube.radius_mm
    ahead = np.gradient(points, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    across, up = _axes_across(ahead)
    angles = 2.0 * np.pi * np.arange(NUM_ROUND) / NUM_ROUND
    ring = np.cos(angles)[None, :, None] * across[:, None] + np.sin(angles)[None, :, None] * up[:, None]
    outwards = [ring.reshape(-1, 3)]
    places = [np.repeat(points, NUM_ROUND, axis=0)]
    sizes = [np.repeat(radius, NUM_ROUND)]
    for end, sign in ((0, -1.0), (-1, 1.0)):
        for rise in np.linspace(0.0, 0.5 * np.pi, NUM_CAP + 1)[1:]:
            outwards.append(np.cos(rise) * ring[end] + sign * np.sin(rise) * ahead[end])
            places.append(np.repeat(points[end][None], NUM_ROUND, axis=0))
            sizes.append(np.full(NUM_ROUND, radius[end]))
    out = np.concatenate(outwards)
    return np.concatenate(places) + np.concatenate(sizes)[:, None] * out, out


def _outside_mm(tube: TrueBranch, points: Floats) -> Floats:
    """Return the distance (n,) of each point from the surface of a tube, mm; negative inside the tube."""
    found = np.empty(len(points))
    for begin in range(0, len(points), PART):
        part = points[begin : begin + PART]
        squared = np.square(part).sum(axis=1)[:, None] + np.square(tube.points).sum(axis=1) - 2.0 * part @ tube.points.T
        found[begin : begin + PART] = (np.sqrt(np.maximum(squared, 0.0)) - tube.radius_mm).min(axis=1)
    return found


def _merged(wall: Floats, outwards: Floats, tubes: Sequence[TrueBranch]) -> Floats:
    """Return the wall with the points near unions of lumens moved outwards to the painter's rounded surface.

    Points that another tube covers are removed.
    """
    moved = wall.copy()
    within = np.flatnonzero(_merged_mm(moved, tubes) < -0.01)
    for _ in range(2):
        moved[within] -= outwards[within] * _merged_mm(moved[within], tubes)[:, None]
    left = within[_merged_mm(moved[within], tubes) < -MERGED_MM]
    return np.delete(moved, left, axis=0)


def _merged_mm(points: Floats, tubes: Sequence[TrueBranch]) -> Floats:
    """Return the distance (n,) of each point from the wall where several lumens join, mm; negative inside.

    The edge of the joint is rounded by the formula with which `carina_bench.paint_tubes` paints it.
    """
    least = np.full(len(points), 50.0)
    for tube in tubes:
        other = _outside_mm(tube, points)
        merge = MERGE_SHARE * float(np.median(tube.radius_mm))
        near = np.maximum(merge - np.abs(least - other), 0.0)
        least = np.minimum(least, other) - near * near * 0.25 / merge
    return least


def _nearest_mm(wall: Floats, points: Floats) -> Floats:
    squared = np.square(points).sum(axis=1)[:, None] + np.square(wall).sum(axis=1) - 2.0 * points @ wall.T
    found: Floats = np.sqrt(np.maximum(squared.min(axis=1), 0.0))
    return found
