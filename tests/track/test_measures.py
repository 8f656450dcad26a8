"""Tests of airway measures in the synthetic chest: sections, forks, branches, and measures after an edit."""

from __future__ import annotations

import dataclasses
import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cached_test_data import cached_airways, cached_phantom
from carina._core import cast_sections, section_axes
from carina.errors import CancelledError, UsageError
from carina.track import AirwayTree, Branch, measure_tree
from carina.track.measures.branch_summary import (
    ReferenceDiameter,
    Stenosis,
    diameter_by_neighbours,
    stenosis_of,
    summary_of,
)
from carina.track.measures.diameter import branch_diameter, narrowest_diameter, passage_of, with_scatter
from carina.track.measures.forks import angle_deg, directions
from carina.volume.model import Volume


@pytest.fixture(scope="module")
def measured(chest, found):
    return found, measure_tree(chest.volume, found)


def test_measured_diameters_are_within_their_errors(chest, measured):
    airways, measures = measured
    truth = {"Trachea": 13.0, "RMB": 10.0, "LMB": 9.2}
    for name, diameter in truth.items():
        summary = measures.of(airways.tree.named(name).id).summary
        # The tolerance is 0.5 mm, because the drawn edge is a linear ramp and not a Gaussian blur.
        assert abs(summary.mean_mm - diameter) < max(summary.mean_error_mm, 0.5)
    for branch in airways.tree.branches:
        own = measures.of(branch.id)
        assert own.at_mm.shape == own.area_mm2.shape == own.at_junction.shape == (len(branch.points),)
        assert own.edge_mm.shape == own.outer_mm.shape == (len(branch.points), 64)
        usable = own.is_usable
        assert usable.any()
        assert np.allclose(own.area_mm2[usable], np.pi / 4 * own.equivalent_mm[usable] ** 2)
        assert (own.min_mm[usable] <= own.max_mm[usable]).all()


def test_cross_sections_at_forks_are_flagged_and_left_out_of_the_mean(chest, measured):
    airways, measures = measured
    tree = airways.tree
    for branch in tree.branches:
        own = measures.of(branch.id)
        assert own.at_junction[-1] == bool(branch.children)
        assert own.at_junction[0] == (branch.parent is not None)
        assert own.summary.num_sections == own.is_usable.sum()
    # A section through a main carina is much wider than the trachea.
    trachea = measures.of(tree.root.id)
    assert trachea.summary.mean_mm < 14.0


def test_carina_is_in_the_wall_between_the_main_bronchi_below_the_fork(chest, measured):
    airways, measures = measured
    fork = measures.fork_of(airways.tree.root.id)
    assert set(fork.children) == set(airways.tree.root.children)
    assert fork.carina_lps is not None
    assert fork.carina_lps[2] < fork.fork_lps[2]
    # The carina is on the surface of the lumen, to within one voxel.
    assert abs(chest.depth_mm(np.array(fork.carina_lps))) < 1.6
    # The measured angle of the carina agrees with the angle between the drawn axes of the main bronchi.
    one, other = (end - start for start, end, _ in chest.tubes[1:3])
    drawn = np.degrees(np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other)))
    assert abs(fork.angle_between_deg - drawn) < 12.0
    assert all(measures.fork_of(tip.id) is None for tip in airways.tree.tips())


def test_only_changed_branches_are_measured_again_after_an_edit(chest, measured, monkeypatch):
    airways, measures = measured
    counts = []

    def counted(hu, matrix, centres, *rest, **options):
        counts.append(len(centres))
        return cast_sections(hu, matrix, centres, *rest, **options)

    monkeypatch.setattr("carina.track.measures.branch_measures.cast_sections", counted)
    again = measure_tree(chest.volume, airways, previous=measures)
    assert counts == [0]
    assert again.to_json() == measures.to_json()
    tip = airways.tree.tips()[0]
    shorter = dataclasses.replace(tip, points=tip.points[:-3], radius=tip.radius[:-3])
    tree = AirwayTree(tuple(shorter if branch is tip else branch for branch in airways.tree.branches))
    edited = dataclasses.replace(airways, tree=tree)
    fresh = measure_tree(chest.volume, edited, previous=measures)
    assert counts[1:] == [len(shorter.points)]
    whole = measure_tree(chest.volume, edited)
    # Blur is estimated from the whole scan; the estimate for the shorter tree differs by 0.1 %.
    np.testing.assert_allclose(fresh.of(tip.id).edge_mm, whole.of(tip.id).edge_mm, atol=2e-3)


def test_measurements_by_an_earlier_method_are_not_reused(chest, measured, monkeypatch):
    airways, measures = measured
    counts = []

    def counted(hu, matrix, centres, *rest, **options):
        counts.append(len(centres))
        return cast_sections(hu, matrix, centres, *rest, **options)

    monkeypatch.setattr("carina.track.measures.branch_measures.cast_sections", counted)
    branches = (dataclasses.replace(measures.branches[0], method=1), *measures.branches[1:])
    again = measure_tree(chest.volume, airways, previous=dataclasses.replace(measures, branches=branches))
    assert counts == [sum(len(branch.points) for branch in airways.tree.branches)]
    assert not any(branch.is_by_earlier_method for branch in again.branches)
    assert branches[0].is_by_earlier_method
    assert branches[0].to_json()["by_earlier_method"]


def test_narrowest_diameter_of_a_route_is_that_of_its_branches_up_to_the_route_end(measured):
    airways, measures = measured
    tree = airways.tree
    tip = tree.tips()[0]
    ids = [branch.id for branch in tree.lineage(tip.id)]
    found = measures.narrowest_of_route(ids)
    passages = [measures.passage(i) for i in ids]
    assert found.mm == min(float(one.diameter_mm.min()) for one in passages if len(one.diameter_mm))
    assert found.branch_id in ids
    lower = min(float((one.diameter_mm - one.error_mm).min()) for one in passages if len(one.diameter_mm))
    assert found.mm - found.error_mm == pytest.approx(lower), "the error covers what may be narrower elsewhere"
    assert measures.narrowest_of_route([]) is None
    first = measures.narrowest_of_route([ids[0]], until_mm=0.0)
    assert first.mm == float(measures.passage(ids[0]).diameter_mm[0])
    assert measures.narrowest_of_route(ids[:1]).mm >= found.mm


def test_width_of_a_route_uses_cross_sections_at_branch_ends_by_their_narrow_side_and_none_at_starts():
    at = 0.7 * np.arange(40)
    equal, least, error = np.full(40, 4.0), np.full(40, 4.0), np.full(40, 0.1)
    at_junction = (at < 4.0) | (at > 24.0)
    equal[at < 4.0], least[at < 4.0] = 7.0, 1.0
    equal[at > 24.0], least[at > 24.0] = 6.0, 3.5

    def narrowest(*, has_fork):
        return passage_of(
            1,
            at,
            (equal, error),
            (least, error),
            is_measured=np.ones(40, bool),
            at_junction=at_junction,
            is_cut=np.zeros(40, bool),
            has_fork=has_fork,
            parent_mm=0.0,
        ).diameter_mm.min()

    assert narrowest(has_fork=True) == pytest.approx(3.5)
    assert narrowest(has_fork=False) == pytest.approx(4.0)


def test_branch_with_only_cross_sections_at_forks_has_an_error_that_covers_both_diameters():
    at = 0.7 * np.arange(5)
    equal, least, error = np.full(5, 6.0), np.full(5, 4.0), np.full(5, 0.1)
    found = passage_of(
        1,
        at,
        (equal, error),
        (least, error),
        is_measured=np.ones(5, bool),
        at_junction=np.ones(5, bool),
        is_cut=np.zeros(5, bool),
        has_fork=False,
        parent_mm=0.0,
    )
    assert found.diameter_mm == pytest.approx(5.0)
    assert (found.diameter_mm - found.error_mm <= 4.0).all() and (found.diameter_mm + found.error_mm >= 6.0).all()


@given(
    num=st.integers(1, 60),
    diameter=st.floats(1.0, 20.0),
    noise=st.floats(0.0, 0.1),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=80, deadline=None)
def test_branch_diameter_is_independent_of_the_order_of_cross_sections(num, diameter, noise, seed):
    rng = np.random.default_rng(seed)
    at = 0.7 * np.arange(num)
    sections = diameter * (1.0 + noise * rng.standard_normal(num))
    usable = np.ones(num, dtype=bool)
    by_model = np.full(num, 0.05 * diameter)
    error = with_scatter(at, sections, by_model, usable)
    whole, narrowest = branch_diameter(at, sections, error), narrowest_diameter(at, sections, error)
    assert sections.min() <= narrowest.mm <= whole.mm + 1e-9 <= sections.max() + 2e-9
    assert whole.error_mm >= 0.05 * diameter - 1e-9
    assert narrowest.at_mm in at
    order = rng.permutation(num)
    shuffled = branch_diameter(at[order], sections[order], error[order])
    assert (shuffled.mm, shuffled.error_mm) == pytest.approx((whole.mm, whole.error_mm), rel=1e-6)
    # A branch that is twice as wide has twice the diameter and twice the error.
    twice = branch_diameter(2.0 * at, 2.0 * sections, 2.0 * error)
    assert (twice.mm, twice.error_mm) == pytest.approx((2.0 * whole.mm, 2.0 * whole.error_mm), rel=1e-6, abs=1e-9)
    assert (error >= by_model).all()


def test_one_disturbed_cross_section_changes_neither_diameter_nor_narrowest_position():
    at = np.arange(20.0)
    sections, error = np.linspace(8.0, 6.0, 20), np.full(20, 0.2)
    plain = narrowest_diameter(at, sections, error)
    disturbed = sections.copy()
    disturbed[10] = 2.0
    assert narrowest_diameter(at, disturbed, error).mm == pytest.approx(plain.mm, abs=0.1)
    assert branch_diameter(at, disturbed, error).mm == pytest.approx(7.0, abs=0.1)
    assert branch_diameter(at, disturbed, error).error_mm > branch_diameter(at, sections, error).error_mm
    assert branch_diameter(*(np.zeros(0),) * 3) is None


def test_measurements_are_plain_json_and_refuse_an_unknown_branch(measured):
    airways, measures = measured
    document = json.loads(json.dumps(measures.to_json(), allow_nan=False))
    assert document["format"] == "carina-measures"
    assert len(document["branches"]) == len(airways.tree)
    assert len(document["forks"]) == 3
    with pytest.raises(UsageError, match="no branch has the id 99"):
        measures.of(99)


def test_measurement_of_a_tree_can_be_cancelled_and_reports_progress(chest, measured):
    airways, _ = measured
    reported = []
    measure_tree(chest.volume, airways, progress=lambda what, fraction: reported.append((what, fraction)))
    assert reported[0] == ("measuring the airways", 0.0)
    assert reported[-1] == ("airways measured", 1.0)
    calls = itertools.count()
    with pytest.raises(CancelledError):
        measure_tree(chest.volume, airways, cancel=lambda: next(calls) >= 1)


def test_cross_sections_of_a_branch_of_one_voxel_and_at_the_volume_edge_are_flagged(chest, measured):
    airways, _ = measured
    root = airways.tree.root
    # The tree has a branch of one point in the top slice, and another at the end of the trachea.
    trunk = dataclasses.replace(root, children=(1,), points=root.points, radius=root.radius)
    twig = Branch(1, 0, (), 1, None, "tracked", root.points[-1:], root.radius[-1:])
    tree = AirwayTree((trunk, twig))
    measures = measure_tree(chest.volume, dataclasses.replace(airways, tree=tree))
    single = measures.of(1)
    assert single.at_mm.tolist() == [0.0]
    assert single.summary.length_mm == 0.0
    assert single.summary.angle_deg is None
    # The volume is cut through the middle of the trachea, so its sections are incomplete and flagged.
    i = int(chest.volume.to_ijk(root.points[len(root.points) // 2])[0] + 0.5)
    half = Volume(np.ascontiguousarray(chest.volume.hu_zyx[:, :, :i]), chest.volume.lps_from_ijk)
    alone = AirwayTree((dataclasses.replace(root, children=()),))
    cut = measure_tree(half, dataclasses.replace(airways, tree=alone, lumen_zyx=airways.lumen_zyx[:, :, :i]))
    own = cut.of(0)
    assert own.at_edge.mean() > 0.5
    assert not (own.at_edge & own.is_usable).any()


@given(st.floats(0.3, 0.9), st.floats(4.0, 14.0), st.floats(-0.08, 0.02))
@settings(max_examples=40, deadline=None)
def test_stenosis_is_measured_relative_to_a_line_through_healthy_cross_sections(left, diameter, taper):
    at = np.arange(0.0, 40.0)
    healthy = diameter + taper * at * diameter / 20.0
    narrowing = 1.0 - (1.0 - left) * np.clip(1.0 - np.abs(at - 22.0) / 6.0, 0.0, 1.0)
    found = stenosis_of(at, healthy * narrowing, np.full(40, 0.1), np.ones(40, bool), expected=None)
    if left < 0.8:
        assert found.reference_from == "branch"
        assert found.at_mm == 22.0
        assert abs(found.percent - 100.0 * (1.0 - left)) < 4.0
        assert abs(found.percent - 100.0 * (1.0 - left)) < found.percent_error
        assert abs(found.area_percent - 100.0 * (1.0 - left**2)) < 6.0


def test_branch_narrow_over_its_complete_length_is_compared_with_its_neighbours():
    at = np.arange(0.0, 8.0)
    narrow = np.full(8, 4.0) + 0.3 * np.abs(at - 4.0)
    expected = diameter_by_neighbours(12.0, [8.0], [7.0, 7.5])
    # Murray's law gives 12^3 - 8^3 from the parent and sibling, and 7^3 + 7.5^3 from the children.
    above, below = 12.0**3 - 8.0**3, 7.0**3 + 7.5**3
    assert expected.mm == pytest.approx(np.sqrt(above ** (1 / 3) * below ** (1 / 3)))
    # The result has the error of the parent's cube.
    assert expected.error == pytest.approx(1.96 * 0.5 * np.hypot(0.15 * 12.0**3 / above, 0.15))
    found = stenosis_of(at, narrow, np.full(8, 0.1), np.ones(8, bool), expected=expected)
    assert found.reference_from == "neighbours"
    assert found.percent == pytest.approx(100.0 * (1.0 - 4.0 / expected.mm))
    assert found.percent_error > 10.0
    assert (
        stenosis_of(at, narrow, narrow, np.zeros(8, bool), expected=ReferenceDiameter(9.0, 0.3, "neighbours")) is None
    )


def test_neighbours_with_missing_diameters_give_no_expected_diameter():
    assert diameter_by_neighbours(None, [], []) is None
    assert diameter_by_neighbours(12.0, [8.0], []) is None, "siblings of a tip may be missing"
    assert diameter_by_neighbours(5.0, [6.0], [None]) is None
    assert diameter_by_neighbours(5.0, [6.0], [3.0]).mm == pytest.approx(3.0)
    assert diameter_by_neighbours(12.0, [8.0], [None]).mm == pytest.approx((12.0**3 - 8.0**3) ** (1 / 3))


@pytest.mark.parametrize(("percent", "error", "is_reported"), [(8.0, 7.9, True), (8.0, 8.0, False), (-3.0, 1.0, False)])
def test_stenosis_is_reported_only_if_it_exceeds_its_error(percent, error, is_reported):
    measured = Stenosis(percent, error, percent, 10.0, 5.0, 6.0, "branch")
    assert measured.exceeds_error is is_reported
    at, even = np.arange(5.0), np.full(5, 6.0)
    columns = (at, (even, even), (even, even), np.ones(5, dtype=bool))
    summary = summary_of(*columns, angle_deg=None, stenosis=measured)
    assert (summary.stenosis is measured) is is_reported
    assert (summary.to_json()["stenosis"] is not None) is is_reported
    assert summary.measured_stenosis is measured


@given(st.integers(0, 2**32 - 1), st.sampled_from([6, 20, 80]), st.floats(2.0, 14.0), st.floats(0.02, 0.1))
@settings(max_examples=15, deadline=None)
def test_noise_causes_stenoses_in_no_more_branches_than_their_error_allows(seed, num, diameter, share):
    random = np.random.default_rng(seed)
    at = np.arange(num) * diameter
    found = [
        stenosis_of(
            at,
            # Half of a 95 % interval is 1.96 standard deviations.
            diameter * (1.0 + random.normal(0.0, share / 1.96, len(at))),
            np.full(len(at), share * diameter),
            np.ones(len(at), dtype=bool),
            expected=None,
        )
        for _ in range(200)
    ]
    assert np.mean([one is not None for one in found]) < 0.06


def test_narrowing_that_an_unseen_fork_may_cause_is_not_a_stenosis():
    at = np.arange(0.0, 30.0)
    one_fork = np.where(at < 20.0, 5.0, 5.0 * 2.0 ** (-1 / 3))
    measured = {"usable": np.ones(30, bool), "expected": None}
    assert stenosis_of(at, one_fork, np.full(30, 0.1), **measured) is None
    two_forks_in_twice_the_way = np.where(at < 10.0, 5.0, np.where(at < 25.0, 4.0, 3.2))
    assert stenosis_of(at, two_forks_in_twice_the_way, np.full(30, 0.1), **measured) is None
    half_closed = stenosis_of(at, np.where(at < 20.0, 5.0, 2.5), np.full(30, 0.1), **measured)
    assert half_closed.percent == pytest.approx(50.0)
    assert half_closed.at_mm >= 20.0
    # A missed fork cannot explain an airway that becomes wider.
    first_narrow = stenosis_of(at, one_fork[::-1], np.full(30, 0.1), **measured)
    assert first_narrow.percent == pytest.approx(100.0 * (1.0 - 2.0 ** (-1 / 3)))
    between = np.where((at > 15.0) & (at < 20.0), 4.0, 5.0)
    assert stenosis_of(at, between, np.full(30, 0.1), **measured).percent == pytest.approx(20.0)


@pytest.mark.parametrize("seed", [1, pytest.param(4, marks=pytest.mark.soak)])
def test_stenosis_of_a_phantom_is_reported_and_no_other_beyond_chance(seed):
    options = {"seed": seed, "spacing_mm": 1.2, "noise_hu": 25.0}
    healthy = measure_tree(cached_phantom(**options).volume, cached_airways(**options))
    reported = [one.branch_id for one in healthy.branches if one.summary.stenosis is not None]
    # The error covers 97.5 % of healthy branches, so 2.5 % may be reported.
    assert len(reported) <= 0.025 * len(healthy.branches)

    options["stenosis"] = True
    made, airways = cached_phantom(**options), cached_airways(**options)
    measures = measure_tree(made.volume, airways)
    truth = made.truth["stenosis"]
    branch, _, _ = airways.tree.nearest_branch(truth["centre_lps"])
    found = measures.of(branch.id)
    stenosis = found.summary.stenosis
    at = int(np.argmin(np.abs(found.at_mm - stenosis.at_mm)))
    assert np.linalg.norm(found.centre_lps[at] - truth["centre_lps"]) < 2.0
    percent = 100.0 * (1.0 - truth["min_radius_mm"] / truth["reference_radius_mm"])
    assert abs(stenosis.percent - percent) < stenosis.percent_error
    others = [one for one in measures.branches if one.summary.stenosis is not None and one is not found]
    assert len(others) <= 0.025 * len(measures.branches)


def test_angles_and_directions_of_a_fork_are_those_of_its_straight_branches():
    trunk = Branch(
        0, None, (1,), 0, None, "tracked", np.array([[0.0, 0, z] for z in range(40, -1, -1)]), np.full(41, 5.0)
    )
    tilt = np.radians(35.0)
    line = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    child = Branch(1, 0, (), 1, None, "tracked", np.arange(0.0, 30.0)[:, None] * line, np.full(30, 3.0))
    assert angle_deg(trunk, child) == pytest.approx(35.0)
    point = dataclasses.replace(child, points=child.points[:1], radius=child.radius[:1])
    assert angle_deg(trunk, point) is None
    np.testing.assert_allclose(directions(child.points, child.radius), np.tile(line, (30, 1)), atol=1e-12)
    np.testing.assert_allclose(directions(point.points, point.radius, trunk.points[-2]), [[0.0, 0.0, -1.0]])


def test_directions_of_a_thin_branch_follow_its_bends():
    """Check directions near a right angle.

    Directions are computed over 2 mm, so the angle affects the direction 0.9 mm before it, but not 1.2 mm before it.
    """
    at = np.linspace(0.0, 5.0, 51)
    points = np.concatenate(
        [np.stack([0 * at, 0 * at, -at], axis=1), np.stack([at[1:], 0 * at[1:], 0 * at[1:] - 5.0], 1)]
    )
    found = directions(points, np.full(len(points), 0.6))
    np.testing.assert_allclose(found[38], [0.0, 0.0, -1.0], atol=1e-12)
    assert found[41][0] > 0.04


@pytest.mark.parametrize(
    ("num", "length_mm", "is_stated"), [(5, 6.0, True), (21, 20.0, True), (4, 20.0, False), (21, 4.9, False)]
)
def test_taper_is_stated_only_for_five_cross_sections_over_five_millimetres(num, length_mm, is_stated):
    at = np.linspace(0.0, length_mm, num)
    even = np.full(num, 0.1)
    summary = summary_of(
        at, (8.0 - 0.05 * at, even), (even, even), np.ones(num, dtype=bool), angle_deg=None, stenosis=None
    )
    assert summary.taper == (pytest.approx(-0.05) if is_stated else None)


def test_cross_section_with_an_invalid_plane_is_refused(chest):
    arguments = (chest.volume.hu_zyx, chest.volume.lps_from_ijk)
    levels = {"min_contrast": 100.0, "brightest_wall": 100.0, "wall_rise": 1020.0, "noise": 10.0}
    with pytest.raises(UsageError, match="normal with length"):
        cast_sections(*arguments, [[0.0, 0, 0]], [[0.0, 0, 0]], [3.0], **levels)
    with pytest.raises(UsageError, match="radius"):
        cast_sections(*arguments, [[0.0, 0, 0]], [[0.0, 0, 1]], [np.nan], **levels)
    with pytest.raises(UsageError, match="as many"):
        cast_sections(*arguments, [[0.0, 0, 0]], [], [3.0], **levels)
    across, up = section_axes([0.0, 0.6, 0.8])
    np.testing.assert_allclose(np.cross(across, up), [0.0, 0.6, 0.8], atol=1e-12)
