"""``carina plan``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.arguments import check_output_file
from carina.cli.console import print_json, progress_printer, say
from carina.cli.opened import check_case_options, opened
from carina.disk import write_whole
from carina.errors import NoResultError
from carina.plan import Plan, PlannedRoute, Verdict, judge_scopes

__all__ = ["report"]

SIGNS = {"into": "an airway leads into it", "beside": "an airway lies against it", "none": "no airway leads to it"}


def report(
    path: Path,
    *,
    target: NDArray[np.float64],
    scope: str,
    tool: str,
    vessel_margin_mm: float,
    moved_mm: float | None,
    all_scopes: bool,
    output: Path | None,
    series: str | None,
    as_json: bool,
    ct: Path | None = None,
) -> int:
    """Plan the ways to one nodule, say them, and write them; 4 if there is none."""
    if output is not None:
        check_output_file(output, ".json")
    check_case_options(path, ct)
    progress = progress_printer()
    source = opened(path, series=series, progress=progress, ct=ct)
    nodule = carina.grow_nodule(source.volume, target)
    say(f"target: {nodule.words}")
    airways = source.airways(progress)
    source.badges.add(airways.badges)
    wall = carina.wall_field(source.volume, airways)
    found = carina.plan_route(
        source.volume,
        airways,
        nodule,
        scope=scope,
        tool=tool,
        vessel_margin_mm=vessel_margin_mm,
        moved_mm=moved_mm,
        wall=wall,
    )
    for line in lines(found):
        say(line)
    verdicts: tuple[Verdict, ...] = ()
    if found.routes:
        scopes = None if all_scopes else [found.scope]
        verdicts = judge_scopes(airways.tree, found, wall, scopes=scopes, spacing_mm=max(source.volume.spacing_mm))
    for verdict in verdicts:
        say(f"{verdict.scope.title} on route 1: {verdict.words}")
    document = found.to_json() | {"verdicts": [verdict.to_json() for verdict in verdicts]}
    if output is not None:
        write_whole(output, (json.dumps(document, indent=1) + "\n").encode(), what="the plan")
        say(f"wrote {output}")
    if as_json:
        print_json(document | {"badges": source.badges.to_json()})
    return 0 if found.routes else NoResultError.exit_code


def lines(plan: Plan) -> list[str]:
    """A plan in words, a line for each route and each doubt."""
    sign = SIGNS[plan.bronchus_sign] + ("" if plan.sign_branch is None else f" ({plan.sign_branch})")
    said = [f"bronchus sign: {sign}"]
    for number, route in enumerate(plan.routes, 1):
        said.append(f"route {number}: {_route_words(plan, route)}")
        said += [f"route {number}: ! {doubt}" for doubt in route.doubts]
    if plan.why is not None:
        said.append(plan.why)
    else:
        said.append(
            f"the CT was taken at inspiration; in the procedure the target may lie up to {plan.moved_mm:.0f} mm off"
        )
    return said


def _route_words(plan: Plan, route: PlannedRoute) -> str:
    leg = route.leg
    place = "" if route.from_carina_mm is None else f", {route.from_carina_mm:.0f} mm beyond the carina"
    fits = "" if route.fits else f" ({plan.scope.title} needs {plan.scope.fit_mm:.1f} mm)"
    vessel = "no vessel seen nearby" if leg.vessel_mm is None else f"nearest vessel {leg.vessel_mm:.1f} mm away"
    moved = "" if leg.hit_share_moved is None else f", {100 * leg.hit_share_moved:.0f} % if the target has moved"
    return (
        f"{route.branch_name}{place}; narrowest {route.narrowest_mm:.1f} mm{fits}; needle path "
        f"{leg.to_target_mm:.1f} mm to the target at {leg.angle_deg:.0f} degrees to the airway, "
        f"{leg.in_target_mm:.1f} mm within it; {vessel}; expected hits {100 * leg.hit_share:.0f} %{moved}; "
        f"score {route.score:.2f}"
    )
