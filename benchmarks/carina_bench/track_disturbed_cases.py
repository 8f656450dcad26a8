"""CTs with metal, a breathing step, correlated noise or streaks, made from a CT that has none of them.

Each function returns a new volume on the same grid and leaves the airways where they were, but for a breathing step,
which moves all of a part of the slices; the true airways are moved with them by :func:`stepped_points`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.volume import Volume

__all__ = ["Step", "noisy", "stepped", "stepped_points", "streaked", "with_clips", "with_metal"]

Points = NDArray[np.float64]
Floats = NDArray[np.float64]

CLIP_HU = 3000.0
CLIP_SIZE_MM = (1.5, 1.5, 5.0)
"""Extent of a surgical clip along x, y and z."""
STREAK_HU = 900.0
"""Greatest amplitude of the streaks of a clip, beside it."""
HALF_STREAK_MM = 25.0
"""Distance from the clip at which the amplitude is half of the greatest."""
NUM_BANDS = 72
"""Directions in the plane at which the amplitude of the streaks of one piece of metal is drawn."""
SAME_STREAKS = 0.9
"""Correlation of the streaks of one piece of metal in neighbouring slices."""
LEAST_HU, MOST_HU = -1024, 3071


def with_clips(
    volume: Volume, centre_lps: Sequence[float], *, seed: int, num: int = 7, spread_mm: float = 12.0
) -> Volume:
    """Return the CT with surgical clips round a place and their streaks in the slices that contain the clips."""
    rng = np.random.default_rng((seed, 11))
    places = np.asarray(centre_lps, np.float64) + spread_mm * np.clip(rng.standard_normal((num, 3)), -1.5, 1.5)
    sizes = np.array([rng.permutation(CLIP_SIZE_MM) for _ in range(num)])
    return with_metal(volume, places, sizes, seed=seed)


def with_metal(
    volume: Volume,
    places_lps: Points,
    sizes_mm: Points,
    *,
    seed: int,
    streak_hu: float = STREAK_HU,
    half_mm: float = HALF_STREAK_MM,
) -> Volume:
    """Return the CT with blocks of metal and their streaks: dark and bright bands that fade with the distance.

    Parameters
    ----------
    places_lps, sizes_mm
        (n, 3) centres, LPS mm, and extents along the axes of the grid, mm.
    """
    rng = np.random.default_rng((seed, 12))
    nz, ny, nx = volume.shape_zyx
    dx, dy, dz = volume.spacing_mm
    values = volume.hu_zyx.astype(np.float32)
    metal = np.zeros(values.shape, np.float32)
    rows, columns = np.arange(ny)[:, None], np.arange(nx)[None, :]
    for place, size in zip(volume.to_ijk(places_lps), sizes_mm, strict=True):
        extent = np.maximum(size / (dx, dy, dz), 1.0)
        covers = [
            np.clip(0.5 * e + 0.5 - np.abs(np.arange(n) - p), 0.0, 1.0)
            for n, p, e in zip((nx, ny, nz), place, extent, strict=True)
        ]
        off_x, off_y = (columns - place[0]) * dx, (rows - place[1]) * dy
        angle, away_mm = np.arctan2(off_y, off_x), np.hypot(off_x, off_y)
        fading = streak_hu / (1.0 + away_mm / half_mm)
        knots = rng.standard_normal(NUM_BANDS // 2)
        for k in np.flatnonzero(covers[2] > 0.0):
            # The same metal leaves nearly the same streaks in the next slice.
            knots = SAME_STREAKS * knots + np.sqrt(1.0 - SAME_STREAKS**2) * rng.standard_normal(len(knots))
            values[k] += (covers[2][k] * fading * _bands(angle, knots)).astype(np.float32)
            metal[k] = np.maximum(metal[k], (covers[2][k] * covers[1][:, None] * covers[0][None, :]).astype(np.float32))
    values += metal * (np.float32(CLIP_HU) - values)
    return _with_values(volume, values)


def _bands(angle: Floats, knots: Floats) -> Floats:
    """Return values of -1 to 1 that change with the direction alone; opposite directions are alike, as rays are."""
    knots = np.clip(knots / 1.5, -1.0, 1.0)
    knots = knots - knots.mean()
    at = np.mod(angle, np.pi) * (len(knots) / np.pi)
    low = np.floor(at).astype(int) % len(knots)
    share = at - np.floor(at)
    result: Floats = (1.0 - share) * knots[low] + share * knots[(low + 1) % len(knots)]
    return result


@dataclasses.dataclass(frozen=True, slots=True)
class Step:
    """A breath between two slices: everything above a level lies elsewhere than the scan says."""

    above_lps_z: float
    """Level of the first moved slice, LPS mm."""
    shift_mm: tuple[float, float, float] = (0.0, 3.0, 6.0)
    """By how much the chest above the level appears moved, LPS mm. Positive z: a part of it is missing in the scan;
    negative z: a part of it is there twice."""


def stepped(volume: Volume, step: Step) -> Volume:
    """Return the CT with a breathing step; the axes of the grid are those of the patient."""
    spacing = np.diag(volume.lps_from_ijk)[:3]
    by_i, by_j, by_k = (round(mm / size) for mm, size in zip(step.shift_mm, spacing, strict=True))
    nz = volume.shape_zyx[0]
    heights = volume.lps_from_ijk[2, 3] + spacing[2] * np.arange(nz)
    values = volume.hu_zyx.copy()
    for k in np.flatnonzero(heights >= step.above_lps_z):
        plane = volume.hu_zyx[min(max(k - by_k, 0), nz - 1)]
        values[k] = np.roll(plane, (by_j, by_i), axis=(0, 1))
    return dataclasses.replace(volume, hu_zyx=values)


def stepped_points(points_lps: Points, step: Step, volume: Volume) -> tuple[Points, NDArray[np.bool_]]:
    """Return where points of the chest appear after a breathing step, and which of them still appear.

    Points that appear twice are returned where they appear above the level.
    """
    spacing = np.diag(volume.lps_from_ijk)[:3]
    shift = np.rint(np.array(step.shift_mm) / spacing) * spacing
    moved = points_lps + shift
    is_above = moved[:, 2] >= step.above_lps_z
    shown = np.where(is_above[:, None], moved, points_lps)
    return shown, is_above | (points_lps[:, 2] < step.above_lps_z)


def noisy(volume: Volume, noise_hu: float, *, seed: int, sigma_mm: float = 0.0) -> Volume:
    """Return the CT with more noise of this standard deviation; correlated over a Gaussian, or white without one."""
    rng = np.random.default_rng((seed, 13))
    noise = rng.standard_normal(volume.shape_zyx).astype(np.float32)
    if sigma_mm > 0.0:
        for axis, step in zip((2, 1, 0), volume.spacing_mm, strict=True):
            noise = _blurred(noise, sigma_mm / step, axis)
    noise *= np.float32(noise_hu / float(noise.std()))
    return _with_values(volume, volume.hu_zyx.astype(np.float32) + noise)


def _blurred(values: NDArray[np.float32], sigma: float, axis: int) -> NDArray[np.float32]:
    """Return values blurred along an axis; the ends are continued by the other ends."""
    reach = int(np.ceil(3.0 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    result = np.zeros_like(values)
    for by, weight in zip(range(-reach, reach + 1), weights, strict=True):
        result += np.float32(weight) * np.roll(values, by, axis)
    return result


def streaked(volume: Volume, streak_hu: float, *, seed: int, from_lps_z: float, width_mm: float = 1.5) -> Volume:
    """Return the CT with streaks from side to side in the slices above a level, as shoulders leave them.

    Parameters
    ----------
    streak_hu
        Standard deviation from row to row.
    width_mm
        Sigma of a streak across its direction.
    """
    rng = np.random.default_rng((seed, 14))
    spacing = np.diag(volume.lps_from_ijk)[:3]
    nz, ny, _ = volume.shape_zyx
    heights = volume.lps_from_ijk[2, 3] + spacing[2] * np.arange(nz)
    values = volume.hu_zyx.astype(np.float32)
    sigma = width_mm / abs(spacing[1])
    reach = int(np.ceil(3.0 * sigma))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= np.linalg.norm(kernel)
    for k in np.flatnonzero(heights >= from_lps_z):
        rows = np.convolve(rng.standard_normal(ny + 2 * reach), kernel, mode="valid")
        values[k] += (streak_hu * rows[:, None]).astype(np.float32)
    return _with_values(volume, values)


def _with_values(volume: Volume, values: NDArray[np.float32]) -> Volume:
    return dataclasses.replace(volume, hu_zyx=np.clip(np.rint(values), LEAST_HU, MOST_HU).astype(np.int16))
