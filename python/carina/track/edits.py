"""Mending the airway tree by hand: each edit gives new airways, and the old ones stay as they are.

The edits themselves are values (:mod:`carina.track.edit_kinds`). Applying them one after the other to the airways that
were found gives the same tree as :func:`rebuild_airways` does with everything computed again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from carina.errors import CancelledError, NoResultError, UsageError
from carina.track.airways import Airways, Progress
from carina.track.edit_kinds import (
    AddBranch,
    Bridge,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    RenameBranch,
    SmoothBranch,
    TreeEdit,
    edit_words,
    edits_from_json,
    edits_to_json,
)
from carina.track.paths import Cancel
from carina.track.tree import AirwayTree, Branch
from carina.volume.model import Volume

__all__ = [
    "AddBranch",
    "Bridge",
    "CutBranch",
    "MoveFork",
    "MoveRoot",
    "PaintLumen",
    "RenameBranch",
    "SmoothBranch",
    "TreeEdit",
    "edit_airways",
    "edit_words",
    "edits_from_json",
    "edits_to_json",
    "rebuild_airways",
]


def edit_airways(
    volume: Volume,
    airways: Airways,
    edit: TreeEdit,
    *,
    progress: Progress | None = None,
    cancel: Cancel | None = None,
) -> Airways:
    """The airways after one edit; only what depends on it is computed again.

    Parameters
    ----------
    volume
        The CT that ``airways`` were found in.
    airways
        Not changed: undo is going back to them.
    edit
        What to do.
    progress, cancel
        Told what is going on; asked whether to stop.

    Returns
    -------
    Airways
        With ``edits`` one longer. Branches that the edit does not touch keep their id, points and radii; new ones get
        ids never used before.

    Raises
    ------
    UsageError
        If the edit does not fit: no such branch, a point outside the volume, the root cut off.
    NoResultError
        If there is no way to do it: no airway at the point, a bridge too long; the message says what to do.
    CancelledError
        If ``cancel()`` said so.

    References
    ----------
    Paper 6.3 (targets and root set by hand, Figure 14); docs/decisions/0018.
    """
    if cancel is not None and cancel():
        raise CancelledError("editing the airways was stopped")
    if progress is not None:
        progress("editing the airways", None)
    match edit:
        case RenameBranch(branch_id, name):
            tree = _replaced(airways.tree, branch_id, lambda branch: _named_by_person(branch, name))
        case SmoothBranch(branch_id):
            tree = _replaced(airways.tree, branch_id, lambda branch: _smoothed(airways, branch))
        case _:
            raise NoResultError("this edit is not available yet", code="track.edit")
    return dataclasses.replace(airways, tree=tree, edits=(*airways.edits, edit))


def rebuild_airways(
    volume: Volume,
    base: Airways,
    edits: Sequence[TreeEdit],
    *,
    progress: Progress | None = None,
    cancel: Cancel | None = None,
) -> Airways:
    """The airways after all edits, with everything computed from scratch: the truth for :func:`edit_airways`.

    Raises
    ------
    TrackingError
        As :func:`edit_airways`.
    """
    airways = base
    for edit in edits:
        airways = edit_airways(volume, airways, edit, progress=progress, cancel=cancel)
    return airways


def _replaced(tree: AirwayTree, branch_id: int, change: Callable[[Branch], Branch]) -> AirwayTree:
    needed_branch(tree, branch_id)
    return dataclasses.replace(
        tree, branches=tuple(change(branch) if branch.id == branch_id else branch for branch in tree.branches)
    )


def needed_branch(tree: AirwayTree, branch_id: int) -> Branch:
    """The branch of that id.

    Raises
    ------
    UsageError
        If the tree has none, in a doctor's words.
    """
    for branch in tree.branches:
        if branch.id == branch_id:
            return branch
    msg = f"branch {branch_id} is not in the tree (it may have been cut); choose a branch of the list"
    raise UsageError(msg, code="track.edit-branch")


def _named_by_person(branch: Branch, name: str | None) -> Branch:
    if name is None:
        return dataclasses.replace(branch, name=None, name_confidence=None, name_from=None, variant=None)
    return dataclasses.replace(branch, name=name, name_confidence=None, name_from="person")


def _smoothed(airways: Airways, branch: Branch) -> Branch:
    core = airways.tracker.core
    points = core.smooth(branch.points, step_mm=1.0, keep_end=True)
    return dataclasses.replace(branch, points=points, radius=core.radius_mm(points))
