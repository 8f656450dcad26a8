"""The diameter of an airway: of a branch, and the narrowest one of a branch or of the way to a place.

A diameter is that of the circle with the area of the lumen across the airway, from the sections of
:func:`~carina.track.measure_tree`. Nothing else is called a diameter: :attr:`carina.track.Branch.radius` is the radius
of the lumen that the search found.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line

if TYPE_CHECKING:
    from carina.track.measures.tree import BranchMeasures, TreeMeasures

__all__ = ["Diameter", "branch_diameter", "narrowest_diameter", "narrowest_of_route"]

Floats = NDArray[np.float64]

DEVIATIONS_95 = 1.96
"""Standard deviations on each side of a mean that hold 95 % of a normal distribution."""
SCATTER_SHARE = 0.5
"""Share of the scatter's 95 % interval that is added: the error of a section already contains a part of it."""
NARROW_REACH_DIAMETERS = 0.5
"""The narrowest diameter is the least median of the sections within this many diameters before and behind a place."""


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


def branch_diameter(at_mm: Floats, diameter_mm: Floats, error_mm: Floats) -> Diameter | None:
    """Return the median diameter of a branch from its usable sections, all (n,); None without any.

    Neighbouring sections share their voxels and the blur, so their errors do not average out. What they scatter about
    a straight taper is added to the error, by the number of sections that are one diameter apart: forks and vessels
    that disturb a section also shift its neighbours.
    """
    if not len(at_mm):
        return None
    middle = float(np.median(diameter_mm))
    scatter = _scatter_mm(at_mm, diameter_mm) / np.sqrt(_independent(at_mm, middle))
    return Diameter(middle, float(np.median(error_mm) + SCATTER_SHARE * DEVIATIONS_95 * scatter))


def narrowest_diameter(
    at_mm: Floats, diameter_mm: Floats, error_mm: Floats, *, branch_id: int | None = None
) -> Diameter | None:
    """Return the narrowest diameter of a branch from its usable sections, all (n,); None without any.

    It is the least of running medians: the least section would be the one with the largest error.
    """
    if not len(at_mm):
        return None
    reach = NARROW_REACH_DIAMETERS * float(np.median(diameter_mm))
    near = np.abs(at_mm[:, None] - at_mm[None, :]) <= reach
    medians = np.array([np.median(diameter_mm[row]) for row in near])
    least = int(np.argmin(medians))
    beside = diameter_mm[near[least]]
    scatter = float(beside.std()) / np.sqrt(2.0)
    error = float(np.median(error_mm[near[least]]) + SCATTER_SHARE * DEVIATIONS_95 * scatter)
    return Diameter(float(medians[least]), error, branch_id, float(at_mm[least]))


def narrowest_of_route(
    measures: TreeMeasures, branch_ids: Iterable[int], until_mm: float | None = None
) -> Diameter | None:
    """Return the narrowest diameter of the branches of a route; None if none of their sections is usable.

    Parameters
    ----------
    measures
        Of the tree that the route runs in.
    branch_ids
        The branches of the route, from the trachea.
    until_mm
        Way along the last branch to the end of the route; None for its tip.
    """
    ids = list(branch_ids)
    found = [
        _narrowest_of(measures.of(branch_id), until_mm if branch_id == ids[-1] else None)
        for branch_id in dict.fromkeys(ids)
    ]
    return min((one for one in found if one is not None), key=lambda one: one.mm, default=None)


def _narrowest_of(branch: BranchMeasures, until_mm: float | None) -> Diameter | None:
    used = branch.is_usable
    if until_mm is not None:
        used = used & (branch.at_mm <= until_mm)
    return narrowest_diameter(
        branch.at_mm[used], branch.equivalent_mm[used], branch.equivalent_error_mm[used], branch_id=branch.branch_id
    )


def _scatter_mm(at_mm: Floats, diameter_mm: Floats) -> float:
    """Return the standard deviation of diameters about their straight line; 0 for fewer than three."""
    if len(at_mm) < 3 or np.ptp(at_mm) <= 0.0:
        return 0.0
    line = np.polynomial.Polynomial.fit(at_mm, diameter_mm, 1)
    return float(np.std(diameter_mm - line(at_mm)))


def _independent(at_mm: Floats, diameter_mm: float) -> float:
    """Return how many sections are one diameter apart, at least 1."""
    return max(1.0, float(np.ptp(at_mm)) / diameter_mm)
