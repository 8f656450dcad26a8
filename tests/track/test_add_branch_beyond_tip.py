"""Tests of *Add branch* beyond a tip that was cut off an airway mask: the branch that was cut is extended."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cached_test_data import patient
from carina.track import Branch, RenameBranch, edit_airways, name_tree
from carina.track.names.renaming import name_edited_tree
from carina.track.tree.airway_tree import AirwayTree
from carina_bench.track_tips import Repair, repair, uncut_airways


@pytest.fixture(scope="module")
def uncut():
    return uncut_airways(patient()[0])


@pytest.mark.parametrize(
    ("end_lps", "cut_mm"),
    [
        # At both tips, a parallel airway is nearer to the click than the tip itself.
        ((63.1, -124.7, 256.1), 14.0),
        ((64.7, -133.1, 251.4), 6.3),
    ],
)
def test_click_beyond_a_lost_tip_extends_that_branch_and_renames_no_other(uncut, end_lps, cut_mm):
    airways, lumen = uncut
    leaf = airways.tree.nearest_branch(end_lps)[0]
    length_mm = float(np.linalg.norm(np.diff(leaf.points, axis=0), axis=1).sum())
    found = repair(patient()[0], airways.tree, lumen, leaf, length_mm - cut_mm)
    assert isinstance(found, Repair)
    assert found.extends
    assert not found.is_refused
    assert abs(found.length_error_mm) < 3.0
    assert found.old_lumen_mm < 3.0
    assert found.num_renamed == 0


def swapped(tree: AirwayTree, one: str, other: str) -> AirwayTree:
    """Return a tree in which the names of two branches are exchanged."""
    names = {one: other, other: one}
    return dataclasses.replace(
        tree, branches=tuple(dataclasses.replace(b, name=names.get(b.name or "", b.name)) for b in tree.branches)
    )


def with_twig(tree: AirwayTree, parent: Branch) -> AirwayTree:
    """Return a tree with a short new branch at the tip of a branch."""
    points = parent.points[-1] + np.linspace(0.0, 4.0, 5)[:, None] * np.array([0.0, 0.0, -1.0])
    new_id = 1 + max(branch.id for branch in tree.branches)
    new = Branch(new_id, parent.id, (), parent.generation + 1, None, "tracked", points, np.full(5, 1.0))
    grown = dataclasses.replace(parent, children=(*parent.children, new_id))
    branches = tuple(grown if branch.id == parent.id else branch for branch in tree.branches)
    return dataclasses.replace(tree, branches=(*branches, new))


def test_added_branch_does_not_change_the_names_of_other_branches(uncut):
    tree = name_tree(uncut[0].tree)
    leaf = next(branch for branch in tree.branches if branch.name == "RB10a")
    edited = name_edited_tree(tree, with_twig(tree, leaf))
    names = {branch.id: branch.name for branch in edited.branches}
    assert all(names[branch.id] == branch.name for branch in tree.branches)


def test_branch_names_that_the_edited_tree_makes_improbable_are_replaced(uncut):
    tree = name_tree(uncut[0].tree)
    wrong = swapped(tree, "RB6", "RB10")
    leaf = next(branch for branch in tree.branches if branch.name == "RB10a")
    edited = name_edited_tree(wrong, with_twig(wrong, leaf))
    names = {branch.id: branch.name for branch in edited.branches}
    assert {names[branch.id] for branch in tree.branches if branch.name in ("RB6", "RB10")} == {"RB6", "RB10"}
    assert all(names[branch.id] == branch.name for branch in tree.branches if branch.name in ("RB6", "RB10"))


def test_name_given_by_the_user_is_removed_from_the_branch_that_had_it_before(uncut):
    airways, _ = uncut
    other = next(branch for branch in airways.tree.branches if branch.name == "RB10b")
    edited = edit_airways(patient()[0], airways, RenameBranch(other.id, "RB10a"))
    assert [branch.id for branch in edited.tree.branches if branch.name == "RB10a"] == [other.id]
