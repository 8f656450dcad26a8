"""Tests of the published predictors of a route, against analytic tubes and an independent calculation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from fork_trees import made_tree, random_tree
from phantom_plan import airways, plan, volume, wall

from carina.cli.plan import lines
from carina.plan import PREDICTOR_WORDS, PlannedRoute, route_predictors
from carina.plan.routes.predictors import mean_curvature
from carina.plan.routes.route_width import width_of_section
from carina.server.to_wire.plan import _route
from carina.track import AirwayTree, measure_tree
from carina_bench.plan_predictors import LIMITS, angle_by_definition, curvature_by_definition, predictor_rows


def arc_tree(angle_deg: float, curvature: float) -> AirwayTree:
    """Return a straight parent of 60 mm and a circular child of 40 mm that leaves it at an angle; diameter 5 and 3 mm.

    The child turns by its curvature in the plane of both branches, and its chord over two diameters has the angle.
    """
    parent = np.array([[0.0, 0.0, -z] for z in np.arange(0.0, 60.1, 0.5)])
    along = np.arange(0.0, 40.01, 0.5)
    # The chord over two diameters (6 mm) of an arc has the direction of the arc's middle.
    turn = math.radians(angle_deg) + curvature * (along - 3.0)
    start = math.radians(angle_deg) - 3.0 * curvature
    if curvature:
        side, down = (math.cos(start) - np.cos(turn)) / curvature, (np.sin(turn) - math.sin(start)) / curvature
    else:
        side, down = math.sin(start) * along, math.cos(start) * along
    child = np.stack([side, 0.0 * along, -60.0 - down], axis=1)
    other = np.array([[0.0, -y, -60.0] for y in np.arange(0.0, 20.1, 0.5)])
    return made_tree(
        [
            {"id": 0, "parent": None, "children": [1, 2], "points": parent, "radius": np.full(len(parent), 2.5)},
            {"id": 1, "parent": 0, "children": [], "points": child, "radius": np.linspace(2.0, 1.0, len(child))},
            {"id": 2, "parent": 0, "children": [], "points": other, "radius": np.full(len(other), 1.0)},
        ]
    )


@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 42.0, 88.0, 130.0])
@pytest.mark.parametrize("curvature", [0.0, 0.011, 0.03, 0.06])
def test_predictors_of_analytic_tubes_are_their_true_angle_diameter_and_curvature(
    angle_deg: float, curvature: float
) -> None:
    tree = arc_tree(angle_deg, curvature)
    for past_mm in (25.0, 33.3, 40.0):
        found = route_predictors(tree, 1, 60.0 + past_mm)
        assert found.bifurcation_deg == pytest.approx(angle_deg, abs=1.0)
        assert found.curvature_per_mm == pytest.approx(curvature, abs=0.001)
        assert found.width.mm == pytest.approx(2.0 * (2.0 - past_mm / 40.0), abs=0.1)
        assert found.section_mm == 20.0


def test_predictors_of_phantom_routes_equal_an_independent_calculation() -> None:
    measures = measure_tree(volume(), airways())
    rows = list(predictor_rows(airways().tree, measures, max(volume().spacing_mm)))
    assert len(rows) > 20
    for name, limit in LIMITS.items():
        pairs = [row[name] for row in rows if row[name][1] is not None]
        assert len(pairs) > 20
        for found, slow in pairs:
            assert found == pytest.approx(slow, abs=limit), name


@pytest.mark.parametrize("seed", range(12))
def test_angle_and_curvature_in_random_trees_equal_an_independent_calculation(seed: int) -> None:
    tree = random_tree(seed, curl=0.4)
    for branch in tree.branches[1:]:
        along = sum(one.length_mm for one in tree.lineage(branch.id))
        for end in (along, along - 0.37 * branch.length_mm):
            found = route_predictors(tree, branch.id, end)
            assert found.bifurcation_deg == pytest.approx(angle_by_definition(tree, branch.id), abs=1.0)
            slow = curvature_by_definition(tree, branch.id, end)
            assert found.curvature_per_mm == (None if slow is None else pytest.approx(slow, abs=0.005))


def test_bifurcation_angle_of_an_extension_is_that_of_the_last_fork() -> None:
    def row(number: int, parent: int | None, children: list[int], *ends: list[float]) -> dict[str, Any]:
        points = np.linspace(*(np.array(end, dtype=float) for end in ends), 21)
        return {"id": number, "parent": parent, "children": children, "points": points, "radius": np.full(21, 1.0)}

    tree = made_tree(
        [
            row(0, None, [1, 2], [0, 0, 0], [0, 0, -40]),
            row(1, 0, [3], [0, 0, -40], [20, 0, -60]),
            row(2, 0, [], [0, 0, -40], [-20, 0, -40]),
            row(3, 1, [], [20, 0, -60], [40, 0, -60]),
        ]
    )
    assert route_predictors(tree, 3, 80.0).bifurcation_deg == pytest.approx(45.0, abs=0.1)
    assert route_predictors(tree, 0, 30.0).bifurcation_deg is None


def test_least_diameter_predictor_of_the_complete_route_is_the_narrowest_diameter_of_the_route() -> None:
    measures = measure_tree(volume(), airways())
    for route in plan().routes:
        whole = width_of_section(
            airways().tree.lineage(route.branch_id),
            wall(),
            measures,
            max(volume().spacing_mm),
            section_mm=(0.0, route.along_mm),
            origin=route.origin,
        )
        assert whole.mm == pytest.approx(route.narrowest_mm, abs=0.1)


def test_curvature_predictor_of_a_short_route_is_unknown() -> None:
    assert mean_curvature(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 9.0]]), 0.0, 9.0) is None


def test_predictors_are_equal_in_json_and_on_the_wire_and_have_a_source_in_the_text() -> None:
    for route in plan().routes:
        assert isinstance(route, PlannedRoute)
        sent = _route(route).predictors
        stored = route.to_json()["predictors"]
        assert sent is not None
        assert (sent.bifurcation_deg, sent.least_mm, sent.curvature_per_mm) == (
            stored["bifurcation_deg"],
            stored["least_mm"],
            stored["curvature_per_mm"],
        )
    text = "\n".join(lines(plan()))
    assert PREDICTOR_WORDS in text
    assert "s40644-024-00730-7" in text
    assert "not a verdict" in text
