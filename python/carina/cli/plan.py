"""``carina plan``: plan the routes to a target."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.arguments import check_needs, check_output_file, check_range
from carina.cli.console import print_json, print_note, progress_printer
from carina.cli.opened import check_case_options, open_input
from carina.config import load_settings
from carina.disk import ScratchFolder
from carina.errors import NoResultError, UsageError
from carina.export import PLAN_FORMATS, check_plan_file, export_plan, send_plan, write_plan_pdf
from carina.plan import (
    MovementMeasurement,
    Plan,
    PlannedRoute,
    PlanTarget,
    Verdict,
    judge_pairs,
    judge_scopes,
    measure_movement,
    scope_from_file,
    target_from_click,
    target_from_file,
    tool_from_file,
)
from carina.plan import tool as tool_named
from carina.plan.carm import CARM_LIMITS, CArmAngles, carm_angles
from carina.plan.reasons import reasons_against
from carina.plan.report import AGAINST, Paper, PlanMaterials, ReportKind, route_turns, whole_sheet, write_report
from carina.plan.route_stations import STATION_NOTE, route_stations
from carina.plan.routes.predictors import PREDICTOR_WORDS
from carina.plan.target_comparison import ORDER_RULE, ComparedTarget, compare_targets, comparison_lines
from carina.plan.targets.doubts import confirmed_codes
from carina.scopes import scope_preset, scope_presets
from carina.session import LocalStore
from carina.volume.point_check import check_in_volume

if TYPE_CHECKING:
    from carina.cli.console import ProgressCallback
    from carina.export.plan_dicom import Identity
    from carina.track import Airways
    from carina.volume import Volume

ARCHIVE_SUFFIX = ".pdf.dcm"
REPORT_SUFFIXES = (".html", ".pdf", ".json")
PAPERS: Final[dict[str, Paper]] = {"A4": "A4", "Letter": "Letter"}


def report(
    path: Path,
    *,
    target: NDArray[np.float64] | Path,
    structure: str | None,
    part: NDArray[np.float64] | None,
    resample: bool,
    scope: str,
    tool: str,
    vessel_margin_mm: float,
    moved_mm: float | None,
    second_ct: Path | None,
    carina_depth_mm: float | None,
    confirm: str | None,
    all_scopes: bool,
    available: str | None,
    output: Path | None,
    kind: ReportKind,
    paper: str,
    clips: bool,
    identity: Identity,
    send_to: str | None,
    series: str | None,
    strict: bool,
    as_json: bool,
    ct: Path | None = None,
    compare: tuple[NDArray[np.float64], ...] = (),
) -> int:
    """Plan the routes to one target, print and write them; return 4 if there is no route."""
    if output is not None:
        known = (*REPORT_SUFFIXES, *PLAN_FORMATS, ARCHIVE_SUFFIX)
        check_output_file(output, *known)
    name = "" if output is None else output.name.lower()
    if not isinstance(target, Path):
        check_needs("a target from a file; the target is a point", structure=structure, part=part, resample=resample)
    check_range("--vessel-margin-mm", vessel_margin_mm, 0.0, 50.0, "mm")
    confirmed = confirmed_codes(_confirmed_codes(confirm))
    check_range("--moved-mm", moved_mm, 0.0, 60.0, "mm")
    if second_ct is not None and moved_mm is not None:
        raise UsageError("--second-ct measures the movement that --moved-mm states; leave one of them out")
    check_range("--carina-depth-mm", carina_depth_mm, 0.0, 600.0, "mm")
    if not name.endswith((".html", ".pdf")):
        check_needs("a report (-o NAME.html or NAME.pdf)", tracing_sheet=kind == "tracing")
    if not name.endswith((".pdf", ARCHIVE_SUFFIX)):
        check_needs("a report on paper (-o NAME.pdf or NAME.pdf.dcm)", paper=None if paper == "A4" else paper)
    if not name.endswith(".html") or kind == "tracing":
        check_needs("an .html report (-o NAME.html)", no_clips=not clips)
    if not name.endswith(".dcm"):
        check_needs("DICOM files (-o NAME.seg.dcm, NAME.sr.dcm or NAME.pdf.dcm)", with_identity=identity != "none")
    peer = None if send_to is None else _host_and_port(send_to)
    instrument = scope_from_file(scope) if Path(scope).is_file() else scope_preset(scope)
    used = tool_from_file(tool) if Path(tool).is_file() else tool_named(tool)
    all_scopes = all_scopes or available is not None
    here = _available_scopes(available) if all_scopes else None
    if paper not in PAPERS:
        raise UsageError(f"--paper: expected {' or '.join(PAPERS)}; found {paper}")
    check_case_options(path, ct)
    progress = progress_printer()
    source = open_input(path, series=series, strict=strict, progress=progress, ct=ct)
    place = source.place if ct is None else ct
    if output is not None and output.name.lower().endswith((*PLAN_FORMATS, ARCHIVE_SUFFIX)):
        check_plan_file(output, source.volume, place, series=series, identity=identity)
    found: PlanTarget | None = None
    if isinstance(target, Path):
        named = int(structure) if structure is not None and structure.isdecimal() else structure
        found = target_from_file(
            target,
            source.volume,
            structure=named,
            at_lps=part,
            ct=place,
            resample=resample,
            compare_click=True,
            progress=progress,
        )
    else:
        check_in_volume(source.volume, target, "--target", code="plan.point")
    airways = source.airways(progress)
    source.badges.add(airways.badges)
    wall = carina.wall_field(source.volume, airways)
    if not isinstance(target, Path):
        found = target_from_click(source.volume, target, airways=airways, wall=wall, progress=False)
    assert found is not None
    print_note(f"target: {found.words}")
    for note in found.nodule.notes:
        print_note(f"target: {note}")
    measured = None
    if second_ct is not None:
        measured = _measured_movement(second_ct, source.volume, airways, found, progress, strict=strict)
    plan = carina.plan_route(
        source.volume,
        airways,
        found,
        scope=instrument,
        tool=used,
        vessel_margin_mm=vessel_margin_mm,
        moved_mm=moved_mm,
        movement=measured,
        wall=wall,
        confirmed=confirmed,
    )
    for line in lines(plan):
        print_note(line)
    compared: tuple[ComparedTarget, ...] = ()
    if compare:
        plans = [plan]
        for point in compare:
            check_in_volume(source.volume, point, "--compare", code="plan.point")
            other = target_from_click(source.volume, point, airways=airways, wall=wall, progress=False)
            plans.append(
                carina.plan_route(
                    source.volume,
                    airways,
                    other,
                    scope=instrument,
                    tool=used,
                    vessel_margin_mm=vessel_margin_mm,
                    moved_mm=moved_mm,
                    wall=wall,
                    confirmed=confirmed,
                )
            )
        points = [np.array(one.nodule.centre_lps) for one in plans[:1]] + list(compare)
        titles = [f"target {n} ({', '.join(f'{v:.0f}' for v in point)})" for n, point in enumerate(points, 1)]
        compared = compare_targets(plans, titles)
        for line in comparison_lines(compared):
            print_note(f"comparison: {line}")
    carm: CArmAngles | None = None
    if plan.routes:
        carm = carm_angles(source.volume, airways, plan)
        for line in carm.lines:
            print_note(f"C-arm on route 1: {line}")
        print_note(f"C-arm: {CARM_LIMITS}")
        for station in route_stations(airways.tree, plan, plan.routes[0]):
            print_note(f"EBUS: {station.words}")
            for text in station.landmark.doubts:
                print_note(f"EBUS: ! station {station.landmark.station}: {text}")
        print_note(f"EBUS: {STATION_NOTE}")
    verdicts: tuple[Verdict, ...] = ()
    if plan.routes and not plan.routes[0].origin.is_carina:
        # The depth of the carina does not apply to a route that does not pass the carina.
        carina_depth_mm = None
    pairs: tuple[Verdict, ...] = ()
    if plan.routes and all_scopes:
        library = list(scope_presets())
        # An instrument from a file of the user is not in the library, and is available.
        scopes = library if plan.scope in library else [plan.scope, *library]
        if here is not None and plan.scope not in library:
            here = (*here, plan.scope.name)
        pairs = judge_pairs(
            airways.tree,
            plan,
            wall,
            scopes=scopes,
            available=here,
            origin_depth_mm=carina_depth_mm,
        )
        of_first = {pair.scope.name: pair for pair in pairs if pair.route_key == plan.routes[0].key}
        verdicts = tuple(of_first[scope.name] for scope in scopes)
    elif plan.routes:
        verdicts = judge_scopes(airways.tree, plan, wall, scopes=[plan.scope], origin_depth_mm=carina_depth_mm)
    for verdict in verdicts:
        print_note(f"{verdict.scope.title} on route 1: {verdict.words}")
    if pairs:
        print_note(_best_pair(plan, pairs, here))
    materials = PlanMaterials(
        source.volume, airways, wall, plan, verdicts=verdicts, carina_depth_mm=carina_depth_mm, carm=carm
    )
    # Turns are computed first, because a turn without a reliable clock hour is a reason against the plan.
    materials = replace(materials, turns=route_turns(materials))
    against = reasons_against(plan, verdicts=verdicts, turns=materials.turns)
    if against:
        print_note(f"{AGAINST.lower()}:")
    for reason in against:
        # The code of a doubt is what --confirm accepts.
        code = f" ({reason.code})" if reason.code in {doubt.code for doubt in plan.doubts} else ""
        print_note(f"{'!' if reason.severity == 'stop' else '-'} {reason.words}{code}")
    if peer is not None:
        num = send_plan(plan, airways.tree, host=peer[0], port=peer[1])
        print_note(f"sent {num} messages to {send_to}")
    if output is not None and output.name.lower().endswith(tuple(PLAN_FORMATS)):
        export_plan(
            output,
            plan,
            airways.tree,
            volume=source.volume,
            ct=place,
            series=series,
            identity=identity,
            badges=source.badges.notes,
        )
        print_note(f"wrote {output}")
        output = None
    elif output is not None and output.name.lower().endswith(ARCHIVE_SUFFIX):
        with ScratchFolder() as folder:
            page = write_report(folder / "plan.pdf", whole_sheet(materials), paper=PAPERS[paper])
            write_plan_pdf(
                output,
                page.read_bytes(),
                names_patient=False,
                identity=identity,
                volume=source.volume,
                ct=place,
                series=series,
            )
        print_note(f"wrote {output}")
        output = None
    if output is not None or as_json:
        # Only an HTML report can play video clips.
        plays = clips and output is not None and output.name.lower().endswith(".html") and kind == "report"
        sheet = whole_sheet(materials, clips=plays)
        if output is not None:
            write_report(output, sheet, kind=kind, paper=PAPERS[paper])
            print_note(f"wrote {output}")
        if as_json:
            listed = [pair.to_json() | {"available": here is None or pair.scope.name in here} for pair in pairs]
            judged: dict[str, Any] = {"pairs": listed} if all_scopes else {}
            if measured is not None:
                judged["second_ct"] = measured.to_json()
            if compared:
                judged["comparison"] = {"order": ORDER_RULE, "targets": [one.to_json() for one in compared]}
            print_json(sheet.to_json() | {"badges": source.badges.to_json()} | judged)
    return 0 if plan.routes else NoResultError.exit_code


def _measured_movement(
    path: Path, volume: Volume, airways: Airways, target: PlanTarget, progress: ProgressCallback, *, strict: bool
) -> MovementMeasurement:
    """Return the movement of a target that is measured from a second CT or case."""
    second = open_input(path, series=None, strict=strict, progress=progress)
    # The airways of a scan are found only after the checks of its size.
    known = None if second.document is None else second.airways(progress)
    found = measure_movement(volume, airways, target, second.volume, known, progress=progress)
    used = sum(fork.is_used for fork in found.forks)
    print_note(
        f"second CT: {used} of {len(found.forks)} named forks and {found.num_vessels} vessels near the target fit; "
        f"median residual {found.residual_mm:.1f} mm"
    )
    return found


def _confirmed_codes(text: str | None) -> bool | tuple[str, ...]:
    """Return the doubts that ``--confirm`` names: all, or codes separated by commas."""
    if text is None or text == "all":
        return text == "all"
    return tuple(code.strip() for code in text.split(","))


def _available_scopes(text: str | None) -> tuple[str, ...] | None:
    """Return the names of the instruments that ``--available`` or else the stored setting lists; None: all."""
    if text is None:
        stored = LocalStore(load_settings().config_dir).available_scopes()
        return None if stored is None else tuple(one.name for one in scope_presets() if one.name in stored)
    if text.strip() == "all":
        return None
    return tuple(scope_preset(name.strip()).name for name in text.split(","))


def _best_pair(plan: Plan, pairs: tuple[Verdict, ...], here: tuple[str, ...] | None) -> str:
    """Return the best pair of route and instrument as text; the pairs are those of `judge_pairs`."""
    best = pairs[0]
    number = next(n for n, route in enumerate(plan.routes, 1) if route.key == best.route_key)
    of = {pair.scope.name for pair in pairs} if here is None else set(here)
    if best.outcome in {"does not reach", "cannot say"}:
        num, kind = len(of), "" if here is None else "available "
        routes = len({pair.route_key for pair in pairs})
        by = "the only route" if routes == 1 else f"one of the best {routes} routes"
        return f"of {num} {kind}instruments none is known to reach by {by}"
    with_tool = "" if best.tool == plan.tool.name else f" with {tool_named(best.tool).title}"
    return f"best pair: {best.scope.title}{with_tool} on route {number}, which {best.outcome}"


def _host_and_port(words: str) -> tuple[str, int]:
    """Return the host and the port of a text ``host:port``."""
    host, _, port = words.rpartition(":")
    if not host or not port.isdecimal() or len(port) > 5 or not 1 <= int(port) <= 65535:
        raise UsageError(f"--send: expected HOST:PORT, such as 127.0.0.1:18944; found {words!r}")
    return host, int(port)


def lines(plan: Plan) -> list[str]:
    """Return a plan as text, a line for each route and each doubt of a route after the first one."""
    reported = [f"bronchus sign: {plan.sign_words}"]
    for number, route in enumerate(plan.routes, 1):
        reported.append(f"route {number}: {_route_words(plan, route)}")
        if route.predictors is not None:
            reported.append(f"route {number}: {route.predictors.words}")
        if number == 1:
            # The doubts of the first route are already in the list of reasons.
            continue
        reported += [f"route {number}: ! {doubt}" for doubt in route.doubts]
        if route.width.why is not None:
            reported.append(f"route {number}: ! {route.width.why}")
    if any(route.predictors is not None for route in plan.routes):
        reported.append(f"bifurcation angle, least diameter and curvature: {PREDICTOR_WORDS}")
    if plan.why is None:
        reported.append(plan.movement.words)
    return reported


def _route_words(plan: Plan, route: PlannedRoute) -> str:
    leg = route.leg
    needs = f" ({plan.scope.title} needs {plan.scope.fit_mm:.1f} mm)"
    fits = {"fits": "", "may fit": f"{needs}, may fit", "does not fit": f"{needs}, does not fit"}[route.fit]
    return (
        f"{route.branch_name}, {route.place_words}; narrowest {route.width.words}{fits}; needle path "
        f"{leg.to_target_mm:.1f} mm to the target at {leg.angle_deg:.0f} degrees to the airway, "
        f"{leg.in_target_mm:.1f} mm within it; {leg.vessel_words}; {route.hit_words}; "
        f"score {route.score:.2f}"
    )
