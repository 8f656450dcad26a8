"""Report of a plan as one self-contained HTML page, as PDF or as JSON, and a tracing sheet for the procedure."""

from carina.plan.report.from_plan import PlanMaterials, whole_sheet
from carina.plan.report.plan_sheet import PlanSheet, make_sheet
from carina.plan.report.write import Paper, ReportKind, write_report

__all__ = ["Paper", "PlanMaterials", "PlanSheet", "ReportKind", "make_sheet", "whole_sheet", "write_report"]
