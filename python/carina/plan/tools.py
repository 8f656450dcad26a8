"""Instruments that go through a scope's working channel: what is known of each, and on what basis.

Basis as in the library of scopes: ``s`` was read in a source, ``k`` is common knowledge that was not checked against
the maker's data. Unknown is None, never a guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from carina.display import one_line
from carina.errors import UsageError

__all__ = ["DEFAULT_TOOL", "Tool", "tool", "tools"]

DEFAULT_TOOL = "needle-21g"
CLEARANCE_MM = 0.1
"""A tool slides in a channel that is so much wider (k)."""


@one_line
@dataclass(frozen=True, slots=True)
class Tool:
    """One instrument. Lengths in mm; None where nothing is known."""

    name: str
    title: str
    outer_mm: float
    """What the channel must let pass: needle with sheath."""
    reach_mm: float
    """How far beyond the scope's tip it works: a needle's throw, or how far a flexible tool is pushed under vision."""
    pierces: bool
    """Goes through an airway's wall; others stay in the lumen."""
    rigid_mm: float | None
    """Longest part that does not bend."""
    basis: str

    def __post_init__(self) -> None:
        for what, value, most in (("outer_mm", self.outer_mm, 10.0), ("reach_mm", self.reach_mm, 100.0)):
            if not (math.isfinite(value) and 0.0 < value <= most):
                raise UsageError(f"{what}: expected above 0 up to {most:g}; found {value}", code="plan.tool")

    def passes(self, channel_mm: float) -> bool:
        """Whether it slides through a channel of this width."""
        return channel_mm - self.outer_mm >= CLEARANCE_MM - 1e-9


_TOOLS = (
    Tool("needle-21g", "Aspiration needle, 21 G", 1.8, 15.0, True, 15.0, "k"),
    Tool("needle-19g", "Aspiration needle, 19 G", 1.9, 15.0, True, 15.0, "k"),
    Tool("needle-21g-long", "Aspiration needle, 21 G, long throw", 1.8, 20.0, True, 20.0, "k"),
    Tool("forceps", "Biopsy forceps, 1.8 mm", 1.8, 30.0, False, 8.0, "k"),
    Tool("brush", "Cytology brush", 1.4, 30.0, False, 10.0, "k"),
    Tool("cryoprobe-1.1", "Cryoprobe, 1.1 mm", 1.1, 30.0, False, None, "k"),
    Tool("cryoprobe-1.9", "Cryoprobe, 1.9 mm", 1.9, 30.0, False, None, "k"),
    Tool("ultrasound-1.4", "Radial ultrasound probe, 1.4 mm", 1.4, 40.0, False, None, "k"),
    Tool("guide-sheath", "Guide sheath, 1.95 mm", 1.95, 40.0, False, None, "k"),
)


def tools() -> tuple[Tool, ...]:
    """All instruments.

    Examples
    --------
    >>> [t.name for t in tools()][:2]
    ['needle-21g', 'needle-19g']
    """
    return _TOOLS


def tool(name: str) -> Tool:
    """The instrument of that name.

    Raises
    ------
    UsageError
        If there is none; all are listed.
    """
    found = next((one for one in _TOOLS if one.name == name), None)
    if found is None:
        known = ", ".join(one.name for one in _TOOLS)
        raise UsageError(f"no tool is called {name!r}; expected one of {known}", code="plan.tool")
    return found
