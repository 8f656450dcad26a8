"""Path through the airways between two points: up to the branch that both share, and down again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.track.tree.airway_tree import AirwayTree, Branch

Points = NDArray[np.float64]


def way_between(
    tree: AirwayTree, start_lps: Sequence[float] | Points, end_lps: Sequence[float] | Points
) -> tuple[Points, int] | None:
    """Return the path along the centrelines between the tree points nearest to two points.

    Parameters
    ----------
    tree
        Tree with the centrelines.
    start_lps, end_lps
        Points, LPS in mm, anywhere; the nearest points of the tree are used.

    Returns
    -------
    tuple or None
        Points ``(n, 3)``, LPS in mm, from start to end, and the index of the point nearest to the root: the path
        leads towards the root before it, and away from the root after it. None if both points have the same nearest
        point.
    """
    branch_a, index_a, _ = tree.nearest_branch(start_lps)
    branch_b, index_b, _ = tree.nearest_branch(end_lps)
    down_to_a, down_to_b = tree.lineage(branch_a.id), tree.lineage(branch_b.id)
    shared = sum(one.id == other.id for one, other in zip(down_to_a, down_to_b, strict=False))
    trunk = down_to_a[shared - 1]
    leave = _trunk_index(trunk, branch_a, index_a)
    join = _trunk_index(trunk, branch_b, index_b)
    # The path runs up or down along the shared branch; the parts before and after it belong to one lineage only.
    step = 1 if join >= leave else -1
    middle = trunk.points[np.arange(leave, join + step, step)]
    up = _centreline_below(down_to_a[shared:], index_a)[::-1]
    down = _centreline_below(down_to_b[shared:], index_b)
    points = np.concatenate([up, middle, down])
    apex = len(up) + (len(middle) - 1 if step < 0 else 0)
    new = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])
    remaining = points[new]
    return None if len(remaining) < 2 else (remaining, int(np.count_nonzero(new[: apex + 1])) - 1)


def _trunk_index(trunk: Branch, branch: Branch, index: int) -> int:
    """Return the index on a trunk of a point on it, or of the fork at which the point's branch leaves the trunk."""
    return index if branch.id == trunk.id else len(trunk.points) - 1


def _centreline_below(branches: Sequence[Branch], index: int) -> Points:
    """Return the centrelines (n, 3), LPS in mm, from a fork down to a point on the last of the given branches."""
    if not branches:
        return np.empty((0, 3))
    return np.concatenate([*(branch.points for branch in branches[:-1]), branches[-1].points[: index + 1]])
