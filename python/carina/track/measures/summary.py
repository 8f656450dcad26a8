"""One branch in a few figures: mean and least lumen, taper, and a narrowing against what is healthy."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line

__all__ = ["BranchSummary", "Stenosis", "healthy_neighbours_mm", "stenosis_of", "summed_up"]

Floats = NDArray[np.float64]

HEALTHY_SHARE = 0.9
"""A section counts as healthy where it has at least this share of its branch's wide part."""
WIDE_PERCENTILE = 80.0
LEAST_HEALTHY_MM = 3.0
"""So much healthy branch, at least, makes a reference of its own."""
MURRAY_POWER = 3.0
"""Murray (1926): the cubes of the diameters of two branches add up to that of their parent."""
NEIGHBOURS_ERROR = 0.15
"""Airways keep to Murray's law within about this share (one standard deviation)."""


@one_line
@dataclass(frozen=True, slots=True)
class Stenosis:
    """The narrowest place of a branch against its healthy neighbourhood."""

    percent: float
    """How much narrower it is than the reference, by diameter: 0 is healthy, 100 closed. Below 0 it is wider."""
    percent_error: float
    """Half of an interval meant to hold the truth in 95 of 100 cases."""
    area_percent: float
    """The same by area."""
    at_mm: float
    """Where, along the branch."""
    min_mm: float
    """Equivalent diameter there."""
    reference_mm: float
    """What the diameter there would be."""
    reference_from: str
    """``branch``: the healthy parts of the branch itself; ``neighbours``: its parent, siblings and children."""

    @property
    def exceeds_error(self) -> bool:
        """Whether it is reported: healthy, 0 %, lies below its 95 % interval."""
        return self.percent > self.percent_error

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        return {name: _rounded(value) for name, value in dataclasses.asdict(self).items()}


@one_line
@dataclass(frozen=True, slots=True)
class BranchSummary:
    """A branch in a few figures, from its sections away from forks and from the volume's faces; None without any."""

    length_mm: float = 0.0
    angle_deg: float | None = None
    """To the parent, 0 straight on: between the chords of two diameters on both sides of the fork."""
    num_sections: int = 0
    """Sections that count."""
    mean_mm: float | None = None
    """Mean equivalent diameter."""
    mean_error_mm: float | None = None
    min_mm: float | None = None
    """Least equivalent diameter."""
    min_at_mm: float | None = None
    taper: float | None = None
    """Change of the equivalent diameter per mm of way (mm/mm): below 0 where the branch narrows."""
    wall_mm: float | None = None
    """Median thickness of the wall."""
    wall_error_mm: float | None = None
    measured_stenosis: Stenosis | None = dataclasses.field(default=None, repr=False)
    """As measured or read. Case files of earlier versions also hold stenoses within their errors: read ``stenosis``."""

    @property
    def stenosis(self) -> Stenosis | None:
        """The stenosis that is reported: None where it does not exceed its error."""
        own = self.measured_stenosis
        return own if own is not None and own.exceeds_error else None

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        values = {
            field.name: _rounded(getattr(self, field.name))
            for field in dataclasses.fields(self)
            if field.name != "measured_stenosis"
        }
        return {**values, "stenosis": None if self.stenosis is None else self.stenosis.to_json()}


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value


def summed_up(
    at_mm: Floats,
    equivalent: tuple[Floats, Floats],
    wall: tuple[Floats, Floats],
    usable: NDArray[np.bool_],
    *,
    angle_deg: float | None,
    stenosis: Stenosis | None,
) -> BranchSummary:
    """The summary of a branch from its sections, all (n,): diameters and walls with their errors, mm."""
    (equivalent_mm, error_mm), (wall_mm, wall_error_mm) = equivalent, wall
    length = float(at_mm[-1])
    if not usable.any():
        return BranchSummary(length_mm=length, angle_deg=angle_deg)
    at, diameter = at_mm[usable], equivalent_mm[usable]
    least = int(np.argmin(diameter))
    walls = usable & np.isfinite(wall_mm)
    return BranchSummary(
        length_mm=length,
        angle_deg=angle_deg,
        num_sections=int(usable.sum()),
        mean_mm=float(diameter.mean()),
        # Neighbouring sections share their voxels and the correction for the blur: their errors do not average out.
        mean_error_mm=float(np.median(error_mm[usable])),
        min_mm=float(diameter[least]),
        min_at_mm=float(at[least]),
        taper=_slope(at, diameter),
        wall_mm=float(np.median(wall_mm[walls])) if walls.any() else None,
        wall_error_mm=float(np.median(wall_error_mm[walls])) if walls.any() else None,
        measured_stenosis=stenosis,
    )


def _slope(at: Floats, values: Floats) -> float | None:
    """Median of the slopes between all pairs (Theil 1950, Sen 1968); None over less than 5 mm or 5 sections."""
    if len(at) < 5 or at[-1] - at[0] < 5.0:
        return None
    one, other = np.triu_indices(len(at), k=1)
    return float(np.median((values[other] - values[one]) / (at[other] - at[one])))


def healthy_neighbours_mm(
    parent_mm: float | None, siblings_mm: Sequence[float | None], children_mm: Sequence[float | None]
) -> float | None:
    """The diameter that a branch should have by Murray's law, from its parent and siblings, from its children, or both.

    None where neither side is known whole.
    """
    guesses = []
    if parent_mm is not None and siblings_mm and all(sibling is not None for sibling in siblings_mm):
        rest = parent_mm**MURRAY_POWER - sum(float(s or 0.0) ** MURRAY_POWER for s in siblings_mm)
        if rest > 0.0:
            guesses.append(rest ** (1.0 / MURRAY_POWER))
    if children_mm and all(child is not None for child in children_mm):
        guesses.append(sum(float(c or 0.0) ** MURRAY_POWER for c in children_mm) ** (1.0 / MURRAY_POWER))
    return float(np.exp(np.mean(np.log(guesses)))) if guesses else None


def stenosis_of(
    at_mm: Floats,
    equivalent_mm: Floats,
    error_mm: Floats,
    usable: NDArray[np.bool_],
    *,
    neighbours_mm: float | None,
) -> Stenosis | None:
    """The narrowest usable section of a branch against its reference; None where it does not exceed its error.

    The reference is the line through the healthy sections of the branch itself (at least 0.9 of its wide part), taken
    at the narrowest place, where they lie on both sides of it or are 3 mm long on one. Where the branch has less than
    6 mm of healthy sections its neighbours may say what it should be, by Murray's law: if there is nothing else, or if
    that is wider than the branch's widest section by more than the law's scatter (it is narrow all along).
    """
    if usable.sum() < 3:
        return None
    at, diameter, error = at_mm[usable], equivalent_mm[usable], error_mm[usable]
    least = int(np.argmin(diameter))
    healthy = diameter >= HEALTHY_SHARE * np.percentile(diameter, WIDE_PERCENTILE)
    healthy[least] = False
    own = _own_reference(at, diameter, healthy, at[least])
    reference, source, share = own, "branch", float(np.median(error / diameter))
    if neighbours_mm is not None and (own is None or neighbours_mm > (1.0 + NEIGHBOURS_ERROR) * float(diameter.max())):
        reference, source, share = neighbours_mm, "neighbours", 1.96 * NEIGHBOURS_ERROR
    if reference is None or reference <= 0.0:
        return None
    left = float(diameter[least]) / reference
    found = Stenosis(
        percent=100.0 * (1.0 - left),
        percent_error=float(100.0 * left * np.hypot(error[least] / diameter[least], share)),
        area_percent=100.0 * (1.0 - left * left),
        at_mm=float(at[least]),
        min_mm=float(diameter[least]),
        reference_mm=float(reference),
        reference_from=source,
    )
    return found if found.exceeds_error else None


def _own_reference(at: Floats, diameter: Floats, healthy: NDArray[np.bool_], place: float) -> float | None:
    before, after = healthy & (at < place), healthy & (at > place)
    sides = [float(np.ptp(at[side])) if side.any() else 0.0 for side in (before, after)]
    if before.any() and after.any() and healthy.sum() >= 4:
        slope = _slope(at[healthy], diameter[healthy]) or 0.0
        middle = float(np.median(diameter[healthy] - slope * at[healthy]))
        return middle + slope * place
    if max(sides) >= LEAST_HEALTHY_MM:
        return float(np.median(diameter[before if sides[0] >= sides[1] else after]))
    return None
