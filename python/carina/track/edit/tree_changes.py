"""Draft of an airway tree during an edit: branches are removed, split, joined and reversed.

This module contains only geometry and bookkeeping; :mod:`carina.track.edit.edits` checks points against the lumen.
"""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError
from carina.track.tree.airway_tree import AirwayTree, Branch

Points = NDArray[np.float64]

ONE_FORK_RADII = 0.9
"""Distance between two forks, in radii of the tube, below which both are one fork (as in the search)."""


@dataclass(frozen=True, slots=True)
class CentrelinePoint:
    """Point of a centreline: branch ID and index of the point."""

    branch_id: int
    index: int


def along_mm(points: Points) -> NDArray[np.float64]:
    """Return the length in mm along a centreline up to each of its points, (n,)."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def turn_deg(before: Points, after: Points) -> float:
    """Return the angle in degrees between the last 5 mm of a line and the first 5 mm of the line that continues it."""
    back, on = along_mm(before), along_mm(after)
    came = before[-1] - before[int(np.searchsorted(back, back[-1] - 5.0, side="right")) - 1 if back[-1] > 5.0 else 0]
    goes = after[min(int(np.searchsorted(on, 5.0)), len(after) - 1)] - after[0]
    length = float(np.linalg.norm(came) * np.linalg.norm(goes))
    return 0.0 if length == 0.0 else float(np.degrees(np.arccos(np.clip(came @ goes / length, -1.0, 1.0))))


def needed_branch(tree: AirwayTree, branch_id: int) -> Branch:
    """Return the branch with the given ID.

    Raises
    ------
    UsageError
        If the tree has no such branch.
    """
    for branch in tree.branches:
        if branch.id == branch_id:
            return branch
    msg = f"branch {branch_id} is not in the tree (it may have been cut); choose a branch from the list"
    raise UsageError(msg, code="track.edit-branch")


class TreeDraft:
    """Tree whose branches can change; IDs stay, and new branches get IDs that were never used.

    Parameters
    ----------
    tree
        Tree to start from; not changed.
    next_id
        First ID that was never used.
    """

    def __init__(self, tree: AirwayTree, next_id: int) -> None:
        self._branches = {branch.id: branch for branch in tree.branches}
        self.root_id = tree.root.id
        self.next_id = next_id

    def __getitem__(self, branch_id: int) -> Branch:
        """Return the branch with the given ID."""
        return self._branches[branch_id]

    def __contains__(self, branch_id: object) -> bool:
        """Return whether the modified tree has a branch with the given ID."""
        return branch_id in self._branches

    def ordered(self) -> list[Branch]:
        """Return all branches of the modified tree, parents before children, in the order of the parents' lists."""
        found: list[Branch] = []
        waiting = [self.root_id]
        while waiting:
            branch = self._branches[waiting.pop()]
            found.append(branch)
            waiting.extend(reversed(branch.children))
        return found

    def below(self, branch_id: int) -> list[Branch]:
        """Return a branch and all branches below it, parents first."""
        found = [self._branches[branch_id]]
        for branch in found:
            found.extend(self._branches[child] for child in branch.children)
        return found

    def change(self, branch_id: int, **values: object) -> Branch:
        """Replace fields of a branch of the modified tree, and return the new branch."""
        branch = dataclasses.replace(self._branches[branch_id], **values)  # type: ignore[arg-type]
        self._branches[branch_id] = branch
        return branch

    def add_child(self, parent_id: int | None, points: Points, radius: NDArray[np.float64], kind: str) -> int:
        """Add a branch at the end of a parent; return its ID.

        Without a parent the branch is the new root; the caller sets its children.
        """
        branch_id = self.next_id
        self.next_id += 1
        self._branches[branch_id] = Branch(branch_id, parent_id, (), 0, None, kind, points, radius)
        if parent_id is not None:
            self.change(parent_id, children=(*self._branches[parent_id].children, branch_id))
        return branch_id

    def remove(self, branch_id: int) -> None:
        """Remove a branch and all branches below it from the draft.

        The parent of the removed branch and the only remaining child are joined, as they were before the fork,
        unless the child has another name or is of another kind.
        """
        for branch in self.below(branch_id):
            del self._branches[branch.id]
            if branch.id == branch_id and branch.parent is not None:
                parent = self._branches[branch.parent]
                self.change(parent.id, children=tuple(child for child in parent.children if child != branch_id))
                self._join_only_child(parent.id)

    def _join_only_child(self, branch_id: int) -> None:
        branch = self._branches[branch_id]
        if len(branch.children) != 1:
            return
        child = self._branches[branch.children[0]]
        if child.kind != branch.kind or (child.name is not None and child.name != branch.name):
            return
        del self._branches[child.id]
        self.change(
            branch_id,
            points=np.concatenate([branch.points, child.points[1:]]),
            radius=np.concatenate([branch.radius, child.radius[1:]]),
            children=child.children,
            doubtful_mm=branch.doubtful_mm + child.doubtful_mm,
            cost=_sum(branch.cost, child.cost),
            confidence=_least(branch.confidence, child.confidence),
        )
        for grandchild in child.children:
            self.change(grandchild, parent=branch_id)

    def shorten(self, branch_id: int, last: int) -> None:
        """End a branch at one of its points, and remove all branches below it."""
        for child in self._branches[branch_id].children:
            for branch in self.below(child):
                del self._branches[branch.id]
        branch = self._branches[branch_id]
        self.change(
            branch_id,
            children=(),
            points=branch.points[: last + 1],
            radius=branch.radius[: last + 1],
            cost=None,
            doubtful_mm=_share_mm(branch, last),
        )

    def split(self, place: CentrelinePoint) -> int:
        """Split a branch at an inner point; the upper part keeps the ID. Return the ID of the lower part."""
        branch, at = self._branches[place.branch_id], place.index
        assert 0 < at < len(branch.points) - 1
        lower_id = self.next_id
        self.next_id += 1
        self._branches[lower_id] = dataclasses.replace(
            branch,
            id=lower_id,
            parent=branch.id,
            name=None,
            name_confidence=None,
            name_from=None,
            variant=None,
            cost=None,
            points=branch.points[at:],
            radius=branch.radius[at:],
            doubtful_mm=branch.doubtful_mm - _share_mm(branch, at),
        )
        for child in branch.children:
            self.change(child, parent=lower_id)
        self.change(
            branch.id,
            children=(lower_id,),
            cost=None,
            points=branch.points[: at + 1],
            radius=branch.radius[: at + 1],
            doubtful_mm=_share_mm(branch, at),
        )
        return lower_id

    def parent_at(self, place: CentrelinePoint, least_mm: float) -> int:
        """Return the ID of the branch whose end is the start of a new branch that leaves the tree at a place.

        The branch is split there if no fork is near. If the place is so close to a tip that less than ``least_mm``
        would be left, the branch is shortened instead: such a remainder is only the end of the centreline.
        """
        branch = self._branches[place.branch_id]
        along = along_mm(branch.points)
        near_mm = ONE_FORK_RADII * float(branch.radius[place.index])
        if not branch.children and place.index > 0 and along[-1] - along[place.index] < max(near_mm, least_mm):
            self.shorten(branch.id, place.index)
            return branch.id
        if along[-1] - along[place.index] < near_mm or len(branch.points) < 3:
            return branch.id
        if along[place.index] < near_mm and branch.parent is not None:
            return branch.parent
        inner = min(max(place.index, 1), len(branch.points) - 2)
        self.split(CentrelinePoint(branch.id, inner))
        return branch.id

    def turn_round(self, root_branch_id: int) -> None:
        """Make the tip of a leaf branch the root; the branches on the path to this tip are reversed."""
        lineage = [root_branch_id]
        while (parent := self._branches[lineage[-1]].parent) is not None:
            lineage.append(parent)
        siblings = {
            member: tuple(child for child in self._branches[parent].children if child != member)
            for member, parent in itertools.pairwise(lineage)
        }
        for number, member in enumerate(lineage):
            branch = self._branches[member]
            above = lineage[number + 1] if number + 1 < len(lineage) else None
            children = () if above is None else (above, *siblings[member])
            for child in children:
                self.change(child, parent=member)
            self.change(
                member,
                parent=None if number == 0 else lineage[number - 1],
                children=children,
                points=branch.points[::-1].copy(),
                radius=branch.radius[::-1].copy(),
            )
        self.root_id = root_branch_id

    def finished(self) -> tuple[Branch, ...]:
        """Return the branches of the draft in order, with generations.

        The only child of a branch has the generation of its parent, because there is no fork between them.
        """
        generation: dict[int, int] = {}
        found = []
        for branch in self.ordered():
            if branch.parent is None:
                generation[branch.id] = 0
            else:
                siblings = [self._branches[child] for child in self._branches[branch.parent].children]
                # A branch that was drawn without evidence does not count as a fork for its siblings.
                is_fork = sum(other.kind != "manual" or branch.kind == "manual" for other in siblings) > 1
                generation[branch.id] = generation[branch.parent] + int(is_fork)
            found.append(dataclasses.replace(branch, generation=generation[branch.id]))
        return tuple(found)


def _share_mm(branch: Branch, last: int) -> float:
    """Return the part of a branch's doubtful length (mm) up to a point, in proportion to the lengths."""
    along = along_mm(branch.points)
    return branch.doubtful_mm * float(along[last] / along[-1]) if branch.doubtful_mm > 0.0 and along[-1] > 0.0 else 0.0


def _sum(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a + b


def _least(a: float | None, b: float | None) -> float | None:
    return min((v for v in (a, b) if v is not None), default=None)
