"""What a report is made of, the same for the page and for the PDF: sections of words, tables and drawings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from carina.display import one_line
from carina.plan.report.drawing import Drawing

__all__ = ["Block", "Bullets", "Clip", "Facts", "Figure", "Figures", "Grid", "Section", "Tone", "Words"]

MOST_ROWS = 14
"""A table of no more rows stays on one page."""
Tone = Literal["plain", "lead", "quiet", "warning"]
"""*Lead* sums up; *warning* is red: what a person drew, and what forbids something."""


@one_line
@dataclass(frozen=True, slots=True)
class Words:
    """A paragraph."""

    text: str
    tone: Tone = "plain"


@one_line
@dataclass(frozen=True, slots=True)
class Bullets:
    """Sentences below one another."""

    items: tuple[str, ...]
    tone: Tone = "plain"


@one_line
@dataclass(frozen=True, slots=True)
class Facts:
    """Names with their values, the largest figures of a section."""

    rows: tuple[tuple[str, str], ...]


@one_line
@dataclass(frozen=True, slots=True)
class Grid:
    """A table. ``shares`` are the columns' widths as parts of the whole; rows in ``warned`` are red."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    shares: tuple[float, ...]
    warned: tuple[int, ...] = ()


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Frames that a page on a screen can play over a drawing; paper shows the drawing alone."""

    strip_jpeg: bytes = field(repr=False)
    """The frames below one another, square."""
    num_frames: int
    duration_s: float
    says: str
    """What it shows, for those who cannot see it."""


@one_line
@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing with what it shows, and the way there."""

    drawing: Drawing
    caption: str = ""
    clip: Clip | None = None


@one_line
@dataclass(frozen=True, slots=True)
class Figures:
    """Drawings side by side, at most so many in a row."""

    items: tuple[Figure, ...]
    columns: int


Block = Words | Bullets | Facts | Grid | Figure | Figures


@one_line
@dataclass(frozen=True, slots=True)
class Section:
    """A titled part of the report. ``name`` is a short word for programs and links."""

    name: str
    title: str
    blocks: tuple[Block, ...]
    starts_page: bool = False

    @property
    def is_whole(self) -> bool:
        """It is not parted between pages: there is no long table in it."""
        return not any(isinstance(block, Grid) and len(block.rows) > MOST_ROWS for block in self.blocks)
