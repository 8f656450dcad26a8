"""Tests of thick slices: calibrated shares of airways, the note that states them, and explained misses."""

from __future__ import annotations

import dataclasses
import json
import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import carina
from cached_test_data import cached_airways, cached_phantom
from carina.commands.tree import CutBranch
from carina.track import Airways, AirwayTree, edit_airways, find_absent, fold_airways
from carina.track.tree.thick_slices import (
    PATIENT_FACTOR,
    SHARES,
    SLICES_MM,
    THICK_SLICES,
    calibrated_shares,
    effective_mm,
    miss_text,
    shares_in,
    shares_of,
    with_slice_note,
)
from carina.volume import Volume, VolumeSource, badges_of
from carina_bench.track_shares import CALIBRES, MIN_LENGTH_MM, length_by_calibre
from carina_bench.track_truth import truth_of_phantom

THICK: dict[str, Any] = {"spacing_mm": (0.8, 0.8, 3.0), "noise_hu": 25.0, "seed": 4}
DISEASE = re.compile("blocked|filled|fills|resected|collapsed|tumour|mucus|secretions|obstructed")
ROUNDING = 0.05
CALIBRE_ENDS_MM = (1.0, 2.0, 3.0, 4.0, 6.0)


def ct_of(slice_mm: float, *, pixel_mm: float = 0.7, thickness_mm: float | None = None) -> Volume:
    source = VolumeSource(format="array", title="t", slice_thickness_mm=thickness_mm)
    return Volume(np.zeros((4, 5, 6), np.int16), np.diag([pixel_mm, pixel_mm, slice_mm, 1.0]), source=source)


def note_of(tree: AirwayTree) -> str | None:
    """Return the text of the note of thick slices; None if the tree has no such note."""
    found = [note for note in tree.notes if note.code == THICK_SLICES]
    assert all(note.badge for note in found)
    return found[0].words if found else None


@pytest.fixture(scope="module")
def chest() -> Airways:
    return cached_airways(**THICK)


@given(st.floats(0.3, 12.0), st.floats(0.0, 3.0))
def test_calibrated_detection_share_increases_with_diameter_and_decreases_with_slice_thickness(slice_mm, more_mm):
    shares, thicker = calibrated_shares(slice_mm), calibrated_shares(slice_mm + more_mm)
    for one, other in pairwise(shares):
        assert one.from_mm == other.to_mm
        assert one.most >= other.most
        assert one.least >= other.least - ROUNDING
    for share, later in zip(shares, thicker, strict=True):
        assert 0.0 <= share.least <= (share.typical or share.least) <= share.most <= 1.0
        assert (share.typical is None) == (slice_mm > SLICES_MM[-1])
        if share.typical is not None and later.typical is not None:
            # The mean shares must decrease with the thickness; the extreme shares need not, because two thicknesses
            # have an outlier each.
            assert later.typical <= share.typical + ROUNDING


def test_detection_shares_of_calibrated_slice_thicknesses_are_the_measured_ones():
    for n, slice_mm in enumerate(SLICES_MM):
        for share in calibrated_shares(slice_mm):
            measured = SHARES[share.from_mm, share.to_mm][n]
            assert measured == pytest.approx((100 * share.least, 100 * (share.typical or 0.0), 100 * share.most))


@pytest.mark.parametrize(
    ("slice_mm", "is_thick"), [(0.7, False), (1.0, False), (1.25, False), (1.5, False), (2.0, True), (5.0, True)]
)
def test_slices_count_as_thick_if_airways_of_2_to_3_mm_are_missed(chest, slice_mm, is_thick):
    tree = dataclasses.replace(chest.tree, notes=())
    assert (note_of(with_slice_note(tree, ct_of(slice_mm))) is not None) == is_thick


def test_overlapping_slices_count_as_thinner_and_slices_with_gaps_as_thick_as_their_distance():
    assert effective_mm(3.0, 3.0) == 3.0
    assert effective_mm(5.0, 2.5) == 3.75
    assert effective_mm(1.0, 10.0) == 10.0
    overlapping = shares_in(ct_of(2.5, thickness_mm=5.0))
    assert overlapping is not None
    assert (overlapping.slices, overlapping.shares) == (
        "slices of 5 mm every 2.5 mm",
        calibrated_shares(PATIENT_FACTOR * 3.75),
    )
    gaps = shares_in(ct_of(3.0, thickness_mm=1.0))
    assert gaps is not None
    assert (gaps.slices, gaps.shares) == ("slices of 3 mm", calibrated_shares(PATIENT_FACTOR * 3.0))
    assert shares_in(ct_of(0.6, thickness_mm=1.2)) is None


def test_slices_thicker_than_calibrated_have_only_upper_limits_of_the_detection_shares():
    thickest = shares_in(ct_of(5.0))
    assert thickest is not None
    assert thickest.shares == calibrated_shares(5.0)
    thicker = shares_in(ct_of(5.1))
    assert thicker is not None
    assert [share.most for share in thicker.shares] == [share.most for share in thickest.shares]
    assert all(share.least == 0.0 and share.typical is None for share in thicker.shares)


def test_missed_airway_of_a_diameter_that_is_always_found_is_not_explained_by_the_slices():
    found = shares_in(ct_of(2.0))
    assert found is not None
    assert miss_text(found, 8.0) == ""
    assert miss_text(found, 2.5) == "; in slices of 2 mm, Carina finds 70 % (45 to 90 %) of airways of this width"


def test_pixels_wider_than_calibrated_give_only_limits_of_the_detection_shares(chest):
    coarse = shares_in(ct_of(3.0, pixel_mm=0.98))
    assert coarse is not None
    assert all(share.least == 0.0 and share.typical is None for share in coarse.shares)
    text = note_of(with_slice_note(dataclasses.replace(chest.tree, notes=()), ct_of(3.0, pixel_mm=0.98))) or ""
    limits = "at most 90 % of the length of airways of 3 to 4 mm, at most 75 % of those of 2 to 3 mm and at most 25 %"
    assert f"Carina finds {limits} of those of 1 to 2 mm." in text


def test_note_of_a_search_in_thick_slices_states_the_detection_share_of_each_diameter(chest):
    text = note_of(chest.tree)
    assert text is not None
    assert text in chest.notes
    assert text.startswith(
        "slices of 3 mm: in such CTs, Carina finds 95 % (90 to 100 %) of the length of airways wider than 6 mm"
    )
    assert "40 % (20 to 75 %) of those of 2 to 3 mm and 5 % (at most 25 %) of those of 1 to 2 mm." in text
    assert "An airway that is not in the tree may still be there." in text
    assert [note.words for note in badges_of(cached_phantom(**THICK).volume, chest) if note.code == THICK_SLICES] == [
        text
    ]


def test_tree_from_thin_slices_has_no_note_and_no_detection_shares():
    thin = cached_airways(seed=1, spacing_mm=1.1, noise_hu=25.0)
    assert note_of(thin.tree) is None
    assert thin.calibrated_shares is None


def test_note_of_thick_slices_is_preserved_by_files_edits_and_undo_storage(chest, tmp_path):
    text = note_of(chest.tree)
    assert note_of(AirwayTree.from_json(json.loads(json.dumps(chest.tree.to_json())))) == text
    path = tmp_path / "t.json"
    carina.write_tree(path, chest.tree)
    assert note_of(carina.read_tree(path)) == text
    tip = max(chest.tree.tips(), key=lambda branch: branch.generation)
    edited = edit_airways(cached_phantom(**THICK).volume, chest, CutBranch(tip.id))
    assert note_of(edited.tree) == text
    assert edited.calibrated_shares == chest.calibrated_shares
    assert note_of(fold_airways(edited).unfold().tree) == text


def test_mask_of_another_tool_has_no_note_of_thick_slices(chest):
    volume = cached_phantom(**THICK).volume
    imported = carina.find_airways(volume, lumen_zyx=chest.lumen_zyx)
    assert note_of(imported.tree) is None
    assert imported.calibrated_shares is None


def test_detection_shares_as_json_equal_those_of_the_note(chest):
    shares = chest.calibrated_shares
    assert shares is not None
    document = json.loads(json.dumps(shares.to_json()))
    assert (document["slice_mm"], document["distance_mm"]) == (3.0, 3.0)
    assert document["shares"][3] == {"from_mm": 2.0, "to_mm": 3.0, "least": 0.2, "typical": 0.4, "most": 0.75}


def without(tree: AirwayTree, name: str) -> AirwayTree:
    """Return the tree without a named branch and its descendants."""
    removed: set[int] = set()
    for branch in tree.branches:
        if branch.name == name or branch.parent in removed:
            removed.add(branch.id)
    remaining = tuple(
        dataclasses.replace(branch, children=tuple(child for child in branch.children if child not in removed))
        for branch in tree.branches
        if branch.id not in removed
    )
    return dataclasses.replace(tree, branches=remaining)


def test_reason_for_a_missed_segment_in_thick_slices_is_the_slice_thickness_not_a_disease(chest):
    volume = cached_phantom(**THICK).volume
    segment = next(b.name for b in chest.tree.branches if b.name is not None and re.fullmatch("[RL]B[0-9]+", b.name))
    tree = without(chest.tree, segment)
    (absence,) = [one for one in find_absent(tree, (), volume) if one.name == segment]
    assert absence.reason.endswith("; slices of 3 mm hide many airways, so it may still be there")
    assert not DISEASE.search(absence.words)
    lost = dataclasses.replace(absence, kind="lost", width_mm=2.5)
    assert lost.reason.endswith("; in slices of 3 mm, Carina finds 40 % (20 to 75 %) of airways of this width")
    # The slices are unknown if the tree has no note, or if it was not found in a CT.
    (plain,) = [one for one in find_absent(dataclasses.replace(tree, notes=()), (), volume) if one.name == segment]
    (alone,) = [one for one in find_absent(tree) if one.name == segment]
    assert "hide" not in plain.reason + alone.reason
    assert shares_of(dataclasses.replace(tree, notes=()), volume) is None


def test_search_in_a_phantom_not_used_for_calibration_finds_the_stated_shares(chest, capsys):
    made = cached_phantom(**THICK)
    truth = truth_of_phantom(made.truth, made.lumen_zyx, made.volume)
    found, whole = length_by_calibre(made.volume, truth, chest.lumen_zyx != 0)
    assert len(CALIBRES) == len(CALIBRE_ENDS_MM)
    for share, hit, length in zip(calibrated_shares(3.0), found, whole, strict=True):
        if length >= MIN_LENGTH_MM:
            with capsys.disabled():
                print(f"\n{share.from_mm:g} to {share.to_mm or 99:g} mm: {hit / length:.2f}")
            assert share.least - ROUNDING <= hit / length <= share.most + ROUNDING
