"""Forks of two airway trees of one patient, matched by the names of their branches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.track import AirwayTree, Branch

Points = NDArray[np.float64]

MIN_CONFIDENCE = 0.5
"""Minimum confidence of a branch name in each tree from which the forks of the branch are compared."""


@one_line
@dataclass(frozen=True, slots=True)
class ForkShift:
    """Shift of one fork from the first CT to the second."""

    branch: str
    """Name of the branch that ends in the fork, such as ``RB6``."""
    first_lps: tuple[float, float, float]
    """Position of the fork in the first CT, LPS mm."""
    shift_lps: tuple[float, float, float]
    """Shift (x, y, z) of the fork from the first to the second CT, LPS mm, with any shift of the table."""
    residual_mm: float
    """Distance in mm between the measured shift and the shift that the other forks and vessels predict."""
    is_used: bool
    """Whether the fork's shift agrees with the other shifts and contributes to the deformation."""

    def to_json(self) -> dict[str, Any]:
        """Return the shift as plain JSON types."""
        return {
            "branch": self.branch,
            "first_lps": list(self.first_lps),
            "shift_lps": list(self.shift_lps),
            "residual_mm": self.residual_mm,
            "is_used": self.is_used,
        }


def named_forks(first: AirwayTree, second: AirwayTree) -> tuple[tuple[str, ...], Points, Points]:
    """Return the names of the branches that end in a fork in both trees, and both places (n, 3) of each fork, LPS mm.

    A branch counts if both trees give the name to exactly one branch with enough confidence, and if the CT shows the
    branch.
    """
    here, there = _by_name(first), _by_name(second)
    names = tuple(name for name in here if name in there)
    places = [np.array([tree[name].points[-1] for name in names]).reshape(-1, 3) for tree in (here, there)]
    return names, places[0], places[1]


def fork_points(tree: AirwayTree) -> Points:
    """Return the positions (n, 3) of all forks of a tree, LPS mm."""
    found = [one.points[-1] for one in tree.branches if len(one.children) > 1 and len(one.points) and _is_shown(one)]
    return np.array(found, dtype=np.float64).reshape(-1, 3)


def _by_name(tree: AirwayTree) -> dict[str, Branch]:
    found: dict[str, Branch] = {}
    twice = set()
    for branch in tree.branches:
        sure = branch.name_confidence is None or branch.name_confidence >= MIN_CONFIDENCE
        if branch.name is None or not sure or len(branch.children) < 2 or not len(branch.points):
            continue
        if branch.name in found:
            twice.add(branch.name)
        if _is_shown(branch):
            found[branch.name] = branch
    return {name: branch for name, branch in found.items() if name not in twice}


def _is_shown(branch: Branch) -> bool:
    return branch.kind == "tracked"
