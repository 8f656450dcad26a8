"""Verdict on whether an instrument reaches the end of a route and can point its tool at the target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from carina.display import one_line
from carina.plan.instruments.tools import tool as tool_named
from carina.plan.routes.last_leg import edge_on_needle_mm
from carina.plan.routes.main_carina import ROOT, DistanceOrigin
from carina.plan.routes.plan_route import Plan
from carina.plan.verdict.checks import (
    Check,
)
from carina.plan.verdict.drive import DrivenRoute
from carina.scopes import ScopeHold, ScopePreset

__all__ = ["Outcome", "Verdict", "needle_to_target_mm"]

Outcome = Literal["reaches", "may reach", "does not reach", "cannot say"]
OUTCOMES: tuple[Outcome, ...] = ("reaches", "may reach", "cannot say", "does not reach")
"""Possible outcomes of a verdict, the best first."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Result of the checks and of the simulated drive for one instrument on one route."""

    scope: ScopePreset
    outcome: Outcome
    share: float | None
    """Smallest of the probabilities of the single checks; None if one of them cannot be computed."""
    checks: tuple[Check, ...]
    reached_mm: float | None
    """Distance in mm from the origin of the route to the place that the tip reaches; None if it is not known."""
    hold: ScopeHold | None
    """Roll and lever with which the scope points at the target; None if the scope did not arrive."""
    driven: DrivenRoute | None
    """Simulated drive; None if checks without a simulation decide, or too little is known about the instrument."""
    would: str | None
    """Changes with which the instrument would reach the target, as text; None if no change is needed."""
    origin: DistanceOrigin = ROOT
    """Origin of the distances, that of the route."""
    route_key: str = ""
    """Key of the route that was judged (`PlannedRoute.key`)."""
    tool: str = ""
    """Name of the tool with which the instrument was judged: that of the plan, or one that passes the channel."""
    needle_lps: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    """Tip after the drive, and the point on the needle at the distance of the aim, LPS mm.

    None if the drive did not arrive or no needle hits.
    """
    withdrawn_mm: float = 0.0
    """Distance in mm by which the drive withdraws the tip from the end of the route to aim at the target.

    0 if the tip stays within 2 mm of the end of the route.
    """

    @property
    def words(self) -> str:
        """Verdict as text, such as *reaches the end of the route and can point at the target*."""
        if self.outcome == "reaches":
            return "reaches the end of the route and can point at the target"
        worst = [check for check in self.checks if check.answer in {"no", "unknown", "perhaps"}]
        order = {"no": 0, "unknown": 1, "perhaps": 2}
        worst.sort(key=lambda check: order[check.answer])
        if not worst:
            return self.outcome
        stops = self.outcome == "does not reach" and worst[0].name in {"diameter", "bend", "drive"}
        if stops and self.reached_mm is not None:
            return f"stops {self.origin.words(self.reached_mm)}: {worst[0].words}"
        return f"{self.outcome}: {worst[0].words}"

    def to_json(self) -> dict[str, Any]:
        """Return the verdict as plain JSON types."""
        return {
            "scope": self.scope.name,
            "title": self.scope.title,
            "route": self.route_key,
            "tool": self.tool,
            "outcome": self.outcome,
            "share": self.share,
            "words": self.words,
            "checks": [
                {"name": c.name, "answer": c.answer, "share": c.share, "words": c.words, "basis": c.basis}
                for c in self.checks
            ],
            "reached_mm": self.reached_mm,
            "withdrawn_mm": self.withdrawn_mm,
            "hold": None
            if self.hold is None
            else {
                "insertion_mm": self.hold.insertion_mm,
                "roll_rad": self.hold.roll_rad,
                "flexion_rad": self.hold.flexion_rad,
            },
            "drive": None if self.driven is None else self.driven.to_json(poses=False),
            "would": self.would,
        }


def needle_to_target_mm(plan: Plan, verdict: Verdict) -> float:
    """Return the distance in mm from the tip after a verdict's drive to the target's edge along the needle.

    Parameters
    ----------
    plan
        Plan of the verdict's route.
    verdict
        Verdict with a needle (`Verdict.needle_lps`).
    """
    assert verdict.needle_lps is not None
    tip, end = (np.array(point) for point in verdict.needle_lps)
    return edge_on_needle_mm(plan.nodule, tip, end, tool_named(verdict.tool).reach_mm)
