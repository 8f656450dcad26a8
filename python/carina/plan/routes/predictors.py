"""Published predictors of a failed navigation, measured on the last section of a route."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_fields, instance, number_from
from carina.display import one_line
from carina.plan.routes.main_carina import ROOT, DistanceOrigin
from carina.plan.routes.route_width import RouteWidth, width_of_section
from carina.scopes import WallField
from carina.track import AirwayTree, Branch, TreeMeasures
from carina.track.measures.forks import angle_deg, point_at, run_mm

Points = NDArray[np.float64]

SECTION_MM = 20.0
"""Length in mm of the last section of a route, on which diameter and curvature are measured."""
CHORD_MM = 3.0
"""Half the length in mm of the chords that give the direction of the axis."""
STEP_MM = 0.25
"""Distance in mm between the points of an airway's axis at which its direction is measured."""
PREDICTOR_SOURCE = "Cancer Imaging 2024, doi 10.1186/s40644-024-00730-7"
"""Publication of the predictors; only its abstract was read."""
PREDICTOR_WORDS = (
    "A large bifurcation angle at the target branch and a narrow, curved last section were associated with failed "
    f"navigation by radial EBUS (491 patients, 57 targets not reached; {PREDICTOR_SOURCE}). The source has no limits: "
    "these are figures for comparison, not a verdict."
)


@one_line
@dataclass(frozen=True, slots=True)
class RoutePredictors:
    """Predictors of a failed navigation for one route; the source publishes no limits."""

    bifurcation_deg: float | None
    """Angle in degrees between the axes before and after the last fork of the route; 0 for straight on.

    A branch that is the only one from its parent, such as an extension drawn by hand, begins at no fork. None if the
    route passes no fork.
    """
    width: RouteWidth
    """Least diameter of the lumen in the route's last section, with its error and position."""
    curvature_per_mm: float | None
    """Mean curvature of the last section's axis, 1/mm: the sum of its turns divided by its length.

    None if the route is shorter than two chords of 6 mm.
    """
    section_mm: float
    """Length of the last section in mm; below 20 only if the route is shorter."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `RoutePredictors` has an invalid value."""
        check_fields(
            self,
            bifurcation_deg=number_from(0.0, 180.0, optional=True, unit="degrees"),
            width=instance(RouteWidth, "get predictors from carina.plan_route"),
            curvature_per_mm=number_from(0.0, 100.0, optional=True),
            section_mm=number_from(0.0, SECTION_MM, unit="mm"),
        )

    @property
    def angle_words(self) -> str:
        """Bifurcation angle as text, such as *38°*."""
        return "not known" if self.bifurcation_deg is None else f"{self.bifurcation_deg:.0f}\u00b0"

    @property
    def curvature_words(self) -> str:
        """Mean curvature as text, such as *0.021 /mm*."""
        return "not known" if self.curvature_per_mm is None else f"{self.curvature_per_mm:.3f} /mm"

    @property
    def words(self) -> str:
        """Predictors as one text."""
        return (
            f"bifurcation angle {self.angle_words}; last {self.section_mm:.0f} mm: least diameter {self.width.words}, "
            f"mean curvature {self.curvature_words}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the predictors as plain JSON types."""
        return {
            "bifurcation_deg": self.bifurcation_deg,
            "least_mm": self.width.mm,
            "least_error_mm": self.width.error_mm,
            "least_by": self.width.source,
            "curvature_per_mm": self.curvature_per_mm,
            "section_mm": self.section_mm,
            "source": PREDICTOR_SOURCE,
            "note": PREDICTOR_WORDS,
        }


def route_predictors(
    tree: AirwayTree,
    branch_id: int,
    along_mm: float,
    *,
    wall: WallField | None = None,
    measures: TreeMeasures | None = None,
    spacing_mm: float = 1.0,
    origin: DistanceOrigin = ROOT,
) -> RoutePredictors:
    """Return the predictors of the route to a place of a tree.

    Parameters
    ----------
    tree
        The airways.
    branch_id, along_mm
        Branch of the scope's tip, and the distance of the tip from the root along the airways.
    wall, measures, spacing_mm
        Wall of the airways, measures of this tree, and largest spacing of the CT, as for the narrowest diameter.
    origin
        Origin of the distances along the route.
    """
    lineage = tree.lineage(branch_id)
    points = np.concatenate([lineage[0].points, *(branch.points[1:] for branch in lineage[1:])])
    begins_mm = max(along_mm - SECTION_MM, 0.0)
    return RoutePredictors(
        bifurcation_deg=_bifurcation_deg(lineage),
        width=width_of_section(lineage, wall, measures, spacing_mm, section_mm=(begins_mm, along_mm), origin=origin),
        curvature_per_mm=mean_curvature(points, begins_mm, along_mm),
        section_mm=min(along_mm - begins_mm, SECTION_MM),
    )


def _bifurcation_deg(lineage: Sequence[Branch]) -> float | None:
    forks = [(mother, daughter) for mother, daughter in itertools.pairwise(lineage) if len(mother.children) > 1]
    return angle_deg(*forks[-1]) if forks else None


def mean_curvature(points: Points, begins_mm: float, ends_mm: float) -> float | None:
    """Return the mean curvature of a section of a polyline in 1/mm; None if the section is too short.

    The direction at a point is that of the chord from 3 mm before to 3 mm after it, which removes the steps of the
    voxels. At an end of the polyline the section is shortened so that each chord is part of the polyline.

    Parameters
    ----------
    points
        (n, 3) LPS mm.
    begins_mm, ends_mm
        Ends of the section, as distances along the polyline.

    Examples
    --------
    >>> turn = np.linspace(0.0, 1.0, 200)[:, None]
    >>> arc = np.concatenate([50.0 * np.sin(turn), 50.0 * np.cos(turn), 0.0 * turn], axis=1)
    >>> round(mean_curvature(arc, 20.0, 40.0), 4)
    0.02
    """
    length = float(run_mm(points)[-1])
    first, last = max(begins_mm, CHORD_MM), min(ends_mm, length - CHORD_MM)
    if last - first < 2.0 * CHORD_MM:
        return None
    at = np.linspace(first, last, math.ceil((last - first) / STEP_MM) + 1)
    chords = point_at(points, at + CHORD_MM) - point_at(points, at - CHORD_MM)
    chords /= np.maximum(np.linalg.norm(chords, axis=1, keepdims=True), 1e-9)
    # The sine of half an angle is exact for small angles, unlike the cosine of the angle.
    turns = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(np.diff(chords, axis=0), axis=1), 0.0, 1.0))
    return float(turns.sum()) / (last - first)
