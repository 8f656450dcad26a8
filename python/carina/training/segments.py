"""Segments of the published scores, and the branches of an airway tree that lead to them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from carina.display import one_line
from carina.errors import NoResultError
from carina.track import AirwayTree, Branch
from carina.track.names.name_texts import MIRRORED, bare_name, segment_of

SEGMENTS = (
    *(f"RB{number}" for number in range(1, 11)),
    "LB1+2",
    *(f"LB{number}" for number in (3, 4, 5, 6, 8, 9, 10)),
)
"""The 18 segments of diagnostic completeness, in ascending order (the right lung first)."""
MIRRORED_SEGMENTS = tuple(name.translate(str.maketrans("RL", "LR")) for name in SEGMENTS)
"""The 18 segments of a chest whose three-lobed lung is on the left: the mirror image of :data:`SEGMENTS`."""
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
"""Minimum confidence of a branch's name with which an attempt can count in a verdict."""
_PARTS = {"LB1+2": ("LB1", "LB2"), "RB1+2": ("RB1", "RB2")}
_LETTERS = re.compile(r"(?<=\d)(?:[a-e](?:iv|i{1,3}|v)?)$")


@one_line
@dataclass(frozen=True, slots=True)
class CaseSegment:
    """Segment of a case, with the branches that begin at its openings."""

    name: str
    """Name in :data:`SEGMENTS`; in a mirrored chest, in :data:`MIRRORED_SEGMENTS`."""
    branch_ids: tuple[int, ...]
    """One branch; several where the parts of a segment arise separately, such as LB1 and LB2, or RB7a and RB7b."""


def label_of(branch: Branch) -> str:
    """Return the name of a branch in the usual spelling, or its number."""
    return f"branch {branch.id}" if branch.name is None else bare_name(branch.name)


def branches_named(tree: AirwayTree, name: str) -> tuple[Branch, ...]:
    """Return the branch with a name, or the first branch of each part of the segment with this name.

    If no branch has the whole name, the parts are the topmost branches with the name and a letter (RB7a and RB7b), or
    LB1 and LB2 for LB1+2; none below a branch of another segment. Case and blanks of names are ignored. The result is
    empty if the tree has no such branch.
    """
    wanted = bare_name(name)
    labels = {branch.id: label_of(branch) for branch in tree.branches}
    whole = _topmost(tree, {number for number, label in labels.items() if label == wanted})
    if whole:
        return whole[:1]
    if wanted in {*SEGMENTS, *MIRRORED_SEGMENTS, *_PARTS.get("LB1+2", ()), *_PARTS.get("RB1+2", ())}:
        lettered = {
            branch.id
            for branch in tree.branches
            if _LETTERS.sub("", labels[branch.id]) == wanted
            and not any(segment_of(labels[one.id]) not in {None, wanted} for one in tree.lineage(branch.id))
        }
        if lettered:
            return _topmost(tree, lettered)
    halves = [branches_named(tree, part) for part in _PARTS.get(wanted, ())]
    return tuple(branch for half in halves for branch in half) if all(halves) else ()


def _topmost(tree: AirwayTree, branch_ids: set[int]) -> tuple[Branch, ...]:
    """Return the branches of a set without an ancestor in the set, in the order of the tree."""
    return tuple(
        branch
        for branch in tree.branches
        if branch.id in branch_ids and not any(one.id in branch_ids for one in tree.lineage(branch.id)[:-1])
    )


def is_mirrored(tree: AirwayTree) -> bool:
    """Return whether the three-lobed lung of a chest is on the left."""
    return any(note.code == MIRRORED for note in tree.notes)


def published_segments(tree: AirwayTree) -> tuple[str, ...]:
    """Return the names of the 18 segments of the published scores in a chest, in ascending order."""
    return MIRRORED_SEGMENTS if is_mirrored(tree) else SEGMENTS


def segments_of_case(tree: AirwayTree) -> tuple[CaseSegment, ...]:
    """Return the segments of the published scores that a tree has, in ascending order."""
    found = ((name, branches_named(tree, name)) for name in published_segments(tree))
    return tuple(CaseSegment(name, tuple(one.id for one in branches)) for name, branches in found if branches)


def needed_branches(tree: AirwayTree, names: Sequence[str], *, task: str) -> tuple[Branch, ...]:
    """Return the branches that have any of the given names.

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
