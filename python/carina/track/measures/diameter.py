"""Diameters of airways: of a branch, the narrowest of a branch, and the narrowest of a route.

A diameter is that of the circle with the area of the lumen across the airway, from the sections of
:func:`~carina.track.measure_tree`. No other value is called a diameter: :attr:`carina.track.Branch.radius` is the
radius of the lumen that the search found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line

Floats = NDArray[np.float64]

DEVIATIONS_95 = 1.96
"""Number of standard deviations on each side of a mean that contain 95 % of a normal distribution."""
SCATTER_SHARE = 0.5
"""Share of the scatter (95 % interval) that is added to a branch's error; the model error already contains the rest."""
NARROW_REACH_DIAMETERS = 0.5
"""Half length, in airway diameters, of the window of the running median that removes single wrong diameters."""
SECTION_ERROR = 1.645 / DEVIATIONS_95
"""Factor from a half 95 % interval (stated for sections) to a half 90 % interval (stated for passages)."""
PASSAGE_ERROR = 0.03
"""Additional error of a passage (widest instrument that passes), as a share of its diameter
(``carina_bench.plan_widths``)."""
FORK_ERROR = 0.05
"""Additional error of a passage whose sections all cut through a fork, as a share of its diameter.

A section through a fork contains both lumens and so hides a narrowing there. (Calibrated:
``carina_bench.plan_widths``.)
"""
MOUTH_ERROR = 0.06
"""Additional error of passages at the start of a branch after a fork, as a share of their diameter.

Sections there also contain the parent's lumen. The value is calibrated: ``carina_bench.plan_widths``.
"""
CUT_ERROR = 0.06
"""Additional error of a section that the end of the CT cuts, as a share of its diameter."""
SHOWN_MM = 1.5
"""Distance in mm on each side of a section over which the section describes the airway (docs/decisions/0117)."""
START_MM = 10.0
"""Length in mm at the start of the first branch that no route uses, because the CT may cut the trachea there."""
MEDIAN_VARIANCE = 0.5 * np.pi
"""Variance of a median of many normal values, as a multiple of the variance of their mean."""
MAX_CORRELATION = 0.9
"""Upper limit of the correlation of neighbouring sections; a running median cannot estimate a larger one."""
MIN_FOR_SCATTER = 5
"""Minimum number of measured sections from which the scatter of the diameters is estimated."""


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
    """Distance of the narrowest place from the start of the branch ``branch_id``, mm."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """Diameter of the widest instrument that can pass each point of one branch, along its centreline.

    The diameter at a point is the median over one diameter of the sections' least widths, or the value on which two
    sections agree, if it is below the median by more than the error. In a round lumen the least width is the
    diameter. At a fork and in a slit it is the narrow side, where the circle of equal area is wider than what
    passes. The least of many noisy medians is too small on average; therefore the spread of the medians that noise
    causes is removed, so that the expected least median is the least true diameter.
    """

    branch_id: int
    at_mm: Floats
    """Distance (n,) of each point from the start of the branch, mm."""
    diameter_mm: Floats
    """Largest diameter (n,) in mm of a round instrument that passes each point."""
    error_mm: Floats
    """Half (n,) of an interval in mm that should contain the true value in 90 of 100 cases."""
    unmeasured: NDArray[np.intp]
    """Indices of centreline points without a cross-section: there is no visible wall, or the CT ends, or a user
    added the branch."""
    length_mm: float
    """Length of the branch, mm."""

    def without_start(self) -> Passage:
        """Return the passage of the first branch without its first part, where the CT may cut the trachea.

        Missing sections count only if no section is left, because they may be missing at both ends of the trachea.
        """
        is_beyond_start = self.at_mm >= min(START_MM, self.length_mm)
        unmeasured = self.unmeasured[:0] if is_beyond_start.any() else self.unmeasured
        return replace(
            self,
            at_mm=self.at_mm[is_beyond_start],
            diameter_mm=self.diameter_mm[is_beyond_start],
            error_mm=self.error_mm[is_beyond_start],
            unmeasured=unmeasured,
        )

    def until(self, mm: float) -> Passage:
        """Return the passage up to a length along the branch, with the next section if there is none at that length.

        The first measured section of a branch may be some way beyond its start.
        """
        is_before = np.concatenate([[True], self.at_mm < mm - 1e-6])[: len(self.at_mm)]
        return replace(
            self,
            at_mm=self.at_mm[is_before],
            diameter_mm=self.diameter_mm[is_before],
            error_mm=self.error_mm[is_before],
        )


def passage_of(
    branch_id: int,
    at_mm: Floats,
    equivalent: tuple[Floats, Floats],
    least: tuple[Floats, Floats],
    *,
    is_measured: NDArray[np.bool_],
    at_junction: NDArray[np.bool_],
    is_cut: NDArray[np.bool_],
    has_fork: bool,
    parent_mm: float,
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
    is_cut
        Whether the end of the CT cuts off a part of the section. The diameter is that of the circle through the rest of
        the wall, with an additional error.
    has_fork
        Whether the branch ends in a fork.
    parent_mm
        Diameter of the parent, within which the branch may have no wall; 0 for a branch without a parent.
    """
    (equal_mm, equal_error_mm), (least_mm, least_error_mm) = (
        (mm, SECTION_ERROR * wide) for mm, wide in (equivalent, least)
    )
    # A section shows the airway beside it, so a single missing section leaves no gap.
    gap = np.abs(at_mm[:, None] - at_mm[None, is_measured]).min(axis=1, initial=np.inf)
    is_missing = ~is_measured & (gap > SHOWN_MM)
    narrow_mm = np.fmin(equal_mm, least_mm)
    is_own = is_measured & ~at_junction
    alone = is_own if is_own.any() else is_measured
    if not alone.any():
        none = np.empty(0)
        return Passage(branch_id, none, none, none, np.flatnonzero(is_missing), float(at_mm[-1]))
    middle = float(np.median(equal_mm[alone]))
    # The start of a branch is inside the lumen of its parent, where the branch has no wall.
    is_start = (at_mm < at_mm[alone][0]) & (at_mm <= max(parent_mm, middle))
    unmeasured = np.flatnonzero(is_missing & ~is_start)
    if is_own.any():
        used = is_own | (is_measured & has_fork & (at_mm[-1] - at_mm <= middle))
        # Noise makes a round lumen look flat: the narrow side is only used beyond its error.
        value = np.where(at_junction, narrow_mm, np.fmin(equal_mm, least_mm + least_error_mm))
        error = np.where(at_junction, np.fmax(equal_error_mm, least_error_mm), equal_error_mm)
    else:
        used = is_measured
        value = 0.5 * (equal_mm + narrow_mm)
        error = equal_error_mm + 0.5 * (equal_mm - narrow_mm)
    error = np.where(is_cut, np.hypot(error, CUT_ERROR * equal_mm), error)
    at, value, error, is_fork = at_mm[used], value[used], error[used], at_junction[used]
    near = np.abs(at[:, None] - at[None, :]) <= NARROW_REACH_DIAMETERS * float(np.median(value))
    rows = [np.sort(value[row]) for row in near]
    medians = np.array([_median_of_sorted(row) for row in rows])
    model = np.array([_median_of_sorted(np.sort(error[row])) for row in near])
    medians = _with_true_spread(at, value, medians, near, ~is_fork)
    fork_share = np.array([is_fork[row].mean() for row in near])
    # One narrow section may be an error. Two that are narrow beyond their error are a short narrowing, which the
    # running median would hide.
    agreed = np.array([row[min(1, len(row) - 1)] for row in rows])
    diameter = np.fmin(medians, np.fmax(agreed + model / SECTION_ERROR, value))
    dip = diameter - np.fmin(diameter, np.array([row[0] for row in rows]))
    first_mm = float(at_mm[alone][0])
    is_mouth = is_own.any() & (first_mm > 0.0) & (at <= first_mm + middle)
    share = np.hypot(PASSAGE_ERROR + FORK_ERROR * fork_share, MOUTH_ERROR * is_mouth)
    whole = np.sqrt(np.square(model) + np.square(dip) + np.square(share * diameter))
    return Passage(branch_id, at, diameter, whole, unmeasured, float(at_mm[-1]))


def _median_of_sorted(values: Floats) -> float:
    """Return the median of sorted finite values, bit for bit that of `numpy.median`, which takes ten times as long."""
    half = len(values) // 2
    return float(values[half]) if len(values) % 2 else 0.5 * float(values[half - 1] + values[half])


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
    mm, error_mm = least_with_error(diameter, error)
    least = int(np.argmin(diameter))
    return Diameter(mm, error_mm, int(branch[least]), float(at[least]))


def least_with_error(diameter_mm: Sequence[float] | Floats, error_mm: Sequence[float] | Floats) -> tuple[float, float]:
    """Return the smallest diameter and an error that also covers other places which may be narrower, mm.

    A place may be narrower if its diameter less its error is smaller.
    """
    least = float(np.min(diameter_mm))
    return least, least - float(np.min(np.subtract(diameter_mm, error_mm)))


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


def _with_true_spread(
    at_mm: Floats, section_mm: Floats, median_mm: Floats, near: NDArray[np.bool_], usable: NDArray[np.bool_]
) -> Floats:
    """Return running medians (n,) whose spread about the branch's taper is that of the true diameters, mm.

    Noise adds to the spread of the medians, so the least of them is too small. Each median is moved towards the line
    of the taper by the square root of the share of the variance that is not noise. The moved values have the variance
    of the true diameters, so their expected minimum is the minimum of the true diameters (constrained empirical Bayes
    estimates, Louis 1984 and Ghosh 1992). The variance of a median by noise follows from the deviations of the
    sections from it, and from the correlation of neighbouring deviations, because neighbouring sections share voxels.
    A narrowing far beyond the noise is not changed.

    Parameters
    ----------
    at_mm
        Distance (n,) of the sections along the branch.
    section_mm, median_mm
        Diameters (n,) of the sections and their running medians.
    near
        Flags (n, n): the sections of each running median.
    usable
        Flags (n,): sections away from forks. Other medians stay.
    """
    rows = np.flatnonzero(usable)
    rest = section_mm[rows] - median_mm[rows]
    if len(rows) < MIN_FOR_SCATTER or np.ptp(at_mm[rows]) <= 0.0 or not rest.any():
        return median_mm
    num = float(np.median(near[np.ix_(rows, rows)].sum(axis=1)))
    if num < 2.0:
        return median_mm
    # Deviations of 0 are left out: a section that is itself the running median does not show the noise.
    deviation = 1.4826 * float(np.median(np.abs(rest[rest != 0.0])))
    variance = np.square(deviation) * num / (num - 1.0)
    scale = float(np.sqrt(np.sum(np.square(rest[:-1])) * np.sum(np.square(rest[1:]))))
    correlation = float(np.sum(rest[:-1] * rest[1:])) / scale if scale > 0.0 else 0.0
    correlation = min(max(correlation, 0.0), MAX_CORRELATION)
    num_independent = max(1.0, num * (1.0 - correlation) / (1.0 + correlation))
    noise = MEDIAN_VARIANCE * variance / num_independent
    line = np.polynomial.Polynomial.fit(at_mm[rows], median_mm[rows], 1)(at_mm[rows])
    spread = float(np.mean(np.square(median_mm[rows] - line)))
    found: Floats = median_mm.copy()
    if spread > 0.0:
        found[rows] = line + np.sqrt(max(1.0 - noise / spread, 0.0)) * (median_mm[rows] - line)
    return found


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
    if len(at_mm) < MIN_FOR_SCATTER or np.ptp(at_mm) <= 0.0:
        return 0.0
    one, other = np.triu_indices(len(at_mm), k=1)
    run = at_mm[other] - at_mm[one]
    slope = float(np.median((diameter_mm[other] - diameter_mm[one])[run != 0.0] / run[run != 0.0]))
    rest = diameter_mm - slope * at_mm
    return 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
