"""Values in the words of a report, one way for all of its parts."""

from __future__ import annotations

from collections.abc import Sequence

from carina.plan.moves import Move
from carina.plan.routes import BronchusSign

__all__ = [
    "NOT_A_DEVICE",
    "SIGNS",
    "carina_words",
    "clock",
    "lines_of",
    "move_words",
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
"""Width of a letter, of its size, averaged over text in the fonts of page and PDF."""
LEAST_MOVE_DEG = 2.5


def clock(hours: float) -> str:
    """An hour of the clock face to the nearest half hour.

    Examples
    --------
    >>> clock(2.6), clock(11.9), clock(0.3)
    ('2:30', '12:00', '12:30')
    """
    halves = round(2.0 * hours) % 24
    hour, half = divmod(halves, 2)
    return f"{hour or 12}:{'30' if half else '00'}"


def carina_words(mm: float | None) -> str:
    """Where on the route, from the main carina.

    Examples
    --------
    >>> carina_words(41.6), carina_words(0.2), carina_words(-12.0), carina_words(None)
    ('42 mm', 'at the carina', '12 mm above', 'not known')
    """
    if mm is None:
        return "not known"
    if abs(mm) < 0.5:
        return "at the carina"
    return f"{mm:.0f} mm" if mm > 0.0 else f"{-mm:.0f} mm above"


def per_cent(share: float | None) -> str:
    """92 %"""
    return "not calculated" if share is None else f"{100.0 * share:.0f} %"


def move_words(moves: Sequence[Move] | None) -> str:
    """What the hand does, in order.

    Examples
    --------
    >>> move_words([Move(-40.0, 35.0, 18.0), Move(0.0, 0.0, -3.0)])
    'turn 40\u00b0 anticlockwise, flex 35\u00b0 up, advance 18 mm; lever neutral, withdraw 3 mm'
    """
    if moves is None:
        return "moves not calculated"
    said = []
    lever: float | None = None
    for move in moves:
        parts = []
        if abs(move.turn_deg) >= LEAST_MOVE_DEG:
            parts.append(f"turn {abs(move.turn_deg):.0f}\u00b0 {'clockwise' if move.turn_deg > 0 else 'anticlockwise'}")
        if lever is None or abs(move.flexion_deg - lever) >= LEAST_MOVE_DEG:
            parts.append(_lever_words(move.flexion_deg))
            lever = move.flexion_deg
        if abs(move.advance_mm) >= 0.5:
            parts.append(f"{'advance' if move.advance_mm > 0 else 'withdraw'} {abs(move.advance_mm):.0f} mm")
        if parts:
            said.append(", ".join(parts))
    return "; ".join(said) or "hold"


def _lever_words(flexion_deg: float) -> str:
    if abs(flexion_deg) < LEAST_MOVE_DEG:
        return "lever neutral"
    return f"flex {abs(flexion_deg):.0f}\u00b0 {'up' if flexion_deg > 0 else 'down'}"


def text_width(text: str, size: float) -> float:
    """About how wide a line of text is, in the unit of its size."""
    return AVERAGE_ADVANCE * size * len(text)


def lines_of(text: str, size: float, width: float) -> list[str]:
    """Text in lines that fit a width, broken at spaces."""
    lines: list[str] = []
    for word in text.split():
        if lines and text_width(f"{lines[-1]} {word}", size) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines
