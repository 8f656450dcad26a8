"""Planning: from a nodule in the lung to a way there."""

from carina.plan.last_leg import Crossed, LastLeg, NearVessel, NeedleScene, last_leg
from carina.plan.needle import NeedleErrors, hit_share
from carina.plan.nodule import Nodule, NoduleKind, grow_nodule
from carina.plan.places import BronchusSign, NearestPlace
from carina.plan.routes import Plan, PlannedRoute, plan_route
from carina.plan.score import Outlook, ScoreWeights
from carina.plan.surroundings import Surroundings, surroundings
from carina.plan.tools import DEFAULT_TOOL, Tool, tool, tools
from carina.plan.verdict import Check, Outcome, Verdict, judge_scope, judge_scopes

__all__ = [
    "DEFAULT_TOOL",
    "BronchusSign",
    "Check",
    "Crossed",
    "LastLeg",
    "NearVessel",
    "NearestPlace",
    "NeedleErrors",
    "NeedleScene",
    "Nodule",
    "NoduleKind",
    "Outcome",
    "Outlook",
    "Plan",
    "PlannedRoute",
    "ScoreWeights",
    "Surroundings",
    "Tool",
    "Verdict",
    "grow_nodule",
    "hit_share",
    "judge_scope",
    "judge_scopes",
    "last_leg",
    "plan_route",
    "surroundings",
    "tool",
    "tools",
]
