"""Planning: from a nodule in the lung to a way there."""

from carina.plan.ebus import EBUS_LIMITS, Landmark, clock_hours, ebus_landmarks
from carina.plan.fissures import FissureBox
from carina.plan.last_leg import Crossed, LastLeg, NeedleScene, last_leg
from carina.plan.lobes import Lobes, lobes
from carina.plan.needle import NeedleErrors, hit_share
from carina.plan.nodule import Nodule, NoduleKind, grow_nodule
from carina.plan.routes import Plan, PlannedRoute, ScoreWeights, plan_route
from carina.plan.surroundings import Surroundings, lung_surroundings, surroundings
from carina.plan.tools import DEFAULT_TOOL, Tool, tool, tools
from carina.plan.verdict import Check, Outcome, Verdict, judge_scope, judge_scopes
from carina.plan.vessels import VesselBranch, VesselTree

__all__ = [
    "DEFAULT_TOOL",
    "EBUS_LIMITS",
    "Check",
    "Crossed",
    "FissureBox",
    "Landmark",
    "LastLeg",
    "Lobes",
    "NeedleErrors",
    "NeedleScene",
    "Nodule",
    "NoduleKind",
    "Outcome",
    "Plan",
    "PlannedRoute",
    "ScoreWeights",
    "Surroundings",
    "Tool",
    "Verdict",
    "VesselBranch",
    "VesselTree",
    "clock_hours",
    "ebus_landmarks",
    "grow_nodule",
    "hit_share",
    "judge_scope",
    "judge_scopes",
    "last_leg",
    "lobes",
    "lung_surroundings",
    "plan_route",
    "surroundings",
    "tool",
    "tools",
]
