"""Live path to the point under the pointer (intelligent scissors of paper 6.3, in 3D)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker
from carina.display import one_line
from carina.track.intensity_levels import AirScale
from carina.volume.model import Volume

# Number of rays round a point of the path, and largest number of points that are judged.
NUM_RAYS = 8
MAX_POINTS = 48
# The wall of a bronchus is 0.5 to 2 mm thick; the scanner blurs it by about a voxel.
WALL_REACH_MM = 2.0
# Rises that count as no wall and as a certain wall, in standard deviations of the noise: the brightest of some noise
# samples is about 2 above the mean.
NOTHING_SIGMA, CERTAIN_SIGMA = 2.0, 6.0
# Minimum rise in HU that counts as evidence of a wall, in CTs with little noise.
MIN_CONTRAST_HU = 60.0
# A lumen below the first width (voxels) may be noise; from the second width on it is completely visible.
FEW_VOXELS, ENOUGH_VOXELS = 0.5, 3.0
# Length in mm at the end of the path that is judged if the path contains no new part.
LAST_MM = 10.0
# Radius in mm round a pointer outside all airways within which the nearest airway is searched.
SEARCH_MM = 40.0
# The wall is judged by its weakest points; a quantile, because noise determines the single weakest sample.
WEAK_SHARE = 0.1


Point = tuple[float, float, float]


class LumenPaths(Protocol):
    """Interface of a path tracker for live paths (:class:`carina.track.PathTracker`)."""

    @property
    def core(self) -> LumenTracker:
        """Compiled tracker."""
        ...

    @property
    def air_scale(self) -> AirScale:
        """Voxel values of air and soft tissue in this volume, which need not be HU."""
        ...

    @property
    def noise_hu(self) -> float:
        """Standard deviation of the values deep inside the first airway, HU."""
        ...

    def snap(self, point: Point, *, snap_mm: float) -> tuple[int, float]:
        """Return the lumen voxel (as a node) nearest to a point, and the distance in mm."""
        ...

    def middle_to(self, node: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return smooth (n, 3) points of the path to a node (LPS, mm), and their (n,) distances to the wall in mm."""
        ...

    def new_share(self, node: int) -> tuple[float, int | None]:
        """Return the share of a path's length that is outside the tree, and the branch where this part starts."""
        ...


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class LivePath:
    """Path to the point under the pointer, before the user confirms it."""

    points_lps: NDArray[np.float64]
    """Points (n, 3) from the root to the target, LPS in mm, smoothed inside the lumen; (0, 3) if there is a problem."""
    length_mm: float
    min_radius_mm: float
    """Smallest distance in mm from the centreline to the wall, without one radius at both ends of the path."""
    confidence: float | None
    """Confidence (0..1) that the new part is an airway, from its wall and lumen (see :func:`find_live_path`).

    None if there is no path.
    """
    snapped_mm: float
    """Distance in mm of the given point from the lumen; 0 inside the lumen."""
    new_mm: float
    """Length in mm of that part of the path that is not yet in the tree."""
    joins_branch_id: int | None
    """Branch of the current tree from which the new part starts; None without a tree."""
    problem: str | None
    """Text that states why there is no path and what to do; None if there is a path."""


def find_live_path(tracker: LumenPaths, volume: Volume, point: Point, *, reach_mm: float) -> LivePath:
    """Return the path to a point in the volume, or a result that states why there is none.

    The confidence is the product of three shares:

    - the wall: at points of the new part (or of the last 10 mm if nothing is new), eight rays run across the path. A
      ray meets a wall if the values rise above those of the lumen within 2 mm of the expected wall. A rise of 2
      standard deviations of the noise (measured in the widest airway), or of 60 HU, counts 0; a rise of 6 standard
      deviations counts 1. The share is that of the weakest tenth of the points: lung that leaked in has no wall,
      whatever its own value.
    - the width: a lumen of 3 voxels across counts 1; one of half a voxel counts one half, because it may be noise.
    - the place: a point in the lumen counts 1; a point that was moved by ``reach_mm`` counts one half.

    Parameters
    ----------
    tracker
        Tracker of the lumen.
    volume
        The CT on the grid of the tracker.
    point
        Target, LPS in mm.
    reach_mm
        Largest distance of the target from the lumen.
    """
    inside = bool(tracker.core.inside([point])[0])
    # Check this before `snap`, whose error message searches within 60 mm: too slow while a pointer moves.
    if not inside and volume.contains_lps(np.array(point)) and tracker.core.nearest(point, reach_mm) is None:
        return _no_path(_place_text(tracker, volume, point, reach_mm))
    node, snapped_mm = tracker.snap(point, snap_mm=reach_mm)
    if not tracker.core.solve_to(node):
        return _no_path(
            "This part of the lumen is not connected to the trachea: the airway is obstructed, or the "
            "segmentation has a gap. Bridge the gap, or paint the missing lumen."
        )
    points, radius = tracker.middle_to(node)
    new_share, joins = tracker.new_share(node)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    length_mm = float(steps.sum())
    new_mm = new_share * length_mm
    to_end = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
    looked_at = to_end <= max(new_mm, LAST_MM)
    # Leave out one tube radius at the target and at the root: the distance to the wall does not describe the tube at
    # its closed end or near a target beside the wall.
    tube_mm = float(radius[looked_at].max(initial=0.0))
    from_root = to_end[0] - to_end
    middle = (to_end > tube_mm) & (from_root > float(radius[from_root <= LAST_MM].max(initial=0.0)))
    if not middle.any():
        middle = radius == radius.max()
    scores = wall_scores(
        volume,
        points[looked_at & middle] if (looked_at & middle).any() else points[middle][-1:],
        points,
        float(np.median(radius[looked_at])),
        sigma_hu=tracker.noise_hu,
        scale=tracker.air_scale,
    )
    wall = float(np.quantile(scores, WEAK_SHARE))
    voxel_mm = float(np.prod(volume.spacing_mm)) ** (1 / 3)
    narrow = float(radius[looked_at & middle].min(initial=tube_mm))
    seen = np.clip((2.0 * narrow / voxel_mm - FEW_VOXELS) / (ENOUGH_VOXELS - FEW_VOXELS), 0.0, 1.0)
    width = 0.5 + 0.5 * float(seen)
    place = 1.0 - 0.5 * min(snapped_mm / reach_mm, 1.0) if reach_mm > 0.0 else 1.0
    return LivePath(
        points_lps=points,
        length_mm=length_mm,
        min_radius_mm=float(radius[middle].min()),
        confidence=round(wall * width * place, 3),
        snapped_mm=snapped_mm,
        new_mm=new_mm,
        joins_branch_id=joins,
        problem=None,
    )


def wall_scores(
    volume: Volume,
    points_lps: NDArray[np.float64],
    path_lps: NDArray[np.float64],
    radius_mm: float,
    *,
    sigma_hu: float,
    scale: AirScale,
) -> NDArray[np.float64]:
    """Return (n,) shares (0..1) of the rays round each (n, 3) point that meet a wall.

    Parameters
    ----------
    volume
        The CT.
    points_lps
        (n, 3) points, LPS in mm; at most 48 of them are used.
    path_lps
        (m, 3) path that contains the points, LPS in mm; the rays run across it.
    radius_mm
        Approximate distance to the wall; the rays extend 2 mm and a voxel farther.
    sigma_hu
        Standard deviation of the noise.
    scale
        Voxel values of air and soft tissue in this volume, which need not be HU.
    """
    points = points_lps[np.linspace(0, len(points_lps) - 1, min(len(points_lps), MAX_POINTS)).round().astype(int)]
    across_u, across_v = _perpendicular_vectors(points, path_lps)
    angles = 2.0 * np.pi * np.arange(NUM_RAYS) / NUM_RAYS
    rays = np.cos(angles)[None, :, None] * across_u[:, None, :] + np.sin(angles)[None, :, None] * across_v[:, None, :]
    spacing = np.array(volume.spacing_mm)
    reach = radius_mm + WALL_REACH_MM + float(np.prod(spacing)) ** (1 / 3)
    at_mm = np.arange(0.0, reach + 1e-9, max(0.5 * float(spacing.min()), reach / 24.0))
    samples = points[:, None, None, :] + at_mm[None, None, :, None] * rays[:, :, None, :]
    values = sampled(volume, samples.reshape(-1, 3)).reshape(samples.shape[:3]) / scale.span(1.0)
    # A ray passes the lumen first; the wall is the brightest value behind it.
    lumen = values[:, :, at_mm <= max(0.5 * radius_mm, at_mm[1])].mean(axis=(1, 2))
    rise = values.max(axis=2) - lumen[:, None]
    nothing = max(NOTHING_SIGMA * sigma_hu, MIN_CONTRAST_HU)
    certain = max(CERTAIN_SIGMA * sigma_hu, 2.0 * MIN_CONTRAST_HU)
    return np.asarray(np.clip((rise - nothing) / (certain - nothing), 0.0, 1.0).mean(axis=1))


def noise_hu(volume: Volume, points_lps: NDArray[np.float64], scale: AirScale) -> float:
    """Return the standard deviation (HU) of the values at (n, 3) points deep inside the widest airway; 20 if n < 30."""
    if len(points_lps) < 30:
        return 20.0
    values = sampled(volume, np.asarray(points_lps), nearest=True) / scale.span(1.0)
    # The deviation is estimated from the quartiles, so that a polyp or a tube in the airway has no effect.
    low, high = np.quantile(values, [0.25, 0.75])
    return float(max((high - low) / 1.349, 1.0))


def _perpendicular_vectors(
    points: NDArray[np.float64], path: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two unit vectors (n, 3) across a path at each of its points."""
    place = np.argmin(np.linalg.norm(path[None, :, :] - points[:, None, :], axis=2), axis=1)
    last = len(path) - 1
    along = path[np.minimum(place + 2, last)] - path[np.maximum(place - 2, 0)]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.where(length > 0.0, along / np.maximum(length, 1e-9), np.array([0.0, 0.0, 1.0]))
    # Of the axes x, y and z the one least parallel to the path is made perpendicular to the path.
    other = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    u = np.cross(along, other)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(along, u)


def sampled(volume: Volume, points_lps: NDArray[np.float64], *, nearest: bool = False) -> NDArray[np.float64]:
    """Return the trilinear values at (n, 3) points (LPS, mm), clamped to the edge of the volume."""
    values = volume.hu_zyx
    top = np.array(values.shape[::-1]) - 1
    ijk = np.clip(volume.to_ijk(points_lps), 0.0, top)
    if nearest:
        i, j, k = np.rint(ijk).astype(int).T
        exact: NDArray[np.float64] = values[k, j, i].astype(np.float64)
        return exact
    base = np.minimum(ijk.astype(int), np.maximum(top - 1, 0))
    share = ijk - base
    result = np.zeros(len(ijk))
    for corner in range(8):
        step = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        weight = np.where(step == 1, share, 1.0 - share).prod(axis=1)
        i, j, k = np.minimum(base + step, top).T
        result += weight * values[k, j, i]
    return result


def _no_path(problem: str) -> LivePath:
    return LivePath(np.empty((0, 3)), 0.0, 0.0, None, 0.0, 0.0, None, problem)


def _place_text(tracker: LumenPaths, volume: Volume, point: Point, reach_mm: float) -> str:
    """Return a text for the user that states what is at a point outside the lumen, and what to do."""
    found = tracker.core.nearest(point, SEARCH_MM)
    far = f"more than {SEARCH_MM:g} mm" if found is None else f"{found[1]:.0f} mm"
    do = (
        f"The nearest segmented airway is {far} away (at most {reach_mm:g} mm is allowed). Point at an airway; if one "
        "is missing here, paint its lumen or raise the air threshold."
    )
    offsets = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    around = volume.to_lps(volume.to_ijk(np.array(point)) + offsets)
    scale = tracker.air_scale
    value = float(np.median(sampled(volume, around, nearest=True)))
    if value > scale.level(-500.0):
        return f"This is soft tissue, not an airway. {do}"
    if value > scale.level(-950.0):
        return f"This is lung outside the segmented airways. {do}"
    return f"This is air outside the segmented airways. {do}"
