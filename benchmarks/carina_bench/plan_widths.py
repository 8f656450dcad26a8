"""``python -m carina_bench.plan_widths``: narrowest diameters of routes compared with those of painted airways.

A route leads from the trachea to the end of a branch that was found. Its true narrowest diameter is the diameter of the
largest ball that passes through the painted lumens (:mod:`carina_bench.true_passage`), at least that of the widest tube
at each point. Routes that leave the true lumen are omitted. By kernel and slices, four diameters are compared with the
true one:

- *sections*: the narrowest diameter that a plan states (:mod:`carina.plan.routes.route_width`), if sections were
  measured along the whole route;
- *partly ball*: the narrowest diameter that a plan states, if a stretch without sections is part of the route;
- *single sections*: the least diameter of single sections, without the median over neighbouring ones, which removes
  noise;
- *ball*: the diameter of the largest ball in the found lumen, with the error that plans stated before decision 0130.

*Bias* is the median relative error, *coverage* the share of routes whose true diameter lies within the stated error,
*too wide* the share of routes whose true diameter lies below the stated range.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.plan.routes.clearance import ball_diameters_mm
from carina.plan.routes.route_width import widths_on_the_way
from carina.track import AirwayTree, TreeMeasures, find_airways, measure_tree, wall_field
from carina.track.measures import diameter
from carina_bench.track_diameter_cases import KERNEL_NAMES, DiameterCase, painted_patients, painted_phantoms
from carina_bench.true_passage import largest_balls_mm, lumen_wall, widest_tubes_mm

__all__ = ["ComparedRoute", "compared_routes", "rows_of", "run"]

Row = dict[str, Any]
Say = Callable[[str], None]
Floats = NDArray[np.float64]

SEEDS = range(101, 105)
"""Seeds of the painted phantoms whose routes are compared."""
PATIENTS = ("Patient1", "Patient2", "Patient3", "lobes-Patient1", "lobes-Patient2")
"""Names of the patients whose painted CTs are compared."""
KERNELS = ("medium", "sharp")
"""Names of the kernels with which the CTs are painted."""
SLICES = ("0.7mm", "1.5mm", "3mm")
"""Names of the slice thicknesses with which the CTs are painted."""
MOST_OUTSIDE = 0.1
"""Largest share of a route's points, without those in the trachea, that may be outside the true lumen."""
FORMER_SHARE, FORMER_SIGMA_MM = 0.2, 0.15
"""Standard deviations that plans used before decision 0130.

The first is that of the largest ball, as a share of the coarsest spacing; the second is that of a scope's size, mm.
"""
LEAST_COVERAGE, MOST_COVERAGE, MOST_BIAS = 0.85, 0.95, 3.0
"""Limits of the coverage, as shares, and of the bias, in %."""


@dataclass(frozen=True, slots=True)
class ComparedRoute:
    """True narrowest diameter of one route, and the diameters that are compared with it, mm."""

    subject: str
    condition: str
    true_mm: float
    stated_mm: float
    error_mm: float
    by_ball: bool
    single_mm: float
    ball_mm: float
    ball_error_mm: float


def compared_routes(
    case: DiameterCase, tree: AirwayTree, measures: TreeMeasures, wall_of_lumen: Any
) -> list[ComparedRoute]:
    """Return the routes from the trachea to the ends of all branches, if they stay in the true lumen."""
    spacing = float(max(case.volume.spacing_mm))
    widths = widths_on_the_way(tree, wall_of_lumen, measures, spacing)
    with patch.object(diameter, "NARROW_REACH_DIAMETERS", 0.0):
        singles = widths_on_the_way(tree, wall_of_lumen, measures, spacing)
    surface = lumen_wall(case.truth.branches)
    true: dict[int, Floats] = {}
    balls: dict[int, float] = {}
    for branch in tree.branches:
        tubes = widest_tubes_mm(branch.points, case.truth.branches)
        passing = largest_balls_mm(branch.points, surface)
        true[branch.id] = np.where(np.isfinite(tubes), np.fmax(tubes, passing), np.nan)
        balls[branch.id] = float(ball_diameters_mm(branch, wall_of_lumen).min())
    found = []
    for branch in tree.branches:
        if branch.parent is None:
            continue
        lineage = [one.id for one in tree.lineage(branch.id)][1:]
        way = np.concatenate([true[n] for n in lineage])
        if not np.isfinite(way[-1]) or np.isnan(way).mean() > MOST_OUTSIDE:
            continue
        width = widths[branch.id][-1]
        found.append(
            ComparedRoute(
                case.subject,
                case.condition,
                float(np.nanmin(way)),
                width.mm,
                width.error_mm,
                width.source == "ball",
                singles[branch.id][-1].mm,
                min(balls[n] for n in lineage),
                1.645 * math.hypot(FORMER_SHARE * spacing, FORMER_SIGMA_MM),
            )
        )
    return found


def rows_of(subjects: str, routes: Sequence[ComparedRoute]) -> list[Row]:
    """Return bias, coverage and the share of too wide diameters of routes, one row for each measure and condition."""
    true = np.array([one.true_mm for one in routes])
    stated = np.array([one.stated_mm for one in routes])
    error = np.array([one.error_mm for one in routes])
    by_ball = np.array([one.by_ball for one in routes], dtype=np.bool_)
    ball = np.array([one.ball_mm for one in routes])
    ball_error = np.array([one.ball_error_mm for one in routes])
    section = np.array([one.single_mm for one in routes])
    rows = []
    for measure, value, within, which in (
        ("sections", stated, error, ~by_ball),
        ("partly ball", stated, error, by_ball),
        ("all", stated, error, np.ones(len(true), np.bool_)),
        ("single sections", section, error, ~by_ball),
        ("ball", ball, ball_error, np.ones(len(true), np.bool_)),
    ):
        if which.any():
            off = value[which] - true[which]
            rows.append(
                {
                    "measure": measure,
                    "case": subjects,
                    "routes": int(which.sum()),
                    "bias": float(np.median(100.0 * off / true[which])),
                    "bias_mm": float(np.median(off)),
                    "error": float(np.median(100.0 * within[which] / true[which])),
                    "coverage": float((np.abs(off) <= within[which]).mean()),
                    "too_wide": float((off > within[which]).mean()),
                }
            )
    return rows


def run(
    say: Say,
    *,
    seeds: Sequence[int] = SEEDS,
    patients: Sequence[str] = (),
    kernels: Sequence[str] = KERNELS,
    slices: Sequence[str] = SLICES,
) -> list[Row]:
    """Return the rows of painted phantoms, and those of painted patients whose masks are available."""
    rows: list[Row] = []
    groups: list[tuple[str, Iterator[DiameterCase]]] = []
    if seeds:
        groups.append(("phantoms", painted_phantoms(seeds, kernels, slices, say)))
    data = load_settings().data_dir
    if patients and data is not None:
        groups.append(("patients", painted_patients(data, patients, kernels, slices, say)))
    for subjects, cases in groups:
        routes: list[ComparedRoute] = []
        for case in cases:
            airways = find_airways(case.volume, progress=False)
            measures = measure_tree(case.volume, airways)
            own = compared_routes(case, airways.tree, measures, wall_field(case.volume, airways))
            say(f"{case.subject} {case.condition}: {len(own)} routes")
            routes += own
        for condition in dict.fromkeys(one.condition for one in routes):
            rows += rows_of(f"{subjects}, {condition}", [one for one in routes if one.condition == condition])
        rows += rows_of(f"{subjects}, all", routes)
    return rows


def main() -> None:
    """Run the command line: compare the routes of all cases and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="One phantom, one kernel.")
    parser.add_argument("--patients", action="store_true", help="Painted patients, too (CARINA_DATA_DIR).")
    parser.add_argument("--kernels", nargs="*", choices=KERNEL_NAMES, default=list(KERNELS))
    parser.add_argument("--json", type=Path, help="A file for the rows.")
    options = parser.parse_args()
    rows = run(
        print,
        seeds=SEEDS[:1] if options.quick else SEEDS,
        patients=PATIENTS if options.patients else (),
        kernels=options.kernels[:1] if options.quick else options.kernels,
    )
    for row in rows:
        met = LEAST_COVERAGE <= row["coverage"] <= MOST_COVERAGE and abs(row["bias"]) <= MOST_BIAS
        print(
            f"{row['case']:28} {row['measure']:14} {row['routes']:5} routes  bias {row['bias']:+5.1f} % "
            f"({row['bias_mm']:+.2f} mm)  error {row['error']:4.1f} %  coverage {row['coverage']:.2f}  "
            f"too wide {row['too_wide']:.2f}{'' if met else '  (outside)'}"
        )
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
