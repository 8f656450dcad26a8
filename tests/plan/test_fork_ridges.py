"""Tests of the ridges between the branches of forks."""

from __future__ import annotations

import math

import numpy as np
import phantom_plan
import pytest

from carina.phantom import lumen_distance_at
from carina.plan.routes.fork_ridges import HALF_PLATE_MM, HIDDEN_SHARE, ForkRidge, RouteRidges, fork_ridges
from carina.scopes import WallField
from carina.track import Branch

RADIUS_MM, HALF_DEG = 2.0, 35.0
SPACING_MM = 1.2 / HIDDEN_SHARE
"""Coarsest spacing in mm of a CT whose blur hides 1.2 mm of each ridge."""


def junction() -> tuple[list[Branch], WallField]:
    """Return three branches, the second and third of which leave the first at 35 degrees, and their wall."""
    half = math.radians(HALF_DEG)
    ahead = np.array([0.0, 0.0, -1.0])
    ways = [ahead, *(np.array([sign * math.sin(half), 0.0, -math.cos(half)]) for sign in (1.0, -1.0))]
    starts = [np.array([0.0, 0.0, 15.0]), np.zeros(3), np.zeros(3)]
    at = np.arange(0.0, 15.01, 0.5)
    lines = [start + at[:, None] * way for start, way in zip(starts, ways, strict=True)]
    branches = [
        Branch(
            n, None if n == 0 else 0, (1, 2) if n == 0 else (), n, None, "tracked", line, np.full(len(at), RADIUS_MM)
        )
        for n, line in enumerate(lines)
    ]
    step, low = 0.25, np.array([-14.0, -5.0, -17.0])
    k, j, i = np.indices((140, 41, 113))
    points = low + step * np.stack([i, j, k], axis=-1).reshape(-1, 3)
    depth = np.full(len(points), -9.0)
    for start, way in zip(starts, ways, strict=True):
        along = np.clip((points - start) @ way, 0.0, 15.0)
        away = np.linalg.norm(points - start - along[:, None] * way, axis=1)
        depth = np.maximum(depth, RADIUS_MM - away)
    place = np.diag([step, step, step, 1.0])
    place[:3, 3] = low
    return branches, WallField.from_distances(depth.reshape(k.shape).astype(np.float32), place)


def test_ridge_of_two_tubes_is_where_their_walls_meet() -> None:
    branches, wall = junction()
    (ridge,) = fork_ridges(branches[:2], branches, wall, spacing_mm=SPACING_MM).ridges
    assert ridge.branch_ids == (1, 2)
    assert ridge.edge_lps == pytest.approx([0.0, 0.0, -RADIUS_MM / math.sin(math.radians(HALF_DEG))], abs=0.3)
    assert ridge.into_parent == pytest.approx([0.0, 0.0, 1.0], abs=0.02)
    assert np.abs(ridge.along_edge) == pytest.approx([0.0, 1.0, 0.0], abs=0.02)
    # The width is that of the lens between both tubes 0.5 mm before the edge.
    off_axis_mm = (RADIUS_MM / math.sin(math.radians(HALF_DEG)) - 0.5) * math.sin(math.radians(HALF_DEG))
    assert ridge.half_width_mm == pytest.approx(math.sqrt(RADIUS_MM**2 - off_axis_mm**2), abs=0.35)


def test_longer_ridge_is_part_of_the_wall_up_to_the_hidden_length() -> None:
    branches, wall = junction()
    found = fork_ridges(branches[:2], branches, wall, spacing_mm=SPACING_MM)
    longer = found.lengthened(wall)
    (ridge,) = found.ridges
    line = ridge.edge_lps + np.arange(-0.8, 4.0, 0.1)[:, None] * ridge.into_parent
    before, after = wall.distance_mm(line), longer.distance_mm(line)
    far = np.arange(-0.8, 4.0, 0.1)
    assert (before[far > 0.4] > 0.0).all()
    assert (after[far < 1.15] < 0.0).all() and (after[far > 1.25] > 0.0).all()
    assert (after <= before + 1e-9).all()
    # The distance to the wall is unchanged beside the ridge, and on a route without ridges.
    outer = branches[1].points[12:] + np.array([1.0, 0.0, 0.0])
    assert (longer.distance_mm(outer) == wall.distance_mm(outer)).all()
    assert RouteRidges((), 1.2).lengthened(wall) is wall


def test_true_ridges_are_at_most_as_long_as_the_stated_hidden_length_in_nine_of_ten_forks() -> None:
    tree, wall = phantom_plan.airways().tree, phantom_plan.wall()
    hidden_mm = []
    far = np.arange(-3.0, 4.0, 0.05)
    for parent in tree.branches:
        if len(parent.children) < 2:
            continue
        child = next(branch for branch in tree.branches if branch.id == parent.children[0])
        for ridge in fork_ridges([parent, child], tree.branches, wall, spacing_mm=1.0).ridges:
            line = ridge.edge_lps + far[:, None] * ridge.into_parent
            true = _end_mm(far, -lumen_distance_at(line, seed=phantom_plan.CHEST["seed"]))
            hidden_mm.append(true - _end_mm(far, wall.distance_mm(line)))
    hidden = np.array(hidden_mm)
    hidden = hidden[np.isfinite(hidden)]
    assert len(hidden) > 40
    assert (hidden <= HIDDEN_SHARE * phantom_plan.CHEST["spacing_mm"]).mean() >= 0.9
    assert 0.0 < np.median(hidden) < 0.3


def _end_mm(far: np.ndarray, depth: np.ndarray) -> float:
    """Return the value of ``far`` at which the wall nearest to a ridge's edge ends towards the parent; NaN if none."""
    inside = np.flatnonzero(depth <= 0.0)
    if not len(inside):
        return math.nan
    n = int(inside[np.argmin(np.abs(far[inside]))])
    while n + 1 < len(far) and depth[n + 1] <= 0.0:
        n += 1
    return float(far[n]) if n + 1 < len(far) else math.nan


def test_forks_without_a_wall_between_their_branches_have_no_ridge() -> None:
    branches, wall = junction()
    short = [branch if branch.id == 0 else _cut(branch) for branch in branches]
    assert fork_ridges(short[:2], short, wall, spacing_mm=1.0).ridges == ()
    assert fork_ridges(branches[:1], branches, wall, spacing_mm=1.0).ridges == ()


def _cut(branch: Branch) -> Branch:
    return Branch(branch.id, 0, (), 1, None, "tracked", branch.points[:5], branch.radius[:5])


def test_plate_of_a_ridge_has_its_edge_at_the_requested_distance() -> None:
    ridge = ForkRidge((1, 2), np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), 2.5)
    middle, into, along = ridge.plate_lps(0.9)
    assert (middle + into)[2] + HALF_PLATE_MM == pytest.approx(3.9)
    assert (middle - into)[2] == pytest.approx(2.0)
    assert np.linalg.norm(along) == pytest.approx(2.5) and into @ along == 0.0
