"""The one owner of a case: state, commands with undo, jobs, the pose."""

from carina.case.routes import ChosenRoute
from carina.session.case_files import case_files
from carina.session.case_list import ListedCase, StorageInfo
from carina.session.core import Event
from carina.session.jobs import JobEnded, JobProgress, log_fault
from carina.session.parts import Parts, RendererFactory, default_parts
from carina.session.public import Case
from carina.session.recent import LocalStore, RecentCase
from carina.session.records import FORGOTTEN_FOR_S, CaseRecords
from carina.session.scene import Renderer, ShownCase
from carina.session.session import Session
from carina.session.snapshot import (
    Changed,
    KeysInfo,
    MaskQuestion,
    NotEvident,
    PoseInfo,
    Said,
    Snapshot,
    Trouble,
    WallPoint,
)

__all__ = [
    "FORGOTTEN_FOR_S",
    "Case",
    "CaseRecords",
    "Changed",
    "ChosenRoute",
    "Event",
    "JobEnded",
    "JobProgress",
    "KeysInfo",
    "ListedCase",
    "LocalStore",
    "MaskQuestion",
    "NotEvident",
    "Parts",
    "PoseInfo",
    "RecentCase",
    "Renderer",
    "RendererFactory",
    "Said",
    "Session",
    "ShownCase",
    "Snapshot",
    "StorageInfo",
    "Trouble",
    "WallPoint",
    "case_files",
    "default_parts",
    "log_fault",
]
