"""A route as the drive of a scope sees it: places along it, its forks, and how far ahead it can be seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carina.plan.room import rooms_mm
from carina.plan.routes import PlannedRoute
from carina.scopes import WallField
from carina.track import AirwayTree, Route

__all__ = ["DriveWay"]

Points = NDArray[np.float64]

SMOOTH_MM = 4.0
"""Half the way over which a direction of the route is taken."""
CUT_MM = 10.0
"""So far from where the tree begins widths are not looked at."""
FINE_MM = 0.5
LEAST_AHEAD_MM = 4.0
NUM_ON_LINE = 14


class DriveWay:
    """A route as far as the tip goes.

    A drive counts along the smooth route, which is a few millimetres shorter than the branches' centrelines. What is
    told counts along the centrelines, as `PlannedRoute.along_mm` and the list of turns do: `told_mm`.

    Parameters
    ----------
    tree, planned
        The airways, and where in them the scope stands at the end.
    wall
        The airways' wall.
    """

    def __init__(self, tree: AirwayTree, planned: PlannedRoute, wall: WallField) -> None:
        route: Route = tree.route_to(planned.branch_id)
        tip = np.array(planned.leg.tip_lps)
        self.wall = wall
        self.width = planned.width
        self.points, self.cumulative_mm = route.points_lps, route.cumulative_mm
        self.park_mm = float(self.cumulative_mm[int(np.argmin(np.linalg.norm(self.points - tip, axis=1)))])
        self.aim = np.array(planned.leg.aim_lps)
        self.forks_mm = np.array(route.forks_mm, dtype=np.float64)
        self._radius_mm = route.radius_mm
        self._fine_mm = np.arange(0.0, float(self.cumulative_mm[-1]) + 1e-9, FINE_MM)
        self._fine = self.at(self._fine_mm)
        self._fine_room_mm = wall.distance_mm(self._fine)
        # Both measures, at the forks and where the tip stands.
        ends = np.cumsum([branch.length_mm for branch in tree.lineage(planned.branch_id)])
        knots = [(0.0, 0.0), *zip(self.forks_mm.tolist(), ends[:-1].tolist(), strict=True)]
        whole = (self.length_mm, float(ends[-1]))
        if knots[-1][0] < self.park_mm < whole[0] and knots[-1][1] < planned.along_mm < whole[1]:
            knots.append((self.park_mm, planned.along_mm))
        self._knots = np.array([*knots, whole])
        # The ball that fits at each point of the centrelines; at the trachea's upper end the CT may cut it.
        lineage = tree.lineage(planned.branch_id)
        points = np.concatenate([branch.points for branch in lineage])
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        room = np.concatenate([rooms_mm(branch, wall) for branch in lineage])
        on_the_way = (at >= CUT_MM) & (at <= planned.along_mm + 1e-6)
        self.room_at_mm, self.room_mm = at[on_the_way], room[on_the_way]

    @property
    def wall_room_mm(self) -> float:
        """Diameter of the largest ball that passes to where the scope stands, in the wall that a drive is held in.

        It may differ from `width`, which was measured in the CT: the wall is a mesh of the lumen found.
        """
        on_the_way = (self._fine_mm >= CUT_MM) & (self._fine_mm <= self.park_mm)
        return 2.0 * float(self._fine_room_mm[on_the_way].min()) if on_the_way.any() else math.inf

    @property
    def length_mm(self) -> float:
        """Of the whole way, which may lead beyond where the scope stands."""
        return float(self.cumulative_mm[-1])

    def told_mm(self, mm: float) -> float:
        """A place along the smooth route, in the measure that is told: from the root along the centrelines."""
        return float(np.interp(mm, self._knots[:, 0], self._knots[:, 1]))

    def at(self, mm: float | Points) -> Points:
        """Places along the route, (..., 3)."""
        return np.stack([np.interp(mm, self.cumulative_mm, self.points[:, axis]) for axis in range(3)], axis=-1)

    def direction(self, mm: float) -> Points:
        """Unit vector along it."""
        low, high = max(mm - SMOOTH_MM, 0.0), min(mm + SMOOTH_MM, self.length_mm)
        ahead = self.at(high) - self.at(low)
        found: Points = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        return found

    def radius_mm(self, mm: float) -> float:
        """How far a tip may be from the centreline: the circle with the lumen's area, or the ball that fits."""
        area = float(np.interp(mm, self.cumulative_mm, self._radius_mm))
        return max(area, float(np.interp(mm, self._fine_mm, self._fine_room_mm)))

    def nearest(self, point: Points, around_mm: float) -> tuple[float, float]:
        """The place nearest to a tip that was at ``around_mm`` before: mm along the route, and the distance."""
        low, high = np.searchsorted(self._fine_mm, [around_mm - 6.0, around_mm + 8.0])
        off = np.linalg.norm(self._fine[low:high] - point, axis=1)
        n = int(np.argmin(off))
        return float(self._fine_mm[low + n]), float(off[n])

    def visible(self, tip: Points, along_mm: float, farthest_mm: float, clear_mm: float) -> Points:
        """The farthest place of the route that a straight line from the tip gets to with ``clear_mm`` to the wall.

        Where not even the next is seen, the next.
        """
        ahead = np.arange(along_mm + farthest_mm, along_mm + LEAST_AHEAD_MM - 0.1, -1.0)
        places = self.at(np.minimum(ahead, self.length_mm))
        share = np.linspace(0.1, 1.0, NUM_ON_LINE)
        line = tip + share[None, :, None] * (places - tip)[:, None, :]
        room = self.wall.distance_mm(line.reshape(-1, 3)).reshape(len(places), -1)
        # In a narrow airway less is left than is asked for.
        needed = np.minimum(clear_mm, 0.6 * np.maximum(room[:, -1], 0.3))
        seen = np.flatnonzero((room >= needed[:, None]).all(axis=1))
        found: Points = places[int(seen[0])] if seen.size else places[-1]
        return found

    def holds(self, tip: Points, along_mm: float) -> bool:
        """Whether a tip lies in the route's own lumen there, and not beyond a wall in the next one."""
        share = np.linspace(0.0, 1.0, 9)
        line = tip + share[:, None] * (self.at(along_mm) - tip)
        return bool((self.wall.distance_mm(line) > 0.0).all())
