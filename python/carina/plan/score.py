"""By what routes are ranked: first by whether the planned scope gets there, then by a score whose parts are told."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from carina.argument_checks import check_fields, number_from
from carina.display import one_line
from carina.errors import UsageError
from carina.plan.last_leg import LastLeg
from carina.plan.nodule import Nodule
from carina.plan.route_width import RouteWidth
from carina.scopes import ScopePreset

__all__ = ["Demands", "Judge", "Outlook", "ScoreWeights", "Worst"]

Outlook = Literal["reaches", "may reach", "does not reach"]
RANK: dict[Outlook, int] = {"reaches": 0, "may reach": 1, "does not reach": 2}

DEEP_MM = 8.0
"""So much of a needle's way in the target is enough for a sample."""
SURE = 0.9
"""Told *reaches* from this chance up, *does not reach* at what is left below its rest."""
BEND_SIGMA_DEG = 8.0
"""Of the angle that a route asks of the bending section (k)."""
DEPTH_SIGMA_MM = 0.5
"""Of where the target's edge lies along the needle (k)."""
MEDIASTINUM_MM = 2.0
"""Where the needle crosses more of it, a vessel may lie there unseen."""


@one_line
@dataclass(frozen=True, slots=True)
class ScoreWeights:
    """What each part of a route's score counts. A part is 0 at its best and 1 where it is as bad as can be."""

    misses: float = 0.25
    """Needle positions that miss."""
    way: float = 0.15
    """Way outside the lumen, of the tool's reach."""
    angle: float = 0.15
    """Angle between needle and airway, of 90 degrees."""
    narrow: float = 0.3
    """What the narrowest place on the way lacks for the scope, of the scope's own size; 1 where it lacks a quarter."""
    vessels: float = 0.1
    """What the nearest vessel lacks of the margin; 1 where mediastinum is crossed, whose vessels are not seen."""
    shallow: float = 0.15
    """What the needle's way in the target lacks of 8 mm, or of the target's own length."""

    def __post_init__(self) -> None:
        check_fields(self, **dict.fromkeys(self.__slots__, number_from(0.0, 1e6)))
        values = [getattr(self, name) for name in self.__slots__]
        if not all(math.isfinite(v) and v >= 0.0 for v in values) or sum(values) <= 0.0:
            raise UsageError(f"weights: expected numbers from 0 up, not all 0; found {values}", code="plan.weights")

    def to_json(self) -> dict[str, float]:
        """Plain JSON types."""
        return {name: float(getattr(self, name)) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Worst:
    """The worst place on a way."""

    value: float
    at_mm: float
    """From the root."""


@dataclass(frozen=True, slots=True)
class Demands:
    """What the way to a place asks of a scope."""

    width: RouteWidth
    """The narrowest place."""
    bend_deg: Worst
    """The sharpest turn over the length of rigid tip and bending section; where that ends."""
    doubts: tuple[str, ...]
    trust: float
    """How sure it is that the way is airway: 1 without doubts."""


@dataclass(frozen=True, slots=True)
class Judge:
    """By what a route is judged."""

    scope: ScopePreset
    margin_mm: float
    weights: ScoreWeights
    reach_mm: float
    """How far the tool works beyond the scope's tip."""

    def parts(self, leg: LastLeg, narrowest_mm: float, nodule: Nodule) -> dict[str, float]:
        """Of the score, each 0 to 1 (`ScoreWeights`)."""
        near = 0.0 if self.margin_mm <= 0.0 or leg.vessel_mm is None else 1.0 - leg.vessel_mm / self.margin_mm
        found = {
            "misses": 1.0 - leg.hit_share,
            "way": leg.outside_mm / self.reach_mm,
            "angle": leg.angle_deg / 90.0,
            "narrow": 4.0 * (1.0 - narrowest_mm / self.scope.fit_mm),
            "vessels": 1.0 if self.margin_mm > 0.0 and leg.mediastinum_mm > MEDIASTINUM_MM else near,
            "shallow": 1.0 - leg.in_target_mm / min(DEEP_MM, 0.9 * nodule.short_mm),
        }
        return {name: float(np.clip(part, 0.0, 1.0)) for name, part in found.items()}

    def score(self, parts: dict[str, float]) -> float:
        """0 to 1, 1 the best."""
        total = sum(getattr(self.weights, name) for name in parts)
        lost = sum(getattr(self.weights, name) * part for name, part in parts.items())
        return 1.0 - float(lost) / float(total)

    def outlook(self, way: Demands, leg: LastLeg | None = None) -> tuple[Outlook, float, tuple[str, ...]]:
        """Whether it gets there by width, bend, doubts and the tool's reach; how likely; what stands against it."""
        found: Outlook = "may reach" if way.doubts else "reaches"
        chance = way.trust
        limits = []
        asked: list[tuple[float | None, str]] = [self._room(way), self._bend(way)]
        if leg is not None:
            asked.append(self._depth(leg))
        for share, words in asked:
            answer: Outlook = (
                "may reach"
                if share is None
                else "reaches"
                if share >= SURE
                else "does not reach"
                if share <= 1.0 - SURE
                else "may reach"
            )
            if answer != "reaches":
                limits.append(words)
            found = max(found, answer, key=lambda one: RANK[one])
            chance *= 0.5 if share is None else share
        return found, chance, tuple(limits)

    def _depth(self, leg: LastLeg) -> tuple[float, str]:
        spare = self.reach_mm - leg.to_target_mm
        return _share(spare / DEPTH_SIGMA_MM), f"the tool reaches no more than {spare:.1f} mm beyond the target's edge"

    def _room(self, way: Demands) -> tuple[float, str]:
        needs = f"{self.scope.title} needs {self.scope.fit_mm:.1f} mm"
        words = [way.width.place_words, needs, *([] if way.width.why is None else [way.width.why])]
        return way.width.chance(self.scope), "; ".join(words)

    def _bend(self, way: Demands) -> tuple[float | None, str]:
        if self.scope.flexion_deg is None or self.scope.bending_mm is None:
            return None, f"it is not known how far {self.scope.title} flexes"
        most = max(self.scope.flexion_deg)
        words = (
            f"the bend {way.bend_deg.at_mm:.0f} mm along the route requires {way.bend_deg.value:.0f} degrees of "
            f"flexion; {self.scope.title} has {most:.0f}"
        )
        return _share((most - way.bend_deg.value) / BEND_SIGMA_DEG), words


def bending_mm(scope: ScopePreset) -> float | None:
    """Length of rigid tip and bending section; None where it is not known."""
    return None if scope.bending_mm is None else float(np.mean(scope.bending_mm)) + (scope.rigid_tip_mm or 0.0)


def order(route: Any) -> tuple[Any, ...]:
    """Return the sort key of a route: what the scope reaches, then the score; for *may reach*, times its chance."""
    score = route.score * route.chance if route.outlook == "may reach" else route.score
    return RANK[route.outlook], -score, route.branch_id, route.aim


def _share(sigmas: float) -> float:
    """Of a Gaussian below so many standard deviations."""
    return 0.5 * (1.0 + math.erf(sigmas / math.sqrt(2.0)))
