"""Ridge of the main carina, the origin of the distances that a bronchoscopist uses."""

from __future__ import annotations

import itertools
from dataclasses import replace

from carina.track import Airways, AirwayTree, Branch
from carina.track.measures.forks import find_forks
from carina.volume import Volume

__all__ = ["SAME_PLACE_MM", "ridge_beyond_axes_mm"]

SAME_PLACE_MM = 1e-6


def ridge_beyond_axes_mm(volume: Volume, airways: Airways, branch_id: int, axes_mm: float) -> float | None:
    """Return how far the ridge of the main carina is beyond the point where the axes of the main bronchi meet, in mm.

    Parameters
    ----------
    volume, airways
        The CT and its airways.
    branch_id
        Id of a branch beyond the main carina.
    axes_mm
        Distance from the root to the point where the axes meet, along the way to the branch.

    Returns
    -------
    float or None
        None if there is no fork at this distance, or no ridge of wall.
    """
    tree = airways.tree
    at_mm = 0.0
    for mother, _ in itertools.pairwise(tree.lineage(branch_id)):
        at_mm += mother.length_mm
        if len(mother.children) > 1 and abs(at_mm - axes_mm) < SAME_PLACE_MM:
            ids = {mother.id, *mother.children}
            alone = AirwayTree(tuple(_without_rest(branch, ids) for branch in tree.branches if branch.id in ids))
            return find_forks(volume, airways.lumen_zyx, alone)[0].fork_to_carina_mm
    return None


def _without_rest(branch: Branch, ids: set[int]) -> Branch:
    """Return a copy of a branch in which parent and children are limited to the given IDs."""
    parent = branch.parent if branch.parent in ids else None
    return replace(branch, parent=parent, children=tuple(i for i in branch.children if i in ids))
