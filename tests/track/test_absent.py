"""Absence is a finding: what a tree lacks is listed, each with a reason that the CT gives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plugged_chest import CHEST, named, plugged

import carina
from carina.track import AirwayTree, Branch, find_absent, name_tree
from carina.track.tree.uncertain import Uncertainty
from carina.volume import Volume
from made import made_airways, made_phantom
from made import patient as the_patient


@pytest.fixture(scope="module")
def chest():
    return made_phantom(**CHEST), made_airways(**CHEST)


def without(tree, name):
    """The tree with a named branch and all that hangs on it cut off."""
    gone = {branch.id for branch in tree.branches if branch.name == name}
    for branch in tree.branches:
        if branch.parent in gone:
            gone.add(branch.id)
    kept = tuple(
        dataclasses.replace(branch, children=tuple(child for child in branch.children if child not in gone))
        for branch in tree.branches
        if branch.id not in gone
    )
    return dataclasses.replace(tree, branches=kept)


def test_a_whole_tree_lacks_nothing(chest):
    assert chest[1].absent == ()


def test_a_tree_without_names_says_nothing(chest):
    bare = tuple(dataclasses.replace(branch, name=None) for branch in chest[1].tree.branches)
    assert find_absent(AirwayTree(bare)) == ()


@pytest.mark.parametrize("name", ["RB6", "LB3", "RB10", "LB1+2"])
def test_a_segment_that_nothing_leads_to_is_told_with_the_airway_that_would(chest, name):
    (absence,) = find_absent(without(chest[1].tree, name))
    assert absence.name == name
    assert absence.kind in ("nothing", "unnamed", "fine")
    assert absence.carrier != name
    assert absence.words.startswith(f"{name} (")


@pytest.mark.parametrize("name", ["RML", "LLL", "RUL"])
def test_a_lobe_of_which_nothing_was_found_is_told_once(chest, name):
    absences = find_absent(without(chest[1].tree, name))
    assert [absence.name for absence in absences] == [name]
    assert absences[0].carrier in ("BI", "LMB", "RMB")


def resected(seed, lobe, stump_mm=4.0):
    """A true tree after a lobectomy: of the lobe a stump is left; its neighbours have moved a little to its place."""
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    made = carina.generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box, generations=5)
    whole = AirwayTree.from_json(made.truth)
    lost = whole.named(lobe)
    cut = without(whole, lobe)
    left_mm = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(lost.points, axis=0), axis=1))])
    kept = max(int((left_mm <= stump_mm).sum()), 2)
    stump = dataclasses.replace(lost, name=None, children=(), points=lost.points[:kept], radius=lost.radius[:kept])
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
def test_a_lobe_that_was_resected_is_told_once_with_resection_among_the_reasons(seed, lobe):
    whole, tree = resected(seed, lobe)
    read = name_tree(tree)
    assert read.notes == ()
    (absence,) = find_absent(read)
    assert absence.name == lobe
    assert "resected" in absence.reason
    true = {b.id: b.name for b in whole.branches if b.name is not None and b.name[1:2] == "B"}
    left = [b for b in read.branches if b.id in true]
    assert sum(b.name == true[b.id] for b in left) >= 0.8 * len(left)


@pytest.mark.parametrize("lobe", ["RUL", "RML", "LUL", "LLL"])
def test_after_a_lobectomy_the_lobe_is_told_once_and_the_others_keep_their_names(lobe):
    made = carina.generate_phantom(seed=2, spacing_mm=1.0, noise_hu=25.0, resected=lobe)
    airways = carina.find_airways(made.volume)
    (absence,) = airways.absent
    assert absence.name == lobe
    assert "resected" in absence.reason
    true = [branch for branch in made.truth["branches"] if (branch["name"] or "")[1:2] == "B"]
    places = np.concatenate([branch["points"] for branch in true])
    names = [branch["name"] for branch in true for _ in branch["points"]]
    for branch in airways.tree.branches:
        if branch.name in names:
            middle = branch.points[len(branch.points) // 2]
            assert names[int(np.argmin(np.linalg.norm(places - middle, axis=1)))] == branch.name


@pytest.mark.parametrize(("name", "lacking", "carrier"), [("RML", {"RML", "RLL"}, "BI"), ("LB6", {"LB6"}, "LLL")])
def test_mucus_in_a_bronchus_is_said_with_its_place(chest, name, lacking, carrier):
    made, whole = chest
    branch = named(whole, name)
    airways = carina.find_airways(plugged(made.volume, branch, 6.0))
    assert {one.name for one in airways.absent} == lacking
    for absence in airways.absent:
        assert (absence.kind, absence.carrier) == ("filled", carrier)
        assert absence.beyond_mm < 25.0
        # The middle of the mucus, which reaches up to 14 mm into the branch.
        assert np.linalg.norm(np.array(absence.lps) - branch.points[0]) < 12.0


def test_not_an_ordinary_tip_but_the_mucus_is_the_reason_for_a_segment_that_is_missing(chest):
    made, whole = chest
    airways = carina.find_airways(plugged(made.volume, named(whole, "LB3"), 6.0))
    assert {one.name for one in airways.absent} == {"LB1+2", "LB3"}
    for absence in airways.absent:
        # Without LB3 nothing tells LB1+2 from a common stem of all three.
        assert (absence.kind, absence.carrier) == ("filled", "Upper division")


def test_a_scan_that_ends_above_the_bases_says_so(chest):
    made, _ = chest
    cut = made.volume.hu_zyx.shape[0] * 2 // 5
    place = made.volume.lps_from_ijk.copy()
    place[:3, 3] += cut * place[:3, 2]
    airways = carina.find_airways(Volume(np.ascontiguousarray(made.volume.hu_zyx[cut:]), place))
    assert airways.absent
    assert {"volume"} <= {absence.kind for absence in airways.absent}


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


def test_where_an_airway_ends_is_told_along_it():
    trunk = Branch(0, None, (1, 2), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -90]]), np.full(2, 8.0))
    right = Branch(1, 0, (), 1, "RMB", "tracked", np.array([[0.0, 0, -90], [-30, 0, -130]]), np.full(2, 6.0))
    left = Branch(2, 0, (), 1, "LMB", "tracked", np.array([[0.0, 0, -90], [40, 0, -110]]), np.full(2, 6.0))
    absences = find_absent(AirwayTree((trunk, right, left)), [end("blocked", 1, 7.2), end("volume", 2, 9.0)])
    assert [(one.name, one.kind, one.carrier) for one in absences] == [
        ("RUL", "blocked", "RMB"),
        ("RML", "blocked", "RMB"),
        ("RLL", "blocked", "RMB"),
        ("LUL", "volume", "LMB"),
        ("LLL", "volume", "LMB"),
    ]
    assert absences[0].beyond_mm == pytest.approx(50.0)
    assert "50 mm beyond the start of RMB, where it is 7.2 mm wide" in absences[0].words


def test_in_a_mirrored_chest_the_three_lobed_lung_is_the_left_one(chest):
    made, _ = chest
    place = made.volume.lps_from_ijk.copy()
    place[0, :] *= -1.0
    airways = carina.find_airways(Volume(made.volume.hu_zyx, place))
    assert {absence.name for absence in airways.absent} == set()
    lacking = find_absent(without(airways.tree, "LML"))
    assert [absence.name for absence in lacking] == ["LML"]


def test_the_bundled_patient_lacks_the_segments_of_a_middle_lobe_whose_bronchus_is_lost():
    airways = the_patient()[1]
    assert {absence.name for absence in airways.absent} <= {"RB4", "RB5"}
    for absence in airways.absent:
        assert absence.carrier == "RML"
        assert absence.beyond_mm > 5.0
        assert absence.words in airways._repr_html_()
