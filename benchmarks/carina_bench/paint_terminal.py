"""Terminal airways of painted CTs: forks beyond the tips of a mask's airways, down to lumens of 0.45 mm radius.

Each fork divides the flow of its parent in two shares. The lumens follow Murray's rule with an exponent of 2.8. The
narrower airway of a fork turns farther from the parent's direction than the wider one. The plane of a fork is
perpendicular to the plane of the previous fork.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina_bench.paint_fine_vessels import Space
from carina_bench.paint_tubes import Tube

__all__ = ["MIN_RADIUS_MM", "terminal_airways"]

Floats = NDArray[np.float64]

MIN_RADIUS_MM = 0.45
"""Radius in mm of the lumen below which no terminal airway is painted."""
FLOW_EXPONENT = 2.8
"""Exponent of Murray's rule: the flow through an airway is proportional to this power of the radius."""
MIN_FLOW = 0.3
"""Minimum share of the parent's flow that the narrower airway of a painted fork receives."""
LENGTH_RADII = (9.0, 16.0)
"""Minimum and maximum length of an airway between two forks, in radii of its lumen."""
TURN_DEG = 70.0
"""Sum of the angles between the parent's direction and the directions of both airways of a fork, degrees."""
WALL_MM = (0.2, 0.3)
"""Minimum and maximum wall thickness of an airway up to 0.8 mm radius, mm; the wall of a wider airway is thicker."""
STEP_MM = 0.5
"""Distance in mm between two points of a painted airway's centreline."""
FREE_MM = 0.35
"""Minimum distance between the walls of two airways that do not share a fork, mm."""
LUNG_MM = 1.5
"""Minimum distance in mm of a painted airway from the lung's border."""
TRIALS = 8
"""Number of directions that are tried for each painted airway; the best one is used."""
MAX_GENERATIONS = 8
"""Maximum number of painted generations beyond a tip of the airway mask."""


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Free end of an airway, from which a painted fork may grow."""

    tube: Tube
    towards: Floats
    plane: Floats
    """Unit vector (3,) in the plane of the previous fork, perpendicular to the airway."""
    num_forks: int


def terminal_airways(tubes: Sequence[Tube], space: Space, share_per_mm2: float, rng: np.random.Generator) -> list[Tube]:
    """Return the airways that grow beyond the tips of ``tubes``, in the lung and clear of other airways.

    Parameters
    ----------
    tubes
        Airways of the masks, LPS mm; the ID of each is its index.
    space
        Masks in which the airways grow.
    share_per_mm2
        Share of the possible airways that grow, for each mm2 of the square of their lumen's radius. No airway below
        :data:`MIN_RADIUS_MM` grows.
    rng
        Random generator.
    """
    parents = {tube.parent for tube in tubes}
    ends = [_end_of(tube, rng) for tube in tubes if tube.id not in parents]
    everything = list(tubes)
    found: list[Tube] = []
    while ends:
        end = ends.pop(0)
        fork = _fork(end, everything, len(tubes) + len(found), space, share_per_mm2, rng)
        for tube, plane in fork:
            found.append(tube)
            everything.append(tube)
            if end.num_forks + 1 < MAX_GENERATIONS:
                ends.append(_End(tube, _course(tube), plane, end.num_forks + 1))
    return found


def _end_of(tube: Tube, rng: np.random.Generator) -> _End:
    towards = _course(tube)
    return _End(tube, towards, _across(towards, rng), 0)


def _course(tube: Tube) -> Floats:
    towards = tube.points[-1] - tube.points[max(len(tube.points) - 7, 0)]
    result: Floats = towards / np.linalg.norm(towards)
    return result


def _across(direction: Floats, rng: np.random.Generator) -> Floats:
    other = rng.standard_normal(3)
    other -= (other @ direction) * direction
    result: Floats = other / np.linalg.norm(other)
    return result


def _fork(
    end: _End,
    everything: Sequence[Tube],
    first_id: int,
    space: Space,
    share_per_mm2: float,
    rng: np.random.Generator,
) -> list[tuple[Tube, Floats]]:
    """Return up to two airways that grow from an end, each with the direction perpendicular to their fork's plane."""
    start = end.tube.points[-1]
    before = float(end.tube.radius_mm[-1])
    flow = rng.uniform(MIN_FLOW, 0.5)
    radii = [before * share ** (1.0 / FLOW_EXPONENT) for share in (1.0 - flow, flow)]
    near = [
        tube for tube in everything if tube is not end.tube and np.abs(tube.points - start).max(axis=1).min() < 25.0
    ]
    there = np.concatenate([tube.points for tube in near]) if near else np.full((1, 3), 1e6)
    outer = np.concatenate([tube.outer_mm() for tube in near]) if near else np.zeros(1)
    found: list[tuple[Tube, Floats]] = []
    plane = np.cross(end.towards, end.plane)
    plane /= np.linalg.norm(plane)
    for radius, other, side in ((radii[0], radii[1], 1.0), (radii[1], radii[0], -1.0)):
        if radius < MIN_RADIUS_MM or rng.random() >= share_per_mm2 * radius**2:
            continue
        thickness = float(rng.uniform(*WALL_MM)) * max(1.0, radius / 0.8)
        for _ in range(TRIALS):
            angle = math.radians(TURN_DEG) * other**2 / (radius**2 + other**2) * rng.uniform(0.75, 1.25)
            turned = math.cos(angle) * end.towards + side * math.sin(angle) * plane
            points = _line(start, turned, rng.uniform(*LENGTH_RADII) * radius, rng)
            along = np.linalg.norm(points - start, axis=1)
            gap = (np.linalg.norm(points[:, None] - there, axis=2) - outer).min(axis=1)
            clear = gap > radius + thickness + FREE_MM
            clear &= space.in_lung(points, LUNG_MM) & ~space.at_vessel(points, radius + thickness + 0.2)
            # Near the fork a new airway is inside its parent, which already has the required distance from its
            # neighbours.
            clear |= along < before + 0.5
            if clear.all():
                tube = Tube(
                    points,
                    np.linspace(radius, max(0.95 * radius, MIN_RADIUS_MM), len(points)),
                    id=first_id + len(found),
                    parent=end.tube.id,
                    generation=end.tube.generation + 1,
                    true_from=min(max(math.ceil(before / STEP_MM), 1), len(points) - 2),
                    thickness_mm=thickness,
                )
                found.append((tube, plane))
                break
            plane = _across(end.towards, rng)
    return found


def _line(start: Floats, heading: Floats, length_mm: float, rng: np.random.Generator) -> Floats:
    """Return a line (n, 3) from ``start`` that bends evenly, with points :data:`STEP_MM` apart."""
    num = max(round(length_mm / STEP_MM), 4)
    bend = _across(heading, rng) * rng.uniform(0.0, 0.06)
    points = [start]
    for _ in range(num):
        points.append(points[-1] + STEP_MM * heading)
        heading = heading + STEP_MM * bend
        heading = heading / np.linalg.norm(heading)
    return np.array(points)
