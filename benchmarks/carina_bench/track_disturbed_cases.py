"""CTs with metal, a breathing step, correlated noise or streaks, derived from an undisturbed CT.

Each function returns a new volume on the same grid. The airways keep their positions, except with a breathing step,
which moves all anatomy in a part of the slices; :func:`stepped_points` moves the true airways accordingly.
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
"""CT value of a clip and of other metal, HU."""
CLIP_SIZE_MM = (1.5, 1.5, 5.0)
"""Size of a surgical clip along the patient's x, y and z axes, mm."""
STREAK_HU = 900.0
"""Maximum amplitude in HU of painted metal streaks, which is that at the metal clip."""
HALF_STREAK_MM = 25.0
"""Distance from a clip at which the amplitude of its streaks is half of the largest, mm."""
NUM_BANDS = 72
"""Number of directions in a slice for which the amplitude of a clip's streaks is drawn at random."""
SAME_STREAKS = 0.9
"""Correlation between the streaks of one piece of metal in two neighbouring slices."""
MIN_HU, MAX_HU = -1024, 3071
"""Minimum and maximum CT value that a painted volume can store, HU."""


def with_clips(
    volume: Volume, centre_lps: Sequence[float], *, seed: int, num: int = 7, spread_mm: float = 12.0
) -> Volume:
    """Return the CT with ``num`` surgical clips around a point (LPS mm), and streaks in the slices of the clips."""
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
        (n, 3) centres of the blocks, LPS mm, and their sizes along the axes of the grid, mm.
    streak_hu
        Largest amplitude of the streaks, HU.
    half_mm
        Distance from the metal at which the amplitude is half of the largest, mm.
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
            # Neighbouring slices contain the same piece of metal, so their streaks are correlated.
            knots = SAME_STREAKS * knots + np.sqrt(1.0 - SAME_STREAKS**2) * rng.standard_normal(len(knots))
            values[k] += (covers[2][k] * fading * _bands(angle, knots)).astype(np.float32)
            metal[k] = np.maximum(metal[k], (covers[2][k] * covers[1][:, None] * covers[0][None, :]).astype(np.float32))
    values += metal * (np.float32(CLIP_HU) - values)
    return _with_values(volume, values)


def _bands(angle: Floats, knots: Floats) -> Floats:
    """Return the amplitude (-1 to 1) at each angle, interpolated between knots.

    Opposite directions have one amplitude.
    """
    knots = np.clip(knots / 1.5, -1.0, 1.0)
    knots = knots - knots.mean()
    at = np.mod(angle, np.pi) * (len(knots) / np.pi)
    low = np.floor(at).astype(int) % len(knots)
    share = at - np.floor(at)
    result: Floats = (1.0 - share) * knots[low] + share * knots[(low + 1) % len(knots)]
    return result


@dataclasses.dataclass(frozen=True, slots=True)
class Step:
    """Breathing step between two slices: in the scan the anatomy above a level is shifted against that below it."""

    above_lps_z: float
    """Position of the first slice that a painted breathing step shifts, LPS z in mm."""
    shift_mm: tuple[float, float, float] = (0.0, 3.0, 6.0)
    """Shift of the anatomy above the level, LPS mm.

    With a positive z a part of the chest is missing in the scan; with a negative z a part appears twice.
    """


def stepped(volume: Volume, step: Step) -> Volume:
    """Return the CT with a breathing step; the axes of its grid must be parallel to those of the patient."""
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
    """Return the positions (n, 3) of points after a breathing step, and for each whether the scan still shows it.

    The position of a point that appears twice is the one above the level.
    """
    spacing = np.diag(volume.lps_from_ijk)[:3]
    shift = np.rint(np.array(step.shift_mm) / spacing) * spacing
    moved = points_lps + shift
    is_above = moved[:, 2] >= step.above_lps_z
    shown = np.where(is_above[:, None], moved, points_lps)
    return shown, is_above | (points_lps[:, 2] < step.above_lps_z)


def noisy(volume: Volume, noise_hu: float, *, seed: int, sigma_mm: float = 0.0) -> Volume:
    """Return the CT with additional noise of the standard deviation ``noise_hu``.

    The noise is correlated by a Gaussian of ``sigma_mm``; it is white if ``sigma_mm`` is 0.
    """
    rng = np.random.default_rng((seed, 13))
    noise = rng.standard_normal(volume.shape_zyx).astype(np.float32)
    if sigma_mm > 0.0:
        for axis, step in zip((2, 1, 0), volume.spacing_mm, strict=True):
            noise = _blurred(noise, sigma_mm / step, axis)
    noise *= np.float32(noise_hu / float(noise.std()))
    return _with_values(volume, volume.hu_zyx.astype(np.float32) + noise)


def _blurred(values: NDArray[np.float32], sigma: float, axis: int) -> NDArray[np.float32]:
    """Return the values blurred along one axis by a Gaussian; ``sigma`` is in voxels and the ends are periodic."""
    reach = int(np.ceil(3.0 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    result = np.zeros_like(values)
    for by, weight in zip(range(-reach, reach + 1), weights, strict=True):
        result += np.float32(weight) * np.roll(values, by, axis)
    return result


def streaked(volume: Volume, streak_hu: float, *, seed: int, from_lps_z: float, width_mm: float = 1.5) -> Volume:
    """Return the CT with lateral streaks in the slices above a level, as the shoulders cause them.

    Parameters
    ----------
    streak_hu
        Standard deviation of the streaks between rows, HU.
    from_lps_z
        Level, LPS z in mm.
    width_mm
        Sigma of a streak perpendicular to its direction, mm.
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
    return dataclasses.replace(volume, hu_zyx=np.clip(np.rint(values), MIN_HU, MAX_HU).astype(np.int16))
