"""Sessions: the state of an open case, its commands with undo, its background jobs and the pose of the tip."""

from carina.case.routes import ChosenRoute
from carina.session.case_files import case_files
from carina.session.case_list import ListedCase, StorageInfo
from carina.session.case_scan import CASE_SUFFIX, CaseScans, FoundScan, is_case_file
from carina.session.core import Event
from carina.session.doors import Door
from carina.session.errands import Errand
from carina.session.flying import view_words
from carina.session.jobs import JobEnded, JobProgress, log_fault
from carina.session.key_framing import key_file
from carina.session.layers import LAYERS, LayerLines, LayerName
from carina.session.lung_values import LungsInfo
from carina.session.parts import Parts, RendererFactory, default_parts
from carina.session.plan_values import PlannedTarget, PlanningInfo, chosen_number, shown_surface
from carina.session.public import Case
from carina.session.recent import LocalStore, RecentCase
from carina.session.records import FORGOTTEN_FOR_S, CaseRecord, CaseRecords
from carina.session.scene import SessionRenderer, ShownCase
from carina.session.session import Session
from carina.session.snapshot import (
    Changed,
    FlightInfo,
    FlightPlace,
    KeyFramesInfo,
    MaskQuestion,
    NotEvident,
    PoseInfo,
    Said,
    Snapshot,
    StartMarked,
    Trouble,
    WallPoint,
)

__all__ = [
    "CASE_SUFFIX",
    "FORGOTTEN_FOR_S",
    "LAYERS",
    "Case",
    "CaseRecord",
    "CaseRecords",
    "CaseScans",
    "Changed",
    "ChosenRoute",
    "Door",
    "Errand",
    "Event",
    "FlightInfo",
    "FlightPlace",
    "FoundScan",
    "JobEnded",
    "JobProgress",
    "KeyFramesInfo",
    "LayerLines",
    "LayerName",
    "ListedCase",
    "LocalStore",
    "LungsInfo",
    "MaskQuestion",
    "NotEvident",
    "Parts",
    "PlannedTarget",
    "PlanningInfo",
    "PoseInfo",
    "RecentCase",
    "RendererFactory",
    "Said",
    "Session",
    "SessionRenderer",
    "ShownCase",
    "Snapshot",
    "StartMarked",
    "StorageInfo",
    "Trouble",
    "WallPoint",
    "case_files",
    "chosen_number",
    "default_parts",
    "is_case_file",
    "key_file",
    "log_fault",
    "shown_surface",
    "view_words",
]
