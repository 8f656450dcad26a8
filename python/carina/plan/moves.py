"""What the hand does on the way: turn, flex, advance, move by move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carina.display import one_line

__all__ = ["Move"]


@one_line
@dataclass(frozen=True, slots=True)
class Move:
    """Turn the scope, set the lever, then advance; one after the other, and nothing else."""

    turn_deg: float
    """Change of roll, clockwise as the operator sees it."""
    flexion_deg: float
    """What the bending section is set to (not a change); above 0 the instrument's up."""
    advance_mm: float
    """Below 0 the scope is withdrawn."""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {"turn_deg": self.turn_deg, "flexion_deg": self.flexion_deg, "advance_mm": self.advance_mm}
