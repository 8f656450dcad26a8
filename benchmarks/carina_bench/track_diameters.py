"""``carina bench track --only diameters``: measured diameters of branches and routes compared with the true ones.

Each branch that was found is compared with the nearest true axis. Its figures are the median of the true diameters at
its usable sections, the measured diameter, the stated error, and the diameter of the found lumen (``Branch.radius``).
*Bias* is the median relative error; *coverage* is the share of branches whose true diameter lies within the stated
error. A route is the path from the trachea to a tip; its true narrowest diameter is the least true diameter at its
usable sections.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.errors import NoResultError
from carina.track import AirwayTree, TreeMeasures, find_airways, measure_tree
from carina.track.measures.diameter import branch_diameter, narrowest_diameter
from carina_bench.track_diameter_cases import (
    KERNEL_NAMES,
    SLICE_NAMES,
    DiameterCase,
    painted_patients,
    painted_phantoms,
)

__all__ = ["Compared", "compared_diameters", "run"]

Row = dict[str, Any]
Say = Callable[[str], None]
Floats = NDArray[np.float64]

SEEDS = range(101, 121)
"""Seeds of the painted phantoms whose diameters are compared."""
QUICK_SEEDS = range(101, 102)
"""Seeds of the painted phantoms in a quick run."""
PATIENTS = ("Patient1", "Patient2", "lobes-Patient1", "lobes-Patient2")
"""Names of the patients whose painted CTs are compared."""
SIZES_MM = (0.0, 1.6, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 30.0)
"""Borders in mm of the classes of true diameter in the report."""
SIZES_VOX = (0.0, 3.0, 4.0, 6.0, 10.0, 99.0)
"""Borders in voxels of the classes of true diameter in the report."""
MIN_IN_CLASS = 8
"""Minimum number of branches or routes of a class that the report contains."""
MIN_SECTIONS = 3
"""Minimum number of usable sections of a branch that is compared."""
MAX_BIAS = 3.0
"""Maximum accepted mean error of a class of diameters, %."""
MIN_COVERAGE, MAX_COVERAGE = 0.85, 0.95
"""Minimum and maximum accepted share of true diameters inside the stated interval, in a class."""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """Diameters of the branches and routes of one case, mm.

    The columns are the true diameter, the measured diameter, the stated error, and the diameter of the found lumen.
    """

    branches: Floats
    """(n, 4) diameters of the branches, mm."""
    routes: Floats
    """(m, 4) narrowest diameters of the routes to the tips, mm."""


def run(quick: bool, say: Say, cases: Sequence[str] = ()) -> list[Row]:
    """Return bias and coverage by kernel, slices and size; ``cases`` selects cases (see ``carina_bench.track``)."""
    kernels = [name for name in KERNEL_NAMES if name in cases] or list(KERNEL_NAMES[1:2] if quick else KERNEL_NAMES)
    slices = [name for name in SLICE_NAMES if name in cases] or list(SLICE_NAMES[:1] if quick else SLICE_NAMES)
    patients = [name for name in PATIENTS if name in cases]
    rows: list[Row] = []
    if not patients or "phantoms" in cases:
        seeds = QUICK_SEEDS if quick else SEEDS
        rows += _rows("phantoms", painted_phantoms(seeds, kernels, slices, say), say)
    if patients or (not quick and "phantoms" not in cases):
        data = load_settings().data_dir
        if data is None or not data.is_dir():
            raise NoResultError("no masks to paint CTs from: CARINA_DATA_DIR names no folder")
        rows += _rows("patients", painted_patients(data, patients or PATIENTS, kernels, slices, say), say)
    return rows


def compared_diameters(case: DiameterCase, tree: AirwayTree, measures: TreeMeasures) -> Compared:
    """Return the measured diameters of the branches and routes of a tree beside the true ones."""
    points = np.concatenate([branch.points for branch in case.truth.branches])
    radius = np.concatenate([branch.radius_mm for branch in case.truth.branches])
    course = np.concatenate([np.gradient(branch.points, axis=0) for branch in case.truth.branches])
    course /= np.maximum(np.linalg.norm(course, axis=1, keepdims=True), 1e-9)
    whole: list[list[float]] = []
    narrowest: dict[int, list[float]] = {}
    for branch in tree.branches:
        own = measures.of(branch.id)
        used = np.flatnonzero(own.is_usable)
        if not len(used):
            continue
        near, away = _nearest(points, own.centre_lps[used])
        along = np.abs((own.normal_lps[used] * course[near]).sum(axis=1))
        is_same = (away < 0.8 * radius[near]) & (along > 0.8)
        used, true = used[is_same], 2.0 * radius[near[is_same]]
        if len(used) < MIN_SECTIONS:
            continue
        columns = (own.at_mm[used], own.equivalent_mm[used], own.equivalent_error_mm[used])
        found = 2.0 * branch.radius[used]
        middle, least = branch_diameter(*columns), narrowest_diameter(*columns)
        assert middle is not None and least is not None
        whole.append([float(np.median(true)), middle.mm, middle.error_mm, float(np.median(found))])
        narrowest[branch.id] = [float(true.min()), least.mm, least.error_mm, float(found.min())]
    routes = [_narrowest_of_route(tree, tip.id, narrowest) for tip in tree.tips()]
    return Compared(
        np.array(whole).reshape(-1, 4), np.array([route for route in routes if route is not None]).reshape(-1, 4)
    )


def _nearest(points: Floats, places: Floats) -> tuple[NDArray[np.int64], Floats]:
    nearest, away = np.empty(len(places), dtype=np.int64), np.empty(len(places))
    for begin in range(0, len(places), 64):
        part = places[begin : begin + 64]
        squared = np.square(part[:, None] - points[None]).sum(axis=2)
        nearest[begin : begin + 64] = squared.argmin(axis=1)
        away[begin : begin + 64] = np.sqrt(squared.min(axis=1))
    return nearest, away


def _narrowest_of_route(tree: AirwayTree, tip: int, narrowest: dict[int, list[float]]) -> list[float] | None:
    way = []
    branch_id: int | None = tip
    while branch_id is not None:
        way.append(branch_id)
        branch_id = tree.branch(branch_id).parent
    known = [narrowest[branch] for branch in way if branch in narrowest]
    if not known:
        return None
    reported = min(known, key=lambda row: row[1])
    return [min(row[0] for row in known), reported[1], reported[2], min(row[3] for row in known)]


def _rows(subjects: str, cases: Iterator[DiameterCase], say: Say) -> list[Row]:
    found: dict[str, list[tuple[Compared, float]]] = {}
    for case in cases:
        airways = find_airways(case.volume, progress=False)
        one = compared_diameters(case, airways.tree, measure_tree(case.volume, airways))
        found.setdefault(case.condition, []).append((one, float(min(case.volume.spacing_mm))))
        say(f"{case.subject} {case.condition}: {len(one.branches)} branches")
    rows: list[Row] = []
    for condition, parts in found.items():
        name = f"{subjects}, {condition}"
        branches = np.concatenate([one.branches for one, _ in parts])
        voxels = np.concatenate([one.branches[:, 0] / voxel for one, voxel in parts])
        rows += _judged("diameters of branches", name, branches)
        rows += _judged("narrowest diameters of routes", name, np.concatenate([one.routes for one, _ in parts]))
        for unit, sizes, limits in (("mm", branches[:, 0], SIZES_MM), ("voxels", voxels, SIZES_VOX)):
            for low, high in pairwise(limits):
                part = branches[(sizes >= low) & (sizes < high)]
                if len(part) >= MIN_IN_CLASS:
                    rows += _judged(f"diameters of {low:g} to {high:g} {unit}", name, part)
    return rows


def _judged(what: str, name: str, table: Floats) -> list[Row]:
    if not len(table):
        return []
    true, reported, error, lumen = table.T
    relative = 100.0 * (reported / true - 1.0)
    inside = float((np.abs(reported - true) <= error).mean())
    bias = float(np.median(relative))
    note = (
        f"{len(true)}; scatter {relative.std():.1f} %, stated error {100.0 * np.median(error / true):.1f} %; "
        f"lumen found: bias {100.0 * np.median(lumen / true - 1.0):+.1f} %, "
        f"{100.0 * (np.abs(lumen - true) <= error).mean():.0f} % inside that error"
    )
    return [
        {
            "what": f"{what}: bias",
            "case": name,
            "figure": bias,
            "size": abs(bias),
            "unit": "%",
            "met": abs(bias) <= MAX_BIAS,
            "note": note,
        },
        {
            "what": f"{what}: coverage",
            "case": name,
            "figure": inside,
            "limit": MIN_COVERAGE,
            "most": MAX_COVERAGE,
            "aim": True,
        },
    ]
