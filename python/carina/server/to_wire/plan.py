"""Conversion of the plans of a case (targets, routes, verdicts, turns) to a wire message."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from carina.case.routes import NeedleLine
from carina.plan import WHERE_WORDS, tools
from carina.server.wire import messages as wire
from carina.session import PlannedTarget, PlanningInfo, chosen_number, shown_surface

if TYPE_CHECKING:
    from carina.plan import Nodule, Plan, PlannedRoute, Verdict

__all__ = ["plans_message"]


def plans_message(info: PlanningInfo) -> wire.Plans:
    """Return the wire message of the plans for the steps *Target* and *Route*."""
    return wire.Plans(
        targets=tuple(_target(one, info) for one in info.targets),
        standing=info.standing,
        verdicts=tuple(_verdict(verdict) for verdict in info.verdicts),
        verdicts_standing=info.verdicts_standing,
        tools=tuple((one.name, one.title) for one in tools()),
        turns=() if info.turns is None else _turns(info),
        parking=None if info.turns is None else (info.turns.words("head")[-1], info.turns.words("facing")[-1]),
        dicom_problem=info.dicom_problem,
    )


def _turns(info: PlanningInfo) -> tuple[wire.PlannedTurn, ...]:
    assert info.turns is not None
    airways = info.document.airways
    ends = {} if airways is None else {_point(branch.points[-1]): branch.id for branch in airways.tree.branches}
    lines = (info.turns.words("head"), info.turns.words("facing"))
    return tuple(
        wire.PlannedTurn(
            head=lines[0][n],
            facing=lines[1][n],
            doubts=turn.cautions,
            fork_branch_id=ends.get(turn.fork_lps, turn.to_branch_id),
            seen_from_lps=turn.seen_from_lps,
            openings=(
                wire.TurnOpening(
                    branch_id=turn.to_branch_id,
                    middle_lps=turn.opening_lps,
                    in_view=turn.in_view,
                    straight_ahead=turn.straight_ahead,
                ),
                *(
                    wire.TurnOpening(
                        branch_id=other.branch_id,
                        middle_lps=other.opening_lps,
                        in_view=other.in_view,
                        straight_ahead=other.straight_ahead,
                    )
                    for other in turn.others
                ),
            ),
            hour_doubt=None if turn.hour_doubt is None else turn.hour_doubt.words,
        )
        for n, turn in enumerate(info.turns.turns)
    )


def _target(one: PlannedTarget, info: PlanningInfo) -> wire.TargetPlan:
    lesion = one.target.lesion
    assert lesion is not None
    planned = one.planned
    plan = None if planned is None else planned.plan
    route = info.document.route
    mine = route is not None and route.target_id == one.target.target_id
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
        bronchus_sign=None if plan is None else plan.bronchus_sign,
        routes=() if plan is None else tuple(_route(plan, route) for route in plan.routes),
        problem=None if planned is None else planned.problem,
        notes=(*lesion.nodule.notes, *(() if plan is None else plan.notes)),
        chosen=None if plan is None or not mine else chosen_number(info.document, plan),
    )


def _size(nodule: Nodule) -> str:
    ml, error = nodule.volume_mm3 / 1000.0, nodule.volume_error_mm3 / 1000.0
    digits = 2 if ml >= 0.1 else 3
    across = f"{nodule.long_mm:.1f} \u00d7 {nodule.short_mm:.1f} mm (\u00b1 {nodule.diameter_error_mm:.1f})"
    return f"{nodule.kind} nodule, {across}, {ml:.{digits}f} ml (\u00b1 {error:.{digits}f})"


def _surface(nodule: Nodule) -> wire.TargetSurface:
    mesh = shown_surface(nodule)
    vertices = tuple(_point(p) for p in np.round(mesh.vertices_lps, 2))
    return wire.TargetSurface(vertices, tuple(int(n) for n in mesh.triangles.ravel()))


def _route(plan: Plan, route: PlannedRoute) -> wire.RouteOffer:
    leg = route.leg
    return wire.RouteOffer(
        branch_id=route.branch_id,
        branch_name=route.branch_name,
        from_carina_mm=plan.past_carina_mm(route),
        narrowest_mm=route.width.mm,
        narrowest_error_mm=route.width.error_mm,
        narrowest_by=route.width.source,
        narrowest_why=route.width.why,
        fit=route.fit,
        outlook=route.outlook,
        limits=tuple(route.limits),
        needle=NeedleLine((_point(leg.tip_lps), _point(leg.aim_lps)), float(leg.to_target_mm)),
        angle_deg=leg.angle_deg,
        in_target_mm=leg.in_target_mm,
        vessel_mm=leg.vessel_mm,
        hit_share=leg.hit_share,
        hit_share_moved=leg.hit_share_moved,
        crossed=tuple(wire.NeedleTissue(one.tissue, (one.start_mm, one.end_mm)) for one in leg.crossed),
        score=route.score,
        doubts=tuple(route.doubts),
    )


def _verdict(verdict: Verdict) -> wire.ScopeVerdict:
    return wire.ScopeVerdict(
        scope=verdict.scope.name,
        title=verdict.scope.title,
        outcome=verdict.outcome,
        words=verdict.words,
        share=verdict.share,
        would=verdict.would,
        checks=tuple(wire.ScopeCheck(c.name, c.answer, c.words, c.basis) for c in verdict.checks),
        was_driven=verdict.driven is not None,
    )


def _point(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
