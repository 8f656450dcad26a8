"""Ranking of routes: first by whether the planned scope reaches their end, then by a score with weighted parts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import check_fields, number_from
from carina.display import one_line
from carina.errors import UsageError
from carina.plan.instruments.tools import Tool
from carina.plan.routes.last_leg import LastLeg
from carina.plan.routes.route_width import SURE, RouteWidth
from carina.plan.targets.grow_nodule import Nodule
from carina.scopes import ScopePreset

Outlook = Literal["reaches", "may reach", "does not reach"]
OUTLOOKS: tuple[Outlook, ...] = ("reaches", "may reach", "does not reach")
"""Answers to the question whether the scope reaches the target by a route (its *outlook*), the best first."""
RANK: dict[Outlook, int] = {outlook: rank for rank, outlook in enumerate(OUTLOOKS)}

DEEP_MM = 8.0
"""Length in mm of needle inside the target that suffices for a sample."""
BEND_SIGMA_DEG = 8.0
"""Standard deviation in degrees of the angle that a route requires of the bending section (common knowledge)."""
POINTS, BARELY = 0.5, 0.1
"""Shares of needles that hit: from the first on, the scope can point at the target; below the second, it cannot.

The second share is small, because a needle pass can be repeated.
"""
DEPTH_SIGMA_MM = 0.5
"""Standard deviation in mm of the position of the target's edge along the needle (common knowledge)."""
MIN_SPARE_MM = DEPTH_SIGMA_MM * NormalDist().inv_cdf(SURE)
"""Minimum planned length in mm of a tool beyond the target's edge with which the tool certainly reaches the edge."""
MEDIASTINUM_MM = 2.0
"""Maximum length in mm of mediastinum on the needle path in which no hidden vessel is assumed."""


@one_line
@dataclass(frozen=True, slots=True)
class ScoreWeights:
    """Weights of the parts of a route's score; each part is 0 at its best and 1 at its worst."""

    misses: float = 0.25
    """Weight of the share of needles that miss the target."""
    way: float = 0.15
    """Weight of the needle's distance outside the lumen, divided by the tool's reach."""
    angle: float = 0.15
    """Weight of the angle between needle and airway, divided by 90 degrees."""
    narrow: float = 0.3
    """Weight of the width by which the route's narrowest place is narrower than the scope.

    The missing width is relative to the scope's size; the part is 1 if a quarter is missing.
    """
    vessels: float = 0.1
    """Weight of a vessel nearer to the needle than the margin.

    The part is 1 if the needle crosses mediastinum, whose vessels are not visible.
    """
    shallow: float = 0.15
    """Weight of a short length of needle in the target, compared with 8 mm or 90 % of the target's short diameter."""

    def __post_init__(self) -> None:
        """Raise an error if a weight is negative or not finite, or if all weights are 0."""
        check_fields(self, **dict.fromkeys(self.__slots__, number_from(0.0, 1e6)))
        values = [getattr(self, name) for name in self.__slots__]
        if not all(math.isfinite(v) and v >= 0.0 for v in values) or sum(values) <= 0.0:
            raise UsageError(f"weights: expected numbers from 0 up, not all 0; found {values}", code="plan.weights")

    def to_json(self) -> dict[str, float]:
        """Return the weights as plain JSON types, by name."""
        return {name: float(getattr(self, name)) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class WorstValue:
    """Worst value of a measure along a path from the root, and the position of this value on the path."""

    value: float
    at_mm: float
    """Distance of the worst value's place from the origin of the path's distances (`RouteWidth.origin`), mm."""


@dataclass(frozen=True, slots=True)
class PathRequirements:
    """Requirements of a path for the scope that follows it: width, bend, and doubts about the airways."""

    width: RouteWidth
    """Narrowest diameter of the path, with its error."""
    bend_deg: WorstValue
    """Sharpest turn in degrees over the length of rigid tip and bending section, and the place where it ends."""
    doubts: tuple[str, ...]
    trust: float
    """Probability that every branch of the path is an airway; 1 if no branch is doubtful."""


@dataclass(frozen=True, slots=True)
class Judge:
    """Criteria by which routes to one target are judged: scope, tool and weights."""

    scope: ScopePreset
    margin_mm: float
    weights: ScoreWeights
    reach_mm: float
    """Distance in mm beyond the scope's tip that the tool reaches."""
    tool: Tool | None = None
    """Tool that must pass the scope's channel; None leaves the channel unchecked."""

    def parts(self, leg: LastLeg, narrowest_mm: float, nodule: Nodule) -> dict[str, float]:
        """Return the parts of a route's score by name, each 0 (best) to 1 (`ScoreWeights`).

        Parameters
        ----------
        leg
            Needle path of the route.
        narrowest_mm
            Narrowest diameter of the route.
        nodule
            The target.
        """
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
        """Return the score of a route from its parts, 0 to 1 (best)."""
        total = sum(getattr(self.weights, name) for name in parts)
        lost = sum(getattr(self.weights, name) * part for name, part in parts.items())
        return 1.0 - float(lost) / float(total)

    def outlook(self, way: PathRequirements, leg: LastLeg | None = None) -> tuple[Outlook, float, tuple[str, ...]]:
        """Return whether the scope reaches a place, the probability, and the reasons against reaching the place.

        The criteria are width, bend, doubts about the airways and, with a leg, the tool's reach and the share of
        needles that hit in a direction that the scope can take.

        Parameters
        ----------
        way
            Width, bend and doubts of the path to the place.
        leg
            Needle path from the place; None ignores the tool's reach and the direction.
        """
        found: Outlook = "may reach" if way.doubts else "reaches"
        chance = way.trust
        limits = []
        criteria: list[tuple[float | None, str]] = [self._width(way), self._bend(way)]
        if leg is not None:
            criteria.append(self._depth(leg))
        for share, words in criteria:
            answer: Outlook = "may reach" if share is None else _outlook_of(share)
            if answer != "reaches":
                limits.append(words)
            found = worst(found, answer)
            chance *= 0.5 if share is None else share
        if leg is not None and leg.hit_share < POINTS:
            found = worst(found, OUTLOOKS[int(pointing_rank(leg.hit_share))])
            limits.append(self.aim_limit(leg))
            chance *= leg.hit_share
        blocked = self.channel_limit()
        if leg is not None and blocked is not None:
            found, chance = "does not reach", 0.0
            limits.append(blocked)
        return found, chance, tuple(limits)

    def channel_limit(self) -> str | None:
        """Return the reason why the tool does not pass the scope's channel; None if it passes or this is unknown."""
        if self.tool is None or self.scope.channel_mm is None or self.tool.passes(self.scope.channel_mm):
            return None
        return (
            f"{self.tool.title} ({self.tool.outer_mm:g} mm) does not fit the working channel of {self.scope.title} "
            f"({self.scope.channel_mm:g} mm)"
        )

    def aim_limit(self, leg: LastLeg) -> str:
        """Return the reason against a scope position from which too few needles hit, as text."""
        if leg.hit_share < BARELY:
            return (
                f"{self.scope.title} cannot point at the target there: the needle would leave the airway at "
                f"{leg.angle_deg:.0f} degrees"
            )
        return (
            "fewer than half of needle passes are expected to hit in the best direction that "
            f"{self.scope.title} can take"
        )

    def depth_limit(self, leg: LastLeg) -> tuple[Outlook, tuple[str, ...]]:
        """Return whether the tool is long enough to reach the target from a tip, and the reason if not surely."""
        _, words = self._depth(leg)
        rank = int(depth_rank(self.reach_mm - leg.to_target_mm))
        return OUTLOOKS[rank], (() if rank == RANK["reaches"] else (words,))

    def _depth(self, leg: LastLeg) -> tuple[float, str]:
        spare = self.reach_mm - leg.to_target_mm
        return _share(spare / DEPTH_SIGMA_MM), depth_words(spare)

    def _width(self, way: PathRequirements) -> tuple[float, str]:
        needs = f"{self.scope.title} needs {self.scope.fit_mm:.1f} mm"
        words = [way.width.place_words, needs, *([] if way.width.why is None else [way.width.why])]
        return way.width.chance(self.scope), "; ".join(words)

    def _bend(self, way: PathRequirements) -> tuple[float | None, str]:
        if self.scope.flexion_deg is None or self.scope.bending_mm is None:
            return None, f"it is not known how far {self.scope.title} flexes"
        most = max(self.scope.flexion_deg)
        place = way.width.origin.words(way.bend_deg.at_mm)
        words = (
            f"the bend {place} requires {way.bend_deg.value:.0f} degrees of flexion; {self.scope.title} has {most:.0f}"
        )
        return _share((most - way.bend_deg.value) / BEND_SIGMA_DEG), words


def bending_mm(scope: ScopePreset) -> float | None:
    """Return the length of a scope's rigid tip and bending section in mm; None if the length is not known."""
    return None if scope.bending_mm is None else float(np.mean(scope.bending_mm)) + (scope.rigid_tip_mm or 0.0)


def pointing_rank(hit_share: ArrayLike) -> NDArray[np.int64]:
    """Return the ranks of outlooks (`OUTLOOKS`) for shares of needles that hit.

    Parameters
    ----------
    hit_share
        Shares, 0 to 1, of any shape.
    """
    share = np.asarray(hit_share)
    found: NDArray[np.int64] = np.where(share >= POINTS, 0, np.where(share >= BARELY, 1, 2))
    return found


def depth_rank(spare_mm: ArrayLike) -> NDArray[np.int64]:
    """Return the ranks of outlooks (`OUTLOOKS`) for lengths of a tool beyond the edge of a target.

    Parameters
    ----------
    spare_mm
        Lengths in mm, of any shape; negative if the tool ends before the target.
    """
    spare = np.asarray(spare_mm)
    found: NDArray[np.int64] = np.where(spare >= MIN_SPARE_MM, 0, np.where(spare > -MIN_SPARE_MM, 1, 2))
    return found


def depth_words(spare_mm: float) -> str:
    """Return the length of a tool beyond the edge of a target as text; the length is negative before the edge."""
    if spare_mm >= 0.0:
        return f"the tool reaches no more than {spare_mm:.1f} mm beyond the target's edge"
    return f"the tool ends {-spare_mm:.1f} mm before the target's edge"


def order(route: Any) -> tuple[Any, ...]:
    """Return the sort key of a route: the outlook, then the score, which *may reach* multiplies by the probability."""
    score = route.score * route.chance if route.outlook == "may reach" else route.score
    return RANK[route.outlook], -score, route.branch_id, route.aim


def worst(*outlooks: Outlook) -> Outlook:
    """Return the worst of several outlooks."""
    return max(outlooks, key=lambda one: RANK[one])


def _outlook_of(share: float) -> Outlook:
    return "reaches" if share >= SURE else "does not reach" if share <= 1.0 - SURE else "may reach"


def _share(sigmas: float) -> float:
    """Return the probability that a standard normal variable is below ``sigmas``."""
    return 0.5 * (1.0 + math.erf(sigmas / math.sqrt(2.0)))
