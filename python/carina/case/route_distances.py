"""Distances along a route as the window, saved videos and plans state them, and their origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carina.case.routes import ChosenRoute, centreline_mm
from carina.commands.tree import PathCost
from carina.plan.routes.main_carina import (
    ROOT,
    DistanceOrigin,
    RouteScale,
    mother_of_main_bronchi,
    origins_of_branches,
)
from carina.track import Airways, AirwayTree

START_OF_ROUTE = DistanceOrigin("route")
"""Origin at the first point of a route."""


def scale_of_route(
    airways: Airways | None, route: ChosenRoute, *, cost: PathCost, origin: DistanceOrigin = ROOT
) -> RouteScale:
    """Return the distances of the points of a route and their origin.

    A route that follows the airways is measured along the centrelines, as in plans. A path that was searched with
    another cost is measured along the path itself, because the path need not follow any branch.

    Parameters
    ----------
    airways
        The airways; None if they are not known.
    route
        The route.
    cost
        Cost by which the path of the route was searched.
    origin
        Origin of the distances in the airways (`carina.plan.distance_origin`).
    """
    if cost != "lumen" or airways is None or not route.lumen_known:
        passed = None if airways is None or not route.lumen_known else carina_of_path(airways, route, origin)
        return RouteScale(passed or START_OF_ROUTE, route.cumulative_mm)
    origins = origins_of_branches(airways.tree, origin)
    return RouteScale(origins.get(route.spans[-1].branch_id, ROOT), centreline_mm(airways.tree, route))


def carina_of_path(airways: Airways, route: ChosenRoute, origin: DistanceOrigin) -> DistanceOrigin | None:
    """Return the origin of the distances along a path at the main carina; None if the path does not pass it.

    A path passes the main carina if it runs through the lumen from the branch above it into one below it. The
    distances of the origin are measured along the path.

    Parameters
    ----------
    airways
        The airways.
    route
        Route whose path was searched with any cost.
    origin
        Origin of the distances in the airways.
    """
    mother = mother_of_main_bronchi(airways.tree) if origin.is_carina else None
    if mother is None:
        return None
    at = _fork_index(airways.tree, mother.id, route)
    if at is None or not airways.tracker.inside(route.points_lps[at : at + 2]).all():
        return None
    axes_mm = float(route.cumulative_mm[at])
    return replace(origin, along_mm=axes_mm + (origin.ridge_beyond_axes_mm or 0.0), axes_mm=axes_mm)


def _fork_index(tree: AirwayTree, branch_id: int, route: ChosenRoute) -> int | None:
    """Return the index of the last point of a route in a branch or above it; None if the route does not continue there.

    The result is also None if the route begins beyond the branch.
    """
    above = np.isin(route.branch_ids, [branch.id for branch in tree.lineage(branch_id)])
    beyond = np.flatnonzero(~above)
    return int(beyond[0]) - 1 if len(beyond) and beyond[0] > 0 else None
