"""Texts of edits for the undo list."""

from __future__ import annotations

from carina.track.edit.kinds import (
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
)
from carina.track.find.found import Airways
from carina.track.tree.airway_tree import AirwayTree

__all__ = ["edit_words"]


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


def _title(tree: AirwayTree, branch_id: int) -> str:
    name = next((branch.name for branch in tree.branches if branch.id == branch_id), None)
    return branch_title(name, branch_id)


def _nearest_title(tree: AirwayTree, lps: Point) -> str:
    branch, _, _ = tree.nearest_branch(lps)
    return branch_title(branch.name, branch.id)
