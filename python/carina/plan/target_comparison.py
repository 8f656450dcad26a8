"""Comparison of the plans of several targets in one table with one order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from carina.argument_checks import check_arguments, each, instance, text_of
from carina.display import one_line
from carina.errors import UsageError
from carina.plan.routes.plan_route import Plan, PlannedRoute
from carina.plan.routes.ranking import RANK

ORDER_RULE = (
    "Order: the outlook of the first route (reaches, may reach, does not reach, no route), then fewer doubts about "
    "target and airways, then the larger expected share of needle passes that hit, then the shorter way past the main "
    "carina."
)
NO_ROUTE = "no route"
HITS_UNKNOWN = "not known without a drive"


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ComparedTarget:
    """Row of a comparison of targets, with the first route of the target's plan."""

    title: str
    plan: Plan

    @property
    def route(self) -> PlannedRoute | None:
        """First route of the target's plan; None without a route."""
        return self.plan.routes[0] if self.plan.routes else None

    @property
    def outlook(self) -> str:
        """Outlook of the first route, or *no route*."""
        return NO_ROUTE if self.route is None else self.route.outlook

    @property
    def doubts(self) -> tuple[str, ...]:
        """Doubts about the target and the route's airways; also the reason why there is no route.

        Doubts about outlook, needle and vessel are not included, because they have their own columns.
        """
        found = tuple(doubt.words for doubt in self.plan.doubts)
        if self.route is not None:
            return (*found, *self.route.doubts)
        return (*found, *((self.plan.why,) if self.plan.why is not None else ()))

    @property
    def cells(self) -> tuple[str, ...]:
        """Texts of the row in the order of `HEAD`."""
        route = self.route
        doubts = "; ".join(self.doubts) or "none"
        if route is None:
            return (self.title, NO_ROUTE, "", "", "", "", "", doubts)
        vessel = "none seen" if route.leg.vessel_mm is None else f"{route.leg.vessel_mm:.1f} mm"
        vessel = "on the way" if route.leg.crosses_vessel else vessel
        return (
            self.title,
            self.outlook,
            HITS_UNKNOWN if route.hit_share is None else f"{100 * route.hit_share:.0f} %",
            route.width.words,
            route.place_words,
            f"{route.leg.to_target_mm:.1f} mm",
            vessel,
            doubts,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the row as plain JSON types; its figures are those of the target's own plan."""
        route = self.route
        value = None if route is None else route.to_json()
        leg = None if value is None else value["leg"]
        return {
            "name": self.title,
            "outlook": self.outlook,
            "route": None if value is None else value["key"],
            "hit_share": None if leg is None else leg["hit_share"],
            "narrowest_mm": None if value is None else value["narrowest_mm"],
            "narrowest_error_mm": None if value is None else value["narrowest_error_mm"],
            "from_carina_mm": None if value is None else value["from_carina_mm"],
            "to_target_mm": None if leg is None else leg["to_target_mm"],
            "vessel_mm": None if leg is None else leg["vessel_mm"],
            "doubts": list(self.doubts),
        }


HEAD: Final = (
    "target",
    "outlook",
    "hits",
    "narrowest",
    "tip",
    "needle to target",
    "vessel",
    "doubts about target and airways",
)


@check_arguments(plans=each(instance(Plan, "get plans from carina.plan_route")), names=each(text_of(), optional=True))
def compare_targets(plans: Sequence[Plan], names: Sequence[str] | None = None) -> tuple[ComparedTarget, ...]:
    """Return the plans of several targets in one order (`ORDER_RULE`), the best first.

    Parameters
    ----------
    plans
        Plan of each target in the same airways.
    names
        Name of each target; *target 1*, *target 2* and so on if None.

    Raises
    ------
    UsageError
        If there are not as many names as plans.
    """
    titles = [f"target {n}" for n in range(1, len(plans) + 1)] if names is None else list(names)
    if len(titles) != len(plans):
        raise UsageError(f"names: expected {len(plans)}, one for each plan; found {len(titles)}")
    return tuple(sorted((ComparedTarget(*one) for one in zip(titles, plans, strict=True)), key=_order))


def _order(one: ComparedTarget) -> tuple[float, ...]:
    route = one.route
    if route is None:
        return (len(RANK), len(one.doubts), 0.0, 0.0)
    return (RANK[route.outlook], len(one.doubts), -(route.hit_share or 0.0), route.origin.past_mm(route.along_mm))


def comparison_lines(compared: Sequence[ComparedTarget]) -> tuple[str, ...]:
    """Return the comparison as lines of text: the rule of the order, then each target with its figures and doubts."""
    rows = [
        f"{place}. " + "; ".join(f"{head} {cell}" if head != "target" else cell for head, cell in named if cell)
        for place, one in enumerate(compared, 1)
        for named in [list(zip(HEAD, one.cells, strict=True))]
    ]
    return (ORDER_RULE, *rows)
