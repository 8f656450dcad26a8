"""Tests of the narrowest diameter of a route: its origin in sections or a ball, its error, and which scopes fit."""

from __future__ import annotations

import dataclasses
import gc
import itertools
import json

import numpy as np
import pytest
from exact_measures import exact_measures
from hypothesis import given, settings
from hypothesis import strategies as st

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.errors import UsageError
from carina.plan.routes import route_width
from carina.plan.routes.route_width import (
    RouteWidth,
    ball_error_mm,
    matches_tree,
    measures_of,
    narrowest_opening,
    openings_of_route,
    widths_on_the_way,
)
from carina.plan.verdict.checks import diameter_check
from carina.scopes import scope_preset
from carina.track import AirwayTree, Branch, measure_tree
from carina.track.measures.diameter import SECTION_ERROR

SPACING_MM = 1.5


def straight(*kinds: str, radius_mm: float = 3.0, step_mm: float = 0.7, num: int = 60) -> AirwayTree:
    """Return a trachea and branches below it in a straight line, each 42 mm long and equally wide."""
    branches = []
    for n, kind in enumerate(("tracked", *kinds)):
        points = np.zeros((num, 3))
        points[:, 2] = -step_mm * ((num - 1) * n + np.arange(num))
        children = (n + 1,) if n < len(kinds) else ()
        name = "Trachea" if n == 0 else None
        radius = np.full(num, radius_mm)
        branches.append(Branch(n, n - 1 if n else None, children, n, name, kind, points, radius))
    return AirwayTree(tuple(branches))


def end_of(tree: AirwayTree, **options) -> RouteWidth:
    measures = exact_measures(tree, **options)
    return widths_on_the_way(tree, None, measures, SPACING_MM)[tree.branches[-1].id][-1]


def test_diameter_of_a_measured_route_is_that_of_its_cross_sections_and_not_of_the_inscribed_ball() -> None:
    tree = straight("tracked", radius_mm=1.1)
    found = end_of(tree, widths_mm={0: np.full(60, 14.0), 1: np.full(60, 3.4)})
    assert found.mm == pytest.approx(3.4) and found.source == "sections" and found.why is None
    assert 0.1 <= found.error_mm < 0.2
    by_ball = widths_on_the_way(tree, None, None, SPACING_MM)[1][-1]
    assert by_ball.mm == pytest.approx(2.2) and by_ball.source == "ball"


@pytest.mark.parametrize("taper_mm", [0.0, 0.6])
@pytest.mark.parametrize("num_noisy", [40, 160, 640])
def test_noise_of_many_sections_does_not_bias_the_narrowest_diameter(num_noisy: int, taper_mm: float) -> None:
    noise_mm, off, single, inside = 0.2, [], [], []
    true = np.linspace(4.0, 4.0 - taper_mm, num_noisy)
    for seed in range(20):
        tree = straight("tracked", num=num_noisy)
        noisy = true + noise_mm * np.random.default_rng(seed).standard_normal(num_noisy)
        width = end_of(tree, widths_mm={0: np.full(num_noisy, 14.0), 1: noisy}, error_mm=1.96 * noise_mm)
        inside.append(abs(width.mm - true.min()) <= width.error_mm)
        off.append(width.mm - true.min())
        single.append(noisy.min() - true.min())
    assert np.mean(inside) >= 0.85
    assert abs(np.mean(off)) <= 0.08, "the least of the running medians is 0.2 to 0.3 mm too small"
    assert np.mean(single) < -0.2


def test_widenings_and_narrowings_larger_than_the_noise_retain_their_diameters() -> None:
    tree = straight("tracked", num=160)
    at = np.arange(160)
    true = 5.0 - 1.5 * np.exp(-np.square((at - 80) / 12.0))
    noisy = true + 0.05 * np.random.default_rng(1).standard_normal(160)
    found = end_of(tree, widths_mm={0: np.full(160, 14.0), 1: noisy}, error_mm=0.1)
    assert found.mm == pytest.approx(3.5, abs=0.1)


def test_diameters_of_cross_sections_at_forks_have_larger_errors() -> None:
    tree = straight("tracked", "tracked")
    measures = exact_measures(tree, widths_mm={0: np.full(60, 14.0)})
    own = measures.branches[1]
    at_junction = own.at_mm[-1] - own.at_mm < 6.0
    widths = np.where(at_junction, 5.0, 6.0)
    narrow = dataclasses.replace(own, at_junction=at_junction, min_mm=widths)
    at_fork = dataclasses.replace(measures, branches=(measures.branches[0], narrow, measures.branches[2]))
    plain = exact_measures(tree, widths_mm={0: np.full(60, 14.0), 1: widths})
    fork, away = (widths_on_the_way(tree, None, one, SPACING_MM)[2][-1] for one in (at_fork, plain))
    assert fork.mm == pytest.approx(5.0) and fork.error_mm > away.error_mm + 0.1


def test_single_missing_cross_section_is_bridged_by_its_neighbours() -> None:
    tree = straight("tracked")
    for missing in (slice(30, 31), slice(58, 60)):
        found = end_of(tree, missing={1: missing})
        assert found.source == "sections" and found.mm == pytest.approx(6.0)
    assert end_of(tree, missing={1: slice(28, 34)}).source == "ball", "no section shows the middle"


def test_cross_sections_missing_inside_the_lumen_of_the_parent_do_not_make_the_route_unmeasured() -> None:
    tree = straight("tracked")
    first = {0: np.full(60, 14.0)}
    assert end_of(tree, widths_mm=first, missing={1: slice(0, 8)}).source == "sections"
    assert end_of(tree, widths_mm=first, missing={1: slice(0, 30)}).source == "ball", "longer than the parent is wide"


def test_section_that_the_end_of_the_ct_cuts_is_measured_by_the_rest_of_its_wall() -> None:
    tree = straight("tracked")
    measures = exact_measures(tree, widths_mm={0: np.full(60, 14.0)})
    whole = widths_on_the_way(tree, None, measures, SPACING_MM)[1][-1]

    def cut(share: float) -> RouteWidth:
        at_edge = np.arange(60) >= 40
        shares = np.where(at_edge, share, 1.0)
        own = dataclasses.replace(measures.branches[1], at_edge=at_edge, at_junction=shares < 0.9, share=shares)
        both = dataclasses.replace(measures, branches=(measures.branches[0], own))
        return widths_on_the_way(tree, None, both, SPACING_MM)[1][-1]

    assert cut(0.6).source == "sections" and cut(0.6).mm == pytest.approx(6.0)
    assert cut(0.6).error_mm > whole.error_mm
    assert cut(0.3).source == "ball"


@settings(deadline=None, max_examples=30)
@given(at=st.integers(5, 50), num=st.integers(2, 8), narrow_mm=st.floats(1.0, 3.0))
def test_narrowing_shorter_than_a_diameter_limits_the_scope_that_fits(at: int, num: int, narrow_mm: float) -> None:
    tree = straight("tracked")
    widths = np.full(60, 6.0)
    widths[at : at + num] = narrow_mm
    found = end_of(tree, widths_mm={1: widths}, error_mm=0.2)
    assert found.lower_mm <= narrow_mm <= found.mm + found.error_mm
    assert found.mm <= narrow_mm + 0.21, "two sections agree"
    thick = dataclasses.replace(scope_preset("thin"), tip_mm=narrow_mm + 0.7, tube_mm=None)
    assert found.fit(thick) == "does not fit"


def test_start_of_a_branch_has_the_diameter_of_its_first_valid_cross_section() -> None:
    tree = straight("tracked")
    measures = exact_measures(tree, widths_mm={0: np.full(60, 14.0), 1: np.full(60, 3.0)})
    at_junction = np.arange(60) < 20
    begins = dataclasses.replace(measures.branches[1], at_junction=at_junction)
    measures = dataclasses.replace(measures, branches=(measures.branches[0], begins))
    found = widths_on_the_way(tree, None, measures, SPACING_MM)
    assert found[0][-1].mm == pytest.approx(14.0)
    plain = end_of(tree, widths_mm={0: np.full(60, 14.0), 1: np.full(60, 3.0)})
    assert found[1][-1].error_mm > plain.error_mm, "no section shows the mouth of the branch"
    for n in (1, 5, 19, 20, 40):
        assert found[1][n].mm == pytest.approx(3.0), "cross-sections in the parent's lumen do not widen the branch"
        until = float(measures.branches[1].at_mm[n])
        assert measures.narrowest_of_route([0, 1], until_mm=until).mm == pytest.approx(3.0)


def test_one_narrow_cross_section_widens_the_error_and_not_the_diameter() -> None:
    tree = straight("tracked")
    widths = np.full(60, 6.0)
    widths[30] = 3.0
    found = end_of(tree, widths_mm={1: widths})
    assert found.mm == pytest.approx(6.0) and found.lower_mm <= 3.0


def test_narrowest_diameter_of_a_flat_lumen_is_its_narrow_side() -> None:
    tree = straight("tracked")
    found = end_of(tree, flat=0.5, error_mm=0.2)
    assert found.mm == pytest.approx(3.0 + 0.2 * SECTION_ERROR) and found.lower_mm <= 3.0
    round_one = end_of(tree, flat=0.98, error_mm=0.2)
    assert round_one.mm == pytest.approx(6.0), "within the error it is round"


@pytest.mark.parametrize(("kind", "reason"), [("manual", "was drawn by hand"), ("bridge", "is a bridge")])
def test_branch_not_visible_in_the_ct_uses_the_inscribed_ball_with_a_note(kind: str, reason: str) -> None:
    tree = straight("tracked", kind)
    found = end_of(tree)
    assert found.source == "ball" and reason in found.why and "branch 2" in found.why
    assert found.lower_mm <= 6.0 - ball_error_mm(6.0, SPACING_MM) + 1e-9
    before = widths_on_the_way(tree, None, exact_measures(tree), SPACING_MM)[1][-1]
    assert before.source == "sections" and before.error_mm < found.error_mm


def test_fit_of_a_scope_is_less_certain_if_the_last_cross_sections_are_unmeasured() -> None:
    tree = straight("tracked")
    whole = end_of(tree)
    part = end_of(tree, missing={1: slice(45, 60)})
    assert part.source == "ball" and "has no section that can be measured" in part.why
    assert part.lower_mm < whole.lower_mm
    for tip_mm in (2.0, 4.0, 5.0, 5.5):
        scope = dataclasses.replace(scope_preset("thin"), tip_mm=tip_mm, tube_mm=None)
        assert part.chance(scope) <= whole.chance(scope)


@settings(deadline=None, max_examples=40)
@given(
    widths=st.lists(st.floats(2.0, 12.0), min_size=3, max_size=5),
    errors=st.floats(0.05, 0.6),
    drawn=st.integers(0, 4),
)
def test_narrowest_diameter_never_increases_along_a_route_and_its_lower_bound_covers_every_position(
    widths: list[float], errors: float, drawn: int
) -> None:
    kinds = ["manual" if n == drawn else "tracked" for n in range(len(widths))]
    tree = straight(*kinds)
    measured = {n + 1: np.full(60, mm) for n, mm in enumerate(widths)}
    found = widths_on_the_way(tree, None, exact_measures(tree, error_mm=errors, widths_mm=measured), SPACING_MM)
    way = [one for branch in tree.branches for one in found[branch.id]]
    for before, after in itertools.pairwise(way):
        assert after.mm <= before.mm and after.lower_mm <= before.lower_mm + 1e-9
        assert after.at_mm >= before.at_mm or after.mm == before.mm
    own = [mm for n, mm in enumerate(widths) if n != drawn]
    assert way[-1].mm <= min(own) + 1e-9 and way[-1].lower_mm <= min(own) - SECTION_ERROR * errors + 1e-9


@settings(deadline=None, max_examples=50)
@given(mm=st.floats(1.0, 9.0), error_mm=st.floats(0.0, 3.0), tip_mm=st.floats(2.0, 7.0), more_mm=st.floats(0.0, 2.0))
def test_scope_is_judged_to_fit_only_if_its_diameter_is_below_the_interval_of_the_route_width(
    mm: float, error_mm: float, tip_mm: float, more_mm: float
) -> None:
    width = RouteWidth(mm, error_mm, 50.0)
    thin, thick = (
        dataclasses.replace(scope_preset("thin"), tip_mm=tip, tube_mm=None) for tip in (tip_mm, tip_mm + more_mm)
    )
    assert width.chance(thin) >= width.chance(thick)
    if width.fit(thin) == "fits":
        # A one-sided probability of 90 % corresponds to 1.28 standard deviations; the interval has 1.645.
        assert mm - 0.779 * error_mm >= thin.fit_mm - 1e-9
    if width.fit(thin) == "does not fit":
        assert mm < thin.fit_mm
    check = diameter_check(width, thin, errors=True)
    assert (check.answer, check.share) == (
        {"fits": "yes", "may fit": "perhaps", "does not fit": "no"}[width.fit(thin)],
        width.chance(thin),
    )
    assert f"{mm:.1f} \u00b1 {error_mm:.1f} mm wide" in check.words


def test_measurements_of_another_tree_or_by_an_earlier_method_are_not_used() -> None:
    tree = straight("tracked")
    assert matches_tree(exact_measures(tree), tree)
    assert not matches_tree(exact_measures(tree, method=1), tree)
    assert not matches_tree(exact_measures(straight("tracked", "tracked")), tree)
    assert not matches_tree(exact_measures(straight("tracked", num=50)), tree)


def test_route_width_is_plain_json_and_invalid_widths_are_refused() -> None:
    width = RouteWidth(3.2, 0.4, 91.0, "ball", "branch 7 was drawn by hand 91 mm along the route")
    assert json.loads(json.dumps(width.to_json())) == {
        "narrowest_mm": 3.2,
        "narrowest_error_mm": 0.4,
        "narrowest_at_mm": 91.0,
        "narrowest_by": "ball",
        "narrowest_why": "branch 7 was drawn by hand 91 mm along the route",
    }
    assert width.words == "3.2 \u00b1 0.4 mm by the largest ball"
    with pytest.raises(UsageError):
        RouteWidth(-1.0, 0.4, 91.0)
    with pytest.raises(UsageError):
        RouteWidth(3.0, float("nan"), 91.0)


CHEST = {"spacing_mm": 3.0, "generations": 3}


def test_measures_that_a_plan_computes_equal_those_of_measure_tree_and_are_computed_once_per_ct_and_tree() -> None:
    volume, airways = cached_phantom(**CHEST).volume, cached_airways(**CHEST)
    first = measures_of(volume, airways, None)
    assert first.to_json() == measure_tree(volume, airways).to_json()
    assert measures_of(volume, airways, None) is first
    # Measures of another tree are not used, neither given nor cached ones.
    root = dataclasses.replace(airways.tree.root, children=())
    alone = dataclasses.replace(airways, tree=AirwayTree((root,)))
    cut = measures_of(volume, alone, first)
    assert len(cut.branches) == 1 and cut.to_json() == measure_tree(volume, alone).to_json()
    assert measures_of(volume, airways, cut) is first
    assert measures_of(volume, alone, None) is cut
    same = dataclasses.replace(volume)
    assert measures_of(same, airways, None) is not first
    given_ones = measure_tree(volume, airways)
    assert measures_of(volume, airways, given_ones) is given_ones


def test_cached_measures_are_deleted_with_the_lumen() -> None:
    volume = cached_phantom(**CHEST).volume
    before = set(route_width._MEASURED)
    airways = carina.find_airways(volume)
    measures_of(volume, airways, None)
    assert len(set(route_width._MEASURED) - before) == 1
    del airways
    gc.collect()
    assert set(route_width._MEASURED) <= before


def forked(*, radius_mm: float = 1.0) -> AirwayTree:
    """Return a trachea with two daughters, of which the first has two daughters too, all 42 mm long."""
    rows = {0: (None, (1, 2), (0.0, -0.7)), 1: (0, (3, 4), (-0.5, -0.5)), 2: (0, (), (0.5, -0.5))}
    rows |= {3: (1, (), (-0.7, 0.0)), 4: (1, (), (0.0, -0.7))}
    branches: list[Branch] = []
    for n, (parent, children, (x, z)) in rows.items():
        start = np.zeros(3) if parent is None else branches[parent].points[-1]
        points = start + np.arange(60)[:, None] * np.array([x, 0.0, z])
        radius = np.full(60, 7.0 if parent is None else radius_mm)
        branches.append(Branch(n, parent, children, n, None, "tracked", points, radius))
    return AirwayTree(tuple(branches))


@settings(deadline=None, max_examples=40)
@given(
    widths_mm=st.lists(st.floats(1.5, 9.0), min_size=4, max_size=4),
    dip=st.tuples(st.integers(1, 4), st.integers(0, 52), st.floats(1.0, 3.0)),
    share=st.floats(0.05, 1.0),
)
def test_no_opening_of_a_route_is_narrower_than_the_route(widths_mm, dip, share) -> None:
    tree = forked()
    widths = {n: np.full(60, mm) for n, mm in enumerate((14.0, *widths_mm))}
    branch, at, narrow_mm = dip
    widths[branch][at : at + 8] = narrow_mm
    measures = exact_measures(tree, widths_mm=widths, error_mm=0.3)
    way = widths_on_the_way(tree, None, measures, SPACING_MM)
    index = max(1, round(share * 59))
    last = tree.branches[3]
    along = sum(tree.branches[n].length_mm for n in (0, 1)) + index * float(
        np.linalg.norm(last.points[1] - last.points[0])
    )
    scope = scope_preset("thin")
    found = openings_of_route(tree, 3, along, scope=scope, wall=None, measures=measures, spacing_mm=SPACING_MM)
    assert set(found) == {1, 2, 3, 4}
    route = way[3][index]
    order = ("does not fit", "may fit", "fits")
    for n in (1, 3):
        assert found[n].width.mm >= route.mm and found[n].width.lower_mm >= route.lower_mm
        assert order.index(found[n].fit) >= order.index(route.fit(scope))
        assert found[n].width.source == "sections", "the ball of 2 mm in the lumen found does not count"
    both = narrowest_opening([found[1], found[3]])
    assert both.width.mm == min(found[1].width.mm, found[3].width.mm) and both.fit in {found[1].fit, found[3].fit}


def test_opening_states_its_error_and_whether_the_scope_passes() -> None:
    tree = forked()
    widths = {0: np.full(60, 14.0), 1: np.full(60, 8.0), 3: np.full(60, 4.4), 4: np.full(60, 2.0)}
    measures = exact_measures(tree, widths_mm=widths, error_mm=0.3)
    scope = dataclasses.replace(scope_preset("thin"), tip_mm=4.0, tube_mm=None)
    found = openings_of_route(tree, 3, 140.0, scope=scope, wall=None, measures=measures, spacing_mm=SPACING_MM)
    assert found[1].fit == "fits" and "scope" not in found[1].words
    assert found[3].fit == "may fit" and found[3].words.endswith("mm wide, the scope may pass")
    assert found[4].fit == "does not fit" and found[4].cell.endswith(": the scope does not pass")
    assert found[3].words.startswith(f"4.4 \u00b1 {found[3].width.error_mm:.1f} mm wide")
    for opening in found.values():
        check = diameter_check(opening.width, scope, errors=True)
        assert check.answer == {"fits": "yes", "may fit": "perhaps", "does not fit": "no"}[opening.fit]
