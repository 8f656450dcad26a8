"""Tests of the width and the bend that a route to a point requires of a scope, on trees with known bends and widths."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from exact_measures import exact_measures
from hypothesis import given, settings
from hypothesis import strategies as st
from nodules import ellipsoid

from carina.plan.routes.last_leg import LastLeg
from carina.plan.routes.ranking import RANK, Judge, ScoreWeights, bending_mm
from carina.plan.routes.standing_points import FINE_STEP_MM, POSITION_STEP_MM, ScopePositions
from carina.scopes import scope_preset
from carina.track import AirwayTree, Branch

SECTION_MM = 50.0


def bent(bend_deg: float, radius_mm: float, *, straight_mm: float = 80.0) -> AirwayTree:
    """Return a tree of one tube, 6 mm wide: straight down, along a circle, then straight."""
    down = [np.array([0.0, 0.0, -z]) for z in np.arange(0.0, straight_mm, 0.5)]
    bend = math.radians(bend_deg)
    angles = np.linspace(0.0, bend, int(2.0 * bend * radius_mm) + 2)
    turned = [np.array([radius_mm * (1.0 - math.cos(a)), 0.0, -straight_mm - radius_mm * math.sin(a)]) for a in angles]
    ahead = np.array([math.sin(bend), 0.0, -math.cos(bend)])
    points = np.array([*down, *turned, *(turned[-1] + s * ahead for s in np.arange(0.5, 60.0, 0.5))])
    half = 60
    radius = np.full(len(points), 3.0)
    trunk = Branch(0, None, (1,), 0, "Trachea", "tracked", points[: half + 1], radius[: half + 1])
    rest = Branch(1, 0, (), 1, None, "tracked", points[half:], radius[half:])
    return AirwayTree((trunk, rest))


@settings(deadline=None, max_examples=30)
@given(bend_deg=st.floats(5.0, 150.0), radius_mm=st.floats(8.0, 16.0))
def test_required_bend_of_a_route_along_a_circular_arc_is_the_angle_of_the_arc(
    bend_deg: float, radius_mm: float
) -> None:
    tree = bent(bend_deg, radius_mm)
    positions = ScopePositions(
        tree, ellipsoid((3.0, 3.0, 3.0), tree.branches[1].points[-1]), measures=exact_measures(tree, error_mm=0.28)
    )
    required = positions.requirements_at(len(positions.points) - 1, SECTION_MM)
    # The circle is shorter than the section over which bends are measured, so both ends of a section are on straight
    # parts.
    assert math.radians(bend_deg) * radius_mm < SECTION_MM - 8.0
    assert required.bend_deg.value == pytest.approx(bend_deg, abs=1.0)
    assert 80.0 < required.bend_deg.at_mm < 80.0 + math.radians(bend_deg) * radius_mm + SECTION_MM
    assert positions.requirements_at(len(tree.root.points) + 30, SECTION_MM).bend_deg.value < 1.0, (
        "the route before the bend requires no bend"
    )


def test_required_bend_does_not_decrease_along_a_route() -> None:
    tree = bent(110.0, 12.0)
    positions = ScopePositions(
        tree, ellipsoid((3.0, 3.0, 3.0), tree.branches[1].points[-1]), measures=exact_measures(tree, error_mm=0.28)
    )
    bends = [positions.requirements_at(n, SECTION_MM).bend_deg.value for n in range(len(positions.points))]
    assert bends == sorted(bends)


def test_narrowest_position_of_a_route_is_where_the_lumen_is_narrow() -> None:
    tree = bent(30.0, 15.0)
    radius = tree.branches[1].radius.copy()
    radius[40:44] = 1.4
    narrowed = dataclasses.replace(tree.branches[1], radius=radius)
    tree = AirwayTree((tree.root, narrowed))
    positions = ScopePositions(tree, ellipsoid((3.0, 3.0, 3.0), narrowed.points[-1]), measures=exact_measures(tree))
    required = positions.requirements_at(len(positions.points) - 1, SECTION_MM)
    # The narrow part is shorter than a diameter, and the narrowing is larger than the error of a section.
    assert required.width.mm == pytest.approx(2.9) and required.width.lower_mm < 2.8
    assert required.width.at_mm == pytest.approx(30.0 + 0.5 * 41.5, abs=1.1)
    before = positions.requirements_at(len(tree.root.points) + 20, SECTION_MM)
    assert before.width.mm == pytest.approx(6.0)


@settings(deadline=None, max_examples=10)
@given(at_mm=st.floats(31.0, 130.0))
def test_further_positions_near_a_route_position_are_on_the_centreline_and_not_wider_than_the_route(
    at_mm: float,
) -> None:
    tree = bent(70.0, 12.0)
    radius = np.interp(np.arange(len(tree.branches[1].points)), [0, 400], [3.0, 0.5])
    tree = AirwayTree((tree.root, dataclasses.replace(tree.branches[1], radius=radius)))
    positions = ScopePositions(
        tree, ellipsoid((3.0, 3.0, 3.0), tree.branches[1].points[-1]), measures=exact_measures(tree, error_mm=0.28)
    )
    own = positions.branch == 1
    along, points = positions.along_mm[own], positions.points[own]
    at_mm = min(at_mm, float(along[-1]))
    found = positions.beside([(1, at_mm)])
    assert (np.abs(found.along_mm - at_mm) <= POSITION_STEP_MM + 1e-9).all()
    assert (np.diff(found.along_mm) <= 2.0 * FINE_STEP_MM + 1e-9).all() and len(found.along_mm) >= 4
    assert min(at_mm + POSITION_STEP_MM, along[-1]) in found.along_mm, (
        "up to the neighbours, or to where the branch ends"
    )
    for n, mm in enumerate(found.along_mm):
        after = min(int(np.searchsorted(along, mm)), len(along) - 1)
        before = points[max(after - 1, 0)]
        step = points[after] - before
        assert found.points[n] == pytest.approx(before + (mm - along[max(after - 1, 0)]) / 0.5 * step, abs=0.05)
        assert np.linalg.norm(np.cross(found.points[n] - before, step)) < 1e-9
        assert found.width[n].mm == positions.width[own][after].mm
        assert np.linalg.norm(found.forward[n]) == pytest.approx(1.0)
    required = found.requirements_at(0, SECTION_MM)
    assert required.width.at_mm <= found.along_mm[0]
    assert required.bend_deg.value <= positions.requirements_at(len(positions.points) - 1, SECTION_MM).bend_deg.value
    assert len(positions.beside([]).points) == 0


@settings(deadline=None, max_examples=30)
@given(tip_mm=st.floats(3.0, 7.0), more_mm=st.floats(0.01, 2.0))
def test_thicker_scope_never_has_a_higher_chance_to_arrive(tip_mm: float, more_mm: float) -> None:
    tree = bent(90.0, 14.0)
    positions = ScopePositions(
        tree, ellipsoid((3.0, 3.0, 3.0), tree.branches[1].points[-1]), measures=exact_measures(tree, error_mm=0.28)
    )
    required = positions.requirements_at(len(positions.points) - 1, SECTION_MM)
    thin, thick = (
        Judge(dataclasses.replace(scope_preset("thin"), tip_mm=mm, tube_mm=None), 3.0, ScoreWeights(), 15.0).outlook(
            required
        )
        for mm in (tip_mm, tip_mm + more_mm)
    )
    assert thin[1] >= thick[1] and RANK[thin[0]] <= RANK[thick[0]]


@pytest.mark.parametrize(
    ("tip_mm", "most_deg", "outlook"),
    [
        (4.0, 130.0, "reaches"),
        (5.55, 130.0, "may reach"),
        (6.5, 130.0, "does not reach"),
        (4.0, 92.0, "may reach"),
        (4.0, 60.0, "does not reach"),
        (6.5, 60.0, "does not reach"),
    ],
)
def test_outlook_of_a_route_is_the_worse_of_those_by_width_and_by_bend(
    tip_mm: float, most_deg: float, outlook: str
) -> None:
    scope = dataclasses.replace(
        scope_preset("thin"), tip_mm=tip_mm, tube_mm=None, flexion_deg=(most_deg, most_deg), bending_mm=(40.0, 40.0)
    )
    assert bending_mm(scope) == SECTION_MM
    tree = bent(90.0, 14.0)
    positions = ScopePositions(
        tree, ellipsoid((3.0, 3.0, 3.0), tree.branches[1].points[-1]), measures=exact_measures(tree, error_mm=0.28)
    )
    found, _, limits = Judge(scope, 3.0, ScoreWeights(), 15.0).outlook(
        positions.requirements_at(len(positions.points) - 1, bending_mm(scope))
    )
    assert found == outlook and (limits == ()) == (outlook == "reaches")


def test_outlook_of_a_scope_with_unknown_flexion_is_may_reach() -> None:
    tree = bent(90.0, 14.0)
    positions = ScopePositions(
        tree, ellipsoid((3.0, 3.0, 3.0), tree.branches[1].points[-1]), measures=exact_measures(tree, error_mm=0.28)
    )
    scope = dataclasses.replace(scope_preset("thin"), flexion_deg=None)
    found, _, limits = Judge(scope, 3.0, ScoreWeights(), 15.0).outlook(
        positions.requirements_at(100, bending_mm(scope))
    )
    assert found == "may reach" and limits[0].startswith("it is not known how far")


@pytest.mark.parametrize(
    ("to_target_mm", "outlook"), [(9.0, "reaches"), (14.8, "may reach"), (15.0, "may reach"), (15.9, "does not reach")]
)
def test_outlook_of_a_tool_that_just_reaches_the_edge_of_the_target_is_may_reach(
    to_target_mm: float, outlook: str
) -> None:
    tree = bent(20.0, 14.0)
    end = tree.branches[1].points[-1]
    positions = ScopePositions(tree, ellipsoid((3.0, 3.0, 3.0), end), measures=exact_measures(tree, error_mm=0.28))
    at = (float(end[0]), float(end[1]), float(end[2]))
    leg = LastLeg(at, at, at, to_target_mm, 6.0, 0.0, (), 8.0, 8.0, None, None, None, 1.0, reaches=True)
    scope = dataclasses.replace(scope_preset("thin"), tip_mm=4.0, tube_mm=None)
    found, chance, limits = Judge(scope, 3.0, ScoreWeights(), 15.0).outlook(
        positions.requirements_at(100, SECTION_MM), leg
    )
    assert found == outlook and (limits == ()) == (outlook == "reaches")
    assert chance == pytest.approx(0.5 * math.erfc((to_target_mm - 15.0) / 0.5 / math.sqrt(2.0)), abs=0.01)
