"""Writing of a report to a file; the suffix determines the format."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from carina.disk import write_whole
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, CarinaError, UsageError, check_type
from carina.installation import extra_command
from carina.plan.report.blocks import Section
from carina.plan.report.html_page import html_page
from carina.plan.report.plan_sheet import PlanSheet
from carina.plan.report.sections import sections, tracing_sections

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


ReportKind = Literal["report", "tracing"]


@shows_progress
def write_report(
    path: Path | str,
    sheet: PlanSheet,
    *,
    kind: ReportKind = "report",
    paper: Paper = "A4",
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> Path:
    """Write the report of a plan.

    Parameters
    ----------
    path
        ``.html`` (one page that needs no network), ``.pdf`` or ``.json``.
    sheet
        Contents of the report (`make_sheet`).
    kind
        ``report`` for the whole report, ``tracing`` for the tracing sheet alone. JSON is always the whole report.
    paper
        Paper size of a PDF: ``A4`` or ``Letter``. The HTML page prints on both.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    UsageError
        If the suffix, kind or paper is unknown (``plan.report-format``), the plan has no route to trace
        (``plan.no-route``), or the font of a PDF lacks a character (``plan.report-characters``).
    CarinaError
        If ``path`` is a PDF and reportlab is not installed (``plan.no-pdf``).
    DiskError
        If the file cannot be written.
    CancelledError
        If ``cancel()`` returned True; nothing is written.

    Examples
    --------
    >>> import carina, tempfile
    >>> from carina.plan import make_sheet, write_report
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> found = carina.find_airways(made.volume)
    >>> plan = carina.plan_route(made.volume, found, made.truth["nodule"]["centre_lps"])
    >>> sheet = make_sheet(made.volume, found, plan)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_report(f"{folder}/plan.html", sheet).suffix
    '.html'
    """
    check_type("write_report", "sheet", sheet, PlanSheet, "make one with carina.plan.make_sheet")
    suffix = Path(path).suffix.lower()
    if suffix not in {".html", ".htm", ".pdf", ".json"}:
        found = suffix or "no suffix"
        raise UsageError(
            f"write_report: expected a file name that ends in .html, .pdf or .json; found {found}",
            code="plan.report-format",
        )
    for name, value, known in (("kind", kind, ("report", "tracing")), ("paper", paper, ("A4", "Letter"))):
        if value not in known:
            raise UsageError(
                f"write_report: {name}: expected {' or '.join(known)}; found {value!r}", code="plan.report-format"
            )
    if kind == "tracing" and sheet.route is None and suffix != ".json":
        raise UsageError("write_report: the plan has no route to trace", code="plan.no-route")

    report = progress_function(progress)

    def report_fraction(fraction: float) -> None:
        if cancel is not None and cancel():
            raise CancelledError("writing the report was cancelled")
        if report is not None:
            report("laying out the pages", fraction)

    report_fraction(0.0)
    if suffix == ".json":
        content = (json.dumps(sheet.to_json(), indent=1) + "\n").encode()
    else:
        parts = tracing_sections(sheet) if kind == "tracing" else sections(sheet)
        report_fraction(0.3)
        content = html_page(sheet, parts).encode() if suffix != ".pdf" else pdf_pages(sheet, parts, paper=paper)
    report_fraction(0.9)
    written = write_whole(path, content, what="the report")
    report_fraction(1.0)
    return written
