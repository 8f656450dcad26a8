"""Plausibility check of an airway tree: totals larger than in any chest, or a trachea that leads nowhere."""

from __future__ import annotations

from carina.track.find.beyond import SOFT_KERNEL, STOPPED
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Note

__all__ = ["doubt_of_totals"]

# Upper limits of a tree. The airways that CTs show are 1 to 4 m long in total, in 100 to 600 branches of up to 10 to 16
# generations.
MOST_LENGTH_MM = 12_000.0
MOST_BRANCHES = 2_500
MOST_GENERATION = 40
# Beyond a trachea that divides, both main bronchi with their lobar bronchi are longer than this in total.
LEAST_BEYOND_MM = 150.0


def doubt_of_totals(branches: tuple[Branch, ...], *, splits: bool) -> Note | None:
    """Return the permanent note on a tree that is too large for a chest, or too small beyond a trachea that divides.

    Returns None if the totals are plausible.

    Parameters
    ----------
    branches
        Branches of the tree.
    splits
        Whether the trachea was found by its division into two main bronchi, with lung on both sides.
    """
    length_mm = float(sum(branch.length_mm for branch in branches))
    deepest = max(branch.generation for branch in branches)
    if length_mm > MOST_LENGTH_MM or len(branches) > MOST_BRANCHES or deepest > MOST_GENERATION:
        words = (
            f"the segmentation leaked: {length_mm / 1000.0:.0f} m of airway in {len(branches)} branches of {deepest} "
            f"generations is more than any chest contains, so much of it is lung. {SOFT_KERNEL}"
        )
        return Note(STOPPED, words, badge=True)
    beyond_mm = length_mm - branches[0].length_mm
    if splits and beyond_mm < LEAST_BEYOND_MM:
        words = (
            f"the search was stopped near the trachea: only {beyond_mm:.0f} mm of airway was found beyond it, although "
            f"the scan contains both lungs. Nearly all airways are missing. {SOFT_KERNEL}"
        )
        return Note(STOPPED, words, badge=True)
    return None
