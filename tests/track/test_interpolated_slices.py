"""Tests of the note on airways in interpolated slices, and of their confidence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cached_test_data import cached_phantom
from carina.track import find_airways, measure_tree
from carina.track.find.interpolated_slices import INTERPOLATED, MAX_CONFIDENCE, with_interpolated_note
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume import Volume, VolumeSource

SPACING_MM = np.array([0.7, 0.7, 2.0])


def ct(*missing: int) -> Volume:
    source = VolumeSource(format="dicom", title="ct", interpolated_slices=missing)
    return Volume(np.zeros((40, 20, 20), np.int16), np.diag([*SPACING_MM, 1.0]), source=source)


def branch(number: int, levels: tuple[float, float], **fields) -> Branch:
    ijk = np.stack([np.full(11, 9.0), np.full(11, 9.0), np.linspace(*levels, 11)], axis=1)
    parent = None if number == 0 else number - 1
    children = (1,) if number == 0 else ()
    return Branch(number, parent, children, number, None, "tracked", ijk * SPACING_MM, np.full(11, 3.0), **fields)


@pytest.fixture
def tree() -> AirwayTree:
    """Return a long branch from slice 30 to 12, and a short one from slice 12 to 10."""
    return AirwayTree((branch(0, (30, 12), confidence=0.9), branch(1, (12, 10), confidence=0.9)))


def test_tree_of_a_ct_without_interpolated_slices_has_no_note(tree):
    assert with_interpolated_note(tree, ct()) == (tree, None)


def test_tree_that_does_not_pass_the_interpolated_slices_has_no_note(tree):
    assert with_interpolated_note(tree, ct(3, 4)) == (tree, None)


def test_branch_that_passes_a_gap_keeps_its_confidence_and_is_counted(tree):
    changed, note = with_interpolated_note(tree, ct(20))
    assert note is not None
    assert (note.code, note.badge) == (INTERPOLATED, True)
    assert "1 of 2 branches passes through interpolated slices. Do not trust" in note.words
    assert [one.confidence for one in changed.branches] == [0.9, 0.9]


def test_branch_mostly_in_interpolated_slices_has_limited_confidence_and_is_named(tree):
    changed, note = with_interpolated_note(tree, ct(11))
    assert note is not None
    assert "1 of 2 branches passes" in note.words
    assert "most of branch 1 is in them" in note.words
    assert [one.confidence for one in changed.branches] == [0.9, MAX_CONFIDENCE]


def test_no_calibre_is_measured_in_interpolated_slices():
    volume = cached_phantom(spacing_mm=2.5, generations=3, noise_hu=0).volume
    airways = find_airways(volume, progress=False)
    root = airways.tree.root
    levels = np.rint(volume.to_ijk(root.points)[:, 2])
    missing = (int(np.median(levels)),)
    source = dataclasses.replace(volume.source, interpolated_slices=missing)
    whole = measure_tree(volume, airways, progress=False).of(root.id)
    part = measure_tree(dataclasses.replace(volume, source=source), airways, progress=False).of(root.id)
    unseen = np.isin(levels, missing)
    assert np.isfinite(whole.equivalent_mm[unseen]).any()
    assert np.isnan(part.equivalent_mm[unseen]).all()
    assert np.isnan(part.wall_mm[unseen]).all()
    assert not part.is_usable[unseen].any()
    np.testing.assert_array_equal(part.equivalent_mm[~unseen], whole.equivalent_mm[~unseen])
    assert part.summary.num_sections < whole.summary.num_sections
