"""Route of a simulated drive: points along the route, its forks, and the farthest point visible from the tip."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carina.plan.routes.clearance import ball_diameters_mm
from carina.plan.routes.plan_route import PlannedRoute
from carina.scopes import WallField
from carina.track import AirwayTree, Route

Points = NDArray[np.float64]

SMOOTH_MM = 4.0
"""Half the length in mm over which a direction of the route is measured."""
CUT_MM = 10.0
"""Length in mm at the start of the tree whose widths are ignored, because the CT may cut the trachea there."""
FINE_MM = 0.5
MIN_AHEAD_MM = 4.0
NUM_ON_LINE = 14
SHARES_AHEAD = np.linspace(0.1, 1.0, NUM_ON_LINE)[None, :, None]
"""Positions at which a line of sight is tested for walls, as shares of its length."""
SHARES = np.linspace(0.0, 1.0, 9)[:, None]
"""Positions between the tip and the centreline that are tested for walls, as shares of their distance."""


class DriveWay:
    """Route of a drive, up to the final position of the tip.

    Distances in a drive are measured along the smooth route, which is a few millimetres shorter than the branches'
    centrelines. Distances in results are measured along the centrelines, from the origin of the planned route as in the
    list of turns; `from_origin_mm` converts them.

    Parameters
    ----------
    tree, planned
        The airways, and the planned route that ends at the position of the scope.
    wall
        The wall of the airways.
    """

    def __init__(self, tree: AirwayTree, planned: PlannedRoute, wall: WallField) -> None:
        route: Route = tree.route_to(planned.branch_id)
        self.wall = wall
        self.origin = planned.origin
        self.width = planned.width
        self.points, self.cumulative_mm = route.points_lps, route.cumulative_mm
        # The place on the centreline is used, not the tip of the leg, which may be beside the centreline.
        place = _place_at(tree, planned)
        self.park_mm = float(self.cumulative_mm[int(np.argmin(np.linalg.norm(self.points - place, axis=1)))])
        self.aim = np.array(planned.leg.aim_lps)
        self.forks_mm = np.array(route.forks_mm, dtype=np.float64)
        self._radius_mm = route.radius_mm
        self._fine_mm = np.arange(0.0, float(self.cumulative_mm[-1]) + 1e-9, FINE_MM)
        self._fine = self.at(self._fine_mm)
        self._fine_clearance_mm = wall.distance_mm(self._fine)
        # A search calls for these values at the same places of the route again and again.
        self._radii_mm: dict[float, float] = {}
        self._points: dict[float, Points] = {}
        self._directions: dict[float, Points] = {}
        # Knots that map the smooth route to the centrelines: the forks and the position of the tip.
        ends = np.cumsum([branch.length_mm for branch in tree.lineage(planned.branch_id)])
        knots = [(0.0, 0.0), *zip(self.forks_mm.tolist(), ends[:-1].tolist(), strict=True)]
        whole = (self.length_mm, float(ends[-1]))
        if knots[-1][0] < self.park_mm < whole[0] and knots[-1][1] < planned.along_mm < whole[1]:
            knots.append((self.park_mm, planned.along_mm))
        self._knots = np.array([*knots, whole])
        # Largest ball at each point of the centrelines. The CT may cut the upper end of the trachea, which is left out.
        lineage = tree.lineage(planned.branch_id)
        points = np.concatenate([branch.points for branch in lineage])
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        ball_mm = np.concatenate([ball_diameters_mm(branch, wall) for branch in lineage])
        on_the_way = (at >= CUT_MM) & (at <= planned.along_mm + 1e-6)
        self.ball_at_mm, self.ball_diameter_mm = at[on_the_way], ball_mm[on_the_way]

    @property
    def passable_diameter_mm(self) -> float:
        """Diameter in mm of the largest ball that passes to the end of the route inside the wall mesh.

        The diameter may differ from `width`, which is measured in the CT; the wall is a mesh of the segmented lumen.
        """
        on_the_way = (self._fine_mm >= CUT_MM) & (self._fine_mm <= self.park_mm)
        return 2.0 * float(self._fine_clearance_mm[on_the_way].min()) if on_the_way.any() else math.inf

    @property
    def length_mm(self) -> float:
        """Length in mm of the whole route, which may extend beyond the position of the scope."""
        return float(self.cumulative_mm[-1])

    def from_origin_mm(self, mm: float) -> float:
        """Convert a distance along the smooth route to one along the centrelines from the route's origin, mm."""
        return self.origin.past_mm(float(np.interp(mm, self._knots[:, 0], self._knots[:, 1])))

    def position_words(self, mm: float) -> str:
        """Return a place of the smooth route as text, such as *42 mm past the main carina*."""
        return self.origin.words(self.from_origin_mm(mm))

    def at(self, mm: float | Points) -> Points:
        """Return the points (..., 3), LPS mm, at distances in mm along the route."""
        return np.stack([np.interp(mm, self.cumulative_mm, self.points[:, axis]) for axis in range(3)], axis=-1)

    def direction(self, mm: float) -> Points:
        """Return the unit vector (3,) along the route at a distance in mm."""
        found = self._directions.get(mm)
        if found is None:
            low, high = max(mm - SMOOTH_MM, 0.0), min(mm + SMOOTH_MM, self.length_mm)
            ahead = self.at(high) - self.at(low)
            found = self._directions[mm] = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        return found

    def point(self, mm: float) -> Points:
        """Return the point (3,), LPS mm, at a distance in mm along the route; do not change it."""
        found = self._points.get(mm)
        if found is None:
            found = self._points[mm] = self.at(mm)
        return found

    def radius_mm(self, mm: float) -> float:
        """Return the largest distance in mm of a tip in the lumen from the centreline, at a place of the route.

        The distance is the radius of the circle with the lumen's area, or of the largest ball if that is larger.
        """
        found = self._radii_mm.get(mm)
        if found is None:
            area = float(np.interp(mm, self.cumulative_mm, self._radius_mm))
            found = self._radii_mm[mm] = max(area, float(np.interp(mm, self._fine_mm, self._fine_clearance_mm)))
        return found

    def nearest(self, point: Points, around_mm: float) -> tuple[float, float]:
        """Return the point of the route nearest to a tip: distance along the route and distance from the tip, mm.

        Parameters
        ----------
        point
            (3,) position of the tip.
        around_mm
            Previous distance of the tip along the route; the search covers -6 to +8 mm round it.
        """
        low, high = np.searchsorted(self._fine_mm, [around_mm - 6.0, around_mm + 8.0])
        off = np.linalg.norm(self._fine[low:high] - point, axis=1)
        n = int(np.argmin(off))
        return float(self._fine_mm[low + n]), float(off[n])

    def visible(self, tip: Points, along_mm: float, farthest_mm: float, clear_mm: float) -> Points:
        """Return the farthest point of the route that a straight line from the tip reaches without touching the wall.

        If no point is visible, the nearest one is returned.

        Parameters
        ----------
        tip
            (3,) position of the tip.
        along_mm
            Distance of the tip along the route.
        farthest_mm
            Largest distance ahead.
        clear_mm
            Clearance to the wall; less is required in a narrow airway.
        """
        ahead = np.arange(along_mm + farthest_mm, along_mm + MIN_AHEAD_MM - 0.1, -1.0)
        places = self.at(np.minimum(ahead, self.length_mm))
        line = tip + SHARES_AHEAD * (places - tip)[:, None, :]
        clearance_mm = self.wall.core.distance_mm(line.reshape(-1, 3)).reshape(len(places), -1)
        # In a narrow airway a smaller clearance suffices.
        needed = np.minimum(clear_mm, 0.6 * np.maximum(clearance_mm[:, -1], 0.3))
        seen = np.flatnonzero((clearance_mm >= needed[:, None]).all(axis=1))
        found: Points = places[int(seen[0])] if seen.size else places[-1]
        return found

    def holds(self, tip: Points, along_mm: float) -> bool:
        """Return whether a tip is in the lumen of the route, not behind a wall in a neighbouring lumen.

        Parameters
        ----------
        tip
            (3,) position of the tip, LPS mm.
        along_mm
            Distance of the tip along the route.
        """
        line = tip + SHARES * (self.point(along_mm) - tip)
        return bool((self.wall.core.distance_mm(line) > 0.0).all())


def _place_at(tree: AirwayTree, planned: PlannedRoute) -> Points:
    """Return the point of the centrelines that belongs to the final position of the scope."""
    points = np.concatenate([branch.points for branch in tree.lineage(planned.branch_id)])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.array([np.interp(planned.along_mm, along, points[:, axis]) for axis in range(3)])
