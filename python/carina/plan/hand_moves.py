"""Move of the operator's hand along a route: turn, flexion and advance of the scope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carina.display import one_line


@one_line
@dataclass(frozen=True, slots=True)
class Move:
    """Move of the hand: turn the scope, set the lever, then advance, one after the other."""

    turn_deg: float
    """Change of roll in degrees, clockwise as seen by the operator."""
    flexion_deg: float
    """Flexion in degrees that the lever is set to (not a change); above 0 the tip bends to the instrument's up side."""
    advance_mm: float
    """Advance in mm; below 0 the scope is withdrawn."""

    def to_json(self) -> dict[str, Any]:
        """Return the move as plain JSON types."""
        return {"turn_deg": self.turn_deg, "flexion_deg": self.flexion_deg, "advance_mm": self.advance_mm}
