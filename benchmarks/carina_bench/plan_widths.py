"""``python -m carina_bench.plan_widths``: narrowest diameters of routes compared with those of painted airways.

A route leads from the trachea to a point at a third, two thirds or the end of a branch that was found. Its true
narrowest diameter is the diameter of the largest ball that passes through the painted lumens
(:mod:`carina_bench.true_narrowest_diameter`), at least that of the widest tube at each point. Routes that leave the
true lumen are omitted. Subjects are painted phantoms, painted patients, and the phantoms of `carina.generate_phantom`
(*generated*), whose walls are blurred as if they were flat. The constants of the error were fitted on ``FITTED``; the
other subjects only check the constants and have separate rows. By kernel and slices, four diameters are compared with
the true one:

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
from carina.phantom import generate_phantom
from carina.plan.routes.clearance import ball_diameters_mm
from carina.plan.routes.route_width import widths_on_the_way
from carina.track import AirwayTree, TreeMeasures, find_airways, measure_tree, wall_field
from carina.track.measures import diameter
from carina_bench.track_diameter_cases import (
    KERNEL_NAMES,
    SLICE_NAMES,
    DiameterCase,
    painted_patients,
    painted_phantoms,
)
from carina_bench.track_truth import truth_of_phantom
from carina_bench.true_narrowest_diameter import largest_balls_mm, lumen_wall, widest_tubes_mm

__all__ = ["ComparedRoute", "compared_routes", "generated_phantoms", "rows_by_condition", "rows_of", "run"]

Row = dict[str, Any]
Say = Callable[[str], None]
Floats = NDArray[np.float64]

SEEDS = (117, 201)
"""Seeds of the painted phantoms whose routes are compared."""
PATIENTS = ("Patient1", "Patient2", "Patient3", "lobes-Patient1", "lobes-Patient2", "lobes-Patient3")
"""Names of the patients whose painted CTs are compared."""
FITTED = frozenset(
    {"phantom 117", "phantom 201", "Patient1", "Patient2", "lobes-Patient2"} | {f"generated {n}" for n in (1, 2, 3, 5)}
)
"""Subjects on which the constants of the error in :mod:`carina.track.measures.diameter` were fitted."""
GENERATED = (1, 2, 3)
"""Seeds of the phantoms that Carina generates, whose routes are compared."""
SPACINGS_MM = {"1mm": (1.0, 1.0, 1.0), "1.5mm": (1.5, 1.5, 1.5), "2.5mm": (0.8, 0.8, 2.5)}
"""Spacings of the generated phantoms by their names."""
NOISE_HU = 25.0
"""Standard deviation of the noise of the generated phantoms, HU."""
KERNELS = ("medium", "sharp")
"""Names of the kernels with which the CTs are painted."""
SLICES = ("0.7mm", "1mm", "1.5mm", "2.5mm", "3mm")
"""Names of the slice thicknesses with which the CTs are painted."""
NUM_PER_BRANCH = 3
"""Number of compared routes that end in each branch."""
MAX_OUTSIDE = 0.1
"""Maximum share of a route's points, without those in the trachea, that may be outside the true lumen."""
FORMER_SHARE, FORMER_SIGMA_MM = 0.2, 0.15
"""Standard deviations of the diameter that plans assumed before decision 0130: share of the diameter, and mm.

The first is that of the largest ball, as a share of the coarsest spacing; the second is that of a scope's size, mm.
"""
MIN_COVERAGE, MAX_COVERAGE, MAX_BIAS = 0.85, 0.95, 3.0
"""Limits of the share of true diameters inside the stated interval, and of the bias in %."""


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
    """Return the routes from the trachea to three points of each branch, if they stay in the true lumen."""
    spacing = float(max(case.volume.spacing_mm))
    widths = widths_on_the_way(tree, wall_of_lumen, measures, spacing)
    with patch.object(diameter, "NARROW_REACH_DIAMETERS", 0.0):
        singles = widths_on_the_way(tree, wall_of_lumen, measures, spacing)
    surface = lumen_wall(case.truth.branches)
    true: dict[int, Floats] = {}
    balls: dict[int, Floats] = {}
    for branch in tree.branches:
        tubes = widest_tubes_mm(branch.points, case.truth.branches)
        passing = largest_balls_mm(branch.points, surface)
        true[branch.id] = np.where(np.isfinite(tubes), np.fmax(tubes, passing), np.nan)
        balls[branch.id] = ball_diameters_mm(branch, wall_of_lumen)
    found = []
    for branch in tree.branches:
        if branch.parent is None:
            continue
        before = [one.id for one in tree.lineage(branch.id)][1:-1]
        num = len(branch.points)
        for at in sorted({num * part // NUM_PER_BRANCH for part in range(1, NUM_PER_BRANCH)} | {num - 1}):
            way = np.concatenate([*(true[n] for n in before), true[branch.id][: at + 1]])
            if not np.isfinite(way[-1]) or np.isnan(way).mean() > MAX_OUTSIDE:
                continue
            width = widths[branch.id][at]
            found.append(
                ComparedRoute(
                    case.subject,
                    case.condition,
                    float(np.nanmin(way)),
                    width.mm,
                    width.error_mm,
                    width.source == "ball",
                    singles[branch.id][at].mm,
                    float(np.concatenate([*(balls[n] for n in before), balls[branch.id][: at + 1]]).min()),
                    1.645 * math.hypot(FORMER_SHARE * spacing, FORMER_SIGMA_MM),
                )
            )
    return found


def generated_phantoms(seeds: Sequence[int]) -> Iterator[DiameterCase]:
    """Yield generated phantoms with noise; a main airway has a stenosis if the seed is even."""
    for seed in seeds:
        for name, spacing_mm in SPACINGS_MM.items():
            made = generate_phantom(seed=seed, spacing_mm=spacing_mm, noise_hu=NOISE_HU, stenosis=seed % 2 == 0)
            truth = truth_of_phantom(made.truth, made.lumen_zyx, made.volume)
            yield DiameterCase(f"generated {seed}", "flat walls", name, made.volume, truth)


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
    generated: Sequence[int] = GENERATED,
    kernels: Sequence[str] = KERNELS,
    slices: Sequence[str] = SLICES,
) -> list[Row]:
    """Return the rows of painted and generated phantoms, and those of painted patients whose masks are available."""
    rows: list[Row] = []
    groups: list[tuple[str, Iterator[DiameterCase]]] = [
        ("phantoms", painted_phantoms(seeds, kernels, slices, say)),
        ("generated", generated_phantoms(generated)),
    ]
    data = load_settings().data_dir
    if patients and data is not None:
        groups.append(("patients", painted_patients(data, patients, kernels, slices, say)))
    for subjects, cases in groups:
        routes: list[ComparedRoute] = []
        for case in cases:
            airways = find_airways(case.volume, progress=False)
            measures = measure_tree(case.volume, airways, progress=False)
            own = compared_routes(case, airways.tree, measures, wall_field(case.volume, airways))
            say(f"{case.subject} {case.condition}: {len(own)} routes")
            routes += own
        rows += rows_by_condition(subjects, routes)
    return rows


def rows_by_condition(subjects: str, routes: Sequence[ComparedRoute]) -> list[Row]:
    """Return the rows of each condition, of the fitted subjects, of the others, and of all routes."""
    rows: list[Row] = []
    for condition in dict.fromkeys(one.condition for one in routes):
        rows += rows_of(f"{subjects}, {condition}", [one for one in routes if one.condition == condition])
    parts = {"fitted": True, "only checked": False}
    for name, is_fitted in parts.items():
        own = [one for one in routes if (one.subject in FITTED) == is_fitted]
        rows += rows_of(f"{subjects}, {name}", own) if own else []
    return rows + (rows_of(f"{subjects}, all", routes) if routes else [])


def main() -> None:
    """Run the command line: compare the routes of all cases and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="One phantom, one kernel.")
    parser.add_argument("--patients", nargs="*", help="Painted patients, too (CARINA_DATA_DIR); default: all.")
    parser.add_argument("--seeds", nargs="*", type=int, default=list(SEEDS), help="Seeds of painted phantoms.")
    parser.add_argument(
        "--generated", nargs="*", type=int, default=list(GENERATED), help="Seeds of generated phantoms."
    )
    parser.add_argument("--slices", nargs="*", choices=SLICE_NAMES, default=list(SLICES))
    parser.add_argument("--kernels", nargs="*", choices=KERNEL_NAMES, default=list(KERNELS))
    parser.add_argument("--json", type=Path, help="A file for the rows.")
    options = parser.parse_args()
    rows = run(
        print,
        seeds=options.seeds[:1] if options.quick else options.seeds,
        patients=() if options.patients is None else options.patients or PATIENTS,
        generated=options.generated[:1] if options.quick else options.generated,
        kernels=options.kernels[:1] if options.quick else options.kernels,
        slices=options.slices[:1] if options.quick else options.slices,
    )
    for row in rows:
        met = MIN_COVERAGE <= row["coverage"] <= MAX_COVERAGE and abs(row["bias"]) <= MAX_BIAS
        print(
            f"{row['case']:28} {row['measure']:14} {row['routes']:5} routes  bias {row['bias']:+5.1f} % "
            f"({row['bias_mm']:+.2f} mm)  error {row['error']:4.1f} %  coverage {row['coverage']:.2f}  "
            f"too wide {row['too_wide']:.2f}{'' if met else '  (outside)'}"
        )
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
