"""Orientation of a second CT whose airways do not fit: mirrored, rotated or upside down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.plan.movement.forks import fork_points
from carina.track import AirwayTree

Points = NDArray[np.float64]

NEAR_CARINA_MM = 90.0
"""Maximum distance in mm of compared forks from the main carina; breathing moves nearer forks little."""
MIN_FORKS = 8
BETTER = 0.75
"""Maximum ratio of the median fork distance in another orientation to that in the stated orientation."""
ORIENTATIONS = (
    ((-1.0, 1.0, 1.0), "movement.mirrored", "a mirror image of this CT: right and left are exchanged"),
    ((1.0, -1.0, 1.0), "movement.mirrored", "a mirror image of this CT: front and back are exchanged"),
    ((1.0, 1.0, -1.0), "movement.mirrored", "a mirror image of this CT: head and feet are exchanged"),
    (
        (-1.0, -1.0, 1.0),
        "movement.pose",
        "rotated by 180 degrees: the patient lies prone in one CT and supine in the other",
    ),
    ((1.0, -1.0, -1.0), "movement.pose", "upside down"),
    ((-1.0, 1.0, -1.0), "movement.pose", "upside down"),
)
"""Signs of x, y and z with the code and the text of the refusal."""


def orientation_error(first: AirwayTree, second: AirwayTree) -> NoResultError | None:
    """Return the error that names the orientation in which the airways of a second CT fit; None for the stated one.

    Names of branches are not used, because a tree in a wrong orientation is named wrongly.
    """
    here, there = _around_carina(first), _around_carina(second)
    if min(len(here), len(there)) < MIN_FORKS:
        return None
    stated_mm = _apart_mm(here, there)
    fits = [(_apart_mm(here, there * signs), code, words) for signs, code, words in ORIENTATIONS]
    best_mm, code, words = min(fits)
    if best_mm > BETTER * stated_mm:
        return None
    return NoResultError(
        f"the second CT seems to be {words}, or the orientation in its file is wrong. Compare its orientation letters "
        "with those of this CT, and choose a CT in the pose of the procedure",
        code=code,
    )


def _around_carina(tree: AirwayTree) -> Points:
    """Return the forks (n, 3) near the main carina relative to it, mm."""
    carina = next((one for one in tree.branches if one.name == "Trachea"), tree.branches[0])
    if not len(carina.points):
        return np.zeros((0, 3))
    found: Points = fork_points(tree) - carina.points[-1]
    away = np.linalg.norm(found, axis=1)
    near: Points = found[(away > 1.0) & (away < NEAR_CARINA_MM)]
    return near


def _apart_mm(here: Points, there: Points) -> float:
    """Return the median distance in mm of forks from the other tree's nearest fork; the larger of both directions."""
    away = np.linalg.norm(here[:, None] - there[None], axis=2)
    return float(max(np.median(away.min(axis=0)), np.median(away.min(axis=1))))
