"""Judgement of several instruments on one route or on several routes, and the order of the verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from typing import Any

from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import UsageError
from carina.plan.instruments.tools import Tool
from carina.plan.routes.plan_route import Plan, PlannedRoute
from carina.plan.verdict.drive_search import EFFORT
from carina.plan.verdict.route_judge import InstrumentChecks, RouteJudge, SimulatedDrive, tool_for
from carina.plan.verdict.verdict import OUTCOMES, Verdict
from carina.scopes import ScopePreset, WallField, scope_presets
from carina.track import AirwayTree

__all__ = ["judge_pairs", "judge_scope", "judge_scopes", "pairs_in_order"]

NUM_THREADS, NUM_ROUTES = 2, 3
"""Number of drives at the same time, and of the best routes on which all instruments are judged."""


@shows_progress
def judge_scopes(
    tree: AirwayTree,
    plan: Plan,
    wall: WallField,
    *,
    route: PlannedRoute | None = None,
    scopes: Iterable[ScopePreset] | None = None,
    origin_depth_mm: float | None = None,
    errors: bool = True,
    effort: float = EFFORT,
    found: Callable[[Verdict], None] | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> tuple[Verdict, ...]:
    """Judge several instruments on one route.

    Parameters
    ----------
    tree, plan, wall
        The airways, the plan of `plan_route`, and the wall of the airways.
    route
        Route of the plan; the first one if None.
    scopes
        Instruments; the whole library if None.
    origin_depth_mm
        Insertion depth in mm at nose or mouth when the tip is at the origin of the route's distances, the main carina
        (`PlannedRoute.origin`); None leaves the check of the length open.
    errors
        Whether to consider the errors of measurements and instrument data; False treats them as exact.
    effort
        Limit of each search for a drive (`search_drive`).
    found
        Called with each verdict as soon as it is known: first those without a simulated drive, then those with one.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    tuple[Verdict, ...]
        Verdicts in the order of the instruments.

    Raises
    ------
    UsageError
        If the plan has no route, or a number is out of range.
    CancelledError
        If ``cancel()`` returned True.
    """
    judge = RouteJudge(
        tree,
        plan,
        wall,
        route=route,
        origin_depth_mm=origin_depth_mm,
        errors=errors,
        effort=effort,
        cancel=cancel,
    )
    listed = tuple(scope_presets() if scopes is None else scopes)
    on_progress = fraction_callback(progress_function(progress), "driving each instrument along the route")
    (verdicts,) = _judged([_Task(judge, listed)], found, on_progress)
    return verdicts


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """Instruments that are judged on one route, with one tool."""

    judge: RouteJudge
    scopes: tuple[ScopePreset, ...]


def _judged(
    tasks: Sequence[_Task], found: Callable[[Verdict], None] | None, on_progress: Callable[[float], None] | None
) -> list[tuple[Verdict, ...]]:
    """Return the verdicts of each task in the order of its instruments.

    All drives of all tasks share the threads, so no processor waits for the last drive of a task.
    """
    verdicts: dict[tuple[int, int], Verdict] = {}
    num = sum(len(task.scopes) for task in tasks)

    def tell(place: tuple[int, int], verdict: Verdict) -> None:
        verdicts[place] = verdict
        if found is not None:
            found(verdict)
        if on_progress is not None:
            on_progress(len(verdicts) / num)

    if on_progress is not None:
        on_progress(0.0)
    waiting: dict[tuple[int, int], InstrumentChecks] = {}
    for n, task in enumerate(tasks):
        for k, scope in enumerate(task.scopes):
            task.judge.stop_if_cancelled()
            figures = task.judge.figures(scope)
            if figures.driven_as is None:
                tell((n, k), task.judge.undriven(scope, figures))
            else:
                waiting[n, k] = figures
    with ThreadPoolExecutor(NUM_THREADS) as pool:
        # Instruments with the same mechanical sizes share one simulated drive.
        drives: dict[tuple[Any, ...], Future[SimulatedDrive]] = {}
        sharing: dict[Future[SimulatedDrive], list[tuple[int, int]]] = {}
        for place, figures in waiting.items():
            key = place[0], figures.drive_key
            if key not in drives:
                drives[key] = pool.submit(tasks[place[0]].judge.drive, figures)
            sharing.setdefault(drives[key], []).append(place)
        try:
            for done in as_completed(sharing):
                drive = done.result()
                for n, k in sharing[done]:
                    task = tasks[n]
                    tell((n, k), task.judge.driven(task.scopes[k], waiting[n, k], drive))
        except BaseException:
            for job in sharing:
                job.cancel()
            for task in tasks:
                task.judge.stopped = True
            raise
    return [tuple(verdicts[n, k] for k in range(len(task.scopes))) for n, task in enumerate(tasks)]


@shows_progress
def judge_pairs(
    tree: AirwayTree,
    plan: Plan,
    wall: WallField,
    *,
    routes: int = NUM_ROUTES,
    scopes: Iterable[ScopePreset] | None = None,
    available: Iterable[str] | None = None,
    origin_depth_mm: float | None = None,
    errors: bool = True,
    effort: float = EFFORT,
    found: Callable[[Verdict], None] | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> tuple[Verdict, ...]:
    """Judge each pair of a route and an instrument, the best pair first.

    An instrument whose channel does not take the plan's needle is judged with the first needle of the library that
    passes and reaches as far.

    Parameters
    ----------
    tree, plan, wall
        The airways, the plan of `plan_route`, and the wall of the airways.
    routes
        Number of routes, from the first one.
    available
        Names of the instruments that are available here; pairs of other instruments are listed behind them. None: all.
    origin_depth_mm
        As for `judge_scopes`, for the routes whose distances have the same origin as those of the first route.
    scopes, errors, effort, found, progress, cancel
        As for `judge_scopes`.

    Returns
    -------
    tuple[Verdict, ...]
        A verdict for each pair, the best pair first (`pairs_in_order`); ``route_key`` names the route, ``tool`` the
        tool.

    Raises
    ------
    UsageError
        If the plan has no route, or a number is out of range.
    CancelledError
        If ``cancel()`` returned True.
    """
    if not plan.routes:
        raise UsageError("the plan has no route to judge", code="plan.no-route")
    listed = list(scope_presets() if scopes is None else scopes)
    on_progress = fraction_callback(progress_function(progress), "driving each instrument along the best routes")
    chosen = plan.routes[:routes]
    by_tool: dict[Tool, list[ScopePreset]] = {}
    for scope in listed:
        by_tool.setdefault(tool_for(scope, plan.tool), []).append(scope)
    tasks: list[_Task] = []
    for route in chosen:
        judge = RouteJudge(
            tree,
            plan,
            wall,
            route=route,
            origin_depth_mm=origin_depth_mm if route.origin == chosen[0].origin else None,
            errors=errors,
            effort=effort,
            cancel=cancel,
        )
        tasks += [_Task(judge.with_tool(tool), tuple(presets)) for tool, presets in by_tool.items()]
    judged = [verdict for verdicts in _judged(tasks, found, on_progress) for verdict in verdicts]
    return pairs_in_order(plan, judged, available=available)


def pairs_in_order(
    plan: Plan, verdicts: Iterable[Verdict], *, available: Iterable[str] | None = None
) -> tuple[Verdict, ...]:
    """Return verdicts on pairs of route and instrument, the best pair first.

    The order is: available instruments, outcome, probability, rank of the route, the planned instrument, the
    instrument's name. An instrument that does not reach by a route states the better route by which it reaches.

    Parameters
    ----------
    plan
        The plan of the routes.
    verdicts
        Verdicts on routes of the plan.
    available
        Names of the available instruments; None: all.
    """
    known = None if available is None else set(available)
    number = {route.key: n for n, route in enumerate(plan.routes, 1)}
    listed = list(verdicts)

    def worth(one: Verdict) -> tuple[Any, ...]:
        absent = known is not None and one.scope.name not in known
        is_other = one.scope.name != plan.scope.name
        rank = OUTCOMES.index(one.outcome), -(one.share or 0.0), number[one.route_key]
        return absent, *rank, is_other, one.scope.name

    listed.sort(key=worth)
    reaching: dict[str, int] = {}
    for one in listed:
        if one.outcome == "reaches":
            reaching.setdefault(one.scope.name, number[one.route_key])
    return tuple(
        replace(one, would=f"reaches by route {reaching[one.scope.name]}")
        if one.outcome != "reaches" and one.scope.name in reaching
        else one
        for one in listed
    )


def judge_scope(
    tree: AirwayTree,
    plan: Plan,
    wall: WallField,
    scope: ScopePreset,
    *,
    route: PlannedRoute | None = None,
    origin_depth_mm: float | None = None,
    errors: bool = True,
    effort: float = EFFORT,
    cancel: Callable[[], bool] | None = None,
) -> Verdict:
    """Judge one instrument on one route.

    Parameters
    ----------
    tree, plan, wall, scope
        The airways, the plan, the wall of the airways, and the instrument.
    route, origin_depth_mm, errors, effort, cancel
        As for `judge_scopes`.

    Returns
    -------
    Verdict
        Its result.

    Raises
    ------
    UsageError
        If the plan has no route, or a number is out of range.
    CancelledError
        If ``cancel()`` returned True.
    """
    judge = RouteJudge(
        tree,
        plan,
        wall,
        route=route,
        origin_depth_mm=origin_depth_mm,
        errors=errors,
        effort=effort,
        cancel=cancel,
    )
    return judge.verdict(scope)
