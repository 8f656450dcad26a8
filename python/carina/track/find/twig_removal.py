"""Removal of twigs: tips that stay inside the cross-section of the wide airway that they leave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

NEAR_TOP = 3.0
"""Maximum distance from the trachea's upper end, in radii, of a cut end (a false branch where the scan cuts the
trachea)."""
INSIDE = 1.5
"""Maximum distance of a cut end (a false branch) from the trachea's axis, in radii; a bronchus is farther away."""
MIN_FALL_MM = 2.0
"""Maximum descent in mm of a cut end (a false branch); a branch that descends farther is a bronchus."""
MIN_BULGING_MM = 3.0
"""Minimum radius in mm of an airway whose bulges are removed; in a thinner one a bulge may be a single voxel."""
AXIS_MM = 15.0
"""Length in mm of the upper part of the trachea from which the axis above its upper end is extrapolated."""


def without_twigs(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the compiled tracker's rows of branches without twigs of wide airways.

    If the scan or the search cuts the trachea obliquely, the section of the trachea is longer than wide. The centreline
    starts in one end of the section, and the other end looks like a branch. A bulge of the wall of a wide airway looks
    like a short branch that ends inside the airway's own section. The two parts of the airway at the fork become one
    branch, and the generation of every branch below is lower by one.

    Parameters
    ----------
    rows
        One dict for each branch: ``parent`` (index in the list), ``generation``, ``points``, ``radius_mm``,
        ``wall_mm``, ``cost`` and ``nodes``. The first one is the root. Not modified.
    """
    rows = list(rows)
    number = 1
    while number < len(rows):
        siblings = [other for other, row in enumerate(rows) if row["parent"] == rows[number]["parent"]]
        if _is_cut_end(rows, number, siblings) or _is_bulge(rows, number, siblings):
            rows = _without_leaf(rows, number)
            number = 1
        else:
            number += 1
    return rows


def _is_bulge(rows: Sequence[dict[str, Any]], number: int, siblings: Sequence[int]) -> bool:
    """Return whether a branch is a tip inside the cross-section of the wide airway that it leaves."""
    others = [other for other in siblings if other != number]
    if not others or any(row["parent"] == number for row in rows):
        return False
    going_on = max((rows[other] for other in others), key=lambda row: float(np.median(row["radius_mm"])))
    radius = float(np.median(going_on["radius_mm"]))
    if radius < MIN_BULGING_MM:
        return False
    axis = np.concatenate([np.asarray(rows[rows[number]["parent"]]["points"]), np.asarray(going_on["points"])[1:]])
    away = np.linalg.norm(np.asarray(rows[number]["points"])[:, None] - axis[None], axis=2).min(axis=1)
    return bool(away.max() <= radius)


def _is_cut_end(rows: Sequence[dict[str, Any]], number: int, below: Sequence[int]) -> bool:
    """Return whether a branch of the root is a tip inside the trachea's cross-section, near its upper end."""
    if rows[number]["parent"] != 0 or len(below) < 2 or any(row["parent"] == number for row in rows):
        return False
    others = [other for other in below if other != number and any(row["parent"] == other for row in rows)]
    if not others:
        return False
    root, line = rows[0], np.asarray(rows[number]["points"])
    going_on = max(others, key=lambda other: float(np.median(rows[other]["radius_mm"])))
    trunk = np.concatenate([np.asarray(root["points"]), np.asarray(rows[going_on]["points"])[1:]])
    radius = float(np.median(rows[going_on]["radius_mm"]))
    if _length_mm(np.asarray(root["points"])) > NEAR_TOP * radius:
        return False
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(trunk, axis=0), axis=1))])
    first = trunk[: max(int(np.searchsorted(at, AXIS_MM)), 2)]
    up = first[0] - first[-1]
    up /= max(float(np.linalg.norm(up)), 1e-9)
    if float((line[-1] - line[0]) @ up) < -MIN_FALL_MM:
        return False
    axis = np.concatenate([first[0] + up * np.arange(2.0 * radius, 0.0, -1.0)[:, None], trunk])
    away = np.linalg.norm(line[:, None] - axis[None], axis=2).min(axis=1)
    return bool(away.max() <= INSIDE * radius)


def _length_mm(points: Points) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _without_leaf(rows: Sequence[dict[str, Any]], twig: int) -> list[dict[str, Any]]:
    """Return the rows without a tip; if its parent then has one child left, parent and child are merged."""
    above = rows[twig]["parent"]
    remaining = [number for number, row in enumerate(rows) if row["parent"] == above and number != twig]
    merged = remaining[0] if len(remaining) == 1 else None
    below = set() if merged is None else {merged}
    for number, row in enumerate(rows):
        # Parents come before their children.
        if row["parent"] in below:
            below.add(number)
    removed = {twig, merged}
    place: dict[int | None, int | None] = {None: None}
    for number in range(len(rows)):
        if number not in removed:
            place[number] = len(place) - 1
    if merged is not None:
        place[merged] = place[above]
    found = []
    for number, row in enumerate(rows):
        if number in removed:
            continue
        changed = {**row, "parent": None if row["parent"] is None else place[row["parent"]]}
        if merged is not None and number == above:
            changed |= _join_branches(row, rows[merged])
        elif number in below:
            changed["generation"] = row["generation"] - 1
        found.append(changed)
    return found


def _join_branches(above: dict[str, Any], below: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of one branch made of two; the second one starts at the last point of the first one."""
    # The node of the fork may be in both lists.
    nodes = list(dict.fromkeys(int(node) for node in (*above["nodes"], *below["nodes"])))
    joined: dict[str, Any] = {"nodes": np.array(nodes, dtype=np.uint32), "cost": below["cost"]}
    for field in ("points", "radius_mm", "wall_mm"):
        joined[field] = (
            None if above[field] is None else np.concatenate([np.asarray(above[field]), np.asarray(below[field])[1:]])
        )
    return joined
