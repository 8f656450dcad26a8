"""Layout of a report as PDF with reportlab: the same blocks as the HTML page, with drawings as vector graphics."""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import reportlab  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.lib.colors import HexColor  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.lib.enums import TA_RIGHT  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.lib.pagesizes import A4, LETTER  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.lib.styles import ParagraphStyle  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.lib.utils import ImageReader  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.pdfbase import pdfmetrics  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.pdfbase.ttfonts import TTFError, TTFont  # type: ignore[import-not-found, import-untyped, unused-ignore]
from reportlab.platypus import (  # type: ignore[import-not-found, import-untyped, unused-ignore]
    BaseDocTemplate,
    CondPageBreak,
    Flowable,
    Frame,
    KeepTogether,
    PageBreak,
    PageTemplate,
    Paragraph,
    Spacer,
    Table,
)

from carina.display.html import escaped
from carina.errors import UsageError
from carina.plan.report.blocks import Block, Bullets, Facts, Figure, Figures, ReportTable, Section, Words
from carina.plan.report.colours import INK, PALE, QUIET, WARNING
from carina.plan.report.drawing import Disc, Drawing, Label, LineStyle, Raster, Stroke
from carina.plan.report.plan_sheet import PlanSheet, target_words
from carina.plan.report.uncertainty import movement_words
from carina.plan.report.wording import NOT_A_DEVICE

TITLE = "Bronchoscopy plan"
SIDE, TOP, BOTTOM = 34.0, 50.0, 46.0
"""Side, top and bottom margins of a page in points; the last two contain the head and foot of each page."""
GAP = 8.0
MIN_SIZE = 8.0
"""Minimum font size on a page in points, also of text in drawings."""
HEADING, PARAGRAPH = 48.0, 44.0
"""Maximum heights in points of a heading and a paragraph on a page that a drawing fills."""
FONTS = (("Vera.ttf", "VeraBd.ttf"), ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf"))
"""Plain and bold font files: the first pair is part of reportlab, the second is searched in the system's fonts."""
TONES = {"plain": INK, "lead": INK, "quiet": QUIET, "warning": WARNING}


def laid_out(sheet: PlanSheet, parts: tuple[Section, ...], *, paper: str) -> bytes:
    """Return the report as the bytes of a PDF."""
    size = A4 if paper == "A4" else LETTER
    fonts = _fonts("".join(_texts(sheet, parts)))
    # The first pass counts the pages; the second pass prints the count on each page.
    _, num_pages = _built(sheet, parts, size, fonts, 0)
    content, _ = _built(sheet, parts, size, fonts, num_pages)
    return content


def _built(
    sheet: PlanSheet, parts: tuple[Section, ...], size: tuple[float, float], fonts: tuple[str, str], num_pages: int
) -> tuple[bytes, int]:
    out = io.BytesIO()
    page = BaseDocTemplate(
        out, pagesize=size, title=TITLE, author="Carina", subject=NOT_A_DEVICE, creator="Carina", invariant=1
    )
    frame_size = (size[0] - 2 * SIDE, size[1] - TOP - BOTTOM)
    frame = Frame(SIDE, BOTTOM, *frame_size, leftPadding=0, rightPadding=0, topPadding=0, bottomPadding=0)
    furniture = partial(_furniture, sheet=sheet, fonts=fonts, num_pages=num_pages)
    page.addPageTemplates([PageTemplate(frames=[frame], onPage=furniture)])
    page.build(_ReportFlow(fonts, frame_size).flowables(parts))
    return out.getvalue(), int(page.page)


def _furniture(canvas: Any, page: Any, *, sheet: PlanSheet, fonts: tuple[str, str], num_pages: int) -> None:
    """Draw the head and foot of a PDF page."""
    width, height = page.pagesize
    plain, bold = fonts
    who = "" if sheet.patient is None else f" \u00b7 {sheet.patient}"
    canvas.setStrokeColor(HexColor(INK))
    canvas.setFillColor(HexColor(INK))
    canvas.setLineWidth(0.6)
    head, max_width = f"{TITLE}{who} \u00b7 {target_words(sheet)}", width - 2 * SIDE - 125.0
    # A long name gets a smaller font, so that it is never cut.
    canvas.setFont(bold, min(9.0, 9.0 * max_width / pdfmetrics.stringWidth(head, bold, 9.0)))
    canvas.drawString(SIDE, height - 33, head)
    canvas.setFont(plain, 8)
    canvas.setFillColor(HexColor(QUIET))
    canvas.drawRightString(width - SIDE, height - 33, f"Carina {sheet.provenance.version}, {sheet.provenance.made_on}")
    canvas.line(SIDE, height - 39, width - SIDE, height - 39)
    canvas.line(SIDE, 37, width - SIDE, 37)
    canvas.setFillColor(HexColor(INK))
    canvas.setFont(bold, 8)
    canvas.drawString(SIDE, 26, NOT_A_DEVICE)
    canvas.setFont(plain, 8)
    canvas.drawString(SIDE, 14, movement_words(sheet.plan))
    canvas.setFillColor(HexColor(QUIET))
    canvas.drawRightString(width - SIDE, 14, f"{page.page} / {num_pages}")


class _ReportFlow:
    """Conversion of blocks to reportlab flowables for a frame of (width, height) points."""

    def __init__(self, fonts: tuple[str, str], frame_size: tuple[float, float]) -> None:
        self._plain, self._bold = fonts
        self._width, self._height = frame_size

    def flowables(self, parts: tuple[Section, ...]) -> list[Any]:
        """Return the flowables of all sections."""
        # A tracing sheet, of one page or several, fills its pages and has no title above it.
        is_report = not parts[0].name.startswith("tracing")
        found: list[Any] = [self._paragraph(TITLE, 20.0, is_bold=True), Spacer(1, 10)] if is_report else []
        for n, part in enumerate(parts):
            if n and part.starts_page:
                found.append(PageBreak())
            # Space before a heading is left out at the top of a page; a spacer could begin an empty page.
            above = 14 + GAP if n and not part.starts_page else 0.0
            heading = self._paragraph(part.title, 13.0, is_bold=True, above=above)
            line = Table(
                [[""]],
                colWidths=[self._width],
                rowHeights=[3.0],
                style=[("LINEABOVE", (0, 0), (-1, 0), 0.8, HexColor(INK))],
            )
            content: list[Any] = [heading, Spacer(1, 3), line]
            used = HEADING
            for k, block in enumerate(part.blocks):
                made = self._block(block, used)
                # A gap at the end of a section could begin an empty page.
                content += [*([Spacer(1, GAP)] if k else []), *(made if isinstance(made, list) else [made])]
                used += PARAGRAPH * isinstance(block, Words)
            if part.is_whole:
                found.append(KeepTogether(content))
            else:
                # Avoids a heading alone at the end of a page.
                found += [CondPageBreak(110.0), *content]
        return found

    def _block(self, block: Block, used: float) -> Any:
        match block:
            case Words(text=text, tone="warning"):
                inner = self._paragraph(text, 8.5, tone="warning", is_bold=True)
                box = ("BOX", (0, 0), (-1, -1), 1.0, HexColor(WARNING))
                return Table([[inner]], colWidths=[self._width], style=[box, *_padding(5)])
            case Words(text=text, tone="lead"):
                return self._paragraph(text, 10.0, is_bold=True)
            case Words(text=text, tone=tone):
                return self._paragraph(text, 8.0 if tone == "quiet" else 9.0, tone=tone)
            case Bullets(items=items, tone=tone, warned=warned):
                return [
                    self._paragraph(item, 9.0, tone="warning" if n in warned else tone, is_item=True)
                    for n, item in enumerate(items)
                ]
            case Facts(rows=rows):
                return self._facts(rows)
            case ReportTable():
                return self._grid(block)
            case Figure():
                return self._figure(block, self._width, self._height - used)
            case Figures(items=items, columns=columns):
                return self._figures(items, columns)

    def _paragraph(
        self,
        text: str,
        size: float,
        *,
        tone: str = "plain",
        is_bold: bool = False,
        is_right: bool = False,
        is_item: bool = False,
        above: float = 0.0,
    ) -> Any:
        style = ParagraphStyle(
            "words",
            fontName=self._bold if is_bold else self._plain,
            fontSize=size,
            leading=1.28 * size,
            textColor=HexColor(TONES[tone]),
            alignment=TA_RIGHT if is_right else 0,
            splitLongWords=1,
            leftIndent=11.0 if is_item else 0.0,
            bulletFontName=self._plain,
            bulletFontSize=size,
            bulletColor=HexColor(TONES[tone]),
            spaceBefore=above,
            spaceAfter=3.0 if is_item else 0.0,
        )
        return Paragraph(escaped(text), style, bulletText="\u2022" if is_item else None)

    def _facts(self, rows: tuple[tuple[str, str], ...]) -> Any:
        """Return a table of names and values in two columns, as a reportlab flowable."""
        half = (len(rows) + 1) // 2
        cells = []
        for n in range(half):
            row: list[Any] = []
            for name, value in rows[n : n + half + 1 : half] if n + half < len(rows) else rows[n : n + 1]:
                row += [
                    self._paragraph(name, 8.5, tone="quiet"),
                    self._paragraph(value, 8.5, is_bold=True, is_right=True),
                    "",
                ]
            cells.append((row + [""] * 6)[:5])
        gap = 16.0
        name_width = 0.19 * self._width
        value_width = 0.5 * (self._width - gap) - name_width
        lines = [("LINEBELOW", (a, 0), (a + 1, -1), 0.5, HexColor(PALE)) for a in (0, 3)]
        widths = [name_width, value_width, gap, name_width, value_width]
        return Table(cells, colWidths=widths, style=[*_padding(0, 2.5), _TOP, *lines])

    def _grid(self, grid: ReportTable) -> Any:
        rows = [[self._paragraph(name, MIN_SIZE, is_bold=True) for name in grid.head]]
        for n, row in enumerate(grid.rows):
            tone = "warning" if n in grid.warned else "plain"
            rows.append(
                [
                    self._paragraph(cell, MIN_SIZE, tone=tone, is_bold=k == 0 or n in grid.warned)
                    for k, cell in enumerate(row)
                ]
            )
        total = sum(grid.shares)
        style = [
            *_padding(0, 2.0),
            ("RIGHTPADDING", (0, 0), (-1, -1), 5),
            _TOP,
            ("LINEBELOW", (0, 0), (-1, 0), 0.9, HexColor(INK)),
            ("LINEBELOW", (0, 1), (-1, -1), 0.4, HexColor(PALE)),
        ]
        return Table(rows, colWidths=[self._width * share / total for share in grid.shares], repeatRows=1, style=style)

    def _figure(self, figure: Figure, width: float, height: float) -> Any:
        drawn: list[Any] = [_Drawn(figure.drawing, width, height, (self._plain, self._bold))]
        if figure.caption:
            drawn.append(self._paragraph(figure.caption, 8.0, tone="quiet"))
        return Table([[one] for one in drawn], colWidths=[width], style=[*_padding(0, 1.5), _TOP])

    def _figures(self, items: tuple[Figure, ...], columns: int) -> Any:
        gap = 7.0
        # A single drawing is limited in width, so that it does not fill the page.
        width = 0.62 * self._width if columns == 1 else (self._width - gap * (columns - 1)) / columns
        rows: list[list[Any]] = []
        for n in range(0, len(items), columns):
            row: list[Any] = []
            for item in items[n : n + columns]:
                row += [self._figure(item, width, self._height - 60.0), ""]
            rows.append((row + [""] * (2 * columns))[: 2 * columns - 1])
        widths = ([width, gap] * columns)[:-1]
        return Table(rows, colWidths=widths, hAlign="LEFT", style=[*_padding(0, 1.5), _TOP])


_TOP = ("VALIGN", (0, 0), (-1, -1), "TOP")


def _padding(aside: float, above: float | None = None) -> list[tuple[Any, ...]]:
    high = aside if above is None else above
    names = (("LEFTPADDING", aside), ("RIGHTPADDING", aside), ("TOPPADDING", high), ("BOTTOMPADDING", high))
    return [(name, (0, 0), (-1, -1), value) for name, value in names]


class _Drawn(Flowable):  # type: ignore[misc, unused-ignore]
    """Drawing as a flowable, as large as its frame allows."""

    def __init__(self, drawing: Drawing, width: float, height: float, fonts: tuple[str, str]) -> None:
        super().__init__()
        self._drawing, self._fonts = drawing, fonts
        self._scale = min(width / drawing.width, height / drawing.height)
        self.width, self.height = drawing.width * self._scale, drawing.height * self._scale

    def wrap(self, _width: float, _height: float) -> tuple[float, float]:
        """Return the size of the drawing, independent of the offered size."""
        return self.width, self.height

    def draw(self) -> None:
        """Draw the shapes on the page, clipped to the edges of the drawing."""
        canvas = self.canv
        canvas.saveState()
        edge = canvas.beginPath()
        edge.rect(0, 0, self.width, self.height)
        canvas.clipPath(edge, stroke=0, fill=0)
        canvas.scale(self._scale, self._scale)
        canvas.setLineCap(1)
        canvas.setLineJoin(1)
        for shape in self._drawing.shapes:
            self._shape(canvas, shape)
        canvas.restoreState()

    def _shape(self, canvas: Any, shape: Any) -> None:
        top = self._drawing.height
        match shape:
            case Stroke(places=places, pen=pen, closed=closed):
                if not places:
                    return
                path = canvas.beginPath()
                path.moveTo(places[0][0], top - places[0][1])
                for x, y in places[1:]:
                    path.lineTo(x, top - y)
                if closed:
                    path.close()
                _take(canvas, pen)
                canvas.drawPath(path, stroke=int(pen.line is not None), fill=int(pen.fill is not None))
            case Disc(middle=(x, y), radius=radius, pen=pen):
                _take(canvas, pen)
                canvas.circle(x, top - y, radius, stroke=int(pen.line is not None), fill=int(pen.fill is not None))
            case Label():
                self._label(canvas, shape)
            case Raster(corner=(x, y), size=(width, height), png=png):
                canvas.drawImage(ImageReader(io.BytesIO(png)), x, top - y - height, width, height)

    def _label(self, canvas: Any, label: Label) -> None:
        font = self._fonts[label.bold]
        # The PDF font is wider than the font of the HTML page.
        size = max(0.9 * label.size, MIN_SIZE / self._scale)
        x, y = label.at
        width = pdfmetrics.stringWidth(label.text, font, size)
        x -= {"start": 0.0, "middle": 0.5 * width, "end": width}[label.anchor]
        canvas.setFont(font, size)
        canvas.setFillAlpha(1.0)
        canvas.setStrokeAlpha(1.0)
        canvas.setDash()
        if label.halo is not None:
            canvas.setStrokeColor(HexColor(label.halo))
            canvas.setLineWidth(0.22 * label.size)
            canvas.drawString(x, self._drawing.height - y, label.text, mode=1)
        canvas.setFillColor(HexColor(label.colour))
        canvas.drawString(x, self._drawing.height - y, label.text, mode=0)


def _take(canvas: Any, pen: LineStyle) -> None:
    if pen.line is not None:
        canvas.setStrokeColor(HexColor(pen.line))
        canvas.setLineWidth(pen.width)
    if pen.fill is not None:
        canvas.setFillColor(HexColor(pen.fill))
    if pen.dash is None:
        canvas.setDash()
    else:
        canvas.setDash(*pen.dash)
    # Setting a colour resets the opacity, so the opacity is set last.
    canvas.setStrokeAlpha(pen.opacity)
    canvas.setFillAlpha(pen.opacity)


def _fonts(text: str) -> tuple[str, str]:
    """Return the names of an embedded plain and bold font that contain all characters of a text."""
    missing: set[str] = set()
    for plain, bold in FONTS:
        try:
            made = [_font(name) for name in (plain, bold)]
        except (TTFError, OSError):
            continue
        lacking = {
            letter
            for letter in text
            if letter not in "\n\t" and any(ord(letter) not in one.face.charToGlyph for one in made)
        }
        if not lacking:
            for one in made:
                pdfmetrics.registerFont(one)
            return made[0].fontName, made[1].fontName
        missing = missing & lacking if missing else lacking
    shown = ", ".join(f"{letter!r} (U+{ord(letter):04X})" for letter in sorted(missing)[:5])
    raise UsageError(
        f"the PDF's fonts lack characters of this report: {shown}; write .html instead, and print it to PDF from a "
        "browser",
        code="plan.report-characters",
    )


def _font(name: str) -> Any:
    own = Path(reportlab.__file__).parent / "fonts" / name
    return TTFont(name.removesuffix(".ttf"), str(own) if own.exists() else name)


def _texts(sheet: PlanSheet, parts: tuple[Section, ...]) -> Iterator[str]:
    """Yield all texts of the report, to check the characters that its font must have."""
    yield from (
        TITLE,
        NOT_A_DEVICE,
        movement_words(sheet.plan),
        sheet.patient or "",
        target_words(sheet),
        "\u2022\u00b7",
    )
    for part in parts:
        yield part.title
        for block in part.blocks:
            yield from _texts_of(block)


def _texts_of(block: Block) -> Iterator[str]:
    match block:
        case Words(text=text):
            yield text
        case Bullets(items=items):
            yield from items
        case Facts(rows=rows):
            yield from (cell for row in rows for cell in row)
        case ReportTable(head=head, rows=rows):
            yield from head
            yield from (cell for row in rows for cell in row)
        case Figure(drawing=drawing, caption=caption):
            yield caption
            yield from (shape.text for shape in drawing.shapes if isinstance(shape, Label))
        case Figures(items=items):
            for item in items:
                yield from _texts_of(item)
