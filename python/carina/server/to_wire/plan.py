"""Conversion of the plans of a case (targets, routes, verdicts, turns) to a wire message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np

from carina.plan import ORDER_RULE, STATION_NOTE, WHERE_WORDS, compare_targets, tools
from carina.plan.reasons import reasons_against
from carina.server.wire import messages as wire
from carina.session import PlannedTarget, PlanningInfo, chosen_number, shown_surface
from carina.typed_reading import read_plain

if TYPE_CHECKING:
    from carina.case.document import Target
    from carina.plan import CArmAngles, Nodule, Plan, PlannedRoute, TurnList, Verdict
    from carina.plan.reasons import Severity
    from carina.session.derived.plans import PlanOutcome

Value = TypeVar("Value", bound=msgspec.Struct)


def plans_message(info: PlanningInfo) -> wire.Plans:
    """Return the wire message of the plans for the steps *Target* and *Route*."""
    return wire.Plans(
        targets=tuple(_target(one, info) for one in info.targets),
        standing=info.standing,
        verdicts=tuple(_verdict(verdict) for verdict in info.verdicts),
        verdicts_standing=info.verdicts_standing,
        pairs=tuple(_pair(pair, info.available) for pair in info.pairs),
        pairs_standing=info.pairs_standing,
        available=info.available,
        tools=tuple((one.name, one.title) for one in tools()),
        turns=() if info.turns is None else _turns(info, info.turns),
        parking=None if info.turns is None else (info.turns.words("head")[-1], info.turns.words("facing")[-1]),
        park_from_carina_mm=None if info.turns is None else info.turns.park_from_carina_mm,
        park_depth_estimate_mm=None if info.turns is None else info.turns.park_depth_estimate_mm,
        dicom_problem=info.dicom_problem,
        carm=None if info.carm is None else _carm(info.carm),
        carm_standing=info.carm_standing,
        comparison=_comparison(info),
        station_note=STATION_NOTE,
    )


def _turns(info: PlanningInfo, turns: TurnList) -> tuple[wire.PlannedTurn, ...]:
    airways = info.document.airways
    ends = {} if airways is None else {_point(branch.points[-1]): branch.id for branch in airways.tree.branches}
    value = turns.to_json()
    lines = zip(turns.turns, value["turns"], value["words"]["head"], value["words"]["facing"], strict=False)
    return tuple(
        to_wire_value(
            wire.PlannedTurn,
            one
            | {
                "head": head,
                "facing": facing,
                "doubts": turn.cautions,
                "fork_branch_id": ends.get(_point(turn.fork_lps), turn.to_branch_id),
                "openings": [
                    wire.TurnOpening(
                        turn.to_branch_id,
                        turn.opening_lps,
                        in_view=turn.in_view,
                        straight_ahead=turn.straight_ahead,
                        ahead_deg=turn.ahead_deg,
                    ),
                    *(
                        wire.TurnOpening(
                            other.branch_id,
                            other.opening_lps,
                            in_view=other.in_view,
                            straight_ahead=other.straight_ahead,
                            ahead_deg=other.ahead_deg,
                        )
                        for other in turn.others
                    ),
                ],
                "hour_doubt": None if turn.hour_doubt is None else turn.hour_doubt.words,
            },
        )
        for turn, one, head, facing in lines
    )


def _target(one: PlannedTarget, info: PlanningInfo) -> wire.TargetPlan:
    lesion = one.target.lesion
    assert lesion is not None
    planned = one.planned
    plan = None if planned is None else planned.plan
    doubts = _doubts(one)
    route = info.document.route
    mine = route is not None and route.target_id == one.target.target_id
    chosen = None if plan is None or not mine else chosen_number(info.document, plan)
    return wire.TargetPlan(
        target_id=one.target.target_id,
        centre_lps=_point(lesion.nodule.centre_lps),
        size=_size(lesion.nodule),
        where=WHERE_WORDS[lesion.target.where],
        long_mm=float(lesion.nodule.long_mm),
        num_aims=len(lesion.target.aims),
        surface=_surface(lesion.nodule),
        options=lesion.options,
        moved_mm=None if plan is None else plan.moved_mm,
        movement=None if plan is None else plan.movement.words,
        bronchus_sign=None if plan is None else plan.sign_words,
        reasons=() if plan is None else _reasons(plan, chosen, info),
        routes=() if plan is None else tuple(_route(route) for route in plan.routes),
        problem=None if planned is None else planned.problem,
        notes=(*lesion.nodule.notes, *(() if plan is None else plan.notes)),
        doubts=tuple(doubts.items()),
        unconfirmed=tuple(code for code in doubts if code not in lesion.target.confirmed),
        chosen=chosen,
        stations=_stations(planned, chosen),
    )


def _stations(planned: PlanOutcome | None, chosen: int | None) -> tuple[wire.StationOnRoute, ...]:
    """Return the stations of the chosen route, or of the best one if none is chosen."""
    if planned is None or not planned.stations:
        return ()
    return tuple(to_wire_value(wire.StationOnRoute, one.to_json()) for one in planned.stations[(chosen or 1) - 1])


def _carm(found: CArmAngles) -> wire.CArmPositions:
    value = found.to_json()
    return to_wire_value(
        wire.CArmPositions, value | {"angles": [to_wire_value(wire.CArmPosition, one) for one in value["angles"]]}
    )


def _comparison(info: PlanningInfo) -> wire.TargetComparison | None:
    """Return the planned targets in the order of `carina.plan.compare_targets`, and the others with their reason."""
    if len(info.document.targets) < 2:
        return None
    outcomes = {one.target.target_id: one.planned for one in info.targets}
    planned: list[tuple[Target, Plan]] = []
    unplanned = []
    for target in info.document.targets:
        outcome = outcomes.get(target.target_id)
        if outcome is not None and outcome.plan is not None:
            planned.append((target, outcome.plan))
        else:
            why = _unplanned_reason(target, outcome, info)
            unplanned.append(wire.UnplannedTarget(target.target_id, why))
    rows = []
    for row in compare_targets([plan for _, plan in planned], [target.name for target, _ in planned]):
        # Targets can have the same name, and targets with the same boundary have the same plan.
        place = next(n for n, one in enumerate(planned) if one[1] is row.plan and one[0].name == row.title)
        target, _ = planned.pop(place)
        rows.append(to_wire_value(wire.PlannedTargetRow, row.to_json() | {"target_id": target.target_id}))
    return wire.TargetComparison(ORDER_RULE, tuple(rows), tuple(unplanned))


def _unplanned_reason(target: Target, outcome: PlanOutcome | None, info: PlanningInfo) -> str:
    if target.lesion is None:
        return "not planned: the target has no size, so there is no needle to plan"
    if outcome is not None and outcome.problem is not None:
        return f"not planned: {outcome.problem}"
    if info.document.airways is None:
        return "not planned: the airways have not been segmented"
    if info.standing in {"failed", "stopped"}:
        return "not planned: planning has stopped"
    return "not planned yet: the routes are being planned"


def _reasons(plan: Plan, chosen: int | None, info: PlanningInfo) -> tuple[tuple[str, str, Severity], ...]:
    """Return the reasons against a plan; verdicts and turns are those of the chosen route."""
    found = (
        reasons_against(plan)
        if chosen is None
        else reasons_against(plan, route=plan.routes[chosen - 1], verdicts=info.verdicts, turns=info.turns)
    )
    return tuple((reason.code, reason.words, reason.severity) for reason in found)


def _doubts(one: PlannedTarget) -> dict[str, str]:
    """Return the doubts of a target by code: those that its plan found, then others found with its boundary."""
    lesion, planned = one.target.lesion, one.planned
    assert lesion is not None
    found = () if planned is None else planned.doubts
    if planned is None or planned.plan is None:
        known = {doubt.code for doubt in found}
        found = (*found, *(doubt for doubt in lesion.target.doubts if doubt.code not in known))
    return {doubt.code: doubt.words for doubt in found}


def _size(nodule: Nodule) -> str:
    ml, error = nodule.volume_mm3 / 1000.0, nodule.volume_error_mm3 / 1000.0
    digits = 2 if ml >= 0.1 else 3
    across = f"{nodule.long_mm:.1f} \u00d7 {nodule.short_mm:.1f} mm (\u00b1 {nodule.diameter_error_mm:.1f})"
    return f"{nodule.kind} nodule, {across}, {ml:.{digits}f} ml (\u00b1 {error:.{digits}f})"


def _surface(nodule: Nodule) -> wire.TargetSurface:
    mesh = shown_surface(nodule)
    vertices = tuple(_point(p) for p in np.round(mesh.vertices_lps, 2))
    return wire.TargetSurface(vertices, tuple(int(n) for n in mesh.triangles.ravel()))


def to_wire_value(kind: type[Value], value: Mapping[str, Any]) -> Value:
    """Return a wire value from the plain JSON types of a plan's value; keys that the wire does not carry are left out.

    Window and plan.json then state the same numbers, because both come from one ``to_json``.
    """
    return read_plain({field: value[field] for field in kind.__struct_fields__}, kind)


def _route(route: PlannedRoute) -> wire.RouteOffer:
    value = route.to_json()
    crossed = [to_wire_value(wire.NeedleTissue, one) for one in value["leg"]["crossed"]]
    leg = to_wire_value(wire.NeedleLeg, value["leg"] | {"crossed": crossed})
    origin = to_wire_value(wire.RouteOrigin, value["origin"])
    predictors = None if route.predictors is None else to_wire_value(wire.FailurePredictors, value["predictors"])
    return to_wire_value(wire.RouteOffer, value | {"leg": leg, "origin": origin, "predictors": predictors})


def _verdict(verdict: Verdict) -> wire.ScopeVerdict:
    value = verdict.to_json()
    checks = [to_wire_value(wire.ScopeCheck, check) for check in value["checks"]]
    return to_wire_value(wire.ScopeVerdict, value | {"checks": checks, "was_driven": verdict.driven is not None})


def _pair(verdict: Verdict, available: tuple[str, ...] | None) -> wire.RoutePair:
    is_available = available is None or verdict.scope.name in available
    return to_wire_value(wire.RoutePair, verdict.to_json() | {"available": is_available})


def _point(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
