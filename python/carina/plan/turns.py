"""The list of turns: fork by fork, where the opening is and what the hand does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from carina.display import one_line
from carina.plan.moves import Move

__all__ = ["Turn", "TurnList"]


@one_line
@dataclass(frozen=True, slots=True)
class Turn:
    """One fork of a route."""

    from_branch: str
    to_branch: str
    to_branch_id: int
    fork_lps: tuple[float, float, float]
    from_carina_mm: float | None
    """From the main carina along the route; below 0 before it, None where the tree shows none."""
    from_fork_mm: float
    """From the fork before; from where the route begins for the first."""
    clock_head: float
    """Where the opening is seen, 0 < hours <= 12, in the levelled picture of an operator at the patient's head."""
    clock_facing: float
    """The same for an operator who faces the patient."""
    angle_deg: float
    """Between the way so far and the way on."""
    diameter_mm: float
    """Of the opening: the largest ball that enters the branch."""
    moves: tuple[Move, ...] | None
    """What the hand does from the fork before to here, in the verdict's drive; None where no drive is known."""
    doubts: tuple[str, ...]
    """What must be said of the branch that is entered."""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "from_branch": self.from_branch,
            "to_branch": self.to_branch,
            "to_branch_id": self.to_branch_id,
            "fork_lps": list(self.fork_lps),
            "from_carina_mm": self.from_carina_mm,
            "from_fork_mm": self.from_fork_mm,
            "clock_head": self.clock_head,
            "clock_facing": self.clock_facing,
            "angle_deg": self.angle_deg,
            "diameter_mm": self.diameter_mm,
            "moves": None if self.moves is None else [move.to_json() for move in self.moves],
            "doubts": list(self.doubts),
        }


@one_line
@dataclass(frozen=True, slots=True)
class TurnList:
    """All forks of a route in order, and the place where the scope is parked."""

    turns: tuple[Turn, ...]
    park_from_carina_mm: float | None
    park_from_fork_mm: float
    carina_depth_mm: float | None
    """Depth of the main carina at nose or mouth, as the user set it (an estimate); None where nobody did."""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "turns": [turn.to_json() for turn in self.turns],
            "park_from_carina_mm": self.park_from_carina_mm,
            "park_from_fork_mm": self.park_from_fork_mm,
            "carina_depth_mm": self.carina_depth_mm,
        }
