"""Size of a chest relative to an adult's, measured on the trachea; the search multiplies its lengths by the size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.tree.uncertainty import THREAD_SHARE
from carina.volume.model import Volume

ADULT_MM = 16.0
"""Minimum diameter in mm of an adult's trachea; with a smaller one, the lengths of the search are reduced."""
WIDE_PART = 75.0
"""Percentile of the trachea's diameters that counts as its width, so that a stenosis has no effect."""
# Distance in voxels by which the measured edge of an air space lies inside the true wall (phantoms, voxels of 0.8 to 4
# mm).
EDGE_VOXELS = 0.5
# Minimum size of a chest relative to an adult's: a trachea of 4 mm is that of a newborn.
MIN_SIZE = 0.25
# Maximum and usual length in mm of an adult's trachea; both are larger for a trachea that is wider than usual, by at
# most the factor ``MAX_LONGER``.
LONGEST_TRACHEA_MM, USUAL_TRACHEA_MM = 150.0, 110.0
# Usual diameter of an adult's trachea, mm.
USUAL_DIAMETER_MM = 17.3
# Maximum factor by which a trachea that is wider than usual is expected to be longer than usual.
MAX_LONGER = 1.2
# Reduction of the chest's size over which the confidence of the thinnest airways falls to UNPROVEN_THREAD; this
# confidence was measured in adults only.
THREAD_FALL = 0.04
# Confidence of the thinnest airways in chests that are much smaller than an adult's.
UNPROVEN_THREAD = 0.5


def search_size(volume: Volume, diameters_mm: NDArray[np.float64]) -> float:
    """Return the size of the chest relative to an adult's: 1 if the trachea has :data:`ADULT_MM` or more, else less.

    The search for small airways compares the lumen with the tissue within fixed distances. In a smaller chest the
    neighbouring vessels are within these distances and look like the wall of an airway.

    Parameters
    ----------
    volume
        The CT.
    diameters_mm
        (n,) equivalent diameter of the trachea in each of its slices.
    """
    if not len(diameters_mm):
        return 1.0
    voxel_mm = sorted(volume.spacing_mm)[1]
    wide_mm = float(np.percentile(diameters_mm, WIDE_PART)) + EDGE_VOXELS * voxel_mm
    return float(np.clip(wide_mm / ADULT_MM, MIN_SIZE, 1.0))


def _lower_diameter(diameter_mm: float) -> float:
    return float(np.clip(diameter_mm / USUAL_DIAMETER_MM, 1.0, MAX_LONGER))


def longest_trachea_mm(diameter_mm: float) -> float:
    """Return the maximum length in mm of a trachea of this diameter, from the carina to the vocal cords.

    Examples
    --------
    >>> longest_trachea_mm(16.0), longest_trachea_mm(25.0)
    (150.0, 180.0)
    """
    return LONGEST_TRACHEA_MM * _lower_diameter(diameter_mm)


def usual_trachea_mm(diameter_mm: float) -> float:
    """Return the height above the carina at which most tracheas of this diameter begin, mm."""
    return USUAL_TRACHEA_MM * _lower_diameter(diameter_mm)


def thread_confidence(size: float) -> float:
    """Return the confidence of the thinnest airways (whose wall the CT does not show) in a chest of this size.

    Examples
    --------
    >>> thread_confidence(1.0), thread_confidence(0.8)
    (0.95, 0.5)
    """
    fall = min((1.0 - size) / THREAD_FALL, 1.0)
    return round(THREAD_SHARE - (THREAD_SHARE - UNPROVEN_THREAD) * fall, 3)
