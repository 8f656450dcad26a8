"""Directions that a scope's tip can take at a point of the airways, from the sizes of the scope and the wall.

The distal part of a scope is a rigid cylinder with a bending section behind it. A direction is attainable if the rigid
tip, in this direction, is inside the lumen, and if an arc that is no sharper than the bending section's sharpest bend
leads from the tip's rear end into the direction of the airway without leaving the lumen. The tip may touch the wall.
This analysis selects the positions to which the scope is driven; the simulated drive of `carina.plan.verdict` decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.routes.needle_hits import axes_across
from carina.scopes import ScopePreset, WallField
from carina.track import AirwayTree

Points = NDArray[np.float64]

SMOOTH_MM = 4.0
"""Half the length in mm over which a direction of the airway is measured."""
CUT_MM = 10.0
"""Length in mm at the start of the tree whose widths are ignored, because the CT may cut the trachea there."""
PATH_STEP_MM, WIDEST_MM = 0.5, 12.0
"""Step and largest distance from the centreline, both in mm, of the search for the wall beside the scope's tip."""
MIN_SIDE_MM, NEAR_MM = 0.1, 0.5
"""Minimum distances in mm of an aim from the airway's axis and from the tip; nearer aims have the axis's direction."""
RIGID_STEP_MM = 1.0
ROUNDED_MM = 0.3
"""Radius in mm of the rounded edge of the tip's face."""
TIP_LACK_MM, SHAFT_LACK_MM = 0.05, 0.2
"""Depths in mm by which the rigid tip and the bending section may enter the wall, as in the simulated drive."""
RADII = (1.0, 1.6, 3.0, 8.0)
"""Radii of the bending section's arcs that are tested, as multiples of its smallest radius."""
NUM_ON_ARC, BEHIND_MM = 8, 4.0
OFFSETS = (0.0, 0.5, 1.0)
"""Tested positions of the tip between the centreline and the wall on the side of the target."""
NUM_SIDES = 6
"""Number of sides of the centreline towards which the tip is moved if there is no aim."""
RINGS = (1, 6, 12, 18)
"""Number of tested directions on each ring round the direction to the aim; the last ring touches the target's edge."""
MAX_RING_DEG = 60.0
SPARE_MM, SLIMMER_MM, THINNEST_MM = 0.2, 0.8, 0.6
"""Limits in mm for the thinner substitute of a scope: least play, reduction of the diameter, least diameter.

The substitute represents a scope about as wide as the airway, because the width is a separate criterion of a route
(`carina.plan.routes.ranking`). Its directions select and order positions, and give the outlook of a draft without
drives; a driven route is judged by the scope's own width.
"""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class AttainableTip:
    """Position and direction that a scope's tip can take in the lumen."""

    tip_lps: Points
    forward: Points
    """(3,) unit vector in the direction of the needle."""
    off_deg: float
    """Angle in degrees between ``forward`` and the direction to the aim."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class StandingPlace:
    """Point on the centreline of a branch at which a scope's tip may be positioned."""

    branch_id: int
    along_mm: float
    """Distance of the tip's position from the root along the airways, mm."""
    point_lps: Points
    forward: Points
    """(3,) unit vector of the airway's direction at the tip's position."""


class TipDirections:
    """Directions that the tip of one scope can take in one tree of airways.

    Parameters
    ----------
    tree, wall
        The airways and their wall.
    scope
        The instrument.
    """

    def __init__(self, tree: AirwayTree, wall: WallField, scope: ScopePreset) -> None:
        self._tree, self._wall = tree, wall
        self._tip_mm = scope.tip_mm
        self._rigid_mm = scope.rigid_tip_mm or 0.0
        self._sharpest_mm = self._bending_mm = 0.0
        self.is_known = scope.flexion_deg is not None and scope.bending_mm is not None
        """Whether the scope's flexion and bending section are known; otherwise its attainable directions are not."""
        if scope.flexion_deg is not None and scope.bending_mm is not None:
            self._bending_mm = float(np.mean(scope.bending_mm))
            self._sharpest_mm = self._bending_mm / math.radians(max(*scope.flexion_deg, 1.0))
        self._paths: dict[int, tuple[Points, Points, Points]] = {}

    def towards(self, place: StandingPlace, aim: Points, radius_mm: float) -> AttainableTip | None:
        """Return the attainable tip that points nearest to an aim; None if none points at the target.

        Parameters
        ----------
        place
            Place of the tip.
        aim
            (3,) LPS mm, the point in the target.
        radius_mm
            Radius of the target; directions that pass the aim at a larger distance are not tested.
        """
        radius = 0.5 * self._slim_mm(place.branch_id, place.along_mm)
        found = [self._nearest(place, tip, aim, radius_mm, radius) for tip in self._tips(place, aim, radius)]
        return min((one for one in found if one is not None), key=lambda one: one.off_deg, default=None)

    def around(self, place: StandingPlace, ways: Points) -> Iterator[tuple[Points, NDArray[np.bool_]]]:
        """Yield positions of the tip near a centreline point, each with the directions that the tip can take there.

        Parameters
        ----------
        place
            Place of the tip.
        ways
            (n, 3) unit vectors, the tested directions.

        Yields
        ------
        tuple
            (3,) position of the tip on the centreline or against the wall, LPS mm, and (n,) whether each direction is
            attainable from there.
        """
        radius = 0.5 * self._slim_mm(place.branch_id, place.along_mm)
        across, up = axes_across(place.forward)
        yield place.point_lps, self._attained(place, place.point_lps, ways, radius)
        for turn in 2.0 * np.pi * np.arange(NUM_SIDES) / NUM_SIDES:
            aside = place.point_lps + math.cos(turn) * across + math.sin(turn) * up
            *_, tip = self._tips(place, aside, radius)
            if tip is not place.point_lps:
                yield tip, self._attained(place, tip, ways, radius)

    def _attained(self, place: StandingPlace, tip: Points, ways: Points, radius: float) -> NDArray[np.bool_]:
        found = self._rigid_fits(tip, ways, radius)
        found[found] = self._bends(place, tip, ways[found], radius)
        return found

    def _nearest(
        self, place: StandingPlace, tip: Points, aim: Points, radius_mm: float, radius: float
    ) -> AttainableTip | None:
        off = aim - tip
        distance = float(np.linalg.norm(off))
        towards = off / distance if distance > NEAR_MM else place.forward
        edge = math.radians(MAX_RING_DEG)
        if distance > radius_mm:
            edge = min(edge, math.asin(min(radius_mm / distance, 1.0)))
        ways, angles = _rings(towards, edge)
        fit = np.flatnonzero(self._rigid_fits(tip, ways, radius))
        # The direction nearest to the aim is tested alone first, because it is attainable in most places.
        for part in (fit[:1], fit[1:]):
            bent = part[self._bends(place, tip, ways[part], radius)]
            if bent.size:
                return AttainableTip(tip, ways[bent[0]], math.degrees(float(angles[bent[0]])))
        return None

    def _tips(self, place: StandingPlace, aim: Points, radius: float) -> list[Points]:
        """Return positions of the tip from the centreline to the wall, on the side of the aim."""
        side = aim - place.point_lps
        side = side - (side @ place.forward) * place.forward
        length = float(np.linalg.norm(side))
        if length < MIN_SIDE_MM:
            return [place.point_lps]
        at = np.arange(0.0, WIDEST_MM, PATH_STEP_MM)
        clearance_mm = self._wall.distance_mm(place.point_lps + at[:, None] * side / length) - radius
        out = np.flatnonzero(clearance_mm < 0.0)
        spare = float(at[max(int(out[0]) - 1, 0)]) if out.size else WIDEST_MM
        if spare < PATH_STEP_MM:
            return [place.point_lps]
        return [place.point_lps + share * spare * side / length for share in OFFSETS]

    def _rigid_fits(self, tip: Points, ways: Points, radius: float) -> NDArray[np.bool_]:
        behind = np.arange(min(radius, self._rigid_mm), self._rigid_mm + 1e-6, RIGID_STEP_MM)
        axis = tip - behind[None, :, None] * ways[:, None, :]
        clearance_mm = self._wall.distance_mm(axis.reshape(-1, 3)).reshape(len(ways), -1).min(axis=1)
        across, up = axes_across(ways)
        turn = 2.0 * np.pi * np.arange(8) / 8
        rim = np.cos(turn)[None, :, None] * across[:, None, :] + np.sin(turn)[None, :, None] * up[:, None, :]
        face = tip - ROUNDED_MM * ways[:, None, :] + max(radius - ROUNDED_MM, 0.0) * rim
        edge = self._wall.distance_mm(face.reshape(-1, 3)).reshape(len(ways), -1).min(axis=1)
        found: NDArray[np.bool_] = (clearance_mm >= radius - TIP_LACK_MM) & (edge >= ROUNDED_MM - TIP_LACK_MM)
        return found

    def _bends(self, place: StandingPlace, tip: Points, ways: Points, radius: float) -> NDArray[np.bool_]:
        """Return for each direction (n, 3) whether the bending section can lead from the tip into the airway's axis."""
        rear = tip - self._rigid_mm * ways
        behind_mm = place.along_mm - self._rigid_mm
        at_rear = self._direction(place.branch_id, np.full(len(ways), behind_mm))
        turn = np.linspace(0.0, 1.0, NUM_ON_ARC)[None, :, None]
        found = np.zeros(len(ways), dtype=bool)
        for times in RADII:
            left = np.flatnonzero(~found)
            arc_mm, own = times * self._sharpest_mm, ways[left]
            angle = _angles(own, at_rear[left])
            for _ in range(2):
                back = self._direction(place.branch_id, behind_mm - arc_mm * angle)
                angle = _angles(own, back)
            bent = arc_mm * angle <= self._bending_mm
            left, own, angle, back = left[bent], own[bent], angle[bent], back[bent]
            if not len(left):
                continue
            side = back - (back * own).sum(axis=1, keepdims=True) * own
            length = np.linalg.norm(side, axis=1, keepdims=True)
            side = np.where(length > 1e-6, side / np.maximum(length, 1e-6), side)
            on_arc = turn * angle[:, None, None]
            arc = rear[left][:, None] - arc_mm * (
                np.sin(on_arc) * own[:, None] + (1.0 - np.cos(on_arc)) * side[:, None]
            )
            points = np.concatenate([arc, arc[:, -1:] - BEHIND_MM * back[:, None]], axis=1)
            clearance_mm = self._wall.distance_mm(points.reshape(-1, 3)).reshape(len(left), -1).min(axis=1)
            found[left] = clearance_mm >= radius - SHAFT_LACK_MM
        return found

    def _path(self, branch_id: int) -> tuple[Points, Points, Points]:
        """Return the path from the root to a branch's end: distances, points, smallest ball diameters so far."""
        if branch_id not in self._paths:
            lineage = self._tree.lineage(branch_id)
            points = np.concatenate([lineage[0].points, *(branch.points[1:] for branch in lineage[1:])])
            along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
            diameter_mm = np.where(along >= CUT_MM, 2.0 * self._wall.distance_mm(points), np.inf)
            self._paths[branch_id] = along, points, np.minimum.accumulate(diameter_mm)
        return self._paths[branch_id]

    def _direction(self, branch_id: int, mm: Points) -> Points:
        """Return the directions (n, 3) of the path to a branch at distances (n,) from the root."""
        along, points, _ = self._path(branch_id)
        ends = np.clip(np.stack([mm - SMOOTH_MM, mm + SMOOTH_MM]), 0.0, along[-1])
        low, high = np.stack([np.interp(ends, along, points[:, axis]) for axis in range(3)], axis=-1)
        found: Points = (high - low) / np.maximum(np.linalg.norm(high - low, axis=1, keepdims=True), 1e-9)
        return found

    def _slim_mm(self, branch_id: int, along_mm: float) -> float:
        """Return the diameter in mm of the scope, or of its thinner substitute in an airway about as wide."""
        along, _, diameters_mm = self._path(branch_id)
        diameter_mm = float(diameters_mm[max(int(np.searchsorted(along, along_mm, side="right")) - 1, 0)])
        if self._tip_mm <= diameter_mm - SPARE_MM:
            return self._tip_mm
        return min(max(diameter_mm - SLIMMER_MM, THINNEST_MM), self._tip_mm)


def _rings(towards: Points, edge_rad: float) -> tuple[Points, Points]:
    """Return directions on rings round a direction, the nearest first, and their angles from it in radians."""
    across, up = axes_across(towards)
    ways, angles = [], []
    for ring, num in enumerate(RINGS):
        angle = edge_rad * ring / (len(RINGS) - 1)
        turn = 2.0 * np.pi * np.arange(num) / num
        side = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * up
        ways.append(math.cos(angle) * towards + math.sin(angle) * side)
        angles.append(np.full(num, angle))
    return np.concatenate(ways), np.concatenate(angles)


def _angles(some: Points, others: Points) -> Points:
    """Return the angles (n,) in radians between unit vectors (n, 3)."""
    found: Points = np.arccos(np.clip((some * others).sum(axis=1), -1.0, 1.0))
    return found
