"""One phantom's plan, and the sheet that its report is made from."""

from __future__ import annotations

import dataclasses
import datetime
from functools import cache
from typing import Any

import carina
from carina.plan import Plan, Verdict, judge_scopes, plan_route
from carina.plan.moves import Move
from carina.plan.report import PlanSheet, make_sheet
from carina.plan.turns import Turn, TurnList
from carina.scopes import WallField, scope_preset
from carina.track import Airways
from carina.volume import Volume
from made import made_airways, made_phantom

CHEST: dict[str, Any] = {"seed": 2, "spacing_mm": 1.1, "nodule": True}
DAY = datetime.date(2026, 11, 25)


def volume() -> Volume:
    return made_phantom(**CHEST).volume


def airways() -> Airways:
    return made_airways(**CHEST)


@cache
def wall() -> WallField:
    return carina.wall_field(volume(), airways())


@cache
def plan() -> Plan:
    return plan_route(volume(), airways(), made_phantom(**CHEST).truth["nodule"]["center_lps"], wall=wall())


@cache
def verdicts() -> tuple[Verdict, ...]:
    scopes = [scope_preset(name) for name in ("thin", "ultrathin", "ion")]
    return judge_scopes(airways().tree, plan(), wall(), scopes=scopes, spacing_mm=1.1)


def turns(found: Airways, planned: Plan, doubts: tuple[str, ...] = ()) -> TurnList:
    """A list of turns with true places and made-up hours."""
    route = planned.routes[0]
    lineage = found.tree.lineage(route.branch_id)
    assert route.from_carina_mm is not None
    along, told = route.from_carina_mm - route.along_mm, []
    for n, (before, branch) in enumerate(zip(lineage, lineage[1:], strict=False)):
        along += before.length_mm
        x, y, z = (float(v) for v in branch.points[0])
        hours = 1.5 + 1.9 * n
        turn = Turn(
            from_branch=before.name or "?",
            to_branch=branch.name or f"branch {branch.id}",
            to_branch_id=branch.id,
            fork_lps=(x, y, z),
            from_carina_mm=along,
            from_fork_mm=before.length_mm,
            clock_head=hours,
            clock_facing=(hours + 6.0) % 12.0 or 12.0,
            angle_deg=33.0,
            diameter_mm=2.0 * float(branch.radius.min()),
            moves=(Move(-40.0, 35.0, before.length_mm),),
            doubts=doubts if n == 2 else (),
        )
        told.append(turn)
    return TurnList(tuple(told), route.from_carina_mm, route.along_mm - (along - told[0].from_carina_mm), None)


def sheet(**more: Any) -> PlanSheet:
    """The usual sheet, or one made anew with other choices."""
    if not more:
        return _usual()
    told: dict[str, Any] = {"verdicts": verdicts(), "made_on": DAY, "wall": wall()} | more
    return make_sheet(told.pop("volume", volume()), told.pop("airways", airways()), told.pop("plan", plan()), **told)


@cache
def _usual() -> PlanSheet:
    return make_sheet(
        volume(), airways(), plan(), verdicts=verdicts(), turns=turns(airways(), plan()), made_on=DAY, wall=wall()
    )


def with_drawn_branch() -> tuple[Airways, Plan]:
    """The same airways, the branch before the last of the first route drawn by hand, and a plan in them."""
    found, route = airways(), plan().routes[0]
    drawn = found.tree.lineage(route.branch_id)[-2].id
    branches = tuple(
        dataclasses.replace(one, kind="manual", confidence=None, doubtful_mm=one.length_mm) if one.id == drawn else one
        for one in found.tree.branches
    )
    changed = dataclasses.replace(found, tree=dataclasses.replace(found.tree, branches=branches))
    name = found.tree.branch(drawn).name or f"branch {drawn}"
    routes = tuple(dataclasses.replace(one, doubts=(f"{name} was drawn by hand",)) for one in plan().routes[:1])
    return changed, dataclasses.replace(plan(), routes=routes + plan().routes[1:])
