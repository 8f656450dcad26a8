"""Report of a plan as one self-contained HTML page, as PDF or as JSON, and a tracing sheet for the procedure."""

from carina.plan.report.from_plan import PlanMaterials, route_turns, whole_sheet
from carina.plan.report.plan_sheet import PlanSheet, make_sheet
from carina.plan.report.wording import AGAINST
from carina.plan.report.write import Paper, ReportKind, write_report

__all__ = [
    "AGAINST",
    "Paper",
    "PlanMaterials",
    "PlanSheet",
    "ReportKind",
    "make_sheet",
    "route_turns",
    "whole_sheet",
    "write_report",
]
