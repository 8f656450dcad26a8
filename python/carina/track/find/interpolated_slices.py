"""Airways in interpolated slices of a CT, in which nothing was measured: limited confidence, and a permanent note."""

from __future__ import annotations

import dataclasses

import numpy as np

from carina.track.tree.airway_tree import AirwayTree
from carina.volume.model import Note, Volume

INTERPOLATED = "track.interpolated-slices"
"""Code of the permanent note on airways in interpolated slices."""
MAX_CONFIDENCE = 0.5
"""Limit of the confidence of a branch that is mostly in interpolated slices, in which nothing was measured."""
_MOSTLY = 0.5
_MAX_NAMED = 6


def with_interpolated_note(tree: AirwayTree, ct: Volume) -> tuple[AirwayTree, Note | None]:
    """Return the tree with limited confidence of branches in interpolated slices, and a note; None without them.

    Parameters
    ----------
    tree
        The named tree.
    ct
        The CT.
    """
    missing = np.array(ct.source.interpolated_slices)
    if missing.size == 0:
        return tree, None
    branches, through, mostly = [], [], []
    for branch in tree.branches:
        levels = ct.to_ijk(branch.points)[:, 2]
        # A point between a measured and an interpolated slice depends on both.
        share = float((np.abs(levels[:, None] - missing).min(axis=1) < 1.0).mean()) if len(levels) else 0.0
        limited = branch
        if share > 0.0:
            through.append(branch)
        if share >= _MOSTLY:
            mostly.append(branch)
            if branch.confidence is not None and branch.confidence > MAX_CONFIDENCE:
                limited = dataclasses.replace(branch, confidence=MAX_CONFIDENCE)
        branches.append(limited)
    if not through:
        return tree, None
    names = [branch.name or f"branch {branch.id}" for branch in mostly]
    shown = ", ".join(names[:_MAX_NAMED]) + (f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else "")
    most = (
        f"; most of {shown} is in them, so {'their' if len(names) > 1 else 'its'} confidence is limited"
        if names
        else ""
    )
    count = f"{len(through)} of {len(tree.branches)} branches {'passes' if len(through) == 1 else 'pass'}"
    words = (
        f"{count} through interpolated slices{most}. Do not trust diameters there, and check the branches on the "
        "measured slices beside the gap"
    )
    return dataclasses.replace(tree, branches=tuple(branches)), Note(INTERPOLATED, words, badge=True)
