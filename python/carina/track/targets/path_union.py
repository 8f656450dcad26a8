"""Tree that unites several paths from one start whose points are not nodes of one graph."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.track.find.result import Airways
from carina.track.targets.relaxed_path import BESIDE_LUMEN_MM
from carina.track.tree.airway_tree import Branch

Points = NDArray[np.float64]


def tree_of_paths(paths: Sequence[Points], airways: Airways) -> tuple[tuple[Branch, ...], Points]:
    """Return the branches of the union of paths from one start, and the points (n, 3) where paths part, LPS in mm.

    A path is together with the earlier ones as long as each of its points is in the ball of lumen around one of
    theirs; outside the lumen, as long as it is within `BESIDE_LUMEN_MM`.
    """
    long = [path for path in paths if len(path) > 1]
    parts = long[:1]
    # Part and index of the point at which each part leaves an earlier one.
    leaves: list[tuple[int, int]] = [(0, 0)] * len(parts)
    for path in long[1:]:
        every = np.concatenate(parts)
        shared, nearest = _shared(path, every, airways)
        if shared == len(path):
            continue
        ends = np.cumsum([len(part) for part in parts])
        part = int(np.searchsorted(ends, nearest, side="right"))
        # The first point of a part belongs to the part that it leaves.
        at = max(nearest - int(ends[part]) + len(parts[part]), 1)
        leaves.append((part, at))
        parts.append(np.concatenate([parts[part][at][None], path[shared:]]))
    branches: list[Branch] = []
    ending_at: dict[tuple[int, int], int] = {}
    for number, points in enumerate(parts):
        above = ending_at[leaves[number]] if number else None
        cuts = {at for part, at in leaves[1:] if part == number} | {len(points) - 1}
        for first, last in itertools.pairwise([0, *sorted(cuts)]):
            piece = points[first : last + 1]
            branch = Branch(
                id=len(branches),
                parent=above,
                children=(),
                generation=0,
                name=None,
                kind="tracked",
                points=piece,
                radius=airways.tracker.core.radius_mm(piece),
                cost=None,
            )
            if above is not None:
                parent = branches[above]
                branches[above] = dataclasses.replace(parent, children=(*parent.children, branch.id))
            branches.append(branch)
            above = ending_at[number, last] = branch.id
    for branch in branches:
        if branch.parent is not None:
            parent = branches[branch.parent]
            # A branch that only continues its parent has the generation of its parent: there is no fork between them.
            generation = parent.generation + int(len(parent.children) > 1)
            branches[branch.id] = dataclasses.replace(branch, generation=generation)
    forks = [branch.points[-1] for branch in branches if len(branch.children) > 1]
    return tuple(branches), np.array(forks).reshape(-1, 3)


def _shared(path: Points, others: Points, airways: Airways) -> tuple[int, int]:
    """Return how many first points a path shares with others, and the others' point nearest to the last one."""
    squares = (path**2).sum(axis=1)[:, None] + (others**2).sum(axis=1)[None] - 2.0 * path @ others.T
    nearest = squares.argmin(axis=1)
    distance = np.linalg.norm(path - others[nearest], axis=1)
    inside = airways.tracker.inside(others)[nearest]
    radius = np.where(inside, airways.tracker.core.radius_mm(others)[nearest], BESIDE_LUMEN_MM)
    apart = np.flatnonzero(distance > radius)
    shared = int(apart[0]) if len(apart) else len(path)
    return shared, int(nearest[max(shared - 1, 0)])
