"""The report of a plan: a page that opens anywhere, the same as PDF and JSON, and a sheet for the theatre."""

from carina.plan.report.sheet import PlanSheet, make_sheet
from carina.plan.report.write import write_report

__all__ = ["PlanSheet", "make_sheet", "write_report"]
