"""Relaxation of a path that was found with the cost ``walls``, to a shorter and smoother path in the same vessel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.find.result import Airways
from carina.track.paths.tracker import STEP_MM, as_point
from carina.track.targets.results import WallCrossing
from carina.volume.model import Volume

Points = NDArray[np.float64]
Mask = NDArray[np.bool_]

REACH_MM = 12.0
"""Maximum radius in mm of the tube for relaxation at points where no lumen is known."""
RAY_STEP_MM = 0.5
"""Distance in mm between the samples of a ray, whose values are compared with the path's to find the tube's radius."""
NUM_RAYS = 32
"""Number of rays from each node along which the end of the medium (the material of the path, such as air) is
searched."""
MEDIUM_NODES = 5
"""Number of nodes before and after a node whose values define the medium (air or contrast agent) of the path."""
NOISE_FACTOR = 4.0
"""Minimum difference between a ray's value and the medium at which the medium ends, as a multiple of the noise."""
RISE_SHARE = 0.3
"""Minimum difference at which the medium ends, as a share of the largest difference on a ray (median of all rays)."""
LUMEN_SHARE = 0.85
"""Radius of the tube in a known lumen, relative to the distance to the wall."""
BESIDE_LUMEN_MM = 4.0
"""Minimum radius of the tube outside a known lumen, mm; the tube excludes lumen that the search did not enter."""
MAX_ROUNDS = 200
"""Maximum number of rounds in which each point is moved to the middle of its neighbours."""
ROUNDS_PER_CHECK = 10
SETTLED_SHARE = 1e-4
"""Relative decrease of the length in `ROUNDS_PER_CHECK` rounds at which the relaxation ends."""
CHECKED_SHARES = (0.25, 0.5, 0.75, 1.0)
"""Positions between a neighbour and the moved point at which the tube is checked, as shares of their distance."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchTube:
    """Set of voxels to which the relaxation of a path is confined, in the box around the path."""

    mask_zyx: Mask
    """Voxels (nz, ny, nx) of the tube."""
    ijk_from_lps: NDArray[np.float64]
    """Affine matrix (4, 4) from LPS in mm to the voxels of ``mask_zyx``."""

    def inside(self, points_lps: Points) -> Mask:
        """Return (n,) whether the voxel of each (n, 3) point, LPS in mm, belongs to the tube."""
        ijk = np.rint(points_lps @ self.ijk_from_lps[:3, :3].T + self.ijk_from_lps[:3, 3]).astype(np.intp)
        within: Mask = np.all((ijk >= 0) & (ijk < np.array(self.mask_zyx.shape[::-1])), axis=1)
        i, j, k = np.where(within[:, None], ijk, 0).T
        found: Mask = within & self.mask_zyx[k, j, i]
        return found


def relaxed_path(
    volume: Volume, airways: Airways | None, nodes_lps: Points, *, may_leave: Mask | None = None
) -> Points:
    """Return a shorter and smoother path with the same ends in the tube around the path of a search.

    Parameters
    ----------
    volume
        The CT.
    airways
        Airways whose lumen bounds the tube where the search was in it; None if there are none.
    nodes_lps
        Points (n, 3) of the path of the search, LPS in mm.
    may_leave
        Whether the path may leave the lumen at each of these points (n,); by default where they are outside it.

    Returns
    -------
    ndarray
        Points about 1 mm apart, LPS in mm. The path is not longer than that of the search, and
        leaves the lumen only where the search left it.
    """
    points = evenly_spaced(nodes_lps, STEP_MM)
    if len(points) < 3:
        return points
    tube = tube_around(volume, airways, nodes_lps, may_leave=may_leave)
    relaxed = relaxed_in_tube(_in_tube(points, nodes_lps, tube), tube)
    resampled = _in_tube(evenly_spaced(relaxed, STEP_MM), relaxed, tube)
    is_new = np.append(True, (resampled[1:] != resampled[:-1]).any(axis=1))
    distinct: Points = resampled[is_new]
    return distinct


def _in_tube(points: Points, vertices: Points, tube: SearchTube) -> Points:
    """Replace evenly spaced points of a polyline that are outside the tube by the nearest vertex along it.

    Between two vertices in the tube a segment may touch the corner of another voxel.
    """
    outside = np.flatnonzero(~tube.inside(points))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vertices, axis=0), axis=1))])
    places = np.linspace(0.0, along[-1], len(points))[outside]
    points[outside] = vertices[np.abs(along[None, :] - places[:, None]).argmin(axis=1)]
    return points


def relaxed_in_tube(points: Points, tube: SearchTube) -> Points:
    """Move each inner point repeatedly to the middle of its neighbours where the path then remains in the tube.

    No move makes the path longer.
    """
    points = points.copy()
    before = _length_mm(points)
    for number in range(1, MAX_ROUNDS + 1):
        # The neighbours of every second point do not move while that point moves.
        for first in (1, 2):
            inner = np.arange(first, len(points) - 1, 2)
            if not len(inner):
                continue
            ahead, behind = points[inner - 1], points[inner + 1]
            middle = 0.5 * (ahead + behind)
            free = np.ones(len(inner), dtype=bool)
            for share in CHECKED_SHARES:
                free &= tube.inside(ahead + share * (middle - ahead)) & tube.inside(behind + share * (middle - behind))
            points[inner[free]] = middle[free]
        if number % ROUNDS_PER_CHECK == 0:
            after = _length_mm(points)
            if before - after <= SETTLED_SHARE * before:
                break
            before = after
    return points


def tube_around(
    volume: Volume, airways: Airways | None, nodes_lps: Points, *, may_leave: Mask | None = None
) -> SearchTube:
    """Return the union of balls of the medium around the path of a search, and the voxels of that path.

    The radius of a ball is the distance to the end of the medium: for a point in a known lumen, the distance to its
    wall; elsewhere the distance at which a ray reaches a value that differs from those of the path.
    Where ``may_leave`` (n,) is False, the tube is in the lumen, also if a straight line between two of its voxels
    touches the corner of another voxel.
    """
    if airways is None:
        shape_zyx, lps_from_ijk = volume.shape_zyx, volume.lps_from_ijk
    else:
        shape_zyx, lps_from_ijk = airways.tracker.grid.shape_zyx, airways.tracker.grid.lps_from_ijk
    spacing = np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    whole_from_lps = np.linalg.inv(lps_from_ijk)

    def to_ijk(points: Points) -> Points:
        return np.asarray(points @ whole_from_lps[:3, :3].T + whole_from_lps[:3, 3])

    fine = evenly_spaced(nodes_lps, 0.25 * float(spacing.min()))
    ijk = to_ijk(fine)
    most = np.array(shape_zyx[::-1]) - 1
    first = np.clip(np.floor(ijk.min(axis=0) - REACH_MM / spacing), 0, most).astype(int)
    last = np.clip(np.ceil(ijk.max(axis=0) + REACH_MM / spacing), 0, most).astype(int)
    mask = np.zeros((last - first + 1)[::-1], dtype=bool)

    points = evenly_spaced(nodes_lps, STEP_MM)
    centres = to_ijk(points) - first
    in_lumen = np.zeros(len(points), dtype=bool) if airways is None else airways.tracker.inside(points)
    if may_leave is not None:
        in_lumen |= ~_spread_along(nodes_lps, may_leave, len(points))
    radius = np.zeros(len(points))
    if not in_lumen.all():
        radius[~in_lumen] = medium_radii(volume, points)[~in_lumen]
    least = float(spacing.min()) if airways is None else BESIDE_LUMEN_MM
    _add_balls(mask, centres[~in_lumen], np.maximum(LUMEN_SHARE * radius[~in_lumen], least), spacing)
    if airways is not None:
        box = tuple(slice(first[axis], last[axis] + 1) for axis in (2, 1, 0))
        lumen = airways.tracker.lumen_zyx[box] != 0
        mask &= ~lumen
        wall = LUMEN_SHARE * airways.tracker.core.radius_mm(points[in_lumen])
        inner = np.zeros_like(mask)
        _add_balls(inner, centres[in_lumen], np.maximum(wall, spacing.max()), spacing)
        mask |= inner & lumen
    if airways is not None and may_leave is not None:
        ijk = ijk[_spread_along(nodes_lps, may_leave, len(fine)) | airways.tracker.inside(fine)]
    i, j, k = np.rint(ijk - first).astype(int).T
    mask[k, j, i] = True
    ijk_from_lps = np.array(whole_from_lps, dtype=np.float64)
    ijk_from_lps[:3, 3] -= first
    return SearchTube(mask, ijk_from_lps)


def medium_radii(volume: Volume, points: Points) -> NDArray[np.float64]:
    """Return the radii (n,) of the largest balls of the medium around the points of a path, mm, at most `REACH_MM`.

    The medium of a point is the median of the values near it on the path. A ray leaves the medium at the first
    value that differs by more than `NOISE_FACTOR` times the noise and `RISE_SHARE` of the largest difference nearby.
    """
    values = _values_at(volume, points)
    window = np.lib.stride_tricks.sliding_window_view(np.pad(values, MEDIUM_NODES, mode="edge"), 2 * MEDIUM_NODES + 1)
    medium = np.median(window, axis=1)
    noise = 1.4826 * float(np.median(np.abs(window - medium[:, None])))
    along = np.arange(RAY_STEP_MM, REACH_MM + 0.5 * RAY_STEP_MM, RAY_STEP_MM)
    offsets = _directions(NUM_RAYS)[:, None, :] * along[None, :, None]
    away = np.abs(_values_at(volume, points[:, None, None, :] + offsets[None]) - medium[:, None, None])
    rise = np.median(away.max(axis=2), axis=1)
    leaves = away > np.maximum(NOISE_FACTOR * noise, RISE_SHARE * rise)[:, None, None]
    steps = np.where(leaves.any(axis=2), leaves.argmax(axis=2), len(along))
    return np.asarray(steps.min(axis=1) * RAY_STEP_MM, dtype=np.float64)


def evenly_spaced(points: Points, step_mm: float) -> Points:
    """Return evenly spaced points along a polyline, at most ``step_mm`` apart, including its ends."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    count = max(int(np.ceil(along[-1] / step_mm)), 1) + 1 if along[-1] > 0.0 else 1
    places = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(places, along, points[:, axis]) for axis in range(3)], axis=1)


def _spread_along(points: Points, marks: Mask, count: int) -> Mask:
    """Return (count,) whether evenly spaced places along a polyline have a marked point (n,) before or after them."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    found: Mask = np.interp(np.linspace(0.0, along[-1], count), along, marks.astype(np.float64)) > 0.0
    return found


def wall_crossings(points: Points, airways: Airways) -> tuple[WallCrossing, ...]:
    """Return the places where a path leaves a lumen or returns into it, in order.

    A part outside the lumen that is shorter than half a voxel is not a crossing.
    """
    spacing = np.linalg.norm(airways.tracker.grid.lps_from_ijk[:3, :3], axis=0)
    step_mm = 0.25 * float(spacing.min())
    dense = evenly_spaced(points, step_mm)
    inside = airways.tracker.inside(dense)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
    edges = (np.flatnonzero(inside[1:] != inside[:-1]) + 1).tolist()
    crossings: list[WallCrossing] = []
    for at in edges:
        enters = bool(inside[at])
        if enters and crossings and along[at] - crossings[-1].along_mm < 2.0 * step_mm:
            crossings.pop()
            continue
        crossings.append(WallCrossing(along_mm=float(along[at]), lps=as_point(dense[at]), enters=enters))
    return tuple(crossings)


def _length_mm(points: Points) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _values_at(volume: Volume, points: Points) -> NDArray[np.float64]:
    """Return the values of the voxels that contain points (..., 3), LPS in mm; outside the volume the nearest ones."""
    ijk = np.rint(volume.to_ijk(points.reshape(-1, 3))).astype(np.intp)
    i, j, k = np.clip(ijk, 0, np.array(volume.shape_zyx[::-1]) - 1).T
    values: NDArray[np.float64] = volume.hu_zyx[k, j, i].astype(np.float64)
    return values.reshape(points.shape[:-1])


def _directions(count: int) -> Points:
    """Return unit vectors (n, 3) that are spread evenly over the sphere (Fibonacci lattice)."""
    number = np.arange(count) + 0.5
    z = 1.0 - 2.0 * number / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * number
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _add_balls(mask: Mask, centres: Points, radii_mm: NDArray[np.float64], spacing: NDArray[np.float64]) -> None:
    """Set the voxels whose centres are in one of the balls; centres (n, 3) are in voxels of the mask (i, j, k)."""
    most = np.array(mask.shape[::-1]) - 1
    for centre, radius in zip(centres, radii_mm, strict=True):
        low = np.maximum(np.ceil(centre - radius / spacing), 0).astype(int)
        high = np.minimum(np.floor(centre + radius / spacing), most).astype(int)
        i, j, k = (((np.arange(low[axis], high[axis] + 1) - centre[axis]) * spacing[axis]) ** 2 for axis in range(3))
        ball = k[:, None, None] + j[None, :, None] + i[None, None, :] <= radius * radius
        mask[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1] |= ball
