"""Planning: from a nodule in the lung to a way there."""

from carina.plan.drive import DrivenRoute, moves_between, replay_moves
from carina.plan.drive_search import condense_drive, place_at_start, search_drive
from carina.plan.drive_way import DriveWay
from carina.plan.last_leg import Crossed, LastLeg, NeedleScene, last_leg
from carina.plan.moves import Move
from carina.plan.needle import NeedleErrors, hit_share
from carina.plan.nodule import Nodule, NoduleKind, grow_nodule
from carina.plan.routes import Plan, PlannedRoute, ScoreWeights, plan_route
from carina.plan.scope_file import scope_from_file, scope_to_json
from carina.plan.surroundings import Surroundings, surroundings
from carina.plan.tools import DEFAULT_TOOL, Tool, tool, tool_from_file, tools
from carina.plan.verdict import Check, Outcome, Verdict, judge_scope, judge_scopes

__all__ = [
    "DEFAULT_TOOL",
    "Check",
    "Crossed",
    "DriveWay",
    "DrivenRoute",
    "LastLeg",
    "Move",
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
    "condense_drive",
    "grow_nodule",
    "hit_share",
    "judge_scope",
    "judge_scopes",
    "last_leg",
    "moves_between",
    "place_at_start",
    "plan_route",
    "replay_moves",
    "scope_from_file",
    "scope_to_json",
    "search_drive",
    "surroundings",
    "tool",
    "tool_from_file",
    "tools",
]
