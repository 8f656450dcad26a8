"""Event of a flight, as it is listed in scores and exports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from carina.display import one_line

EventKind = Literal[
    "clock-start",
    "seen",
    "visit",
    "revisit",
    "progress",
    "contact",
    "landmark",
    "entered",
    "wrong-branch",
    "wrong-segment",
    "held",
    "station",
    "reached",
    "completed",
    "doubt",
    "clock-end",
]


@one_line
@dataclass(frozen=True, slots=True)
class FlightEvent:
    """Event of a flight, such as a contact with the wall or a wrong branch."""

    time_s: float
    """Time from the start of the recording, s."""
    kind: EventKind
    name: str
    """Segment, branch, structure or reason of the event."""
    detail: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the event as plain JSON types."""
        return {"time_s": self.time_s, "kind": self.kind, "name": self.name, "detail": self.detail}
