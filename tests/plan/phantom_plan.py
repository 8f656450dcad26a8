"""A plan in the phantom and the content of its report; all test files that use this plan run in one process."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable
from functools import cache
from typing import Any
from unittest.mock import patch

import numpy as np

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.plan import Plan, Verdict, judge_scopes, plan_route, turn_list
from carina.plan.hand_moves import Move
from carina.plan.report import PlanSheet, make_sheet
from carina.plan.report import plan_sheet as sheet_module
from carina.plan.turns.clips import TurnClip
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.pictures import TurnPicture
from carina.plan.turns.turn_list import Turn, TurnList
from carina.render import Picture, RenderStats
from carina.scopes import Pose, WallField, scope_preset
from carina.track import Airways
from carina.volume import Volume

CHEST: dict[str, Any] = {"seed": 2, "spacing_mm": 1.1, "nodule": True}
DAY = datetime.date(2026, 11, 25)


def volume() -> Volume:
    return cached_phantom(**CHEST).volume


def airways() -> Airways:
    return cached_airways(**CHEST)


@cache
def wall() -> WallField:
    return carina.wall_field(volume(), airways())


@cache
def plan() -> Plan:
    return plan_route(volume(), airways(), cached_phantom(**CHEST).truth["nodule"]["centre_lps"], wall=wall())


@cache
def verdicts() -> tuple[Verdict, ...]:
    scopes = [scope_preset(name) for name in ("thin", "ultrathin", "ion")]
    return judge_scopes(airways().tree, plan(), wall(), scopes=scopes)


def turns(found: Airways, planned: Plan) -> TurnList:
    """Return the list of turns of the first route, with one move to each fork."""
    route = planned.routes[0]
    lineage = found.tree.lineage(route.branch_id)
    ends = [float(mm) for mm in np.cumsum([branch.length_mm for branch in lineage[:-1]])]
    moves = [Move(-40.0, 35.0, mm) for mm in np.diff([0.0, *ends]).tolist()]
    return turn_list(found.tree, route, moves=moves, ends_along_mm=[route.origin.past_mm(mm) for mm in ends])


def _key(one: Any) -> object:
    if isinstance(one, np.ndarray):
        return one.tobytes()
    return one if isinstance(one, float | tuple) else id(one)


def once(make: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that caches the results of ``make``.

    The key consists of the identity of objects and the content of arrays. The arguments are stored, so that their ids
    stay unique.
    """
    made: dict[tuple[object, ...], tuple[Any, Any]] = {}

    def same(*given: Any) -> Any:
        key = tuple(_key(one) for one in given)
        if key not in made:
            made[key] = given, make(*given)
        return made[key][1]

    return same


# Pictures of one target in one CT are rendered once: rendering takes about 2 s, and about thirty sheets differ only in
# text.
RENDERED = {
    name: once(getattr(sheet_module, name))
    for name in ("Renderer", "LumenOutline", "surroundings", "target_slices", "needle_slice", "place_slices")
}


def sheet(**more: Any) -> PlanSheet:
    """Return the sheet of the plan's report; ``more`` are options of the sheet."""
    if not more:
        return _usual()
    options: dict[str, Any] = {"verdicts": verdicts(), "made_on": DAY, "wall": wall()} | more
    with patch.multiple("carina.plan.report.plan_sheet", **RENDERED):
        return make_sheet(
            options.pop("volume", volume()), options.pop("airways", airways()), options.pop("plan", plan()), **options
        )


@cache
def _usual() -> PlanSheet:
    return make_sheet(
        volume(), airways(), plan(), verdicts=verdicts(), turns=turns(airways(), plan()), made_on=DAY, wall=wall()
    )


def still(turn: Turn, *, operator: Operator = "head", in_view: bool = True, shade: int = 0) -> TurnPicture:
    """Return a picture of a turn that is not rendered: all pixels have one grey level."""
    rgb = np.full((8, 12, 3), shade, np.uint8)
    picture = Picture(rgb, "airway", RenderStats("leap", 12, 8, 96, 96, 0, 0, 0, 0, 0, 0.0), lps_from_camera=np.eye(4))
    return TurnPicture(turn, operator, picture, in_view, np.zeros((8, 12), bool))


def clip(turn: Turn, *, operator: Operator = "head") -> TurnClip:
    """Return a clip of a turn with three frames that are not rendered."""
    frames = tuple(np.full((16, 16, 3), shade, np.uint8) for shade in (0, 100, 200))
    return TurnClip(turn, operator, frames, (Pose(np.eye(4)),) * 3, 1.5)


def with_drawn_branch() -> tuple[Airways, Plan]:
    """Return the airways with one branch of the first route drawn by hand, and a plan in these airways.

    The branch is the second last of the route.
    """
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
