"""Comparison of planned routes with the truth, in chests with random nodules whose airways are known.

The airways are found again in the CTs. ``python -m carina_bench.plan_truth FOLDER`` stores the slow results in FOLDER:
the CTs with the airways found in them, so that a second run only plans; and the rows of each finished case, so that an
interrupted run continues. Rows are judged again if the code of the plan or of the judgement has changed. Phantoms are
measured first.

A target is *reachable* if some point of the true centrelines satisfies three conditions. The scope fits along the whole
path to the point (true diameter at least ``fit_mm``). The path bends no more than the scope. The needle, aimed at the
nodule's true centre at no more than 100 degrees from the airway, meets the nodule's true edge within its reach.

The first route *arrives* if in the truth the scope fits along the whole path to its parking point, and the needle,
aimed as planned, meets the true nodule within its reach. All of the found path must lie in true lumen (within half a
voxel): along the true branches that lead to its end, or with the scope's width of true lumen around it (overlapping
branches are one lumen). No part of it may be a branch that was drawn by hand. A route is *stated as reachable* if its
outlook states that the scope reaches the target.

These rules ignore whether the scope can point there. Therefore each row also has ``points``: whether a drive of the
scope along the first route *in the wall of the true airways* (`carina_bench.plan_true_drive`) arrives and at least half
of the needles with random errors, from the tip and in the direction of the drive, meet the true nodule. A route that
does not arrive by the rules above, for example because its true airway is narrower than ``fit_mm``, does not point.
The old figure (``arrives``) and the new one (``arrives`` and ``points``) are reported beside each other.

Two searches in the true airways look for holds of the scope from which at least half of the needles with random errors
hit each target:

- ``could`` (``--holds``, seconds for a target): the exhaustive geometric search of `carina_bench.plan_holds`, which
  shares no code with the plan, the drive or the mechanics. It ignores whether a drive leads to the hold.
- ``laid`` (``--laid``, half a minute for a target): holds of the elastic model, at places of the true airways
  without a drive. It shares the scope's mechanics with the drive and misses poses that only a drive takes.

A first route is ``accepted`` if the geometric search also finds such a hold with the tip near the end of the route's
drive. The doubts about a target are listed and confirmed, because the target is known to be a nodule.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina.plan
from carina.config import load_settings
from carina.errors import CarinaError
from carina.plan import Plan, grow_nodule, plan_route
from carina.plan.routes.plan_route import MAX_ANGLE_DEG, PlannedRoute
from carina.scopes import ScopeDrive, ScopePreset, WallField, scope_preset
from carina.track import AirwayTree
from carina_bench import plan_cases
from carina_bench.plan_cases import PlanCase, Target, TrueTree, found_case, patient_cases, phantom_case, true_wall
from carina_bench.plan_holds import find_hold
from carina_bench.plan_true_drive import points_in_truth, strikes

__all__ = ["Flight", "flown", "is_reachable", "run"]

Say = Callable[[str], None]
Row = dict[str, Any]
Floats = NDArray[np.float64]

SCOPE, TOOL = replace(scope_preset("ultrathin"), channel_mm=2.0), "needle-21g"
"""Scope and name of the tool for which routes are planned; the channel is widened so that the needle passes."""
HOLD_STEP_MM, NUM_ROLLS, LEVERS_DEG = 2.0, 12, (0.0, 30.0, 60.0, 90.0, 120.0, 160.0, 210.0)
"""Distance between two places, number of rolls and lever settings of the search over holds."""
LAID_MM, NUM_FINER, FINER_DEG, NEARLY_DEG = 3.0, 3, (-20.0, -10.0, 0.0, 10.0, 20.0), 20.0
"""Search near a place: largest distance of the inserted tip, number of refined positions, and steps in degrees.

Positions at a place are refined if one of them points past the target's edge by less than the last angle.
"""
NEAR_TIP_MM = 5.0
"""Distance in mm from the tip after a route's drive within which the geometric search must find a hold."""
MIN_HITS, NUM_NEEDLES = 0.5, 400
"""Minimum share of needles that hit from a hold, and number of simulated needles."""
MIN_POINTS, MAX_STATED_WRONG = 0.9, 0.01
"""Minimum share of reachable routes that point, and of targets that holds hit, and maximum share of wrong
statements."""
PATIENTS = ("Patient1", "Patient2", "Patient3", "lobes-Patient1", "lobes-Patient2")
"""Names of the patients whose CTs are painted with nodules."""
CONDITION = "medium-25"
"""Condition (kernel and noise) under which the CTs of `PATIENTS` are painted."""
NUM_PER_PATIENT, NUM_PER_PHANTOM = 36, 6
"""Number of painted nodules in a patient's CT and in a phantom."""
PHANTOM_SEEDS = range(1, 21)
"""Seeds of the phantoms with nodules."""
MIN_ARRIVE, MAX_WRONG = 0.94, 0.01
"""Minimum share of reachable targets at which the route arrives; maximum share of wrong statements "reachable"."""
EDGE_MM = 0.05
"""Distance in mm between two points of a needle at which the true tissue is read."""
AT_ALL_MM = 3.0
"""Minimum length in mm of a true branch that the found path must follow."""
PASSED = 0.6
"""Minimum share of the length of a true branch that the found path must follow."""


def _code() -> str:
    taken = hashlib.sha256()
    for path in (*sorted(Path(carina.plan.__file__).parent.rglob("*.py")), Path(plan_cases.__file__), Path(__file__)):
        taken.update(path.read_bytes())
    return taken.hexdigest()[:16]


CODE = _code()
"""Hash of the source code of planning and of this comparison, computed at the start of this run."""


@dataclass(frozen=True, slots=True)
class Flight:
    """Result of following a plan's first route through the true airways."""

    arrives: bool
    why: str
    """Reason why the route does not arrive; empty if it arrives."""


def is_reachable(truth: TrueTree, target: Target, scope: ScopePreset, reach_mm: float) -> bool:
    """Return whether a target is reachable with this scope and reach, by a search over all true centreline points."""
    off = np.array(target.centre_lps) - truth.points
    distance = np.linalg.norm(off, axis=1)
    cosine = (off * truth.forward).sum(axis=1) / np.maximum(distance, 1e-9)
    may = truth.narrowest_mm >= scope.fit_mm
    may &= distance - target.radius_mm <= reach_mm
    may &= (np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) <= MAX_ANGLE_DEG) | (distance <= target.radius_mm)
    return bool(may.any())


def flown(case: PlanCase, target: Target, route: PlannedRoute, scope: ScopePreset, reach_mm: float) -> Flight:
    """Return whether a route arrives in the true airways, and the reason if it does not."""
    assert case.airways is not None
    truth, tree = case.truth, case.airways.tree
    way = _way(tree, route)
    tip = np.array(route.leg.tip_lps)
    slack_mm = 0.5 * max(case.volume.spacing_mm)
    outside = np.array([float((np.linalg.norm(truth.points - p, axis=1) - truth.radius_mm).min()) for p in way])
    # The trachea is not tested, because its cross-section is not a circle.
    in_trachea = np.arange(len(way)) < len(tree.root.points)
    if any(branch.kind == "manual" for branch in tree.lineage(route.branch_id)):
        return Flight(False, "drawn by hand")
    if outside[-1] > slack_mm:
        return Flight(False, f"parked {outside[-1]:.1f} mm outside the true lumen")
    if (outside > slack_mm)[~in_trachea].any():
        return Flight(False, f"the way leaves the true lumen by {outside[~in_trachea].max():.1f} mm")
    at = _true_place(truth, way)
    strayed = _strayed(truth, way, at)
    if strayed is not None and _room_mm(truth, way[~in_trachea]) < scope.fit_mm:
        return Flight(False, strayed)
    if truth.narrowest_mm[at] < scope.fit_mm:
        return Flight(False, f"truly {truth.narrowest_mm[at]:.2f} mm wide, stated {route.narrowest_mm:.2f}")
    along = np.array(route.leg.aim_lps) - tip
    along /= max(float(np.linalg.norm(along)), 1e-9)
    line = tip + np.arange(0.0, reach_mm + 1e-9, EDGE_MM)[:, None] * along
    off = np.linalg.norm(line - np.array(target.centre_lps), axis=1) - target.radius_mm
    if off.min() > 0.0:
        return Flight(False, f"the needle ends {off.min():.2f} mm short of the target or beside it")
    return Flight(True, "")


def _way(tree: AirwayTree, route: PlannedRoute) -> Floats:
    """Return the points of a route to the scope's parking point, which may be between two centreline points."""
    points = np.concatenate([branch.points for branch in tree.lineage(route.branch_id)])
    tip = np.array(route.leg.tip_lps)
    last = int(np.argmin(np.linalg.norm(points - tip, axis=1)))
    return np.concatenate([points[:last], tip[None]])


def _room_mm(truth: TrueTree, way: Floats) -> float:
    """Return the least width of true lumen around a path, mm; the lumen may be that of any of the true branches.

    The width of a point is at most the diameter of the true lumen there.
    """
    between = [way[:-1] + part * (way[1:] - way[:-1]) for part in np.linspace(0.0, 1.0, 6)]
    radius_mm = [
        float((truth.radius_mm - np.linalg.norm(truth.points - p, axis=1)).max()) for p in np.concatenate(between)
    ]
    return 2.0 * min(radius_mm, default=0.0)


def _true_place(truth: TrueTree, way: Floats) -> int:
    """Return the index of the true centreline point nearest to the end of a path; at a fork, of the widest path."""
    inside = np.linalg.norm(truth.points - way[-1], axis=1) - truth.radius_mm
    near = np.flatnonzero(inside <= max(float(inside.min()) + 0.3, 0.0))
    off = np.linalg.norm(truth.points[near] - way[-1], axis=1)
    # The dictionary contains the nearest point of each true branch.
    best = {int(truth.branch[n]): int(n) for _, n in sorted(zip(-off, near, strict=True))}
    return max(best.values(), key=lambda n: (float(truth.narrowest_mm[n]), -n))


def _strayed(truth: TrueTree, way: Floats, at: int) -> str | None:
    """Return a text with the first true branch that the path to the point ``at`` does not follow.

    The result is None if the path follows all true branches that lead to this point.
    """
    own = int(truth.branch[at])
    for branch in truth.lineage(own)[1:]:
        part = truth.branch == branch
        if branch == own:
            part &= np.arange(len(part)) <= at
        points, radius = truth.points[part], truth.radius_mm[part]
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        if length < AT_ALL_MM:
            continue
        gap = np.array([float(np.linalg.norm(way - p, axis=1).min()) for p in points])
        if float((gap <= radius + 0.5).mean()) < PASSED:
            return f"the true way leads over branch {branch}, the found one does not"
    return None


def accepted(case: PlanCase, target: Target, plan: Plan) -> bool:
    """Return whether a hold that hits is near the tip after the first route's drive, by the geometric search."""
    tip = np.array(plan.routes[0].leg.tip_lps)
    found = find_hold(case.truth, target, plan.scope, plan.tool.reach_mm, near_lps=tip, near_mm=NEAR_TIP_MM)
    return found is not None


def held(case: PlanCase, target: Target, scope: ScopePreset, reach_mm: float, wall: WallField) -> bool:
    """Return whether the needle hits the true nodule from any position of the scope in the true airways.

    The tested places are `HOLD_STEP_MM` apart on all branches within reach that are wide enough.
    """
    truth, centre = case.truth, np.array(target.centre_lps)
    for branch in range(len(truth.parents)):
        own = np.flatnonzero(truth.branch == branch)
        near = np.linalg.norm(truth.points[own] - centre, axis=1) - target.radius_mm <= reach_mm
        near &= truth.narrowest_mm[own] >= scope.fit_mm
        if not near.any():
            continue
        line = np.concatenate([truth.points[truth.branch == one] for one in truth.lineage(branch)])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])[-len(own) :]
        last_mm = -math.inf
        for n in np.flatnonzero(near):
            if along[n] - last_mm < HOLD_STEP_MM:
                continue
            last_mm = float(along[n])
            drive = ScopeDrive(wall, scope, line)
            laid = drive.place(line, last_mm)
            off_mm = float(np.linalg.norm(laid.pose.position_lps - truth.points[own[n]]))
            if off_mm <= LAID_MM and _holds_hit(drive, target, reach_mm):
                return True
    return False


def _holds_hit(drive: ScopeDrive, target: Target, reach_mm: float) -> bool:
    """Return whether a roll and a lever setting of an inserted scope hit a target; the best of a grid are refined."""
    insertion_mm, centre = drive.state.insertion_mm, np.array(target.centre_lps)

    def tip_at(roll_rad: float, lever_deg: float) -> Floats:
        return drive.drive(insertion_mm, roll_rad, math.radians(lever_deg), 0.1).pose.lps_from_camera

    found: list[tuple[float, float, float]] = []
    for roll in np.linspace(0.0, 2.0 * np.pi, NUM_ROLLS, endpoint=False):
        for lever_deg in LEVERS_DEG:
            tip = tip_at(float(roll), lever_deg)
            if strikes(tip, target, reach_mm):
                return True
            off = centre - tip[:3, 3]
            distance = max(float(np.linalg.norm(off)), target.radius_mm)
            angle = math.acos(float(np.clip(tip[:3, 2] @ off / distance, -1.0, 1.0)))
            past_edge = math.degrees(angle - math.asin(target.radius_mm / distance))
            found.append((past_edge, float(roll), lever_deg))
    found.sort()
    if found[0][0] > NEARLY_DEG:
        return False
    return any(
        strikes(tip_at(roll + math.radians(turn), min(max(lever_deg + more, 0.0), LEVERS_DEG[-1])), target, reach_mm)
        for _, roll, lever_deg in found[:NUM_FINER]
        for turn in FINER_DEG
        for more in FINER_DEG
    )


def judged(case: PlanCase, say: Say, *, with_holds: bool = False, with_laid: bool = False) -> Iterator[Row]:
    """Yield a row for each target: whether it is reachable, the stated outlook, and whether the first route arrives."""
    scope, wall = SCOPE, true_wall(case.truth)
    assert case.airways is not None and case.wall is not None
    for number, target in enumerate(case.targets):
        row: Row = {"case": case.name, "target": number, "radius_mm": round(target.radius_mm, 1)}
        try:
            nodule = grow_nodule(case.volume, target.centre_lps)
            start = time.perf_counter()
            cpu = time.process_time()
            plan = plan_route(
                case.volume,
                case.airways,
                nodule,
                scope=scope,
                tool=TOOL,
                wall=case.wall,
                moved_mm=0.0,
                confirmed=True,
            )
            row["seconds"] = round(time.perf_counter() - start, 2)
            row["cpu_seconds"] = round(time.process_time() - cpu, 2)
            row["doubts"] = [doubt.code for doubt in plan.doubts]
        except CarinaError as error:
            row |= {"reachable": is_reachable(case.truth, target, scope, 15.0), "outlook": "refused", "arrives": False}
            row["why"] = str(error)[:100]
            if with_holds:
                row["could"] = find_hold(case.truth, target, scope, 15.0) is not None
            yield row
            continue
        reach_mm = plan.tool.reach_mm
        row["reachable"] = is_reachable(case.truth, target, scope, reach_mm)
        row |= _stated_row(plan)
        flight = Flight(False, plan.why or "")
        if plan.routes:
            flight = flown(case, target, plan.routes[0], scope, reach_mm)
        row |= {"arrives": flight.arrives, "why": flight.why}
        if with_holds:
            row["could"] = find_hold(case.truth, target, scope, reach_mm) is not None
        if plan.routes:
            place = _true_place(case.truth, _way(case.airways.tree, plan.routes[0]))
            row["points"] = flight.arrives and points_in_truth(case, target, plan, place)
        if with_holds:
            if with_laid:
                row["laid"] = held(case, target, scope, reach_mm, wall)
            if row["outlook"] == "reaches":
                row["accepted"] = accepted(case, target, plan)
            say(json.dumps(row))
        elif (row["reachable"] and not flight.arrives) or (row["outlook"] == "reaches" and not flight.arrives):
            say(json.dumps(row))
        yield row


def stored_rows(
    folder: Path | None,
    name: str,
    make: Callable[[], PlanCase],
    say: Say,
    *,
    with_holds: bool = False,
    with_laid: bool = False,
) -> list[Row]:
    """Return the rows of the case ``name`` that the same code has stored in ``folder``; else judge and store them."""
    stored = None if folder is None else folder / "rows" / f"{name}.json"
    if stored is not None and stored.exists():
        found = json.loads(stored.read_text())
        if found["code"] == CODE and _is_searched(found["rows"], with_holds, with_laid):
            rows: list[Row] = found["rows"]
            return rows
    start = time.process_time()
    case = found_case(folder, name, make, say)
    found_s = time.process_time() - start
    rows = list(judged(case, say, with_holds=with_holds, with_laid=with_laid))
    arrived, reachable = sum(row["reachable"] and row["arrives"] for row in rows), sum(row["reachable"] for row in rows)
    planned_s = time.process_time() - start - found_s
    say(
        f"{name}: {arrived} of {reachable} reachable arrive; {len(rows)} targets; {found_s:.0f} s of the processor to "
        f"make or read the case, {planned_s:.0f} to plan"
    )
    if stored is not None:
        stored.parent.mkdir(parents=True, exist_ok=True)
        draft = stored.with_suffix(".draft")
        draft.write_text(json.dumps({"code": CODE, "rows": rows}, indent=0))
        draft.rename(stored)
    return rows


def _is_searched(rows: Sequence[Row], with_holds: bool, with_laid: bool) -> bool:
    planned = [row for row in rows if row["outlook"] != "refused"]
    return all(
        not wanted or all(name in row for row in planned)
        for name, wanted in (("could", with_holds), ("laid", with_laid))
    )


def _stated_row(plan: Plan) -> Row:
    if not plan.routes:
        return {"outlook": "no route"}
    first = plan.routes[0]
    return {
        "outlook": first.outlook,
        "branch": first.branch_name,
        "score": round(first.score, 3),
        "narrowest_mm": round(first.narrowest_mm, 2),
        "leg_mm": round(first.leg.to_target_mm, 1),
        "num_routes": len(plan.routes),
    }


def summary(rows: Sequence[Row], what: str) -> list[Row]:
    """Return the summary rows over the rows of all targets; ``what`` names the cases."""
    reachable = [row for row in rows if row["reachable"]]
    reaching = [row for row in rows if row["outlook"] == "reaches"]
    wrong = [row for row in reaching if not row["arrives"]]
    silent = [row for row in reachable if not row["arrives"] and row["outlook"] == "reaches"]
    return [
        {
            "what": "reachable targets whose first route arrives in the truth",
            "case": f"{what}, {len(reachable)} of {len(rows)} targets",
            "figure": float(np.mean([row["arrives"] for row in reachable])) if reachable else None,
            "limit": MIN_ARRIVE,
            "better": "higher",
        },
        {
            "what": "targets stated as reachable by a first route that does not arrive",
            "case": f"{what}, {len(reaching)} stated as reachable",
            "figure": len(wrong) / max(len(rows), 1),
            "of_stated": len(wrong) / max(len(reaching), 1),
            "of_reachable": len(silent),
            "limit": MAX_WRONG,
            "better": "lower",
        },
        *_pointing(rows, what),
    ]


def _pointing(rows: Sequence[Row], what: str) -> list[Row]:
    """Return the summary rows about the drives' pointing; without stated routes or holds, their figures are None."""
    reaching = [row for row in rows if row["outlook"] == "reaches"]
    right = [row for row in reaching if row["arrives"] and row.get("points", False) and row.get("accepted", True)]
    is_searched = any("could" in row for row in reaching)

    def row(text: str, of: str, part: int, whole: int, limit: float, better: str) -> Row:
        figure = part / whole if whole else None
        return {
            "what": text,
            "case": f"{what}, {part} of {whole} {of}",
            "figure": figure,
            "limit": limit,
            "better": better,
        }

    checks = "arrive, point and are accepted" if is_searched else "arrive and point"
    found = [
        row(
            f"first routes stated as reachable that {checks}",
            "outlook",
            len(right),
            len(reaching),
            MIN_POINTS,
            "higher",
        )
    ]
    for name, words in (("could", "geometric"), ("laid", "elastic")):
        searched = [one for one in rows if name in one]
        # A drive in the true wall that hits shows that the target can be hit, although a search has missed the hold.
        hit = [one for one in searched if one[name] or one.get("points", False)]
        missed = [one for one in searched if not (one[name] or one.get("points", False))]
        got = sum(one["outlook"] == "reaches" and one.get("points", False) for one in hit)
        wrong = sum(one["outlook"] == "reaches" for one in missed)
        found += [
            row(f"targets that a {words} hold hits with such a route", "hit", got, len(hit), MIN_POINTS, "higher"),
            row(
                f"targets that no {words} hold hits stated as reachable",
                "not hit",
                wrong,
                len(missed),
                MAX_STATED_WRONG,
                "lower",
            ),
        ]
    return found


def run(
    quick: bool,
    say: Say,
    folder: Path | None = None,
    *,
    with_holds: bool = False,
    with_laid: bool = False,
    seeds: Sequence[int] | None = None,
    patients: Sequence[str] | None = None,
    nodules: int = NUM_PER_PHANTOM,
) -> list[Row]:
    """Return the summary rows of painted patients, of phantoms, and of both together.

    Seeds of the phantoms and names of the patients replace the default ones.
    """
    data = load_settings().data_dir
    if seeds is None:
        seeds = PHANTOM_SEEDS[:2] if quick else PHANTOM_SEEDS
    rows_of = partial(stored_rows, folder, say=say, with_holds=with_holds, with_laid=with_laid)
    phantoms: list[Row] = []
    for seed in seeds:
        phantoms += rows_of(f"phantom-{seed}", partial(phantom_case, seed, num=nodules))
    painted: list[Row] = []
    if data is not None:
        if patients is None:
            patients = PATIENTS[:1] if quick else PATIENTS
        for name, make in patient_cases(data, list(patients), CONDITION, NUM_PER_PATIENT, say):
            painted += rows_of(name, make)
    rows = []
    for what, part in (("painted", painted), ("phantoms", phantoms), ("all", [*painted, *phantoms])):
        if part:
            say(f"{what}: outlook {dict(Counter(row['outlook'] for row in part))}")
            rows += summary(part, what)
    return rows


def main() -> None:
    """Run the command line: judge the routes of all cases and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="Folder of the stored CTs and their airways.")
    parser.add_argument("--quick", action="store_true", help="One patient and two phantoms.")
    parser.add_argument("--holds", action="store_true", help="Search holds that hit each target by geometry.")
    parser.add_argument("--laid", action="store_true", help="Also search holds of the elastic model (slow).")
    parser.add_argument("--phantoms", type=int, nargs="*", help="Seeds of the phantoms; none without a number.")
    parser.add_argument("--patients", nargs="*", help="Names of the painted patients; none without a name.")
    parser.add_argument("--nodules", type=int, default=NUM_PER_PHANTOM, help="Number of nodules in a phantom.")
    options = parser.parse_args()
    say = partial(print, flush=True)
    for row in run(
        options.quick,
        say,
        options.folder,
        with_holds=options.holds or options.laid,
        with_laid=options.laid,
        seeds=options.phantoms,
        patients=options.patients,
        nodules=options.nodules,
    ):
        figure = "none" if row["figure"] is None else f"{row['figure']:.4f}"
        print(f"{row['what']} ({row['case']}): {figure}, limit {row['limit']:g}", row.get("of_stated", ""))


if __name__ == "__main__":
    main()
