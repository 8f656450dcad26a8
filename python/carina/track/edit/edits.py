"""Manual edits of the airway tree: each edit returns new airways and does not change the old ones.

Edits are values (:mod:`carina.track.edit.edit_list`). A series of edits of the found airways gives, bit for bit, the
same tree as :func:`rebuild_airways`, which computes graph, distances and least costs of the lumen from scratch after
each edit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, flag, function, instance
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import CancelledError, NoResultError, UsageError, check_type
from carina.track.edit.edit_list import (
    AddBranch,
    Bridge,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    Point,
    RenameBranch,
    SmoothBranch,
    TreeEdit,
    branch_title,
    edits_from_json,
    edits_to_json,
)
from carina.track.edit.evidence import evidence_of
from carina.track.edit.lumen import EditedLumen
from carina.track.edit.remeasure import with_sections, with_walls
from carina.track.edit.steps import EditSteps
from carina.track.edit.tree_changes import needed_branch
from carina.track.find.airway_ends import find_uncertain
from carina.track.find.result import TREE_EDITS, Airways
from carina.track.names.renaming import RenamedBranch, extends_tips_only, name_edited_tree
from carina.track.names.without_drawn import carried_names, seen_part
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.paths.tracker import PathTracker, lumen_voxels
from carina.track.progress import Cancel, Progress
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.trachea_diameter_range import with_limited_confidence
from carina.track.tree.uncertainty import Uncertainty, judged
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
    "name_edited",
    "rebuild_airways",
    "renaming_texts",
    "steps_of",
]


def edit_words(edit: TreeEdit, airways: Airways) -> str:
    """Return the text of an edit for the undo list, such as ``cut RB3``.

    Parameters
    ----------
    edit
        The edit.
    airways
        Airways before the edit; they contain the names.
    """
    tree = airways.tree
    match edit:
        case AddBranch(lps, even_without_evidence):
            what = "draw" if even_without_evidence else "add"
            return f"{what} a branch beyond {_nearest_title(tree, lps)}"
        case CutBranch(branch_id, at_mm):
            return f"cut {_title(tree, branch_id)}" if at_mm <= 0.0 else f"shorten {_title(tree, branch_id)}"
        case Bridge(lps):
            return f"add a bridge beyond {_nearest_title(tree, lps)}"
        case MoveRoot():
            return "move the start"
        case MoveFork(branch_id):
            return f"move the fork of {_title(tree, branch_id)}"
        case PaintLumen(erase=erase):
            return "erase lumen" if erase else "paint lumen"
        case SmoothBranch(branch_id):
            return f"smooth {_title(tree, branch_id)}"
        case RenameBranch(branch_id, name):
            title = _title(tree, branch_id)
            return f"restore the automatic name of {title}" if name is None else f"rename {title} to {name}"


def renaming_texts(renamed: Sequence[RenamedBranch]) -> list[str]:
    """Return a text for each branch that an edit renames; pieces of one airway with equal texts are listed once.

    Examples
    --------
    >>> renaming_texts([RenamedBranch(4, "RB1", "RB1+3"), RenamedBranch(9, "RB2", None)])
    ['RB1 becomes RB1+3', 'RB2 becomes branch 9']
    """
    texts = (f"{one.before} becomes {branch_title(one.after, one.branch_id)}" for one in renamed)
    return list(dict.fromkeys(texts))


def _title(tree: AirwayTree, branch_id: int) -> str:
    name = next((branch.name for branch in tree.branches if branch.id == branch_id), None)
    return branch_title(name, branch_id)


def _nearest_title(tree: AirwayTree, lps: Point) -> str:
    branch, _, _ = tree.nearest_branch(lps)
    return branch_title(branch.name, branch.id)


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    edit=instance(TREE_EDITS, "create one of the tree edits of carina.commands"),
    name_branches=flag,
    cancel=function,
)
def edit_airways(
    volume: Volume,
    airways: Airways,
    edit: TreeEdit,
    *,
    name_branches: bool = True,
    progress: ProgressChoice = None,
    cancel: Cancel | None = None,
) -> Airways:
    """Return the airways after one edit; only parts that depend on the edit are computed again.

    Parameters
    ----------
    volume
        The CT in which ``airways`` were found.
    airways
        Airways before the edit; not changed, so that undo can return to them.
    edit
        The edit.
    name_branches
        Whether to determine the anatomical names again. With False they stay unchanged, and :func:`name_edited`
        updates them later: in a tree of some hundred branches naming takes longer than the edit.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Function that is called often; the calculation stops when it returns True.

    Returns
    -------
    Airways
        Airways with the edit appended to ``edits``. Branches that the edit does not affect keep their ID, points and
        radii; new branches get IDs that were never used before.

    Raises
    ------
    UsageError
        If the edit does not fit: no such branch, a point outside the volume, the root cut off.
    NoResultError
        If the edit is impossible: no airway at the point, or a bridge too long; the message states what to do.
    CancelledError
        If ``cancel()`` returned True.

    References
    ----------
    Paper 6.3 (targets and root set by hand, Figure 14); docs/decisions/0119.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> tip = airways.tree.tips()[0]
    >>> named = carina.edit_airways(phantom.volume, airways, carina.track.RenameBranch(tip.id, "biopsy"))
    >>> named.tree.branch(tip.id).name, len(named.edits)
    ('biopsy', 1)
    """
    check_type("edit_airways", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("edit_airways", "airways", airways, Airways, "get airways from carina.find_airways")
    _check_ct("edit_airways", volume, airways)
    edited = _edited(airways, edit, progress_function(progress), cancel, is_fresh=False)
    return name_edited(airways, edited) if name_branches else edited


@shows_progress
def rebuild_airways(
    volume: Volume,
    base: Airways,
    edits: Sequence[TreeEdit],
    *,
    progress: ProgressChoice = None,
    cancel: Cancel | None = None,
) -> Airways:
    """Return the airways after all edits, computed from scratch: the reference for :func:`edit_airways`.

    Parameters
    ----------
    volume
        The CT in which the airways were found.
    base
        Airways to which the first edit applies; they may contain earlier edits.
    edits
        Edits in order.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Function that is called often; the calculation stops when it returns True.

    Raises
    ------
    UsageError, NoResultError
        As :func:`edit_airways`; the message begins with the number of the edit in the list, from 1.
    CancelledError
        If ``cancel()`` returned True.
    """
    _check_ct("rebuild_airways", volume, base)
    airways = base
    for number, edit in enumerate(edits, start=1):
        try:
            edited = _edited(airways, edit, progress_function(progress), cancel, is_fresh=True)
        except (NoResultError, UsageError) as error:
            error.args = (f"edit {number} of {len(edits)}: {error}", *error.args[1:])
            raise
        airways = name_edited(airways, edited)
    return airways


def _check_ct(where: str, volume: Volume, airways: Airways) -> None:
    ct = airways.tracker.grid.ct
    if volume is ct or (volume.shape_zyx == ct.shape_zyx and np.array_equal(volume.lps_from_ijk, ct.lps_from_ijk)):
        return
    msg = (
        f"{where}: the airways belong to another CT: their grid is {ct.shape_zyx}, this CT's is {volume.shape_zyx}; "
        "pass the CT that they were found in"
    )
    raise UsageError(msg)


def name_edited(before: Airways, edited: Airways) -> Airways:
    """Return edited airways with updated anatomical names; ``edited`` itself if the names stay the same.

    Names are only determined again if branches were added, removed or moved to another parent, or if the user
    changed a name. A branch with a changed centreline is still the same bronchus.
    """
    (was, _), (seen, place_of) = seen_part(before.tree), seen_part(edited.tree)
    ways = [[(b.id, b.parent, b.name_from == "person", b.name) for b in tree.branches] for tree in (was, seen)]
    if ways[0] == ways[1] and not extends_tips_only(was, seen):
        # Branches drawn without evidence must not change the names and confidences of their neighbours.
        if seen is edited.tree:
            return edited
        return dataclasses.replace(edited, tree=carried_names(edited.tree, seen, place_of))
    return dataclasses.replace(edited, tree=name_edited_tree(before.tree, edited.tree))


def _edited(
    airways: Airways,
    edit: TreeEdit,
    progress: Progress | None,
    cancel: Cancel | None,
    *,
    is_fresh: bool,
) -> Airways:
    if cancel is not None and cancel():
        raise CancelledError("stopped while editing the airways")
    if progress is not None:
        progress("editing the airways", None)
    tree, edits = airways.tree, (*airways.edits, edit)
    next_id = airways.next_id or 1 + max(branch.id for branch in tree.branches)
    if isinstance(edit, RenameBranch):
        # Paths refer to branches by ID, so nothing else changes.
        branches = tuple(_named_by_person(b, edit.name) if b.id == edit.branch_id else b for b in tree.branches)
        needed_branch(tree, edit.branch_id)
        renamed = dataclasses.replace(tree, branches=branches)
        return dataclasses.replace(airways, tree=renamed, edits=edits, base=airways.base or airways, next_id=next_id)
    steps = steps_of(airways, is_fresh=is_fresh, cancel=cancel)
    steps.make(edit)
    volume = airways.tracker.volume
    core = steps.lumen.core
    changed = None if is_fresh else steps.changed_boxes
    branches = with_sections(volume, core, steps.draft.finished(), tree, changed)
    if steps.judged:
        noise = evidence_of(airways).noise
        branches = tuple(judged(volume, b, noise) if b.id in steps.judged else b for b in branches)
        branches = with_limited_confidence(AirwayTree(branches, notes=tree.notes)).branches
    grid = airways.tracker.grid
    lumen = lumen_voxels(core) if steps.lumen_changed else airways.tracker.lumen_zyx
    recipe = CoreRecipe(airways.wall_levels, is_edited=True)
    tracker = PathTracker(grid, core, recipe=recipe, lumen_zyx=lumen)
    tracker.follow_branches(branches)
    edited_tree = AirwayTree(branches, _smooth=tracker.smooth, notes=tree.notes)
    return dataclasses.replace(
        airways,
        lumen_zyx=_lumen_on_ct(airways, tracker, is_changed=steps.lumen_changed),
        root_lps=branches[0].points[0].copy(),
        tree=edited_tree,
        tracker=tracker,
        edits=edits,
        base=airways.base or airways,
        next_id=steps.draft.next_id,
        uncertain=_uncertain_after(volume, airways, edited_tree),
        bridges=steps.bridges,
    )


def _lumen_on_ct(airways: Airways, tracker: PathTracker, *, is_changed: bool) -> NDArray[np.uint8]:
    """Return the lumen of edited airways on the grid of the CT, (nz, ny, nx); the previous array if both are equal."""
    if not is_changed and not tracker.grid.is_divided:
        return airways.lumen_zyx
    lumen = tracker.grid.lumen_on_ct(tracker.lumen_zyx, tracker.branches)
    return airways.lumen_zyx if not is_changed and np.array_equal(lumen, airways.lumen_zyx) else lumen


def steps_of(airways: Airways, *, is_fresh: bool = False, cancel: Cancel | None = None) -> EditSteps:
    """Return an object that makes or previews an edit of these airways; the airways are not changed."""
    before = EditedLumen(airways.tracker.grid, airways.tracker.core, is_fresh, cancel)
    return EditSteps(
        before,
        with_walls(airways.tree),
        airways.next_id or 1 + max(branch.id for branch in airways.tree.branches),
        (airways.base or airways).tracker.lumen_zyx,
        bridges=airways.bridges,
        evidence=partial(evidence_of, airways),
    )


def _uncertain_after(volume: Volume, airways: Airways, tree: AirwayTree) -> tuple[Uncertainty, ...]:
    """Return the uncertain places of an edited tree; empty if no tree was judged (an imported mask)."""
    found = (airways.base or airways).uncertain
    if not found:
        return ()
    # Leaks of the search stay listed, because an edit does not change where the search would leak into the lung.
    leaks = np.array([one.lps for one in found if one.kind == "leak"]).reshape(-1, 3)
    return find_uncertain(volume, tree, leaks, [one for one in found if one.kind == "filled"])


def _named_by_person(branch: Branch, name: str | None) -> Branch:
    if name is None:
        return dataclasses.replace(branch, name=None, name_confidence=None, name_from=None, variant=None)
    return dataclasses.replace(branch, name=name, name_confidence=None, name_from="person")
