"""``carina bench track --only mr``: paths and airways in synthetic MR pictures of phantoms, compared with the truth.

Paths to named segments start in the middle of the trachea. The paper's tracker searches the whole picture, with both
signs of the paper's cost; the other paths follow the airways that the automatic search finds. The distance is that
between the points of a path and the true centrelines.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import CarinaError
from carina.phantom import Phantom, generate_mr_phantom
from carina.track import find_airways
from carina.track.targets.paper_tracker import track_on_graph

__all__ = ["run"]

Row = dict[str, Any]
Points = NDArray[np.float64]
Say = Callable[[str], None]

SEEDS, QUICK_SEEDS = range(1, 6), range(1, 2)
"""Seeds of the phantoms that are shown as MR images, in a full and in a quick run."""
SPACING_MM, SNR = 1.5, 20.0
"""Size of the voxels in mm, and ratio of the signal of soft tissue to the noise."""
SEGMENTS = ("RB1", "RB4", "RB6", "RB8", "RB10", "LB3", "LB4", "LB6", "LB8", "LB10")
"""Segments to which paths are searched."""
STEP_MM = 0.5
"""Distance in mm between the compared points of the true centrelines."""
COSTS = ("lumen", "walls", "paper")


def run(quick: bool, say: Say) -> list[Row]:
    """Return rows with the distances of paths from the true centrelines, and their shares inside the true lumen."""
    rows: list[Row] = []
    all_off: dict[str, list[Points]] = {cost: [] for cost in COSTS}
    all_inside: dict[str, list[bool]] = {cost: [] for cost in COSTS}
    for seed in QUICK_SEEDS if quick else SEEDS:
        made = generate_mr_phantom(seed=seed, spacing_mm=SPACING_MM, snr=SNR, progress=False)
        for cost in COSTS:
            try:
                paths = _paths(made, cost)
            except CarinaError as error:
                rows.append({"what": "paths found", "case": f"{cost}, phantom {seed}", "figure": 0, "note": str(error)})
                continue
            off, inside = _compared(made, paths)
            all_off[cost].append(off)
            all_inside[cost] += list(inside)
            say(f"phantom {seed}, {cost}: {len(paths)} paths, {off.mean():.2f} mm off, {100 * np.mean(inside):.1f} %")
    for cost in COSTS:
        if not all_off[cost]:
            continue
        off = np.concatenate(all_off[cost])
        rows += [
            {"what": "mean distance from the true centreline", "case": cost, "figure": float(off.mean()), "unit": "mm"},
            {"what": "largest distance", "case": cost, "figure": float(off.max()), "unit": "mm"},
            {"what": "share of the points in the true lumen", "case": cost, "figure": float(np.mean(all_inside[cost]))},
        ]
    return rows


def _paths(made: Phantom, cost: str) -> list[Points]:
    """Return the paths (n, 3), LPS mm, to the segments of a phantom."""
    branches = {branch["name"]: np.array(branch["points"]) for branch in made.truth["branches"] if branch["name"]}
    targets = [branches[name][min(4, len(branches[name]) - 1)] for name in SEGMENTS if name in branches]
    trachea = branches["Trachea"]
    airways = find_airways(made.volume, progress=False) if cost == "lumen" else None
    found = track_on_graph(made.volume, airways, targets, cost=cost, graph="voxel", root_lps=trachea[len(trachea) // 2])
    return [one.path.points_lps for one in found.targets if one.path is not None]


def _compared(made: Phantom, paths: list[Points]) -> tuple[Points, NDArray[np.bool_]]:
    """Return the distance of each path point from the true centrelines, mm, and whether it is in the true lumen."""
    lines = np.concatenate([_along(np.array(branch["points"])) for branch in made.truth["branches"]])
    points = np.concatenate(paths)
    off = np.array([np.linalg.norm(lines - point, axis=1).min() for point in points])
    shape = np.array(made.lumen_zyx.shape[::-1])
    i, j, k = np.clip(np.rint(made.volume.to_ijk(points)).astype(int), 0, shape - 1).T
    return off, made.lumen_zyx[k, j, i] > 0


def _along(points: Points) -> Points:
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    places = np.linspace(0.0, along[-1], max(int(along[-1] / STEP_MM), 1) + 1)
    return np.stack([np.interp(places, along, points[:, axis]) for axis in range(3)], axis=1)
