"""Tests that parts drawn by hand, which the CT does not show, are counted separately and not measured."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cached_test_data import SMALL_CHEST, cached_airways, cached_phantom
from carina.case.routes import route_to_branch
from carina.track import AirwayTree, DrawnPart, drawn_part, drawn_tree, measure_tree


@pytest.fixture(scope="module")
def case():
    """Return a phantom, its airways, and a branch of the periphery that has no children."""
    airways = cached_airways(**SMALL_CHEST)
    leaf = max(airways.tree.tips(), key=lambda branch: (branch.generation, branch.length_mm))
    return cached_phantom(**SMALL_CHEST).volume, airways, leaf


def of_kind(airways, branch_id: int, kind: str):
    branches = tuple(dataclasses.replace(b, kind=kind) if b.id == branch_id else b for b in airways.tree.branches)
    return dataclasses.replace(airways, tree=dataclasses.replace(airways.tree, branches=branches))


@pytest.mark.parametrize("kind", ["manual", "bridge"])
def test_length_of_a_route_along_branches_not_visible_in_the_ct_is_stated(case, kind):
    _, airways, leaf = case
    tree = of_kind(airways, leaf.id, kind).tree
    route = route_to_branch(tree, leaf.id)
    found = {"manual": route.drawn.drawn_mm, "bridge": route.drawn.bridge_mm}
    # The route is smoothed as a whole, so its last branch is slightly shorter than the branch itself.
    assert found.pop(kind) == pytest.approx(leaf.length_mm, rel=0.05)
    assert list(found.values()) == [0.0]
    assert route.drawn.length_mm == pytest.approx(route.length_mm)
    assert [span.kind for span in route.spans] == ["tracked"] * (len(route.spans) - 1) + [kind]
    assert route_to_branch(airways.tree, leaf.id).drawn.words is None


def test_text_of_a_route_states_its_drawn_and_total_length():
    assert DrawnPart(180.0, drawn_mm=21.0).words == "21 of 180 mm drawn by hand"
    assert DrawnPart(180.0, 21.0, 8.0).words == "21 of 180 mm drawn by hand; 8 of 180 mm bridged across an obstruction"
    assert DrawnPart(180.0).words is None


@pytest.mark.parametrize(("places_mm", "length_mm"), [([], 0.0), ([4.0], 0.0), ([4.0, 9.0], 5.0)])
def test_drawn_length_of_a_path_of_zero_or_one_step_is_the_length_of_the_path(case, places_mm, length_mm):
    _, airways, leaf = case
    tree = of_kind(airways, leaf.id, "manual").tree
    ids = np.full(len(places_mm), leaf.id)
    assert drawn_part(tree, ids, np.array(places_mm)) == DrawnPart(length_mm, drawn_mm=length_mm)


def test_path_in_lumen_without_a_branch_does_not_count_as_drawn_by_hand(case):
    _, airways, _ = case
    assert drawn_part(airways.tree, np.array([-1, -1, -1]), np.array([0.0, 1.0, 3.0])) == DrawnPart(3.0)
    assert drawn_tree(airways.tree).words is None
    assert isinstance(airways.tree, AirwayTree)


@pytest.mark.parametrize("kind", ["manual", "bridge"])
def test_branch_drawn_by_hand_has_a_measured_length_and_no_diameter(case, kind):
    volume, airways, leaf = case
    found = measure_tree(volume, airways)
    drawn = measure_tree(volume, of_kind(airways, leaf.id, kind), previous=found)
    assert found.of(leaf.id).summary.mean_mm is not None
    summary = drawn.of(leaf.id).summary
    assert summary.length_mm == pytest.approx(found.of(leaf.id).summary.length_mm)
    assert summary.num_sections == 0
    figures = (summary.mean_mm, summary.min_mm, summary.wall_mm, summary.taper, summary.stenosis)
    assert figures == (None,) * 5
    assert np.isnan(drawn.of(leaf.id).equivalent_mm).all()
