"""Content blocks of a report, common to the HTML page and the PDF: text, tables and drawings in sections."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from carina.display import one_line
from carina.plan.report.drawing import Drawing

MAX_ROWS = 14
"""Maximum number of rows of a table that is not divided between pages."""
Tone = Literal["plain", "lead", "quiet", "warning"]
"""Tone of a text: ``lead`` is a summary; ``warning`` is red, for drawn airways and for limits that forbid something."""


@one_line
@dataclass(frozen=True, slots=True)
class Words:
    """Paragraph of text."""

    text: str
    tone: Tone = "plain"


@one_line
@dataclass(frozen=True, slots=True)
class Bullets:
    """Bulleted list of sentences."""

    items: tuple[str, ...]
    tone: Tone = "plain"
    warned: tuple[int, ...] = ()
    """Indices of the sentences that are red; all are if the tone is ``warning``."""


@one_line
@dataclass(frozen=True, slots=True)
class Facts:
    """Table of two columns, names and values, with the main results of a section."""

    rows: tuple[tuple[str, str], ...]


@one_line
@dataclass(frozen=True, slots=True)
class ReportTable:
    """Table; ``shares`` are relative column widths, and the rows with an index in ``warned`` are red."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    shares: tuple[float, ...]
    warned: tuple[int, ...] = ()


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Frames that the HTML page plays over a drawing; the PDF shows only the drawing."""

    strip_jpeg: bytes = field(repr=False)
    """Square frames below one another, as one JPEG image."""
    num_frames: int
    duration_s: float
    says: str
    """Text alternative of the clip for screen readers."""


@one_line
@dataclass(frozen=True, slots=True)
class Figure:
    """Drawing with a caption and an optional clip."""

    drawing: Drawing
    caption: str = ""
    clip: Clip | None = None


@one_line
@dataclass(frozen=True, slots=True)
class Figures:
    """Drawings side by side, at most ``columns`` in a row."""

    items: tuple[Figure, ...]
    columns: int


Block = Words | Bullets | Facts | ReportTable | Figure | Figures


@one_line
@dataclass(frozen=True, slots=True)
class Section:
    """Section of the report with a title; ``name`` is its short identifier for programs and links."""

    name: str
    title: str
    blocks: tuple[Block, ...]
    starts_page: bool = False

    @property
    def is_whole(self) -> bool:
        """Whether the section is not divided between pages, because it contains no long table."""
        return not any(isinstance(block, ReportTable) and len(block.rows) > MAX_ROWS for block in self.blocks)
