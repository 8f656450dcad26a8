"""Sections of a report in the order of reading: target, route, turns, instruments, uncertainties, provenance."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from carina.plan.carm import CARM_LIMITS
from carina.plan.report.blocks import Block, Bullets, Clip, Facts, Figure, Figures, ReportTable, Section, Words
from carina.plan.report.drawing import Drawing, Raster
from carina.plan.report.figures import needle_bar, slice_drawing, tree_drawing
from carina.plan.report.plan_sheet import PlanSheet, target_words
from carina.plan.report.tracing import tracing_drawings
from carina.plan.report.uncertainty import doubt_words
from carina.plan.report.wording import AGAINST, carina_cell, lines_of, per_cent
from carina.plan.route_stations import STATION_NOTE
from carina.plan.routes.last_leg import CROSSED_VESSEL_MM
from carina.plan.routes.plan_route import PlannedRoute, ScoreWeights
from carina.plan.routes.predictors import PREDICTOR_WORDS
from carina.plan.turns.clips import TurnClip
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.pictures import TurnPicture
from carina.plan.turns.texts import joined, moves_words
from carina.plan.turns.turn_list import Turn

PART_WORDS = {
    "misses": "needle passes that miss",
    "way": "distance outside the lumen",
    "angle": "angle to the airway",
    "narrow": "narrowest place",
    "vessels": "vessel within the margin",
    "shallow": "short length in the target",
}
CHECKS = ("diameter", "bend", "length", "channel", "drive", "pointing")
LEGEND = (
    "Slices through the middle of the target, lung window (width 1500, level \u2212600 HU); the patient's right is on "
    "the left of axial and coronal slices. Yellow: outline of the target. Blue: airway lumen."
)
LEGEND_OF_LEG = " Orange: last leg, dotted where it lies outside the slice."
STILLS = (
    "The airway from a diameter before each fork, level, made from the CT without texture. The opening to enter is "
    "outlined."
)
OF_ROUTE = ("plan.verdict", "plan.limit", "needle.", "route.narrowest")
"""Beginnings of the codes of reasons that are listed again in the route's section."""
MAX_LINES_BEFORE_TREE = 4
"""Maximum number of lines of reasons with which the tree fits on the first page, also on Letter in a wide typeface."""
TREE_BELOW_TARGET, TREE_ALONE = 110.0, 330.0
"""Height of the tree in points, on the first page and on a separate page."""
NOT_EXAMINED = "\u2013"
"""Symbol in a table of checks for a check that was not made, because the result of another check decides."""
ANSWERS = {"yes": "yes", "perhaps": "perhaps", "no": "no", "unknown": "?"}


def sections(sheet: PlanSheet) -> tuple[Section, ...]:
    """Return all sections of a report."""
    found = [*_against(sheet), _target(sheet), _way(sheet), *_route(sheet), *_sign(sheet)]
    found += [*_turns(sheet), *_verdicts(sheet), *_others(sheet), *_carm(sheet), *_stations(sheet)]
    found += [_by_hand(sheet), _uncertain(sheet), *_ct(sheet), *_notes(sheet), *_score(sheet), _provenance(sheet)]
    return (*found, *_figures_behind(sheet), *tracing_sections(sheet))


def tracing_sections(sheet: PlanSheet) -> tuple[Section, ...]:
    """Return the sections of the tracing sheet alone."""
    drawings = tracing_drawings(sheet)
    several = len(drawings) > 1
    return tuple(
        Section(
            "tracing" if n == 0 else f"tracing-{n + 1}",
            "Tracing sheet" + (f", {n + 1} of {len(drawings)}" if several else ""),
            (Figure(drawing),),
            starts_page=True,
        )
        for n, drawing in enumerate(drawings)
    )


def _against(sheet: PlanSheet) -> list[Section]:
    """Return the section with the reasons against the plan; an empty list if there is no reason."""
    if not sheet.reasons:
        return []
    warned = tuple(n for n, reason in enumerate(sheet.reasons) if reason.severity == "stop")
    return [Section("against", AGAINST, (Bullets(tuple(one.words for one in sheet.reasons), warned=warned),))]


def _red(sheet: PlanSheet) -> tuple[Block, ...]:
    """Return the blocks with warnings (shown in red) that every view of the target and of the route contains."""
    found = [Words(words, "warning") for words in doubt_words(sheet.plan)]
    route = sheet.route
    if route is not None and route.doubts:
        found.append(Words("Route over doubtful airway: " + "; ".join(route.doubts) + ".", "warning"))
    return tuple(found)


def _target(sheet: PlanSheet) -> Section:
    nodule, place = sheet.plan.nodule, sheet.place
    ml = nodule.volume_mm3 / 1000.0
    digits = 2 if ml >= 0.1 else 3
    diameters = f"{nodule.long_mm:.1f} \u00d7 {nodule.short_mm:.1f} mm, each \u00b1 {nodule.diameter_error_mm:.1f} mm"
    rows = [
        ("Kind", f"{nodule.kind} nodule, {nodule.density_hu:.0f} HU"),
        ("Volume", f"{ml:.{digits}f} \u00b1 {nodule.volume_error_mm3 / 1000.0:.{digits}f} ml"),
        ("Diameters (axial)", diameters),
        ("Lobe", place.lobe or "not known"),
        ("Nearest airway", place.nearest_branch),
        ("To pleura or mediastinum", place.pleura_words),
        (
            "Bronchus sign",
            sheet.plan.sign_words[0].upper() + sheet.plan.sign_words[1:],
        ),
        ("Centre (LPS)", ", ".join(f"{v:.1f}" for v in nodule.centre_lps) + " mm"),
    ]
    if nodule.kind == "part-solid":
        rows.insert(2, ("Of which solid", f"{nodule.solid_mm3 / 1000.0:.{digits}f} ml"))
    figures = tuple(Figure(slice_drawing(one)) for one in sheet.slices)
    blocks = (
        *_red(sheet),
        Words(_lead(sheet), "lead"),
        Facts(tuple(rows)),
        Figures(figures, 3),
        Words(LEGEND + (LEGEND_OF_LEG if sheet.route is not None else ""), "quiet"),
    )
    return Section("target", "Target", blocks)


def _lead(sheet: PlanSheet) -> str:
    """Return the summary sentence at the beginning of the report."""
    plan, route = sheet.plan, sheet.route
    nodule = target_words(sheet)
    nodule = nodule[0].upper() + nodule[1:]
    if route is None:
        return f"{nodule}. No route with {plan.tool.title} was found."
    tip = f"Tip in {route.branch_name}, {route.place_words}"
    text = f"{nodule}. {tip}, then {route.leg.to_target_mm:.0f} mm with the needle."
    if not sheet.verdicts:
        return text
    num = {name: sum(one.outcome == name for one in sheet.verdicts) for name in ("reaches", "may reach", "cannot say")}
    best = next((one for name in num for one in sheet.verdicts if one.outcome == name), None)
    of = _instruments(len(sheet.verdicts))
    reach = "1 reaches" if num["reaches"] == 1 else f"{num['reaches']} reach"
    counts = [reach] * bool(num["reaches"]) + [f"{num['may reach']} may reach"] * bool(num["may reach"])
    unknown = f"{num['cannot say']} cannot be judged"
    if not counts:
        judged = (
            f"Of {of} none is known to reach on this route; {unknown}."
            if num["cannot say"]
            else f"Of {of} none reaches on this route."
        )
    else:
        assert best is not None
        said_of = ", ".join(counts + [unknown] * bool(num["cannot say"]))
        judged = f"Of {of}: {said_of}. First of them: {best.scope.title}, which {best.outcome}."
    return f"{text} {judged}"


def _instruments(num: int) -> str:
    return "1 instrument" if num == 1 else f"{num} instruments"


def _way(sheet: PlanSheet) -> Section:
    words, title = "Orange: target. Red: drawn by hand or bridged.", "Airways and target"
    if sheet.route is not None:
        words = "Blue: the route, with its forks by number. Orange: last leg and target. Red: drawn by hand or bridged."
        title = "Airways and route"
    no_route = (Words(words, "quiet"), _tree_figures(sheet))
    return Section("airways", title, no_route, starts_page=_is_tree_after_page_one(sheet))


def _route(sheet: PlanSheet) -> list[Section]:
    plan, route = sheet.plan, sheet.route
    if route is None:
        why = plan.why or "no route was found"
        no_route: list[Block] = [Words(why[0].upper() + why[1:] + ("" if why.endswith(".") else "."), "warning")]
        if plan.nearest is not None:
            near = plan.nearest
            place = (
                ("Nearest airway found", near.branch_name),
                ("From its middle to the target", f"{near.gap_mm:.0f} mm"),
                ("Its width there", f"{near.width_mm:.1f} mm"),
                ("Place (LPS)", ", ".join(f"{v:.1f}" for v in near.place_lps) + " mm"),
            )
            no_route.append(Facts(place))
        return [Section("route", "No route", tuple(no_route))]
    leg = route.leg
    fits = f"{route.width.words}; the scope needs {plan.scope.fit_mm:.1f} mm"
    least = f"{leg.in_target_mm:.0f} mm as aimed, at least {leg.least_in_target_mm:.0f} mm within the needle's errors"
    vessel = "none seen nearby" if leg.vessel_mm is None else f"{leg.vessel_mm:.1f} mm from the needle's line"
    vessel = "on the needle's line" if leg.crosses_vessel else vessel
    beyond = "more than 10 mm" if leg.beyond_mm is None else f"{leg.beyond_mm:.0f} mm"
    rows = (
        ("Tip of the scope", f"in {route.branch_name}"),
        *((("Aim", f"{route.aim + 1} of {len(plan.aims)} in this target"),) if len(plan.aims) > 1 else ()),
        ("Past the main carina", carina_cell(route.from_carina_mm)),
        ("Narrowest diameter", f"{fits}: {route.fit}"),
        ("Sharpest bend", f"{route.bend_deg:.0f}\u00b0 over the scope's rigid tip and bending section"),
        *((("Predictors*", route.predictors.words),) if route.predictors is not None else ()),
        ("Tool", plan.tool.title),
        ("To the target's edge", f"{leg.to_target_mm:.1f} mm, of which {leg.outside_mm:.1f} mm outside the lumen"),
        ("Angle to the airway", f"{leg.angle_deg:.0f}\u00b0"),
        ("Length in the target", least),
        ("Beyond the target", f"{beyond} to pleura or mediastinum"),
        (f"Vessels within {plan.vessel_margin_mm:g} mm", _vessel_words(route)),
        ("Nearest vessel", vessel),
        *(
            (
                ("Needle passes that hit", f"{per_cent(route.hit_share)} where the CT shows the target"),
                ("If the target has moved", f"{per_cent(route.hit_share_moved)}, {plan.movement.region_words}"),
            )
            if route.hit_share is not None
            else (("Needle passes that hit", per_cent(None)),)
        ),
    )
    first = "First route" if sheet.route_number == 1 else f"Route {sheet.route_number}"
    title = f"{first} at a glance"
    blocks: list[Block] = [*_red(sheet)]
    blocks += [
        Words(reason.words, "warning")
        for reason in sheet.reasons
        if reason.severity == "stop" and reason.code.startswith(OF_ROUTE)
    ]
    blocks += [
        Facts(rows),
        *((Words(f"* {PREDICTOR_WORDS}", "quiet"),) if route.predictors is not None else ()),
        Figure(needle_bar(leg, plan.tool), "Tissue on the needle's way in order, mm from the scope's tip."),
    ]
    if sheet.needle_slice is not None:
        words = "CT in the plane of the needle, which points to the right; the airway comes from the left and above."
        blocks.append(Figures((Figure(slice_drawing(sheet.needle_slice), words),), 1))
    return [Section("route", title, tuple(blocks), starts_page=True)]


def _vessel_words(route: PlannedRoute) -> str:
    """Return the vessels near the needle in words, such as *0.5 mm off at 6 mm, 2.1 mm off at 14 mm from the tip*."""
    near = route.leg.vessels
    if not near:
        return "none seen"
    off = ["crossed" if one.distance_mm < CROSSED_VESSEL_MM else f"{one.distance_mm:.1f} mm off" for one in near]
    return ", ".join(f"{words} at {one.at_mm:.0f} mm" for words, one in zip(off, near, strict=True)) + " from the tip"


def _vessel_cell(route: PlannedRoute) -> str:
    if route.leg.vessel_mm is None:
        return "none seen"
    return "crossed" if route.leg.crosses_vessel else f"{route.leg.vessel_mm:.1f} mm"


def _num_lines(sheet: PlanSheet) -> int:
    """Return the number of lines of the reasons against the plan and of the warnings in the section of the target."""
    texts = [reason.words for reason in sheet.reasons]
    return sum(len(lines_of(text, 9.0, 500.0)) for text in texts) + 2 * len(_red(sheet))


def _is_tree_after_page_one(sheet: PlanSheet) -> bool:
    """Return whether the tree is on a separate page, because the reasons leave no room on the first page."""
    return _num_lines(sheet) > MAX_LINES_BEFORE_TREE


def _tree_figures(sheet: PlanSheet) -> Figures:
    sides = (("front", "From the front"), ("left", "From the patient's left"))
    # On the first page the tree is small, so that it fits there below the reasons and the target.
    height = TREE_ALONE if _is_tree_after_page_one(sheet) else TREE_BELOW_TARGET
    drawn = [
        Figure(tree_drawing(sheet.shape, sheet.forks, side, width=255.0, height=height), words) for side, words in sides
    ]
    return Figures(tuple(drawn), 2)


def _sign(sheet: PlanSheet) -> list[Section]:
    if not sheet.sign_slices:
        return []
    text = f"Bronchus sign: {sheet.plan.sign_words}. The cross marks where it shows."
    figures = tuple(Figure(slice_drawing(one)) for one in sheet.sign_slices)
    return [Section("bronchus-sign", "Bronchus sign", (Words(text), Figures(figures, 3)))]


def _turns(sheet: PlanSheet) -> list[Section]:
    if sheet.turns is None or sheet.route is None:
        return []
    other_operator: Operator = "facing" if sheet.operator == "head" else "head"
    rows: list[tuple[str, ...]] = []
    warned = []
    for number, turn in enumerate(sheet.turns.turns, 1):
        if turn.cautions:
            warned.append(number - 1)
        rows.append(
            (
                str(number),
                _enter_words(turn, sheet.operator),
                _hour(turn, sheet.operator),
                _hour(turn, other_operator),
                "carina" if turn.at_main_carina else _rounded(turn.from_carina_mm),
                f"{turn.from_fork_mm:.0f}",
                turn.opening.cell,
                f"{turn.angle_deg:.0f}\u00b0",
                "not calculated" if turn.moves is None else moves_words(turn.moves),
            )
        )
    park = _rounded(sheet.turns.park_from_carina_mm)
    doing = moves_words(sheet.turns.park_moves or ())
    past = sheet.turns.park_from_fork_mm
    # The tip may stop before a ridge that lies beyond the fork of the airways' axes.
    behind = f"{past:.0f}" if past > -0.5 else f"{-past:.0f} before it"
    rows.append(("", "stop: tip of the scope", "", "", park, behind, "", "", doing))
    first, second = (name.capitalize() for name in (sheet.operator, other_operator))
    head = ("", "Enter", first, second, "From carina, mm", "From last fork, mm", "Opening, mm", "Turn", "Hand")
    shares = (0.04, 0.18, 0.075, 0.075, 0.09, 0.095, 0.09, 0.065, 0.29)
    text = (
        "Clock hours as seen by an operator at the patient's head, and facing the patient. Distances along the route."
    )
    blocks: list[Block] = [*_red(sheet), Words(text, "quiet"), ReportTable(head, tuple(rows), shares, tuple(warned))]
    if sheet.turns.carina_depth_mm is not None:
        deep = sheet.turns.park_depth_estimate_mm
        stop = "" if deep is None else f"; the tip stops at about {deep / 10.0:.0f} cm"
        depth = f"Main carina at {sheet.turns.carina_depth_mm / 10.0:.1f} cm from nose or mouth{stop} (estimates)."
        blocks.append(Words(depth, "quiet"))
    if sheet.turn_pictures:
        clips = sheet.turn_clips or (None,) * len(sheet.turn_pictures)
        stills = tuple(
            Figure(_still(one), f"{n}. {one.words}", None if clip is None else _clip(clip))
            for n, (one, clip) in enumerate(zip(sheet.turn_pictures, clips, strict=True), 1)
        )
        blocks += [Words(STILLS, "quiet"), Figures(stills, 3)]
    return [Section("turns", "Turns", tuple(blocks))]


def _enter_words(turn: Turn, operator: Operator) -> str:
    """Return the branch to enter in words, such as *RB4a, just past RB4, not RB4b (9 o'clock)*."""
    text = [turn.to_branch]
    if turn.through:
        text.append(f"just past {joined(turn.through)}")
    if turn.others:
        text.append(f"not {joined([f'{one.name} ({one.direction(operator)})' for one in turn.others])}")
    doubts = f" ({'; '.join(turn.cautions)})" if turn.cautions else ""
    return ", ".join(text) + doubts


def _hour(turn: Turn, operator: Operator) -> str:
    hour = turn.hour(operator)
    if hour is None:
        return "ahead" if turn.straight_ahead else "not given"
    return str(hour)


def _rounded(mm: float | None) -> str:
    if mm is None:
        return "not known"
    return f"{mm:.0f}" if mm > -0.5 else f"{-mm:.0f} above"


def _still(one: TurnPicture) -> Drawing:
    height, width = one.rgb.shape[:2]
    picture = Raster((0.0, 0.0), (width, height), one.png())
    return Drawing(width, height, (picture,), f"Airway view before the turn into {one.words}")


def _clip(one: TurnClip) -> Clip:
    return Clip(one.strip(), len(one.frames), one.duration_s, f"to the turn into {one.turn.to_branch}")


def _verdicts(sheet: PlanSheet) -> list[Section]:
    if not sheet.verdicts:
        return []
    order = {"reaches": 0, "may reach": 1, "cannot say": 2, "does not reach": 3}
    ranked = sorted(sheet.verdicts, key=lambda one: (order[one.outcome], -(one.share or 0.0)))
    rows = []
    for one in ranked:
        answers = {str(check.name): ANSWERS[check.answer] for check in one.checks}
        chance = f" ({per_cent(one.share)})" if one.outcome == "may reach" and one.share is not None else ""
        rows.append(
            (
                one.scope.title,
                f"{one.outcome}{chance}",
                *(answers.get(name, NOT_EXAMINED) for name in CHECKS),
                one.words.removeprefix(f"{one.outcome}: "),
            )
        )
    head = ("Instrument", "Verdict", "Width", "Bend", "Length", "Channel", "Drive", "Aim", "What decides")
    shares = (0.17, 0.11, 0.075, 0.075, 0.07, 0.085, 0.075, 0.075, 0.265)
    text = (
        f"On this route, with {sheet.plan.tool.title}. ?: not known; {NOT_EXAMINED}: not examined, since another check "
        "decides. The figures behind each answer, and what they rest on, are listed at the end."
    )
    return [
        Section(
            "instruments",
            "Instruments",
            (Words(text, "quiet"), ReportTable(head, tuple(rows), shares)),
            starts_page=True,
        )
    ]


def _others(sheet: PlanSheet) -> list[Section]:
    routes = sheet.plan.routes
    if not routes:
        return []
    head = (
        "",
        *(f"Route {n}" + (" (this report)" if n == sheet.route_number else "") for n in range(1, len(routes) + 1)),
    )
    rows = [(name, *(tell(sheet, route) for route in routes)) for name, tell in _COMPARED]
    if len(sheet.plan.aims) > 1:
        rows.insert(0, ("Aim", *(f"{route.aim + 1} of {len(sheet.plan.aims)}" for route in routes)))
    doubts = [f"Route {n}: {doubt}." for n, route in enumerate(routes, 1) for doubt in route.doubts]
    share = 0.76 / len(routes)
    blocks: list[Block] = [ReportTable(head, tuple(rows), (0.24, *(share,) * len(routes)))]
    if any(route.predictors is not None for route in routes):
        blocks.append(Words(f"* {PREDICTOR_WORDS}", "quiet"))
    if doubts:
        blocks.append(Bullets(tuple(doubts), "warning"))
    return [Section("routes", "Routes side by side", tuple(blocks))]


_COMPARED: tuple[tuple[str, Callable[[PlanSheet, PlannedRoute], str]], ...] = (
    ("Tip of the scope in", lambda _, r: r.branch_name),
    ("Past the main carina", lambda _, r: carina_cell(r.from_carina_mm)),
    (
        "Narrowest diameter",
        lambda s, r: r.width.words + ("" if r.fits else f" (needs {s.plan.scope.fit_mm:.1f}: {r.fit})"),
    ),
    (
        "By figures, this scope",
        lambda _, r: r.outlook + (f" ({per_cent(r.chance)})" if r.outlook == "may reach" else ""),
    ),
    ("Sharpest bend", lambda _, r: f"{r.bend_deg:.0f}\u00b0"),
    ("Bifurcation angle*", lambda _, r: "not known" if r.predictors is None else r.predictors.angle_words),
    ("Least, last 20 mm*", lambda _, r: "not known" if r.predictors is None else r.predictors.width.words),
    ("Curvature, last 20 mm*", lambda _, r: "not known" if r.predictors is None else r.predictors.curvature_words),
    ("To the target's edge", lambda _, r: f"{r.leg.to_target_mm:.1f} mm"),
    ("Angle to the airway", lambda _, r: f"{r.leg.angle_deg:.0f}\u00b0"),
    ("Length in the target", lambda _, r: f"{r.leg.in_target_mm:.0f} mm"),
    ("Nearest vessel", lambda _, r: _vessel_cell(r)),
    ("Needle passes that hit", lambda _, r: per_cent(r.hit_share)),
    ("If the target has moved", lambda _, r: per_cent(r.hit_share_moved)),
    ("Tissue on the way", lambda _, r: _crossed_words(r)),
    ("Score (1 is best)", lambda _, r: f"{r.score:.2f}"),
)


def _carm(sheet: PlanSheet) -> list[Section]:
    if sheet.carm is None:
        return []
    blocks: list[Block] = []
    if sheet.carm.why is not None:
        blocks.append(Words(f"{sheet.carm.why[0].upper()}{sheet.carm.why[1:]}.", "warning"))
    if sheet.carm.angles:
        rows = tuple(
            (
                one.name,
                f"{one.target_clear_mm:.0f} mm",
                f"{one.tip_clear_mm:.0f} mm",
                f"{one.tilt_deg:.0f}\u00b0",
            )
            for one in sheet.carm.angles
        )
        head = ("C-arm", "Target clear by", "Tip clear by", "Last branch out of the picture")
        blocks.append(ReportTable(head, rows, (0.31, 0.2, 0.2, 0.29)))
    if sheet.carm.notes:
        blocks.append(Bullets(tuple(f"{note[0].upper()}{note[1:]}." for note in sheet.carm.notes), "warning"))
    blocks.append(Words(CARM_LIMITS, "quiet"))
    return [Section("c-arm", "C-arm angles", tuple(blocks))]


def _stations(sheet: PlanSheet) -> list[Section]:
    if sheet.route is None:
        return []
    note = Words(STATION_NOTE, "quiet")
    if not sheet.stations:
        none = Words("The route passes no landmark of a lymph node station, and none is next to the target.")
        return [Section("ebus", "Lymph node stations (EBUS)", (none, note))]
    rows = []
    warned = []
    for n, one in enumerate(sheet.stations):
        hour = one.landmark.clock_head if sheet.operator == "head" else one.landmark.clock_facing
        clock = "not given" if hour is None else f"{round(hour) or 12}"
        rows.append((one.landmark.station, one.landmark.seen_from, one.place_words, clock, one.relation))
        if one.landmark.doubts:
            warned.append(n)
    head = ("Station", "Seen from", "Landmark", "Clock hour", "Relation")
    doubts = tuple(f"{one.landmark.station}: {doubt}." for one in sheet.stations for doubt in one.landmark.doubts)
    blocks: list[Block] = [ReportTable(head, tuple(rows), (0.1, 0.24, 0.24, 0.12, 0.3), tuple(warned))]
    if doubts:
        blocks.append(Bullets(doubts, "warning"))
    return [Section("ebus", "Lymph node stations (EBUS)", (*blocks, note))]


def _crossed_words(route: PlannedRoute) -> str:
    names = []
    for one in route.leg.crossed:
        names.append(one.tissue)
        if one.tissue == "target":
            break
    return ", ".join(names)


def _by_hand(sheet: PlanSheet) -> Section:
    none = Words("Nothing: every airway of this report was found in the CT.")
    return Section("by-hand", "Drawn by hand", (Bullets(sheet.by_hand, "warning") if sheet.by_hand else none,))


def _uncertain(sheet: PlanSheet) -> Section:
    return Section("uncertain", "What is uncertain", (Bullets(sheet.uncertain),))


def _ct(sheet: PlanSheet) -> list[Section]:
    """Return the statement on the CT: what limits the airways that can be seen in it."""
    found = sheet.assessment
    if found is None:
        return []
    rows = tuple(
        (one.name.capitalize(), one.words + (" (limits the airways)" if one.limits else "")) for one in found.statement
    )
    trusted = f"{found.trusted_words[0].upper()}{found.trusted_words[1:]}."
    return [Section("ct", "The CT", (Words(trusted), Facts(rows)))]


def _notes(sheet: PlanSheet) -> list[Section]:
    return [Section("notes", "Notes", (Bullets(sheet.notes),))] if sheet.notes else []


def _score(sheet: PlanSheet) -> list[Section]:
    if sheet.route is None:
        return []
    weights = sheet.plan.weights
    total = sum(getattr(weights, field.name) for field in dataclasses.fields(ScoreWeights))
    rows = []
    for name, part in sheet.route.parts.items():
        weight = getattr(weights, name) / total
        rows.append((PART_WORDS.get(name, name), f"{part:.2f}", f"{100 * weight:.0f} %", f"{weight * part:.3f}"))
    rows.append(("score: 1 less the sum", "", "", f"{sheet.route.score:.2f}"))
    text = (
        "Each part is 0 at its best and 1 at its worst. The weights are a choice, not fitted to outcomes; they can be "
        "changed when planning."
    )
    grid = ReportTable(("Part", "Value", "Weight", "Costs"), tuple(rows), (0.49, 0.17, 0.17, 0.17))
    return [Section("score", "How the route was scored", (Words(text, "quiet"), grid))]


def _figures_behind(sheet: PlanSheet) -> list[Section]:
    if not sheet.verdicts:
        return []
    rows: list[tuple[str, ...]] = []
    for one in sheet.verdicts:
        for n, check in enumerate(one.checks):
            name = one.scope.title if n == 0 else ""
            rows.append((name, check.name, ANSWERS[check.answer], check.words, check.basis))
        if one.would is not None:
            rows.append(("", "", "", one.would, ""))
    text = "Basis of a figure: s, read in a published source; k, common knowledge that was not checked with the maker."
    head = ("Instrument", "Check", "Answer", "What was found", "Rests on")
    grid = ReportTable(head, tuple(rows), (0.17, 0.09, 0.09, 0.36, 0.29))
    return [Section("figures", "Figures behind the verdicts", (Words(text, "quiet"), grid))]


def _provenance(sheet: PlanSheet) -> Section:
    made, plan = sheet.provenance, sheet.plan
    (nz, ny, nx), (sx, sy, sz) = made.shape_zyx, made.spacing_mm
    rows = [
        ("Made by", f"Carina {made.version}, {made.made_on}"),
        ("Scan", f"{made.scan_format}" + (f", {made.series}" if made.series else "")),
        ("Voxels", f"{nx} \u00d7 {ny} \u00d7 {nz} of {sx:.2f} \u00d7 {sy:.2f} \u00d7 {sz:.2f} mm"),
        ("Digest of the voxels", made.ct_digest),
        ("Planned for", f"{plan.scope.title} ({plan.scope.basis}), {plan.tool.title} ({plan.tool.basis})"),
        ("Space", "LPS, mm: x to the patient's left, y to the back, z to the head"),
    ]
    return Section("provenance", "How this report was made", (Facts(tuple(rows)),))
