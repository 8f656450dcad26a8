"""Targets and routes after a change of the airways: each path is searched again for the same points."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import structs

from carina.case.document import Document, Target
from carina.case.routes import ChosenRoute, route_along_points, route_to_branch, route_to_parking, route_to_target
from carina.errors import NoResultError, TrackingError, UsageError
from carina.session.open_case.open_case import as_point
from carina.track.targets.paper_tracker import outside_mm, track_on_graph
from carina.track.targets.relaxed_path import wall_crossings
from carina.track.targets.results import WallCrossing

if TYPE_CHECKING:
    from carina.session.engines import Cancel, Progress
    from carina.track import Airways, AirwayTree
    from carina.volume import Volume

NO_START = "mark the start point of the path first: there are no segmented airways to start from"
SNAP_MM = 5.0
"""Maximum distance, in mm, over which a target outside the lumen is moved into it; the user is notified."""


def searched_target(
    volume: Volume, airways: Airways | None, target: Target, *, progress: Progress, cancel: Cancel
) -> Target:
    """Return the target with its path by the cost ``walls`` or ``paper``, or with the reason why there is none.

    Raises
    ------
    UsageError
        If neither the target nor the airways define the start of the path.
    """
    if target.root_lps is None and airways is None:
        raise UsageError(NO_START, code="track.no-root")
    root = as_point(airways.root_lps) if target.root_lps is None and airways is not None else target.root_lps
    target = replace(target, root_lps=root)
    try:
        result = track_on_graph(
            volume,
            airways,
            [target.lps],
            cost=target.cost,
            graph="voxel",
            root_lps=root,
            progress=progress,
            cancel=cancel,
        )
        found = result.targets[0]
        if found.path is None:
            return replace(target, problem=found.problem)
        route = route_along_points(airways, found.path.points_lps, target.target_id, target.name)
    except (TrackingError, UsageError) as error:
        return replace(target, problem=str(error))
    row = None if result.search is None else result.search.targets[0]
    return replace(
        target,
        used_lps=target.lps,
        snapped_mm=0.0,
        length_mm=route.length_mm,
        route=route,
        outside_mm=None if row is None else row.outside_mm,
        crossings_mm=None if row is None or row.crossings is None else _along_mm(row.crossings),
        value_range=None if row is None else row.value_range,
    )


def tracked_target(airways: Airways | None, target: Target) -> Target:
    """Return the target with its path through ``airways``, or with the reason why there is none.

    A path that was searched without the lumen is unchanged; only values that compare it with the airways are updated.
    """
    if target.lesion is not None:
        # Routes to a lesion are part of its plan, which is not stored in the document.
        return target
    if target.cost != "lumen":
        if target.route is None:
            return target
        points = target.route.points_lps
        return replace(
            target,
            route=route_along_points(airways, points, target.target_id, target.name),
            outside_mm=None if airways is None else outside_mm(points, airways, airways.tracker.grid.ct),
            crossings_mm=None if airways is None else _along_mm(wall_crossings(points, airways)),
        )
    assert airways is not None
    bare = Target(
        target_id=target.target_id, name=target.name, lps=target.lps, note=target.note, priority=target.priority
    )
    try:
        path = airways.tracker.path_to(target.lps, snap_mm=SNAP_MM)
        route = route_to_target(airways.tree, path, target.target_id, target.name)
    except TrackingError as error:
        return replace(bare, problem=str(error))
    # Without a move the target itself is used; after a move, the last lumen voxel of the path.
    used = target.lps if path.snapped_mm == 0.0 else as_point(path.points_lps[-1])
    return replace(bare, used_lps=used, snapped_mm=path.snapped_mm, length_mm=path.length_mm, route=route)


def _along_mm(crossings: tuple[WallCrossing, ...]) -> tuple[float, ...]:
    return tuple(crossing.along_mm for crossing in crossings)


def needed_target(document: Document, target_id: str) -> Target:
    """Return the target with this ID.

    Raises
    ------
    UsageError
        ``session.target``: if the target has been deleted.
    """
    for target in document.targets:
        if target.target_id == target_id:
            return target
    raise UsageError("this target has been removed", code="session.target")


def renamed_route(route: ChosenRoute | None, tree: AirwayTree) -> ChosenRoute | None:
    """Return a route with the present names of its branches; nothing else about the route changes."""
    if route is None or not route.lumen_known:
        return route
    names = {branch.id: branch.name for branch in tree.branches}
    spans = tuple(structs.replace(span, name=names.get(span.branch_id)) for span in route.spans)
    title = route.title
    if route.branch_id is not None and (branch := next((b for b in tree.branches if b.id == route.branch_id), None)):
        title = branch.name or f"branch {branch.id}, generation {branch.generation}"
    return replace(route, spans=spans, title=title)


def followed_route(airways: Any, chosen: ChosenRoute | None, targets: tuple[Target, ...]) -> ChosenRoute | None:
    """Return the chosen route in changed airways; None if its target or branch no longer exists.

    A route with unchanged points keeps its path object, so that the flight along it continues.
    """
    if chosen is None:
        return None
    if chosen.needle is not None and chosen.target_id is not None:
        # The plan is computed again; meanwhile the route ends at the present standing point of the scope.
        try:
            found = route_to_parking(airways.tree, chosen.needle, chosen.target_id, chosen.title)
        except NoResultError:
            found = None
    elif chosen.target_id is not None:
        found = next((t.route for t in targets if t.target_id == chosen.target_id), None)
    elif chosen.branch_id is not None and any(b.id == chosen.branch_id for b in airways.tree.branches):
        found = route_to_branch(airways.tree, chosen.branch_id)
    else:
        found = None
    if found is not None and np.array_equal(found.points_lps, chosen.points_lps):
        return replace(found, path=chosen.path)
    return found
