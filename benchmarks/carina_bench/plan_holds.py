"""Exhaustive search of the holds of a scope from which a needle hits a target, in airways that are known exactly.

The search is a slow reference. It shares no code with the plan, with the simulated drive or with the elastic model of
the scope: it uses only geometry. The lumen is the union of the true balls on the true centrelines, and its outside is
an obstacle. The distal part of a scope is a chain of three parts:

1. The shaft is anywhere in the lumen of a place that is wide enough for the scope, in a direction up to 20 degrees off
   the airway.
2. From there the free part of the bending section follows an arc of a circle, in any plane (roll) and at most as sharp
   as the scope bends. The rest of the bending section is behind it and follows the airway.
3. A rigid tip continues the arc.

A hold is possible if the whole chain, with the scope's radius, is inside the lumen; the wall yields by `YIELD_MM`. A
hold hits if the needle without errors meets the target within its reach, and at least half of the needles with random
errors do. Whether a drive leads to a hold is not examined, so the search may find holds that no hand can reach.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.scopes import ScopePreset
from carina_bench.plan_cases import Target, TrueTree

__all__ = ["Hold", "LumenDepth", "find_hold", "needle_hits"]

Floats = NDArray[np.float64]

PLACE_STEP_MM = 1.0
"""Distance between two tested places of the shaft's end, mm."""
NUM_SIDES, OFFSETS, TILTS_DEG = 6, (0.5, 1.0), (10.0, 20.0)
"""Sides towards which the shaft is moved and tilted; shares of the free way to the wall; tilts in degrees."""
NUM_ROLLS, NUM_BENDS, NUM_LENGTHS = 24, 6, 5
"""Number of planes of the arc, of its curvatures above 0, and of the lengths of the free part."""
CHAIN_STEP_MM, BEHIND_MM = 1.0, 3.0
"""Distance between two tested points of the chain, and length of the tested shaft behind the arc, mm."""
YIELD_MM, NUM_RIM = 0.2, 8
"""Depth in mm to which the wall yields, and number of tested points on the rim of the tip's face."""
GRID_MM, OUTSIDE_MM, OUTSIDE_BOX_MM = 0.5, -9.0, 2.0
"""Spacing of the sampled depth, its value far outside, and margin of the sampled cube, mm."""
MIN_HITS, NUM_NEEDLES = 0.5, 400
"""Least share of the needles with random errors that hit, and number of these needles."""
SIGMA_DEG, SIGMA_MM = 4.0, 0.7
"""Standard deviations of the needle's direction in degrees, and of the tip in mm; equal to those of the plan."""


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """Position and direction of a tip from which enough needles hit."""

    tip_lps: Floats
    forward: Floats
    share: float
    """Share of the needles with random errors that hit."""
    branch: int
    """Index of the true branch in which the free part of the scope begins."""
    narrowest_mm: float
    """Diameter of the largest ball that passes from the trachea to that place, mm."""


class LumenDepth:
    """Depth inside the lumen near some point, sampled on a grid: the largest radius less distance over all balls.

    Parameters
    ----------
    truth
        True centrelines with their radii.
    middle, within_mm
        (3,) LPS mm and half the size of the sampled cube in mm; all of its outside counts as wall.
    """

    def __init__(self, truth: TrueTree, middle: Floats, within_mm: float) -> None:
        self._low = middle - within_mm
        size = math.ceil(2.0 * within_mm / GRID_MM) + 1
        self._depth = np.full((size, size, size), OUTSIDE_MM, dtype=np.float32)
        near = np.linalg.norm(truth.points - middle, axis=1) <= 2.0 * within_mm
        for point, radius in zip(truth.points[near], truth.radius_mm[near], strict=True):
            half = radius + 2.0 * GRID_MM
            begin = np.clip(np.floor((point - half - self._low) / GRID_MM).astype(int), 0, size)
            end = np.clip(np.ceil((point + half - self._low) / GRID_MM).astype(int) + 1, begin, size)
            x, y, z = (self._low[a] + GRID_MM * np.arange(begin[a], end[a]) - point[a] for a in range(3))
            ball = radius - np.sqrt(x[:, None, None] ** 2 + y[None, :, None] ** 2 + z[None, None, :] ** 2)
            part = self._depth[begin[0] : end[0], begin[1] : end[1], begin[2] : end[2]]
            np.maximum(part, ball.astype(np.float32), out=part)

    def at(self, points: Floats) -> Floats:
        """Return the depths (...) in mm of points (..., 3), interpolated linearly; negative outside the lumen."""
        place = np.clip((points - self._low) / GRID_MM, 0.0, len(self._depth) - 1.001)
        corner = place.astype(np.intp)
        share = place - corner
        found = np.zeros(points.shape[:-1])
        for dx, dy, dz in np.ndindex(2, 2, 2):
            weight = np.prod(np.where((dx, dy, dz), share, 1.0 - share), axis=-1)
            found += weight * self._depth[corner[..., 0] + dx, corner[..., 1] + dy, corner[..., 2] + dz]
        return found


def find_hold(
    truth: TrueTree,
    target: Target,
    scope: ScopePreset,
    reach_mm: float,
    *,
    near_lps: Floats | None = None,
    near_mm: float = math.inf,
) -> Hold | None:
    """Return a hold of a scope from which at least half of the needles hit a target; None if there is none.

    Parameters
    ----------
    truth, target, scope, reach_mm
        Known airways, target, instrument, and length of the needle beyond the tip.
    near_lps, near_mm
        (3,) LPS mm and a distance: only tips within this distance of the point count. None: all tips.
    """
    assert scope.bending_mm is not None and scope.flexion_deg is not None
    section_mm, rigid_mm = float(np.mean(scope.bending_mm)), scope.rigid_tip_mm or 0.0
    sharpest = math.radians(max(scope.flexion_deg)) / section_mm
    centre, radius = np.array(target.centre_lps), 0.5 * max(scope.tip_mm, scope.tube_mm or 0.0)
    within_mm = reach_mm + target.radius_mm + section_mm + rigid_mm
    lumen = LumenDepth(truth, centre, within_mm + BEHIND_MM + OUTSIDE_BOX_MM)
    shapes = _shapes(section_mm, rigid_mm, sharpest)
    for n in _places(truth, centre, within_mm, scope.fit_mm):
        bases, axes = _bases(truth, n, lumen, radius)
        tips = bases[:, None] + shapes.tips @ axes
        forward = shapes.forward @ axes
        hopeful = _meets(tips, forward, centre, target.radius_mm, reach_mm)
        if near_lps is not None:
            hopeful &= np.linalg.norm(tips - near_lps, axis=-1) <= near_mm
        base, shape = np.nonzero(hopeful)
        inside = _fits(lumen, shapes, shape, bases[base], axes[base], radius)
        for k in np.flatnonzero(inside):
            tip, ahead = tips[base[k], shape[k]], forward[base[k], shape[k]]
            share = needle_hits(tip, ahead, target, reach_mm)
            if share >= MIN_HITS:
                return Hold(tip, ahead, share, int(truth.branch[n]), float(truth.narrowest_mm[n]))
    return None


def needle_hits(tip: Floats, forward: Floats, target: Target, reach_mm: float) -> float:
    """Return the share of needles with random errors that meet a target, from a tip (3,) in a direction (3,)."""
    off = np.array(target.centre_lps) - tip
    sigma = math.hypot(math.radians(SIGMA_DEG), SIGMA_MM / max(float(np.linalg.norm(off)), 1e-6))
    across, up = _across(forward)
    errors = sigma * np.random.default_rng(7).normal(size=(NUM_NEEDLES, 2))
    ways = forward + errors[:, :1] * across + errors[:, 1:] * up
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    along = np.clip(ways @ off, 0.0, reach_mm)
    return float((np.linalg.norm(along[:, None] * ways - off, axis=1) <= target.radius_mm).mean())


@dataclass(frozen=True, slots=True, eq=False)
class _Shapes:
    """Shapes of the chain of arc and rigid tip, in axes across (two) and along the shaft's end; one row for each."""

    tips: Floats
    forward: Floats
    plane: Floats
    """(n, 3) unit vectors across the shaft, in the plane of each arc."""
    curvature: Floats
    length_mm: Floats
    rigid_mm: float

    def arc(self, which: NDArray[np.intp]) -> Floats:
        """Return points (shape, place, 3) of the arcs of some shapes."""
        curvature, length = self.curvature[which, None], self.length_mm[which, None]
        share = np.linspace(0.0, 1.0, 1 + math.ceil(float(self.length_mm.max()) / CHAIN_STEP_MM))
        aside, ahead = _on_arc(curvature, share * length)
        found: Floats = aside[..., None] * self.plane[which, None] + ahead[..., None] * np.array([0.0, 0.0, 1.0])
        return found


def _on_arc(curvature: Floats, length_mm: Floats) -> tuple[Floats, Floats]:
    """Return how far a circle leads aside and ahead at a length from its start, mm."""
    angle = curvature * length_mm
    straight = angle < 1e-9
    safe = np.where(straight, 1.0, curvature)
    aside = np.where(straight, 0.0, (1.0 - np.cos(angle)) / safe)
    return aside, np.where(straight, length_mm, np.sin(angle) / safe)


def _shapes(section_mm: float, rigid_mm: float, sharpest: float) -> _Shapes:
    rows = [(0.0, 0.0, section_mm)]
    for roll in 2.0 * np.pi * np.arange(NUM_ROLLS) / NUM_ROLLS:
        for bend in sharpest * np.arange(1, NUM_BENDS + 1) / NUM_BENDS:
            rows += [(roll, bend, section_mm * n / NUM_LENGTHS) for n in range(1, NUM_LENGTHS + 1)]
    roll, curvature, length = np.array(rows).T
    plane = np.stack([np.cos(roll), np.sin(roll), np.zeros(len(roll))], axis=1)
    along = np.array([0.0, 0.0, 1.0])
    aside, ahead = _on_arc(curvature, length)
    angle = (curvature * length)[:, None]
    forward = np.sin(angle) * plane + np.cos(angle) * along
    ends = aside[:, None] * plane + ahead[:, None] * along
    return _Shapes(ends + rigid_mm * forward, forward, plane, curvature, length, rigid_mm)


def _places(truth: TrueTree, centre: Floats, within_mm: float, fit_mm: float) -> Iterator[int]:
    """Yield indices of true centreline points, `PLACE_STEP_MM` apart, that are near a target and wide enough."""
    last: tuple[int, Floats] | None = None
    for n in np.flatnonzero(np.linalg.norm(truth.points - centre, axis=1) <= within_mm):
        if truth.narrowest_mm[n] < fit_mm:
            continue
        is_same = last is not None and last[0] == truth.branch[n]
        if last is not None and is_same and float(np.linalg.norm(truth.points[n] - last[1])) < PLACE_STEP_MM:
            continue
        last = int(truth.branch[n]), truth.points[n]
        yield int(n)


def _bases(truth: TrueTree, n: int, lumen: LumenDepth, radius: float) -> tuple[Floats, Floats]:
    """Return ends of the shaft at a place: positions (k, 3), and axes (k, 3, 3), two across and one along the shaft."""
    point, forward = truth.points[n], truth.forward[n]
    across, up = _across(forward)
    turns = 2.0 * np.pi * np.arange(NUM_SIDES)[:, None] / NUM_SIDES
    sides = np.cos(turns) * across + np.sin(turns) * up
    spare_mm = max(float(truth.radius_mm[n]) - radius, 0.0)
    points = np.concatenate([point[None], *(point + share * spare_mm * sides for share in OFFSETS)])
    tilts = np.radians(TILTS_DEG)
    ways = np.concatenate([forward[None], *(math.cos(tilt) * forward + math.sin(tilt) * sides for tilt in tilts)])
    axes = np.array([[*_across(way), way] for way in ways])
    behind = np.arange(0.0, BEHIND_MM + 1e-6, CHAIN_STEP_MM)[:, None]
    shaft = points[:, None, None] - behind * ways[None, :, None]
    base, way = np.nonzero(lumen.at(shaft).min(axis=-1) >= radius - YIELD_MM)
    return points[base], axes[way]


def _fits(
    lumen: LumenDepth, shapes: _Shapes, shape: NDArray[np.intp], bases: Floats, axes: Floats, radius: float
) -> NDArray[np.bool_]:
    """Return whether chains, each a shape from its base, are inside the lumen with the scope's radius."""
    tips = bases + np.einsum("ni,nij->nj", shapes.tips[shape], axes)
    forward = np.einsum("ni,nij->nj", shapes.forward[shape], axes)
    inside = lumen.at(tips) >= -YIELD_MM
    # A ball round a point less than a radius behind the face would extend beyond the face, so the face's rim is tested.
    for at_mm in np.arange(min(radius, shapes.rigid_mm), shapes.rigid_mm + 1e-6, CHAIN_STEP_MM):
        left = np.flatnonzero(inside)
        inside[left] = lumen.at(tips[left] - at_mm * forward[left]) >= radius - YIELD_MM
    left = np.flatnonzero(inside)
    arc = bases[left, None] + np.einsum("nki,nij->nkj", shapes.arc(shape[left]), axes[left])
    inside[left] = lumen.at(arc).min(axis=-1) >= radius - YIELD_MM
    for row in np.flatnonzero(inside):
        across, up = _across(forward[row])
        turn = 2.0 * np.pi * np.arange(NUM_RIM)[:, None] / NUM_RIM
        rim = tips[row] + radius * (np.cos(turn) * across + np.sin(turn) * up)
        inside[row] = bool(lumen.at(rim).min() >= -YIELD_MM)
    return inside


def _meets(tips: Floats, forward: Floats, centre: Floats, radius_mm: float, reach_mm: float) -> NDArray[np.bool_]:
    """Return whether needles without errors meet a ball within their reach."""
    off = centre - tips
    along = np.clip((off * forward).sum(axis=-1), 0.0, reach_mm)
    found: NDArray[np.bool_] = np.linalg.norm(off - along[..., None] * forward, axis=-1) <= radius_mm
    return found


def _across(along: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors perpendicular to a direction and to each other."""
    across = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    across /= np.linalg.norm(across)
    return across, np.cross(along, across)
