"""Summary of one branch: mean and least lumen, taper, and a narrowing relative to the healthy diameter."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.track.measures.diameter import branch_diameter, narrowest_diameter

Floats = NDArray[np.float64]

HEALTHY_SHARE = 0.9
"""Minimum diameter of a healthy section, as a share of the diameter of the branch's wide part."""
WIDE_PERCENTILE = 80.0
MIN_HEALTHY_MM = 3.0
"""Minimum length in mm of healthy branch on one side of a narrowing for it to be the reference."""
MURRAY_POWER = 3.0
"""Exponent of Murray's law (1926): the cubes of the diameters of two branches add up to that of their parent."""
NEIGHBOURS_ERROR = 0.15
"""Standard deviation of airway diameters from Murray's law, as a share of the diameter."""
EQUAL_DAUGHTER = 2.0 ** (-1.0 / MURRAY_POWER)
"""Ratio of the diameter of each of two equal daughter branches to their parent's, by Murray's law."""
DIAMETERS_TO_FORK = 3.0
"""Mean length of an airway between two forks, in diameters (Weibel 1963)."""
DEVIATIONS_95 = 1.96
"""Number of standard deviations on each side of a mean that contain 95 % of a normal distribution."""
SECTION_REACH_MM = 1.5
"""Distance in mm above and below the plane of a section from which blur and voxel size mix values into it."""


@one_line
@dataclass(frozen=True, slots=True)
class Stenosis:
    """Narrowest place of a branch relative to its healthy surroundings."""

    percent: float
    """Reduction of the diameter relative to the reference: 0 is healthy, 100 closed; below 0 it is wider."""
    percent_error: float
    """Half of the 95 % interval of ``percent``."""
    area_percent: float
    """Reduction of the area relative to the reference's area, in percent."""
    at_mm: float
    """Distance of the narrowest place from the start of the branch, mm."""
    min_mm: float
    """Equivalent diameter at the narrowest place, mm."""
    reference_mm: float
    """Expected healthy diameter at the narrowest place, mm."""
    reference_from: str
    """Source of the reference: ``branch``, its own healthy parts, or ``neighbours``, its parent, siblings and children.
    """

    @property
    def exceeds_error(self) -> bool:
        """Whether the stenosis is reported: 0 % (healthy) is below its 95 % interval."""
        return self.percent > self.percent_error

    def to_json(self) -> dict[str, Any]:
        """Return the stenosis as JSON values."""
        return {name: _rounded(value) for name, value in dataclasses.asdict(self).items()}


@one_line
@dataclass(frozen=True, slots=True)
class ReferenceDiameter:
    """Diameter that the lumen of a healthy branch would have at one place, with its error and source."""

    mm: float
    """Diameter in mm that a healthy branch would have at the place."""
    error: float
    """Half of the 95 % interval of the diameter, as a share of ``mm``."""
    source: str
    """Origin of the expected diameter, with the values of :attr:`Stenosis.reference_from`."""


@one_line
@dataclass(frozen=True, slots=True)
class BranchSummary:
    """Summary of a branch over its sections that are away from forks and from the faces of the volume.

    A value is None if there is no such section.
    """

    length_mm: float = 0.0
    """Length of the branch's centreline, mm."""
    angle_deg: float | None = None
    """Angle to the parent in degrees (0: straight on), between chords of two diameters on both sides of the fork."""
    num_sections: int = 0
    """Number of measured sections on which the summary is based."""
    mean_mm: float | None = None
    """Diameter of the branch (:mod:`carina.track.measures.diameter`), mm: the median.

    In measurements of earlier versions it is the mean.
    """
    mean_error_mm: float | None = None
    """Error of ``mean_mm``: half of a 95 % interval, mm."""
    min_mm: float | None = None
    """Narrowest diameter, mm: the smallest running median.

    In measurements of earlier versions it is the smallest section.
    """
    min_error_mm: float | None = None
    """Error of ``min_mm`` (half of a 95 % interval), mm; None in measurements of earlier versions."""
    min_at_mm: float | None = None
    """Distance of the narrowest place from the start of the branch, mm; None if the lumen was not measured."""
    taper: float | None = None
    """Change of the equivalent diameter per mm of length (mm/mm); below 0 if the branch narrows."""
    wall_mm: float | None = None
    """Median thickness of the branch's wall, mm; None if not measured."""
    wall_error_mm: float | None = None
    """Error of ``wall_mm``: half of a 95 % interval, mm."""
    measured_stenosis: Stenosis | None = dataclasses.field(default=None, repr=False)
    """Stenosis as measured or read from a file; None if there is none.

    Case files of earlier versions also contain stenoses within their errors: use ``stenosis``.
    """

    @property
    def stenosis(self) -> Stenosis | None:
        """Stenosis that is reported; None if it does not exceed its error."""
        own = self.measured_stenosis
        return own if own is not None and own.exceeds_error else None

    def to_json(self) -> dict[str, Any]:
        """Return the summary as JSON values."""
        values = {
            field.name: _rounded(getattr(self, field.name))
            for field in dataclasses.fields(self)
            if field.name != "measured_stenosis"
        }
        return {**values, "stenosis": None if self.stenosis is None else self.stenosis.to_json()}


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value


def summary_of(
    at_mm: Floats,
    equivalent: tuple[Floats, Floats],
    wall: tuple[Floats, Floats],
    usable: NDArray[np.bool_],
    *,
    angle_deg: float | None,
    stenosis: Stenosis | None,
) -> BranchSummary:
    """Return the summary of a branch from its sections, all (n,).

    Parameters
    ----------
    at_mm
        Distance along the branch.
    equivalent, wall
        Diameters and wall thicknesses, each with its errors, mm.
    usable
        Whether a section is used.
    angle_deg
        Angle to the parent.
    stenosis
        Stenosis of the branch, if measured.
    """
    (equivalent_mm, error_mm), (wall_mm, wall_error_mm) = equivalent, wall
    length = float(at_mm[-1])
    if not usable.any():
        return BranchSummary(length_mm=length, angle_deg=angle_deg)
    used = (at_mm[usable], equivalent_mm[usable], error_mm[usable])
    whole, narrowest = branch_diameter(*used), narrowest_diameter(*used)
    assert whole is not None and narrowest is not None
    walls = usable & np.isfinite(wall_mm)
    return BranchSummary(
        length_mm=length,
        angle_deg=angle_deg,
        num_sections=int(usable.sum()),
        mean_mm=whole.mm,
        mean_error_mm=whole.error_mm,
        min_mm=narrowest.mm,
        min_error_mm=narrowest.error_mm,
        min_at_mm=narrowest.at_mm,
        taper=_slope(used[0], used[1]),
        wall_mm=float(np.median(wall_mm[walls])) if walls.any() else None,
        wall_error_mm=float(np.median(wall_error_mm[walls])) if walls.any() else None,
        measured_stenosis=stenosis,
    )


def _slope(at: Floats, values: Floats) -> float | None:
    """Return the median slope of all pairs of values (Theil 1950, Sen 1968); None over less than 5 mm or 5 sections."""
    if len(at) < 5 or at[-1] - at[0] < 5.0:
        return None
    one, other = np.triu_indices(len(at), k=1)
    return float(np.median((values[other] - values[one]) / (at[other] - at[one])))


def diameter_by_neighbours(
    parent_mm: float | None, siblings_mm: Sequence[float | None], children_mm: Sequence[float | None]
) -> ReferenceDiameter | None:
    """Return the diameter that a branch should have by Murray's law: from parent and siblings, from children, or both.

    Returns None if neither side is fully measured, and for a branch without children, because a bronchus that the
    search did not find may be missing among its siblings.
    """
    logs, errors = [], []
    if not children_mm:
        return None
    if parent_mm is not None and siblings_mm and all(sibling is not None for sibling in siblings_mm):
        whole = parent_mm**MURRAY_POWER
        rest = whole - sum(float(s or 0.0) ** MURRAY_POWER for s in siblings_mm)
        if rest > 0.0:
            logs.append(np.log(rest) / MURRAY_POWER)
            # The error is relative to the difference of cubes, which has the full error of the parent's cube.
            errors.append(NEIGHBOURS_ERROR * whole / rest)
    if all(child is not None for child in children_mm):
        logs.append(np.log(sum(float(c or 0.0) ** MURRAY_POWER for c in children_mm)) / MURRAY_POWER)
        errors.append(NEIGHBOURS_ERROR)
    if not logs:
        return None
    error = DEVIATIONS_95 * float(np.linalg.norm(errors)) / len(errors)
    return ReferenceDiameter(float(np.exp(np.mean(logs))), error, "neighbours")


def stenosis_of(
    at_mm: Floats,
    equivalent_mm: Floats,
    error_mm: Floats,
    usable: NDArray[np.bool_],
    *,
    expected: ReferenceDiameter | None,
) -> Stenosis | None:
    """Return the stenosis of a branch: its narrowest usable section relative to a reference.

    Returns None if the stenosis does not exceed its error. The reference is the line through the healthy sections of
    the branch itself (at least 0.9 of its wide part), taken at the narrowest place; such sections must be on both
    sides of the place, or extend over 3 mm on one. The reference by the neighbours applies if the branch has no such
    sections, or if it exceeds the widest section of the branch by more than the error of that reference: the whole
    branch is then narrow.

    The error is half of a 95 % interval. The error contains that of the narrowest section, which is the extreme of
    all independent sections; the error of the healthy sections and their scatter; and, for a narrowing without a
    healthy section beyond it, the forks that may have been missed in between (:func:`_missed_forks`).
    """
    if usable.sum() < 3:
        return None
    at, diameter, error = at_mm[usable], equivalent_mm[usable], error_mm[usable]
    least = int(np.argmin(diameter))
    reference = _reference_of_branch(at, diameter, error, least)
    if expected is not None and (reference is None or expected.mm > (1.0 + expected.error) * float(diameter.max())):
        scatter = DEVIATIONS_95 * float(diameter.std() / diameter.mean())
        reference = dataclasses.replace(expected, error=float(np.hypot(expected.error, scatter)))
    if reference is None or reference.mm <= 0.0:
        return None
    left = float(diameter[least]) / reference.mm
    narrowest_error = _narrowest_error_mm(at, diameter, error, least) / diameter[least]
    found = Stenosis(
        percent=100.0 * (1.0 - left),
        percent_error=float(100.0 * left * np.hypot(narrowest_error, reference.error)),
        area_percent=100.0 * (1.0 - left * left),
        at_mm=float(at[least]),
        min_mm=float(diameter[least]),
        reference_mm=reference.mm,
        reference_from=reference.source,
    )
    return found if found.exceeds_error else None


def _reference_of_branch(at: Floats, diameter: Floats, error: Floats, least: int) -> ReferenceDiameter | None:
    healthy = diameter >= HEALTHY_SHARE * np.percentile(diameter, WIDE_PERCENTILE)
    healthy[least] = False
    place = at[least]
    before, after = healthy & (at < place), healthy & (at > place)
    sides = [float(np.ptp(at[side])) if side.any() else 0.0 for side in (before, after)]
    median_error = float(np.median(error / diameter))
    if before.any() and after.any() and healthy.sum() >= 4:
        slope = _slope(at[healthy], diameter[healthy]) or 0.0
        rest = diameter[healthy] - slope * at[healthy]
        middle = float(np.median(rest)) + slope * float(place)
        scatter = DEVIATIONS_95 * float((rest - np.median(rest)).std()) / max(middle, 1e-9)
        return ReferenceDiameter(middle, float(np.hypot(median_error, scatter)), "branch")
    if max(sides) >= MIN_HEALTHY_MM:
        side = before if sides[0] >= sides[1] else after
        middle = float(np.median(diameter[side]))
        scatter = DEVIATIONS_95 * float(diameter[side].std()) / middle
        forks = 0.0 if after.any() else _missed_forks(float(place - at[before].max()), middle)
        return ReferenceDiameter(middle, float(np.linalg.norm([median_error, scatter, forks])), "branch")
    return None


def _missed_forks(distance_mm: float, diameter_mm: float) -> float:
    """Return the error, as a share, of a reference diameter that is due to forks which the CT does not show.

    The forks may be between the reference and the stenosis. One fork is assumed, and one more for each three diameters
    of distance: an airway that divides, one branch of which the CT does not show, looks like an airway that narrows.
    """
    forks = 1.0 + distance_mm / (DIAMETERS_TO_FORK * diameter_mm)
    return float(EQUAL_DAUGHTER**-forks - 1.0)


def _narrowest_error_mm(at: Floats, diameter: Floats, error: Floats, least: int) -> float:
    """Return half of the 95 % interval of the narrowest diameter, mm, which is the minimum over many sections.

    Sections one diameter apart count as independent (Bonferroni). Blur mixes the wider airway beside it into a section,
    so the widening over that distance is part of the error.
    """
    independent = max(1.0, float(np.ptp(at)) / float(np.median(diameter)))
    extreme = NormalDist().inv_cdf(1.0 - 0.025 / independent) / DEVIATIONS_95
    around = np.interp([at[least] - SECTION_REACH_MM, at[least] + SECTION_REACH_MM], at, diameter)
    widening = float(around.mean() - diameter[least])
    return float(np.hypot(extreme * error[least], widening))
