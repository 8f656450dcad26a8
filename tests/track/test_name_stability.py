"""Tests that names depend little on where a search lost a tip: a tip is cut, and the other names stay."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from carina.phantom import generate_phantom
from carina.track import AirwayTree, Branch, name_tree
from carina.track.names import naming, renaming
from carina.track.names.name_texts import segment_of
from carina.track.names.naming import _read, branch_side_and_lobe, name_human_tree
from carina.track.names.renaming import extends_tips_only, name_edited_tree, renamed_branches
from carina.track.names.tree_fit import MISFIT
from carina.track.names.tree_shape import bronchi_of
from carina_bench.confidence_trees import degraded, turned

NUM_TIPS = 5
"""Number of tips that are cut in each tree, one at a time."""
CLEAR = 0.6
"""Minimum confidence of a name that must not be lost; a name with less may be lost, but not replaced."""


@functools.cache
def uncut(seed: int) -> AirwayTree:
    """Return the tree of a phantom as a poor CT shows it, turned by 12 degrees, with names."""
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    tree = AirwayTree.from_json(generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box).truth)
    angle = np.radians(12.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return name_tree(degraded(turned(tree, turn), np.random.default_rng(seed), amount=0.5))


@functools.cache
def cut_trees(seed: int) -> list[tuple[int, AirwayTree]]:
    """Return trees in which one random tip is shorter by 6 to 25 mm, with the ID of this tip."""
    tree = uncut(seed)
    rng = np.random.default_rng(seed)
    tips = [b for b in tree.branches if not b.children and _along(b.points)[-1] >= 12.0]
    made = []
    for number in rng.permutation(len(tips))[:NUM_TIPS]:
        tip = tips[number]
        along = _along(tip.points)
        left_mm = along[-1] - rng.uniform(6.0, min(25.0, along[-1] - 5.0))
        # The points of a phantom are farther apart than those of a search.
        places = np.arange(0.0, left_mm, 0.5)
        points = np.stack([np.interp(places, along, tip.points[:, axis]) for axis in range(3)], axis=1)
        short = dataclasses.replace(tip, points=points, radius=np.interp(places, along, tip.radius))
        branches = tuple(short if b.id == tip.id else b for b in tree.branches)
        made.append((tip.id, name_tree(dataclasses.replace(tree, branches=branches))))
    return made


def _along(points: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _segment(name: str | None) -> str | None:
    return None if name is None else segment_of(name)


# Known failure: in phantom 2, a cut of tip 11 removes the name of the right basal trunk.
MISSED = pytest.mark.xfail(reason="a lost tip beside the right basal trunk removes the name of the trunk", strict=True)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=MISSED), 3, 4])
def test_cut_tip_leaves_the_names_outside_its_segment(seed):
    tree = uncut(seed)
    for tip, cut in cut_trees(seed):
        segment = _segment(tree.branch(tip).name)
        for before, after in zip(tree.branches, cut.branches, strict=True):
            if before.id == tip or (segment is not None and _segment(before.name) == segment):
                continue
            is_clear = before.name is None or (before.name_confidence or 0.0) >= CLEAR
            assert after.name == before.name or (after.name is None and not is_clear), (tip, before.id)


@pytest.mark.parametrize("seed", range(1, 5))
def test_cut_tip_turns_the_body_frame_by_less_than_two_and_a_half_degrees(seed):
    frame = _read(uncut(seed)).frame
    for tip, cut in cut_trees(seed):
        cosine = (np.trace(_read(cut).frame @ frame.T) - 1.0) / 2.0
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 2.5, tip


def test_order_of_letters_does_not_depend_on_the_length_of_a_tip():
    tree = uncut(1)
    whole = {b.pieces[0]: b for b in bronchi_of(tree)}
    for tip, cut in cut_trees(1):
        at = next(number for number, branch in enumerate(tree.branches) if branch.id == tip)
        shorter = next((b for b in bronchi_of(cut) if b.pieces[0] == at), None)
        if shorter is not None and shorter.length_mm >= 20.0:
            assert np.allclose(shorter.ahead, whole[at].ahead, atol=0.2)
            assert shorter.radius_mm == pytest.approx(whole[at].radius_mm, rel=0.05)


@pytest.mark.parametrize("seed", range(1, 5))
def test_extension_of_a_lost_tip_restores_the_names_of_the_uncut_tree(seed):
    tree = uncut(seed)
    for _, cut in cut_trees(seed):
        edited = name_edited_tree(cut, tree)
        assert [b.name for b in edited.branches] == [b.name for b in tree.branches]


def test_extension_keeps_names_from_another_source_that_it_does_not_change():
    tree = uncut(2)
    tip, cut = cut_trees(2)[0]
    other = next(b for b in cut.branches if b.name is not None and b.name_from == "anatomy" and b.id != tip)
    older = dataclasses.replace(
        cut,
        branches=tuple(dataclasses.replace(b, name="RB99") if b.id == other.id else b for b in cut.branches),
    )
    edited = name_edited_tree(older, tree)
    assert edited.branch(other.id).name == "RB99"
    assert all(one.branch_id != other.id for one in renamed_branches(older, edited))


def test_tip_that_a_moved_fork_lengthens_is_not_an_extension():
    tree = uncut(1)
    tip, cut = cut_trees(1)[0]
    assert extends_tips_only(cut, tree)
    assert not extends_tips_only(tree, tree)
    assert not extends_tips_only(tree, cut)
    fork = tree.branch(tree.branch(tip).parent)
    moved_to = fork.points[-1] + np.array([0.0, 0.0, 6.0])

    def moved(branch: Branch) -> Branch:
        """Return a branch with its end at the new place of the fork, so that it becomes longer."""
        is_parent = branch.id == fork.id
        at = len(branch.points) if is_parent else 0
        radius = np.insert(branch.radius, at, branch.radius[-1 if is_parent else 0])
        return dataclasses.replace(branch, points=np.insert(branch.points, at, moved_to, axis=0), radius=radius)

    adjoining = {fork.id, *fork.children}
    branches = tuple(moved(b) if b.id in adjoining else b for b in tree.branches)
    assert not extends_tips_only(tree, dataclasses.replace(tree, branches=branches))


def test_one_more_tip_does_not_make_a_human_tree_implausible(monkeypatch):
    tree = uncut(1)
    fit = {tip: (cut, _read(cut).fit, _read(tree).fit) for tip, cut in cut_trees(1)}
    cut, before, after = max(fit.values(), key=lambda of_tip: of_tip[1] - of_tip[2])
    assert after < before
    monkeypatch.setattr(naming, "POOR_FIT", (before + after) / 2.0)
    assert MISFIT in {note.code for note in name_tree(tree).notes}
    edited = name_edited_tree(cut, tree)
    assert MISFIT not in {note.code for note in edited.notes}
    assert {b.id: b.name for b in edited.branches}.items() >= {
        b.id: b.name for b in cut.branches if b.name is not None
    }.items()
    # The lobes follow the same decision as the names.
    assert set(branch_side_and_lobe(edited).values()) > {None}


def test_tree_read_with_the_other_laterality_than_before_needs_the_usual_fit(monkeypatch):
    tree = uncut(1)
    monkeypatch.setattr(naming, "POOR_FIT", _read(tree).fit + 0.1)
    codes = [{note.code for note in name_human_tree(tree, is_mirrored=was).notes} for was in (False, True)]
    assert [MISFIT in found for found in codes] == [False, True]


def test_removal_of_many_branches_can_make_a_tree_unlike_a_human_one(monkeypatch):
    tree = uncut(1)
    top = max((b for b in tree.branches if b.parent == tree.root.id), key=lambda b: len(b.children))
    removed, found = {top.id}, [top.id]
    while found:
        found = [child for one in found for child in tree.branch(one).children]
        removed |= set(found)
    rest = tuple(
        dataclasses.replace(b, children=tuple(child for child in b.children if child not in removed))
        for b in tree.branches
        if b.id not in removed
    )
    monkeypatch.setattr(naming, "POOR_FIT", 100.0)
    before = name_human_tree(tree, is_mirrored=False)
    edited = name_edited_tree(before, dataclasses.replace(before, branches=rest))
    assert MISFIT in {note.code for note in edited.notes}


def test_extended_tip_can_make_a_tree_fit_a_human_one(monkeypatch):
    tree = uncut(1)
    fit = {tip: (cut, _read(cut).fit, _read(tree).fit) for tip, cut in cut_trees(1)}
    cut, before, after = min(fit.values(), key=lambda of_tip: of_tip[1] - of_tip[2])
    assert before < after
    monkeypatch.setattr(naming, "POOR_FIT", (before + after) / 2.0)
    unlike = name_tree(cut)
    assert MISFIT in {note.code for note in unlike.notes}
    assert set(branch_side_and_lobe(unlike).values()) == {None}
    edited = name_edited_tree(unlike, tree)
    assert [b.name for b in edited.branches] == [b.name for b in tree.branches]
    assert MISFIT not in {note.code for note in edited.notes}


@pytest.mark.parametrize(("confidence", "stays"), [(0.9, True), (0.6, False)])
def test_extension_does_not_remove_a_confident_name(monkeypatch, confidence, stays):
    tree = uncut(2)
    tip, cut = cut_trees(2)[0]
    other = next(b for b in cut.branches if b.name is not None and b.name_from == "anatomy" and b.id != tip)
    was = tuple(dataclasses.replace(b, name_confidence=confidence) if b.id == other.id else b for b in cut.branches)
    usual = renaming.name_human_tree

    def without_the_name(edited: AirwayTree, *, is_mirrored: bool) -> AirwayTree:
        named = usual(edited, is_mirrored=is_mirrored)
        if edited is not tree:
            return named
        lost = (dataclasses.replace(b, name=None) if b.id == other.id else b for b in named.branches)
        return dataclasses.replace(named, branches=tuple(lost))

    monkeypatch.setattr(renaming, "name_human_tree", without_the_name)
    after = name_edited_tree(dataclasses.replace(cut, branches=was), tree).branch(other.id)
    assert after.name == (other.name if stays else None)
    assert not stays or after.name_confidence == 0.5
