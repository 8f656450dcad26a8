"""Plan of the routes to a target whose best routes a simulated scope has driven.

`carina.plan.routes` drafts the routes from the sizes of scope and airways. Here the scope is driven along the best
drafts. The outlook, the needle path and the share of hits of a driven route come from its drive, so that they equal
those of its verdict (docs/decisions/0122).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from carina.argument_checks import check_arguments, function, instance, lps_points, name_or, number_from, whole_from
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import UsageError, check_type
from carina.plan.instruments.tools import DEFAULT_TOOL, Tool
from carina.plan.instruments.tools import tool as tool_named
from carina.plan.movement.measure import MovementMeasurement
from carina.plan.movement.target_movement import TargetMovement
from carina.plan.routes.needle_hits import NeedleErrors
from carina.plan.routes.plan_route import (
    PLANNED_SCOPE,
    CancellableProgress,
    DraftPlan,
    Plan,
    PlannedRoute,
    PlanRequest,
    RoutePlace,
    check_target_type,
    draft_plan,
    is_at,
)
from carina.plan.routes.ranking import Outlook, ScoreWeights, order, worst
from carina.plan.targets.doubts import Confirmed
from carina.plan.targets.nodule import Nodule
from carina.plan.targets.target import PlanTarget
from carina.plan.verdict.route_judge import RouteJudge
from carina.plan.verdict.verdict import Verdict
from carina.scopes import ScopePreset, WallField, scope_preset
from carina.track import Airways, AirwayTree, TreeMeasures
from carina.volume import Volume

NUM_DRIVEN = 3
"""Default of the maximum number of routes along which drives are simulated."""
MAX_SPARES = 2
"""Maximum number of second-best scope positions, in branches already driven to, whose drives are simulated too."""
NUM_THREADS = 2
DRAFTED = 0.4
"""Share of the progress bar at which the routes are known for a needle without errors."""
NOT_DRIVEN = "the drive to this place was not simulated"
OUTLOOKS: dict[str, Outlook] = {"reaches": "reaches", "does not reach": "does not reach"}
"""Outlook of a route for the outcome of its verdict; *may reach* for all other outcomes."""


def _check_place(where: str, name: str, value: object) -> None:
    """Raise an error unless a value is None or a scope position: branch ID, distance in mm, index of the aim."""
    if value is None:
        return
    is_place = isinstance(value, tuple) and len(value) == 3
    if not (is_place and all(isinstance(one, int | float) and math.isfinite(one) for one in value)):  # type: ignore[attr-defined]
        raise UsageError(
            f"{where}: {name}: expected (branch ID, mm from the start of the airway tree, aim) or None; found {value!r}"
        )


def _check_movement(where: str, name: str, value: object) -> None:
    """Raise an error unless a value is a movement, a measurement or None."""
    if not isinstance(value, MovementMeasurement):
        instance(TargetMovement, "get one from carina.plan.measure_movement", optional=True)(where, name, value)


def _movement(moved_mm: float | None, movement: TargetMovement | MovementMeasurement | None) -> TargetMovement | None:
    """Return the movement of the arguments of `plan_route`; None if neither is given."""
    if movement is not None and moved_mm is not None:
        raise UsageError(
            "movement: expected moved_mm or movement; found both; leave one of them out", code="plan.range"
        )
    if isinstance(movement, MovementMeasurement):
        return movement.movement
    return TargetMovement("given", moved_mm) if moved_mm is not None else movement


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    target=check_target_type,
    scope=name_or(ScopePreset, "name one of carina.scopes.scope_presets"),
    tool=name_or(Tool, "name one of carina.plan.tools"),
    aims=lps_points(optional=True, or_one=True),
    vessel_margin_mm=number_from(0.0, 50.0, unit="mm"),
    moved_mm=number_from(0.0, 60.0, optional=True, unit="mm"),
    movement=_check_movement,
    errors=instance(NeedleErrors, "create a carina.plan.NeedleErrors", optional=True),
    weights=instance(ScoreWeights, "create a carina.plan.ScoreWeights", optional=True),
    wall=instance(WallField, "make one with carina.wall_field", optional=True),
    measures=instance(TreeMeasures, "get them from carina.measure_tree", optional=True),
    place=_check_place,
    drives=whole_from(0, 5),
    cancel=function,
)
def plan_route(
    volume: Volume,
    airways: Airways,
    target: PlanTarget | Nodule | ArrayLike,
    *,
    scope: ScopePreset | str = PLANNED_SCOPE,
    tool: Tool | str = DEFAULT_TOOL,
    aims: ArrayLike | None = None,
    vessel_margin_mm: float = 3.0,
    moved_mm: float | None = None,
    movement: TargetMovement | MovementMeasurement | None = None,
    errors: NeedleErrors | None = None,
    weights: ScoreWeights | None = None,
    wall: WallField | None = None,
    measures: TreeMeasures | None = None,
    place: RoutePlace | None = None,
    drives: int = NUM_DRIVEN,
    confirmed: Confirmed = False,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Plan:
    """Plan the routes to a nodule: the position of the scope, and the path of the needle from there.

    Parameters
    ----------
    volume, airways
        The CT and the airways in it.
    target
        A target with its aims, a nodule, or a point in one, LPS mm (`target_from_click`).
    scope, tool
        Instruments, or their names in the libraries. A tool that does not pierce needs a target in a lumen or against
        it.
    aims
        (k, 3) up to three points in the target, LPS mm, that the tool is aimed at; the centroid of the target if None.
        Each route states its aim.
    vessel_margin_mm
        Distance from the needle below which a vessel lowers the score and is listed.
    moved_mm
        Largest movement of the target since the CT; it follows from the lobe if None.
    movement
        Movement measured from a second CT (`carina.plan.measure_movement`), instead of ``moved_mm``.
    errors, weights
        Errors of the needle, and weights of the score.
    wall
        Wall of the airways (`carina.wall_field`); computed if None.
    measures
        Measures of the airways (`carina.measure_tree`). They are computed if None, or if they belong to another tree or
        come from an earlier method.
    place
        Place of the tip that the user has chosen, such as that of a pair of `carina.plan.judge_pairs`: branch ID,
        distance from the root in mm (`PlannedRoute.along_mm`), and index of the aim. It replaces the best place of its
        branch, and its route is driven first.
    drives
        Largest number of routes along which the scope's drive is simulated, 0 to 5, the best ones first. Only a route
        whose drive arrives and points at the target has the outlook *reaches*. With 0 the outlook is estimated from
        the sizes of scope and airways.
    confirmed
        Doubts whether the target is a nodule (`carina.plan.target_doubts`) that the user has confirmed: True for all
        of them, or their codes. Those that a `PlanTarget` lists as confirmed are confirmed too.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Plan
        Plan with its routes. Without a route, ``why`` states the reason.

    Raises
    ------
    UsageError
        If a number is out of range or a name unknown, an aim is outside the target, or airways or target belong to
        another CT.
    NoResultError
        If there is no nodule at the point (`grow_nodule`).
    UnconfirmedTargetError
        If the target has a doubt that is not confirmed. The code is that of the doubt, such as ``target.tube``.
    CancelledError
        If ``cancel()`` returned True.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> found = carina.find_airways(made.volume)
    >>> plan = carina.plan_route(made.volume, found, made.truth["nodule"]["centre_lps"])
    >>> plan.routes[0].leg.reaches
    True
    """
    check_type("plan_route", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("plan_route", "airways", airways, Airways, "get airways from carina.find_airways")
    preset = scope_preset(scope) if isinstance(scope, str) else scope
    used = tool_named(tool) if isinstance(tool, str) else tool
    for name, value, most in (("vessel_margin_mm", vessel_margin_mm, 50.0), ("moved_mm", moved_mm or 0.0, 60.0)):
        if not (math.isfinite(value) and 0.0 <= value <= most):
            raise UsageError(f"{name}: expected 0 to {most:g}; found {value}", code="plan.range")
    on_progress = fraction_callback(progress_function(progress), "planning the routes")
    report = CancellableProgress(on_progress, cancel, "planning was cancelled")
    request = PlanRequest(
        volume,
        airways,
        target,
        preset,
        used,
        aims=aims,
        vessel_margin_mm=vessel_margin_mm,
        movement=_movement(moved_mm, movement),
        errors=errors,
        weights=weights,
        wall=wall,
        measures=measures,
        place=place,
        confirmed=confirmed,
    )
    draft = draft_plan(
        request,
        report=lambda share: report(DRAFTED * share if drives else share),
        cancel=cancel,
    )
    if not drives or not draft.plan.routes:
        report(1.0)
        return draft.plan
    routes = _driven(draft, airways.tree, drives, report, cancel, place=place)
    report(1.0)
    return replace(draft.plan, routes=tuple(sorted(routes, key=order)))


def _driven(
    draft: DraftPlan,
    tree: AirwayTree,
    drives: int,
    report: Callable[[float], None],
    cancel: Callable[[], bool] | None,
    *,
    place: RoutePlace | None,
) -> list[PlannedRoute]:
    """Return the routes with the results of drives along the best ones, up to the first one that reaches.

    The route to ``place`` is driven before the others.
    """
    found = [
        replace(route, outlook="may reach", limits=(*route.limits, NOT_DRIVEN)) if route.outlook == "reaches" else route
        for route in draft.plan.routes
    ]
    wanted = {n for n, route in enumerate(draft.plan.routes) if is_at(route, place)}
    hopeful = [n for n, route in enumerate(draft.plan.routes) if route.outlook != "does not reach" and n not in wanted]
    likely = [(n, draft.plan.routes[n]) for n in (*wanted, *hopeful)][:drives]
    judged = _judged(draft, tree, likely, report, cancel)
    for n, route, verdict in judged:
        found[n] = route
        if verdict.outcome == "reaches":
            return found
    # If a drive does not arrive or point, the second-best place of the same branch is driven.
    failed = {(route.branch_id, route.aim): n for n, route, verdict in judged if _is_place_at_fault(verdict)}
    spares = [(failed[key], one) for one in draft.spares if (key := (one.branch_id, one.aim)) in failed]
    for n, route, _ in _judged(draft, tree, spares[:MAX_SPARES], report, cancel):
        if order(route) < order(found[n]):
            found[n] = route
    # The first route is always driven, because its attainable directions were only estimated before the drive.
    done = {n for n, _, _ in judged}
    for _ in range(drives):
        first = min(range(len(found)), key=lambda n: order(found[n]))
        if first in done:
            break
        done.add(first)
        for n, route, _ in _judged(draft, tree, [(first, draft.plan.routes[first])], report, cancel):
            found[n] = route
    return found


def _is_place_at_fault(verdict: Verdict) -> bool:
    """Return whether the drive or the pointing is uncertain although the scope fits through the route."""
    unsure = {check.name for check in verdict.checks if check.answer != "yes"}
    return bool(unsure & {"drive", "pointing"}) and "diameter" not in unsure


def _judged(
    draft: DraftPlan,
    tree: AirwayTree,
    chosen: list[tuple[int, PlannedRoute]],
    report: Callable[[float], None],
    cancel: Callable[[], bool] | None,
) -> list[tuple[int, PlannedRoute, Verdict]]:
    """Return routes after their drives with their numbers and verdicts, up to the first one that reaches."""
    judges = [RouteJudge(tree, draft.plan, draft.wall, route=route, cancel=cancel) for _, route in chosen]
    found: list[tuple[int, PlannedRoute, Verdict]] = []
    with ThreadPoolExecutor(NUM_THREADS) as pool:
        jobs: list[Future[Verdict]] = [pool.submit(judge.verdict, draft.plan.scope) for judge in judges]
        try:
            for (n, route), judge, job in zip(chosen, judges, jobs, strict=True):
                report(DRAFTED)
                verdict = job.result()
                found.append((n, _after_drive(draft, route, judge, verdict), verdict))
                if verdict.outcome == "reaches":
                    break
        finally:
            # Drives of routes ranked below the first that reaches are cancelled, so speed does not affect the result.
            for judge, job in zip(judges, jobs, strict=True):
                judge.stopped = True
                job.cancel()
    return found


def _after_drive(draft: DraftPlan, route: PlannedRoute, judge: RouteJudge, verdict: Verdict) -> PlannedRoute:
    """Return a route with the outlook, needle path and share of hits that result from its drive."""
    leg = route.leg
    depth, not_deep = draft.judge.depth_limit(leg)
    pointing = next((check for check in verdict.checks if check.name == "pointing"), None)
    if verdict.driven is not None and pointing is not None and pointing.share is not None:
        tip = judge.tip_of(draft.plan.scope)
        if pointing.share > 0.0 and tip is not None:
            leg = draft.leg_of(tip[:3, 3], np.array(route.forward), tip[:3, 2], judge.aim)
        leg = replace(leg, hit_share=pointing.share)
        if pointing.share == 0.0:
            leg = replace(leg, hit_share_moved=0.0)
        depth, not_deep = draft.judge.depth_limit(leg)
    outlook = worst(OUTLOOKS.get(verdict.outcome, "may reach"), depth, "may reach" if route.doubts else "reaches")
    limits = tuple(check.words for check in verdict.checks if check.answer != "yes")
    limits += tuple(words for words in not_deep if not any(words in known for known in limits))
    parts = draft.judge.parts(leg, route.narrowest_mm, draft.plan.nodule)
    driven = replace(
        route,
        leg=leg,
        hold=verdict.hold,
        withdrawn_mm=verdict.withdrawn_mm,
        outlook=outlook,
        chance=route.chance if verdict.share is None else min(route.chance, verdict.share),
        limits=limits,
        parts=parts,
        score=draft.judge.score(parts),
    )
    judge.pass_on(driven)
    return driven
