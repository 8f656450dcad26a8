"""Planning: from a nodule in the lung to a way there."""

from carina.plan.last_leg import Crossed, LastLeg, NeedleScene, last_leg
from carina.plan.needle import NeedleErrors, hit_share
from carina.plan.nodule import Nodule, NoduleKind, grow_nodule
from carina.plan.report import PlanSheet, make_sheet, write_report
from carina.plan.route_turns import main_carina_ridge_mm, turn_list
from carina.plan.routes import Plan, PlannedRoute, ScoreWeights, plan_route
from carina.plan.surroundings import Surroundings, surroundings
from carina.plan.tools import DEFAULT_TOOL, Tool, tool, tools
from carina.plan.turn_pictures import TurnPicture, turn_pictures
from carina.plan.turns import OtherWay, Turn, TurnList
from carina.plan.verdict import Check, Outcome, Verdict, judge_scope, judge_scopes

__all__ = [
    "DEFAULT_TOOL",
    "Check",
    "Crossed",
    "LastLeg",
    "NeedleErrors",
    "NeedleScene",
    "Nodule",
    "NoduleKind",
    "OtherWay",
    "Outcome",
    "Plan",
    "PlanSheet",
    "PlannedRoute",
    "ScoreWeights",
    "Surroundings",
    "Tool",
    "Turn",
    "TurnList",
    "TurnPicture",
    "Verdict",
    "grow_nodule",
    "hit_share",
    "judge_scope",
    "judge_scopes",
    "last_leg",
    "main_carina_ridge_mm",
    "make_sheet",
    "plan_route",
    "surroundings",
    "tool",
    "tools",
    "turn_list",
    "turn_pictures",
    "write_report",
]
