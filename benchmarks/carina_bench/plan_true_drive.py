"""Drives of a scope in the true airways of a case, to the end of a planned route.

The drive shows that the route exists in the truth, so it may be any drive: the moves that the plan states, or those of
several searches. The wall is that of the lumen from which the CT was made, rounded carinas included (`PlanCase.lumen`).
It is sampled along the route alone, and the true centrelines with their radii are added as an exact tube: between its
samples, a sampled wall would make a narrow airway narrower.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError
from carina.plan import NeedleErrors, Plan, judge_scope, place_at_start, search_drive
from carina.plan.verdict.drive import MoveRecorder
from carina.plan.verdict.drive_aim import aim_drive
from carina.plan.verdict.drive_route import DriveWay
from carina.scopes import ScopePreset, WallField
from carina_bench.plan_cases import Lumen, PlanCase, Target, TrueTree

__all__ = ["needle_hits_from", "points_in_truth", "strikes", "wall_along"]

Floats = NDArray[np.float64]

STEP_MM, MARGIN_MM, OUTSIDE_MM = 0.4, 10.0, -6.0
"""Spacing of the sampled wall, its extent beside the route, and the distance stored outside the lumen, mm."""
BALL_MARGIN_MM = 3.0
"""Maximum distance in mm outside the true wall at which distances to the wall are sampled."""
NEAR_WALL_MM = (-2.0, 1.5)
"""Distances in mm from the wall of the union of balls between which the samples use the exact lumen.

Fillets move the wall of the union outwards by at most an eighth of a radius; deep inside the lumen no scope is near the
wall.
"""
TUBE_MM = 4.2
"""Maximum radius in mm of the exact tube; a wider lumen is wide enough for every scope."""
NUM_SEARCHES, EFFORT = 3, 20_000.0
"""Number of searches for a drive in the true airways, with different seeds, and the effort of each."""
MIN_HITS, NUM_NEEDLES, EDGE_MM = 0.5, 400, 0.05
"""Minimum share of needles that hit, number of simulated needles, and spacing of the tested points of a needle, mm."""


def points_in_truth(case: PlanCase, target: Target, plan: Plan, place: int) -> bool:
    """Return whether a drive along the first route in the true wall ends with a pose that hits the true nodule.

    Parameters
    ----------
    case, target, plan
        Case with its truth, the true nodule and the plan whose first route is driven.
    place
        Index of the true centreline's point at the end of the route.
    """
    assert case.airways is not None and case.wall is not None
    tree, route, reach_mm, scope = case.airways.tree, plan.routes[0], plan.tool.reach_mm, plan.scope
    if case.truth.narrowest_mm[place] < max(scope.tip_mm, scope.tube_mm or 0.0):
        return False
    lineage = case.truth.lineage(int(case.truth.branch[place]))
    wall = wall_along(case.truth, tree.route_to(route.branch_id).points_lps, lumen=case.lumen, lineage=lineage)
    way = DriveWay(tree, route, wall)
    planned = judge_scope(tree, plan, case.wall, scope).driven
    if planned is not None and planned.arrived:
        recorder = MoveRecorder(place_at_start(way, wall, scope))
        recorder.repeat(planned.moves)
        if strikes(recorder.state.pose.lps_from_camera, target, reach_mm):
            return True
    return any(strikes(tip, target, reach_mm) for tip in _aimed(way, wall, scope, target, reach_mm))


def _aimed(way: DriveWay, wall: WallField, scope: ScopePreset, target: Target, reach_mm: float) -> Iterator[Floats]:
    """Yield the final poses of the drives that arrive and are aimed at the true nodule."""

    def share(tip: Floats, forward: Floats) -> float:
        return needle_hits_from(_pose(tip, forward), target, reach_mm)

    for seed in range(NUM_SEARCHES):
        try:
            driven = search_drive(way, wall, scope, effort=EFFORT, seed=seed)
        except UsageError:
            return
        if driven.arrived:
            yield aim_drive(way, wall, scope, driven, share).lps_from_tip


def wall_along(truth: TrueTree, path: Floats, *, lumen: Lumen | None = None, lineage: Sequence[int] = ()) -> WallField:
    """Return the true wall near a path; the lumen farther from the path counts as closed.

    Parameters
    ----------
    truth
        True centrelines with their radii.
    path
        (n, 3) points of the path, LPS mm, less than `MARGIN_MM` apart.
    lumen
        Exact distances to the lumen from which the CT was made; None for the union of the true balls, whose carinas
        are sharp.
    lineage
        Indices of the true branches along the path, whose narrow parts are added as an exact tube.
    """
    low, high = path.min(axis=0) - MARGIN_MM, path.max(axis=0) + MARGIN_MM
    size = np.ceil((high - low) / STEP_MM).astype(int) + 1
    inside = np.full(size[::-1], OUTSIDE_MM, dtype=np.float32)
    for point, radius in zip(truth.points, truth.radius_mm, strict=True):
        if float(np.linalg.norm(path - point, axis=1).min()) > radius + MARGIN_MM:
            continue
        half = radius + BALL_MARGIN_MM
        begin = np.clip(np.floor((point - half - low) / STEP_MM).astype(int), 0, size)
        end = np.clip(np.ceil((point + half - low) / STEP_MM).astype(int) + 1, begin, size)
        x, y, z = ((low[a] + STEP_MM * np.arange(begin[a], end[a]) - point[a]).astype(np.float32) for a in range(3))
        ball = np.float32(radius) - np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
        part = inside[begin[2] : end[2], begin[1] : end[1], begin[0] : end[0]]
        np.maximum(part, ball, out=part)
    if lumen is not None:
        near = np.nonzero((inside > NEAR_WALL_MM[0]) & (inside < NEAR_WALL_MM[1]))
        inside[near] = -lumen(low + STEP_MM * np.stack(near[::-1], axis=1))
    lps_from_grid = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    lps_from_grid[:3, 3] = low
    return _with_tubes(WallField.from_distances(inside, lps_from_grid), truth, lineage)


def _with_tubes(wall: WallField, truth: TrueTree, lineage: Sequence[int]) -> WallField:
    """Return a wall with the narrow end of a line of true branches as an exact tube."""
    own = np.concatenate([np.flatnonzero(truth.branch == branch) for branch in lineage] or [np.array([], dtype=int)])
    wide = np.flatnonzero(truth.radius_mm[own] > TUBE_MM)
    narrow = own[int(wide[-1]) + 1 if len(wide) else 0 :]
    return wall if len(narrow) < 2 else wall.with_tube(truth.points[narrow], truth.radius_mm[narrow])


def needle_hits_from(lps_from_tip: Floats, target: Target, reach_mm: float) -> float:
    """Return the share of needles with random errors that meet a target, from a tip in its direction."""
    rng = np.random.default_rng(5)
    off = np.array(target.centre_lps) - lps_from_tip[:3, 3]
    distance = max(float(np.linalg.norm(off)), 1e-6)
    sigma = math.hypot(math.radians(NeedleErrors().angle_deg), NeedleErrors().tip_mm / distance)
    ways = lps_from_tip[:3, 2] + sigma * rng.normal(size=(NUM_NEEDLES, 2)) @ lps_from_tip[:3, :2].T
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    along = np.clip(ways @ off, 0.0, reach_mm)
    return float((np.linalg.norm(along[:, None] * ways - off, axis=1) <= target.radius_mm).mean())


def strikes(lps_from_tip: Floats, target: Target, reach_mm: float) -> bool:
    """Return whether a needle without errors meets a target from a tip, and at least half of those with errors do."""
    along = np.arange(0.0, reach_mm + 1e-9, EDGE_MM)[:, None]
    line = lps_from_tip[:3, 3] + along * lps_from_tip[:3, 2]
    meets = bool((np.linalg.norm(line - np.array(target.centre_lps), axis=1) <= target.radius_mm).any())
    return meets and needle_hits_from(lps_from_tip, target, reach_mm) >= MIN_HITS


def _pose(tip: Floats, forward: Floats) -> Floats:
    """Return a pose (4, 4) of a tip in a direction, with any roll."""
    across = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    across /= np.linalg.norm(across)
    found = np.eye(4)
    found[:3, :3] = np.stack([across, np.cross(forward, across), forward], axis=1)
    found[:3, 3] = tip
    return found
