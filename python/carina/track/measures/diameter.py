"""The diameter of an airway: of a branch, and the narrowest one of a branch.

A diameter is that of the circle with the area of the lumen across the airway, from the sections of
:func:`~carina.track.measure_tree`. Nothing else is called a diameter: :attr:`carina.track.Branch.radius` is the radius
of the lumen that the search found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line

__all__ = ["Diameter", "branch_diameter", "narrowest_diameter", "with_scatter"]

Floats = NDArray[np.float64]

DEVIATIONS_95 = 1.96
"""Standard deviations on each side of a mean that hold 95 % of a normal distribution."""
SCATTER_SHARE = 0.5
"""Share of the 95 % interval of a branch's scatter that is added to its error; the error by the model has the rest."""
NARROW_REACH_DIAMETERS = 0.5
"""The narrowest diameter is the least median of the sections within this many diameters before and behind a place."""
LEAST_FOR_SCATTER = 5
"""Fewer sections do not tell how much they scatter."""


@one_line
@dataclass(frozen=True, slots=True)
class Diameter:
    """A diameter, mm, with half of an interval meant to hold the truth in 95 of 100 cases."""

    mm: float
    error_mm: float
    branch_id: int | None = None
    """The branch in which the narrowest place is; None for the diameter of a whole branch."""
    at_mm: float | None = None
    """Way along that branch to the narrowest place."""


def with_scatter(at_mm: Floats, diameter_mm: Floats, error_mm: Floats, usable: NDArray[np.bool_]) -> Floats:
    """Return the errors (n,) of single sections: those by the model, with the scatter of the branch's usable sections.

    The scatter is robust, so that a narrowing does not count as scatter.
    """
    return error_mm + DEVIATIONS_95 * _robust_scatter_mm(at_mm[usable], diameter_mm[usable])


def branch_diameter(at_mm: Floats, diameter_mm: Floats, error_mm: Floats) -> Diameter | None:
    """Return the median diameter of a branch from its usable sections, all (n,); None without any.

    Neighbouring sections share their voxels and the blur, so their errors by the model do not average out. What they
    scatter about a straight taper averages out, by the number of sections that are one diameter apart.
    """
    if not len(at_mm):
        return None
    middle = float(np.median(diameter_mm))
    by_model = float(np.median(error_mm)) - DEVIATIONS_95 * _robust_scatter_mm(at_mm, diameter_mm)
    independent = max(1.0, float(np.ptp(at_mm)) / middle)
    scatter = _scatter_mm(at_mm, diameter_mm) / np.sqrt(independent)
    return Diameter(middle, float(max(by_model, 0.0) + SCATTER_SHARE * DEVIATIONS_95 * scatter))


def narrowest_diameter(
    at_mm: Floats, diameter_mm: Floats, error_mm: Floats, *, branch_id: int | None = None
) -> Diameter | None:
    """Return the narrowest diameter of a branch from its usable sections, all (n,); None without any.

    It is the least of running medians: the least section would be the one with the largest error. Its error is that of
    a single section.
    """
    if not len(at_mm):
        return None
    reach = NARROW_REACH_DIAMETERS * float(np.median(diameter_mm))
    near = np.abs(at_mm[:, None] - at_mm[None, :]) <= reach
    medians = np.array([np.median(diameter_mm[row]) for row in near])
    least = int(np.argmin(medians))
    return Diameter(float(medians[least]), float(np.median(error_mm[near[least]])), branch_id, float(at_mm[least]))


def _scatter_mm(at_mm: Floats, diameter_mm: Floats) -> float:
    """Return the standard deviation of diameters about their straight line; 0 for fewer than three."""
    if len(at_mm) < 3 or np.ptp(at_mm) <= 0.0:
        return 0.0
    line = np.polynomial.Polynomial.fit(at_mm, diameter_mm, 1)
    return float(np.std(diameter_mm - line(at_mm)))


def _robust_scatter_mm(at_mm: Floats, diameter_mm: Floats) -> float:
    """Return the standard deviation about a straight line by the median deviation; 0 for few sections."""
    if len(at_mm) < LEAST_FOR_SCATTER or np.ptp(at_mm) <= 0.0:
        return 0.0
    one, other = np.triu_indices(len(at_mm), k=1)
    run = at_mm[other] - at_mm[one]
    slope = float(np.median((diameter_mm[other] - diameter_mm[one])[run != 0.0] / run[run != 0.0]))
    rest = diameter_mm - slope * at_mm
    return 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
