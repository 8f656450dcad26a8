"""``carina bench track --only measures``: measured sections, forks and stenosis compared with phantoms' exact values.

The diameter of a section is compared with the true diameter at the nearest point of a true axis. Lengths and angles are
compared branch by branch; angles have the same definition on the true tree. *Coverage* is the share of sections whose
true value lies within the stated error, which is intended to hold for 95 %.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.phantom import Phantom, generate_phantom
from carina.track import AirwayTree, Branch, TreeMeasures, find_airways, measure_tree
from carina.track.measures.forks import angle_deg, run_mm

__all__ = ["Truth", "compared", "run"]

Row = dict[str, Any]
Floats = NDArray[np.float64]

SEEDS = range(1, 5)
"""Seeds of the phantoms that are measured."""
QUICK_SEEDS = range(1, 2)
"""Seeds of the phantoms in a quick run."""
SPACING_MM, NOISE_HU = 0.7, 25.0
"""Spacing (mm) and standard deviation of the noise (HU) of the phantoms."""
QUICK_SPACING_MM = 1.2
"""Spacing of the phantoms in a quick run, mm."""
SIZES_VOX = ((3, 4), (4, 6), (6, 10), (10, 99))
"""Classes of lumen diameter (lower and upper limit), voxels."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """True axes of a phantom's airways as one array of points, 0.25 mm apart."""

    tree: AirwayTree
    points: Floats
    radius: Floats
    wall: Floats
    branch: NDArray[np.int64]

    @classmethod
    def of(cls, phantom: Phantom) -> Truth:
        """Return the true axes of a phantom."""
        tree = AirwayTree.from_json(phantom.truth)
        walls = {row["id"]: float(row["wall_mm"]) for row in phantom.truth["branches"]}
        columns: list[list[Floats]] = [[], [], [], []]
        for branch in tree.branches:
            along = run_mm(branch.points)
            at = np.linspace(0.0, along[-1], max(2, int(along[-1] / 0.25)))
            columns[0].append(np.stack([np.interp(at, along, branch.points[:, a]) for a in range(3)], axis=1))
            columns[1].append(np.interp(at, along, branch.radius))
            columns[2].append(np.full(len(at), walls[branch.id]))
            columns[3].append(np.full(len(at), float(branch.id)))
        points, radius, wall, branch_of = (np.concatenate(column) for column in columns)
        return cls(tree, points, radius, wall, branch_of.astype(np.int64))

    def nearest(self, points: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Return each point's distance (n,) from the true axes, and the index (n,) of the nearest point of an axis."""
        away, which = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        for begin in range(0, len(points), 256):
            part = points[begin : begin + 256]
            squared = np.square(part[:, None] - self.points[None]).sum(axis=2)
            which[begin : begin + 256] = squared.argmin(axis=1)
            away[begin : begin + 256] = np.sqrt(squared.min(axis=1))
        return away, which

    def branch_along(self, branch: Branch) -> int | None:
        """Return the index of the true branch along which most of the middle half of a found branch runs.

        The result is None if there is no such branch.
        """
        count = len(branch.points)
        _, which = self.nearest(branch.points[count // 4 : max(count // 4 + 1, 3 * count // 4 + 1)])
        return Counter(self.branch[which].tolist()).most_common(1)[0][0] if count else None


def run(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the report's rows for diameters, lengths, angles and stenosis (see ``carina_bench.track``)."""
    seeds, spacing = (QUICK_SEEDS, QUICK_SPACING_MM) if quick else (SEEDS, SPACING_MM)
    found: dict[str, list[Floats]] = {}
    seconds, edits, num_sections = [], [], 0
    for seed in seeds:
        say(f"measures: phantom {seed}")
        phantom = generate_phantom(seed=seed, spacing_mm=spacing, noise_hu=NOISE_HU, stenosis=True)
        airways = find_airways(phantom.volume)
        began = time.process_time()
        measures = measure_tree(phantom.volume, airways)
        seconds.append(time.process_time() - began)
        began = time.process_time()
        measure_tree(phantom.volume, airways, previous=measures)
        edits.append(time.process_time() - began)
        num_sections += sum(len(branch.at_mm) for branch in measures.branches)
        for name, values in compared(phantom, airways.tree, measures).items():
            found.setdefault(name, []).append(values)
    columns = {name: np.concatenate(parts) for name, parts in found.items()}
    case = f"{len(seeds)} phantoms, {spacing} mm, {NOISE_HU:g} HU"
    return [
        *_tree_rows(columns, case, spacing),
        *_section_rows(columns, case, spacing),
        {"what": "CPU time to measure a whole tree", "case": case, "figure": max(seconds), "unit": "s"},
        {
            "what": "CPU time to measure again what an edit left as it was",
            "case": case,
            "figure": max(edits),
            "unit": "s",
            "limit": 0.5,
            "better": "lower",
            "aim": True,
        },
        {"what": "sections", "case": case, "figure": num_sections},
    ]


def compared(phantom: Phantom, tree: AirwayTree, measures: TreeMeasures) -> dict[str, Floats]:
    """Return measured and true values of sections and branches as arrays by name; lengths in mm, angles in degrees."""
    truth = Truth.of(phantom)
    along: dict[int, int | None] = {branch.id: truth.branch_along(branch) for branch in tree.branches}
    times = Counter(along.values())
    points = np.concatenate([branch.points for branch in tree.branches])
    radius = np.concatenate([branch.radius for branch in tree.branches])
    away, which = truth.nearest(points)
    columns: dict[str, list[float]] = {name: [] for name in ("length_off", "angle_off", "fork_off")}
    sections: list[Floats] = []
    by_id = {branch.id: branch for branch in tree.branches}
    for branch in tree.branches:
        own = measures.of(branch.id)
        usable = own.is_usable
        _, near = truth.nearest(own.centre_lps[usable])
        sections.append(
            np.stack(
                [
                    2.0 * truth.radius[near],
                    own.equivalent_mm[usable],
                    own.equivalent_error_mm[usable],
                    truth.wall[near],
                    own.wall_mm[usable],
                    own.wall_error_mm[usable],
                ],
                axis=1,
            )
        )
        true_id = along[branch.id]
        if true_id is None or times[true_id] != 1:
            continue
        true = truth.tree.branch(true_id)
        if branch.children and true.children:
            columns["length_off"].append(branch.length_mm - true.length_mm)
            columns["fork_off"].append(float(np.linalg.norm(branch.points[-1] - true.points[-1]) / true.radius[-1]))
        parent = None if branch.parent is None else by_id[branch.parent]
        if parent is not None and true.parent is not None and along[parent.id] == true.parent:
            one, other = angle_deg(parent, branch), angle_deg(truth.tree.branch(true.parent), true)
            if one is not None and other is not None:
                columns["angle_off"].append(one - other)
    result: dict[str, Floats] = {name: np.array(values) for name, values in columns.items()}
    result["away"], result["radius_true"] = away, truth.radius[which]
    result["radius_off"] = radius - truth.radius[which]
    result["sections"] = np.concatenate(sections)
    ids = set(truth.branch.tolist())
    result["extra"] = np.array([float(sum(number - 1 for number in times.values()))])
    result["missing"] = np.array([float(sum(times[i] == 0 for i in ids))])
    stenosis = phantom.truth.get("stenosis")
    if stenosis is not None:
        branch, _, _ = tree.nearest_branch(stenosis["centre_lps"])
        reported = measures.of(branch.id).summary.stenosis
        true_percent = 100.0 * (1.0 - stenosis["min_radius_mm"] / stenosis["reference_radius_mm"])
        result["stenosis_off"] = np.array([np.nan if reported is None else reported.percent - true_percent])
        result["stenosis_error"] = np.array([np.nan if reported is None else reported.percent_error])
        others = [one for one in measures.branches if one.branch_id != branch.id]
        result["stenosis_false"] = np.array([float(one.summary.stenosis is not None) for one in others])
    return result


def _tree_rows(columns: dict[str, Floats], case: str, spacing: float) -> list[Row]:
    wide = columns["radius_true"] >= 1.5 * spacing
    radius = np.abs(columns["radius_off"][wide])

    def least(what: str, figure: float, unit: str, limit: float | None = None) -> Row:
        return {"what": what, "case": case, "figure": figure, "unit": unit, "limit": limit, "better": "lower"}

    return [
        least("mean distance of centrelines from the true axes", float(columns["away"].mean()) / spacing, "voxel", 0.5),
        least("mean error of the radius, lumens of 3 voxels or more", float(radius.mean()) / spacing, "voxel", 0.3),
        {
            "what": "radius bias, lumens of 3 voxels or more",
            "case": case,
            "figure": float(columns["radius_off"][wide].mean()) / spacing,
            "unit": "voxel",
        },
        least("branches that are none, in all", float(columns["extra"].sum()), ""),
        least("true branches without a found one, in all", float(columns["missing"].sum()), ""),
        least("median distance of forks from the true ones", float(np.median(columns["fork_off"])), "radii"),
        least("median error of a length between two forks", float(np.median(np.abs(columns["length_off"]))), "mm"),
        least("median error of an angle to the parent", float(np.median(np.abs(columns["angle_off"]))), "deg"),
        least("largest error of a stenosis", float(np.nanmax(np.abs(columns["stenosis_off"]))), "percent", 10.0),
        {
            "what": "stenosis: coverage",
            "case": case,
            "figure": float((np.abs(columns["stenosis_off"]) <= columns["stenosis_error"]).mean()),
            "limit": 0.9,
            "aim": True,
        },
        least("healthy branches with a stenosis", float(columns["stenosis_false"].mean()), "", 0.025),
    ]


def _section_rows(columns: dict[str, Floats], case: str, spacing: float) -> list[Row]:
    rows: list[Row] = []
    true, found, error, wall, wall_found, wall_error = columns["sections"].T
    for low, high in SIZES_VOX:
        size = (true >= low * spacing) & (true < high * spacing)
        walls = size & np.isfinite(wall_found)
        if size.sum() < 10:
            continue
        name = f"lumens of {low} to {high} voxels"
        off, wall_off = (found - true)[size], (wall_found - wall)[walls]
        rows += [
            {
                "what": f"diameter, {name}: mean error",
                "case": case,
                "figure": float(off.mean()),
                "unit": "mm",
                "mean_absolute": float(np.abs(off).mean()),
                "sections": int(size.sum()),
            },
            {
                "what": f"diameter, {name}: coverage",
                "case": case,
                "figure": float((np.abs(off) <= error[size]).mean()),
                "limit": 0.9,
                "aim": True,
            },
        ]
        if walls.sum() >= 10:
            rows += [
                {
                    "what": f"wall, {name}: median error",
                    "case": case,
                    "figure": float(np.median(wall_off)),
                    "unit": "mm",
                },
                {
                    "what": f"wall, {name}: coverage",
                    "case": case,
                    "figure": float((np.abs(wall_off) <= wall_error[walls]).mean()),
                    "limit": 0.9,
                    "aim": True,
                },
            ]
    return rows
