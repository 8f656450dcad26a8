"""Which values are air, lumen and wall: from the HU scale, or from a volume's own histogram where it has none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.volume.model import Volume

__all__ = ["AirScale", "air_scale", "lumen_threshold_from_histogram"]

# Scanners write this or less outside the reconstructed circle; on the HU scale nothing is thinner than air.
PADDING_HU = -1100


@dataclass(frozen=True, slots=True)
class AirScale:
    """Air and soft tissue in the volume's own numbers; HU levels are read between them."""

    air: float
    """-1000 HU."""
    tissue: float
    """0 HU and a little more."""

    def level(self, hu: float) -> int:
        """The volume's number for a level in HU."""
        return round(self.air + (hu + 1000.0) / 1000.0 * (self.tissue - self.air))

    def span(self, hu: float) -> float:
        """The volume's difference for a difference in HU."""
        return hu / 1000.0 * (self.tissue - self.air)


def air_scale(volume: Volume) -> AirScale:
    """The scale of a volume: HU where it is calibrated, else from its histogram."""
    return AirScale(-1000.0, 0.0) if volume.is_hu else _scale_from_histogram(volume.hu_zyx)


def lumen_threshold_from_histogram(volume: Volume) -> float:
    """Where the lumen ends, in a volume that is not in HU: a fifth of the way from its air to its soft tissue.

    That is -800 HU on a calibrated CT (see ``find_airways``). Air and soft tissue are the means below and above the
    threshold that parts the histogram best (Otsu 1979), the lower one taken at its dark end, because lung is dark too.

    Raises
    ------
    NoResultError
        If the volume has a single value.
    """
    return float(_scale_from_histogram(volume.hu_zyx).level(-800.0))


def _scale_from_histogram(values: NDArray[np.int16]) -> AirScale:
    # Every 5th voxel on each axis: a histogram does not need all.
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
