"""Lymph node stations for EBUS that a route passes or that are next to its target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from carina.display import one_line
from carina.plan.ebus import EBUS_LIMITS, STATION_SOURCE, Landmark, ebus_landmarks
from carina.plan.routes.main_carina import DistanceOrigin, carina_words
from carina.plan.routes.plan_route import Plan, PlannedRoute
from carina.plan.turns.fork_view import Operator
from carina.track import AirwayTree

NEXT_TO_MM = 25.0
"""Maximum distance in mm from the target's edge to a landmark at which the station counts as next to the target."""
ON_ROUTE_MM = 1.0
"""Distance in mm by which a landmark may be beyond the tip and still be on the route."""
STATION_NOTE = f"{EBUS_LIMITS} Source of the borders: {STATION_SOURCE}."


@one_line
@dataclass(frozen=True, slots=True)
class RouteStation:
    """Station of a route, by the landmark from which it is examined."""

    landmark: Landmark
    on_route: bool
    """Whether the scope passes the landmark on the route."""
    to_target_mm: float
    """Distance in mm from the landmark in the airway to the target's edge; 0 inside the target."""

    @property
    def is_next_to_target(self) -> bool:
        """Whether the landmark is at most 25 mm from the target's edge."""
        return self.to_target_mm <= NEXT_TO_MM

    @property
    def place_words(self) -> str:
        """Distance of the landmark from the ridge of the main carina, as text."""
        mm = self.landmark.from_carina_mm
        return "not known" if mm is None else carina_words(mm)

    @property
    def relation(self) -> str:
        """Relation to route and target as text, such as *on the route, 18 mm from the target*."""
        near = f"{self.to_target_mm:.0f} mm from the target" if self.is_next_to_target else ""
        return ", ".join(one for one in ("on the route" if self.on_route else "", near) if one)

    @property
    def words(self) -> str:
        """Station, position, clock hour for an operator at the head, and relation to the target, as text."""
        return self.words_for("head")

    def words_for(self, operator: Operator) -> str:
        """Return station, place, clock hour for an operator and relation, as text.

        Parameters
        ----------
        operator
            Position of the operator, for whom the clock hour is: at the patient's head, or facing the patient.
        """
        at_head = operator == "head"
        hour = self.landmark.clock_head if at_head else self.landmark.clock_facing
        whose = "at the head" if at_head else "who faces the patient"
        clock = "" if hour is None else f", towards {round(hour) or 12} o'clock for an operator {whose}"
        return (
            f"station {self.landmark.station} from {self.landmark.seen_from}, {self.place_words}{clock}: "
            f"{self.relation}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the station as plain JSON types: the landmark, with its relation to route and target."""
        return self.landmark.to_json() | {
            "on_route": self.on_route,
            "to_target_mm": self.to_target_mm,
            "relation": self.relation,
            "head": self.words_for("head"),
            "facing": self.words_for("facing"),
        }


def route_stations(
    tree: AirwayTree, plan: Plan, route: PlannedRoute, *, origin: DistanceOrigin | None = None
) -> tuple[RouteStation, ...]:
    """Return the stations that a route passes or that are next to its target, from the trachea outwards.

    Stations whose airways are missing in the tree are left out.

    Parameters
    ----------
    tree
        Named airways of the plan.
    plan, route
        A plan and one of its routes.
    origin
        Origin of the distances, the ridge of the main carina; that of the route if None.
    """
    known_origin = route.origin if route.origin.is_carina else None
    lineage = tree.lineage(route.branch_id)
    ids = {branch.id for branch in lineage}
    before = {branch.id: sum(one.length_mm for one in lineage[:n]) for n, branch in enumerate(lineage)}
    found = []
    for mark in ebus_landmarks(tree, origin=known_origin if origin is None else origin):
        if mark.point_lps is None:
            continue
        point = np.array(mark.point_lps)
        to_target = max(float(plan.nodule.distance_mm(point[None])[0]), 0.0)
        on_route = False
        if mark.branch_id in ids:
            branch = next(one for one in lineage if one.id == mark.branch_id)
            run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
            along = float(run[np.argmin(np.linalg.norm(branch.points - point, axis=1))])
            on_route = before[branch.id] + along <= route.along_mm + ON_ROUTE_MM
        station = RouteStation(mark, on_route, to_target)
        if on_route or station.is_next_to_target:
            found.append(station)
    return tuple(found)
