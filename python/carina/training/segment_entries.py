"""Detection of the times at which the tip of the scope enters a segment.

docs/training.md defines *inside*, *entered* and *left*; the durations are definitions of Carina, not pass marks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from carina.track import AirwayTree
from carina.training.openings_in_sight import BranchOpening
from carina.training.visits import SEEN_S, Visit, first_run, run_ends

ENTERED_S = 0.5
"""Time in s for which the tip is in a branch without a break when the branch is entered."""
LEFT_S = 0.5
"""Time in s for which the tip is outside a segment without a break when the segment has been left."""


def openings_passed(
    tips: NDArray[np.float64],
    branch_ids: NDArray[np.int64],
    tree: AirwayTree,
    openings: Sequence[BranchOpening],
) -> NDArray[np.int64]:
    """Return (n,) index of the opening inside whose branch, or a descendant of it, the tip is, or -1.

    In the branch itself the tip must be past the plane of the opening; of nested branches the innermost one counts.

    Parameters
    ----------
    tips
        (n, 3) position of the tip at each frame, LPS mm.
    branch_ids
        (n,) branch of the tip at each frame.
    tree
        Airways of the case.
    openings
        The openings.
    """
    opening_of = {one.branch_id: k for k, one in enumerate(openings)}
    owner = _owners(tree, opening_of)
    found = np.array([owner[int(one)] for one in branch_ids], dtype=np.int64)
    for k, one in enumerate(openings):
        before = (tips - one.middle_lps) @ one.dir_lps < 0.0
        found[(found == k) & (branch_ids == one.branch_id) & before] = -1
    return found


def _owners(tree: AirwayTree, opening_of: Mapping[int, int]) -> dict[int, int]:
    """Return for each branch the index of the opening of the branch itself, or of its nearest ancestor, or -1."""
    return {
        branch.id: next((opening_of[one.id] for one in reversed(tree.lineage(branch.id)) if one.id in opening_of), -1)
        for branch in tree.branches
    }


def openings_entered(passed: NDArray[np.int64], clear_view: NDArray[np.bool_], num_openings: int) -> list[int | None]:
    """Return for each opening the frame at which the tip has been inside for :data:`SEEN_S` with a clear view."""
    return [first_run((passed == k) & clear_view, SEEN_S) for k in range(num_openings)]


def entries_of(
    passed: NDArray[np.int64], clear_view: NDArray[np.bool_], places: Sequence[Sequence[int]]
) -> list[Visit]:
    """Return the entries of places in their order; a place is entered again only after the tip has left it.

    Parameters
    ----------
    passed
        (n,) from `openings_passed`.
    clear_view
        (n,) whether the view is clear at each frame.
    places
        Indices of the openings of each place.
    """
    place_of = {k: place for place, openings in enumerate(places) for k in openings}
    inside = np.array([place_of.get(int(k), -1) for k in passed], dtype=np.int64)
    entries: list[Visit] = []
    latest: dict[int, int] = {}
    for frame, place in run_ends(np.where(clear_view, inside, -1), ENTERED_S):
        if place < 0:
            continue
        if place not in latest or first_run(inside[latest[place] : frame] != place, LEFT_S) is not None:
            entries.append(Visit(frame, place, entered=True))
        latest[place] = frame
    return entries
