"""Planning of biopsies: target, route through the airways, reach of an instrument, list of turns and report."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from carina.plan.carm import CARM_LIMITS, CArmAngle, CArmAngles, carm_angles, shadow_parts
from carina.plan.ebus import EBUS_LIMITS, Landmark, clock_hours, ebus_landmarks
from carina.plan.hand_moves import Move
from carina.plan.instruments.scope_file import scope_from_file, scope_to_json
from carina.plan.instruments.tools import DEFAULT_TOOL, Tool, tool, tool_from_file, tools
from carina.plan.lungs.fissures import FissureBox
from carina.plan.lungs.lobes import Lobes, lobes
from carina.plan.lungs.tissue_near_needle import NearbyTissue, lung_surroundings, surroundings
from carina.plan.lungs.vessels import VesselBranch, VesselTree
from carina.plan.movement.forks import ForkShift
from carina.plan.movement.measure import MovementMeasurement, measure_movement
from carina.plan.movement.target_movement import MovementOrigin, TargetMovement, default_movement
from carina.plan.reach_atlas import ReachAtlas, reach_atlas
from carina.plan.report import PlanSheet, make_sheet, write_report
from carina.plan.route_planner import plan_route
from carina.plan.route_stations import STATION_NOTE, RouteStation, route_stations
from carina.plan.routes.last_leg import CrossedTissue, LastLeg, NearVessel, NeedleScene, last_leg
from carina.plan.routes.main_carina import DistanceOrigin, distance_origin
from carina.plan.routes.needle_hits import NeedleErrors, hit_share
from carina.plan.routes.plan_route import Plan, PlannedRoute
from carina.plan.routes.predictors import PREDICTOR_SOURCE, PREDICTOR_WORDS, RoutePredictors, route_predictors
from carina.plan.routes.ranking import Outlook, ScoreWeights
from carina.plan.routes.standing_points import BronchusSign, NearestPlace
from carina.plan.target_comparison import ORDER_RULE, ComparedTarget, compare_targets
from carina.plan.targets.doubts import TargetDoubt, check_confirmed, target_doubts
from carina.plan.targets.edits import brushed, resized, sphere
from carina.plan.targets.from_click import target_from_click
from carina.plan.targets.grow_nodule import Nodule, NoduleKind, grow_nodule
from carina.plan.targets.region import WHERE_WORDS, Whereabouts, whereabouts
from carina.plan.targets.target import PlanTarget, TargetSource, proposed_aims
from carina.plan.turns.clips import TurnClip, turn_clips
from carina.plan.turns.flight import turn_flight
from carina.plan.turns.from_route import turn_list
from carina.plan.turns.pictures import TurnPicture, turn_pictures
from carina.plan.turns.turn_list import OtherWay, Turn, TurnList
from carina.plan.verdict.checks import Check
from carina.plan.verdict.drive import DrivenRoute, moves_between, replay_moves
from carina.plan.verdict.drive_flight import drive_flight
from carina.plan.verdict.drive_search import condense_drive, place_at_start, search_drive
from carina.plan.verdict.judge_scopes import judge_pairs, judge_scope, judge_scopes, pairs_in_order
from carina.plan.verdict.verdict import Outcome, Verdict, needle_to_target_mm

if TYPE_CHECKING:
    from carina.plan.targets.from_file import target_from_file
    from carina.plan.targets.from_mask import nodule_from_mask, target_from_mask

__all__ = [
    "CARM_LIMITS",
    "DEFAULT_TOOL",
    "EBUS_LIMITS",
    "ORDER_RULE",
    "PREDICTOR_SOURCE",
    "PREDICTOR_WORDS",
    "STATION_NOTE",
    "WHERE_WORDS",
    "BronchusSign",
    "CArmAngle",
    "CArmAngles",
    "Check",
    "ComparedTarget",
    "CrossedTissue",
    "DistanceOrigin",
    "DrivenRoute",
    "FissureBox",
    "ForkShift",
    "Landmark",
    "LastLeg",
    "Lobes",
    "Move",
    "MovementMeasurement",
    "MovementOrigin",
    "NearVessel",
    "NearbyTissue",
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
    "RoutePredictors",
    "RouteStation",
    "ScoreWeights",
    "TargetDoubt",
    "TargetMovement",
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
    "carm_angles",
    "check_confirmed",
    "clock_hours",
    "compare_targets",
    "condense_drive",
    "default_movement",
    "distance_origin",
    "drive_flight",
    "ebus_landmarks",
    "grow_nodule",
    "hit_share",
    "judge_pairs",
    "judge_scope",
    "judge_scopes",
    "last_leg",
    "lobes",
    "lung_surroundings",
    "make_sheet",
    "measure_movement",
    "moves_between",
    "needle_to_target_mm",
    "nodule_from_mask",
    "pairs_in_order",
    "place_at_start",
    "plan_route",
    "proposed_aims",
    "reach_atlas",
    "replay_moves",
    "resized",
    "route_predictors",
    "route_stations",
    "scope_from_file",
    "scope_to_json",
    "search_drive",
    "shadow_parts",
    "sphere",
    "surroundings",
    "target_doubts",
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
    "nodule_from_mask": "targets.from_mask",
    "target_from_file": "targets.from_file",
    "target_from_mask": "targets.from_mask",
}


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'carina.plan' has no attribute {name!r}")
    return getattr(importlib.import_module(f"carina.plan.{home}"), name)
