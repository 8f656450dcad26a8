"""Lengths of a tree or path that the CT does not show: drawn by hand, or a bridge across an obstruction.

Routes, files, films and reports all use these functions, so that their figures agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.value import FrozenValue

SHOWN_MM = 0.05
"""Minimum length in mm of a drawn or bridged part that texts state; less is a rounding error."""


class DrawnPart(FrozenValue, frozen=True):
    """Lengths of a path or tree: in total, drawn by hand, and bridged across obstructions."""

    length_mm: float
    """Length of the whole path or tree, in mm."""
    drawn_mm: float = 0.0
    """Length along branches that a user drew (kind ``manual``), in mm."""
    bridge_mm: float = 0.0
    """Length across obstructions (kind ``bridge``), in mm."""

    @property
    def words(self) -> str | None:
        """Text such as ``21 of 180 mm drawn by hand``; None if the CT shows the whole length."""
        parts = []
        if self.drawn_mm > SHOWN_MM:
            parts.append(f"{self.drawn_mm:.0f} of {self.length_mm:.0f} mm drawn by hand")
        if self.bridge_mm > SHOWN_MM:
            parts.append(f"{self.bridge_mm:.0f} of {self.length_mm:.0f} mm bridged across an obstruction")
        return "; ".join(parts) or None

    def to_json(self) -> dict[str, Any]:
        """Return ``drawn_mm`` and ``bridge_mm`` as JSON values, in mm."""
        return {"drawn_mm": round(self.drawn_mm, 2), "bridge_mm": round(self.bridge_mm, 2)}


def drawn_part(
    branches: AirwayTree | Mapping[int, Branch], branch_ids: NDArray[Any], cumulative_mm: NDArray[np.float64]
) -> DrawnPart:
    """Measure the length of a path in branches that the CT does not show.

    Parameters
    ----------
    branches
        The tree, or its branches by ID. IDs that are not in it (lumen beyond the tree) count as shown.
    branch_ids
        (n,) ID of the branch at each point; at a fork that of the branch that ends there, as in
        :class:`carina.track.Route`.
    cumulative_mm
        (n,) position of each point along the path, mm, ascending.
    """
    by_id = {b.id: b for b in branches.branches} if isinstance(branches, AirwayTree) else branches
    steps_mm = np.diff(cumulative_mm)
    ids = np.asarray(branch_ids)[1:]

    def along(kind: str) -> float:
        return float(steps_mm[np.isin(ids, [b.id for b in by_id.values() if b.kind == kind])].sum())

    return DrawnPart(float(steps_mm.sum()), along("manual"), along("bridge"))


def drawn_tree(tree: AirwayTree) -> DrawnPart:
    """Measure the length of the branches of a tree that the CT does not show."""
    drawn = sum(branch.length_mm for branch in tree.branches if branch.kind == "manual")
    bridge = sum(branch.length_mm for branch in tree.branches if branch.kind == "bridge")
    return DrawnPart(sum(branch.length_mm for branch in tree.branches), drawn, bridge)


def kind_words(kind: str) -> str | None:
    """Return the text after a branch's name, ``drawn by hand`` or ``bridge``; None for a branch that was found."""
    return {"manual": "drawn by hand", "bridge": "bridge"}.get(kind)
