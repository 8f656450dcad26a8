"""Narrowest diameter of the path from the root to each point of a tree, with its error (docs/decisions/0130).

Where the airways were measured, the diameter is that of the largest ball that passes their sections
(`carina.track.TreeMeasures.passage`). Where they could not be measured (drawn branches, bridges, long gaps), it is that
of the largest ball in the segmented lumen, whose error is several times larger.
"""

from __future__ import annotations

import functools
import math
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_fields, choice, instance, number_from, text_of
from carina.display import one_line
from carina.plan.routes.clearance import ball_diameters_mm
from carina.plan.routes.main_carina import ROOT, DistanceOrigin
from carina.scopes import ScopePreset, WallField
from carina.track import Airways, AirwayTree, Branch, TreeMeasures, measure_tree
from carina.track.measures.diameter import least_with_error
from carina.volume import Volume

Points = NDArray[np.float64]
Widths = NDArray[np.object_]
WidthSource = Literal["sections", "ball"]
Fit = Literal["fits", "may fit", "does not fit"]

SURE = 0.9
"""Minimum probability with which a scope *fits*; it *does not fit* with at most 1 minus this probability.

Checks and outlooks of routes use the same limits.
"""
EXCESS_SIGMA_MM = 0.15
"""Standard deviation in mm of a scope's true size round its stated size.

A published source measured ten scopes, whose tips exceed their stated size by 0.19 to 0.66 mm; the deviation is our
estimate.
"""
DEVIATIONS_90 = 1.645
"""Number of standard deviations on each side of the mean that contain 90 % of a normal distribution."""
PAST_FORK_MM = 1e-3
"""Distance in mm beyond a fork at which an opening begins, so that the end of the parent branch is excluded."""
BALL_SHARE, BALL_SLICES = 0.3, 1.0
"""Error of the largest ball's diameter: share of the diameter, and multiple of the CT's largest spacing.

In painted CTs, 91 % of 248 routes whose last part was treated as unmeasured have their true diameter within this error
(``benchmarks/measurements/diameters.md``).
"""
NUM_MEASURED = 3
"""Maximum number of trees of one lumen, such as before and after an edit, whose measures are cached."""

_MEASURED: dict[int, tuple[weakref.ref[Any], list[tuple[Volume, tuple[Branch, ...], TreeMeasures]]]] = {}
"""Measures that plans have computed, by the identity of the lumen; deleted with the lumen."""
PASSES: dict[Fit, str | None] = {
    "fits": None,
    "may fit": "the scope may pass",
    "does not fit": "the scope does not pass",
}
"""Text whether a scope passes an opening; None if it does."""


@one_line
@dataclass(frozen=True, slots=True)
class RouteWidth:
    """Narrowest diameter of a route, with its error, place and source."""

    mm: float
    error_mm: float
    """Half width in mm of the interval that contains the true diameter with 90 % probability."""
    at_mm: float
    """Distance in mm of the narrowest place from the route's origin."""
    source: WidthSource = "sections"
    """Source of the diameter.

    ``ball`` if the diameter or its lower limit depends on a part that could not be measured.
    """
    why: str | None = None
    """Part of the route whose width could not be measured, and the reason; None if measured sections give the width."""
    origin: DistanceOrigin = ROOT
    """Point from which ``at_mm`` is counted: the root of the tree, or the main carina."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `RouteWidth` has an invalid value."""
        check_fields(
            self,
            mm=number_from(0.0, 1000.0, unit="mm"),
            error_mm=number_from(0.0, 1000.0, unit="mm"),
            at_mm=number_from(-10_000.0, 10_000.0, unit="mm"),
            source=choice("sections", "ball"),
            why=text_of(optional=True),
            origin=instance(DistanceOrigin, "get one from carina.plan.distance_origin"),
        )

    @property
    def lower_mm(self) -> float:
        """Lower end of the 90 % interval of the diameter, mm."""
        return self.mm - self.error_mm

    @property
    def words(self) -> str:
        """Diameter with its error as text: *3.2 ± 0.3 mm*, or *2.4 ± 1.5 mm by the largest ball*."""
        by = " by the largest ball" if self.source == "ball" else ""
        return f"{self.mm:.1f} \u00b1 {self.error_mm:.1f} mm{by}"

    @property
    def place_words(self) -> str:
        """Narrowest place as text: *the narrowest place, 91 mm past the main carina, is 3.2 ± 0.3 mm wide*."""
        mm = f"{self.mm:.1f} \u00b1 {self.error_mm:.1f} mm"
        return f"the narrowest place, {self.origin.words(self.at_mm)}, is {mm} wide"

    def chance(self, scope: ScopePreset) -> float:
        """Return the probability that a scope passes, by the errors of the diameter and of the scope's size."""
        sigma = math.hypot(self.error_mm / DEVIATIONS_90, EXCESS_SIGMA_MM)
        return 0.5 * (1.0 + math.erf((self.mm - scope.fit_mm) / sigma / math.sqrt(2.0)))

    def fit(self, scope: ScopePreset) -> Fit:
        """Return whether a scope fits, may fit within the errors, or does not fit."""
        chance = self.chance(scope)
        return "fits" if chance >= SURE else "does not fit" if chance <= 1.0 - SURE else "may fit"

    def to_json(self) -> dict[str, Any]:
        """Return the width as plain JSON types, with the keys of a route in `plan.json`."""
        return {
            "narrowest_mm": self.mm,
            "narrowest_error_mm": self.error_mm,
            "narrowest_at_mm": self.at_mm,
            "narrowest_by": self.source,
            "narrowest_why": self.why,
        }


def ball_error_mm(diameter_mm: Points | float, spacing_mm: float) -> Any:
    """Return the half width in mm of the 90 % interval of a diameter that is measured by the largest ball.

    Parameters
    ----------
    diameter_mm
        Diameter of the ball, or an array of diameters.
    spacing_mm
        Largest spacing of the CT.
    """
    return BALL_SHARE * diameter_mm + BALL_SLICES * spacing_mm


def matches_tree(measures: TreeMeasures, tree: AirwayTree) -> bool:
    """Return whether measures belong to a tree and come from the present method."""
    return len(measures.branches) == len(tree.branches) and all(
        own.branch_id == branch.id and len(own.at_mm) == len(branch.points) and not own.is_by_earlier_method
        for own, branch in zip(measures.branches, tree.branches, strict=True)
    )


def measures_of(
    volume: Volume, airways: Airways, given: TreeMeasures | None, *, cancel: Callable[[], bool] | None = None
) -> TreeMeasures:
    """Return measures of a tree: those that the caller has if they match the tree, else computed or cached ones.

    Measuring takes seconds, so the measures of the same CT and tree are computed once while their lumen exists.

    Parameters
    ----------
    volume, airways, cancel
        As for `carina.measure_tree`.
    given
        Measures that the caller has; None if there are none.
    """
    if given is not None and matches_tree(given, airways.tree):
        return given
    key = id(airways.lumen_zyx)
    known = _MEASURED.get(key)
    for ct, branches, measures in [] if known is None else list(known[1]):
        if ct is volume and branches is airways.tree.branches:
            return measures
    made = measure_tree(volume, airways, cancel=cancel)
    # The identity of a lumen is unique only while the lumen exists.
    alive = weakref.ref(airways.lumen_zyx, lambda _gone: _MEASURED.pop(key, None))
    stored = _MEASURED.setdefault(key, (alive, []))[1]
    stored.append((volume, airways.tree.branches, made))
    del stored[:-NUM_MEASURED]
    return made


def widths_on_the_way(
    tree: AirwayTree,
    wall: WallField | None,
    measures: TreeMeasures | None,
    spacing_mm: float,
    origin: DistanceOrigin = ROOT,
) -> dict[int, Widths]:
    """Return for each branch the narrowest width of the path to each of its points, (n,) of `RouteWidth`.

    Parameters
    ----------
    tree, wall
        The airways and their wall; without a wall the ball is centred on each point of the centreline.
    measures
        Measures of this tree; None uses the ball everywhere.
    spacing_mm
        Largest spacing of the CT.
    origin
        Origin from which the narrowest places are measured.
    """
    found: dict[int, Widths] = {}
    starts: dict[int, float] = {}
    # Parents precede their children in the tree.
    for branch in tree.branches:
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
        before: RouteWidth | None = None
        start = origin.past_mm(0.0)
        if branch.parent is not None:
            before, start = found[branch.parent][-1], starts[branch.parent]
        starts[branch.id] = start + float(along[-1])
        places = _known_diameters(branch, along, wall, measures, spacing_mm)
        places.at_mm += start
        found[branch.id] = _cumulated(places, along + start, before, origin)
    return found


def width_of_section(
    lineage: Sequence[Branch],
    wall: WallField | None,
    measures: TreeMeasures | None,
    spacing_mm: float,
    *,
    section_mm: tuple[float, float],
    origin: DistanceOrigin = ROOT,
) -> RouteWidth:
    """Return the narrowest width of one section of a route, from the diameters of `widths_on_the_way`.

    The first known diameter at or beyond the end of the section counts too, as in `widths_on_the_way`. Without a
    diameter in the section, the nearest one before the section counts.

    Parameters
    ----------
    lineage
        Branches of the route from the root.
    wall, measures, spacing_mm, origin
        As for `widths_on_the_way`.
    section_mm
        Ends of the section, as distances from the root.
    """
    low, high = (origin.past_mm(mm) for mm in section_mm)
    end = origin.past_mm(sum(branch.length_mm for branch in lineage))
    found: RouteWidth | None = None
    for branch in reversed(lineage):
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
        end -= float(along[-1])
        places = _known_diameters(branch, along, wall, measures, spacing_mm)
        places.at_mm += end
        last = int(np.searchsorted(places.at_mm, high - 1e-6)) + 1
        for n in reversed(range(min(last, len(places.at_mm)))):
            if found is not None and places.at_mm[n] < low:
                return found
            width = _width(places, n, origin)
            found = _narrower(found, replace(width, at_mm=min(width.at_mm, high)))
    assert found is not None
    return found


@one_line
@dataclass(frozen=True, slots=True)
class RouteOpening:
    """Opening at a fork of a route: its narrowest width, and whether the planned scope passes."""

    width: RouteWidth
    """Narrowest width of the opening, with its error."""
    fit: Fit | None = None
    """Whether the planned scope fits, as for the whole route; None if no scope is known."""

    @property
    def words(self) -> str:
        """Width as text, with a doubt if the scope may not pass: *3.2 ± 0.3 mm wide, the scope may pass*."""
        words = f"{self._mm} mm wide"
        return words if self.doubt is None else f"{words}, {self.doubt}"

    @property
    def cell(self) -> str:
        """Width for a table whose head states the unit: *3.2 ± 0.3: the scope may pass*."""
        return self._mm if self.doubt is None else f"{self._mm}: {self.doubt}"

    @property
    def _mm(self) -> str:
        return f"{self.width.mm:.1f} \u00b1 {self.width.error_mm:.1f}"

    @property
    def doubt(self) -> str | None:
        """Text that the scope may not pass; None if it passes or is not known."""
        return None if self.fit is None else PASSES[self.fit]

    def to_json(self) -> dict[str, Any]:
        """Return the opening as plain JSON types."""
        return {"mm": self.width.mm, "error_mm": self.width.error_mm, "by": self.width.source, "fit": self.fit}


def openings_of_route(
    tree: AirwayTree,
    branch_id: int,
    along_mm: float,
    *,
    scope: ScopePreset,
    wall: WallField | None,
    measures: TreeMeasures | None,
    spacing_mm: float,
    origin: DistanceOrigin = ROOT,
) -> dict[int, RouteOpening]:
    """Return the openings at each fork of a route, by the ID of the branch that begins there.

    An opening extends from the fork to one radius of the parent and one diameter of the branch beyond it, and on the
    route not beyond the tip. An opening is measured by the diameters of `widths_on_the_way`, so no opening that the
    route passes is narrower than the route.

    Parameters
    ----------
    tree
        The airways.
    branch_id, along_mm
        Branch of the scope's tip, and the distance of the tip from the root along the airways.
    scope
        The planned scope.
    wall, measures, spacing_mm, origin
        As for `widths_on_the_way`.
    """
    by_id = {branch.id: branch for branch in tree.branches}
    lineage = tree.lineage(branch_id)
    found: dict[int, RouteOpening] = {}
    fork_mm = 0.0
    for n, mother in enumerate(lineage):
        fork_mm += mother.length_mm
        taken = lineage[n + 1].id if n + 1 < len(lineage) else None
        for child in () if taken is None else mother.children:
            branch = by_id[child]
            end_mm = fork_mm + opening_mm(mother, branch)
            width = width_of_section(
                (*lineage[: n + 1], branch),
                wall,
                measures,
                spacing_mm,
                section_mm=(fork_mm + PAST_FORK_MM, min(end_mm, along_mm) if child == taken else end_mm),
                origin=origin,
            )
            found[child] = RouteOpening(width, width.fit(scope))
    return found


def opening_mm(mother: Branch, branch: Branch) -> float:
    """Return the length in mm of the opening of a branch: one radius of its parent and one diameter of the branch."""
    return float(np.median(mother.radius)) + 2.0 * float(np.median(branch.radius))


def narrowest_opening(openings: Sequence[RouteOpening]) -> RouteOpening:
    """Return the narrowest of several openings in a row, with an error that covers the lower end of each interval."""
    fits = [one.fit for one in openings]
    width = functools.reduce(_narrower, (one.width for one in openings))
    return RouteOpening(width, next((fit for fit in reversed(PASSES) if fit in fits), None))


@dataclass(slots=True, eq=False)
class _KnownDiameters:
    """Points of a branch at which the diameter is known, with the diameters."""

    at_mm: Points
    diameter_mm: Points
    error_mm: Points
    is_ball: NDArray[np.bool_]
    title: str
    kind: str


def _known_diameters(
    branch: Branch, along: Points, wall: WallField | None, measures: TreeMeasures | None, spacing_mm: float
) -> _KnownDiameters:
    title = branch.name or f"branch {branch.id}"
    if measures is None:
        at, diameter, error, unmeasured = along[:0], along[:0], along[:0], np.arange(len(along))
    else:
        passage = measures.passage(branch.id)
        at, diameter, error, unmeasured = passage.at_mm, passage.diameter_mm, passage.error_mm, passage.unmeasured
    if len(unmeasured):
        ball_mm = ball_diameters_mm(branch, wall)
        if branch.parent is None:
            ball_mm = np.full(len(along), float(np.median(ball_mm)))
        at = np.concatenate([at, along[unmeasured]])
        diameter = np.concatenate([diameter, ball_mm[unmeasured]])
        error = np.concatenate([error, ball_error_mm(ball_mm[unmeasured], spacing_mm)])
    is_ball = np.arange(len(at)) >= len(at) - len(unmeasured)
    order = np.argsort(at, kind="stable")
    return _KnownDiameters(at[order], diameter[order], error[order], is_ball[order], title, branch.kind)


def _cumulated(places: _KnownDiameters, along: Points, before: RouteWidth | None, origin: DistanceOrigin) -> Widths:
    """Return the narrowest width up to each point of a centreline, including the path before the branch.

    A point at which no width was measured also uses the next measured place: where a branch leaves its parent, the
    first measured section of the branch is some distance along it, and a scope at the point is in the branch already.
    The stated place is then the point itself, so that it is never beyond the end of the route.
    """
    widths = np.empty(len(along), dtype=object)
    now, used = before, 0
    for n, mm in enumerate(along):
        while used < len(places.at_mm) and (used == 0 or places.at_mm[used - 1] < mm - 1e-6):
            now = _narrower(now, _width(places, used, origin))
            used += 1
        widths[n] = now if now is None or now.at_mm <= mm else replace(now, at_mm=float(mm))
    return widths


def _width(places: _KnownDiameters, n: int, origin: DistanceOrigin) -> RouteWidth:
    mm, error, at = float(places.diameter_mm[n]), float(places.error_mm[n]), float(places.at_mm[n])
    if not places.is_ball[n]:
        return RouteWidth(mm, error, at, origin=origin)
    reason = {"manual": "was drawn by hand", "bridge": "is a bridge across an obstruction"}.get(
        places.kind, "has no section that can be measured"
    )
    why = f"{places.title} {reason}; there the diameter is that of the largest ball"
    return RouteWidth(mm, error, at, "ball", why, origin)


def _narrower(before: RouteWidth | None, here: RouteWidth) -> RouteWidth:
    """Return the narrower of two widths, with an error that covers the lower ends of both intervals."""
    if before is None:
        return here
    if before.mm <= here.mm and before.lower_mm <= here.lower_mm:
        return before
    if here.mm < before.mm and here.lower_mm <= before.lower_mm:
        return here
    least, lowest = (before, here) if before.mm <= here.mm else (here, before)
    decides = least if least.source == "ball" else lowest
    _, error_mm = least_with_error((before.mm, here.mm), (before.error_mm, here.error_mm))
    return replace(least, error_mm=error_mm, source=decides.source, why=decides.why)
