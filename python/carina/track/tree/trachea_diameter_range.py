"""Range of trachea diameters for which confidence was calibrated, and the limit of confidence outside this range."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.volume.model import Note

UNCALIBRATED_SIZE = "track.size-not-calibrated"
"""Code of the permanent note on a tree whose trachea is outside the calibrated range."""
CALIBRATED_MM = (12.0, 27.0)
"""Range of diameters in mm of the trachea in the CTs on which confidence was calibrated (docs/decisions/0137)."""
UNPROVEN = 0.5
"""Minimum of the confidence limit, for a trachea far outside the calibrated range of diameters."""
# Share below or above the range over which the limit falls from 1 to UNPROVEN.
FALL_SHARE = 0.15
WIDE_PART = 75.0
"""Percentile of the radii along a branch that counts as its radius, so that a stenosis has no effect."""
MAIN_OF_TRACHEA = 0.77
"""Usual ratio of the main bronchi's root mean square diameter to the trachea's diameter."""


def limit_at(trachea_mm: float) -> float:
    """Return the highest confidence that a branch may have with a trachea of this diameter: 0.5 to 1.

    Examples
    --------
    >>> limit_at(18.0), round(limit_at(11.1), 2), limit_at(9.0)
    (1.0, 0.75, 0.5)
    """
    low, high = CALIBRATED_MM
    beyond = max(1.0 - trachea_mm / low, trachea_mm / high - 1.0, 0.0) / FALL_SHARE
    return 1.0 - (1.0 - UNPROVEN) * min(beyond, 1.0)


def _diameter_mm(tree: AirwayTree, name: str) -> float | None:
    """Return the 75th percentile of a named airway's diameter, mm; None without such a branch."""
    radii = [branch.radius for branch in tree.branches if branch.name == name]
    return 2.0 * float(np.percentile(np.concatenate(radii), WIDE_PART)) if radii else None


def _sizes_mm(tree: AirwayTree) -> tuple[float, ...]:
    """Return two estimates of the trachea's diameter in mm: measured, and from the main bronchi; empty if unnamed."""
    trachea = _diameter_mm(tree, "Trachea")
    if trachea is None:
        return ()
    right, left = _diameter_mm(tree, "RMB"), _diameter_mm(tree, "LMB")
    if right is None or left is None:
        return (trachea,)
    return trachea, math.sqrt(0.5 * (right**2 + left**2)) / MAIN_OF_TRACHEA


def confidence_limit(tree: AirwayTree) -> float:
    """Return the highest confidence that the tree's branches and names may have, 0.5 to 1.

    The limit applies only if the diameters of the trachea and of the main bronchi are both below or both above the
    calibrated range: a disease that narrows or widens the trachea alone has no effect.
    """
    sizes = _sizes_mm(tree)
    return max(map(limit_at, sizes)) if sizes and _have_same_limit(sizes) else 1.0


def _have_same_limit(sizes: tuple[float, ...]) -> bool:
    low, high = CALIBRATED_MM
    return all(size < low for size in sizes) or all(size > high for size in sizes)


def _limit_confidence(branch: Branch, most: float) -> Branch:
    sure, name_sure = branch.confidence, branch.name_confidence
    return dataclasses.replace(
        branch,
        confidence=None if sure is None else min(sure, most),
        name_confidence=None if name_sure is None else min(name_sure, most),
    )


def with_limited_confidence(tree: AirwayTree) -> AirwayTree:
    """Return the tree with limited confidences if it has the note :data:`UNCALIBRATED_SIZE`; else unchanged."""
    if all(note.code != UNCALIBRATED_SIZE for note in tree.notes):
        return tree
    # An edit may have removed the name of the trachea: its size is then unknown.
    most = round(confidence_limit(tree), 3) if _sizes_mm(tree) else UNPROVEN
    return dataclasses.replace(tree, branches=tuple(_limit_confidence(branch, most) for branch in tree.branches))


def with_size_note(tree: AirwayTree) -> AirwayTree:
    """Return the tree with limited confidences and a permanent note, if its trachea is outside the calibrated range.

    Parameters
    ----------
    tree
        Tree with names. A tree without a named trachea has no size and is returned unchanged.
    """
    most = confidence_limit(tree)
    if most == 1.0:
        return tree
    low, high = CALIBRATED_MM
    words = (
        f"the trachea measures {_sizes_mm(tree)[0]:.1f} mm across; Carina's confidence was calibrated on "
        f"{low:.0f} to {high:.0f} mm, so every confidence is limited to {100.0 * most:.0f} %. Check each branch on the "
        "slices, and whether the scan has the correct voxel spacing"
    )
    notes = (*tree.notes, Note(UNCALIBRATED_SIZE, words, badge=True))
    return with_limited_confidence(dataclasses.replace(tree, notes=notes))
