"""Tests that the edit preview under the pointer equals the edit of a click, bit for bit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from edit_case import edit_case, open_ended_airways, open_ended_volume

from cached_test_data import cached_phantom, found_airways
from carina.errors import NoEvidenceError
from carina.track import (
    AddBranch,
    Bridge,
    CutBranch,
    MoveFork,
    edit_airways,
    preview_edit,
    renamed_branches,
    renaming_texts,
)
from carina.track.edit.preview import new_lines


@pytest.fixture(scope="module")
def case():
    return edit_case()


@pytest.fixture(scope="module")
def opened(case):
    """Return the edit case with two open tubes and with a visible branch cut off.

    Paths lead through the open tubes into the lung.
    """
    volume = open_ended_volume()
    leaf = case.airways.tree.nearest_branch(case.tips[3])[0]
    return volume, edit_airways(volume, open_ended_airways(), CutBranch(leaf.id)), leaf


def points_to_add(volume, case, leaf, count: int):
    """Return ``count`` points on the branch that was cut off, and in the lung around the open tubes, LPS mm."""
    rng = np.random.default_rng(5)
    lung = np.array(case.tips[:2])[rng.integers(2, size=count)] + rng.normal(0.0, 4.0, (count, 3))
    inside = [point for point in lung if volume.contains_lps(point)]
    return [tuple(float(v) for v in point) for point in [*leaf.points[len(leaf.points) // 3 :], *inside]]


def joined(lines):
    """Return one line from several, each of which begins at the end of the previous one."""
    for one, other in itertools.pairwise(lines):
        assert np.array_equal(one.points_lps[-1], other.points_lps[0])
    return np.concatenate([lines[0].points_lps, *(line.points_lps[1:] for line in lines[1:])])


def test_added_branch_follows_the_previewed_line_exactly(case, opened):
    volume, airways, leaf = opened
    taken = refused = 0
    for lps in points_to_add(volume, case, leaf, 30):
        preview = preview_edit(volume, airways, AddBranch(lps))
        if preview.problem is not None:
            assert preview.lines == ()
            continue
        (line,) = preview.lines
        edited = edit_airways(volume, airways, AddBranch(lps, even_without_evidence=True))
        made = new_lines(airways.tree.branches, edited.tree.branches)
        assert np.array_equal(np.concatenate([one.drawn for one in made]), line.drawn)
        assert joined(made).tobytes() == line.points_lps.tobytes()
        if preview.has_evidence:
            taken += 1
            assert not line.doubtful.any()
            again = edit_airways(volume, airways, AddBranch(lps)).tree
            assert {branch.kind for branch in again.branches} == {"tracked"}
            continue
        refused += 1
        with pytest.raises(NoEvidenceError) as doubt:
            edit_airways(volume, airways, AddBranch(lps))
        assert doubt.value.way_lps.tobytes() == line.points_lps.tobytes()
        assert np.array_equal(doubt.value.doubtful, line.doubtful)
        assert doubt.value.doubtful_mm == pytest.approx(preview.doubtful_mm)
        drawn = [branch for branch in edited.tree.branches if branch.kind == "manual"]
        assert sum(branch.doubtful_mm for branch in drawn) == pytest.approx(preview.doubtful_mm)
    # With fewer accepted points this test would compare too few branches.
    assert taken >= 2
    assert refused > 5


def test_bridge_edit_follows_the_previewed_line_exactly(case):
    edit = Bridge(tuple(float(v) for v in case.hidden))
    preview = preview_edit(case.volume, case.airways, edit)
    edited = edit_airways(case.volume, case.airways, edit)
    bridge = next(branch for branch in edited.tree.branches if branch.kind == "bridge")
    dashed = [line for line in preview.lines if line.doubtful.all()]
    assert [line.points_lps.tobytes() for line in dashed] == [bridge.points.tobytes()]
    made = new_lines(case.airways.tree.branches, edited.tree.branches)
    assert [line.points_lps.tobytes() for line in preview.lines] == [line.points_lps.tobytes() for line in made]


def test_moved_fork_has_the_previewed_lines_exactly(case):
    branch = next(b for b in case.airways.tree.branches if b.parent is not None and b.children)
    edit = MoveFork(branch.id, tuple(float(v) for v in branch.points[-1] + np.array([0.4, 0.2, 0.3])))
    preview = preview_edit(case.volume, case.airways, edit)
    edited = edit_airways(case.volume, case.airways, edit)
    made = new_lines(case.airways.tree.branches, edited.tree.branches)
    assert len(made) >= 3
    assert [line.points_lps.tobytes() for line in preview.lines] == [line.points_lps.tobytes() for line in made]
    assert preview.doubtful_mm == 0.0


def test_preview_of_an_impossible_edit_gives_a_reason_and_no_lines(case):
    tree = case.airways.tree
    leaf = tree.tips()[0]
    for edit, text in (
        (MoveFork(leaf.id, tuple(leaf.tip_lps)), "without a fork"),
        (Bridge(tuple(leaf.tip_lps)), "nothing to bridge"),
        (AddBranch(tuple(leaf.points[len(leaf.points) // 2])), "already reaches"),
    ):
        preview = preview_edit(case.volume, case.airways, edit)
        assert text in str(preview.problem)
        assert (preview.lines, preview.has_evidence, preview.length_mm) == ((), False, 0.0)


def test_computing_a_preview_leaves_the_airways_unchanged(case):
    before = [(b.id, b.points.tobytes(), b.radius.tobytes()) for b in case.airways.tree.branches]
    lumen = case.airways.lumen_zyx.tobytes()
    for edit in (Bridge(tuple(case.hidden)), AddBranch(tuple(case.hidden))):
        preview_edit(case.volume, case.airways, edit)
    assert [(b.id, b.points.tobytes(), b.radius.tobytes()) for b in case.airways.tree.branches] == before
    assert case.airways.lumen_zyx.tobytes() == lumen


def test_preview_equals_the_edit_of_a_wide_bronchus_whose_section_radii_differ_from_its_wall_distances():
    volume = cached_phantom(seed=1, spacing_mm=1.5, generations=4).volume
    airways = found_airways(volume)
    bronchus = airways.tree.named("LMB")
    x, y, z = (float(value) for value in bronchus.points[-1])
    cut = edit_airways(volume, airways, CutBranch(bronchus.id, 0.5 * bronchus.length_mm))
    preview = preview_edit(volume, cut, AddBranch((x, y, z)))
    (line,) = preview.lines
    assert (preview.parent_title, preview.extends) == ("LMB", True)
    edited = edit_airways(volume, cut, AddBranch((x, y, z)))
    made = {point.tobytes() for branch in edited.tree.branches for point in branch.points}
    assert {point.tobytes() for point in line.points_lps} <= made


@pytest.mark.parametrize(("cut_off", "texts"), [("LB8", []), ("RB1", ["RB1+3 becomes RB3", "RB2 becomes RB1+2"])])
def test_preview_lists_the_branches_that_the_edit_renames(cut_off, texts):
    volume = cached_phantom(seed=1, spacing_mm=1.5, generations=4).volume
    airways = found_airways(volume)
    leaf = airways.tree.named(cut_off)
    cut = edit_airways(volume, airways, CutBranch(leaf.id))
    x, y, z = (float(value) for value in leaf.points[-1])
    assert preview_edit(volume, cut, AddBranch((x, y, z))).renamed is None
    renamed = preview_edit(volume, cut, AddBranch((x, y, z)), with_names=True).renamed
    assert renamed == renamed_branches(cut.tree, edit_airways(volume, cut, AddBranch((x, y, z))).tree)
    listed = renaming_texts(renamed)
    assert set(texts) <= set(listed)
    assert bool(listed) == bool(texts), "a branch that the new fork divides keeps its name below the fork"
