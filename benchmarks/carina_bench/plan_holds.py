"""Exhaustive search of the holds of a scope from which a needle hits a target, in airways that are known exactly.

The search is a slow reference. It shares no code with the plan, with the simulated drive or with the elastic model of
the scope: it uses only geometry. The lumen is the union of the true balls on the true centrelines, and its outside is
an obstacle. The distal part of a scope is a chain of three parts:

1. The shaft is anywhere in the lumen of a place that is wide enough for the scope, in a direction up to 20 degrees off
   the airway. The airways to the tip are also wide enough: `ScopePreset.fit_mm` includes the excess of real scopes over
   their stated size, which counts for the tip as for the shaft.
2. From there the free part of the bending section follows an arc of a circle, in any plane (roll) and at most as sharp
   as the scope bends. The rest of the bending section is behind it and follows the airway.
3. A rigid tip continues the arc.

A hold is possible if the whole chain, with the scope's radius, is inside the lumen; the wall yields by `YIELD_MM`. A
hold hits if the needle without errors meets the target within its reach, and at least half of the needles with random
errors do. Whether a drive leads to a hold is not examined, so the search may find holds that no hand can reach.

The grid of chains is coarser than the play of a scope in a narrow airway: a tip of 10 mm with a play of 0.5 mm turns by
6 degrees, and two neighbouring curvatures differ by 35 degrees. If no chain of the grid hits, the chains that nearly
fit are therefore changed in small steps until one fits and hits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.scopes import ScopePreset
from carina_bench.plan_cases import STEP_MM, Target, TrueTree

__all__ = ["Hold", "LumenDepth", "find_hold", "needle_hits"]

Floats = NDArray[np.float64]

PLACE_STEP_MM = 1.0
"""Distance in mm between two tested positions of the shaft's end along the airway."""
NUM_SIDES, OFFSETS, TILTS_DEG = 6, (0.5, 1.0), (10.0, 20.0)
"""Sides towards which the shaft is moved and tilted; shares of the free way to the wall; tilts in degrees."""
NUM_ROLLS, NUM_BENDS, NUM_LENGTHS = 24, 6, 5
"""Number of planes of the arc, of its curvatures above 0, and of the lengths of the free part."""
CHAIN_STEP_MM, BEHIND_MM = 1.0, 3.0
"""Distance between two tested points of the chain, and length of the tested shaft behind the arc, mm."""
YIELD_MM, NUM_RIM = 0.2, 8
"""Depth in mm to which the wall yields, and number of tested points on the rim of the tip's face."""
GRID_MM, OUTSIDE_MM, OUTSIDE_BOX_MM = 0.5, -9.0, 2.0
"""Spacing of the grid that stores the nearest balls, depth far outside, and margin of the grid, mm."""
NEARLY_MM, NUM_REFINED, ROUNDS, NUM_CHANGES = 1.0, 12, 16, 64
"""Refinement: largest overlap in mm of wall and refined chain, number of chains, of rounds, of changes in a round."""
CHANGE_MM, CHANGE_DEG, CHANGE_SHARE, SHRINK = 0.5, 8.0, 0.15, 0.85
"""Standard deviations of the changes in the first round: of the shaft's end in mm, of the shaft's direction and of the
arc's plane in degrees, of curvature and length as shares of the largest ones; factor between two rounds."""
MIN_HITS, NUM_NEEDLES = 0.5, 400
"""Minimum share of the needles with random errors that hit, and number of these needles."""
SIGMA_DEG, SIGMA_MM = 4.0, 0.7
"""Standard deviations of the needle's direction in degrees, and of the tip in mm; equal to those of the plan."""


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """Scope tip (position and direction) from which enough needles with random errors hit the target."""

    tip_lps: Floats
    forward: Floats
    share: float
    """Share of the needles with random errors that hit the target."""
    branch: int
    """Index of the true branch in which the free part of the scope begins."""
    narrowest_mm: float
    """Diameter in mm of the largest ball that passes from the trachea to the point where the free part begins."""


class LumenDepth:
    """Depth in the true lumen near a point: the maximum, over its balls, of radius less distance to the centre.

    A grid stores the ball that determines the depth at each of its corners. The depth at a point is computed from the
    balls of the eight corners round the point, which are extended along the airway to the middle between two balls.
    Depths that are interpolated between the corners would be up to 0.35 mm too small on the axis of a tube, where the
    depth has a ridge, and 0.15 mm more between two balls.

    Parameters
    ----------
    truth
        True centrelines with their radii.
    middle, within_mm
        (3,) LPS mm and half the size of the grid in mm; all of its outside counts as wall.
    """

    def __init__(self, truth: TrueTree, middle: Floats, within_mm: float) -> None:
        self._low = middle - within_mm
        size = math.ceil(2.0 * within_mm / GRID_MM) + 1
        depth = np.full((size, size, size), OUTSIDE_MM, dtype=np.float32)
        self._ball = np.full((size, size, size), -1, dtype=np.int32)
        near = np.linalg.norm(truth.points - middle, axis=1) <= 2.0 * within_mm
        # The last row is a ball of radius minus infinity: the nearest ball of grid points that no real ball is near.
        self._points = np.concatenate([truth.points[near], middle[None]])
        self._forward = np.concatenate([_unit(truth.forward[near]), np.zeros((1, 3))])
        self._narrowest_mm = truth.narrowest_mm[near]
        self._radius_mm = np.concatenate([truth.radius_mm[near], [-math.inf]])
        for n, (point, radius) in enumerate(zip(self._points[:-1], self._radius_mm[:-1], strict=True)):
            half = radius + 2.0 * GRID_MM
            begin = np.clip(np.floor((point - half - self._low) / GRID_MM).astype(int), 0, size)
            end = np.clip(np.ceil((point + half - self._low) / GRID_MM).astype(int) + 1, begin, size)
            x, y, z = (self._low[a] + GRID_MM * np.arange(begin[a], end[a]) - point[a] for a in range(3))
            own = (radius - np.sqrt(x[:, None, None] ** 2 + y[None, :, None] ** 2 + z[None, None, :] ** 2)).astype(
                np.float32
            )
            at = tuple(slice(low, high) for low, high in zip(begin, end, strict=True))
            deeper = own > depth[at]
            depth[at][deeper] = own[deeper]
            self._ball[at][deeper] = n

    def at(self, points: Floats) -> Floats:
        """Return the depths (...) in mm of points (..., 3); negative outside the lumen."""
        corner = np.clip((points - self._low) / GRID_MM, 0.0, len(self._ball) - 1.001).astype(np.intp)
        found = np.full(points.shape[:-1], OUTSIDE_MM)
        for dx, dy, dz in np.ndindex(2, 2, 2):
            ball = self._ball[corner[..., 0] + dx, corner[..., 1] + dy, corner[..., 2] + dz]
            off, along = points - self._points[ball], self._forward[ball]
            off -= np.clip((off * along).sum(axis=-1, keepdims=True), -0.5 * STEP_MM, 0.5 * STEP_MM) * along
            np.maximum(found, self._radius_mm[ball] - np.sqrt((off * off).sum(axis=-1)), out=found)
        return found

    def narrowest_mm(self, tips: Floats) -> Floats:
        """Return the diameters (n,) in mm of the largest balls that pass from the trachea to tips (n, 3).

        At a fork, the widest path counts. A tip outside the lumen has the diameter 0.
        """
        found = np.zeros(len(tips))
        for n, tip in enumerate(tips):
            inside = np.linalg.norm(self._points[:-1] - tip, axis=1) <= self._radius_mm[:-1] + YIELD_MM
            found[n] = self._narrowest_mm[inside].max(initial=0.0)
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
    limits = _Limits(lumen, radius, section_mm, sharpest)
    nearly: list[tuple[float, int, _Chains]] = []

    def is_wanted(tips: Floats, forward: Floats) -> NDArray[np.bool_]:
        wanted = _meets(tips, forward, centre, target.radius_mm, reach_mm)
        if near_lps is not None:
            wanted &= np.linalg.norm(tips - near_lps, axis=-1) <= near_mm
        return wanted

    def hits(tip: Floats, forward: Floats) -> float:
        is_wide = lumen.narrowest_mm(tip[None])[0] >= scope.fit_mm
        return needle_hits(tip, forward, target, reach_mm) if is_wide else 0.0

    for n in _places(truth, centre, within_mm, scope.fit_mm):
        bases, axes = _bases(truth, n, lumen, radius)
        tips = bases[:, None] + shapes.tips @ axes
        forward = shapes.forward @ axes
        hopeful = is_wanted(tips, forward)
        base, shape = np.nonzero(hopeful)
        chains = shapes.chains(shape, bases[base], axes[base])
        clearance = limits.clearance_mm(chains)
        for k in np.flatnonzero(clearance >= 0.0):
            tip, ahead = tips[base[k], shape[k]], forward[base[k], shape[k]]
            share = hits(tip, ahead)
            if share >= MIN_HITS:
                return Hold(tip, ahead, share, int(truth.branch[n]), float(truth.narrowest_mm[n]))
        if len(clearance) and clearance.max() >= -NEARLY_MM:
            best = int(np.argmax(clearance))
            nearly.append((-float(clearance[best]), n, chains.rows(np.array([best]))))
    nearly.sort(key=lambda one: one[:2])
    for _, n, chain in nearly[:NUM_REFINED]:
        found = _refined(limits, chain, truth.forward[n], is_wanted, hits)
        if found is not None:
            return Hold(*found, int(truth.branch[n]), float(truth.narrowest_mm[n]))
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

    def chains(self, which: NDArray[np.intp], bases: Floats, axes: Floats) -> _Chains:
        """Return chains, each a shape from its base (n, 3) in its axes (n, 3, 3)."""
        plane = np.einsum("ni,nij->nj", self.plane[which], axes)
        return _Chains(bases, axes[:, 2], plane, self.curvature[which], self.length_mm[which], self.rigid_mm)


@dataclass(frozen=True, slots=True, eq=False)
class _Chains:
    """Chains of shaft, arc and rigid tip; one row for each."""

    base: Floats
    """(n, 3) ends of the shafts, LPS mm."""
    shaft: Floats
    """(n, 3) directions of the shafts, unit vectors."""
    plane: Floats
    """(n, 3) unit vectors across the shafts, in the planes of the arcs."""
    curvature: Floats
    length_mm: Floats
    rigid_mm: float

    def rows(self, which: NDArray[Any]) -> _Chains:
        """Return the scope shapes with the given row numbers."""
        return _Chains(
            self.base[which],
            self.shaft[which],
            self.plane[which],
            self.curvature[which],
            self.length_mm[which],
            self.rigid_mm,
        )

    def ends(self) -> tuple[Floats, Floats]:
        """Return the tips (n, 3), and the directions (n, 3) in which the needles leave them."""
        aside, ahead = _on_arc(self.curvature, self.length_mm)
        angle = (self.curvature * self.length_mm)[:, None]
        forward = np.sin(angle) * self.plane + np.cos(angle) * self.shaft
        tips = self.base + aside[:, None] * self.plane + ahead[:, None] * self.shaft + self.rigid_mm * forward
        return tips, forward

    def arcs(self) -> Floats:
        """Return points (n, k, 3) of the arcs."""
        share = np.linspace(0.0, 1.0, 1 + math.ceil(float(self.length_mm.max(initial=0.0)) / CHAIN_STEP_MM))
        aside, ahead = _on_arc(self.curvature[:, None], share * self.length_mm[:, None])
        found: Floats = (
            self.base[:, None] + aside[..., None] * self.plane[:, None] + ahead[..., None] * self.shaft[:, None]
        )
        return found

    def changed(self, rng: np.random.Generator, scale: float, sharpest: float, section_mm: float) -> _Chains:
        """Return `NUM_CHANGES` random variations of the first scope shape."""
        one = self.rows(np.zeros(NUM_CHANGES, dtype=np.intp))
        turn = scale * math.radians(CHANGE_DEG)
        shaft = _unit(one.shaft + turn * rng.normal(size=(NUM_CHANGES, 3)))
        plane = one.plane + 2.0 * turn * rng.normal(size=(NUM_CHANGES, 3))
        plane = _unit(plane - (plane * shaft).sum(axis=1, keepdims=True) * shaft)
        amount = scale * CHANGE_SHARE * rng.normal(size=(2, NUM_CHANGES))
        return _Chains(
            one.base + scale * CHANGE_MM * rng.normal(size=(NUM_CHANGES, 3)),
            shaft,
            plane,
            np.clip(one.curvature + amount[0] * sharpest, 0.0, sharpest),
            np.clip(one.length_mm + amount[1] * section_mm, 0.0, section_mm),
            one.rigid_mm,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Limits:
    """Limits of a chain: the lumen, the scope's radius, and length and sharpest curvature of the bending section."""

    lumen: LumenDepth
    radius: float
    section_mm: float
    sharpest: float

    def clearance_mm(self, chains: _Chains) -> Floats:
        """Return the least distance in mm between the scope's surface and the wall, for each shape of the scope.

        A negative distance is the depth of the scope in the wall. If a shape is deeper than `NEARLY_MM` in the wall at
        one place, its other places are not examined, so its distance is only an upper limit.
        """
        tips, forward = chains.ends()
        clearance = self.lumen.at(tips) + YIELD_MM
        # A ball round a point less than a radius behind the face would extend beyond the face, so the face's rim is
        # tested.
        for at_mm in np.arange(min(self.radius, chains.rigid_mm), chains.rigid_mm + 1e-6, CHAIN_STEP_MM):
            left = np.flatnonzero(clearance >= -NEARLY_MM)
            self._lower(clearance, left, (tips[left] - at_mm * forward[left])[:, None], self.radius)
        left = np.flatnonzero(clearance >= -NEARLY_MM)
        self._lower(clearance, left, chains.rows(left).arcs(), self.radius)
        left = np.flatnonzero(clearance >= -NEARLY_MM)
        behind = np.arange(0.0, BEHIND_MM + 1e-6, CHAIN_STEP_MM)[None, :, None]
        self._lower(clearance, left, chains.base[left, None] - behind * chains.shaft[left, None], self.radius)
        left = np.flatnonzero(clearance >= -NEARLY_MM)
        self._lower(clearance, left, _rims(tips[left], forward[left], self.radius), 0.0)
        return clearance

    def _lower(self, clearance: Floats, rows: NDArray[np.intp], points: Floats, radius: float) -> None:
        if len(rows):
            clearance[rows] = np.minimum(clearance[rows], self.lumen.at(points).min(axis=-1) - radius + YIELD_MM)


def _refined(
    limits: _Limits,
    chain: _Chains,
    airway: Floats,
    is_wanted: Callable[[Floats, Floats], NDArray[np.bool_]],
    hits: Callable[[Floats, Floats], float],
) -> tuple[Floats, Floats, float] | None:
    """Return tip, direction and share of hits of a chain that fits and hits after small changes; None if none does.

    Parameters
    ----------
    limits, chain
        Limits of all chains, and one chain that nearly fits.
    airway
        (3,) direction of the airway at the shaft's end, from which the shaft differs by at most the largest tilt.
    is_wanted
        Function of tips and directions (n, 3) that returns which chains meet the target.
    hits
        Function of a tip and a direction (3,) that returns the share of needles that hit.
    """
    rng = np.random.default_rng(11)
    worth, scale = (min(float(limits.clearance_mm(chain)[0]), 0.0), 0.0), 1.0
    for _ in range(ROUNDS):
        tried = chain.changed(rng, scale, limits.sharpest, limits.section_mm)
        scale *= SHRINK
        allowed = is_wanted(*tried.ends()) & (tried.shaft @ airway >= math.cos(math.radians(max(TILTS_DEG))))
        tried = tried.rows(np.flatnonzero(allowed))
        clearance, (tips, forward) = np.minimum(limits.clearance_mm(tried), 0.0), tried.ends()
        for k in np.argsort(-clearance):
            if clearance[k] < worth[0]:
                break
            # The needles of a chain that does not fit are not counted, because the chain first has to fit.
            share = hits(tips[k], forward[k]) if clearance[k] >= 0.0 else 0.0
            if (float(clearance[k]), share) > worth:
                worth, chain = (float(clearance[k]), share), tried.rows(np.array([k]))
            if clearance[k] >= 0.0 and share >= MIN_HITS:
                return tips[k], forward[k], share
    return None


def _on_arc(curvature: Floats, length_mm: Floats) -> tuple[Floats, Floats]:
    """Return the sideways and the forward displacement along an arc of a length from its start, mm."""
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


def _rims(tips: Floats, forward: Floats, radius: float) -> Floats:
    """Return points (n, k, 3) on the rims of the faces of tips (n, 3)."""
    across = _unit(np.cross(forward, np.eye(3)[np.argmin(np.abs(forward), axis=-1)]))
    up = np.cross(forward, across)
    turn = 2.0 * np.pi * np.arange(NUM_RIM)[:, None] / NUM_RIM
    rim: Floats = tips[:, None] + radius * (np.cos(turn) * across[:, None] + np.sin(turn) * up[:, None])
    return rim


def _unit(vectors: Floats) -> Floats:
    found: Floats = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return found


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
