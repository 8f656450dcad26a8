"""Centreline points at which a scope's tip may be positioned, and their distances and directions to one target."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.instruments.tools import Tool
from carina.plan.movement.target_movement import TargetMovement, default_movement
from carina.plan.routes.main_carina import ROOT, DistanceOrigin, origins_of_branches
from carina.plan.routes.ranking import PathRequirements, WorstValue
from carina.plan.routes.route_width import widths_on_the_way
from carina.plan.targets.grow_nodule import Nodule
from carina.scopes import WallField
from carina.track import AirwayTree, Branch, TreeMeasures, branch_side_and_lobe

Points = NDArray[np.float64]
BronchusSign = Literal["into", "beside", "none"]

POSITION_STEP_MM = 0.7
"""Distance in mm between two scope positions on one branch that are evaluated in the first pass."""
ON_BRANCH_MM = 0.001
FINE_STEP_MM = 0.175
"""Distance in mm between the additional scope positions that a second pass evaluates round the best ones."""
LOWER_LOBES = {"RUL": "RLL", "RML": "RLL", "LUL": "LLL", "LML": "LLL"}
"""Lower lobe of the same lung for each other lobe; a mirrored chest has LML."""
EITHER_LOBE_MM = 5.0
"""Distance in mm by which a lower lobe's airways may be farther off if the target may be in either of two lobes."""
INTO_MM, BESIDE_MM = 0.8, 2.0
"""Maximum distances in mm between lumen and nodule for an airway that leads into the nodule, and for one beside it."""
DOUBTFUL = 0.5
"""Confidence below which a branch counts as doubtful."""
SMOOTH_MM = 4.0
"""Half the length in mm over which a direction of the route is measured."""
BEND_STEP_MM = 1.0

_COLUMNS = ("points", "forward", "branch", "along_mm", "width", "radius")


@one_line
@dataclass(frozen=True, slots=True)
class NearestPlace:
    """Place in the airways nearest to a target."""

    branch_id: int
    branch_name: str
    place_lps: tuple[float, float, float]
    along_mm: float
    """Distance of the scope position from the root along the airways, mm."""
    width_mm: float
    """Diameter in mm of the largest ball that fits in the airway at the scope position."""
    gap_mm: float
    """Distance in mm from the middle of the airway at the scope position to the edge of the target."""
    from_carina_mm: float | None = None
    """Distance in mm of the scope position from the main carina; None if the route to it passes no main carina."""

    def to_json(self) -> dict[str, Any]:
        """Return the scope position as plain JSON types."""
        return {
            "branch_id": self.branch_id,
            "branch_name": self.branch_name,
            "place_lps": list(self.place_lps),
            "along_mm": self.along_mm,
            "from_carina_mm": self.from_carina_mm,
            "width_mm": self.width_mm,
            "gap_mm": self.gap_mm,
        }


class CentrelinePoints:
    """Centreline points of a tree, with the width, bends and doubts of the path from the root to each point.

    Parameters
    ----------
    tree, wall
        The airways and their wall.
    measures
        Measures of this tree. If None, the diameter is that of the largest ball everywhere.
    spacing_mm
        Largest spacing of the CT.
    origin
        Origin of the distances along the airways (`carina.plan.distance_origin`).
    """

    def __init__(
        self,
        tree: AirwayTree,
        wall: WallField | None = None,
        *,
        measures: TreeMeasures | None = None,
        spacing_mm: float = 1.0,
        origin: DistanceOrigin = ROOT,
    ) -> None:
        self._tree = tree
        branches = [branch for branch in tree.branches if len(branch.points) > 1]
        self._row = {branch.id: branch for branch in tree.branches}
        along = _along(tree)
        self._origins = origins_of_branches(tree, origin)
        widths: dict[int, Any] = {}
        for one in dict.fromkeys(self._origins.values()):
            whole = widths_on_the_way(tree, wall, measures, spacing_mm, one)
            widths |= {branch: whole[branch] for branch, branch_origin in self._origins.items() if branch_origin == one}
        self._bends: dict[int, tuple[Points, Points, Points]] = {}
        self._doubts: dict[int, tuple[str, ...]] = {}

        def joined(rows: list[Any], *shape: int) -> Any:
            return np.concatenate(rows) if rows else np.empty((0, *shape))

        self.points: Points = joined([b.points for b in branches], 3)
        self.forward: Points = joined([_tangents(b.points) for b in branches], 3)
        self.branch: NDArray[Any] = joined([np.full(len(b.points), b.id) for b in branches])
        self.along_mm: Points = joined([along[b.id] for b in branches])
        """(n,) distance of each point from the root along the airways, mm."""
        self.width: NDArray[np.object_] = joined([widths[b.id] for b in branches])
        """(n,) `RouteWidth` of the path from the root to each point."""
        self.radius: Points = joined([b.wall_distance for b in branches])

    def of_branch(self, n: int) -> Branch:
        """Return the branch that contains point ``n``."""
        return self._row[int(self.branch[n])]

    def origin_of(self, branch_id: int) -> DistanceOrigin:
        """Return the origin of the distances along the path to a branch."""
        return self._origins[branch_id]

    def requirements_at(self, n: int, section_mm: float | None) -> PathRequirements:
        """Return the width and the bend that a scope needs for the path to point ``n``, and the doubts about this path.

        Parameters
        ----------
        n
            Index of the point.
        section_mm
            Length of the scope's tip and bending section; None ignores bends.
        """
        branch = self.of_branch(n)
        if branch.id not in self._doubts:
            self._doubts[branch.id] = self._doubts_of(branch)
        origin = self.origin_of(branch.id)
        bend = WorstValue(0.0, origin.past_mm(0.0))
        if section_mm is not None:
            if branch.id not in self._bends:
                self._bends[branch.id] = _bends(self._tree.lineage(branch.id), section_mm)
            at, worst, where = self._bends[branch.id]
            row = int(np.searchsorted(at, float(self.along_mm[n]) + 1e-6, side="right")) - 1
            if row >= 0:
                bend = WorstValue(float(worst[row]), origin.past_mm(float(where[row])))
        return PathRequirements(self.width[n], bend, self._doubts[branch.id], self._trust(branch))

    def _trust(self, branch: Branch) -> float:
        lineage = self._tree.lineage(branch.id)
        found = [one.confidence for one in lineage if one.confidence is not None and one.confidence < DOUBTFUL]
        return min([1.0, *found, *(DOUBTFUL for one in lineage if one.kind in {"bridge", "manual"})])

    def _doubts_of(self, branch: Branch) -> tuple[str, ...]:
        return tuple(words for one in self._tree.lineage(branch.id) for words in branch_doubts(one))


class ScopePositions(CentrelinePoints):
    """Centreline points of a tree, with their distance and direction to one nodule."""

    def __init__(
        self,
        tree: AirwayTree,
        nodule: Nodule,
        wall: WallField | None = None,
        *,
        measures: TreeMeasures | None = None,
        spacing_mm: float = 1.0,
        origin: DistanceOrigin = ROOT,
    ) -> None:
        super().__init__(tree, wall, measures=measures, spacing_mm=spacing_mm, origin=origin)
        self.nodule = nodule
        self.distance: Points = np.linalg.norm(self.points - np.array(nodule.centre_lps), axis=1)

    def angle_deg(self, aim_lps: Points) -> Points:
        """Return the angle in degrees between the airway and the direction to an aim, at each scope position."""
        off = aim_lps - self.points
        cosine = (off * self.forward).sum(axis=1) / np.maximum(np.linalg.norm(off, axis=1), 1e-9)
        found: Points = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return found

    def within_reach(
        self, tool: Tool, aim_lps: Points, most_angle_deg: float, *, apart_mm: float = POSITION_STEP_MM
    ) -> NDArray[np.intp]:
        """Return the places from which the tool may reach the nodule forwards.

        Parameters
        ----------
        tool
            Tool with its reach.
        aim_lps
            (3,) LPS mm.
        most_angle_deg
            Largest angle between the airway and the direction to the aim.
        apart_mm
            Least distance of two places on one branch.
        """
        near = self.distance <= tool.reach_mm + self.nodule.long_mm
        edge = np.full(len(self.distance), np.inf)
        if near.any():
            edge[near] = self.nodule.distance_mm(self.points[near])
        # If the airway passes through the nodule, the nodule is reached even if the aim is behind the tip.
        may = (edge <= tool.reach_mm) & ((self.angle_deg(aim_lps) <= most_angle_deg) | (edge <= 0.0))
        chosen: list[int] = []
        for n in np.flatnonzero(may):
            last = chosen[-1] if chosen else None
            if (
                last is None
                or self.branch[last] != self.branch[n]
                or self.along_mm[n] - self.along_mm[last] >= apart_mm
            ):
                chosen.append(int(n))
        return np.array(chosen, dtype=np.intp)

    def beside(self, spots: Iterable[tuple[int, float]]) -> ScopePositions:
        """Return a copy that contains only scope positions `FINE_STEP_MM` apart, round given ones.

        Parameters
        ----------
        spots
            Id of the branch and distance from the root in mm, of each given place.
        """
        steps = FINE_STEP_MM * np.arange(1, round(POSITION_STEP_MM / FINE_STEP_MM) + 1)
        at: dict[int, list[Points]] = {}
        for branch, middle in spots:
            at.setdefault(branch, []).append(middle + np.concatenate([-steps, steps]))
        return self._interpolated(at)

    def at(self, branch_id: int, along_mm: float) -> ScopePositions:
        """Return a copy with one place, or with none if there is no such place in the tree.

        Parameters
        ----------
        branch_id, along_mm
            Branch, and distance from the root in mm.
        """
        along = self.along_mm[self.branch == branch_id]
        known = len(along) > 0 and along[0] - ON_BRANCH_MM <= along_mm <= along[-1] + ON_BRANCH_MM
        return self._interpolated({branch_id: [np.array([along_mm])]} if known else {})

    def _interpolated(self, at: dict[int, list[Points]]) -> ScopePositions:
        """Return a copy with places at distances from the root in mm, by branch.

        The width at an interpolated place is the narrower one of its two neighbours.
        """
        finer = copy.copy(self)
        of: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
        for branch, wanted in at.items():
            rows = np.flatnonzero(self.branch == branch)
            along = self.along_mm[rows]
            mm = np.unique(np.clip(np.concatenate(wanted), along[0], along[-1]))
            high = np.clip(np.searchsorted(along, mm), 1, len(rows) - 1)
            share = ((mm - along[high - 1]) / np.maximum(along[high] - along[high - 1], 1e-9))[:, None]
            before, after = rows[high - 1], rows[high]
            forward = (1.0 - share) * self.forward[before] + share * self.forward[after]
            of["points"].append((1.0 - share) * self.points[before] + share * self.points[after])
            of["forward"].append(forward / np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9))
            of["branch"].append(self.branch[after])
            of["along_mm"].append(mm)
            widths = np.empty(len(mm), dtype=object)
            widths[:] = [
                replace(width, at_mm=min(width.at_mm, width.origin.past_mm(float(here))))
                for width, here in zip(self.width[after], mm, strict=True)
            ]
            of["width"].append(widths)
            of["radius"].append(np.minimum(self.radius[before], self.radius[after]))
        for name, parts in of.items():
            setattr(finer, name, np.concatenate(parts) if parts else getattr(self, name)[:0])
        finer.distance = np.linalg.norm(finer.points - np.array(self.nodule.centre_lps), axis=1)
        return finer

    def bronchus_sign(self) -> tuple[BronchusSign, str | None, tuple[float, float, float] | None]:
        """Return the bronchus sign, and the name and the nearest point of the airway that shows it.

        The sign is that an airway leads into the nodule, or is beside it.
        """
        near = np.flatnonzero(self.distance <= self.nodule.long_mm + 6.0)
        if not near.size:
            return "none", None, None
        gap = self.nodule.distance_mm(self.points[near])
        angle = self.angle_deg(np.array(self.nodule.centre_lps))[near]
        # The direction distinguishes an airway that leads into the nodule from one that passes it.
        into = (gap - self.radius[near] <= INTO_MM) & ((angle <= 60.0) | (gap <= 0.0))
        beside = gap - self.radius[near] <= BESIDE_MM
        for sign, which in (("into", into), ("beside", beside)):
            if which.any():
                n = int(near[which][np.argmin(gap[which])])
                return sign, branch_title(self.of_branch(n)), _point(self.points[n])  # type: ignore[return-value]
        return "none", None, None

    def default_movement(self) -> TargetMovement:
        """Return the movement that is assumed without a measurement, by the lobe of the nearest airway.

        A target near a fissure may move with either lobe, so that the larger movement applies.
        """
        branch, _, _ = self._tree.nearest_branch(self.nodule.centre_lps)
        lobes = branch_side_and_lobe(self._tree)
        nearest_lobe = lobes[branch.id]
        lower = LOWER_LOBES.get(nearest_lobe or "")
        gap_mm: dict[str, float] = {}
        for one in self._tree.branches if lower is not None else ():
            lobe = lobes[one.id]
            if lobe in {nearest_lobe, lower} and lobe is not None and len(one.points):
                gap_mm[lobe] = min(gap_mm.get(lobe, math.inf), float(self.nodule.distance_mm(one.points).min()))
        if (
            lower is None
            or nearest_lobe is None
            or gap_mm.get(lower, math.inf) > gap_mm.get(nearest_lobe, 0.0) + EITHER_LOBE_MM
        ):
            return default_movement(nearest_lobe)
        note = (
            f"airways of {nearest_lobe} and {lower} are about equally near to the target, which may be in either lobe "
            f"or across the fissure; the larger movement, that of {lower}, is used"
        )
        return replace(default_movement(lower), notes=(note,))

    def nearest(self) -> NearestPlace | None:
        """Return the scope position nearest to the nodule's edge; None for a tree without branches."""
        if not len(self.points):
            return None
        # The place nearest to the edge is at most one nodule length farther from the centre than the nearest place.
        near = np.flatnonzero(self.distance <= float(self.distance.min()) + self.nodule.long_mm)
        gap = self.nodule.distance_mm(self.points[near])
        n = int(near[np.argmin(gap)])
        branch = self.of_branch(n)
        return NearestPlace(
            branch_id=branch.id,
            branch_name=branch_title(branch),
            place_lps=_point(self.points[n]),
            along_mm=float(self.along_mm[n]),
            width_mm=2.0 * float(self.radius[n]),
            gap_mm=float(gap.min()),
            from_carina_mm=self.origin_of(branch.id).from_carina_mm(float(self.along_mm[n])),
        )


def branch_doubts(branch: Branch) -> tuple[str, ...]:
    """Return the warnings about a doubtful branch that every view of a route through the branch shows."""
    if branch.kind == "bridge":
        return (f"{branch_title(branch)} is a bridge across an obstruction: the CT shows no airway there",)
    if branch.kind == "manual":
        return (f"{branch_title(branch)} was drawn by hand",)
    if branch.confidence is not None and branch.confidence < DOUBTFUL:
        sure = f"{100 * branch.confidence:.0f} % confidence that it is an airway"
        return (f"{branch_title(branch)} is doubtful: {sure}",)
    return ()


def branch_title(branch: Branch) -> str:
    """Return the name of a branch, such as ``RB6``, or ``branch 17`` if it has none."""
    return branch.name or f"branch {branch.id}"


def _along(tree: AirwayTree) -> dict[int, Points]:
    """Return for each branch the distance of its points from the root along the airways, mm."""
    along: dict[int, Points] = {}
    # Parents precede their children in the tree.
    for branch in tree.branches:
        branch_mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
        along[branch.id] = branch_mm if branch.parent is None else branch_mm + along[branch.parent][-1]
    return along


def _bends(lineage: tuple[Branch, ...] | list[Branch], section_mm: float) -> tuple[Points, Points, Points]:
    """Return the sharpest turn up to each point of a path: distances, turns in degrees, and distances of these turns.

    Returns
    -------
    at, worst, where
        Distances along the path in mm, 1 mm apart; sharpest turn over ``section_mm`` up to there in degrees; distance
        at which it occurs.
    """
    points = np.concatenate([lineage[0].points, *(branch.points[1:] for branch in lineage[1:])])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.arange(section_mm, along[-1] + 1e-6, BEND_STEP_MM)

    def directions(mm: Points) -> Points:
        low, high = np.maximum(mm - SMOOTH_MM, 0.0), np.minimum(mm + SMOOTH_MM, along[-1])
        ahead = np.stack(
            [np.interp(high, along, points[:, axis]) - np.interp(low, along, points[:, axis]) for axis in range(3)],
            axis=1,
        )
        found: Points = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        return found

    cosine = (directions(at) * directions(at - section_mm)).sum(axis=1)
    turn = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    worst = np.maximum.accumulate(turn)
    where = np.maximum.accumulate(np.where(turn >= worst, at, 0.0))
    return at, worst, where


def _tangents(points: Points) -> Points:
    ahead = np.gradient(points, axis=0)
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    found: Points = ahead / np.maximum(length, 1e-9)
    return found


def _point(values: Points) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
