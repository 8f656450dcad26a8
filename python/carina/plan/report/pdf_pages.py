"""The report as PDF, where the library for it is installed."""

from __future__ import annotations

import importlib.util
from typing import Literal

from carina.errors import CarinaError
from carina.installation import extra_command
from carina.plan.report.blocks import Section
from carina.plan.report.sheet import PlanSheet

__all__ = ["Paper", "pdf_pages"]

Paper = Literal["A4", "Letter"]


def pdf_pages(sheet: PlanSheet, parts: tuple[Section, ...], *, paper: Paper) -> bytes:
    """These sections as a PDF; the same sheet gives the same bytes.

    Raises
    ------
    CarinaError
        If reportlab is not installed (``plan.no-pdf``).
    UsageError
        If none of its fonts has all characters of the report (``plan.report-characters``).
    """
    if importlib.util.find_spec("reportlab") is None:
        raise CarinaError(
            "a PDF needs the package reportlab, which is not installed; the .html report needs no package and can be "
            f"printed to PDF from a browser. Install reportlab with: {extra_command('report')}",
            code="plan.no-pdf",
        )
    # Loaded here: most who plan write no PDF, and it is an extra.
    from carina.plan.report.pdf_layout import laid_out

    return laid_out(sheet, parts, paper=paper)
