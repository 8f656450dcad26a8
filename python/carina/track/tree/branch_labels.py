"""Labels of branches in saved pictures and videos, which state doubts about the branch and its name."""

from __future__ import annotations

from carina.track.tree.airway_tree import Branch
from carina.track.tree.drawn_parts import kind_words

UNCERTAIN_NAME = 0.6
"""Minimum confidence of a name that is shown without "?", as in the window's list (``web/src/state/branch-
text.ts``)."""


def branch_label(branch: Branch) -> str:
    """Return the name of a branch, or its generation, with the doubts about the branch.

    "?" follows an uncertain name. ``drawn by hand`` or ``bridge`` follows where the CT shows no airway.
    """
    name = branch.name or f"generation {branch.generation}"
    if branch.name is not None and branch.name_confidence is not None and branch.name_confidence < UNCERTAIN_NAME:
        name += "?"
    kind = kind_words(branch.kind)
    return name if kind is None else f"{name}, {kind}"
