"""Voxel values of air, lumen and wall: from the HU scale, or from the histogram of a volume without HU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.volume.model import Volume

# Scanners write this or less outside the reconstructed circle; on the HU scale nothing is thinner than air.
PADDING_HU = -1100


@dataclass(frozen=True, slots=True)
class AirScale:
    """Voxel values of air and soft tissue in a volume, from which the value of every other level in HU follows.

    The values of a volume that is not in HU are read from its histogram; see `air_scale`.
    """

    air: float
    """Voxel value of air; -1000 in a volume in HU."""
    tissue: float
    """Voxel value of soft tissue; 0 in a volume in HU."""

    def level(self, hu: float) -> int:
        """Return the voxel value that corresponds to a level in HU, rounded to an integer."""
        return round(self.air + (hu + 1000.0) / 1000.0 * (self.tissue - self.air))

    def span(self, hu: float) -> float:
        """Return the difference of voxel values that corresponds to a difference in HU."""
        return hu / 1000.0 * (self.tissue - self.air)


def air_scale(volume: Volume) -> AirScale:
    """Return the scale of a volume: HU if it is calibrated, otherwise from its histogram."""
    return AirScale(-1000.0, 0.0) if volume.is_hu else _scale_from_histogram(volume.hu_zyx)


def lumen_threshold_from_histogram(volume: Volume) -> float:
    """Return the value at which the lumen ends in a volume that is not in HU.

    The value is a fifth of the way from air to soft tissue, which is -800 HU on a calibrated CT (see
    ``find_airways``). A threshold divides the histogram into two classes (Otsu 1979). Soft tissue is the median of
    the class above it; air is the dark end of the class below it, because lung is dark too.

    Raises
    ------
    NoResultError
        If the volume has a single value.
    """
    return float(_scale_from_histogram(volume.hu_zyx).level(-800.0))


def _scale_from_histogram(values: NDArray[np.int16]) -> AirScale:
    # Every 2nd slice and every 3rd row and column: a histogram does not need all voxels.
    sample = values[::2, ::3, ::3].astype(np.int64).ravel()
    low = int(sample.min())
    counts = np.bincount(sample - low).astype(np.float64)
    if np.count_nonzero(counts) < 2:
        raise NoResultError("every voxel has the same value, so air and tissue cannot be distinguished")
    levels = np.arange(counts.size) + low
    below = np.cumsum(counts)
    sum_below = np.cumsum(counts * levels)
    above = below[-1] - below
    usable = (below > 0) & (above > 0)
    mean_below = sum_below[usable] / below[usable]
    mean_above = (sum_below[-1] - sum_below[usable]) / above[usable]
    between = below[usable] * above[usable] * (mean_above - mean_below) ** 2
    cut = levels[usable][int(np.argmax(between))]
    dark, bright = sample[sample <= cut], sample[sample > cut]
    # The dark end of the dark class is air outside and in the trachea; its middle may be lung.
    return AirScale(float(np.percentile(dark, 5)), float(np.median(bright)))
