"""The last leg of a route: from the tip of the scope through the wall into the target."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.needle import NeedleErrors, axes_across, hit_share
from carina.plan.nodule import Nodule
from carina.plan.surroundings import WALL_MM, Surroundings
from carina.plan.tools import Tool
from carina.scopes import WallField

__all__ = [
    "Crossed",
    "LastLeg",
    "NearVessel",
    "NeedleScene",
    "Tissue",
    "last_leg",
    "leg_as_aimed",
    "where_it_may_have_moved",
    "with_errors",
]

Points = NDArray[np.float64]
Tissue = Literal["lumen", "airway wall", "lung", "vessel", "target", "mediastinum or chest wall", "not examined"]
"""*Not examined*: beyond the CT, or too far from the target to have been looked at."""

STEP_MM = 0.25
LEAST_MM = 0.5
"""A tissue that is crossed for less than this is the edge of another."""
SPREAD = 1.645
"""In units of the errors' standard deviation: nine needles of ten go nearer to the line."""
BEYOND_MM = 10.0
"""So far beyond the target is looked at."""
OPEN_MM = 0.8
"""A target this near to a lumen's edge is reached without piercing a wall."""


@one_line
@dataclass(frozen=True, slots=True)
class Crossed:
    """A stretch of one tissue on the needle's way."""

    tissue: Tissue
    start_mm: float
    """From the scope's tip."""
    length_mm: float

    @property
    def end_mm(self) -> float:
        """From the scope's tip."""
        return self.start_mm + self.length_mm


@one_line
@dataclass(frozen=True, slots=True)
class NearVessel:
    """A vessel nearer to the needle than the margin."""

    at_mm: float
    """Along the needle from the scope's tip, where it is nearest."""
    distance_mm: float
    """0 where the needle goes through it."""
    place_lps: tuple[float, float, float]
    """On the needle's line."""


@one_line
@dataclass(frozen=True, slots=True)
class LastLeg:
    """From the tip of the scope to the target, and what is on the way."""

    tip_lps: tuple[float, float, float]
    aim_lps: tuple[float, float, float]
    entry_lps: tuple[float, float, float]
    """Where the needle meets the wall."""
    to_target_mm: float
    """From the tip to the target's edge, along the needle."""
    outside_mm: float
    """Of which outside the lumen."""
    angle_deg: float
    """Between the needle and the airway's axis at the tip."""
    crossed: tuple[Crossed, ...]
    """In order, to the end of the needle's reach or beyond the target by 10 mm, whichever is farther."""
    in_target_mm: float
    """Length in the target, as aimed."""
    least_in_target_mm: float
    """The same for the worst of needles at 1.6 standard deviations; 0 where one misses."""
    vessel_mm: float | None
    """From the needle's line, up to the target's far edge, to the nearest vessel seen; None where none is seen near."""
    vessel_lps: tuple[float, float, float] | None
    """The place on that line."""
    beyond_mm: float | None
    """From the target's far edge along the needle to pleura or mediastinum; None where there is none within 10 mm."""
    hit_share: float
    """Of the needle positions that the errors allow, where the target lies as in the CT."""
    reaches: bool
    """The tool gets to the target's edge."""
    hit_share_moved: float | None = None
    """The same share where the target may have moved and the needle is not aimed anew; None where nobody asked."""
    vessels: tuple[NearVessel, ...] = ()
    """Seen nearer than the margin, in order, from the wall to the target's far edge."""
    vessel_beyond_mm: float | None = None
    """As `beyond_mm`, to the first vessel on the needle's line."""
    mediastinum_mm: float = 0.0
    """Of mediastinum or chest wall that is crossed before the target's far edge: vessels in it are not seen."""

    @property
    def is_open(self) -> bool:
        """The target lies in the lumen or against it: no wall has to be pierced."""
        return self.outside_mm <= OPEN_MM

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "tip_lps": list(self.tip_lps),
            "aim_lps": list(self.aim_lps),
            "entry_lps": list(self.entry_lps),
            "to_target_mm": self.to_target_mm,
            "outside_mm": self.outside_mm,
            "angle_deg": self.angle_deg,
            "crossed": [{"tissue": one.tissue, "from_mm": one.start_mm, "to_mm": one.end_mm} for one in self.crossed],
            "in_target_mm": self.in_target_mm,
            "least_in_target_mm": self.least_in_target_mm,
            "vessel_mm": self.vessel_mm,
            "vessel_lps": None if self.vessel_lps is None else list(self.vessel_lps),
            "vessels": [
                {"at_mm": one.at_mm, "distance_mm": one.distance_mm, "place_lps": list(one.place_lps)}
                for one in self.vessels
            ],
            "beyond_mm": self.beyond_mm,
            "vessel_beyond_mm": self.vessel_beyond_mm,
            "mediastinum_mm": self.mediastinum_mm,
            "is_open": self.is_open,
            "hit_share": self.hit_share,
            "hit_share_moved": self.hit_share_moved,
            "reaches": self.reaches,
        }


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class NeedleScene:
    """A nodule, what lies round it, and the needle that is meant for it."""

    nodule: Nodule
    wall: WallField
    around: Surroundings
    tool: Tool
    errors: NeedleErrors
    margin_mm: float = 3.0
    """Vessels nearer to the needle than this are listed."""


def last_leg(scene: NeedleScene, tip_lps: Points, forward: Points, aim_lps: Points | None = None) -> LastLeg:
    """The straight line from a tip to an aim in a nodule, and what it meets, where the nodule has not moved.

    Parameters
    ----------
    tip_lps, forward
        (3,) where the scope's tip is, and the airway's direction there.
    aim_lps
        (3,); the nodule's centroid unless told.
    """
    return with_errors(scene, leg_as_aimed(scene, tip_lps, forward, aim_lps))


def with_errors(scene: NeedleScene, leg: LastLeg) -> LastLeg:
    """A leg with what the needle's errors do to it: its hits, and the least length in the target."""
    tip, aim = np.array(leg.tip_lps), np.array(leg.aim_lps)
    distance = float(np.linalg.norm(aim - tip))
    least = leg.in_target_mm
    if distance >= LEAST_MM:
        sigma = math.hypot(math.radians(scene.errors.angle_deg), scene.errors.tip_mm / max(distance, 1.0))
        ring = _ring((aim - tip) / distance, SPREAD * sigma)
        least = min(least, _length_in(scene.nodule, tip, ring, scene.tool.reach_mm))
    share = hit_share(scene.nodule, tip, aim, scene.tool.reach_mm, scene.errors)
    return replace(leg, least_in_target_mm=least, hit_share=share)


def leg_as_aimed(scene: NeedleScene, tip_lps: Points, forward: Points, aim_lps: Points | None = None) -> LastLeg:
    """`last_leg` of a needle that goes as it is aimed: its hits are 1."""
    nodule, wall, around, tool = scene.nodule, scene.wall, scene.around, scene.tool
    aim = np.array(nodule.centre_lps) if aim_lps is None else np.asarray(aim_lps, dtype=np.float64)
    off = aim - tip_lps
    distance = float(np.linalg.norm(off))
    # An airway may lead through the middle of the nodule: there the needle goes straight on.
    along = off / distance if distance >= LEAST_MM else forward
    at = np.arange(0.0, max(tool.reach_mm, distance + nodule.long_mm + BEYOND_MM) + 2.0, STEP_MM)
    points = tip_lps + at[:, None] * along
    in_target = nodule.contains(points)
    to_wall = wall.distance_mm(points)
    in_lumen = (to_wall > 0.0) & (np.cumsum(to_wall <= 0.0) == 0)
    tissue = np.full(len(at), "lung", dtype=object)
    tissue[around.read(around.vessel, points)] = "vessel"
    tissue[around.read(around.thick, points)] = "mediastinum or chest wall"
    examined = around.holds(points)
    tissue[~examined] = "not examined"
    tissue[(to_wall > -WALL_MM) & (to_wall <= 0.0)] = "airway wall"
    tissue[to_wall > 0.0] = "lumen"
    tissue[in_target] = "target"
    hits = np.flatnonzero(in_target)
    edge_mm = float(at[hits[0]]) if hits.size else distance
    far = int(hits[-1]) if hits.size else int(np.searchsorted(at, distance))
    end = max(far + int(BEYOND_MM / STEP_MM), int(tool.reach_mm / STEP_MM))
    crossed = _stretches(tissue[: min(end, len(at))])
    entry = int(np.flatnonzero(~in_lumen)[0]) if (~in_lumen).any() else 0
    between = slice(entry, far + 1)
    to_vessel = np.where(examined[between], around.read(around.vessel_mm, points[between]), np.inf)
    nearest = int(np.argmin(to_vessel)) if to_vessel.size else 0
    has_vessel = bool(to_vessel.size) and math.isfinite(float(to_vessel[nearest]))
    is_thick = tissue == "mediastinum or chest wall"
    in_target_mm = _length_in(nodule, tip_lps, along[None], tool.reach_mm)
    return LastLeg(
        tip_lps=_point(tip_lps),
        aim_lps=_point(aim),
        entry_lps=_point(points[entry]),
        to_target_mm=edge_mm,
        outside_mm=max(edge_mm - float(at[entry]), 0.0),
        angle_deg=math.degrees(math.acos(float(np.clip(along @ forward, -1.0, 1.0)))),
        crossed=crossed,
        in_target_mm=in_target_mm,
        least_in_target_mm=in_target_mm,
        vessel_mm=float(to_vessel[nearest]) if has_vessel else None,
        vessel_lps=_point(points[between][nearest]) if has_vessel else None,
        beyond_mm=_first_mm(is_thick[far:]),
        hit_share=1.0,
        reaches=edge_mm <= tool.reach_mm,
        vessels=_near_vessels(to_vessel, at[between], points[between], scene.margin_mm),
        vessel_beyond_mm=_first_mm(tissue[far:] == "vessel"),
        mediastinum_mm=STEP_MM * float(is_thick[between].sum()),
    )


def where_it_may_have_moved(scene: NeedleScene, leg: LastLeg, moved_mm: float) -> LastLeg:
    """The same leg with its hits where the target may lie anywhere in a ball of ``moved_mm``."""
    tip, aim = np.array(leg.tip_lps), np.array(leg.aim_lps)
    share = hit_share(scene.nodule, tip, aim, scene.tool.reach_mm, scene.errors, moved_mm=moved_mm)
    return replace(leg, hit_share_moved=share)


def _first_mm(there: NDArray[np.bool_]) -> float | None:
    """How far it is to the first of what is looked for; None where there is none near."""
    first = np.flatnonzero(there[: int(BEYOND_MM / STEP_MM) + 1])
    return STEP_MM * float(first[0]) if first.size else None


def _near_vessels(to_vessel: Points, at: Points, points: Points, margin_mm: float) -> tuple[NearVessel, ...]:
    """The nearest place of each stretch on which a vessel is nearer than the margin."""
    near = np.flatnonzero(to_vessel < margin_mm)
    if not near.size:
        return ()
    found = []
    for stretch in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        n = int(stretch[np.argmin(to_vessel[stretch])])
        found.append(NearVessel(float(at[n]), float(to_vessel[n]), _point(points[n])))
    return tuple(found)


def _stretches(tissue: NDArray[Any]) -> tuple[Crossed, ...]:
    found: list[Crossed] = []
    start = 0
    for n in range(1, len(tissue) + 1):
        if n < len(tissue) and tissue[n] == tissue[start]:
            continue
        name, start_mm, length_mm = tissue[start], STEP_MM * start, STEP_MM * (n - start)
        start = n
        if found and (length_mm < LEAST_MM or found[-1].tissue == name):
            found[-1] = replace(found[-1], length_mm=found[-1].length_mm + length_mm)
        else:
            found.append(Crossed(name, start_mm, length_mm))
    return tuple(found)


def _length_in(nodule: Nodule, tip: Points, ways: Points, reach_mm: float) -> float:
    at = np.arange(0.0, reach_mm + 1e-9, STEP_MM)
    points = tip + at[None, :, None] * ways[:, None, :]
    inside = nodule.contains(points.reshape(-1, 3)).reshape(len(ways), -1)
    return float(inside.sum(axis=1).min()) * STEP_MM


def _ring(along: Points, off_rad: float) -> Points:
    across, up = axes_across(along)
    turn = 2.0 * np.pi * np.arange(16) / 16
    side = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * up
    ring: Points = math.cos(off_rad) * along + math.sin(off_rad) * side
    return ring


def _point(values: Points) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
