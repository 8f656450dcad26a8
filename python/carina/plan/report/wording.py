"""Functions that format values as text for all parts of a report."""

from __future__ import annotations

from carina.plan.routes.plan_route import BronchusSign

__all__ = [
    "NOT_A_DEVICE",
    "SIGNS",
    "carina_cell",
    "lines_of",
    "per_cent",
    "text_width",
]

NOT_A_DEVICE = "Not a medical device."
SIGNS: dict[BronchusSign, str] = {
    "into": "positive: an airway leads into the target",
    "beside": "an airway lies against the target",
    "none": "negative: no airway found leads to the target",
}
AVERAGE_ADVANCE = 0.52
"""Average width of a character as a share of the font size, in the fonts of the HTML page and the PDF."""


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
    return "not calculated" if share is None else f"{100.0 * share:.0f} %"


def text_width(text: str, size: float) -> float:
    """Return the approximate width of a line of text, in the unit of its font size."""
    return AVERAGE_ADVANCE * size * len(text)


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
