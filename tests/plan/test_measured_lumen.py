"""Tests of the measured lumen of a route in a phantom with known diameters."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import phantom_plan
import pytest

from cached_test_data import cached_phantom
from carina.phantom import lumen_distance_at
from carina.plan.routes.measured_lumen import MeasuredLumen, measured_lumen
from carina.plan.routes.route_width import measures_of
from carina.scopes import WallField
from carina.track import Branch


def lineages() -> list[list[Branch]]:
    """Return the lineages of the ten tips of the tree that are farthest from the root."""
    tree = phantom_plan.airways().tree
    tips = sorted(tree.tips(), key=lambda tip: -sum(one.length_mm for one in tree.lineage(tip.id)))
    return [tree.lineage(tip.id) for tip in tips[:10]]


def lumen_of(lineage: list[Branch]) -> MeasuredLumen:
    measures = measures_of(phantom_plan.volume(), phantom_plan.airways(), None)
    found = measured_lumen(lineage, phantom_plan.wall(), measures)
    assert found is not None
    return found


def test_measured_lumen_has_the_true_radius_where_the_segmented_one_is_too_narrow() -> None:
    wall = phantom_plan.wall()
    rows = cached_phantom(**phantom_plan.CHEST).truth["branches"]
    points, radii = (np.concatenate([np.array(row[name]) for row in rows]) for name in ("points", "radius"))
    segmented, measured, least = [], [], []
    for lineage in lineages():
        lumen = lumen_of(lineage)
        # Beyond 60 points the airways are narrow; near forks the nearest true point may be in another branch.
        axis = lumen.axis_lps[60:]
        off = np.linalg.norm(points[None] - axis[:, None], axis=-1)
        near = off.argmin(axis=1)
        own = (off.min(axis=1) < 0.4) & (radii[near] < 3.0)
        true_mm = radii[near][own]
        segmented.append(wall.distance_mm(axis[own]) - true_mm)
        measured.append(lumen.widened(wall).distance_mm(axis[own]) - true_mm)
        least.append(lumen.narrowest(wall, error_share=0.78).distance_mm(axis[own]) - true_mm)
    narrow, wide, low = (np.concatenate(part) for part in (segmented, measured, least))
    assert len(wide) > 100
    assert np.median(narrow) < -0.2 and abs(np.median(wide)) < 0.2
    assert np.median(low) < 0.05 and np.quantile(low, 0.9) < 0.3


def test_measured_lumen_near_a_fork_does_not_extend_into_the_carina() -> None:
    wall, excess = phantom_plan.wall(), []
    for lineage in lineages():
        lumen = lumen_of(lineage)
        forks = np.array([branch.points[-1] for branch in lineage[:-1]])
        near = np.linalg.norm(lumen.axis_lps[:, None] - forks, axis=2).min(axis=1) < 4.0
        near &= lumen.ball_mm < 3.5
        axis = lumen.axis_lps[near]
        true_mm = -lumen_distance_at(axis, seed=phantom_plan.CHEST["seed"])
        excess.append(lumen.widened(wall).distance_mm(axis) - np.fmax(true_mm, lumen.ball_mm[near]))
    wide = np.concatenate(excess)
    assert len(wide) > 100
    assert np.median(wide) < 0.1 and np.quantile(wide, 0.95) < 0.35 and wide.max() < 0.5


def test_measured_lumen_ignores_a_section_whose_centre_is_behind_a_wall() -> None:
    lineage = lineages()[0]
    measures = measures_of(phantom_plan.volume(), phantom_plan.airways(), None)
    tip = measures.of(lineage[-1].id)
    aside = np.cross(tip.normal_lps, [0.3, 0.5, 0.8])
    aside *= 4.0 / np.linalg.norm(aside, axis=1, keepdims=True)
    astray = dataclasses.replace(tip, centre_lps=tip.centre_lps + aside)
    branches = tuple(astray if one is tip else one for one in measures.branches)
    found = measured_lumen(lineage, phantom_plan.wall(), dataclasses.replace(measures, branches=branches))
    usual = lumen_of(lineage)
    assert found is not None and len(found.axis_lps) == len(usual.axis_lps)
    assert np.linalg.norm(found.axis_lps - usual.axis_lps, axis=1).max() < 1.5
    assert (found.lack_mm[-len(tip.at_mm) :] <= usual.lack_mm.max()).all()


@pytest.mark.parametrize("length_mm", [0.4, 0.8, 1.6])
def test_measured_lumen_beside_a_short_stenosis_does_not_fill_the_stenosis(length_mm: float) -> None:
    # A tube with a radius of 1.5 mm has a web with an opening of 0.7 mm, as exact distances 0.2 mm apart.
    step, num = 0.2, 61
    k, j, i = (np.indices((num, num, num)) - num // 2) * step
    across, along = np.hypot(i, j), np.maximum(np.abs(k) - 0.5 * length_mm, 0.0)
    to_web = np.hypot(np.maximum(0.7 - across, 0.0), along)
    distance = np.where((along == 0.0) & (across > 0.7), 0.7 - across, np.minimum(1.5 - across, to_web))
    place = np.diag([step, step, step, 1.0])
    place[:3, 3] = -step * (num // 2)
    wall = WallField.from_distances(distance.astype(np.float32), place)
    at = np.arange(-5.0, 5.01, 0.3)
    axis = np.stack([np.zeros_like(at), np.zeros_like(at), at], axis=1)
    ball = wall.ball_mm(axis)
    radius = np.where(np.abs(at) <= 0.5 * length_mm, 0.7, 1.5)
    wide = MeasuredLumen(axis, ball, radius - ball, np.zeros_like(at), ball - radius).widened(wall)
    assert wide.distance_mm(axis).min() < 0.8
    assert wide.distance_mm([[0.0, 0.0, 3.0]])[0] == pytest.approx(1.5, abs=0.01)


def test_measured_lumen_without_a_narrow_place_or_a_lack_leaves_the_wall_unchanged() -> None:
    wall, lumen = phantom_plan.wall(), lumen_of(lineages()[0])
    wide = dataclasses.replace(lumen, lack_mm=np.full_like(lumen.lack_mm, -0.5))
    assert wide.widened(wall) is wall
    trachea = phantom_plan.airways().tree.root
    measures = measures_of(phantom_plan.volume(), phantom_plan.airways(), None)
    found = measured_lumen([trachea], wall, measures)
    assert found is None or (found.widened(wall).distance_mm(trachea.points) >= wall.distance_mm(trachea.points)).all()


def test_narrowest_lumen_is_narrower_than_a_segmented_lumen_that_is_too_wide() -> None:
    wall = phantom_plan.wall()
    lumen = lumen_of(lineages()[0])
    half_mm = 0.5 * lumen.error_mm
    wide = dataclasses.replace(lumen, lack_mm=np.full_like(half_mm, -0.5), surplus_mm=np.full_like(half_mm, 0.5))
    assert wide.widened(wall) is wall
    narrow = wide.narrowest(wall, error_share=0.8)
    # Beside the axis, where the field of samples is exact, the wall moves by the surplus and the error.
    across = np.cross(np.gradient(lumen.axis_lps, axis=0), [0.3, 0.5, 0.8])
    aside = lumen.axis_lps + 0.4 * lumen.ball_mm[:, None] * across / np.linalg.norm(across, axis=1, keepdims=True)
    before, after = wall.distance_mm(aside)[5:-5], narrow.distance_mm(aside)[5:-5]
    assert before - after == pytest.approx(0.5 + 0.8 * half_mm[5:-5], abs=0.15)
    # A surplus that is nowhere above the error changes nothing.
    exact = dataclasses.replace(wide, surplus_mm=np.full_like(half_mm, -np.inf))
    assert exact.narrowest(wall, error_share=0.8) is wall


def test_routes_of_a_plan_have_their_measured_lumen_and_can_be_pickled() -> None:
    routes = phantom_plan.plan().routes
    assert routes and all(route.lumen is not None for route in routes)
    again = pickle.loads(pickle.dumps(routes[0].lumen))
    assert again.ball_mm == pytest.approx(routes[0].lumen.ball_mm)
