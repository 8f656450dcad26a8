"""Shape of the airway tree for drawings: centrelines with radii, a route, and a target's surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.report.outline import surface_of
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.targets.grow_nodule import Nodule
from carina.track import AirwayTree, Branch

Points = NDArray[np.float64]
EVERY_MM = 2.5
"""Approximate distance in mm between the points of a drawn centreline; the centrelines of the tree are finer."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ShapedBranch:
    """Branch of the tree reduced to few points: (n, 3) LPS mm and (n,) radii in mm."""

    id: int
    name: str | None
    points_lps: Points
    radius_mm: Points
    on_route: bool
    is_found: bool
    """Whether the branch was found in the CT and neither drawn by a user nor bridged across an obstruction."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TreeShape:
    """Shape of an airway tree with a route and a target."""

    branches: tuple[ShapedBranch, ...]
    route_lps: Points
    """(n, 3) points along the route from the root to the scope's tip, LPS mm; (0, 3) without a route."""
    needle_lps: Points
    """(2, 3) tip of the scope and aim of the needle, LPS mm; (0, 3) without a route."""
    vertices_lps: Points
    """(n, 3) vertices of the target's surface, LPS mm."""
    quads: NDArray[np.int64]
    """(m, 4) indices of the vertices of each quad."""

    def to_json(self) -> dict[str, Any]:
        """Return the shape as plain JSON types, rounded to 0.1 mm, for the script of the HTML page."""
        return {
            "branches": [
                {
                    "name": one.name,
                    "points": np.round(one.points_lps, 1).tolist(),
                    "radius": np.round(one.radius_mm, 1).tolist(),
                    "route": one.on_route,
                    "found": one.is_found,
                }
                for one in self.branches
            ],
            "route": np.round(self.route_lps, 1).tolist(),
            "needle": np.round(self.needle_lps, 1).tolist(),
            "vertices": np.round(self.vertices_lps, 1).tolist(),
            "quads": self.quads.tolist(),
        }


def tree_shape(tree: AirwayTree, nodule: Nodule, route: PlannedRoute | None) -> TreeShape:
    """Return the shape of a tree with one route of a plan."""
    lineage = [] if route is None else tree.lineage(route.branch_id)
    on_route = {branch.id for branch in lineage}
    way = np.empty((0, 3))
    needle = np.empty((0, 3))
    if route is not None:
        points = np.concatenate([branch.points for branch in lineage])
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        way = _few(points[at <= route.along_mm + 1e-6])
        needle = np.array([route.leg.tip_lps, route.leg.aim_lps])
    vertices, quads = surface_of(nodule)
    return TreeShape(tuple(_shaped(one, one.id in on_route) for one in tree.branches), way, needle, vertices, quads)


def _shaped(branch: Branch, on_route: bool) -> ShapedBranch:
    rows = _rows(branch.points)
    return ShapedBranch(
        branch.id, branch.name, branch.points[rows], branch.radius[rows], on_route, branch.kind == "tracked"
    )


def _few(points: Points) -> Points:
    few: Points = points[_rows(points)]
    return few


def _rows(points: Points) -> NDArray[np.intp]:
    """Return the indices of points of a line about `EVERY_MM` apart, including both ends of the line."""
    if len(points) < 3:
        return np.arange(len(points))
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    num = max(round(float(at[-1]) / EVERY_MM), 1) + 1
    return np.unique(np.searchsorted(at, np.linspace(0.0, float(at[-1]), num) - 1e-9).clip(0, len(points) - 1))
