"""``python -m carina_bench.plan_times CASE[@X,Y,Z] ...``: time from the click on a nodule to the plan, and of verdicts.

A case is ``phantom`` (with its nodule), ``patient`` (bundled CT) or the path of a CT; the point, LPS mm, is clicked.
Airways, wall and measures are known before the click, as in the window. The plan includes the drive of its first route,
which is the first verdict. The verdicts are those of all instruments of the library on the best three routes. Without a
point, the targets are balls at random places (``--seed``) of each kind in `PLACES`.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.plan import Nodule, PlanTarget, judge_pairs, plan_route, sphere, target_from_click
from carina.track import AirwayTree
from carina.volume import Volume

__all__ = ["random_places", "run"]

Floats = NDArray[np.float64]

MAX_PLAN_S, MAX_VERDICTS_S = 10.0, 60.0
"""Aims in s on two cores: time from the click to the plan with its first verdict, and for verdicts on three routes."""
PLACES = {
    "near the hilum": ((2, 3), (6.0, 12.0)),
    "middle of the lung": ((4, 5), (8.0, 14.0)),
    "periphery": ((6, 12), (8.0, 18.0)),
    "far from airways": ((3, 12), (22.0, 45.0)),
}
"""Kinds of places: range of the generation of the nearest airway, and of the distance from its centreline in mm."""
BALL_MM, NUM_TRIED, LUNG_HU = 12.0, 6000, (-980.0, -700.0)
"""Diameter of the ball at a random place, number of random voxels that are tried, and range of the lung's density."""


def random_places(volume: Volume, tree: AirwayTree, seed: int) -> dict[str, Floats]:
    """Return a random point (3,) of the lung, LPS mm, for each kind in `PLACES` that the CT contains."""
    rng = np.random.default_rng(seed)
    voxels = np.argwhere((volume.hu_zyx > LUNG_HU[0]) & (volume.hu_zyx < LUNG_HU[1]))
    points = volume.to_lps(voxels[rng.choice(len(voxels), NUM_TRIED)][:, ::-1].astype(np.float64))
    line = np.concatenate([branch.points[::3] for branch in tree.branches])
    generation = np.concatenate([np.full(len(branch.points[::3]), branch.generation) for branch in tree.branches])
    off = [np.linalg.norm(line - point, axis=1) for point in points]
    nearest, away = np.array([row.argmin() for row in off]), np.array([row.min() for row in off])
    found = {}
    for name, ((first, last), (least_mm, most_mm)) in PLACES.items():
        own = (generation[nearest] >= first) & (generation[nearest] <= last) & (away > least_mm) & (away < most_mm)
        if own.any():
            found[name] = points[int(np.argmax(own))]
    return found


def timed(what: str, work: Callable[[], Any]) -> Any:
    """Return the result of ``work``, and print its wall time and its processor time in seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    found = work()
    print(
        f"  {what}: {time.perf_counter() - wall:.1f} s, {time.process_time() - cpu:.1f} s of the processor", flush=True
    )
    return found


def run(case: str, seed: int = 41) -> None:
    """Print the times of one case: click, plan, and verdicts."""
    name, _, place = case.partition("@")
    print(f"{case}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
    at: Any = [float(value) for value in place.split(",")] if place else None
    if name == "phantom":
        made = carina.generate_phantom(seed=4, spacing_mm=1.1, nodule=True)
        volume: Volume = made.volume
        at = made.truth["nodule"]["centre_lps"] if at is None else at
    else:
        volume = carina.demo_patient() if name == "patient" else carina.open_volume(Path(name), progress=False)
    airways = timed("airways", lambda: carina.find_airways(volume, progress=False))
    wall = timed("wall", lambda: carina.wall_field(volume, airways))
    measures = timed("measures", lambda: carina.measure_tree(volume, airways))

    def click() -> Any:
        return target_from_click(volume, at, airways=airways, wall=wall, progress=False)

    def planned(target: PlanTarget | Nodule) -> None:
        """Print the times of the plan to a target and of the verdicts."""
        plan = timed(
            f"plan with its first verdict (aim with the click: {MAX_PLAN_S:g} s)",
            lambda: plan_route(volume, airways, target, wall=wall, measures=measures, confirmed=True, progress=False),
        )
        first = plan.routes[0] if plan.routes else None
        print(f"  {len(plan.routes)} routes, the first one {'none' if first is None else first.outlook}", flush=True)
        if first is not None:
            found = timed(
                f"verdicts on the best three routes (aim: {MAX_VERDICTS_S:g} s)",
                lambda: judge_pairs(airways.tree, plan, wall, progress=False),
            )
            print(f"  {len(found)} verdicts, the best one {found[0].outcome}", flush=True)

    if at is not None:
        planned(timed("click", click))
        return
    for kind, point in random_places(volume, airways.tree, seed).items():
        print(f"  {kind}: a ball of {BALL_MM:g} mm at {','.join(f'{mm:.1f}' for mm in point)}", flush=True)
        planned(sphere(volume, point, BALL_MM))


def main() -> None:
    """Run the command line: print the times of each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="+", metavar="CASE[@X,Y,Z]")
    parser.add_argument("--seed", type=int, default=41, help="Seed of the random places.")
    options = parser.parse_args()
    for case in options.cases:
        run(case, options.seed)


if __name__ == "__main__":
    main()
