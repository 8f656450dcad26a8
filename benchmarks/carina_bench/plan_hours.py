"""Comparison of the clock hours of turns with the middle of the true opening in the rendered picture.

``python -m carina_bench.plan_hours FOLDER [CASE ...]`` stores the CTs with the airways found in them in FOLDER. A case
is ``phantom-N`` or the name of a painted patient, such as ``Patient1``.

Every fork of every route to a tip is measured once, as far as the airways are at least ``--width`` mm wide. The picture
of a turn is rendered from the CT at the camera of the turn. A pixel belongs to the true opening if its wall is nearest
to the surface of the true branch or of a descendant; the largest connected part counts. The true hour is the direction
of the middle of these pixels from the middle of the picture, and is compared with the unrounded hour of the turn.

A second figure (``true_by_rays``) uses the pixels whose rays pass through lumen of the true branch alone, at least
0.3 mm before the wall. Where the found fork is at another place than the true one, this region includes parts of the
ridge between the branches.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.plan import PlannedRoute, Turn, turn_list
from carina.plan.routes.last_leg import LastLeg
from carina.plan.routes.main_carina import ROOT
from carina.plan.routes.route_width import RouteWidth
from carina.plan.turns.fork_view import hours_of, pixel_at, turn_view, whole_hour
from carina.plan.turns.opening_walls import FOV_DEG
from carina.plan.turns.pictures import turn_pictures
from carina.render import Renderer
from carina.scopes import Pose
from carina.track import AirwayTree, Branch
from carina_bench.plan_cases import PlanCase, TrueTree, found_case, patient_cases, phantom_case

__all__ = ["case_of", "hour_rows", "run", "summary", "true_branch"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Row = dict[str, Any]
Say = Callable[[str], None]

CONDITION = "medium-25"
"""Condition (kernel and noise) under which patients are painted."""
PHANTOM_SEEDS = range(1, 21)
PATIENTS = ("Patient1", "Patient2", "Patient3", "lobes-Patient1", "lobes-Patient2")
WIDTH_MM = 2.8
"""Minimum diameter in mm of the airways of a route whose turns are checked."""
SIZE_PX = 64
STEP_MM = 0.5
BEFORE_MM = 0.3
FAR_MM = 40.0
BESIDE_MM = 4.0
MIN_PX, MAX_SHARE = 4, 0.9
"""Minimum number of pixels of a true opening that is compared, and maximum share of the picture.

If an opening fills the picture, the found fork is at another place than the true one: the camera is in the true branch.
"""
MIN_WITHIN, MAX_NOT_GIVEN = 0.98, 0.1
"""Minimum share of clock hours within half an hour of the true one, and maximum share of openings without an hour."""


def hour_rows(case: PlanCase, *, width_mm: float = WIDTH_MM) -> Iterator[Row]:
    """Yield a row for each turn of a case: the stated clock hour, the true hours, and the hour of the drawn outline."""
    assert case.airways is not None
    tree = case.airways.tree
    renderer = Renderer(case.volume)
    renderer.set_lumen(case.airways.lumen_zyx)
    done = set()
    for route in _routes(tree, width_mm):
        turns = turn_list(tree, route, renderer=renderer)
        for turn in turns.turns:
            if (turn.fork_lps, turn.to_branch_id) in done:
                continue
            done.add((turn.fork_lps, turn.to_branch_id))
            (picture,) = turn_pictures(
                case.volume,
                case.airways,
                replace(turns, turns=(turn,)),
                size_px=2 * SIZE_PX,
                renderer=renderer,
                marked=False,
            )
            yield {
                "case": case.name,
                "from": turn.from_branch,
                "to": turn.to_branch,
                "hour": turn.clock_head,
                "shown": turn.hour("head"),
                "straight_ahead": turn.straight_ahead,
                "doubt": None if turn.hour_doubt is None else turn.hour_doubt.code,
                "off_deg": _off_deg(turn),
                "size_deg": math.sqrt(float(picture.outline.mean()) / math.pi) * FOV_DEG,
                "outline": _hour(picture.outline),
                "dots_in_outline": _dots_share(turn, picture.outline),
                **_true_hours(case, renderer, turn),
            }


def _off_deg(turn: Turn) -> float:
    """Return the angle in degrees between the line of sight and the middle of the opening."""
    camera = turn.camera("head")
    seen = np.array(turn.opening_lps) - camera.position_lps
    return math.degrees(math.acos(float(np.clip(seen @ camera.forward_lps / np.linalg.norm(seen), -1.0, 1.0))))


def _dots_share(turn: Turn, outline: Mask) -> float | None:
    """Return the share of the route's dots at an opening that are inside the drawn outline; None without an outline."""
    if not outline.any() or not turn.dots_lps:
        return None
    camera, size = turn.camera("head"), outline.shape[0]
    pixels = [pixel_at(camera, np.array(dot), size) for dot in turn.dots_lps]
    return float(np.mean([outline[int(row), int(column)] for column, row in pixels]))


def _true_hours(case: PlanCase, renderer: Renderer, turn: Turn) -> Row:
    assert case.airways is not None
    tree = case.airways.tree
    branch = true_branch(case.truth, tree, tree.branch(turn.to_branch_id))
    camera = turn.camera("head")
    walls = renderer.surface(turn_view(renderer, camera, SIZE_PX)).position_lps
    ours = np.isin(case.truth.branch, list(_below(case.truth, branch)))
    pixels = _wall_pixels(case.truth, ours, walls, np.array(turn.fork_lps))
    return {
        "true": _hour(pixels),
        "true_by_rays": _hour(_ray_pixels(case.truth, ours, walls, camera)),
        "true_px": int(pixels.sum()),
        "centre_in_true": bool(pixels[SIZE_PX // 2, SIZE_PX // 2]),
    }


def _routes(tree: AirwayTree, width_mm: float) -> Iterator[PlannedRoute]:
    """Yield a route to each tip of the tree after narrow branches are removed."""
    wide: dict[int, bool] = {}
    for branch in tree.branches:
        passes = 2.0 * float(np.median(branch.radius)) >= width_mm
        wide[branch.id] = branch.parent is None or (wide[branch.parent] and passes)
    for branch in tree.branches:
        if not wide[branch.id] or any(wide[child] for child in branch.children):
            continue
        lineage = tree.lineage(branch.id)
        along = sum(one.length_mm for one in lineage) - 0.3 * branch.length_mm
        tip = (float(branch.points[-1, 0]), float(branch.points[-1, 1]), float(branch.points[-1, 2]))
        leg = LastLeg(tip, tip, tip, 8.0, 6.0, 0.0, (), 8.0, 8.0, None, None, None, 1.0, reaches=True)
        width = RouteWidth(2.0, 0.1, along)
        name = branch.name or f"branch {branch.id}"
        yield PlannedRoute(branch.id, name, along, ROOT, (0.0, 0.0, -1.0), width, "fits", leg, {}, 1.0, ())


def true_branch(truth: TrueTree, tree: AirwayTree, daughter: Branch) -> int:
    """Return the true branch whose axis most points of the middle part of a found branch are nearest to.

    The points of a branch that is shorter than its diameter lie in the fork, where they can be nearest to a sibling.
    Such a branch is the true branch from which the true branches of its children arise.
    """
    if daughter.children and daughter.length_mm < 2.0 * float(np.median(daughter.radius)):
        lineages = [truth.lineage(true_branch(truth, tree, tree.branch(child))) for child in daughter.children]
        common = set.intersection(*map(set, lineages))
        return next(branch for branch in reversed(lineages[0]) if branch in common)
    away = np.linalg.norm(np.diff(daughter.points, axis=0), axis=1).cumsum()
    inner = daughter.points[1:][(away >= 0.4 * away[-1]) & (away <= 0.75 * away[-1])]
    votes: Counter[int] = Counter()
    for point in inner if len(inner) else daughter.points[-1:]:
        distance = np.linalg.norm(truth.points - point, axis=1)
        gap = distance - truth.radius_mm
        inside = gap <= max(float(gap.min()) + 0.3, 0.0)
        votes[int(truth.branch[int(np.argmin(np.where(inside, distance, np.inf)))])] += 1
    return votes.most_common(1)[0][0]


def _below(truth: TrueTree, branch: int) -> set[int]:
    below = {branch}
    for number, parent in enumerate(truth.parents):
        if parent in below:
            below.add(number)
    return below


def _wall_pixels(truth: TrueTree, ours: Mask, walls: Floats, fork: Floats) -> Mask:
    """Return the pixels whose wall is nearest to the true branch, which begins where it leaves the other lumens."""
    shape, points = walls.shape[:2], walls.reshape(-1, 3)
    known = np.isfinite(points).all(axis=1)
    near = np.linalg.norm(truth.points - fork, axis=1) < 60.0
    own, other = _tube(truth, near & ours), _tube(truth, near & ~ours)
    if len(own[0]) and len(other[0]):
        apart = _gap_mm(own[0], *other) >= 0.0
        other = np.concatenate([other[0], own[0][~apart]]), np.concatenate([other[1], own[1][~apart]])
        own = own[0][apart], own[1][apart]
    found = np.zeros(len(points), dtype=bool)
    if len(own[0]) and len(other[0]):
        gap, other_gap = _gap_mm(points[known], *own), _gap_mm(points[known], *other)
        found[known] = (gap < other_gap) & (gap < BESIDE_MM)
    return _largest(found.reshape(shape))


def _ray_pixels(truth: TrueTree, ours: Mask, walls: Floats, camera: Pose) -> Mask:
    """Return the pixels whose rays pass through lumen of the true branch alone."""
    shape, offset = walls.shape[:2], walls.reshape(-1, 3) - camera.position_lps
    depth = np.linalg.norm(offset, axis=1)
    ray = offset / np.maximum(depth, 1e-9)[:, None]
    near = np.linalg.norm(truth.points - camera.position_lps, axis=1) < FAR_MM + 5.0
    own, other = _tube(truth, near & ours), _tube(truth, near & ~ours)
    found = np.zeros(len(ray), dtype=bool)
    if not len(own[0]):
        return found.reshape(shape)
    for along in np.arange(STEP_MM, FAR_MM, STEP_MM):
        todo = np.flatnonzero(np.isfinite(depth) & ~found & (depth - BEFORE_MM >= along))
        todo = todo[_gap_mm(camera.position_lps + along * ray[todo], *own) <= 0.0]
        if todo.size:
            found[todo] = _gap_mm(camera.position_lps + along * ray[todo], *other) > 0.0
    return _largest(found.reshape(shape))


def _tube(truth: TrueTree, chosen: Mask) -> tuple[Floats, Floats]:
    # Every second point, 0.6 mm apart, is dense enough for the surface.
    chosen = chosen & (np.arange(len(chosen)) % 2 == 0)
    return truth.points[chosen], truth.radius_mm[chosen]


def _gap_mm(points: Floats, line: Floats, radius: Floats) -> Floats:
    """Return the least distance of points outside a tube, mm; negative inside."""
    found = np.full(len(points), np.inf)
    if not len(line):
        return found
    middle = line.mean(axis=0)
    line = line - middle
    for start in range(0, len(points), 4000):
        away = points[start : start + 4000] - middle
        squared = (away**2).sum(axis=1)[:, None] + (line**2).sum(axis=1) - 2.0 * away @ line.T
        found[start : start + 4000] = (np.sqrt(np.maximum(squared, 0.0)) - radius).min(axis=1)
    return found


def _largest(mask: Mask) -> Mask:
    """Return the largest part of a mask that is connected by sides."""
    label = np.where(mask, np.arange(mask.size).reshape(mask.shape) + 1, 0)
    while True:
        padded = np.pad(label, 1)
        around = np.max(
            [padded[1:-1, 1:-1], padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]], axis=0
        )
        grown = np.where(mask, around, 0)
        if np.array_equal(grown, label):
            break
        label = grown
    if not mask.any():
        return mask
    found: Mask = np.equal(label, np.bincount(label[mask]).argmax())
    return found


def _hour(mask: Mask) -> float | None:
    rows, columns = np.nonzero(mask)
    if rows.size < MIN_PX or rows.size > MAX_SHARE * mask.size:
        return None
    half = mask.shape[0] / 2
    return hours_of(float(columns.mean()) + 0.5 - half, float(rows.mean()) + 0.5 - half)


def _apart(one: float, other: float) -> float:
    gap = abs(one - other) % 12.0
    return min(gap, 12.0 - gap)


def summary(rows: Sequence[Row]) -> Row:
    """Return the figures of the rows of one or more cases."""
    given = [row for row in rows if row["hour"] is not None]
    result: Row = {
        "openings": len(rows),
        "given": len(given),
        "straight_ahead": sum(row["straight_ahead"] for row in rows),
        "not_given": sum(row["doubt"] is not None for row in rows) / max(len(rows), 1),
        "without_hour": sum(row["hour"] is None for row in rows) / max(len(rows), 1),
        "doubts": dict(Counter(row["doubt"] for row in rows if row["doubt"] is not None)),
        "given_without_true_opening": sum(row["true"] is None for row in given),
        "straight_but_centre_outside": sum(row["straight_ahead"] and not row["centre_in_true"] for row in rows),
        "dots_in_outline": float(np.mean([row["dots_in_outline"] or 0.0 for row in given])) if given else None,
        "dots_mostly_outside": sum((row["dots_in_outline"] or 0.0) < 0.5 for row in given),
        "shown_is_rounded": all(row["shown"] == whole_hour(row["hour"]) for row in given),
    }
    for name in ("true", "true_by_rays", "outline"):
        errors = [_apart(row["hour"], row[name]) for row in given if row[name] is not None]
        result[name] = {
            "compared": len(errors),
            "within_half": sum(error <= 0.5 for error in errors) / max(len(errors), 1),
            "beyond_one": sum(error > 1.0 for error in errors),
            "worst": max(errors, default=math.nan),
        }
    return result


def run(folder: Path, names: Sequence[str], say: Say, *, width_mm: float = WIDTH_MM) -> list[Row]:
    """Measure cases, report the summary of each case and of all, and return all rows."""
    rows: list[Row] = []
    for name in names:
        for stored, make in _makers(name, say):
            case = found_case(folder, stored, make, say)
            found = list(hour_rows(case, width_mm=width_mm))
            for row in found:
                wrong = row["hour"] is not None and row["true"] is not None and _apart(row["hour"], row["true"]) > 0.5
                if wrong or row["doubt"] is not None:
                    say(json.dumps(row))
            say(f"{stored}: {json.dumps(summary(found))}")
            rows += found
    say(f"all: {json.dumps(summary(rows))}; aims {MIN_WITHIN:g} within half an hour, {MAX_NOT_GIVEN:g} not given")
    return rows


def case_of(folder: Path, name: str) -> PlanCase | None:
    """Return a case with its airways from its name, stored in a folder; None if the data of a patient are missing."""
    say = partial(print, flush=True)
    return next((found_case(folder, stored, make, say) for stored, make in _makers(name, say)), None)


def _makers(name: str, say: Say) -> Iterator[tuple[str, Callable[[], PlanCase]]]:
    if name.startswith("phantom-"):
        yield name, partial(phantom_case, int(name.removeprefix("phantom-")), num=6)
        return
    data = load_settings().data_dir
    if data is None:
        say(f"{name}: no folder of data is set, so the patient cannot be painted")
        return
    yield from patient_cases(data, [name], CONDITION, 36, say)


def main() -> None:
    """Run the command line: measure the turns of each case and print how many clock hours are right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="Folder in which the CTs with their airways are stored.")
    parser.add_argument("cases", nargs="*", help="Cases; default: 20 phantoms and five painted patients.")
    parser.add_argument("--width", type=float, default=WIDTH_MM, help="Least diameter of the airways of a route, mm.")
    options = parser.parse_args()
    names = options.cases or [*(f"phantom-{seed}" for seed in PHANTOM_SEEDS), *PATIENTS]
    run(options.folder, names, partial(print, flush=True), width_mm=options.width)


if __name__ == "__main__":
    main()
