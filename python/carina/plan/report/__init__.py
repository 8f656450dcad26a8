"""The report of a plan: a page that opens anywhere, the same as PDF and JSON, and a sheet for the theatre."""

from carina.plan.report.pdf_pages import Paper
from carina.plan.report.sheet import PlanSheet, make_sheet
from carina.plan.report.whole import PlanMaterials, whole_sheet
from carina.plan.report.write import ReportKind, write_report

__all__ = ["Paper", "PlanMaterials", "PlanSheet", "ReportKind", "make_sheet", "whole_sheet", "write_report"]
