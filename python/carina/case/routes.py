"""Routes to a branch, a point or a target, with the flight path and the data for showing them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, cast

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from carina.commands.fields import BranchId
from carina.display import one_line
from carina.errors import NoResultError
from carina.navigate import FlightPath
from carina.navigate.moves import PathFork, PathWay, SetPath
from carina.scopes import PathFrames
from carina.track import Airways, AirwayTree, Branch, DrawnPart, Route, TrackedPath, drawn_part
from carina.track.targets.paper_tracker import along_branches
from carina.value import FrozenValue, PointLps, Words

PARKED_MM = 2.0
"""Maximum distance in mm that an edit may move a centreline while the scope's planned position stays valid."""
AT_THE_ROOT = "the point lies at the tracheal entry, so there is no path to fly along"


class RouteSpan(FrozenValue, frozen=True):
    """Part of a route inside one branch, as positions in mm along the route."""

    branch_id: BranchId
    name: Words | None
    generation: Annotated[int, Meta(ge=0, le=1000)]
    from_mm: float
    to_mm: float
    kind: Literal["tracked", "bridge", "manual"] = "tracked"
    """Kind of the branch; ``manual``: the user drew the branch, because the CT shows no airway there."""


class NeedleLine(FrozenValue, frozen=True):
    """The last leg of a planned route: the straight line of the needle from the scope's tip into the target."""

    ends_lps: tuple[PointLps, PointLps]
    """Tip of the scope and aim of the needle in the target, LPS mm."""
    to_target_mm: float
    """Distance in mm from the tip of the scope to the edge of the target."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ChosenRoute:
    """A route with its arrays, which have one entry per point from the root to the end."""

    route_id: str
    title: str
    points_lps: NDArray[np.float64]
    cumulative_mm: NDArray[np.float64]
    radius_mm: NDArray[np.float64]
    wall_mm: NDArray[np.float64]
    """Radius in mm of the largest ball in the lumen around each centreline point: the space for an instrument."""
    generation: NDArray[np.int64]
    branch_ids: NDArray[np.int64]
    forks_mm: tuple[float, ...]
    lookouts_mm: tuple[float, ...]
    """Positions in mm along the route at which to stop before each fork, with the fork's openings in view."""
    spans: tuple[RouteSpan, ...]
    path: FlightPath
    target_id: str | None = None
    branch_id: int | None = None
    drawn: DrawnPart = field(default_factory=lambda: DrawnPart(0.0))
    """Lengths in mm of the parts of the route that were drawn by hand or bridged because the CT does not show them."""
    lumen_known: bool = True
    """Whether the airways along the route are known; if not, ``radius_mm`` and ``wall_mm`` are 0 without meaning."""
    needle: NeedleLine | None = None
    """Continuation of the route through the wall; None if the route ends in the airways."""

    @property
    def frames(self) -> PathFrames:
        """Planes perpendicular to the route's path at positions along it, for the views along the path."""
        return self.path.frames()

    @property
    def length_mm(self) -> float:
        """Length of the route from the root of the tree to the end of the route, mm."""
        return float(self.cumulative_mm[-1])


class AirwayIndex:
    """All centreline points of a tree in one array, for a search of the nearest branch and the lumen's radius there."""

    def __init__(self, tree: AirwayTree) -> None:
        branches = list(tree.branches)
        self._branches = {branch.id: branch for branch in branches}
        self._points = np.concatenate([np.asarray(b.points, dtype=np.float64) for b in branches])
        self._radius = np.concatenate([np.asarray(b.radius, dtype=np.float64) for b in branches])
        self._ids = np.concatenate([np.full(len(b.points), b.id, dtype=np.int64) for b in branches])

    def nearest(self, point_lps: NDArray[np.float64]) -> tuple[Branch, float, float]:
        """Return the branch nearest to a point, the lumen's radius there, and the distance to its centreline, in mm.

        Parameters
        ----------
        point_lps
            ``(3,)``, LPS mm.
        """
        squared = np.square(self._points - point_lps).sum(axis=1)
        n = int(np.argmin(squared))
        return self._branches[int(self._ids[n])], float(self._radius[n]), float(np.sqrt(squared[n]))

    def branch(self, branch_id: int) -> Branch:
        """Return the branch of the tree with the given id."""
        return self._branches[branch_id]


def default_branch_id(tree: AirwayTree) -> int | None:
    """Return the default branch to fly to: the deepest tip on the patient's right, or else the deepest tip.

    LPS x increases towards the patient's left, so a tip is on the right if its x is smaller than that of the end of the
    trachea.
    """
    leaves = [branch for branch in tree.tips() if len(branch.points) > 1]
    if not leaves:
        return None
    middle_x = float(tree.root.points[-1, 0])
    right = [leaf for leaf in leaves if float(leaf.tip_lps[0]) < middle_x]
    # The id is the last criterion, so that ties have the same result in every run.
    return max(right or leaves, key=lambda leaf: (leaf.generation, leaf.length_mm, -leaf.id)).id


def leaf_below(tree: AirwayTree, branch_id: int) -> int:
    """Return the id of the tip of highest generation that is at or beyond a branch's end."""
    children = {branch.id: branch.children for branch in tree.branches}
    below, waiting = set(), [branch_id]
    while waiting:
        one = waiting.pop()
        below.add(one)
        waiting.extend(children[one])
    leaves = [branch for branch in tree.branches if branch.id in below and not branch.children]
    return max(leaves, key=lambda leaf: (leaf.generation, leaf.length_mm, -leaf.id)).id


def path_move(tree: AirwayTree | None, route: ChosenRoute | None) -> SetPath:
    """Return the command that sets a route's flight path, with the branches that continue at each fork."""
    if route is None:
        return SetPath(())
    return SetPath(**route.path.made_from(), ways=() if tree is None else _path_forks(tree, route))


def position_on_new_route_mm(before: ChosenRoute, before_mm: float, after: ChosenRoute) -> float | None:
    """Return the position in mm along a new route for a tip beyond its common part with the former route.

    The position is the end of the common part. None if the tip is in the common part; the nearest position is then
    correct.

    Parameters
    ----------
    before, before_mm
        The former route, and the position of the tip along that route in mm.
    after
        The new route.
    """
    common_mm = 0.0
    for old, new in zip(before.spans, after.spans, strict=False):
        if old.branch_id != new.branch_id:
            break
        common_mm = min(old.to_mm, new.to_mm)
    return None if before_mm <= common_mm else min(common_mm, after.path.length_mm)


# Length in mm of the start of a branch that gives its direction at a fork: a bend farther on is not in view.
WAY_MM = 10.0


def _path_forks(tree: AirwayTree, route: ChosenRoute) -> tuple[PathFork, ...]:
    """Return the forks of a route, each with the directions of the branches that continue there."""
    branches = {branch.id: branch for branch in tree.branches}
    forks: list[PathFork] = []
    for span, after in itertools.pairwise(route.spans):
        here = branches.get(span.branch_id)
        if here is None or after.branch_id not in here.children or len(here.children) < 2:
            continue
        ways = []
        for child_id in here.children:
            points = np.asarray(branches[child_id].points, dtype=np.float64)
            away = np.linalg.norm(points - points[0], axis=1)
            beyond = np.flatnonzero(away >= WAY_MM)
            toward = points[beyond[0] if len(beyond) else -1] - points[0]
            length = float(np.linalg.norm(toward))
            if length > 0.0:
                x, y, z = (float(v) for v in toward / length)
                ways.append(PathWay(child_id, (x, y, z)))
        place_mm = min(span.to_mm, route.path.length_mm)
        if len(ways) > 1 and any(way.way_id == after.branch_id for way in ways):
            forks.append(PathFork(place_mm, tuple(ways), after.branch_id))
    return tuple(forks)


def route_to_branch(tree: AirwayTree, branch_id: int) -> ChosenRoute:
    """Return the route from the root to the end of a branch."""
    route = tree.route_to(branch_id)
    branch = tree.branch(branch_id)
    title = branch.name or f"branch {branch_id}, generation {branch.generation}"
    return _with_branches_and_path(route, tree, route_id=f"branch-{branch_id}", title=title, branch_id=branch_id)


def route_to_parking(tree: AirwayTree, needle: NeedleLine, target_id: str, name: str) -> ChosenRoute:
    """Return the route from the root to the position of the scope for a needle biopsy, with the line of the needle.

    Parameters
    ----------
    tree
        The airways.
    needle
        Line of the needle; its first end is the position of the scope.
    target_id, name
        Id and name of the target.

    Raises
    ------
    NoResultError
        If no airway reaches this position any more.
    """
    way = route_to_point(tree, np.asarray(needle.ends_lps[0], dtype=np.float64), snap_mm=PARKED_MM)
    return replace(way, route_id=target_id, title=name, target_id=target_id, needle=needle)


def route_to_point(tree: AirwayTree, point_lps: NDArray[np.float64], *, snap_mm: float = 5.0) -> ChosenRoute:
    """Return the route from the root to the point of the tree that is nearest to a given point.

    Parameters
    ----------
    tree
        The airways.
    point_lps
        ``(3,)``, LPS mm.
    snap_mm
        Largest accepted distance between the point and the tree.

    Raises
    ------
    NoResultError
        If no centreline comes within ``snap_mm``, or the nearest point is the root itself.
    """
    branch, _, away_mm = tree.nearest_branch(point_lps)
    if away_mm > snap_mm:
        msg = f"the nearest centreline of the tree is {away_mm:.1f} mm from the point; expected at most {snap_mm:g} mm"
        raise NoResultError(msg, code="track.outside-lumen")
    whole = tree.route_to(branch.id)
    last = int(np.argmin(np.linalg.norm(whole.points_lps - point_lps, axis=1)))
    if last == 0:
        raise NoResultError(AT_THE_ROOT, code="track.no-path")
    end_mm = float(whole.cumulative_mm[last])
    cut = Route(
        whole.points_lps[: last + 1],
        whole.cumulative_mm[: last + 1],
        whole.radius_mm[: last + 1],
        whole.generation[: last + 1],
        whole.branch_ids[: last + 1],
        [mm for mm in whole.forks_mm if mm < end_mm],
    )
    return _with_branches_and_path(
        cut, tree, route_id=f"branch-{branch.id}", title=branch.name or f"branch {branch.id}", branch_id=None
    )


def route_to_target(tree: AirwayTree, path: TrackedPath, target_id: str, name: str) -> ChosenRoute:
    """Return the route of a tracked path, with the branches that it runs through.

    Parameters
    ----------
    tree
        The airways.
    path
        The tracked path.
    target_id, name
        Id and name of the target.

    Raises
    ------
    NoResultError
        If the target is the root itself.
    """
    points = np.asarray(path.points_lps, dtype=np.float64)
    if not (points != points[0]).any():
        raise NoResultError(AT_THE_ROOT, code="track.no-path")
    cumulative_mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    branch_ids = np.asarray(path.branch_ids, dtype=np.int64)
    forks_mm = [float(cumulative_mm[n]) for n in np.flatnonzero(np.diff(branch_ids))]
    return _with_branches_and_path(
        Route(points, cumulative_mm, path.radius_mm, path.generation, path.branch_ids, forks_mm),
        tree,
        route_id=target_id,
        title=name,
        target_id=target_id,
    )


def route_along_points(
    airways: Airways | None, points_lps: NDArray[np.float64], target_id: str, name: str
) -> ChosenRoute:
    """Return the route of a path that was tracked without the lumen, with data of the airways if they are known.

    Parameters
    ----------
    airways
        The airways; None if none are known.
    points_lps
        Points of the path, ``(n, 3)``, LPS mm, from the root to the target.
    target_id, name
        Id and name of the target.

    Raises
    ------
    NoResultError
        If the target is the root itself.
    """
    points = np.asarray(points_lps, dtype=np.float64)
    if not (points != points[0]).any():
        raise NoResultError(AT_THE_ROOT, code="track.no-path")
    cumulative_mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if airways is None:
        branch_ids = generation = np.zeros(len(points), dtype=np.int32)
        radius_mm = np.zeros(len(points))
    else:
        branch_ids, generation = along_branches(points, airways.tree)
        radius_mm = airways.tracker.calibres(points, branch_ids)
    forks_mm = [float(cumulative_mm[n]) for n in np.flatnonzero(np.diff(branch_ids))]
    return _with_branches_and_path(
        Route(points, cumulative_mm, radius_mm, generation, branch_ids, forks_mm),
        None if airways is None else airways.tree,
        route_id=target_id,
        title=name,
        target_id=target_id,
    )


def _wall_distance(
    tree: AirwayTree,
    points_lps: NDArray[np.float64],
    branch_ids: NDArray[np.int64],
    radius_mm: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the distance to the wall in mm at the nearest centreline point, but at most the radius of the path.

    A scope follows the centreline and not exactly the path, so the centreline's distance to the wall applies.
    """
    wall_mm = radius_mm.copy()
    for branch in tree.branches:
        here = np.flatnonzero(branch_ids == branch.id)
        if len(here) == 0:
            continue
        away = points_lps[here, None, :] - np.asarray(branch.points, dtype=np.float64)[None, :, :]
        nearest = np.argmin(np.einsum("ijk,ijk->ij", away, away), axis=1)
        wall_mm[here] = np.minimum(radius_mm[here], np.asarray(branch.wall_distance, dtype=np.float64)[nearest])
    return wall_mm


def _with_branches_and_path(
    route: Route,
    tree: AirwayTree | None,
    *,
    route_id: str,
    title: str,
    target_id: str | None = None,
    branch_id: int | None = None,
) -> ChosenRoute:
    """Return a route with its branches, its stops before forks and its flight path."""
    points = np.ascontiguousarray(route.points_lps, dtype=np.float64)
    cumulative_mm = np.asarray(route.cumulative_mm, dtype=np.float64)
    branch_ids = np.asarray(route.branch_ids, dtype=np.int64)
    generation = np.asarray(route.generation, dtype=np.int64)
    radius_mm = np.asarray(route.radius_mm, dtype=np.float64)
    branches = {} if tree is None else {branch.id: branch for branch in tree.branches}
    spans = _spans(branch_ids, generation, cumulative_mm, branches)
    forks_mm = tuple(float(mm) for mm in route.forks_mm)
    stops_mm = lookouts_mm(forks_mm, spans, cumulative_mm, radius_mm)
    path = FlightPath(
        points, forks_mm=_clamped_to_line(forks_mm, points), lookouts_mm=_clamped_to_line(stops_mm, points)
    )
    return ChosenRoute(
        route_id=route_id,
        title=title,
        points_lps=points,
        cumulative_mm=cumulative_mm,
        radius_mm=radius_mm,
        wall_mm=radius_mm if tree is None else _wall_distance(tree, points, branch_ids, radius_mm),
        generation=generation,
        branch_ids=branch_ids,
        forks_mm=forks_mm,
        lookouts_mm=stops_mm,
        spans=spans,
        path=path,
        target_id=target_id,
        branch_id=branch_id,
        drawn=drawn_part(branches, branch_ids, cumulative_mm),
        lumen_known=tree is not None,
    )


def place_on_tree_mm(tree: AirwayTree, branch_id: int, point: NDArray[np.float64]) -> float:
    """Return the distance along the centrelines, mm, from the start of the tree to the foot of a point on a branch.

    The foot is the point of the branch's centreline that is nearest to the given point.

    Parameters
    ----------
    tree
        The airway tree.
    branch_id
        A branch of the tree.
    point
        Point near the branch, (3,) LPS mm.
    """
    *before, branch = tree.lineage(branch_id)
    return sum(one.length_mm for one in before) + _nearest_mm(branch.points, point)


def centreline_mm(tree: AirwayTree, route: ChosenRoute) -> NDArray[np.float64]:
    """Return the distance in mm of each point of a route from the start of the tree along the centrelines, ``(n,)``.

    Plans, verdicts and reports measure along the centrelines. The points of a route are smoothed, so the route is
    shorter than its centrelines, and a path between two points may begin elsewhere. The ends of the branches are the
    same places on both; between them the distances are interpolated.
    """
    branches = {branch.id: branch for branch in tree.branches}
    at, ids = route.cumulative_mm, [span.branch_id for span in route.spans]
    if any(branch_id not in branches for branch_id in ids):
        return at.copy()

    ends = {branch_id: sum(one.length_mm for one in tree.lineage(branch_id)) for branch_id in ids[:-1]}
    inner = [(fork_mm, ends[branch_id]) for branch_id, fork_mm in zip(ids[:-1], route.forks_mm, strict=False)]
    known = [(0.0, place_on_tree_mm(tree, ids[0], route.points_lps[0]))]
    for place in (*inner, (float(at[-1]), place_on_tree_mm(tree, ids[-1], route.points_lps[-1]))):
        if place[0] > known[-1][0] and place[1] > known[-1][1]:
            known.append(place)
    if len(known) < 2:
        return at.copy()
    places = np.array(known)
    found: NDArray[np.float64] = np.interp(at, places[:, 0], places[:, 1])
    return found


def back_to_route_mm(tree: AirwayTree, route: ChosenRoute, branch_id: int, point: NDArray[np.float64]) -> float | None:
    """Return the distance along the centrelines, mm, from a point in a wrong branch back to the fork of the route.

    The result is None on the route, in the opening of a branch, beyond the last branch of the route, and in airways
    without a common branch with the route.

    Parameters
    ----------
    tree
        The airway tree.
    route
        The route, tracked through the lumen of the tree.
    branch_id
        Branch of the tree that contains the point.
    point
        Point inside the lumen, (3,) LPS mm.
    """
    on_route = [span.branch_id for span in route.spans]
    if branch_id in on_route:
        return None
    lineage = tree.lineage(branch_id)
    common = [n for n, branch in enumerate(lineage) if branch.id in on_route]
    if not common or lineage[common[-1]].id == on_route[-1]:
        return None
    fork_mm = sum(branch.length_mm for branch in lineage[: common[-1] + 1])
    back_mm = place_on_tree_mm(tree, branch_id, point) - fork_mm
    # The centreline of a branch begins in the middle of the fork: up to the wall of the parent, the point is in the
    # opening and not yet in the branch.
    return back_mm if back_mm > float(lineage[common[-1]].radius[-1]) else None


def _nearest_mm(line: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Return the position in mm along a polyline that is nearest to a point."""
    steps = np.diff(line, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    part = np.einsum("ij,ij->i", point - line[:-1], steps) / np.maximum(np.square(lengths), 1e-12)
    part = np.clip(part, 0.0, 1.0)
    away = np.linalg.norm(line[:-1] + part[:, None] * steps - point, axis=1)
    n = int(np.argmin(away))
    return float(lengths[:n].sum() + part[n] * lengths[n])


def lookouts_mm(
    forks_mm: Sequence[float],
    spans: Sequence[RouteSpan],
    cumulative_mm: NDArray[np.float64],
    radius_mm: NDArray[np.float64],
) -> tuple[float, ...]:
    """Return a position in front of each fork at which a flight stops, with all openings of the fork in view.

    The stop is one lumen diameter before the fork, because at the fork itself the opening that is not taken lies beside
    the lens. The stop is never before the middle of the branch that ends at the fork, so that each short branch has its
    own stop.

    Parameters
    ----------
    forks_mm
        Positions of the forks along the route, ascending.
    spans
        The branches along the route, one more than forks.
    cumulative_mm, radius_mm
        Positions along the route and lumen radii of the route's points, ``(n,)``.

    Returns
    -------
    tuple of float
        Positions in mm along the route, strictly increasing; two forks at one position share a stop.
    """
    stops: list[float] = []
    for fork_mm, span in zip(forks_mm, spans, strict=False):
        middle_mm = (min(span.from_mm, fork_mm) + fork_mm) / 2.0
        # Only the first half of the branch counts: near the fork, the radii also include the width of the children.
        inside = (cumulative_mm >= span.from_mm) & (cumulative_mm <= middle_mm)
        diameter_mm = 2.0 * float(np.median(radius_mm[inside] if inside.any() else radius_mm))
        stop_mm = max(fork_mm - diameter_mm, middle_mm)
        if not stops or stop_mm > stops[-1]:
            stops.append(stop_mm)
    return tuple(stops)


def _clamped_to_line(forks_mm: Sequence[float], points: NDArray[np.float64]) -> list[float]:
    """Return the positions of forks in mm, limited to the polyline's length, which rounding may exceed."""
    length_mm = _length_mm(points)
    return [min(float(mm), length_mm) for mm in forks_mm]


def _length_mm(points: NDArray[np.float64] | Sequence[Sequence[float]]) -> float:
    return float(np.linalg.norm(np.diff(np.asarray(points, dtype=np.float64), axis=0), axis=1).sum())


def _spans(
    branch_ids: NDArray[np.int64],
    generation: NDArray[np.int64],
    cumulative_mm: NDArray[np.float64],
    branches: dict[int, Branch],
) -> tuple[RouteSpan, ...]:
    """Return the branches along a route, each with its start and its end in mm."""
    starts = np.flatnonzero(np.diff(branch_ids, prepend=branch_ids[0] - 1))
    ends = [*starts[1:], len(branch_ids) - 1]
    found = []
    for a, b in zip(starts, ends, strict=True):
        branch_id = int(branch_ids[a])
        branch = branches.get(branch_id)
        found.append(
            RouteSpan(
                branch_id,
                None if branch is None else branch.name,
                int(generation[a]),
                float(cumulative_mm[a]),
                float(cumulative_mm[b]),
                "tracked" if branch is None else cast(Any, branch.kind),
            )
        )
    return tuple(found)
