"""Breathing steps: two neighbouring slices between which the chest has moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.find.root_checks import LUNG_HU
from carina.track.intensity_levels import AirScale
from carina.volume.model import Volume

Floats = NDArray[np.float64]

BLOCK_MM = 2.0
"""Side length in mm of the square blocks whose mean values are compared between neighbouring slices."""
BESIDE_HU = 100.0
"""Maximum mean of a compared block, in HU above the upper limit of lung.

Blocks with vessels are below this value, blocks with thick tissue above.
"""
MIN_AREA_MM2 = 2000.0
MIN_SHARE = 0.4
"""Minimum lung area of a compared slice, as a share of the largest lung area in a slice of the scan."""
NUM_BESIDE = 2
# Minimum drop of similarity between two slices against the least similar neighbouring pair, as a difference of Fisher
# transforms of correlations; without a step the drop is at most 0.21.
MIN_DROP = 0.22
# Minimum ratio of a drop to the fourth largest drop of the scan, because streaks make many slices dissimilar.
MIN_RATIO = 2.5
# Maximum number of breathing steps that are looked for in a scan; all other height differences give the usual value.
MAX_STEPS = 3


def find_steps(volume: Volume, scale: AirScale, is_changed: NDArray[np.bool_] | None = None) -> tuple[int, ...]:
    """Return the slices k after which the chest has moved, in ascending order.

    Parameters
    ----------
    volume
        Volume in canonical order: slices from the feet up.
    scale
        Conversion from HU to the values of the volume.
    is_changed
        (nz,) True for slices that streaks change; these slices are not compared.
    """
    return steps_of(similarity_drops(volume, scale, is_changed))


def steps_of(drops: Floats) -> tuple[int, ...]:
    """Return the slices k after which the chest has moved, from the result of :func:`similarity_drops`."""
    drops = np.nan_to_num(drops, nan=0.0)
    order = np.argsort(-drops, kind="stable")
    if len(order) <= MAX_STEPS:
        return ()
    usual = max(float(drops[order[MAX_STEPS]]), 0.0)
    found = [int(k) for k in order[:MAX_STEPS] if drops[k] >= max(MIN_DROP, MIN_RATIO * usual)]
    return tuple(sorted(found))


def similarity_drops(volume: Volume, scale: AirScale, is_changed: NDArray[np.bool_] | None) -> Floats:
    """Return, for each pair of neighbouring slices, by how much it is less similar than the pairs before and after it.

    The value is NaN for a pair that cannot be compared: with too little lung, with streaks, or near the ends.
    """
    dx, dy, _ = volume.spacing_mm
    size = (max(round(BLOCK_MM / dy), 1), max(round(BLOCK_MM / dx), 1))
    block_mm2 = size[0] * size[1] * dx * dy
    low, high = scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1] + BESIDE_HU)
    num = max(len(volume.hu_zyx) - 1, 0)
    alike, area = np.full(num, np.nan), np.zeros(num)
    below: NDArray[np.float32] | None = None
    for k, plane in enumerate(volume.hu_zyx):
        above = _block_means(plane, size)
        if below is not None:
            lung = (above > low) & (above < high) & (below > low) & (below < high)
            area[k - 1] = lung.sum() * block_mm2
            if area[k - 1] >= MIN_AREA_MM2:
                one, two = above[lung] - above[lung].mean(), below[lung] - below[lung].mean()
                power = float(np.sqrt((one * one).sum() * (two * two).sum()))
                alike[k - 1] = np.arctanh(np.clip(float((one * two).sum()) / max(power, 1e-9), -0.99, 0.99))
        below = above
    if is_changed is not None:
        alike[is_changed[:-1] | is_changed[1:]] = np.nan
    alike[area < MIN_SHARE * area.max(initial=0.0)] = np.nan
    padded = np.pad(alike, NUM_BESIDE, constant_values=np.nan)
    places = [n for n in range(2 * NUM_BESIDE + 1) if n != NUM_BESIDE]
    # The minimum is NaN if any neighbouring pair is not compared.
    beside = np.min([padded[n : n + num] for n in places], axis=0)
    return np.asarray(beside - alike, np.float64)


def _block_means(plane: NDArray[np.int16], size: tuple[int, int]) -> NDArray[np.float32]:
    nj, ni = (n // s for n, s in zip(plane.shape, size, strict=True))
    part = plane[: nj * size[0], : ni * size[1]].astype(np.float32)
    return np.asarray(part.reshape(nj, size[0], ni, size[1]).mean(axis=(1, 3)), np.float32)
