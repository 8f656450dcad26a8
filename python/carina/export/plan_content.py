"""Contents common to all files of a plan: named targets, the path of the scope, the needle, and texts.

All coordinates are in LPS, mm. The texts state what is not known about a plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import UsageError, check_type
from carina.plan import Nodule, Plan, PlannedRoute
from carina.plan.reasons import plan_reasons, route_reasons, target_reasons
from carina.track import AirwayTree

Points = NDArray[np.float64]

ONE_TARGET = "Target"
"""Name of the plan's only target if the user gave it none."""
NOT_A_DEVICE = "Not a medical device."
CORNER_MM = 0.7
OFF_ROUTE_MM = 3.0
"""Maximum accepted distance in mm between the scope's tip and the smoothed route.

The planned tip is on the tree's own centreline, and smoothing moves a route by less than this distance.
"""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class DrawnRoute:
    """A planned route as a polyline, with its title, its description and its needle."""

    title: str
    """Title, such as *Route 1: RB4a*."""
    route: PlannedRoute
    way_lps: Points
    """(n, 3) points from the beginning of the tree to the scope's tip, about 1 mm apart, LPS mm."""
    words: str
    """Description of the route in sentences; doubts come first."""

    @property
    def number_words(self) -> str:
        """Short name of the route without its branch, such as *Route 1*."""
        return self.title.partition(":")[0]

    @property
    def is_doubtful(self) -> bool:
        """Whether part of the route was drawn by hand, is a bridge, or may not be an airway."""
        return bool(self.route.doubts)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class DrawnTarget:
    """Target with its routes, the best one first."""

    name: str
    plan: Plan
    routes: tuple[DrawnRoute, ...]
    words: str
    """Size with errors, adjacent structures, possible movement, and the reason if there is no route."""


def named_plans(plan: Plan | Mapping[str, Plan]) -> dict[str, Plan]:
    """Return plans by the names of their targets; the name of a single plan is "Target".

    Parameters
    ----------
    plan
        A plan, or several by the names of their targets.

    Raises
    ------
    UsageError
        If there is no plan, a name is empty, or a value is not a plan.
    """
    found = {ONE_TARGET: plan} if isinstance(plan, Plan) else plan
    check_type("exporting a plan", "plan", found, Mapping, "get it from carina.plan_route")
    if not found:
        raise UsageError("exporting a plan: there is no target; plan a route first", code="plan.no-target")
    for name, one in found.items():
        check_type("exporting a plan", f"the plan of {name!r}", one, Plan, "get it from carina.plan_route")
        if not isinstance(name, str) or not name.strip() or not name.isprintable():
            raise UsageError(
                f"exporting a plan: expected a name of one line for each target; found {name!r}", code="plan.name"
            )
    return dict(found)


def marked_nodules(plans: Mapping[str, Plan]) -> dict[str, Nodule]:
    """Return the nodules of plans by name; their notes are the reasons against the target (`target_reasons`)."""
    return {
        name: replace(one.nodule, notes=tuple(reason.words for reason in target_reasons(one)))
        for name, one in plans.items()
    }


def note_sentences(nodule: Nodule) -> str:
    """Return the notes of a nodule as sentences after a space; empty without notes."""
    return "".join(f" {note[:1].upper()}{note[1:].rstrip('.')}." for note in nodule.notes)


def drawn_plans(plan: Plan | Mapping[str, Plan], tree: AirwayTree) -> tuple[DrawnTarget, ...]:
    """Return the targets of plans with their routes as polylines and with their texts.

    Parameters
    ----------
    plan
        A plan, or several by the names of their targets.
    tree
        The airway tree that the plans were made on.

    Raises
    ------
    UsageError
        If there is no plan, or a plan was made on another tree (``plan.other-tree``).
    """
    check_type("exporting a plan", "tree", tree, AirwayTree, "get it from carina.find_airways")
    found = named_plans(plan)
    return tuple(
        DrawnTarget(
            name,
            one,
            tuple(_drawn_route(route, number, one, tree) for number, route in enumerate(one.routes, 1)),
            _target_words(one),
        )
        for name, one in found.items()
    )


def _drawn_route(route: PlannedRoute, number: int, plan: Plan, tree: AirwayTree) -> DrawnRoute:
    return DrawnRoute(
        f"Route {number}: {route.branch_name}", route, _route_polyline(tree, route, number), _route_words(route, plan)
    )


def _route_polyline(tree: AirwayTree, route: PlannedRoute, number: int) -> Points:
    """Return the points (n, 3) of the smoothed route in LPS mm; the last point is the exact position of the tip."""
    tip = np.array(route.leg.tip_lps)
    if all(branch.id != route.branch_id for branch in tree.branches):
        raise _other_tree_error(f"route {number} ends in branch {route.branch_id}, which this tree does not have")
    whole = tree.route_to(route.branch_id).points_lps
    off_mm = np.linalg.norm(whole - tip, axis=1)
    nearest = int(np.argmin(off_mm))
    gap_mm = _distance_to_line_mm(whole, tip)
    if gap_mm > OFF_ROUTE_MM:
        raise _other_tree_error(f"the scope tip of route {number} lies {gap_mm:.1f} mm from this tree's branch")
    # The route line ends before the tip, so that its last piece does not turn back.
    if 0 < nearest < len(whole) and _is_past(whole, nearest, tip):
        nearest -= 1
    before = whole[: nearest + 1]
    # The tip is beside the smooth line; a point close to the tip would make a corner there.
    while len(before) > 1 and float(np.linalg.norm(before[-1] - tip)) < CORNER_MM:
        before = before[:-1]
    return np.concatenate([before, tip[None]])


def _distance_to_line_mm(points: Points, place: Points) -> float:
    """Return the distance in mm of a point from a polyline."""
    if len(points) < 2:
        return float(np.linalg.norm(points[0] - place))
    steps = np.diff(points, axis=0)
    squares = np.maximum((steps**2).sum(axis=1), 1e-12)
    share = np.clip(((place - points[:-1]) * steps).sum(axis=1) / squares, 0.0, 1.0)
    return float(np.linalg.norm(points[:-1] + share[:, None] * steps - place, axis=1).min())


def _is_past(points: Points, n: int, tip: Points) -> bool:
    """Return whether point ``n`` of the route is farther along the route than the tip."""
    return float((points[n] - tip) @ (points[n] - points[n - 1])) > 0.0


def _other_tree_error(problem: str) -> UsageError:
    return UsageError(
        f"exporting a plan: {problem}; expected the airway tree that the plan was made on: export with that tree, or "
        "plan again",
        code="plan.other-tree",
    )


def _target_words(plan: Plan) -> str:
    nodule = plan.nodule
    ml = nodule.volume_error_mm3 / 1000.0
    parts = [f"{nodule.words} (90 % within {nodule.diameter_error_mm:.1f} mm and {ml:.2f} ml)"]
    parts += [reason.words for reason in (*plan_reasons(plan), *target_reasons(plan))]
    if plan.sign_branch is None:
        parts.append("no bronchus sign")
    else:
        where = {"into": "leads into it", "beside": "lies against it"}.get(plan.bronchus_sign, plan.bronchus_sign)
        parts.append(f"bronchus sign: {plan.sign_branch} {where}")
    parts.append(plan.movement.words)
    return _as_sentences(parts)


def _route_words(route: PlannedRoute, plan: Plan) -> str:
    leg = route.leg
    parts = [reason.words for reason in route_reasons(plan, route)]
    parts.append(f"scope tip {route.place_words}")
    if not route.fits:
        doubt = "too narrow" if route.fit == "does not fit" else "within its error too narrow"
        parts.append(f"{doubt} for {plan.scope.title}, which needs {plan.scope.fit_mm:.1f} mm")
    parts.append(
        f"{plan.tool.title}: {leg.to_target_mm:.1f} mm from the tip to the target, {leg.angle_deg:.0f} degrees to the "
        f"airway, {leg.in_target_mm:.1f} mm in the target"
    )
    if leg.vessel_mm is None:
        parts.append("no vessel seen near the needle")
    elif leg.crosses_vessel:
        parts.append("the needle crosses a vessel that the CT shows")
    else:
        parts.append(f"nearest vessel seen {leg.vessel_mm:.1f} mm from the needle")
    parts.append(route.hit_words)
    return _as_sentences(parts)


def _as_sentences(texts: list[str]) -> str:
    parts = [" ".join(one.split()).rstrip(".") for one in [*texts, NOT_A_DEVICE]]
    return ". ".join(one[:1].upper() + one[1:] for one in parts) + "."
