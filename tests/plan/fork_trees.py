"""Random airway trees without voxels, and routes in these trees, for tests of fork descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from carina.plan import DistanceOrigin, PlannedRoute, TurnList, turn_list
from carina.plan.routes.last_leg import LastLeg
from carina.plan.routes.route_width import RouteWidth
from carina.track import AirwayTree, Branch

Points = NDArray[np.float64]


def unit(vector: Points) -> Points:
    return vector / np.linalg.norm(vector)


def bent(start: Points, first: Points, last: Points, length_mm: float, num: int = 16) -> Points:
    """Return ``num`` points of a line of ``length_mm`` that turns evenly from the direction ``first`` to ``last``."""
    share = (np.arange(num) + 0.5)[:, None] / num
    steps = (1.0 - share) * first + share * last
    steps = length_mm / num * steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return np.concatenate([start[None], start + np.cumsum(steps, axis=0)])


def random_tree(
    seed: int,
    *,
    num_children: Sequence[int] = (2, 2, 3),
    lengths_mm: Sequence[float] = (60.0, 25.0, 14.0, 9.0),
    curl: float = 0.15,
) -> AirwayTree:
    """Return a random tree: a trachea, two named main bronchi, then forks of 2 or 3 branches in all directions.

    ``curl`` sets the curvature of the branches.
    """
    rng = np.random.default_rng(seed)
    branches: list[dict] = []

    def grow(parent: int | None, start: Points, ahead: Points, level: int, name: str | None) -> int:
        number = len(branches)
        turned = unit(ahead + (curl if level else 0.15) * rng.normal(size=3))
        length = float(lengths_mm[level]) * rng.uniform(0.7, 1.3)
        points = bent(start, ahead, turned, length)
        radius = np.linspace(1.0, 0.9, len(points)) * (8.0, 6.0, 3.5, 2.0)[level] * rng.uniform(0.8, 1.2)
        row = {"id": number, "parent": parent, "level": level, "name": name, "points": points, "radius": radius}
        row["children"] = []
        branches.append(row)
        if level < len(num_children):
            for n in range(num_children[level]):
                side = rng.normal(size=3)
                if level == 0:
                    side = np.array([-1.0 if n == 0 else 1.0, 0.3 * rng.normal(), 0.0])
                across = unit(side - float(side @ turned) * turned)
                angle = rng.uniform(0.3, 1.2)
                into = np.cos(angle) * turned + np.sin(angle) * across
                own = ("RMB", "LMB")[n] if level == 0 else None
                row["children"].append(grow(number, points[-1], into, level + 1, own))
        return number

    grow(None, np.array([0.0, 0.0, 100.0]), unit(np.array([0.0, 0.1, -1.0])), 0, "Trachea")
    return made_tree(branches)


def made_tree(rows: Sequence[dict]) -> AirwayTree:
    return AirwayTree(
        tuple(
            Branch(
                row["id"],
                row["parent"],
                tuple(row["children"]),
                row.get("level", 0),
                row.get("name"),
                row.get("kind", "tracked"),
                row["points"],
                row["radius"],
                confidence=row.get("confidence"),
            )
            for row in rows
        )
    )


def moved(tree: AirwayTree, matrix: Points, shift: Points) -> AirwayTree:
    """Return the tree with every point rotated or mirrored and shifted."""
    ends: dict[int, Points] = {}
    rows = []
    for branch in tree.branches:
        points = branch.points @ matrix.T + shift
        if branch.parent is not None:
            points[0] = ends[branch.parent]
        ends[branch.id] = points[-1]
        rows.append(
            {
                "id": branch.id,
                "parent": branch.parent,
                "children": branch.children,
                "level": branch.generation,
                "name": branch.name,
                "points": points,
                "radius": branch.radius,
            }
        )
    return made_tree(rows)


def route_in(
    tree: AirwayTree, branch_id: int, *, share: float = 0.6, carina: bool = True, ridge_mm: float | None = None
) -> PlannedRoute:
    """Return a route that ends in a branch, at the fraction ``share`` of the branch's length.

    With ``carina`` the main carina of the route is at the start of its second branch; its ridge is ``ridge_mm`` beyond.
    """
    lineage = tree.lineage(branch_id)
    branch = lineage[-1]
    index = max(1, int(share * (len(branch.points) - 1)))
    inside = float(np.linalg.norm(np.diff(branch.points[: index + 1], axis=0), axis=1).sum())
    along = sum(one.length_mm for one in lineage[:-1]) + inside
    tip = tuple(float(v) for v in branch.points[index])
    leg = LastLeg(tip, tip, tip, 8.0, 6.0, 0.0, (), 8.0, 8.0, None, None, None, 1.0, reaches=True)
    axes_mm = lineage[0].length_mm
    origin = DistanceOrigin("axes", axes_mm, axes_mm) if carina and len(lineage) > 1 else DistanceOrigin()
    if ridge_mm is not None:
        origin = DistanceOrigin("ridge", axes_mm + ridge_mm, axes_mm)
    ahead = unit(branch.points[index] - branch.points[index - 1] + 1e-12)
    forward = (float(ahead[0]), float(ahead[1]), float(ahead[2]))
    name = branch.name or f"branch {branch.id}"
    width = RouteWidth(2.0, 0.1, along)
    return PlannedRoute(branch.id, name, along, origin, forward, width, "fits", leg, {}, 1.0, ())


def turn_list_with_small_views(tree: AirwayTree, route: PlannedRoute, **options: Any) -> TurnList:
    """Return the turns of a route, for tests of distances and moves.

    The views of the forks, which take most of the time, have few pixels. Distances and moves do not depend on them.
    """
    with patch("carina.plan.turns.from_route.TUBES_PX", 8):
        return turn_list(tree, route, **options)
