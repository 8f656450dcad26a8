"""Planning of biopsies: target, route through the airways, reach of an instrument, list of turns and report."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from carina.plan.atlas import ReachAtlas, reach_atlas
from carina.plan.drive import DrivenRoute, moves_between, replay_moves
from carina.plan.drive_flight import drive_flight
from carina.plan.drive_search import condense_drive, place_at_start, search_drive
from carina.plan.ebus import EBUS_LIMITS, Landmark, clock_hours, ebus_landmarks
from carina.plan.fissures import FissureBox
from carina.plan.last_leg import Crossed, LastLeg, NearVessel, NeedleScene, last_leg
from carina.plan.lobes import Lobes, lobes
from carina.plan.moves import Move
from carina.plan.needle import NeedleErrors, hit_share
from carina.plan.nodule import Nodule, NoduleKind, grow_nodule
from carina.plan.places import BronchusSign, NearestPlace
from carina.plan.report import PlanSheet, make_sheet, write_report
from carina.plan.route_turns import main_carina_ridge_mm, turn_list
from carina.plan.routes import Plan, PlannedRoute, plan_route
from carina.plan.scope_file import scope_from_file, scope_to_json
from carina.plan.score import Outlook, ScoreWeights
from carina.plan.surroundings import Surroundings, lung_surroundings, surroundings
from carina.plan.target import PlanTarget, TargetSource, proposed_aims
from carina.plan.target_click import is_plain_nodule, target_from_click
from carina.plan.target_edits import brushed, resized, sphere
from carina.plan.tools import DEFAULT_TOOL, Tool, tool, tool_from_file, tools
from carina.plan.turn_clips import TurnClip, turn_clips
from carina.plan.turn_flight import turn_flight
from carina.plan.turn_pictures import TurnPicture, turn_pictures
from carina.plan.turns import OtherWay, Turn, TurnList
from carina.plan.verdict import Check, Outcome, Verdict, judge_scope, judge_scopes
from carina.plan.vessels import VesselBranch, VesselTree
from carina.plan.whereabouts import WHERE_WORDS, Whereabouts, whereabouts

if TYPE_CHECKING:
    from carina.plan.target_files import target_from_file
    from carina.plan.target_mask import nodule_from_mask, target_from_mask

__all__ = [
    "DEFAULT_TOOL",
    "EBUS_LIMITS",
    "WHERE_WORDS",
    "BronchusSign",
    "Check",
    "Crossed",
    "DrivenRoute",
    "FissureBox",
    "Landmark",
    "LastLeg",
    "Lobes",
    "Move",
    "NearVessel",
    "NearestPlace",
    "NeedleErrors",
    "NeedleScene",
    "Nodule",
    "NoduleKind",
    "OtherWay",
    "Outcome",
    "Outlook",
    "Plan",
    "PlanSheet",
    "PlanTarget",
    "PlannedRoute",
    "ReachAtlas",
    "ScoreWeights",
    "Surroundings",
    "TargetSource",
    "Tool",
    "Turn",
    "TurnClip",
    "TurnList",
    "TurnPicture",
    "Verdict",
    "VesselBranch",
    "VesselTree",
    "Whereabouts",
    "brushed",
    "clock_hours",
    "condense_drive",
    "drive_flight",
    "ebus_landmarks",
    "grow_nodule",
    "hit_share",
    "is_plain_nodule",
    "judge_scope",
    "judge_scopes",
    "last_leg",
    "lobes",
    "lung_surroundings",
    "main_carina_ridge_mm",
    "make_sheet",
    "moves_between",
    "nodule_from_mask",
    "place_at_start",
    "plan_route",
    "proposed_aims",
    "reach_atlas",
    "replay_moves",
    "resized",
    "scope_from_file",
    "scope_to_json",
    "search_drive",
    "sphere",
    "surroundings",
    "target_from_click",
    "target_from_file",
    "target_from_mask",
    "tool",
    "tool_from_file",
    "tools",
    "turn_clips",
    "turn_flight",
    "turn_list",
    "turn_pictures",
    "whereabouts",
    "write_report",
]

# These names are imported on first use: their modules load file readers that a plan for a clicked target
# does not need.
_HOME = {
    "nodule_from_mask": "target_mask",
    "target_from_file": "target_files",
    "target_from_mask": "target_mask",
}


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'carina.plan' has no attribute {name!r}")
    return getattr(importlib.import_module(f"carina.plan.{home}"), name)
