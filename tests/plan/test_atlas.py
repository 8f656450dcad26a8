"""Tests of the reach atlas, which marks the parts of the lungs that a scope and a tool can reach."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina.errors import CancelledError
from carina.plan.reach_atlas import MOST_ANGLE_DEG, NOT, REACHES, reach_atlas
from carina.scopes import scope_preset
from carina.track import wall_field
from made import made_airways, made_phantom

CHEST = {"seed": 4, "spacing_mm": 1.5, "generations": 4}


@pytest.fixture(scope="module")
def chest():
    volume, airways = made_phantom(**CHEST).volume, made_airways(**CHEST)
    return volume, airways, wall_field(volume, airways)


def test_reach_of_points_equals_a_direct_search(chest) -> None:
    volume, airways, wall = chest
    # This scope is very thin and bends without limit, so that it reaches every position in every airway.
    wire = dataclasses.replace(scope_preset("ultrathin"), tip_mm=0.1, tube_mm=0.1, flexion_deg=(360.0, 360.0))
    found = reach_atlas(volume, airways, scope=wire, wall=wall)
    points = np.concatenate([b.points for b in airways.tree.branches])
    forward = np.concatenate([np.gradient(b.points, axis=0) for b in airways.tree.branches])
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    rng = np.random.default_rng(3)
    inside = np.argwhere(found.lung_zyx)
    for k, j, i in inside[rng.choice(len(inside), 300, replace=False)]:
        at = found.lps_from_ijk[:3, :3] @ (i, j, k) + found.lps_from_ijk[:3, 3]
        off = at - points
        away = np.linalg.norm(off, axis=1)
        angle = np.degrees(np.arccos(np.clip((off * forward).sum(axis=1) / np.maximum(away, 1e-9), -1.0, 1.0)))
        # The atlas has a position every 2 mm, so the direct search uses a margin near the limits.
        surely = bool(((away <= found.tool.reach_mm - 2.0) & (angle <= MOST_ANGLE_DEG - 10.0)).any())
        never = not bool(((away <= found.tool.reach_mm + 2.0) & (angle <= MOST_ANGLE_DEG + 10.0)).any())
        told = found.reach_zyx[k, j, i]
        # A point near a doubtful branch may be marked "may reach".
        assert not surely or told != NOT
        assert not never or told == NOT
        assert found.at(at) == ("does not reach", "may reach", "reaches")[told]
    assert (found.reach_zyx == REACHES).any()
    assert all(mm > 0.0 for mm in found.tip_mm.values())


def test_thinner_scope_and_longer_tool_reach_at_least_as_much_of_the_lungs(chest) -> None:
    volume, airways, wall = chest
    thin = reach_atlas(volume, airways, scope="ultrathin", wall=wall)
    thick = reach_atlas(volume, airways, scope="therapeutic", wall=wall)
    far = reach_atlas(volume, airways, scope="ultrathin", tool="needle-21g-long", wall=wall)
    assert all(thin.tip_mm[b] >= mm for b, mm in thick.tip_mm.items())
    assert thick.reached_ml < thin.reached_ml <= far.reached_ml <= far.lung_ml
    assert (far.reach_zyx >= thin.reach_zyx).all()
    assert not thin.reach_zyx[~thin.lung_zyx].any()
    assert thin.at((1e4, 0.0, 0.0)) is None
    assert set(thin.to_json()) == {"scope", "tool", "lung_ml", "reached_ml", "tip_mm"}


def test_reach_atlas_can_be_cancelled(chest) -> None:
    volume, airways, wall = chest
    told: list[float] = []
    reach_atlas(volume, airways, wall=wall, progress=lambda _what, share: told.append(share))
    assert told[0] == 0.0 and told[-1] == 1.0 and told == sorted(told)
    with pytest.raises(CancelledError):
        reach_atlas(volume, airways, wall=wall, cancel=lambda: True)
