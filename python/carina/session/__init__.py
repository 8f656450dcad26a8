"""Sessions: the state of an open case, its commands with undo, its background jobs and the pose of the tip."""

from carina.case.routes import ChosenRoute
from carina.session.api import Case
from carina.session.cases.case_list import ListedCase, StorageInfo
from carina.session.core import Event
from carina.session.derived.lungs import LungsInfo
from carina.session.derived.plans import PlannedTarget, PlanningInfo, chosen_number, shown_surface
from carina.session.engines import Parts, RendererFactory, default_parts
from carina.session.flights.key_frames import key_file
from carina.session.flights.tip_commands import view_words
from carina.session.jobs.background_jobs import JobEnded, JobProgress, log_fault
from carina.session.jobs.job_groups import JobGroup
from carina.session.scene.branch_names import finish_case_picture
from carina.session.scene.layer_lines import LAYERS, LayerLines, LayerName
from carina.session.scene.shown_case import SessionRenderer, ShownCase
from carina.session.session import Session
from carina.session.state.snapshot import (
    Changed,
    ChestMoved,
    ErrorEvent,
    EvidenceMissing,
    FlightInfo,
    FlightPlace,
    KeyFramesInfo,
    MaskQuestion,
    OpeningInfo,
    PoseInfo,
    Snapshot,
    StartMarked,
    UserMessage,
    WallPoint,
)
from carina.session.state.training import (
    ClassLearner,
    CourseInfo,
    FlightScore,
    QuizInfo,
    ReferenceScores,
    RunningTask,
    TaskInfo,
    TrainingInfo,
)
from carina.session.store.attach_endpoint import AttachEndpoint
from carina.session.store.disk_storage import case_files
from carina.session.store.find_scan import CASE_SUFFIX, CaseScans, FoundScan, is_case_file
from carina.session.store.local_settings import LocalStore, RecentCase
from carina.session.store.registry import FORGOTTEN_FOR_S, CaseRecord, CaseRecords

__all__ = [
    "CASE_SUFFIX",
    "FORGOTTEN_FOR_S",
    "LAYERS",
    "AttachEndpoint",
    "Case",
    "CaseRecord",
    "CaseRecords",
    "CaseScans",
    "Changed",
    "ChestMoved",
    "ChosenRoute",
    "ClassLearner",
    "CourseInfo",
    "ErrorEvent",
    "Event",
    "EvidenceMissing",
    "FlightInfo",
    "FlightPlace",
    "FlightScore",
    "FoundScan",
    "JobEnded",
    "JobGroup",
    "JobProgress",
    "KeyFramesInfo",
    "LayerLines",
    "LayerName",
    "ListedCase",
    "LocalStore",
    "LungsInfo",
    "MaskQuestion",
    "OpeningInfo",
    "Parts",
    "PlannedTarget",
    "PlanningInfo",
    "PoseInfo",
    "QuizInfo",
    "RecentCase",
    "ReferenceScores",
    "RendererFactory",
    "RunningTask",
    "Session",
    "SessionRenderer",
    "ShownCase",
    "Snapshot",
    "StartMarked",
    "StorageInfo",
    "TaskInfo",
    "TrainingInfo",
    "UserMessage",
    "WallPoint",
    "case_files",
    "chosen_number",
    "default_parts",
    "finish_case_picture",
    "is_case_file",
    "key_file",
    "log_fault",
    "shown_surface",
    "view_words",
]
