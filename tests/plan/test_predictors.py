"""Tests of the published predictors of a route, against analytic tubes and an independent calculation."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from fork_trees import Points, made_tree
from phantom_plan import airways, plan, volume, wall

from carina.cli.plan import lines
from carina.plan import PREDICTOR_WORDS, PlannedRoute, route_predictors
from carina.plan.routes.predictors import mean_curvature
from carina.plan.routes.route_width import width_of_section
from carina.server.to_wire.plan import _route
from carina.track import AirwayTree, measure_tree
from carina.track.measures.diameter import Passage


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
    return made_tree(
        [
            {"id": 0, "parent": None, "children": [1], "points": parent, "radius": np.full(len(parent), 2.5)},
            {"id": 1, "parent": 0, "children": [], "points": child, "radius": np.linspace(2.0, 1.0, len(child))},
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


def between(points: Points, from_mm: float, to_mm: float) -> Points:
    """Return points every 0.02 mm of a polyline between two distances, by a walk along its segments."""
    found = []
    wanted, walked = from_mm, 0.0
    for start, end in itertools.pairwise(points):
        length = math.dist(start, end)
        while wanted <= min(walked + length, to_mm) and length > 0.0:
            found.append(start + (end - start) * (wanted - walked) / length)
            wanted += 0.02
        walked += length
    return np.array(found)


def second_angle_deg(tree: AirwayTree, branch_id: int) -> float:
    """Return the angle between two chords of two diameters on both sides of a fork."""
    parent, child = tree.lineage(branch_id)[-2:]
    ahead = []
    for branch, is_end in ((parent, True), (child, False)):
        reach = 4.0 * sorted(branch.radius)[len(branch.radius) // 2]
        length = sum(math.dist(*pair) for pair in itertools.pairwise(branch.points))
        part = between(branch.points, max(length - reach, 0.0), length) if is_end else between(branch.points, 0, reach)
        ahead.append(part[-1] - part[0])
    one, other = ahead
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other)))


def second_curvature(points: Points, from_mm: float, to_mm: float) -> float:
    """Return the mean of the turns between the chords before and after each place, per mm, in steps of 0.1 mm."""
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    low, high = max(from_mm, 3.0), min(to_mm, length - 3.0)
    fine = between(points, low - 3.0, high + 3.0)
    chords = fine[300:] - fine[:-300]
    total = 0.0
    for n in range(0, len(chords) - 5, 5):
        one, other = chords[n], chords[n + 5]
        total += math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other))
    return total / (high - low)


def test_predictors_of_phantom_routes_equal_an_independent_calculation() -> None:
    measures = measure_tree(volume(), airways())
    assert len(plan().routes) >= 2
    for route in plan().routes:
        found = route.predictors
        assert found is not None
        assert found.bifurcation_deg == pytest.approx(second_angle_deg(airways().tree, route.branch_id), abs=1.0)
        lineage = airways().tree.lineage(route.branch_id)
        points = np.concatenate([lineage[0].points, *(branch.points[1:] for branch in lineage[1:])])
        slow = second_curvature(points, route.along_mm - 20.0, route.along_mm)
        assert found.curvature_per_mm == pytest.approx(slow, abs=0.005)
        diameters = []
        before_mm = 0.0
        for branch in lineage:
            for at, mm in zip(*_passage(measures.passage(branch.id)), strict=True):
                if route.along_mm - 20.0 <= before_mm + at <= route.along_mm:
                    diameters.append(mm)
            before_mm += branch.length_mm
        if diameters and found.width.source == "sections":
            assert found.width.mm <= min(diameters) + 0.1
            assert found.width.mm >= route.narrowest_mm - 1e-9
        if found.width.source == "sections" and len(diameters) > 5:
            assert found.width.mm == pytest.approx(min(diameters), abs=0.1)


def _passage(passage: Passage) -> tuple[list[float], list[float]]:
    return passage.at_mm.tolist(), passage.diameter_mm.tolist()


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
