"""A route as it is flown and shown: one shape for a branch's tip and for a tracked target."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import NoResultError
from carina.navigate import FlightPath
from carina.navigate.moves import PathFork, PathWay, SetPath
from carina.scopes import PathFrames
from carina.track import Airways, AirwayTree, Branch, DrawnPart, Route, TrackedPath, drawn_part
from carina.track.targets.paper import along_branches
from carina.value import FrozenValue, PointLps

__all__ = [
    "AirwayIndex",
    "ChosenRoute",
    "NeedleLine",
    "RouteSpan",
    "default_branch_id",
    "leaf_below",
    "lookouts_mm",
    "path_move",
    "route_along_points",
    "route_to_branch",
    "route_to_parking",
    "route_to_point",
    "route_to_target",
    "seat_mm",
]


PARKED_MM = 2.0
"""An edit may move a centreline by this much: the scope still stands where the plan has it."""
AT_THE_ROOT = "the point lies at the tracheal entry, so there is no path to fly along"


@one_line
@dataclass(frozen=True, slots=True)
class RouteSpan:
    """A branch along a route."""

    branch_id: int
    name: str | None
    generation: int
    from_mm: float
    to_mm: float
    kind: str = "tracked"
    """As in :class:`carina.track.Branch`: what a person drew is named so wherever the route is shown."""


class NeedleLine(FrozenValue, frozen=True):
    """The last leg of a planned route: straight from the scope's tip into the target."""

    ends_lps: tuple[PointLps, PointLps]
    """The tip, and what it aims at."""
    to_target_mm: float
    """From the tip to the target's edge."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ChosenRoute:
    """Where to, and the way: parallel arrays from root to tip."""

    route_id: str
    title: str
    points_lps: NDArray[np.float64]
    cumulative_mm: NDArray[np.float64]
    radius_mm: NDArray[np.float64]
    wall_mm: NDArray[np.float64]
    """How large a ball fits round the branch's centre there, mm: what an instrument has."""
    generation: NDArray[np.int64]
    branch_ids: NDArray[np.int64]
    forks_mm: tuple[float, ...]
    lookouts_mm: tuple[float, ...]
    """Where to stop for each fork: in front of it, with its openings in view."""
    spans: tuple[RouteSpan, ...]
    path: FlightPath
    target_id: str | None = None
    branch_id: int | None = None
    drawn: DrawnPart = field(default_factory=lambda: DrawnPart(0.0))
    """How much of it the CT does not show."""
    lumen_known: bool = True
    """False where there are no airways round it: ``radius_mm`` and ``wall_mm`` are 0 and mean nothing."""
    needle: NeedleLine | None = None
    """How the way goes on through the wall; None where the route ends in the airways."""

    @property
    def frames(self) -> PathFrames:
        """The plane across the path at its places, for the views along it."""
        return self.path.frames()

    @property
    def length_mm(self) -> float:
        """Length from root to tip."""
        return float(self.cumulative_mm[-1])


class AirwayIndex:
    """All centreline points of a tree in one array: which branch is nearest, and how wide it is there."""

    def __init__(self, tree: AirwayTree) -> None:
        branches = list(tree.branches)
        self._branches = {branch.id: branch for branch in branches}
        self._points = np.concatenate([np.asarray(b.points, dtype=np.float64) for b in branches])
        self._radius = np.concatenate([np.asarray(b.radius, dtype=np.float64) for b in branches])
        self._ids = np.concatenate([np.full(len(b.points), b.id, dtype=np.int64) for b in branches])

    def nearest(self, point_lps: NDArray[np.float64]) -> tuple[Branch, float, float]:
        """The branch, the lumen's radius there in mm, and the distance to the centreline in mm."""
        squared = np.square(self._points - point_lps).sum(axis=1)
        n = int(np.argmin(squared))
        return self._branches[int(self._ids[n])], float(self._radius[n]), float(np.sqrt(squared[n]))

    def branch(self, branch_id: int) -> Branch:
        """A branch that the tree has."""
        return self._branches[branch_id]


def default_branch_id(tree: AirwayTree) -> int | None:
    """The tip to fly to when nobody chose: the deepest on the patient's right, else the deepest.

    LPS x grows to the patient's left, so "right" is a tip with a smaller x than the end of the trachea.
    """
    leaves = [branch for branch in tree.tips() if len(branch.points) > 1]
    if not leaves:
        return None
    middle_x = float(tree.root.points[-1, 0])
    right = [leaf for leaf in leaves if float(leaf.tip_lps[0]) < middle_x]
    # The id last, so that equal tips are chosen the same way in every run.
    return max(right or leaves, key=lambda leaf: (leaf.generation, leaf.length_mm, -leaf.id)).id


def leaf_below(tree: AirwayTree, branch_id: int) -> int:
    """The deepest tip that is reached through a branch; the branch itself where it is one."""
    children = {branch.id: branch.children for branch in tree.branches}
    below, waiting = set(), [branch_id]
    while waiting:
        one = waiting.pop()
        below.add(one)
        waiting.extend(children[one])
    leaves = [branch for branch in tree.branches if branch.id in below and not branch.children]
    return max(leaves, key=lambda leaf: (leaf.generation, leaf.length_mm, -leaf.id)).id


def path_move(tree: AirwayTree | None, route: ChosenRoute | None) -> SetPath:
    """The route as a pilot takes it: its path, and at each fork the ways on."""
    if route is None:
        return SetPath(())
    return SetPath(**route.path.made_from(), ways=() if tree is None else _path_forks(tree, route))


def seat_mm(before: ChosenRoute, before_mm: float, after: ChosenRoute) -> float | None:
    """Where a tip is seated on another route: at the end of the last branch that both have.

    None where it has not come farther than that: the place that is nearest is where it is.
    """
    common_mm = 0.0
    for old, new in zip(before.spans, after.spans, strict=False):
        if old.branch_id != new.branch_id:
            break
        common_mm = min(old.to_mm, new.to_mm)
    return None if before_mm <= common_mm else min(common_mm, after.path.length_mm)


# Where a way leads, by its first centimetre: the bend behind it is not in view at the fork.
WAY_MM = 10.0


def _path_forks(tree: AirwayTree, route: ChosenRoute) -> tuple[PathFork, ...]:
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
    """The way from the root to the end of a branch."""
    route = tree.route_to(branch_id)
    branch = tree.branch(branch_id)
    title = branch.name or f"branch {branch_id}, generation {branch.generation}"
    return _chosen(route, tree, route_id=f"branch-{branch_id}", title=title, branch_id=branch_id)


def route_to_parking(tree: AirwayTree, needle: NeedleLine, target_id: str, name: str) -> ChosenRoute:
    """The way from the root to where the scope stands for a needle, with the needle's line.

    Raises
    ------
    NoResultError
        If no airway is there any more.
    """
    way = route_to_point(tree, np.asarray(needle.ends_lps[0], dtype=np.float64), snap_mm=PARKED_MM)
    return replace(way, route_id=target_id, title=name, target_id=target_id, needle=needle)


def route_to_point(tree: AirwayTree, point_lps: NDArray[np.float64], *, snap_mm: float = 5.0) -> ChosenRoute:
    """The way from the root to the place of the tree that is nearest to a point.

    Raises
    ------
    NoResultError
        If no centreline comes within ``snap_mm``, or the place is the root itself.
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
    return _chosen(
        cut, tree, route_id=f"branch-{branch.id}", title=branch.name or f"branch {branch.id}", branch_id=None
    )


def route_to_target(tree: AirwayTree, path: TrackedPath, target_id: str, name: str) -> ChosenRoute:
    """The way of a tracked path, with the branches that it runs through.

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
    # A fork lies where one branch ends and the next begins.
    forks_mm = [float(cumulative_mm[n]) for n in np.flatnonzero(np.diff(branch_ids))]
    return _chosen(
        Route(points, cumulative_mm, path.radius_mm, path.generation, path.branch_ids, forks_mm),
        tree,
        route_id=target_id,
        title=name,
        target_id=target_id,
    )


def route_along_points(
    airways: Airways | None, points_lps: NDArray[np.float64], target_id: str, name: str
) -> ChosenRoute:
    """A way that was tracked without the lumen, beside the airways that there are.

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
    return _chosen(
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
    """Of the nearest centreline point, since a scope need not run beside the centre as a path may; else the radius."""
    wall_mm = radius_mm.copy()
    for branch in tree.branches:
        here = np.flatnonzero(branch_ids == branch.id)
        if len(here) == 0:
            continue
        away = points_lps[here, None, :] - np.asarray(branch.points, dtype=np.float64)[None, :, :]
        nearest = np.argmin(np.einsum("ijk,ijk->ij", away, away), axis=1)
        wall_mm[here] = np.minimum(radius_mm[here], np.asarray(branch.wall_distance, dtype=np.float64)[nearest])
    return wall_mm


def _chosen(
    route: Route,
    tree: AirwayTree | None,
    *,
    route_id: str,
    title: str,
    target_id: str | None = None,
    branch_id: int | None = None,
) -> ChosenRoute:
    points = np.ascontiguousarray(route.points_lps, dtype=np.float64)
    cumulative_mm = np.asarray(route.cumulative_mm, dtype=np.float64)
    branch_ids = np.asarray(route.branch_ids, dtype=np.int64)
    generation = np.asarray(route.generation, dtype=np.int64)
    radius_mm = np.asarray(route.radius_mm, dtype=np.float64)
    branches = {} if tree is None else {branch.id: branch for branch in tree.branches}
    spans = _spans(branch_ids, generation, cumulative_mm, branches)
    forks_mm = tuple(float(mm) for mm in route.forks_mm)
    stops_mm = lookouts_mm(forks_mm, spans, cumulative_mm, radius_mm)
    path = FlightPath(points, forks_mm=_inside(forks_mm, points), lookouts_mm=_inside(stops_mm, points))
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


def lookouts_mm(
    forks_mm: Sequence[float],
    spans: Sequence[RouteSpan],
    cumulative_mm: NDArray[np.float64],
    radius_mm: NDArray[np.float64],
) -> tuple[float, ...]:
    """Where a flight stops for each fork: one lumen diameter in front of it, where the openings are in view together.

    At the branch point itself the tip stands between the openings, and the one that is not taken lies beside the lens.
    Never before the middle of the branch that ends there, so that short branches get a stop of their own.

    Parameters
    ----------
    forks_mm
        Places of the forks, ascending.
    spans
        The branches along the route, one more than forks.
    cumulative_mm, radius_mm
        Places and lumen radii of the route's points, ``(n,)``.

    Returns
    -------
    tuple of float
        Strictly increasing; two forks at one place share a look-out.
    """
    stops: list[float] = []
    for fork_mm, span in zip(forks_mm, spans, strict=False):
        middle_mm = (min(span.from_mm, fork_mm) + fork_mm) / 2.0
        # The branch's own width: at the branch point itself the two children count as well.
        inside = (cumulative_mm >= span.from_mm) & (cumulative_mm <= middle_mm)
        diameter_mm = 2.0 * float(np.median(radius_mm[inside] if inside.any() else radius_mm))
        stop_mm = max(fork_mm - diameter_mm, middle_mm)
        if not stops or stop_mm > stops[-1]:
            stops.append(stop_mm)
    return tuple(stops)


def _inside(forks_mm: Sequence[float], points: NDArray[np.float64]) -> list[float]:
    """Forks clamped to the polyline's length: the last one may lie past it by rounding."""
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
                "tracked" if branch is None else branch.kind,
            )
        )
    return tuple(found)
