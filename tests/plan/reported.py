"""One phantom's plan, and the sheet that its report is made from."""

from __future__ import annotations

import dataclasses
import datetime
from functools import cache
from typing import Any

import numpy as np

import carina
from carina.plan import Plan, Verdict, judge_scopes, plan_route, turn_list
from carina.plan.moves import Move
from carina.plan.report import PlanSheet, make_sheet
from carina.plan.turns import TurnList
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


def turns(found: Airways, planned: Plan, *, ridge_mm: float | None = 9.0) -> TurnList:
    """The list of turns of the first route, with a move to each millimetre that a fork stands at."""
    route = planned.routes[0]
    lineage = found.tree.lineage(route.branch_id)
    ends = [float(mm) for mm in np.cumsum([branch.length_mm for branch in lineage[:-1]])]
    moves = [Move(-40.0, 35.0, mm) for mm in np.diff([0.0, *ends]).tolist()]
    return turn_list(found.tree, route, carina_ridge_mm=ridge_mm, moves=moves, ends_along_mm=ends)


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
