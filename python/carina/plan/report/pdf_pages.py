"""Export of a report as PDF; requires the optional package reportlab."""

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
    """Return sections as the bytes of a PDF; equal sheets give equal bytes.

    Parameters
    ----------
    sheet
        Contents of the report, for the head and foot of each page.
    parts
        The sections.
    paper
        Paper size.

    Raises
    ------
    CarinaError
        If reportlab is not installed (``plan.no-pdf``).
    UsageError
        If no available font has all characters of the report (``plan.report-characters``).
    """
    if importlib.util.find_spec("reportlab") is None:
        raise CarinaError(
            "a PDF needs the package reportlab, which is not installed; the .html report needs no package and can be "
            f"printed to PDF from a browser. Install reportlab with: {extra_command('report')}",
            code="plan.no-pdf",
        )
    # Imported on use, because reportlab is optional and most plans need no PDF.
    from carina.plan.report.pdf_layout import laid_out

    return laid_out(sheet, parts, paper=paper)
