"""Names of an edited tree: a branch gets another name only where the edited tree is evidence against its name.

The likeliest names of all branches are chosen together, so that one new branch can exchange uncertain names of distant
branches. A user who adds one branch expects the other names to stay.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from carina.display import one_line
from carina.track.names.name_texts import MIRRORED
from carina.track.names.naming import SURE_ENOUGH, log_evidence_of, name_human_tree, name_tree
from carina.track.names.tree_fit import MISFIT
from carina.track.tree.airway_tree import AirwayTree, Branch

MAX_ADDED = 2
"""Maximum number of new branches with which all former names remain.

One added branch makes two: the branch, and the lower part of its divided parent. An edit that adds more, such as a
bridge, adds airways that were unknown when the former names were chosen.
"""
MAX_CHANGED = 2
"""Maximum number of new and removed branches with which a human tree remains one, however poorly it fits."""
MIN_LOG_PROBABILITY = math.log(0.05)
"""Minimum log probability of the former names in the edited tree; below it the branches are renamed."""
MIN_EXTENSION_MM = 2.0
"""Minimum length in mm by which an edit must extend a tip for the extension to affect the names."""
SURE_OF_NEW = 0.8
"""Minimum confidence of a name for a branch that had no name before the edit and is not itself new.

A name of at least this confidence is not lost by the extension of a tip.
"""


@one_line
@dataclass(frozen=True, slots=True)
class RenamedBranch:
    """Branch whose name an edit changes or removes."""

    branch_id: int
    """ID of the branch, in the tree before and after the edit."""
    before: str
    """Name before the edit."""
    after: str | None
    """Name after the edit; None if the branch has no name any more."""


def renamed_branches(before: AirwayTree, after: AirwayTree) -> tuple[RenamedBranch, ...]:
    """Return the named branches that lost or changed their names, in the order of the tree after the edit.

    A branch that a new fork divides is not listed if its lower part, a new branch, keeps the name.
    """
    former = {branch.id: branch.name for branch in before.branches}
    names_of_new = {(branch.parent, branch.name) for branch in after.branches if branch.id not in former}
    renamed = []
    for branch in after.branches:
        name = former.get(branch.id)
        if name is not None and name != branch.name and (branch.id, name) not in names_of_new:
            renamed.append(RenamedBranch(branch.id, name, branch.name))
    return tuple(renamed)


def name_edited_tree(before: AirwayTree, tree: AirwayTree) -> AirwayTree:
    """Name the branches of an edited tree, and keep the former names unless they have become improbable.

    Parameters
    ----------
    before
        Named tree before the edit.
    tree
        Tree after the edit; branches that both trees have keep their IDs.

    Returns
    -------
    AirwayTree
        ``tree`` with names. All names are determined again, as by :func:`carina.track.name_tree`, if the edit adds more
        than two branches or changes a name that the user gave, or if the probability of those former names that would
        change is below 0.05. Otherwise the former names stay and constrain the names of the new branches. A former
        name that would only be lost stays with a confidence of at most 0.5. A branch without a name gets one if its
        confidence is at least 0.8.

        An edit that adds and removes at most two branches does not make a human tree one that is unlike a human tree.
        The goodness of fit of a part of the airways can cross its limit by one tip.
    """
    former = {branch.id: branch for branch in before.branches}
    if extends_tips_only(before, tree):
        return _named_by_change(before, tree)
    if sum(branch.id not in former for branch in tree.branches) > MAX_ADDED:
        return name_tree(tree)
    renamed_tree = _named_like(before, tree)
    if _badges(renamed_tree) != _badges(before) or _by_user(tree) != _by_user(before):
        return renamed_tree
    changed = {branch.id for branch in renamed_tree.branches if _is_renamed(former.get(branch.id), branch)}
    if not changed:
        return _with_former(renamed_tree, former)
    held = dataclasses.replace(
        tree,
        branches=tuple(
            dataclasses.replace(branch, name=former[branch.id].name, name_from="person")
            if branch.id in changed
            else branch
            for branch in tree.branches
        ),
    )
    if log_evidence_of(held) - log_evidence_of(tree) < MIN_LOG_PROBABILITY:
        return _with_former(renamed_tree, former)
    named = _named_like(before, held)
    released = tuple(
        dataclasses.replace(branch, name_from="anatomy", name_confidence=former[branch.id].name_confidence)
        if branch.id in changed
        else branch
        for branch in named.branches
    )
    return _with_former(dataclasses.replace(named, branches=released), former)


def extends_tips_only(before: AirwayTree, after: AirwayTree) -> bool:
    """Return whether an edit extended tips at their ends and added, removed and renamed no branch.

    A moved fork can make a tip longer at its start, which is not a new airway.
    """
    former = {branch.id: branch for branch in before.branches}
    if len(after.branches) != len(former) or _by_user(before) != _by_user(after):
        return False
    if any(
        b.id not in former or b.children != former[b.id].children or b.kind != former[b.id].kind for b in after.branches
    ):
        return False
    return any(
        not branch.children
        and _length_mm(branch) > _length_mm(former[branch.id]) + MIN_EXTENSION_MM
        and float(np.linalg.norm(branch.points[0] - former[branch.id].points[0])) < MIN_EXTENSION_MM
        for branch in after.branches
    )


def _length_mm(branch: Branch) -> float:
    return float(np.linalg.norm(np.diff(branch.points, axis=0), axis=1).sum())


def _named_by_change(before: AirwayTree, tree: AirwayTree) -> AirwayTree:
    """Name an edited tree with the names of ``before``, changed only where the edit changes the result of naming.

    ``before`` may have names from other sources, such as an older version. Where naming both trees gives one name, the
    edit is no evidence against the present name.
    """
    former = {branch.id: branch for branch in before.branches}
    without_edit = {branch.id: branch for branch in _named_like(before, before).branches}
    renamed_tree = _named_like(before, tree)
    if _badges(renamed_tree) != _badges(before):
        return renamed_tree
    made = []
    for branch in renamed_tree.branches:
        was = former[branch.id]
        if was.name_from == "person" or branch.name != without_edit[branch.id].name or was.name == branch.name:
            made.append(branch)
        else:
            made.append(
                dataclasses.replace(branch, name=was.name, name_confidence=was.name_confidence, name_from=was.name_from)
            )
    return _with_lost(dataclasses.replace(renamed_tree, branches=tuple(made)), former, least=SURE_OF_NEW)


def _named_like(before: AirwayTree, tree: AirwayTree) -> AirwayTree:
    """Name an edited tree; after a small edit a human tree remains one, else its goodness of fit decides."""
    num_changed = len({branch.id for branch in before.branches} ^ {branch.id for branch in tree.branches})
    is_named = any(branch.name_from == "anatomy" for branch in before.branches)
    was_human = num_changed <= MAX_CHANGED and is_named and MISFIT not in _badges(before)
    return name_human_tree(tree, is_mirrored=MIRRORED in _badges(before)) if was_human else name_tree(tree)


def _is_renamed(former: Branch | None, branch: Branch) -> bool:
    return (
        former is not None
        and former.name_from == "anatomy"
        and branch.name_from == "anatomy"
        and former.name != branch.name
    )


def _by_user(tree: AirwayTree) -> dict[int, str | None]:
    """Return the names that the user gave, by branch ID."""
    return {branch.id: branch.name for branch in tree.branches if branch.name_from == "person"}


def _badges(tree: AirwayTree) -> frozenset[str]:
    return frozenset(note.code for note in tree.notes if note.code in (MISFIT, MIRRORED))


def _with_former(tree: AirwayTree, former: dict[int, Branch]) -> AirwayTree:
    """Restore names that were only lost, and remove uncertain names from branches that had none before."""

    def without_uncertain(branch: Branch) -> Branch:
        was = former.get(branch.id)
        is_unsure = branch.name_from == "anatomy" and (branch.name_confidence or 0.0) < SURE_OF_NEW
        if was is not None and was.name is None and is_unsure:
            return dataclasses.replace(branch, name=None, name_confidence=None, name_from=None)
        return branch

    restored = _with_lost(tree, former)
    return dataclasses.replace(restored, branches=tuple(without_uncertain(branch) for branch in restored.branches))


def _with_lost(tree: AirwayTree, former: dict[int, Branch], least: float = 0.0) -> AirwayTree:
    """Restore names that were lost and that no other branch has, with a confidence of at most 0.5.

    Former names with a confidence below ``least`` stay lost.
    """
    used = {branch.name for branch in tree.branches}

    def restored(branch: Branch) -> Branch:
        was = former.get(branch.id)
        if was is None or branch.name is not None or was.name_from != "anatomy" or was.name in used:
            return branch
        sure = was.name_confidence or SURE_ENOUGH
        if sure < least:
            return branch
        sure = min(sure, SURE_ENOUGH)
        return dataclasses.replace(branch, name=was.name, name_confidence=sure, name_from="anatomy")

    return dataclasses.replace(tree, branches=tuple(restored(branch) for branch in tree.branches))
