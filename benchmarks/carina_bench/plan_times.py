"""``python -m carina_bench.plan_times CASE[@X,Y,Z] ...``: time from the click on a nodule to the plan, and of verdicts.

A case is ``phantom`` (with its nodule), ``patient`` (bundled CT) or the path of a CT; the point, LPS mm, is clicked.
Airways, wall and measures are known before the click, as in the window. The plan includes the drive of its first route,
which is the first verdict. The verdicts are those of all instruments of the library on the best three routes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import carina
from carina.plan import judge_pairs, plan_route, target_from_click
from carina.volume import Volume

__all__ = ["run"]

MAX_PLAN_S, MAX_VERDICTS_S = 10.0, 60.0
"""Limits to be reached on two cores: seconds from the click to the plan with its first verdict, and of the verdicts."""


def timed(what: str, work: Callable[[], Any]) -> Any:
    """Return the result of ``work``, and print its wall time and its processor time in seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    found = work()
    print(
        f"  {what}: {time.perf_counter() - wall:.1f} s, {time.process_time() - cpu:.1f} s of the processor", flush=True
    )
    return found


def run(case: str) -> None:
    """Print the times of one case: click, plan, and verdicts."""
    name, _, place = case.partition("@")
    print(case, flush=True)
    at: Any = [float(value) for value in place.split(",")] if place else None
    if name == "phantom":
        made = carina.generate_phantom(seed=4, spacing_mm=1.1, nodule=True)
        volume: Volume = made.volume
        at = made.truth["nodule"]["centre_lps"] if at is None else at
    else:
        volume = carina.demo_patient() if name == "patient" else carina.open_volume(Path(name), progress=False)
    if at is None:
        raise SystemExit(f"{case}: write the clicked point as {name}@X,Y,Z")
    airways = timed("airways", lambda: carina.find_airways(volume, progress=False))
    wall = timed("wall", lambda: carina.wall_field(volume, airways))
    measures = timed("measures", lambda: carina.measure_tree(volume, airways))

    def click() -> Any:
        return target_from_click(volume, at, airways=airways, wall=wall, progress=False)

    target = timed("click", click)
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


def main() -> None:
    """Run the command line: print the times of each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="+", metavar="CASE[@X,Y,Z]")
    for case in parser.parse_args().cases:
        run(case)


if __name__ == "__main__":
    main()
