"""Reduction of the points of a line to points at least a given distance apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

POINT_EVERY_MM = 0.8
"""Minimum distance in mm of the sent points of a live path; less than a pixel in any view of the whole path."""


def thinned(points: NDArray[np.float64], every_mm: float = POINT_EVERY_MM) -> NDArray[np.float64]:
    """Return points (n, 3) of a line that are a minimum distance apart along it; both ends are retained."""
    if len(points) < 3:
        return points
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    steps = np.floor(along / every_mm)
    indices = np.flatnonzero(np.diff(steps, prepend=-1.0) > 0)
    left: NDArray[np.float64] = points[np.unique(np.append(indices, len(points) - 1))]
    return left
