"""Comparison of the score of the first planned route with the best score of an exhaustive search.

The cases are phantoms with nodules and stenoses. ``python -m carina_bench.plan_best FOLDER`` reads those that
``plan_truth`` has stored in FOLDER, or generates them.

The plan is a draft without drives, because a drive takes seconds for each place. The search shares no code with the
plan, only its inputs: the tree, the lumen's width along each branch, the nodule's voxels, the wall's distances, the
vessels of the box, the weights, and the direction nearest to the target that the scope can take at a place
(`carina.plan.routes.attainable_directions`, whose tests compare it with a slow reference). It tests centreline points
0.35 mm apart (the plan: 0.7), follows each needle in steps of 0.1 mm (the plan: 0.25), simulates random needles (the
plan: quadrature), and follows each path from the trachea for its narrowest point and its sharpest bend. Points that
cannot be the best even without misses of the needle are not simulated.

The scores may differ by these tolerances: 0.25 x 0.02 for the needles, 0.15 x (0.35 mm + 0.25 mm) / 15 mm for the way,
0.15 x 2 degrees / 90 for the angle, 0.15 x 0.5 mm / 8 mm for the length in the target, and 0.1 x 0.5 mm / 3 mm for a
vessel: 0.04 at most.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import CarinaError
from carina.plan import NearbyTissue, Nodule, Plan, PlannedRoute, grow_nodule, plan_route, surroundings
from carina.plan.routes.attainable_directions import StandingPlace, TipDirections
from carina.plan.routes.clearance import ball_diameters_mm
from carina.scopes import ScopePreset, scope_preset
from carina.track import AirwayTree, Branch
from carina_bench.plan_cases import PlanCase, found_case, phantom_case
from carina_bench.plan_truth import NUM_PER_PHANTOM, PHANTOM_SEEDS

__all__ = ["best_of_all", "run"]

Say = Callable[[str], None]
Row = dict[str, Any]
Floats = NDArray[np.float64]

SCOPES = (scope_preset("thin"), replace(scope_preset("ultrathin"), channel_mm=2.0))
"""Scopes for which routes are compared; the channel is widened so that the needle passes."""
MIN_HITS, BARELY_HITS = 0.5, 0.1
"""Shares of needles that hit: below the first the outlook is *may reach*, below the second *does not reach*."""
NUM_TARGETS = 2
"""Number of targets of each phantom for which Carina's first route is compared with the best one."""
POSITION_STEP_MM, WALK_MM, FINE_STEP_MM = 0.35, 0.1, 0.5
"""Distance between two tested points of a centreline, step along a needle, and step of simulated needles, mm."""
NUM_NEEDLES = 6000
"""Number of needles with random errors that are simulated at each tested scope position."""
SIGMA_ANGLE_DEG, SIGMA_TIP_MM = 4.0, 0.7
"""Standard deviations of the needle's direction, degrees, and of the scope's tip, mm."""
TOLERANCE = 0.04
"""Maximum accepted amount by which the score of the best route exceeds that of Carina's first route."""
MIN_SHOWN = 0.003
"""Minimum contribution to a difference of scores that the report lists."""
RANKS = ("reaches", "may reach", "does not reach")
"""Outlook of a route for each rank: index 0 is the best rank."""


def best_of_all(case: PlanCase, plan: Plan, around: NearbyTissue, rng: np.random.Generator) -> tuple[float, str, Row]:
    """Return the score, the outlook and the description of the best of all possible positions of the scope."""
    assert case.airways is not None and case.wall is not None
    nodule, reach_mm = plan.nodule, plan.tool.reach_mm
    centre = np.array(nodule.centre_lps)
    found = []
    aim = np.array(plan.aims[0])
    directions = TipDirections(case.airways.tree, case.wall, plan.scope)
    rooms = {branch.id: ball_diameters_mm(branch, case.wall) for branch in case.airways.tree.branches}
    for branch in case.airways.tree.branches:
        near = partial(_is_near, centre, reach_mm + nodule.long_mm)
        for place in _places(case.airways.tree, branch, plan.scope, max(case.volume.spacing_mm), rooms, near):
            walked = _aimed(case, plan, around, place, directions, aim)
            if walked is not None:
                found.append(place | walked)
    # Sorted by an upper bound, the score without misses of the needle: the loop ends at the first bound below the best
    # score.
    found.sort(key=lambda one: (one["rank"], -_worth(plan, one, one["lost"])))
    best: tuple[int, float, Row] | None = None
    for one in found:
        if best is not None and (one["rank"], -_worth(plan, one, one["lost"])) >= (best[0], -best[1]):
            break
        hits = _drawn(nodule, one["tip"], one["aim"], reach_mm, rng) if one["points"] else 0.0
        one["parts"]["misses"] = 1.0 - hits
        lost = one["lost"] + plan.weights.misses * (1.0 - hits)
        if hits < MIN_HITS:
            one["rank"] = max(one["rank"], 1 if hits >= BARELY_HITS else 2)
            one["chance"] *= hits
        if best is None or (one["rank"], -_worth(plan, one, lost)) < (best[0], -best[1]):
            best = one["rank"], _worth(plan, one, lost), one
    assert best is not None
    return best[1], RANKS[best[0]], best[2]


def _aimed(
    case: PlanCase, plan: Plan, around: NearbyTissue, place: Row, directions: TipDirections, aim: Floats
) -> Row | None:
    """Return `_walked` for the needle that points nearest to the target among those that the scope can take.

    If the scope can take no direction that hits, the needle goes to the aim, and all needles count as misses.
    """
    off = aim - place["point"]
    distance = float(np.linalg.norm(off))
    angle = math.degrees(math.acos(np.clip(off @ place["forward"] / max(distance, 1e-9), -1.0, 1.0)))
    if angle > 100.0 and not plan.nodule.contains(place["point"][None])[0]:
        return None
    tip, end, points = place["point"], aim, not directions.is_known
    if directions.is_known:
        standing = StandingPlace(place["branch"], place["mm"], place["point"], place["forward"])
        found = directions.towards(standing, aim, 0.5 * plan.nodule.short_mm)
        if found is not None:
            end = found.tip_lps + float(np.linalg.norm(aim - found.tip_lps)) * found.forward
            tip, points = found.tip_lps, True
    walked = _walked(case, plan, around, place, tip, end)
    if walked is None and points:
        points, tip, end = False, place["point"], aim
        walked = _walked(case, plan, around, place, tip, end)
    return None if walked is None else walked | {"tip": tip, "aim": end, "points": points}


def _worth(plan: Plan, place: Row, lost: float) -> float:
    """Return the score of a position that loses ``lost``; for the outlook *may reach*, times the probability."""
    return _score(plan, lost) * (place["chance"] if place["rank"] == 1 else 1.0)


def _apart(plan: Plan, first: PlannedRoute, place: Row) -> str:
    """Return as text how much each part of the score contributes to the difference between two routes.

    The probability (chance) counts as a part. Contributions below :data:`MIN_SHOWN` are omitted.
    """
    weights = plan.weights.to_json()
    total = sum(weights.values())
    off = {name: weights[name] * (first.parts[name] - part) / total for name, part in place["parts"].items()}
    off["chance"] = place["chance"] - first.chance if first.outlook == "may reach" else 0.0
    shown = [f"{name} {value:+.3f}" for name, value in off.items() if abs(value) >= MIN_SHOWN]
    return f"of it {', '.join(shown)}" if shown else "alike in all parts"


def _score(plan: Plan, lost: float) -> float:
    weights = plan.weights
    total = weights.misses + weights.way + weights.angle + weights.narrow + weights.vessels + weights.shallow
    return 1.0 - lost / total


def _is_near(centre: Floats, most_mm: float, point: Floats) -> bool:
    return float(np.linalg.norm(point - centre)) <= most_mm


def _places(
    tree: AirwayTree,
    branch: Branch,
    scope: ScopePreset,
    spacing_mm: float,
    rooms: dict[int, Floats],
    near: Callable[[Floats], bool],
) -> Iterator[Row]:
    """Yield the points of a branch near the target, with direction, width and bend of the path to each point."""
    lineage: list[Branch] = []
    one: Branch | None = branch
    while one is not None:
        lineage.insert(0, one)
        one = None if one.parent is None else tree.branch(one.parent)
    line: list[Floats] = []
    width: list[float] = []
    first = 0
    for number, part in enumerate(lineage):
        if number == len(lineage) - 1:
            first = len(line)
        own = rooms[part.id] if number else np.full(len(part.points), np.median(rooms[part.id]))
        if line:
            width[-1] = min(width[-1], float(own[0]))
        width += list(own[1:] if line else own)
        line += list(part.points[1:] if line else part.points)
    first = max(first - 1, 0)
    points, widths = np.array(line), np.array(width)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    trust = min(
        0.5 if part.kind != "tracked" else 1.0 if part.confidence is None or part.confidence >= 0.5 else part.confidence
        for part in lineage
    )
    at_branch = np.gradient(branch.points, axis=0)
    own_along = along[first : first + len(branch.points)]
    for mm in np.arange(along[first], along[-1] + 1e-6, POSITION_STEP_MM):
        point = np.array([np.interp(mm, along, points[:, axis]) for axis in range(3)])
        # Points far from the target are skipped before the path's width and bend are computed, which is slow.
        if not near(point):
            continue
        ahead = np.array([np.interp(mm, own_along, at_branch[:, axis]) for axis in range(3)])
        yield {
            "branch": branch.id,
            "mm": float(mm),
            "point": point,
            "forward": ahead / np.linalg.norm(ahead),
            # Between two points of the centreline the width is that of the narrower one.
            "width_mm": (width_mm := float(widths[: int(np.searchsorted(along, mm - 1e-6)) + 1].min())),
            **_outlook(scope, width_mm, _bend(points, along, mm, scope), spacing_mm, trust),
        }


def _bend(points: Floats, along: Floats, mm: float, scope: ScopePreset) -> float:
    if scope.bending_mm is None:
        return 0.0
    section = 0.5 * sum(scope.bending_mm) + (scope.rigid_tip_mm or 0.0)

    def way(at: float) -> Floats:
        ends = [max(at - 4.0, 0.0), min(at + 4.0, along[-1])]
        low, high = (np.array([np.interp(end, along, points[:, axis]) for axis in range(3)]) for end in ends)
        step: Floats = (high - low) / np.linalg.norm(high - low)
        return step

    turns = [
        math.degrees(math.acos(np.clip(way(end) @ way(end - section), -1.0, 1.0)))
        for end in np.arange(section, mm, 3.0)
    ]
    return max(turns, default=0.0)


def _outlook(scope: ScopePreset, width_mm: float, bend_deg: float, spacing_mm: float, trust: float) -> Row:
    """Return the rank of the outlook of a path, and its probability, from the width and the bend of the path.

    The rank is 0 (reaches) if both suffice with a probability of 90 %, 2 (does not reach) if one fails with 90 %, else
    1. It is at least 1 if ``trust`` is below 1.
    """
    sigma = math.hypot(0.2 * spacing_mm, 0.15)
    spare = [(width_mm - max(scope.tip_mm + 0.4, scope.tube_mm or 0.0)) / sigma]
    if scope.flexion_deg is not None:
        spare.append((max(scope.flexion_deg) - bend_deg) / 8.0)
    chances = [0.5 * math.erfc(-one / math.sqrt(2.0)) for one in spare]
    ranks = [0 if one >= 0.9 else 2 if one <= 0.1 else 1 for one in chances]
    return {"rank": max([int(trust < 1.0), *ranks]), "chance": trust * math.prod(chances)}


def _walked(case: PlanCase, plan: Plan, around: NearbyTissue, place: Row, tip: Floats, aim: Floats) -> Row | None:
    """Return the parts of the score of a place except for the needle's misses, and the score that they lose.

    The needle goes from ``tip`` towards ``aim``. The result is None if it does not reach the nodule.
    """
    assert case.wall is not None
    nodule, weights, reach_mm = plan.nodule, plan.weights, plan.tool.reach_mm
    off = aim - tip
    distance = float(np.linalg.norm(off))
    along = off / distance if distance >= 0.5 else place["forward"]
    angle = math.degrees(math.acos(np.clip(along @ place["forward"], -1.0, 1.0)))
    line = tip + np.arange(0.0, distance + nodule.long_mm, WALK_MM)[:, None] * along
    inside = nodule.contains(line)
    if not inside.any():
        return None
    first, last = int(np.argmax(inside)), len(inside) - 1 - int(np.argmax(inside[::-1]))
    if first * WALK_MM > reach_mm:
        return None
    to_wall = case.wall.distance_mm(line)
    out = int(np.argmax(to_wall <= 0.0)) if (to_wall <= 0.0).any() else 0
    in_mm = WALK_MM * float(inside[: int(reach_mm / WALK_MM) + 1].sum())
    stretch = line[min(out, last) : last + 1]
    vessel_mm = np.where(around.holds(stretch), around.read(around.vessel_mm, stretch), np.inf)
    thick = around.read(around.thick, stretch) & around.holds(stretch) & (case.wall.distance_mm(stretch) < -1.5)
    near = 1.0 if thick.sum() * WALK_MM > 2.0 else 1.0 - min(float(vessel_mm.min()) / plan.vessel_margin_mm, 1.0)
    lacks = 1.0 - place["width_mm"] / max(plan.scope.tip_mm + 0.4, plan.scope.tube_mm or 0.0)
    parts = {
        "way": min(max(first - out, 0) * WALK_MM / reach_mm, 1.0),
        "angle": min(angle / 90.0, 1.0),
        "narrow": min(max(4.0 * lacks, 0.0), 1.0),
        "vessels": near,
        "shallow": max(1.0 - in_mm / min(8.0, 0.9 * nodule.short_mm), 0.0),
    }
    lost = sum(getattr(weights, name) * part for name, part in parts.items())
    depth = 0.5 * math.erfc(-(reach_mm - first * WALK_MM) / 0.5 / math.sqrt(2.0))
    return {
        "lost": lost,
        "parts": parts,
        "rank": max(place["rank"], 0 if depth >= 0.9 else 2 if depth <= 0.1 else 1),
        "chance": place["chance"] * depth,
    }


def _drawn(nodule: Nodule, tip: Floats, aim: Floats, reach_mm: float, rng: np.random.Generator) -> float:
    """Return the share of simulated needles from ``tip`` towards ``aim`` that pass through the nodule."""
    along = aim - tip
    distance = float(np.linalg.norm(along))
    if distance < 1e-6:
        return 1.0
    basis = np.linalg.svd((along / distance)[None])[2]
    spread = rng.normal(size=(NUM_NEEDLES, 2)) * math.radians(SIGMA_ANGLE_DEG)
    tips = tip + rng.normal(size=(NUM_NEEDLES, 2)) @ basis[1:] * SIGMA_TIP_MM
    off = np.linalg.norm(spread, axis=1, keepdims=True)
    ways = np.cos(off) * along / distance + np.sin(off) * (spread / np.maximum(off, 1e-12)) @ basis[1:]
    hit = np.zeros(NUM_NEEDLES, dtype=bool)
    for mm in np.arange(0.0, reach_mm + 1e-9, FINE_STEP_MM):
        left = ~hit
        hit[left] = nodule.contains(tips[left] + mm * ways[left])
    return float(hit.mean())


def run(quick: bool, say: Say, folder: Path | None = None) -> list[Row]:
    """Compare the first route's score with the best score in all phantoms; return the rows of the report."""
    off, other_rank = [], 0
    for seed in PHANTOM_SEEDS[:2] if quick else PHANTOM_SEEDS:
        make = partial(phantom_case, seed, num=NUM_PER_PHANTOM)
        case = found_case(folder, f"phantom-{seed}", make, say)
        assert case.airways is not None and case.wall is not None
        num = 0
        for target in case.targets:
            try:
                nodule = grow_nodule(case.volume, target.centre_lps)
            except CarinaError:
                continue
            plan = plan_route(
                case.volume,
                case.airways,
                nodule,
                scope=SCOPES[(seed + num) % 2],
                wall=case.wall,
                moved_mm=0.0,
                drives=0,
                confirmed=True,
            )
            if not plan.routes:
                continue
            half = plan.tool.reach_mm + 2.0 * nodule.long_mm + 14.0
            around = surroundings(case.volume, np.array(nodule.centre_lps), half, nodule, case.wall)
            score, outlook, place = best_of_all(case, plan, around, np.random.default_rng((seed, num)))
            first = plan.routes[0]
            worth = first.score * (first.chance if first.outlook == "may reach" else 1.0)
            other_rank += outlook != first.outlook
            off.append(score - worth if outlook == first.outlook else 0.0)
            say(
                f"phantom-{seed}, {plan.scope.name}: {worth:.3f} {first.outlook} in {first.key}; best of all "
                f"{score:.3f} {outlook} in {place['branch']}-{place['mm']:.1f}; {_apart(plan, first, place)}"
            )
            num += 1
            if num == NUM_TARGETS:
                break
    return [
        {
            "what": "score of the best place of all above the first route's, largest",
            "case": f"{len(off)} targets, {other_rank} of another rank",
            "figure": max(off, default=0.0),
            "mean": float(np.mean(off)) if off else None,
            "limit": TOLERANCE,
            "better": "lower",
        }
    ]


def main() -> None:
    """Run the command line: compare the scores in all phantoms and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="Folder of the stored CTs and their airways.")
    parser.add_argument("--quick", action="store_true", help="Two phantoms.")
    options = parser.parse_args()
    for row in run(options.quick, print, options.folder):
        print(f"{row['what']} ({row['case']}): {row['figure']:.4f}, mean {row['mean']:.4f}, limit {row['limit']:g}")


if __name__ == "__main__":
    main()
