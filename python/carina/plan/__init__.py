"""Planning: from a nodule in the lung to a way there."""

from carina.plan.last_leg import Crossed, LastLeg, NeedleScene, last_leg
from carina.plan.needle import NeedleErrors, hit_share
from carina.plan.nodule import Nodule, NoduleKind, grow_nodule
from carina.plan.routes import Plan, PlannedRoute, ScoreWeights, plan_route
from carina.plan.surroundings import Surroundings, surroundings
from carina.plan.target import PlanTarget, TargetSource, proposed_aims
from carina.plan.target_click import target_from_click
from carina.plan.target_edits import brushed, resized, sphere
from carina.plan.target_files import target_from_file
from carina.plan.target_mask import nodule_from_mask, target_from_mask
from carina.plan.tools import DEFAULT_TOOL, Tool, tool, tools
from carina.plan.verdict import Check, Outcome, Verdict, judge_scope, judge_scopes
from carina.plan.whereabouts import Whereabouts, whereabouts

__all__ = [
    "DEFAULT_TOOL",
    "Check",
    "Crossed",
    "LastLeg",
    "NeedleErrors",
    "NeedleScene",
    "Nodule",
    "NoduleKind",
    "Outcome",
    "Plan",
    "PlanTarget",
    "PlannedRoute",
    "ScoreWeights",
    "Surroundings",
    "TargetSource",
    "Tool",
    "Verdict",
    "Whereabouts",
    "brushed",
    "grow_nodule",
    "hit_share",
    "judge_scope",
    "judge_scopes",
    "last_leg",
    "nodule_from_mask",
    "plan_route",
    "proposed_aims",
    "resized",
    "sphere",
    "surroundings",
    "target_from_click",
    "target_from_file",
    "target_from_mask",
    "tool",
    "tools",
    "whereabouts",
]
