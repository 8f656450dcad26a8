"""Computation of the list of turns of a route (docs/decisions/0124)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError, check_type
from carina.plan.hand_moves import Move
from carina.plan.routes.main_carina import AXES_NOTE, SAME_PLACE_MM, DistanceOrigin
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.routes.route_width import RouteOpening, RouteWidth, ball_error_mm, narrowest_opening, opening_mm
from carina.plan.routes.standing_points import branch_doubts, branch_title
from carina.plan.turns.fork_view import (
    MIN_CAMERA_DISTANCE_MM,
    HourDoubt,
    Opening,
    hour_doubt,
    levelled,
    openings_seen,
    stand_mm,
    turn_view,
    turned_hours,
    whole_hour,
)
from carina.plan.turns.opening_walls import ForkWalls, TubeWall, first_walls
from carina.plan.turns.turn_list import OtherWay, Turn, TurnList, Zero
from carina.render import Renderer
from carina.render.picture_text import letters_of
from carina.scopes import Pose
from carina.track import AirwayTree, Branch
from carina.track.measures.forks import angle_deg

Points = NDArray[np.float64]
Point = tuple[float, float, float]

TOGETHER_MM = 2.0
"""Distance in mm up to which forks always form one turn, because a tip of 3 mm cannot stop between them."""
MAX_TOGETHER_MM = 5.0
"""Maximum distance in mm between forks that form one turn.

Forks form one turn if the branch between them is at most as long as its radius, because the openings of both are then
in the same lumen.
"""
VIEW_PX, FINE_PX, TUBES_PX = 64, 128, 32
"""Widths in pixels of the pictures in which openings are located.

The widths apply, in this order, to pictures of the CT, to pictures of the CT with a small opening, and to pictures of
the tree's tubes without a CT.
"""
SMALL_SHARE = 0.02
"""Share of the picture below which an opening is small; a coarse picture would divide such an opening into parts."""
DISTANCE_FACTORS = (0.75, 0.6, 1.0, 1.5)
"""Distances of the camera before a fork, in airway diameters, that are tried if the usual distance gives no hour."""
BALL_SPACING_MM = 1.0
"""Spacing of the CT in mm that is assumed for the error of an opening that was not measured."""
MIN_MOVE_MM = 0.5
CLEAR_DEG = 10.0
"""Minimum angle in degrees between an opening and the line of sight at which the clock hour is precise."""
MAX_DEPTH_MM = 1000.0
"""Maximum accepted insertion depth of the main carina in mm.

Older cases measured from the start of the tree, with depths up to 500 mm.
"""
SIDES = {"R": "right", "L": "left", "A": "anterior", "P": "posterior", "S": "superior", "I": "inferior"}


def turn_list(
    tree: AirwayTree,
    planned: PlannedRoute,
    *,
    carina_depth_mm: float | None = None,
    moves: Sequence[Move] | None = None,
    ends_along_mm: Sequence[float] | None = None,
    renderer: Renderer | None = None,
) -> TurnList:
    """Return the list of turns of a route: at each fork the opening, the distances and the moves of the hand.

    Parameters
    ----------
    tree
        The tree that the route was planned in.
    planned
        The route; the list ends at the position of its scope. Distances are measured from the origin of the route
        (`PlannedRoute.origin`).
    carina_depth_mm
        Insertion depth at nose or mouth when the tip is at the main carina; depths computed from it are estimates.
    moves, ends_along_mm
        Moves of a drive along the route, and the distance of the tip from the origin of the route at the end of each
        move, mm (`DrivenRoute.ends_along_mm`).
    renderer
        Renderer of the CT with the lumen of its airways, in whose pictures the openings are located. Without a renderer
        the branches count as tubes with the radii of the tree, so hours differ from the picture where these differ.

    Returns
    -------
    TurnList
        One turn for each fork or group of close forks.

    Raises
    ------
    UsageError
        If the tree has no such branch, a number is out of range, or moves and distances differ in number.

    Examples
    --------
    >>> import carina
    >>> from carina.plan import plan_route, turn_list
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> airways = carina.find_airways(made.volume)
    >>> plan = plan_route(made.volume, airways, made.truth["nodule"]["centre_lps"])
    >>> found = turn_list(airways.tree, plan.routes[0])
    >>> found.turns[0].at_main_carina
    True
    """
    check_type("turn_list", "tree", tree, AirwayTree, "it is the tree of carina.find_airways")
    check_type("turn_list", "planned", planned, PlannedRoute, "it is one of the routes of carina.plan_route")
    if carina_depth_mm is not None and not (math.isfinite(carina_depth_mm) and 0.0 <= carina_depth_mm <= MAX_DEPTH_MM):
        raise UsageError(
            f"carina_depth_mm: expected 0 to {MAX_DEPTH_MM:g} mm; found {carina_depth_mm}", code="plan.range"
        )
    found = _turns(
        tree,
        _Way(tree.lineage(planned.branch_id), planned.origin, planned.along_mm, planned.openings),
        carina_depth_mm,
        renderer,
    )
    return found if moves is None else turns_with_moves(tree, planned, found, moves, ends_along_mm)


def branch_turns(
    tree: AirwayTree, branch_id: int, origin: DistanceOrigin, *, renderer: Renderer | None = None
) -> TurnList:
    """Return the turns on the way to the end of a branch, without a plan: fork, opening and clock hour of each.

    Parameters
    ----------
    tree
        The airway tree.
    branch_id
        Branch at the end of the way.
    origin
        Origin of the distances (`carina.plan.distance_origin`).
    renderer
        Renderer of the CT with the lumen of its airways, as for `turn_list`.

    Returns
    -------
    TurnList
        One turn for each fork or group of close forks.

    Raises
    ------
    UsageError
        If the tree has no such branch.
    """
    lineage = tree.lineage(branch_id)
    return _turns(tree, _Way(lineage, origin, sum(branch.length_mm for branch in lineage)), None, renderer)


@dataclass(frozen=True, slots=True)
class _Way:
    """The branches of a route, with its origin, its end in mm from the root, and its measured openings."""

    lineage: list[Branch]
    origin: DistanceOrigin
    end_mm: float
    openings: dict[int, RouteOpening] = field(default_factory=dict)


def _turns(tree: AirwayTree, way: _Way, carina_depth_mm: float | None, renderer: Renderer | None) -> TurnList:
    """Return the list of turns of a route without the moves of the hand."""
    lineage = way.lineage
    by_id = {branch.id: branch for branch in tree.branches}
    origin = way.origin
    groups = _forks(lineage, origin)
    places_mm = [_place_mm(group) for group in groups]
    points = np.concatenate([branch.points for branch in lineage])
    turns: list[Turn] = []
    for n, group in enumerate(groups):
        before_mm = places_mm[n - 1] if n else origin.past_mm(0.0)
        first, last = group[0], group[-1]
        fork = first.mother.points[-1]
        others = [by_id[i] for one in group for i in one.mother.children if i != one.daughter.id]
        view = _view(tree, points, first, [last.daughter, *others], renderer)
        taken, shown = view.openings[0], view.doubt is None and not view.openings[0].straight_ahead
        measured = angle_deg(first.mother, last.daughter)
        turns.append(
            Turn(
                from_branch=branch_title(first.mother),
                to_branch=branch_title(last.daughter),
                to_branch_id=last.daughter.id,
                fork_lps=_point(fork),
                from_carina_mm=places_mm[n] if origin.is_carina else None,
                from_fork_mm=places_mm[n] - before_mm,
                clock_head=taken.hours if shown else None,
                clock_facing=turned_hours(taken.hours) if shown else None,
                angle_deg=_angle_deg(fork - view.eye, taken.middle_lps - fork) if measured is None else measured,
                opening=narrowest_opening([_opening(way, one.mother, one.daughter) for one in group]),
                moves=None,
                doubts=tuple(words for one in group for words in branch_doubts(one.daughter)),
                straight_ahead=view.doubt is None and taken.straight_ahead,
                sides=_sides(fork - view.eye, taken.middle_lps - view.eye) if shown else (),
                others=_clockwise(
                    way, taken, view.openings[1:], {i: one.mother for one in group for i in one.mother.children}
                ),
                through=tuple(branch_title(one.daughter) for one in group[:-1]),
                at_main_carina=any(one.is_main_carina for one in group),
                opening_lps=_point(taken.middle_lps),
                seen_from_lps=_point(view.eye),
                hour_doubt=view.doubt,
                ahead_deg=taken.ahead_limit_deg,
                dots_lps=_dots(taken, view.eye),
            )
        )
    last_mm = places_mm[-1] if places_mm else origin.past_mm(0.0)
    zero: Zero | None = origin.kind if origin.kind in {"ridge", "axes"} else None
    return TurnList(
        turns=tuple(turns),
        park_from_carina_mm=way.origin.from_carina_mm(way.end_mm),
        park_from_fork_mm=origin.past_mm(way.end_mm) - last_mm,
        carina_depth_mm=carina_depth_mm,
        zero=zero,
        notes=_notes(zero, carina_depth_mm),
    )


def turns_with_moves(
    tree: AirwayTree,
    planned: PlannedRoute,
    turns: TurnList,
    moves: Sequence[Move],
    ends_along_mm: Sequence[float] | None,
) -> TurnList:
    """Return a list of turns with the moves of a drive along its route.

    Parameters
    ----------
    tree, planned, turns
        Tree, route and list of turns of `turn_list`.
    moves, ends_along_mm
        Moves, and the distance of the tip from the origin of the route at the end of each move (`turn_list`).

    Raises
    ------
    UsageError
        If moves and distances differ in number.
    """
    groups = _forks(tree.lineage(planned.branch_id), planned.origin)
    forks_mm = [planned.origin.past_mm(group[-1].at_mm) for group in groups]
    per_turn, parking = _moves_by_fork(forks_mm, moves, ends_along_mm)
    with_moves = tuple(replace(turn, moves=doing) for turn, doing in zip(turns.turns, per_turn, strict=True))
    return replace(turns, turns=with_moves, park_moves=parking)


@dataclass(frozen=True, slots=True, eq=False)
class _Fork:
    """Fork of a route, with the branches that begin there."""

    mother: Branch
    daughter: Branch
    at_mm: float
    """Distance of the fork from the root along the airways, mm."""
    place_mm: float
    """Distance of the fork from the origin of the route (`DistanceOrigin.fork_mm`), mm."""
    is_main_carina: bool


def _place_mm(group: Sequence[_Fork]) -> float:
    """Return the distance in mm of a group of forks from the origin, by the main carina or else by the first fork."""
    return next((fork for fork in group if fork.is_main_carina), group[0]).place_mm


def _forks(lineage: Sequence[Branch], origin: DistanceOrigin) -> list[list[_Fork]]:
    """Return the forks of a route; forks with a short branch between them form one group.

    The end of a branch with a single child is not a fork.
    """
    groups: list[list[_Fork]] = []
    at_mm = 0.0
    for mother, daughter in itertools.pairwise(lineage):
        at_mm += mother.length_mm
        if len(mother.children) < 2:
            continue
        fork = _Fork(mother, daughter, at_mm, origin.fork_mm(at_mm), origin.is_main_carina(at_mm))
        together_mm = min(max(TOGETHER_MM, _radius_mm(mother)), MAX_TOGETHER_MM)
        if groups and at_mm - groups[-1][-1].at_mm <= together_mm:
            groups[-1].append(fork)
        else:
            groups.append([fork])
    return groups


@dataclass(frozen=True, slots=True, eq=False)
class _ForkPicture:
    """View of a fork: position of the camera, openings, and the reason why no hour is given."""

    eye: Points
    openings: tuple[Opening, ...]
    doubt: HourDoubt | None

    @property
    def num_in_view(self) -> int:
        """Number of openings of the fork that are visible from the camera."""
        return sum(opening.in_view for opening in self.openings)

    @property
    def is_clear(self) -> bool:
        """Whether the opening is far enough from straight ahead (`CLEAR_DEG`) for a precise clock hour."""
        return self.has_hour and self.openings[0].off_deg >= CLEAR_DEG

    @property
    def has_hour(self) -> bool:
        """Whether the clock hour is reliable and the opening is not straight ahead."""
        return self.doubt is None and not self.openings[0].straight_ahead


def _view(
    tree: AirwayTree, way: Points, fork: _Fork, branches: Sequence[Branch], renderer: Renderer | None
) -> _ForkPicture:
    """Return the view of a fork from the first position that gives a precise hour, else a reliable hour.

    If no position gives an hour, the result is the first view with the opening straight ahead, else the usual view.
    """
    end = fork.mother.points[-1]
    walls = ForkWalls(tree, end, [branch.id for branch in branches])
    views: list[_ForkPicture] = []
    for stand in _stands_mm(fork):
        eye = _eye(way, fork, stand, walls)
        camera = levelled(eye, end - eye, "head")
        if renderer is None:
            openings = openings_seen(camera, walls, branches, first_walls(camera, TUBES_PX, TubeWall(tree, end)))
        else:
            openings = _openings(camera, walls, branches, renderer)
        views.append(_ForkPicture(eye, openings, hour_doubt(camera, openings, _radius_mm(fork.mother), branch_title)))
        # A position from which fewer openings are visible only hides the opening that could be confused.
        if views[-1].num_in_view < views[0].num_in_view:
            views.pop()
        elif views[-1].is_clear:
            return views[-1]
    with_hour = next((view for view in views if view.has_hour), None)
    return with_hour or next((view for view in views if view.doubt is None), views[0])


def _openings(camera: Pose, walls: ForkWalls, branches: Sequence[Branch], renderer: Renderer) -> tuple[Opening, ...]:
    """Return the openings in the CT, from a finer picture if the opening to enter is small."""
    for size_px in (VIEW_PX, FINE_PX):
        seen = renderer.surface(turn_view(renderer, camera, size_px)).position_lps
        openings = openings_seen(camera, walls, branches, seen)
        if float(openings[0].outline.mean()) >= SMALL_SHARE:
            break
    return openings


def _stands_mm(fork: _Fork) -> list[float]:
    """Return the distances in mm of the camera before a fork that are tried, the usual one first."""
    usual = stand_mm(fork.mother)
    diameter = 2.0 * _radius_mm(fork.mother)
    found = [usual]
    for share in DISTANCE_FACTORS:
        other = max(share * diameter, MIN_CAMERA_DISTANCE_MM)
        if all(abs(other - one) > MIN_MOVE_MM for one in found):
            found.append(other)
    return found


def _radius_mm(branch: Branch) -> float:
    return float(np.median(branch.radius))


def _eye(way: Points, fork: _Fork, stand: float, walls: ForkWalls) -> Points:
    """Return the position (3,), LPS mm, of the camera at a distance before a fork, on the centreline."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    at_mm = max(fork.at_mm - stand, 0.0)
    eye: Points = np.array([np.interp(at_mm, along, way[:, axis]) for axis in range(3)])
    end = fork.mother.points[-1]
    if float(np.linalg.norm(end - eye)) > SAME_PLACE_MM:
        return eye
    # The route begins at this fork, so no airway leads to it: the camera is behind the fork, opposite to its branches.
    ahead = np.mean([mouth - end for mouth in walls.mouths_lps], axis=0)
    length = float(np.linalg.norm(ahead))
    ahead = ahead / length if length > 0.0 else np.array([0.0, 0.0, -1.0])
    found: Points = end - stand * ahead
    return found


def _opening(way: _Way, mother: Branch, branch: Branch) -> RouteOpening:
    """Return the opening of a branch as measured for the route, else by the ball in the lumen found."""
    known = way.openings.get(branch.id)
    if known is not None:
        return known
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    mm = 2.0 * float(branch.wall_distance[along <= opening_mm(mother, branch)].min())
    why = f"{branch_title(branch)} was not measured; there the diameter is that of the largest ball"
    return RouteOpening(RouteWidth(mm, float(ball_error_mm(mm, BALL_SPACING_MM)), 0.0, "ball", why, way.origin))


def _dots(taken: Opening, eye: Points) -> tuple[Point, ...]:
    """Return the dots that mark an opening: its middle, then the points beyond, from near to far.

    The result is empty if the opening is not in view.
    """
    if not taken.in_view:
        return ()
    away = float(np.linalg.norm(taken.middle_lps - eye))
    beyond = [dot for dot in taken.dots_lps if float(np.linalg.norm(dot - eye)) > away]
    return (_point(taken.middle_lps), *(_point(dot) for dot in beyond))


def _sides(forward: Points, into: Points) -> tuple[str, ...]:
    """Return the patient's directions (such as anterior) of an opening, as seen along the parent branch."""
    ahead = forward / np.linalg.norm(forward)
    across = into - float(into @ ahead) * ahead
    if float(np.linalg.norm(across)) < SAME_PLACE_MM:
        return ()
    return tuple(SIDES[letter] for letter in letters_of(across))


def _clockwise(
    way: _Way, taken: Opening, others: Sequence[Opening], mothers: dict[int, Branch]
) -> tuple[OtherWay, ...]:
    ordered = sorted(others, key=lambda one: ((one.hours - taken.hours) % 12.0, one.branch.id))
    return tuple(
        OtherWay(
            branch_title(one.branch),
            one.branch.id,
            whole_hour(one.hours) if one.in_view and not one.straight_ahead else None,
            _opening(way, mothers[one.branch.id], one.branch),
            in_view=one.in_view,
            opening_lps=_point(one.middle_lps),
            ahead_deg=one.ahead_limit_deg,
        )
        for one in ordered
    )


def _angle_deg(one: Points, other: Points) -> float:
    lengths = float(np.linalg.norm(one) * np.linalg.norm(other))
    return 0.0 if lengths == 0.0 else math.degrees(math.acos(float(np.clip(one @ other / lengths, -1.0, 1.0))))


def _moves_by_fork(
    forks_mm: Sequence[float], moves: Sequence[Move], ends_along_mm: Sequence[float] | None
) -> tuple[list[tuple[Move, ...]], tuple[Move, ...]]:
    """Return the moves of each turn, and those after the last turn; each move occurs once, in order.

    A move that begins before a fork belongs to this fork, because it moves the tip past it.
    """
    if ends_along_mm is None or len(ends_along_mm) != len(moves):
        found = "none" if ends_along_mm is None else str(len(ends_along_mm))
        raise UsageError(
            f"ends_along_mm: expected one number for each of {len(moves)} moves, where it ends; found {found}",
            code="plan.moves",
        )
    if not all(math.isfinite(mm) for mm in ends_along_mm):
        raise UsageError("ends_along_mm: expected finite numbers in mm from the origin of the route", code="plan.moves")
    parts: list[list[Move]] = [[] for _ in range(len(forks_mm) + 1)]
    turn = 0
    begins = ends_along_mm[0] - moves[0].advance_mm if moves else 0.0
    for move, ends in zip(moves, ends_along_mm, strict=True):
        while turn < len(forks_mm) and begins >= forks_mm[turn] - SAME_PLACE_MM:
            turn += 1
        parts[turn].append(move)
        begins = max(begins, ends)
    return [tuple(part) for part in parts[:-1]], tuple(parts[-1])


def _notes(zero: Zero | None, carina_depth_mm: float | None) -> tuple[str, ...]:
    found = []
    if zero is None:
        found.append(
            "the tree shows no main carina on the way, so distances are from fork to fork, and there are no depths"
            if carina_depth_mm is not None
            else "the tree shows no main carina on the way, so distances are counted from fork to fork"
        )
    elif zero == "axes":
        found.append(AXES_NOTE)
    if carina_depth_mm is not None and zero is not None:
        found.append("depths at the nose or mouth are estimates: the depth that was set for the carina, plus the way")
    return tuple(found)


def _point(point: Points) -> Point:
    return float(point[0]), float(point[1]), float(point[2])
