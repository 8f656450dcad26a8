"""Comparison of the stated probability of a drive with the share of simulated drives that pass.

``python -m carina_bench.plan_drive tubes`` draws measured values of tubes and their errors at random, judges by the
measured values, and drives in the true tube. ``python -m carina_bench.plan_drive phantoms`` searches drives to tips of
generated airways and repeats the moves of each drive with a new scope.
"""

from __future__ import annotations

import argparse
import itertools
import math
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

import carina
from carina.plan import place_at_start, replay_moves, search_drive
from carina.plan.routes.last_leg import LastLeg
from carina.plan.routes.main_carina import ROOT
from carina.plan.routes.plan_route import PlannedRoute
from carina.plan.routes.ranking import BEND_SIGMA_DEG
from carina.plan.routes.route_width import DEVIATIONS_90, EXCESS_SIGMA_MM, RouteWidth
from carina.plan.verdict.checks import bend_check, diameter_check
from carina.plan.verdict.drive_route import DriveWay
from carina.plan.verdict.lever import lever_check
from carina.scopes import FIT_MARGIN_MM, ScopePreset, WallField, scope_preset
from carina.track import AirwayTree, Branch, wall_field

__all__ = ["TubeDrive", "calibration_table", "drive_in_a_tube", "phantom_drives"]

Points = NDArray[np.float64]

SPACING_MM = 0.8
"""Spacing of the simulated CT from which widths are measured, mm."""
MESH_ERROR_SHARE = 0.2
"""Standard deviation of the error of a measured narrowest diameter, as a share of the CT's voxel spacing."""
WIDE_MM, NARROW_FROM_MM, LENGTH_MM = 4.2, 55.0, 110.0
"""Radius of the wide part of a tube, distance at which the narrow part begins, and length of the tube, mm."""
STEP_MM = 0.4
"""Distance between two samples of the wall field, mm; equal to that in `carina.wall_field`."""
TUBE_EFFORT, PHANTOM_EFFORT = 4000.0, 200_000.0
"""Maximum efforts (small steps of the model) of a search for a drive, in a tube and in a phantom."""


@dataclass(frozen=True, slots=True)
class TubeDrive:
    """Stated probability of a drive through one tube, and whether the drive passed."""

    stated: float
    passed: bool


def _tube(
    radius_mm: float, bend_deg: float, bend_radius_mm: float, *, forks: bool = False
) -> tuple[AirwayTree, WallField, Points]:
    """Return a tube as a tree, a wall field and a centreline.

    The tube leads straight down, becomes narrower, follows a circle, and is straight again.

    With ``forks`` another tube of the narrow width continues straight from the point where the tube narrows.
    """
    at = np.arange(0.0, LENGTH_MM + 0.25, 0.5)
    turned = np.clip((at - NARROW_FROM_MM) / bend_radius_mm, 0.0, math.radians(bend_deg))
    points = _line(turned)
    radius = np.interp(at, [NARROW_FROM_MM - 10.0, NARROW_FROM_MM], [WIDE_MM, radius_mm])
    lines = [points, _line(np.zeros_like(at))] if forks else [points]
    lo = np.min([line.min(axis=0) for line in lines], axis=0) - 6.0
    hi = np.max([line.max(axis=0) for line in lines], axis=0) + 6.0
    num = np.ceil((hi - lo) / STEP_MM).astype(int) + 1
    values = np.full(num[::-1], -9.0, dtype=np.float32)
    for line in lines:
        for point, r in zip(line, radius, strict=True):
            first = np.maximum(((point - lo - r - 2.6) / STEP_MM).astype(int), 0)
            last = np.minimum(((point - lo + r + 2.6) / STEP_MM).astype(int) + 2, num)
            x, y, z = (lo[a] + STEP_MM * np.arange(first[a], last[a]) - point[a] for a in range(3))
            off = np.sqrt(z[:, None, None] ** 2 + y[None, :, None] ** 2 + x[None, None, :] ** 2)
            part = values[first[2] : last[2], first[1] : last[1], first[0] : last[0]]
            np.maximum(part, (r - off).astype(np.float32), out=part)
    place = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    place[:3, 3] = lo
    half = round(2.0 * NARROW_FROM_MM) if forks else len(points) // 3
    ways = [line[half:] for line in lines]
    trunk = Branch(
        0, None, tuple(range(1, 1 + len(ways))), 0, "Trachea", "tracked", points[: half + 1], radius[: half + 1]
    )
    rest = [Branch(1 + n, 0, (), 1, None, "tracked", way, radius[half:]) for n, way in enumerate(ways)]
    return AirwayTree((trunk, *rest)), WallField.from_distances(values, place), points


def _line(turned: Points) -> Points:
    """Return a line that starts downwards; ``turned`` is its angle from this direction every 0.5 mm, radians."""
    steps = 0.5 * np.stack([np.sin(turned), np.zeros_like(turned), -np.cos(turned)], axis=1)
    points: Points = np.cumsum(steps, axis=0) - steps[0]
    return points


def _route(branch_id: int, tip: Points, along_mm: float) -> PlannedRoute:
    place = (float(tip[0]), float(tip[1]), float(tip[2]))
    leg = LastLeg(place, place, place, 0.0, 0.0, 0.0, (), 0.0, 0.0, None, None, None, 1.0, reaches=True)
    width = RouteWidth(1.0, 0.1, along_mm)
    return PlannedRoute(branch_id, "", along_mm, ROOT, (0.0, 0.0, -1.0), width, "fits", leg, {}, 1.0, ())


def drive_in_a_tube(rng: np.random.Generator, kind: str) -> TubeDrive:
    """Judge a drive by measured values of a tube, then drive in the true tube, which differs by random errors.

    ``kind`` is the value that has the error: ``diameter``, ``bend`` or ``fork``.
    """
    scope = scope_preset("ultrathin")
    sigma = math.hypot(MESH_ERROR_SHARE * SPACING_MM, EXCESS_SIGMA_MM)
    bend_deg, bend_radius_mm = (8.0, 90.0) if kind == "diameter" else (rng.uniform(50.0, 110.0), 22.0)
    if kind == "fork":
        bend_deg, bend_radius_mm = rng.uniform(40.0, 80.0), 12.0
    spare_mm = {"diameter": sigma * rng.uniform(-1.8, 1.8), "bend": 1.6, "fork": 3.0}[kind]
    diameter_mm = scope.fit_mm + spare_mm
    if kind != "diameter":
        bend_limit_deg = min(bend_deg, math.degrees(50.0 / bend_radius_mm))
        lever = bend_limit_deg + BEND_SIGMA_DEG * rng.uniform(-1.8, 1.8)
        scope = replace(scope, flexion_deg=(lever, lever))
    tree, field, points = _tube(0.5 * diameter_mm, bend_deg, bend_radius_mm, forks=kind == "fork")
    way = DriveWay(tree, _route(1, points[-16], 0.5 * (len(points) - 16)), field)
    if kind == "diameter":
        error_mm = DEVIATIONS_90 * MESH_ERROR_SHARE * SPACING_MM
        stated = diameter_check(RouteWidth(diameter_mm, error_mm, 50.0), scope, errors=True).share
        true_diameter_mm = diameter_mm + rng.normal(0.0, MESH_ERROR_SHARE * SPACING_MM)
        driven = replace(scope, tip_mm=scope.tip_mm + FIT_MARGIN_MM + rng.normal(0.0, EXCESS_SIGMA_MM))
        radius_mm = 0.5 * true_diameter_mm
        # Between its samples, the wall field makes a narrow tube up to 0.4 mm too narrow, so the tube is widened
        # until its width in the field is the drawn width.
        for _ in range(3):
            _, field, _ = _tube(radius_mm, bend_deg, bend_radius_mm)
            way = DriveWay(tree, _route(1, points[-16], 0.5 * (len(points) - 16)), field)
            radius_mm += 0.5 * (true_diameter_mm - way.passable_diameter_mm)
    else:
        figures = bend_check(way, scope, errors=True)
        found = search_drive(way, field, scope, effort=TUBE_EFFORT)
        stated = lever_check(way, field, scope, figures, found, effort=TUBE_EFFORT).share
        lever = max((scope.flexion_deg or (0.0, 0.0))[0] + rng.normal(0.0, BEND_SIGMA_DEG), 1.0)
        driven = replace(scope, flexion_deg=(lever, lever))
    assert stated is not None
    return TubeDrive(stated, search_drive(way, field, driven, effort=TUBE_EFFORT).arrived)


def calibration_table(drives: list[TubeDrive], edges: tuple[float, ...] = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)) -> str:
    """Return a table of the stated probabilities, in bins with these edges, and the share of drives that passed."""
    rows = ["stated        drives  mean       passed"]
    for low, high in itertools.pairwise(edges):
        inside = [one for one in drives if low <= one.stated < high or (high == 1.0 and one.stated == 1.0)]
        if inside:
            stated = float(np.mean([one.stated for one in inside]))
            passed = float(np.mean([one.passed for one in inside]))
            rows.append(f"{low:.1f} to {high:.1f}    {len(inside):5d}     {stated:6.2f}  {passed:6.2f}")
    return "\n".join(rows)


def phantom_drives(seed: int, scope: ScopePreset, num_tips: int, spare_mm: float = 0.5) -> list[tuple[bool, bool, int]]:
    """Search drives to some tips of a phantom, each up to the point where the lumen becomes too narrow.

    The lumen must be wider than the scope and its margin by ``spare_mm``.

    Returns
    -------
    list[tuple[bool, bool, int]]
        For each tip: whether a drive arrives, whether its moves alone lead a new scope into the same branch, and the
        number of moves.
    """
    made = carina.generate_phantom(seed=seed, spacing_mm=1.1)
    airways = carina.find_airways(made.volume)
    tree, wall = airways.tree, wall_field(made.volume, airways)
    tips = [branch.id for branch in tree.branches if not branch.children]
    found = []
    for branch_id in np.random.default_rng(seed).permutation(tips)[:num_tips]:
        route = tree.route_to(int(branch_id))
        at = np.arange(20.0, route.length_mm - 4.0, 0.5)
        points = np.stack([np.interp(at, route.cumulative_mm, route.points_lps[:, a]) for a in range(3)], axis=1)
        narrow = np.flatnonzero(2.0 * wall.distance_mm(points) < scope.fit_mm + spare_mm)
        n = int(narrow[0]) - 1 if len(narrow) else len(at) - 1
        way = DriveWay(tree, _route(int(branch_id), points[n], float(at[n])), wall)
        driven = search_drive(way, wall, scope, effort=PHANTOM_EFFORT)
        same = False
        if driven.arrived:
            tip = replay_moves(place_at_start(way, wall, scope), driven.moves)[-1].position_lps
            nearest, _, _ = tree.nearest_branch(tip)
            lineage = {branch.id for branch in tree.lineage(int(branch_id))}
            same = nearest.id in lineage and bool(np.linalg.norm(tip - points[n]) < 1.5 + way.radius_mm(way.park_mm))
        found.append((driven.arrived, same, len(driven.moves)))
    return found


def main() -> None:
    """Run the command line: print the table of the tubes or the results of the phantoms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("tubes", "phantoms"))
    parser.add_argument("--drives", type=int, default=200)
    parser.add_argument("--phantoms", type=int, default=10)
    parser.add_argument("--tips", type=int, default=3)
    parser.add_argument("--scope", default="ultrathin")
    options = parser.parse_args()
    start = process_time()
    if options.what == "tubes":
        rng = np.random.default_rng(66)
        for kind, share in (("diameter", 0.6), ("bend", 0.2), ("fork", 0.2)):
            drives = [drive_in_a_tube(rng, kind) for _ in range(round(share * options.drives))]
            print(f"{kind}: {len(drives)} drives\n{calibration_table(drives)}", flush=True)
    else:
        every: list[tuple[bool, bool, int]] = []
        for seed in range(11, 11 + options.phantoms):
            every += phantom_drives(seed, scope_preset(options.scope), options.tips)
            arrived, same = sum(one[0] for one in every), sum(one[1] for one in every)
            print(
                f"phantom {seed}: {len(every)} routes so far, {arrived} arrive, {same} blind replays right", flush=True
            )
        print(f"moves of a drive that arrives: {np.median([one[2] for one in every if one[0]]):.0f} in the median")
    print(f"{process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
