"""Tests of absent lobes and segments: each has evidence in the CT, and a missed branch does not count as a disease."""

from __future__ import annotations

import dataclasses
import re

import msgspec
import numpy as np
import pytest
from plugged_chest import CHEST, named, plugged

import carina
from cached_test_data import cached_airways, cached_phantom
from cached_test_data import patient as the_patient
from carina.track import AirwayTree, Branch, find_absent, name_tree
from carina.track.tree.uncertainty import Uncertainty, filled_place, without_unproven_blocks
from carina.volume import Volume

DISEASE = re.compile("blocked|filled|fills|resected|collapsed|tumour|mucus|secretions|obstructed")


def off_mm(points, place):
    """Return the distance of a point from the nearest point of a centreline, mm."""
    return float(np.linalg.norm(points - np.array(place), axis=1).min())


@pytest.fixture(scope="module")
def chest():
    return cached_phantom(**CHEST), cached_airways(**CHEST)


def without(tree, name):
    """Return the tree without a named branch and its descendants."""
    removed = {branch.id for branch in tree.branches if branch.name == name}
    for branch in tree.branches:
        if branch.parent in removed:
            removed.add(branch.id)
    remaining = tuple(
        dataclasses.replace(branch, children=tuple(child for child in branch.children if child not in removed))
        for branch in tree.branches
        if branch.id not in removed
    )
    return dataclasses.replace(tree, branches=remaining)


def test_tree_with_all_segments_has_no_absent_segment(chest):
    assert chest[1].absent == ()


def test_tree_without_names_reports_no_absent_segments(chest):
    bare = tuple(dataclasses.replace(branch, name=None) for branch in chest[1].tree.branches)
    assert find_absent(AirwayTree(bare)) == ()


@pytest.mark.parametrize("name", ["RB6", "LB3", "RB10", "LB1+2"])
def test_missed_segment_is_reported_on_its_parent_branch_without_naming_a_disease(chest, name):
    made, airways = chest
    tree = without(airways.tree, name)
    (absence,) = find_absent(tree, (), made.volume)
    assert absence.name == name
    assert absence.kind in ("nothing", "unnamed", "fine")
    assert absence.carrier != name
    assert absence.words.startswith(f"{name} (")
    assert not DISEASE.search(absence.words)
    parent = tree.branch(named(airways, name).parent)
    assert off_mm(parent.points, absence.lps) < 3.0
    number = round(made.volume.to_ijk(np.array(absence.lps))[2]) + 1
    assert f"(slice {number} of {made.volume.shape_zyx[0]} from the feet)" in absence.words


@pytest.mark.parametrize("name", ["RML", "LLL", "RUL"])
def test_missed_lobe_is_reported_once_at_its_origin_without_naming_a_disease(chest, name):
    made, airways = chest
    (absence,) = find_absent(without(airways.tree, name), (), made.volume)
    assert absence.name == name
    assert absence.carrier in ("BI", "LMB", "RMB")
    assert not DISEASE.search(absence.words)
    assert np.linalg.norm(named(airways, name).points[0] - absence.lps) < 5.0


def test_missing_lobe_is_reported_at_its_origin_and_not_at_a_lost_end_in_another_lobe(chest):
    made, airways = chest
    tree = without(without(airways.tree, "RML"), "Right basal trunk")
    lower = tree.named("RLL")
    unnamed = dataclasses.replace(lower, name=None)
    tree = dataclasses.replace(tree, branches=tuple(unnamed if b.id == lower.id else b for b in tree.branches))
    absences = find_absent(tree, [end("lost", lower.id, 8.0)], made.volume)
    (middle,) = [absence for absence in absences if absence.name == "RML"]
    assert np.linalg.norm(named(airways, "RML").points[0] - middle.lps) < 5.0
    assert np.linalg.norm(lower.tip_lps - middle.lps) > 5.0


@pytest.mark.parametrize("name", ["RB6", "LB10", "RB4"])
def test_unnamed_branch_at_the_position_of_a_segment_is_reported_instead_of_an_absent_segment(chest, name):
    made, airways = chest
    branch = named(airways, name)
    beyond = {branch.id}
    for other in airways.tree.branches:
        if other.parent in beyond:
            beyond.add(other.id)
    bare = tuple(
        dataclasses.replace(b, name=None, name_from=None, name_confidence=None) if b.id in beyond else b
        for b in airways.tree.branches
    )
    parent = airways.tree.branch(branch.parent)
    narrowed = filled_place(
        parent.points[-1], parent.id, air_mm=3.0, length_mm=6.0, calibre_mm=6.0, calibre_error_mm=0.5, beyond_lps=None
    )
    (absence,) = find_absent(dataclasses.replace(airways.tree, branches=bare), [narrowed], made.volume)
    assert (absence.name, absence.kind, absence.branch_id) == (name, "unnamed", branch.id)
    assert f"an unnamed branch runs where it is expected: branch {branch.id}" in absence.words
    assert not DISEASE.search(absence.words)


def resected(seed, lobe, stump_mm=4.0):
    """Return a true tree, and the tree after the resection of a lobe.

    A stump of the lobe's bronchus remains, and the neighbouring bronchi move towards it.
    """
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    made = carina.generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box, generations=5)
    whole = AirwayTree.from_json(made.truth)
    lost = whole.named(lobe)
    cut = without(whole, lobe)
    left_mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(lost.points, axis=0), axis=1))])
    num_points = max(int((left_mm <= stump_mm).sum()), 2)
    stump = dataclasses.replace(
        lost, name=None, children=(), points=lost.points[:num_points], radius=lost.radius[:num_points]
    )
    siblings = whole.branch(lost.parent).children
    carrier = dataclasses.replace(cut.branch(lost.parent), children=siblings)
    branches = [carrier if b.id == carrier.id else b for b in cut.branches]
    branches.insert(1 + branches.index(carrier), stump)
    middle = lost.points[-1]
    is_right = middle[0] < 0.0

    def moved(points):
        toward = middle - points
        beside = (np.abs(points[:, 0]) > 15.0) & ((points[:, 0] < 0.0) == is_right)
        return points + beside[:, None] * 0.15 * toward * np.exp(-np.linalg.norm(toward, axis=1) / 80.0)[:, None]

    return whole, AirwayTree(tuple(dataclasses.replace(b, name=None, points=moved(b.points)) for b in branches))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("lobe", ["RUL", "RML"])
def test_lobe_absent_from_a_tree_without_ct_is_not_reported_as_resected(seed, lobe):
    whole, tree = resected(seed, lobe)
    read = name_tree(tree)
    assert read.notes == ()
    (absence,) = find_absent(read)
    assert absence.name == lobe
    assert not DISEASE.search(absence.words), "no CT proves it"
    true = {b.id: b.name for b in whole.branches if b.name is not None and b.name[1:2] == "B"}
    left = [b for b in read.branches if b.id in true]
    assert sum(b.name == true[b.id] for b in left) >= 0.8 * len(left)


@pytest.mark.parametrize(
    "lobe", ["LLL", *(pytest.param(lobe, marks=pytest.mark.soak) for lobe in ("RML", "RUL", "LUL"))]
)
def test_resected_lobe_is_listed_once_and_branches_of_other_lobes_are_named_correctly(lobe):
    made = carina.generate_phantom(seed=2, spacing_mm=1.0, noise_hu=25.0, resected=lobe)
    airways = carina.find_airways(made.volume)
    (absence,) = airways.absent
    assert absence.name == lobe
    assert absence.kind == "resected"
    assert "its bronchus ends in a stump" in absence.reason
    assert "it was resected, or a tumour or mucus fills it" in absence.reason
    true = [branch for branch in made.truth["branches"] if (branch["name"] or "")[1:2] == "B"]
    places = np.concatenate([branch["points"] for branch in true])
    names = [branch["name"] for branch in true for _ in branch["points"]]
    for branch in airways.tree.branches:
        if branch.name in names:
            middle = branch.points[len(branch.points) // 2]
            assert names[int(np.argmin(np.linalg.norm(places - middle, axis=1)))] == branch.name


@pytest.mark.parametrize(("name", "lacking", "carrier"), [("RML", {"RML", "RLL"}, "BI"), ("LB6", {"LB6"}, "LLL")])
def test_mucus_in_a_bronchus_is_reported_as_reason_with_its_position(chest, name, lacking, carrier):
    made, whole = chest
    branch = named(whole, name)
    airways = carina.find_airways(plugged(made.volume, branch, 6.0))
    assert {one.name for one in airways.absent} == lacking
    for absence in airways.absent:
        assert (absence.kind, absence.carrier) == ("filled", carrier)
        assert absence.beyond_mm < 25.0
        # The middle of the mucus, which extends up to 14 mm into the branch, is compared.
        assert np.linalg.norm(np.array(absence.lps) - branch.points[0]) < 12.0


def test_reason_for_an_absent_segment_is_the_mucus_in_its_bronchus_and_not_another_branch_end(chest):
    made, whole = chest
    airways = carina.find_airways(plugged(made.volume, named(whole, "LB3"), 6.0))
    assert {one.name for one in airways.absent} == {"LB1+2", "LB3"}
    reasons = {absence.name: (absence.kind, absence.carrier) for absence in airways.absent}
    # Without LB3 nothing distinguishes LB1+2 from a common stem of all three; its branches are present without a name.
    assert reasons == {"LB1+2": ("unnamed", "Upper division"), "LB3": ("filled", "Upper division")}


def test_segments_below_the_end_of_the_scan_are_reported_as_outside(chest):
    made, _ = chest
    cut = made.volume.hu_zyx.shape[0] * 2 // 5
    place = made.volume.lps_from_ijk.copy()
    place[:3, 3] += cut * place[:3, 2]
    airways = carina.find_airways(Volume(np.ascontiguousarray(made.volume.hu_zyx[cut:]), place))
    kinds = {absence.name: absence.kind for absence in airways.absent}
    # Only the first millimetres of some segments are in the scan, which is too little for a name.
    assert {"outside"} <= set(kinds.values()) <= {"outside", "unnamed"}
    assert not any(DISEASE.search(absence.words) for absence in airways.absent)


CROPS = {
    "right": (lambda ijk: (slice(None), slice(None), slice(None, int(ijk[0]) + 17)), {"LUL", "LLL"}),
    "left": (lambda ijk: (slice(None), slice(None), slice(int(ijk[0]) - 8, None)), {"RUL", "RML", "RLL"}),
    "top": (lambda ijk: (slice(int(ijk[2]) - 25, None),), {"RML", "RLL", "LUL", "LLL"}),
}


@pytest.mark.parametrize("part", CROPS)
def test_lobes_outside_a_cropped_scan_are_reported_as_outside(chest, part):
    made, _ = chest
    box, outside = CROPS[part]
    cut = box(made.volume.to_ijk(np.zeros(3)))
    place = made.volume.lps_from_ijk.copy()
    for axis, one in zip((2, 1, 0), cut, strict=False):
        place[:3, 3] += (one.start or 0) * place[:3, axis]
    airways = carina.find_airways(Volume(np.ascontiguousarray(made.volume.hu_zyx[cut]), place))
    assert airways.root_lps[2] > 105.0, "the tree begins at the top of the trachea"
    assert {absence.name for absence in airways.absent} == outside
    for absence in airways.absent:
        assert absence.kind == "outside"
        assert absence.words == f"{absence.full_name} is outside this scan"
    assert not any(uncertain.kind in ("filled", "blocked") for uncertain in airways.uncertain)


def test_lobes_in_padding_are_reported_as_outside(chest):
    made, airways = chest
    values = made.volume.hu_zyx.copy()
    values[:, :, int(made.volume.to_ijk(np.zeros(3))[0]) + 12 :] = -1024
    tree = without(without(airways.tree, "LUL"), "LLL")
    absences = find_absent(tree, (), Volume(values, made.volume.lps_from_ijk))
    assert {absence.name: absence.kind for absence in absences} == {"LUL": "outside", "LLL": "outside"}


def end(kind, branch_id, width_mm):
    return Uncertainty(
        lps=(1.0, 2.0, 3.0),
        kind=kind,
        branch_id=branch_id,
        width_mm=width_mm,
        confidence=None,
        num_ends=None,
        voxel_mm=None,
    )


def test_reason_of_a_lost_airway_end_is_reported_for_all_segments_beyond_it():
    trunk = Branch(0, None, (1, 2), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -90]]), np.full(2, 8.0))
    right = Branch(1, 0, (), 1, "RMB", "tracked", np.array([[0.0, 0, -90], [-30, 0, -130]]), np.full(2, 6.0))
    left = Branch(2, 0, (), 1, "LMB", "tracked", np.array([[0.0, 0, -90], [40, 0, -110]]), np.full(2, 6.0))
    absences = find_absent(AirwayTree((trunk, right, left)), [end("lost", 1, 7.2), end("volume", 2, 9.0)])
    assert [(one.name, one.kind, one.carrier) for one in absences] == [
        ("RUL", "lost", "RMB"),
        ("RML", "lost", "RMB"),
        ("RLL", "lost", "RMB"),
        ("LUL", "outside", "LMB"),
        ("LLL", "outside", "LMB"),
    ]
    assert absences[0].beyond_mm == pytest.approx(50.0)
    assert absences[0].reason == "lost 50 mm beyond the start of RMB, 7.2 mm wide"


def test_airway_end_stored_as_blocked_by_an_earlier_version_is_reported_as_lost():
    (place,) = without_unproven_blocks([end("blocked", 1, 7.2)])
    assert place.kind == "lost"
    assert end("blocked", 1, 7.2).reason == "lost here, 7.2 mm wide"
    proven = msgspec.structs.replace(end("blocked", 1, 7.2), length_mm=9.0, slice_number=37, num_slices=104)
    assert without_unproven_blocks([proven]) == (proven,)
    assert proven.reason == (
        "the lumen ends here, 7.2 mm wide (slice 37 of 104 from the feet); soft tissue continues the bronchus over at "
        "least 9 mm: possibly mucus, a tumour or a collapsed airway"
    )


def test_mirrored_chest_has_the_three_lobed_lung_on_the_left(chest):
    made, _ = chest
    place = made.volume.lps_from_ijk.copy()
    place[0, :] *= -1.0
    airways = carina.find_airways(Volume(made.volume.hu_zyx, place))
    assert {absence.name for absence in airways.absent} == set()
    lacking = find_absent(without(airways.tree, "LML"))
    assert [absence.name for absence in lacking] == ["LML"]


def test_absent_segments_of_the_bundled_patient_are_only_those_with_unidentified_branches():
    airways = the_patient()[1]
    assert {"RML", "RB4", "RB5", "RB6"} <= {branch.name for branch in airways.tree.branches}
    assert {absence.name for absence in airways.absent} <= {"LB8", "LB9"}
    for absence in airways.absent:
        assert absence.kind == "unnamed"
        assert airways.tree.branch(absence.branch_id).name is None
        assert absence.words in airways._repr_html_()


@pytest.mark.parametrize("spacing_mm", [(1.0, 1.0, 4.0), 2.5, 3.0])
def test_reasons_for_missed_segments_in_coarse_scans_of_a_healthy_chest_name_no_disease(spacing_mm):
    airways = carina.find_airways(cached_phantom(seed=3, spacing_mm=spacing_mm, noise_hu=25.0).volume)
    assert len(airways.tree) < 120, "the search misses airways that the phantom has"
    texts = [*(absence.words for absence in airways.absent), *(place.reason for place in airways.uncertain)]
    assert texts
    assert [text for text in texts if DISEASE.search(text)] == []


def test_stump_beside_a_branch_is_not_the_reason_for_segments_beyond_the_branch():
    trunk = Branch(0, None, (1,), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -90]]), np.full(2, 8.0))
    right = Branch(1, 0, (), 1, "RMB", "tracked", np.array([[0.0, 0, -90], [-30, 0, -130]]), np.full(2, 6.0))
    tree = AirwayTree((trunk, right))
    at_tip = msgspec.structs.replace(end("stump", 1, 12.0), lps=(-30.0, 0.0, -130.0))
    beside = msgspec.structs.replace(at_tip, lps=(-12.0, 0.0, -106.0))
    assert {one.kind for one in find_absent(tree, [at_tip]) if one.name[0] == "R"} == {"lost"}
    assert {one.kind for one in find_absent(tree, [beside]) if one.name[0] == "R"} == {"nothing"}


def test_stump_without_a_branch_is_listed_at_the_end_of_its_bronchus():
    made = carina.generate_phantom(seed=2, spacing_mm=(1.0, 1.0, 3.0), noise_hu=25.0, resected="RLL")
    airways = carina.find_airways(made.volume)
    (stump,) = [place for place in airways.uncertain if place.kind == "stump"]
    ends = [branch["points"][-1] for branch in made.truth["branches"] if branch["name"] is None]
    assert min(np.linalg.norm(np.array(end) - stump.lps) for end in ends) < 5.0
    assert airways.tree.branch(stump.branch_id).name == "BI"
