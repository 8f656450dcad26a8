"""Tests of the reach atlas, which marks the parts of the lungs that a scope and a tool can reach."""

from __future__ import annotations

import dataclasses
import importlib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
from nodules import ellipsoid

from cached_test_data import cached_airways, cached_phantom
from carina.errors import CancelledError
from carina.plan import NeedleErrors, plan_route
from carina.plan.reach_atlas import NOT, REACHES, STEP_MM, ReachAtlas, reach_atlas
from carina.plan.routes.needle_hits import ball_hit_shares, hit_share
from carina.plan.routes.ranking import RANK
from carina.scopes import ScopePreset, scope_preset
from carina.track import TreeMeasures, measure_tree, wall_field

CHEST = {"seed": 4, "spacing_mm": 1.5, "generations": 4}


@pytest.fixture(scope="module")
def chest():
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    return volume, airways, wall_field(volume, airways)


@pytest.fixture(scope="module")
def measures(chest) -> TreeMeasures:
    volume, airways, _ = chest
    return measure_tree(volume, airways)


@pytest.fixture(scope="module", autouse=True)
def one_lung_grid() -> Iterator[None]:
    """Compute the grid of the lungs, with which every atlas of the chest begins, once."""
    # The package exports a function with the name of the module.
    module = importlib.import_module("carina.plan.reach_atlas")
    with patch.object(module, "lung_box", cache(module.lung_box)):
        yield


@pytest.fixture(scope="module")
def slim_atlas(chest, measures) -> ReachAtlas:
    volume, airways, wall = chest
    return reach_atlas(volume, airways, scope=slim(), wall=wall, measures=measures)


def slim() -> ScopePreset:
    """Return a thin scope whose channel takes a needle."""
    return dataclasses.replace(scope_preset("ultrathin"), channel_mm=2.0)


def closest_mm(centres: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance of each centre (n, 3) to the closest of the points (m, 3)."""
    squares = (centres**2).sum(axis=1)[:, None] - 2.0 * centres @ points.T + (points**2).sum(axis=1)
    return np.sqrt(np.maximum(squares.min(axis=1), 0.0))


def test_reach_of_lung_regions_agrees_with_estimated_plans_for_targets_in_them(chest, measures, slim_atlas) -> None:
    volume, airways, wall = chest
    found = slim_atlas
    rng = np.random.default_rng(3)
    counts: Counter[tuple[int, int]] = Counter()
    for value in (NOT, REACHES):
        points = np.concatenate([branch.points for branch in airways.tree.branches if branch.generation > 1])
        voxels = np.argwhere(found.lung_zyx & (found.reach_zyx == value))
        centres = voxels[:, ::-1] * STEP_MM + found.lps_from_ijk[:3, 3]
        # Only voxels that a needle might reach are compared, because all others are trivially not reached.
        parts = np.array_split(centres, len(centres) // 2000 + 1)
        near = np.concatenate([closest_mm(part, points) < 20.0 for part in parts])
        for centre in rng.permutation(centres[near])[:7]:
            ball = ellipsoid((5.0, 5.0, 5.0), centre)
            plan = plan_route(
                volume,
                airways,
                ball,
                scope=slim(),
                wall=wall,
                measures=measures,
                moved_mm=0.0,
                drives=0,
                confirmed=True,
            )
            best = max((REACHES - RANK[route.outlook] for route in plan.routes), default=NOT)
            counts[value, best] += 1
    agreed = sum(num for (atlas, plan), num in counts.items() if atlas == plan)
    # Atlas and plans test directions and tip positions at different intervals, so voxels at a border may differ by one
    # class.
    assert agreed >= 0.85 * counts.total(), counts
    assert counts[REACHES, NOT] == counts[NOT, REACHES] == 0, counts


def test_hit_shares_computed_for_a_ball_equal_those_of_a_ball_shaped_nodule() -> None:
    ball, reach_mm = ellipsoid((5.0, 5.0, 5.0), (0.0, 0.0, 0.0), step_mm=0.25), 15.0
    distances, angles = np.array([0.0, 3.0, 8.0, 14.0, 19.0, 12.0, 12.0, 9.0]), np.radians([0, 0, 0, 0, 0, 10, 25, 35])
    shares = ball_hit_shares(distances, angles, 5.0, reach_mm, NeedleErrors())
    for distance, angle, share in zip(distances, angles, shares, strict=True):
        tip = np.array([0.0, 0.0, -distance])
        aim = tip + distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
        assert share == pytest.approx(hit_share(ball, tip, aim, reach_mm, NeedleErrors()), abs=0.04), (distance, angle)


def test_scope_with_a_long_rigid_tip_reaches_less_of_the_lungs(chest, measures, slim_atlas) -> None:
    volume, airways, wall = chest
    stiff = dataclasses.replace(slim(), rigid_tip_mm=30.0)
    rigid = reach_atlas(volume, airways, scope=stiff, wall=wall, measures=measures)
    assert 0.0 < rigid.reached_ml < 0.7 * slim_atlas.reached_ml


def test_atlas_of_a_tool_that_does_not_pass_the_channel_is_empty_and_states_why(chest, measures) -> None:
    volume, airways, wall = chest
    found = reach_atlas(volume, airways, scope="ultrathin", wall=wall, measures=measures)
    assert found.why is not None and "does not fit the working channel" in found.why
    assert found.reached_ml == 0.0 and max(found.tip_mm.values()) > 0.0
    brush = reach_atlas(volume, airways, scope="ultrathin", tool="brush", wall=wall, measures=measures)
    assert brush.why is None and 0.0 < brush.reached_ml < brush.lung_ml


def test_thinner_scope_or_longer_tool_reaches_at_least_as_much_of_the_lungs(chest, measures, slim_atlas) -> None:
    volume, airways, wall = chest
    thin = slim_atlas
    thick = reach_atlas(volume, airways, scope="therapeutic", wall=wall, measures=measures)
    far = reach_atlas(volume, airways, scope=slim(), tool="needle-21g-long", wall=wall, measures=measures)
    assert all(thin.tip_mm[b] >= mm for b, mm in thick.tip_mm.items())
    assert thick.reached_ml < thin.reached_ml <= far.reached_ml <= far.lung_ml
    assert (far.reach_zyx >= thin.reach_zyx).all()
    assert not thin.reach_zyx[~thin.lung_zyx].any()
    assert thin.at((1e4, 0.0, 0.0)) is None
    k, j, i = np.argwhere(thin.reach_zyx == REACHES)[0]
    assert thin.at(thin.lps_from_ijk[:3, 3] + STEP_MM * np.array([i, j, k])) == "reaches"
    assert set(thin.to_json()) == {"scope", "tool", "lung_ml", "reached_ml", "tip_mm", "target_mm", "why"}


def test_computation_of_the_reach_atlas_can_be_cancelled(chest) -> None:
    volume, airways, wall = chest
    fractions: list[float] = []
    reach_atlas(volume, airways, wall=wall, progress=lambda _what, share: fractions.append(share))
    assert fractions[0] == 0.0 and fractions[-1] == 1.0 and fractions == sorted(fractions)
    with pytest.raises(CancelledError):
        reach_atlas(volume, airways, wall=wall, cancel=lambda: True)
