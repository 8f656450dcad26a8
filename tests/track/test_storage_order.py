"""Tests that airways do not depend on the order in which a file stores the voxels."""

from __future__ import annotations

import dataclasses
from itertools import permutations, product

import numpy as np
import pytest

import carina
from cached_test_data import cached_phantom
from carina.track import CutBranch, edit_airways

CHEST = {"seed": 3, "spacing_mm": (1.3, 1.2, 1.5), "noise_hu": 25.0, "generations": 6}
ORDERS = [(axes, flips) for axes in permutations(range(3)) for flips in product((False, True), repeat=3)]
# Storage orders that together contain each permutation of the axes, and all but one of the reversals of axes.
SOME = [ORDERS[n] for n in (7, 10, 20, 27, 37, 46)]


def stored(volume, axes, flips):
    """Return the volume with array axis n taken from the original axis ``axes[n]``, reversed where ``flips[n]``."""
    steps = tuple(slice(None, None, -1 if flip else 1) for flip in flips)
    values = np.ascontiguousarray(volume.hu_zyx.transpose(axes)[steps])
    old_from_new = np.zeros((4, 4))
    old_from_new[3, 3] = 1.0
    for new, (axis, flip) in enumerate(zip(axes, flips, strict=True)):
        # Array axes have the order z, y, x.
        old_from_new[2 - axis, 2 - new] = -1.0 if flip else 1.0
        old_from_new[2 - axis, 3] = volume.shape_zyx[axis] - 1.0 if flip else 0.0
    return dataclasses.replace(volume, hu_zyx=values, lps_from_ijk=volume.lps_from_ijk @ old_from_new)


def on_stored_grid(array, axes, flips):
    steps = tuple(slice(None, None, -1 if flip else 1) for flip in flips)
    return array[steps].transpose(np.argsort(axes))


@pytest.fixture(scope="module")
def chest():
    volume = cached_phantom(**CHEST).volume
    return volume, carina.find_airways(volume)


def assert_same(volume, airways, axes, flips):
    other = stored(volume, axes, flips)
    found = carina.find_airways(other)
    assert found.lumen_zyx.shape == other.shape_zyx
    assert (on_stored_grid(found.lumen_zyx, axes, flips) == airways.lumen_zyx).all()
    assert len(found.tree) == len(airways.tree)
    for one, two in zip(found.tree.branches, airways.tree.branches, strict=True):
        assert (one.id, one.parent, one.name, one.generation) == (two.id, two.parent, two.name, two.generation)
        np.testing.assert_allclose(one.points, two.points, rtol=0, atol=1e-9)
        np.testing.assert_allclose(one.radius, two.radius, rtol=0, atol=1e-9)
        assert one.confidence == pytest.approx(two.confidence, abs=1e-9)
    assert found.notes == airways.notes
    assert [place.reason for place in found.uncertain] == [place.reason for place in airways.uncertain]
    return other, found


@pytest.mark.parametrize(("axes", "flips"), SOME, ids=str)
def test_airways_found_in_six_storage_orders_are_equal(chest, axes, flips):
    assert_same(*chest, axes, flips)


def test_airways_found_in_another_storage_order_are_tracked_and_edited_on_the_stored_grid(chest):
    volume, airways = chest
    other, found = assert_same(volume, airways, *ORDERS[27])
    tip = max(found.tree.tips(), key=lambda branch: branch.id)
    path = found.tracker.path_to(tip.tip_lps)
    straight = airways.tracker.path_to(tip.tip_lps)
    assert path.length_mm == pytest.approx(straight.length_mm, rel=0.02)
    assert set(path.branch_ids) == set(straight.branch_ids)
    i, j, k = np.rint(other.to_ijk(path.points_lps)).astype(int).T
    assert (found.lumen_zyx[k, j, i] == 1).all()
    edited = edit_airways(other, found, CutBranch(tip.id))
    assert len(edited.tree) < len(found.tree)
    assert edited.lumen_zyx.sum() < found.lumen_zyx.sum()


def test_mask_in_another_storage_order_gives_equal_airways(chest):
    volume, airways = chest
    axes, flips = ORDERS[20]
    other = stored(volume, axes, flips)
    steps = tuple(slice(None, None, -1 if flip else 1) for flip in flips)
    mask = airways.lumen_zyx.transpose(axes)[steps]
    one = carina.find_airways(volume, lumen_zyx=airways.lumen_zyx)
    two = carina.find_airways(other, lumen_zyx=mask)
    assert len(one.tree) == len(two.tree)
    for a, b in zip(one.tree.branches, two.tree.branches, strict=True):
        np.testing.assert_allclose(a.points, b.points, rtol=0, atol=1e-9)


@pytest.mark.soak
@pytest.mark.parametrize(("axes", "flips"), ORDERS, ids=str)
def test_airways_found_in_all_storage_orders_are_equal(chest, axes, flips):
    assert_same(*chest, axes, flips)
