"""Report of a plan as one self-contained HTML page, as PDF or as JSON, and a tracing sheet for the procedure."""

from carina.plan.report.pdf_pages import Paper
from carina.plan.report.sheet import PlanSheet, make_sheet
from carina.plan.report.whole import PlanMaterials, whole_sheet
from carina.plan.report.write import ReportKind, write_report

__all__ = ["Paper", "PlanMaterials", "PlanSheet", "ReportKind", "make_sheet", "whole_sheet", "write_report"]
