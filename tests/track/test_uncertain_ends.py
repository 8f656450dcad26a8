"""Tests of the reasons why airways end, and of the confidence of each branch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina.errors import NoResultError
from carina.track import AirwayTree, Branch, find_airways
from carina.track.find.airway_ends import find_uncertain
from carina.track.tree.uncertainty import MAX_BESIDE_RIMS, wall_noise, with_confidence
from carina.volume.model import Volume


def tree_of(ends: list[tuple[list[float], float]]) -> AirwayTree:
    """Return a tree with a straight child for each end (position, radius), in mm.

    The trunk leads from (40, 40, 70) to (40, 40, 50).
    """
    children = tuple(range(1, len(ends) + 1))
    fork = np.array([40.0, 40.0, 50.0])
    trunk = Branch(0, None, children, 0, None, "tracked", np.linspace([40.0, 40.0, 70.0], fork, 21), np.full(21, 8.0))
    branches = [trunk]
    for number, (end, radius) in enumerate(ends, start=1):
        points = np.linspace(fork, end, 25)
        branches.append(Branch(number, 0, (), 1, None, "tracked", points, np.full(25, radius)))
    return AirwayTree(tuple(branches))


VOLUME = Volume(np.full((80, 80, 80), -860, np.int16), np.eye(4))


def test_airway_ends_too_wide_for_a_tip_are_listed_with_a_reason_widest_first():
    tree = tree_of(
        [
            ([20.0, 40.0, 30.0], 3.0),  # an end without a cause nearby
            ([60.0, 40.0, 30.0], 2.0),  # an end beside a leak
            ([40.0, 40.0, 1.0], 4.0),  # an end at a face of the volume
            ([40.0, 60.0, 30.0], 0.9),  # an end of a thin airway
        ]
    )
    found = find_uncertain(VOLUME, tree, np.array([[61.0, 43.0, 33.0]]))
    assert [(entry.kind, entry.branch_id) for entry in found] == [
        ("volume", 3),
        ("lost", 1),
        ("leak", 2),
        ("fine", None),
    ]
    assert found[1].lps == (20.0, 40.0, 30.0)
    # Slices are counted from the feet, so z = 30 mm is the 31st.
    assert found[1].reason == "lost here, 6.0 mm wide (slice 31 of 80 from the feet)"
    assert found[2].reason.startswith(
        "lost here, 4.0 mm wide (slice 31 of 80 from the feet): its wall is too thin here"
    )
    assert "1.8 mm" in found[3].reason
    assert "at the thinnest branch end:" in found[3].reason


def test_branch_with_a_hardly_visible_wall_is_listed_as_faint():
    tree = tree_of([([20.0, 40.0, 30.0], 0.9)])
    trunk, thin = tree.branches
    tree = AirwayTree((trunk, dataclasses.replace(thin, confidence=0.31)))
    found = find_uncertain(VOLUME, tree, np.empty((0, 3)))
    assert [(entry.kind, entry.branch_id) for entry in found] == [("faint", 1), ("fine", None)]
    assert "0.31" in found[0].reason


def test_branch_confidence_is_high_with_a_visible_wall_and_low_in_plain_lung(chest, found, rng):
    sure = [branch.confidence for branch in found.tree.branches]
    assert min(sure) > 0.7
    assert all(0.0 <= value <= 1.0 for value in sure)
    lung = Volume((-860 + rng.normal(0.0, 12.0, chest.volume.shape_zyx)).astype(np.int16), chest.volume.lps_from_ijk)
    pretended = with_confidence(lung, found.tree, 12.0)
    assert max(branch.confidence for branch in pretended.branches) < 0.3
    noisier = with_confidence(chest.volume, found.tree, 120.0)
    assert all(a.confidence < b.confidence for a, b in zip(noisier.branches, found.tree.branches, strict=True))


def test_closed_ends_of_wide_bronchi_are_listed_without_naming_a_disease(found):
    tips = {branch.id for branch in found.tree.tips()}
    # Drawn tubes of 6 mm end in the middle of the lung, with a wall around their end.
    ends = [entry for entry in found.uncertain if entry.kind in ("stump", "lost")]
    assert {entry.branch_id for entry in ends} == tips
    assert any(entry.kind == "stump" for entry in ends)
    for entry in ends:
        assert not any(word in entry.reason for word in ("mucus", "tumour", "collapsed", "resected"))


@pytest.mark.parametrize("flips", [(False, False, False), (False, False, True)])
def test_slice_numbers_of_airway_ends_are_counted_from_the_feet_in_any_storage_order(flips, draw_chest):
    drawn = draw_chest(flips=flips)
    airways = find_airways(drawn.volume)
    k = np.array([drawn.volume.to_ijk(np.array(place.lps))[2] for place in airways.uncertain if place.branch_id])
    last = drawn.volume.shape_zyx[0] - 1
    from_feet = last - k if flips[2] else k
    assert [p.slice_number for p in airways.uncertain if p.branch_id] == [round(v) + 1 for v in from_feet]


def test_mask_of_another_tool_has_no_uncertain_airway_ends(chest, found):
    given = find_airways(chest.volume, lumen_zyx=found.lumen_zyx)
    assert given.uncertain == ()
    assert all(branch.confidence is None for branch in given.tree.branches)


def test_mask_in_several_pieces_is_reduced_to_the_piece_with_the_root_and_this_is_reported(chest, found):
    lumen = np.array(found.lumen_zyx)
    alone = find_airways(chest.volume, lumen_zyx=lumen)
    lumen[3:6, 3:6, 3:6] = 1
    both = find_airways(chest.volume, lumen_zyx=lumen)
    assert len(both.tree) == len(alone.tree)
    assert any("27 lumen voxels are not connected" in note for note in both.notes)


def test_empty_mask_is_refused_with_a_message(chest):
    with pytest.raises(NoResultError, match="no voxel is set") as caught:
        find_airways(chest.volume, lumen_zyx=np.zeros(chest.volume.shape_zyx, np.uint8))
    assert caught.value.exit_code == 4


def walled_tube(radius_mm: float) -> tuple[Volume, AirwayTree]:
    """Return a straight tube with a wall of 1 mm along z, and the tree of its only branch."""
    x, y = np.meshgrid(np.arange(40), np.arange(40), indexing="ij")
    off = np.hypot(x - 20.0, y - 20.0)
    plane = np.where(off <= radius_mm, -1000, np.where(off <= radius_mm + 1.0, -100, -860)).astype(np.int16)
    volume = Volume(np.ascontiguousarray(np.broadcast_to(plane.T, (60, 40, 40))), np.eye(4))
    points = np.linspace([20.0, 20.0, 50.0], [20.0, 20.0, 10.0], 41)
    return volume, AirwayTree((Branch(0, None, (), 0, None, "tracked", points, np.full(41, radius_mm)),))


def test_thin_lumen_beside_dark_rims_has_low_confidence_and_a_wide_lumen_high_confidence():
    for radius_mm, is_limited in ((1.5, True), (4.0, False)):
        volume, tree = walled_tube(radius_mm)
        for rims_hu in (None, 5.0, 30.0):
            confidence = with_confidence(volume, tree, 10.0, rims_hu=rims_hu).root.confidence
            assert confidence is not None
            if is_limited and rims_hu == 30.0:
                assert confidence == MAX_BESIDE_RIMS
            else:
                assert confidence > MAX_BESIDE_RIMS


def test_assumed_noise_of_a_wall_increases_less_than_the_noise_of_a_voxel():
    assert wall_noise(10.0) == 10.0
    assert wall_noise(25.0) == pytest.approx(25.0)
    assert 25.0 < wall_noise(40.0) < 40.0
    volume, tree = walled_tube(3.0)
    confidences = [with_confidence(volume, tree, noise).root.confidence for noise in (25.0, 60.0, 100.0, 400.0)]
    assert confidences == sorted(confidences, reverse=True)
    assert confidences[-1] < 0.1
