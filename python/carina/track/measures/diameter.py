"""Diameters of airways: of a branch, the narrowest of a branch, and the narrowest of a route.

A diameter is that of the circle with the area of the lumen across the airway, from the sections of
:func:`~carina.track.measure_tree`. No other value is called a diameter: :attr:`carina.track.Branch.radius` is the
radius of the lumen that the search found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line

__all__ = [
    "Diameter",
    "Passage",
    "branch_diameter",
    "narrowest_diameter",
    "narrowest_of_passages",
    "passage_of",
    "with_scatter",
]

Floats = NDArray[np.float64]

DEVIATIONS_95 = 1.96
"""Number of standard deviations on each side of a mean that contain 95 % of a normal distribution."""
SCATTER_SHARE = 0.5
"""Share of the 95 % interval of a branch's scatter that is added to its error; the model error contains the rest."""
NARROW_REACH_DIAMETERS = 0.5
"""Length before and after a point that a running median covers, in diameters."""
PASSAGE_ERROR = 0.03
"""Additional error of the passage of a branch, as a share of its diameter.

A section through a fork contains both lumens and so hides a narrowing there. (``carina_bench.plan_widths``: this
error raises the coverage in painted patients by 4 %.)
"""
LEAST_FOR_SCATTER = 5
"""Least number of sections from which their scatter is estimated."""


@one_line
@dataclass(frozen=True, slots=True)
class Diameter:
    """Diameter in mm, with half of an interval that is to contain the true value in 95 of 100 cases."""

    mm: float
    error_mm: float
    """Half of the 95 % interval of the diameter, mm."""
    branch_id: int | None = None
    """ID of the branch that contains the narrowest place; None for the diameter of a whole branch."""
    at_mm: float | None = None
    """Distance of the narrowest place along the branch ``branch_id``, mm."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """Largest diameter that can pass each point of one branch, along its centreline.

    The diameter at a point is the median over one diameter of the sections' least widths, or the value on which two
    sections agree, if it is below the median by more than the error. In a round lumen the least width is the
    diameter. At a fork and in a slit it is the narrow side, where the circle of equal area is wider than what
    passes.
    """

    branch_id: int
    at_mm: Floats
    """Distance (n,) of each point along the branch, mm."""
    diameter_mm: Floats
    """Passable diameter (n,) in mm."""
    error_mm: Floats
    """Half (n,) of an interval that is to contain the true value in 90 of 100 cases."""
    unmeasured: NDArray[np.intp]
    """Indices of centreline points without a section: drawn parts, bridges, the end of the CT, invisible walls."""

    def until(self, mm: float) -> Passage:
        """Return the passage up to a length along the branch, with the next section if there is none at that length.

        The first measured section of a branch may be some way beyond its start.
        """
        own = np.concatenate([[True], self.at_mm < mm - 1e-6])[: len(self.at_mm)]
        return Passage(self.branch_id, self.at_mm[own], self.diameter_mm[own], self.error_mm[own], self.unmeasured)


def passage_of(
    branch_id: int,
    at_mm: Floats,
    equivalent: tuple[Floats, Floats],
    least: tuple[Floats, Floats],
    *,
    is_measured: NDArray[np.bool_],
    at_junction: NDArray[np.bool_],
    has_fork: bool,
) -> Passage:
    """Return the passage of a branch from its sections, all (n,).

    At the start of a branch, inside the lumen of the parent, oblique sections contain both lumens and are not used.
    At its end, in a fork, their least width is that of the branch. A branch so short that it has no other sections
    gets the mean of both figures, with half of their difference as an additional error.

    Parameters
    ----------
    branch_id
        ID of the branch.
    at_mm
        Distance along the branch.
    equivalent, least
        Diameters of equal area and least widths, each with its error.
    is_measured
        Whether there is a section.
    at_junction
        Whether the section cuts through a fork.
    has_fork
        Whether the branch ends in a fork.
    """
    (equal_mm, equal_error_mm), (least_mm, least_error_mm) = equivalent, least
    unmeasured = np.flatnonzero(~is_measured)
    narrow_mm = np.fmin(equal_mm, least_mm)
    used = is_measured & ~at_junction
    alone = used if used.any() else is_measured
    if not alone.any():
        none = np.empty(0)
        return Passage(branch_id, none, none, none, unmeasured)
    middle = float(np.median(equal_mm[alone]))
    if has_fork:
        used = is_measured & (~at_junction | (at_mm[-1] - at_mm <= middle))
    if used.any():
        # Noise makes a round lumen look flat: the narrow side is only used beyond its error.
        value = np.where(at_junction, narrow_mm, np.fmin(equal_mm, least_mm + least_error_mm))
        error = np.where(at_junction, np.fmax(equal_error_mm, least_error_mm), equal_error_mm)
    else:
        used = is_measured
        value = 0.5 * (equal_mm + narrow_mm)
        error = equal_error_mm + 0.5 * (equal_mm - narrow_mm)
    at, value, error = at_mm[used], value[used], error[used]
    near = np.abs(at[:, None] - at[None, :]) <= NARROW_REACH_DIAMETERS * float(np.median(value))
    rows = [np.sort(value[row]) for row in near]
    medians = np.array([np.median(row) for row in rows])
    model = np.array([np.median(error[row]) for row in near])
    # One narrow section may be an error. Two beyond the error are a narrowing that is too short for the median.
    agreed = np.array([row[min(1, len(row) - 1)] for row in rows])
    diameter = np.fmin(medians, np.fmax(agreed + model, value))
    dip = diameter - np.fmin(diameter, np.array([row[0] for row in rows]))
    whole = np.sqrt(np.square(model) + np.square(dip) + np.square(PASSAGE_ERROR * diameter))
    return Passage(branch_id, at, diameter, whole, unmeasured)


def narrowest_of_passages(passages: Sequence[Passage]) -> Diameter | None:
    """Return the narrowest diameter of a route from the passages of its branches; None if nothing was measured.

    The error of the diameter also covers every other place that may be narrower, that is, whose diameter less its
    error is smaller.
    """
    places = [one for one in passages if len(one.at_mm)]
    if not places:
        return None
    diameter = np.concatenate([one.diameter_mm for one in places])
    error = np.concatenate([one.error_mm for one in places])
    branch = np.concatenate([np.full(len(one.at_mm), one.branch_id) for one in places])
    at = np.concatenate([one.at_mm for one in places])
    least = int(np.argmin(diameter))
    return Diameter(
        float(diameter[least]),
        float(diameter[least] - (diameter - error).min()),
        int(branch[least]),
        float(at[least]),
    )


def with_scatter(at_mm: Floats, diameter_mm: Floats, error_mm: Floats, usable: NDArray[np.bool_]) -> Floats:
    """Return the errors (n,) of single sections: the model errors plus the scatter of the usable sections.

    The scatter is estimated robustly, so that a narrowing does not count as scatter.
    """
    return error_mm + DEVIATIONS_95 * _robust_scatter_mm(at_mm[usable], diameter_mm[usable])


def branch_diameter(at_mm: Floats, diameter_mm: Floats, error_mm: Floats) -> Diameter | None:
    """Return the median diameter of a branch from its usable sections, all (n,); None without any.

    Neighbouring sections share their voxels and the blur, so their model errors do not average out. The scatter of
    the sections about a straight taper averages out, by the number of sections that are one diameter apart.
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

    The narrowest diameter is the smallest running median, because the smallest section would be the one with the
    largest error. The error is that of a single section.
    """
    if not len(at_mm):
        return None
    reach = NARROW_REACH_DIAMETERS * float(np.median(diameter_mm))
    near = np.abs(at_mm[:, None] - at_mm[None, :]) <= reach
    medians = np.array([np.median(diameter_mm[row]) for row in near])
    least = int(np.argmin(medians))
    return Diameter(float(medians[least]), float(np.median(error_mm[near[least]])), branch_id, float(at_mm[least]))


def _scatter_mm(at_mm: Floats, diameter_mm: Floats) -> float:
    """Return the standard deviation in mm of diameters about their straight line; 0 for fewer than three diameters."""
    if len(at_mm) < 3 or np.ptp(at_mm) <= 0.0:
        return 0.0
    line = np.polynomial.Polynomial.fit(at_mm, diameter_mm, 1)
    return float(np.std(diameter_mm - line(at_mm)))


def _robust_scatter_mm(at_mm: Floats, diameter_mm: Floats) -> float:
    """Return the standard deviation in mm of diameters about a straight line, from the median deviation.

    0 for few sections.
    """
    if len(at_mm) < LEAST_FOR_SCATTER or np.ptp(at_mm) <= 0.0:
        return 0.0
    one, other = np.triu_indices(len(at_mm), k=1)
    run = at_mm[other] - at_mm[one]
    slope = float(np.median((diameter_mm[other] - diameter_mm[one])[run != 0.0] / run[run != 0.0]))
    rest = diameter_mm - slope * at_mm
    return 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
