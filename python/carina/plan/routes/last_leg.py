"""Last leg of a route: the straight needle path from the tip of the scope through the wall into the target."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.instruments.tools import Tool
from carina.plan.lungs.tissue_near_needle import WALL_MM, NearbyTissue
from carina.plan.movement.target_movement import TargetMovement
from carina.plan.routes.needle_hits import NeedleErrors, axes_across, hit_share
from carina.plan.targets.grow_nodule import Nodule
from carina.scopes import WallField

Points = NDArray[np.float64]
Tissue = Literal[
    "lumen", "airway wall", "lung", "fissure", "vessel", "target", "mediastinum or chest wall", "not examined"
]
"""Tissue on a needle path.

``fissure`` is used only for a visible fissure. ``not examined`` is outside the CT, or too far from the target.
"""

STEP_MM = 0.25
MIN_MM = 0.5
"""Minimum length in mm of a separate part of the needle path; a shorter part is added to the part before it."""
SPREAD = 1.645
"""Half width of the interval that contains 90 % of the needles, in standard deviations of the needle's error."""
BEYOND_MM = 10.0
"""Distance in mm beyond the target up to which the tissues on the needle path are examined."""
CROSSED_VESSEL_MM = 0.05
"""Distance in mm from the needle's line below which a vessel counts as crossed; a text would round it to 0.0."""
OPEN_MM = 0.8
"""Maximum length in mm of the needle path outside the lumen, before the target, at which no wall need be pierced."""


@one_line
@dataclass(frozen=True, slots=True)
class CrossedTissue:
    """Stretch of one tissue along the needle."""

    tissue: Tissue
    start_mm: float
    """Distance from the tip of the scope to the start of this part of the needle path, mm."""
    length_mm: float

    @property
    def end_mm(self) -> float:
        """Distance from the tip of the scope to the end of this part of the needle path, mm."""
        return self.start_mm + self.length_mm


@one_line
@dataclass(frozen=True, slots=True)
class NearVessel:
    """Vessel that is nearer to the needle than the margin."""

    at_mm: float
    """Distance in mm from the scope's tip to the point of the needle that is nearest to the vessel."""
    distance_mm: float
    """Distance of the vessel from the needle's line, mm; 0 if the needle passes through it."""
    place_lps: tuple[float, float, float]
    """Nearest point on the needle's line, LPS mm."""


@one_line
@dataclass(frozen=True, slots=True)
class LastLeg:
    """Needle path from the tip of the scope to the target, and the tissues that it crosses."""

    tip_lps: tuple[float, float, float]
    aim_lps: tuple[float, float, float]
    entry_lps: tuple[float, float, float]
    """Point where the needle enters the wall, LPS mm."""
    to_target_mm: float
    """Distance from the tip to the edge of the target, along the needle, mm."""
    outside_mm: float
    """Part of ``to_target_mm`` that lies outside the lumen, mm."""
    angle_deg: float
    """Angle in degrees between the needle and the airway's axis at the tip."""
    crossed: tuple[CrossedTissue, ...]
    """Tissues along the needle in order, to the end of its reach or 10 mm beyond the target, whichever is farther."""
    in_target_mm: float
    """Length of the needle in the target in mm, if the needle is exactly on its planned line."""
    least_in_target_mm: float
    """Least length in the target, in mm, of needles deviating by 1.6 standard deviations; 0 if one of them misses."""
    vessel_mm: float | None
    """Least distance in mm between the needle's line up to the target's far edge and a visible vessel.

    None if there is none.
    """
    vessel_lps: tuple[float, float, float] | None
    """Point on the needle's line nearest to the vessel of ``vessel_mm``, LPS mm; None if there is none."""
    beyond_mm: float | None
    """Distance along the needle from the target's far edge to pleura or mediastinum, mm; None if more than 10 mm."""
    hit_share: float
    """Share of needles within the assumed errors that hit the target at its position in the CT, 0 to 1.

    In a plan the needle has a direction that the scope can take; the share is 0 if no such direction hits. Before a
    simulated drive the share is an estimate, which outputs do not show (`PlannedRoute.hit_share`).
    """
    reaches: bool
    """Whether the tool reaches the edge of the target."""
    hit_share_moved: float | None = None
    """Share of hits if the target may have moved and the needle is not aimed again; None if not computed."""
    vessels: tuple[NearVessel, ...] = ()
    """Visible vessels nearer to the needle than the margin, in order, from the wall to the target's far edge."""
    vessel_beyond_mm: float | None = None
    """Distance in mm along the needle from the target's far edge to the first vessel; None if more than 10 mm."""
    mediastinum_mm: float = 0.0
    """Length of mediastinum or chest wall before the target's far edge, mm; vessels in it are not visible."""

    @property
    def crosses_vessel(self) -> bool:
        """Whether the needle's line crosses a visible vessel before the target's far edge."""
        return self.vessel_mm is not None and self.vessel_mm < CROSSED_VESSEL_MM

    @property
    def vessel_words(self) -> str:
        """Nearest vessel as text: *nearest vessel 1.7 mm*, *crosses a vessel*, or *no vessel seen nearby*."""
        if self.vessel_mm is None:
            return "no vessel seen nearby"
        return "crosses a vessel" if self.crosses_vessel else f"nearest vessel {self.vessel_mm:.1f} mm"

    @property
    def is_open(self) -> bool:
        """Whether the target is in the lumen or against it, so that no wall has to be pierced."""
        return self.outside_mm <= OPEN_MM

    def to_json(self) -> dict[str, Any]:
        """Return the leg as plain JSON types."""
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
    """Inputs of a needle path: the nodule, the tissue round the nodule, and the planned needle."""

    nodule: Nodule
    wall: WallField
    around: NearbyTissue
    tool: Tool
    errors: NeedleErrors
    margin_mm: float = 3.0
    """Distance in mm from the needle within which vessels are listed."""


def last_leg(scene: NeedleScene, tip_lps: Points, forward: Points, aim_lps: Points | None = None) -> LastLeg:
    """Compute the straight needle path from a tip to an aim in a nodule that has not moved.

    Parameters
    ----------
    scene
        Nodule, tissues and needle.
    tip_lps, forward
        (3,) position of the scope's tip, LPS mm, and direction of the airway there.
    aim_lps
        (3,) LPS mm; the centroid of the nodule if None.

    Returns
    -------
    LastLeg
        The path with its tissues, distances and share of hits.
    """
    return with_errors(scene, leg_as_aimed(scene, tip_lps, forward, aim_lps))


def with_errors(scene: NeedleScene, leg: LastLeg) -> LastLeg:
    """Return a leg with the effect of the needle's errors: its share of hits and the least length in the target.

    Parameters
    ----------
    scene, leg
        Nodule, tissues and needle; leg of a needle without errors.
    """
    tip, aim = np.array(leg.tip_lps), np.array(leg.aim_lps)
    distance = float(np.linalg.norm(aim - tip))
    least = leg.in_target_mm
    if distance >= MIN_MM:
        sigma = math.hypot(math.radians(scene.errors.angle_deg), scene.errors.tip_mm / max(distance, 1.0))
        ring = _ring((aim - tip) / distance, SPREAD * sigma)
        least = min(least, _length_in(scene.nodule, tip, ring, scene.tool.reach_mm))
    share = hit_share(scene.nodule, tip, aim, scene.tool.reach_mm, scene.errors)
    return replace(leg, least_in_target_mm=least, hit_share=share)


def leg_as_aimed(scene: NeedleScene, tip_lps: Points, forward: Points, aim_lps: Points | None = None) -> LastLeg:
    """Compute the needle's path from a tip to an aim as `last_leg` does, but for a needle without errors.

    Such a needle always hits, so the share of hits of the result is 1.

    Parameters
    ----------
    scene, tip_lps, forward, aim_lps
        As for `last_leg`.
    """
    nodule, wall, around, tool = scene.nodule, scene.wall, scene.around, scene.tool
    aim = np.array(nodule.centre_lps) if aim_lps is None else np.asarray(aim_lps, dtype=np.float64)
    off = aim - tip_lps
    distance = float(np.linalg.norm(off))
    # If the tip is at the aim, because an airway passes through the nodule, the needle goes along the airway.
    along = off / distance if distance >= MIN_MM else forward
    at, points, in_target = _needle_points(nodule, tip_lps, along, distance, tool.reach_mm)
    to_wall = wall.distance_mm(points)
    in_lumen = (to_wall > 0.0) & (np.cumsum(to_wall <= 0.0) == 0)
    tissue = np.full(len(at), "lung", dtype=object)
    if around.fissure is not None:
        tissue[around.fissure.crossed(points)] = "fissure"
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
        tip_lps=as_point(tip_lps),
        aim_lps=as_point(aim),
        entry_lps=as_point(points[entry]),
        to_target_mm=edge_mm,
        outside_mm=max(edge_mm - float(at[entry]), 0.0),
        angle_deg=math.degrees(math.acos(float(np.clip(along @ forward, -1.0, 1.0)))),
        crossed=crossed,
        in_target_mm=in_target_mm,
        least_in_target_mm=in_target_mm,
        vessel_mm=float(to_vessel[nearest]) if has_vessel else None,
        vessel_lps=as_point(points[between][nearest]) if has_vessel else None,
        beyond_mm=_first_mm(is_thick[far:]),
        hit_share=1.0,
        reaches=edge_mm <= tool.reach_mm,
        vessels=_near_vessels(to_vessel, at[between], points[between], scene.margin_mm),
        vessel_beyond_mm=_first_mm(tissue[far:] == "vessel"),
        mediastinum_mm=STEP_MM * float(is_thick[between].sum()),
    )


def edge_on_needle_mm(nodule: Nodule, tip_lps: Points, end_lps: Points, reach_mm: float) -> float:
    """Return the distance in mm from a tip to a nodule's edge along a needle; the needle's reach if the needle misses.

    Parameters
    ----------
    nodule
        The target.
    tip_lps, end_lps
        (3,) tip, and a point on the needle at the distance of the aim, LPS mm.
    reach_mm
        Distance that the needle reaches beyond the tip.
    """
    off = end_lps - tip_lps
    distance = max(float(np.linalg.norm(off)), MIN_MM)
    at, _, inside = _needle_points(nodule, tip_lps, off / distance, distance, reach_mm)
    hits = np.flatnonzero(inside)
    return float(at[hits[0]]) if hits.size else distance


def _needle_points(
    nodule: Nodule, tip_lps: Points, along: Points, distance: float, reach_mm: float
) -> tuple[Points, Points, NDArray[np.bool_]]:
    """Return points along a needle: distances from the tip, positions, and whether they are in the nodule."""
    at = np.arange(0.0, max(reach_mm, distance + nodule.long_mm + BEYOND_MM) + 2.0, STEP_MM)
    points = tip_lps + at[:, None] * along
    return at, points, nodule.contains(points)


def where_it_may_have_moved(scene: NeedleScene, leg: LastLeg, movement: TargetMovement) -> LastLeg:
    """Return a leg with the share of hits for a target that may be anywhere within its possible movement.

    Parameters
    ----------
    scene, leg
        Nodule, tissues and needle; leg of the needle.
    movement
        Movement of the target. A measured target is on the line between its places in both CTs, within the error.
    """
    tip, aim = np.array(leg.tip_lps), np.array(leg.aim_lps)
    share = hit_share(
        scene.nodule,
        tip,
        aim,
        scene.tool.reach_mm,
        scene.errors,
        moved_mm=movement.most_mm if movement.error_mm is None else movement.error_mm,
        shift_lps=movement.shift_lps,
    )
    return replace(leg, hit_share_moved=share)


def _first_mm(there: NDArray[np.bool_]) -> float | None:
    """Return the distance in mm of the first true sample along the needle; None if no sample is true."""
    first = np.flatnonzero(there[: int(BEYOND_MM / STEP_MM) + 1])
    return STEP_MM * float(first[0]) if first.size else None


def _near_vessels(to_vessel: Points, at: Points, points: Points, margin_mm: float) -> tuple[NearVessel, ...]:
    """Return one point for each part of the needle near a vessel: the point at which the vessel is nearest.

    A part is near a vessel if its distance is below the margin.
    """
    near = np.flatnonzero(to_vessel < margin_mm)
    if not near.size:
        return ()
    found = []
    for stretch in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        n = int(stretch[np.argmin(to_vessel[stretch])])
        found.append(NearVessel(float(at[n]), float(to_vessel[n]), as_point(points[n])))
    return tuple(found)


def _stretches(tissue: NDArray[Any]) -> tuple[CrossedTissue, ...]:
    found: list[CrossedTissue] = []
    start = 0
    for n in range(1, len(tissue) + 1):
        if n < len(tissue) and tissue[n] == tissue[start]:
            continue
        name, start_mm, length_mm = tissue[start], STEP_MM * start, STEP_MM * (n - start)
        start = n
        if found and (length_mm < MIN_MM or found[-1].tissue == name):
            found[-1] = replace(found[-1], length_mm=found[-1].length_mm + length_mm)
        else:
            found.append(CrossedTissue(name, start_mm, length_mm))
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


def as_point(values: Points) -> tuple[float, float, float]:
    """Return the three coordinates as a tuple."""
    return float(values[0]), float(values[1]), float(values[2])
