"""Branch of an airway tree that contains a point, for captions and titles of pictures and videos."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.tree.airway_tree import AirwayTree, Branch

NEAR_MM = 3.0
"""Maximum distance in mm, beyond the branch's radius, of a point from the centreline of the branch that contains it."""


def branch_at_point(tree: AirwayTree, point_lps: NDArray[np.float64]) -> tuple[Branch, int] | None:
    """Return the branch that contains a point and the index of its nearest centreline point; None outside the airways.

    Parameters
    ----------
    tree
        The airway tree.
    point_lps
        The point, LPS mm.
    """
    branch, index, away_mm = tree.nearest_branch(point_lps)
    return (branch, index) if away_mm <= float(branch.radius[index]) + NEAR_MM else None
