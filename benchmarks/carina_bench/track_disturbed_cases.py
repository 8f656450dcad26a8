"""CTs with metal, a breathing step, correlated noise or streaks, derived from a CT without them.

Each function returns a new volume on the same grid. The airways stay in place, except for a breathing step, which moves
all anatomy in a part of the slices; :func:`stepped_points` moves the true airways accordingly.
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
"""Size of a surgical clip along x, y and z, mm."""
STREAK_HU = 900.0
"""Largest amplitude of the streaks, at the clip."""
HALF_STREAK_MM = 25.0
"""Distance from the clip at which the amplitude is half of the largest."""
NUM_BANDS = 72
"""Number of directions in the plane for which an amplitude is drawn, for each piece of metal."""
SAME_STREAKS = 0.9
"""Correlation of the streaks of one piece of metal between neighbouring slices."""
LEAST_HU, MOST_HU = -1024, 3071


def with_clips(
    volume: Volume, centre_lps: Sequence[float], *, seed: int, num: int = 7, spread_mm: float = 12.0
) -> Volume:
    """Return the CT with surgical clips around a point, and their streaks in the slices that contain the clips."""
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
        (n, 3) centres, LPS mm, and sizes along the axes of the grid, mm.
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
            # The streaks of neighbouring slices are similar, because the metal is the same.
            knots = SAME_STREAKS * knots + np.sqrt(1.0 - SAME_STREAKS**2) * rng.standard_normal(len(knots))
            values[k] += (covers[2][k] * fading * _bands(angle, knots)).astype(np.float32)
            metal[k] = np.maximum(metal[k], (covers[2][k] * covers[1][:, None] * covers[0][None, :]).astype(np.float32))
    values += metal * (np.float32(CLIP_HU) - values)
    return _with_values(volume, values)


def _bands(angle: Floats, knots: Floats) -> Floats:
    """Return values of -1 to 1 that depend only on the direction; opposite directions are equal, as for rays."""
    knots = np.clip(knots / 1.5, -1.0, 1.0)
    knots = knots - knots.mean()
    at = np.mod(angle, np.pi) * (len(knots) / np.pi)
    low = np.floor(at).astype(int) % len(knots)
    share = at - np.floor(at)
    result: Floats = (1.0 - share) * knots[low] + share * knots[(low + 1) % len(knots)]
    return result


@dataclasses.dataclass(frozen=True, slots=True)
class Step:
    """Breathing step between two slices: the anatomy above a level is shifted in the scan."""

    above_lps_z: float
    """Level of the first shifted slice, LPS mm."""
    shift_mm: tuple[float, float, float] = (0.0, 3.0, 6.0)
    """Shift of the chest above the level, LPS mm.

    Positive z: a part of the chest is missing in the scan; negative z: a part is duplicated.
    """


def stepped(volume: Volume, step: Step) -> Volume:
    """Return the CT with a breathing step; the axes of the grid must be those of the patient."""
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
    """Return the positions of points of the chest after a breathing step, and whether each of them is still visible.

    Duplicated points are returned at their position above the level.
    """
    spacing = np.diag(volume.lps_from_ijk)[:3]
    shift = np.rint(np.array(step.shift_mm) / spacing) * spacing
    moved = points_lps + shift
    is_above = moved[:, 2] >= step.above_lps_z
    shown = np.where(is_above[:, None], moved, points_lps)
    return shown, is_above | (points_lps[:, 2] < step.above_lps_z)


def noisy(volume: Volume, noise_hu: float, *, seed: int, sigma_mm: float = 0.0) -> Volume:
    """Return the CT with additional noise of this standard deviation.

    The noise is correlated by a Gaussian, or white if sigma is 0.
    """
    rng = np.random.default_rng((seed, 13))
    noise = rng.standard_normal(volume.shape_zyx).astype(np.float32)
    if sigma_mm > 0.0:
        for axis, step in zip((2, 1, 0), volume.spacing_mm, strict=True):
            noise = _blurred(noise, sigma_mm / step, axis)
    noise *= np.float32(noise_hu / float(noise.std()))
    return _with_values(volume, volume.hu_zyx.astype(np.float32) + noise)


def _blurred(values: NDArray[np.float32], sigma: float, axis: int) -> NDArray[np.float32]:
    """Blur values along an axis, with periodic ends."""
    reach = int(np.ceil(3.0 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    result = np.zeros_like(values)
    for by, weight in zip(range(-reach, reach + 1), weights, strict=True):
        result += np.float32(weight) * np.roll(values, by, axis)
    return result


def streaked(volume: Volume, streak_hu: float, *, seed: int, from_lps_z: float, width_mm: float = 1.5) -> Volume:
    """Return the CT with lateral streaks in the slices above a level, as from shoulders.

    Parameters
    ----------
    streak_hu
        Standard deviation between rows.
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
