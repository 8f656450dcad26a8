"""Tests of the measured lumen of a route in a phantom with known diameters."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import phantom_plan
import pytest

from cached_test_data import cached_phantom
from carina.plan.routes.measured_lumen import MeasuredLumen, measured_lumen
from carina.plan.routes.route_width import measures_of
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
        least.append(lumen.widened(wall, error_share=0.78).distance_mm(axis[own]) - true_mm)
    narrow, wide, low = (np.concatenate(part) for part in (segmented, measured, least))
    assert len(wide) > 100
    assert np.median(narrow) < -0.2 and abs(np.median(wide)) < 0.2
    assert np.median(low) < 0.05 and np.quantile(low, 0.9) < 0.3


def test_measured_lumen_without_a_narrow_place_or_a_lack_leaves_the_wall_unchanged() -> None:
    wall, lumen = phantom_plan.wall(), lumen_of(lineages()[0])
    wide = dataclasses.replace(lumen, lack_mm=np.full_like(lumen.lack_mm, -0.5))
    assert wide.widened(wall) is wall
    trachea = phantom_plan.airways().tree.root
    measures = measures_of(phantom_plan.volume(), phantom_plan.airways(), None)
    found = measured_lumen([trachea], wall, measures)
    assert found is None or (found.widened(wall).distance_mm(trachea.points) >= wall.distance_mm(trachea.points)).all()


def test_routes_of_a_plan_have_their_measured_lumen_and_can_be_pickled() -> None:
    routes = phantom_plan.plan().routes
    assert routes and all(route.lumen is not None for route in routes)
    again = pickle.loads(pickle.dumps(routes[0].lumen))
    assert again.ball_mm == pytest.approx(routes[0].lumen.ball_mm)
