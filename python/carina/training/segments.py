"""Segments of the published scores, and the branches of an airway tree that lead to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from carina.display import one_line
from carina.errors import NoResultError
from carina.track import AirwayTree, Branch

SEGMENTS = (
    *(f"RB{number}" for number in range(1, 11)),
    "LB1+2",
    *(f"LB{number}" for number in (3, 4, 5, 6, 8, 9, 10)),
)
"""The 18 segments of diagnostic completeness, in ascending order (the right lung first)."""
LANDMARKS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("main carina", ("RMB", "LMB")),
    ("right upper lobe", ("RUL",)),
    ("bronchus intermedius", ("BI",)),
    ("left secondary carina", ("LUL", "LLL")),
)
"""The four landmarks (JoVE 196, 2023), each with the branches whose openings are in the picture at the same time.

The first three were read in the source (s); the fourth is common knowledge (k).
"""
SURE_NAME = 0.8
"""Least confidence of a branch's name with which an attempt can count in a verdict."""
_PARTS = {"LB1+2": ("LB1", "LB2")}


@one_line
@dataclass(frozen=True, slots=True)
class CaseSegment:
    """Segment of a case, with the branches that begin at its openings."""

    name: str
    """Name in :data:`SEGMENTS`."""
    branch_ids: tuple[int, ...]
    """One branch; two where LB1 and LB2 arise separately, which then both belong to LB1+2."""


def branches_named(tree: AirwayTree, name: str) -> tuple[Branch, ...]:
    """Return the first branch with a name; for LB1+2 the branches LB1 and LB2 if no branch has that name.

    The result is empty if the tree has no such branch.
    """
    for branch in tree.branches:
        if branch.name == name:
            return (branch,)
    parts = tuple(found[0] for part in _PARTS.get(name, ()) if (found := branches_named(tree, part)))
    return parts if len(parts) == len(_PARTS.get(name, ())) else ()


def segments_of_case(tree: AirwayTree) -> tuple[CaseSegment, ...]:
    """Return the segments of :data:`SEGMENTS` that a tree has, in ascending order."""
    found = ((name, branches_named(tree, name)) for name in SEGMENTS)
    return tuple(CaseSegment(name, tuple(one.id for one in branches)) for name, branches in found if branches)


def needed_branches(tree: AirwayTree, names: Sequence[str], *, task: str) -> tuple[Branch, ...]:
    """Return the branches of all names.

    Raises
    ------
    NoResultError
        ``training.no-branch``: if the tree lacks a name.
    """
    found: list[Branch] = []
    for name in names:
        branches = branches_named(tree, name)
        if not branches:
            known = ", ".join(one for one in tree.names) or "none"
            raise NoResultError(
                f"task {task}: the airways of this case: expected a branch named {name}; found the names {known}; "
                "choose another case or task, or name the branch in the window",
                code="training.no-branch",
            )
        found += branches
    return tuple(found)


def doubtful_names(tree: AirwayTree, branch_ids: Sequence[int]) -> tuple[str, ...]:
    """Return a text for each branch whose name has a confidence below :data:`SURE_NAME`.

    Names that a user gave are certain.
    """
    return tuple(
        f"{branch.name} (confidence {branch.name_confidence:.2f})"
        for branch in tree.branches
        if branch.id in branch_ids and branch.name_confidence is not None and branch.name_confidence < SURE_NAME
    )
