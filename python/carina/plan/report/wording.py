"""Functions that format values as text for all parts of a report."""

from __future__ import annotations

NOT_A_DEVICE = "Not a medical device."
AGAINST = "Against this plan, and its limits"
"""Heading of the list of reasons against a plan."""
# fmt: off
ADVANCES = (
    32, 40, 46, 84, 64, 95, 78, 27, 39, 39, 50, 84, 32, 36, 32, 34, 64, 64, 64, 64, 64, 64, 64, 64,
    64, 64, 34, 34, 84, 84, 84, 56, 102, 68, 69, 72, 77, 67, 61, 78, 75, 29, 50, 67, 56, 86, 75, 79,
    67, 79, 72, 67, 61, 73, 68, 99, 69, 67, 69, 39, 34, 39, 84, 56, 50, 61, 63, 55, 63, 62, 35, 63,
    63, 28, 28, 58, 28, 97, 63, 61, 63, 63, 41, 52, 39, 63, 59, 82, 59, 59, 52, 64, 34, 64, 84,
)
# fmt: on
"""Widths of the characters from space to ``~`` in hundredths of the font size.

Each width is the larger one of Helvetica and of the PDF's font, Bitstream Vera Sans, which is as wide as DejaVu Sans.
"""
OTHER_ADVANCE, WIDE_ADVANCE = 0.7, 1.0
"""Widths of other characters as shares of the font size; the second one is that of East Asian characters."""
FIRST_WIDE = 0x2E80
BOLD = 1.16
"""Width of bold text as a multiple of the width of plain text."""


def carina_cell(mm: float | None) -> str:
    """Return a distance from the main carina along the route as the text of a cell, whose heading names the carina.

    Examples
    --------
    >>> carina_cell(41.6), carina_cell(0.2), carina_cell(-12.0), carina_cell(None)
    ('42 mm', 'at the carina', '12 mm above', 'not known')
    """
    if mm is None:
        return "not known"
    if abs(mm) < 0.5:
        return "at the carina"
    return f"{mm:.0f} mm" if mm > 0.0 else f"{-mm:.0f} mm above"


def per_cent(share: float | None) -> str:
    """Return a share (0 to 1) as text in per cent, such as ``92 %``."""
    return "not known without a drive" if share is None else f"{100.0 * share:.0f} %"


def text_width(text: str, size: float, *, is_bold: bool = False) -> float:
    """Return the width of a line of text, in the unit of its font size; no font of a report is wider."""
    return size * sum(map(_advance, text)) * (BOLD if is_bold else 1.0)


def _advance(letter: str) -> float:
    """Return the width of a character as a share of the font size."""
    at = ord(letter) - 32
    if 0 <= at < len(ADVANCES):
        return 0.01 * ADVANCES[at]
    return WIDE_ADVANCE if ord(letter) >= FIRST_WIDE else OTHER_ADVANCE


def lines_of(text: str, size: float, width: float) -> list[str]:
    """Return text in lines that fit a width, broken at spaces, or inside a word that is longer than a line.

    Parameters
    ----------
    text
        The text.
    size
        Font size.
    width
        Width of a line, in the unit of the font size.
    """
    lines: list[str] = []
    for word in text.split():
        if lines and text_width(f"{lines[-1]} {word}", size) <= width:
            lines[-1] += f" {word}"
        else:
            lines += _pieces(word, size, width)
    return lines


def _pieces(word: str, size: float, width: float) -> list[str]:
    """Return a word cut into pieces that fit a width; a piece has at least one character."""
    pieces = [""]
    used = 0.0
    for letter in word:
        wide = text_width(letter, size)
        if pieces[-1] and used + wide > width:
            pieces.append("")
            used = 0.0
        pieces[-1] += letter
        used += wide
    return pieces
