"""Comparison of the published predictors of routes with a second calculation from their definitions.

``python -m carina_bench.plan_predictors FOLDER [CASE ...] [--ct NAME=PATH ...]`` measures the route to every tip: cases
as in ``plan_hours`` and CTs, whose airways are found and stored in FOLDER. The second calculation uses the points,
radii and measured diameters of the same tree, and no code of the product. Where the true tree is known, the
bifurcation angle is also compared with that of the true branches.

Definitions (``docs/contracts.md``): the angle is that between the chords of two diameters on both sides of the last
fork of the route; the curvature is the sum of the turns of chords of 6 mm along the last 20 mm, divided by their
length; the least diameter is the narrowest known diameter of the last 20 mm, including the first one beyond their end.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import pickle
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.plan import route_predictors
from carina.track import Airways, AirwayTree, Branch, TreeMeasures, find_airways, measure_tree
from carina.volume import Volume, open_volume
from carina_bench.plan_cases import TrueTree
from carina_bench.plan_hours import case_of, true_branch

__all__ = ["angle_by_definition", "curvature_by_definition", "least_by_definition", "predictor_rows", "summary"]

Points = NDArray[np.float64]
Row = dict[str, Any]
Say = Callable[[str], None]

SECTION_MM, CHORD_MM = 20.0, 3.0
FINE_MM = 0.02
"""Distance in mm between the points of a centreline that the comparison calculation uses."""
TURN_STEP_MM = 0.1
LIMITS = {"bifurcation_deg": 1.0, "least_mm": 0.1, "curvature_per_mm": 0.005}
"""Maximum differences between Carina's predictors and a calculation from their definitions, by predictor."""


def walked(points: Points, from_mm: float, to_mm: float) -> Points:
    """Return points every 0.02 mm of a polyline between two distances, by a walk along its segments."""
    found, before_mm = [], 0.0
    wanted = np.arange(from_mm, to_mm + 1e-9, FINE_MM)
    for start, end in itertools.pairwise(points):
        length = math.dist(start, end)
        own = wanted[(wanted >= before_mm) & (wanted < before_mm + length)]
        found.append(start + np.outer((own - before_mm) / max(length, 1e-12), end - start))
        before_mm += length
    return np.concatenate([*found, points[-1:]]) if to_mm >= before_mm else np.concatenate(found)


def length_mm(points: Points) -> float:
    """Return the length of a polyline in mm."""
    return sum(math.dist(start, end) for start, end in itertools.pairwise(points))


def _between_deg(one: Points, other: Points) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other)))


def angle_by_definition(tree: AirwayTree, branch_id: int) -> float | None:
    """Return the angle in degrees between the chords of two diameters before and after the last fork of a route."""
    lineage = _lineage(tree, branch_id)
    last = next((n for n in range(len(lineage) - 1, 0, -1) if len(lineage[n - 1].children) > 1), None)
    if last is None:
        return None
    ahead = []
    for branch, at_end in ((lineage[last - 1], True), (lineage[last], False)):
        diameter = 2.0 * float(np.median(branch.radius))
        whole = length_mm(branch.points)
        reach = min(2.0 * diameter, whole)
        part = walked(branch.points, whole - reach, whole) if at_end else walked(branch.points, 0.0, reach)
        ahead.append(part[-1] - part[0])
    return _between_deg(*ahead)


def curvature_by_definition(tree: AirwayTree, branch_id: int, along_mm: float) -> float | None:
    """Return the turns of the chords of 6 mm along the last 20 mm, in steps of 0.1 mm, divided by the length."""
    lineage = _lineage(tree, branch_id)
    points = np.concatenate([lineage[0].points, *(branch.points[1:] for branch in lineage[1:])])
    low = max(along_mm - SECTION_MM, 0.0, CHORD_MM)
    high = min(along_mm, length_mm(points) - CHORD_MM)
    if high - low < 2.0 * CHORD_MM:
        return None
    fine = walked(points, low - CHORD_MM, high + CHORD_MM)
    apart, step = round(2.0 * CHORD_MM / FINE_MM), round(TURN_STEP_MM / FINE_MM)
    chords = (fine[apart:] - fine[:-apart])[::step]
    turns = [_between_deg(one, other) for one, other in itertools.pairwise(chords)]
    return math.radians(sum(turns)) / (high - low)


def least_by_definition(tree: AirwayTree, branch_id: int, along_mm: float, measures: TreeMeasures) -> float | None:
    """Return the narrowest measured diameter of the last 20 mm in mm; None if a part could not be measured."""
    begins_mm, inside, before, beyond = 0.0, [], None, None
    for branch in _lineage(tree, branch_id):
        passage = measures.passage(branch.id)
        if len(passage.unmeasured):
            return None
        for at_mm, mm in zip(passage.at_mm.tolist(), passage.diameter_mm.tolist(), strict=True):
            place = begins_mm + at_mm
            if place < along_mm - SECTION_MM:
                before = mm
            elif place < along_mm - 1e-6:
                inside.append(mm)
            elif beyond is None:
                beyond = mm
        begins_mm += length_mm(branch.points)
    found = [*inside, *([] if beyond is None else [beyond])]
    return min(found) if found else before


def _lineage(tree: AirwayTree, branch_id: int) -> list[Branch]:
    by_id = {branch.id: branch for branch in tree.branches}
    found = [by_id[branch_id]]
    while (parent := found[0].parent) is not None:
        found.insert(0, by_id[parent])
    return found


def predictor_rows(
    tree: AirwayTree, measures: TreeMeasures, spacing_mm: float, truth: TrueTree | None = None
) -> Iterator[Row]:
    """Yield a row for two places in each tip branch: predictors, their values by definition, true angle if known."""
    for branch in tree.branches:
        if branch.children or branch.parent is None:
            continue
        before = sum(length_mm(one.points) for one in _lineage(tree, branch.id)[:-1])
        for share in (0.4, 1.0):
            along = before + share * length_mm(branch.points)
            found = route_predictors(tree, branch.id, along, measures=measures, spacing_mm=spacing_mm)
            yield {
                "branch": branch.name or f"branch {branch.id}",
                "along_mm": along,
                "source": found.width.source,
                "bifurcation_deg": [found.bifurcation_deg, angle_by_definition(tree, branch.id)],
                "least_mm": [found.width.mm, least_by_definition(tree, branch.id, along, measures)],
                "curvature_per_mm": [found.curvature_per_mm, curvature_by_definition(tree, branch.id, along)],
                "true": None if truth is None or share < 1.0 else _true_angles(tree, truth, branch),
            }


def _true_angles(tree: AirwayTree, truth: TrueTree, branch: Branch) -> Row | None:
    """Return the true angle of a fork, two mixed angles of a found and a true chord, and the distance of both forks.

    ``parent_deg`` has the found parent's chord, ``child_deg`` the found child's. None without a true fork.
    """
    lineage = _lineage(tree, branch.id)
    number = next((n for n in range(len(lineage) - 1, 0, -1) if len(lineage[n - 1].children) > 1), None)
    if number is None:
        return None
    parent, child = lineage[number - 1], lineage[number]
    own = true_branch(truth, tree, child)
    true_parent = truth.parents[own]
    if true_parent < 0 or true_parent != true_branch(truth, tree, parent):
        return None
    lines = {n: truth.points[truth.branch == n] for n in (own, true_parent)}
    radii = {n: truth.radius_mm[truth.branch == n] for n in (own, true_parent)}
    ends = {}
    for key, line, radius in (
        ("found", (parent.points, child.points), (parent.radius, child.radius)),
        ("true", (lines[true_parent], lines[own]), (radii[true_parent], radii[own])),
    ):
        reach = [min(4.0 * float(np.median(r)), length_mm(p)) for p, r in zip(line, radius, strict=True)]
        first, last = length_mm(line[0]) - reach[0], reach[1]
        before, after = walked(line[0], first, first + reach[0]), walked(line[1], 0.0, last)
        ends[key] = before[-1] - before[0], after[-1] - after[0]
    stub_share = length_mm(parent.points) / (4.0 * float(np.median(parent.radius)))
    return {
        "deg": _between_deg(*ends["true"]),
        "parent_deg": _between_deg(ends["found"][0], ends["true"][0]),
        "child_deg": _between_deg(ends["found"][1], ends["true"][1]),
        "fork_off_mm": float(np.linalg.norm(child.points[0] - lines[own][0])),
        "parent_stub": stub_share < 1.0,
    }


def summary(rows: Sequence[Row]) -> Row:
    """Return the number of compared values, the largest differences and how many exceed the limits."""
    result: Row = {"routes": len(rows)}
    for name, limit in LIMITS.items():
        pairs = [row[name] for row in rows if row[name][0] is not None and row[name][1] is not None]
        gaps = [abs(one - other) for one, other in pairs]
        result[name] = {
            "compared": len(gaps),
            "beyond": sum(gap > limit for gap in gaps),
            "worst": round(max(gaps, default=math.nan), 5),
            "one is None": sum((row[name][0] is None) != (row[name][1] is None) for row in rows),
        }
    true = [(row["bifurcation_deg"][0], row["true"]) for row in rows if row["true"] is not None]
    if true:
        errors = [abs(found - one["deg"]) for found, one in true]
        stubs = [error for error, (_, one) in zip(errors, true, strict=True) if one["parent_stub"]]
        result["angle against the true tree"] = {
            "compared": len(true),
            "median": round(float(np.median(errors)), 2),
            "90 %": round(float(np.quantile(errors, 0.9)), 2),
            "median off, parent's chord": round(float(np.median([one["parent_deg"] for _, one in true])), 2),
            "median off, child's chord": round(float(np.median([one["child_deg"] for _, one in true])), 2),
            "median off, fork, mm": round(float(np.median([one["fork_off_mm"] for _, one in true])), 2),
            "median where the parent is shorter than its chord": round(float(np.median(stubs)), 2) if stubs else None,
        }
    return result


def _found(folder: Path, name: str, path: str, say: Say) -> tuple[Volume, Airways]:
    """Return a CT with its airways, which are stored in a folder."""
    import carina

    volume = carina.demo_patient() if path == "bundled" else open_volume(path)
    stored = folder / f"{name}.airways.pickle"
    if stored.exists():
        airways: Airways = pickle.loads(stored.read_bytes())
        return volume, airways
    say(f"{name}: finding airways")
    airways = find_airways(volume, progress=False)
    folder.mkdir(parents=True, exist_ok=True)
    stored.write_bytes(pickle.dumps(airways))
    return volume, airways


def main() -> None:
    """Run the command line: compare the predictors with their values by definition, and print the differences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="Folder in which the CTs with their airways are stored.")
    parser.add_argument("cases", nargs="*", help="Cases, such as phantom-1.")
    parser.add_argument("--ct", nargs="*", default=[], help="CTs as NAME=PATH; the path may be bundled.")
    options = parser.parse_args()
    say: Say = partial(print, flush=True)
    everything: list[Row] = []
    for name in options.cases:
        case = case_of(options.folder, name)
        if case is None or case.airways is None:
            continue
        measures = measure_tree(case.volume, case.airways)
        rows = list(predictor_rows(case.airways.tree, measures, max(case.volume.spacing_mm), case.truth))
        say(f"{case.name}: {json.dumps(summary(rows))}")
        everything += rows
    for one in options.ct:
        name, _, path = one.partition("=")
        volume, airways = _found(options.folder, name, path, say)
        measures = measure_tree(volume, airways)
        rows = list(predictor_rows(airways.tree, measures, max(volume.spacing_mm)))
        say(f"{name}: {json.dumps(summary(rows))}")
        everything += rows
    say(f"all: {json.dumps(summary(everything))}")


if __name__ == "__main__":
    main()
