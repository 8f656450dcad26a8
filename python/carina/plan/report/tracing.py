"""Tracing sheet for the procedure: the route as a bronchial diagram with a clock face at each fork."""

from __future__ import annotations

import itertools
import math

from carina.plan.report.colours import ACCENT, INK, LEG, PALE, QUIET, WARNING
from carina.plan.report.drawing import Disc, Drawing, Label, LineStyle, Place, Shape, Stroke
from carina.plan.report.plan_sheet import Fork, PlanSheet
from carina.plan.report.wording import lines_of
from carina.plan.routes.main_carina import carina_words
from carina.plan.turns.texts import joined, moves_words

__all__ = ["TRACING_SIZE", "tracing_drawings"]

TRACING_SIZE = (520.0, 640.0)
"""Width and height of a page of the tracing sheet, in points; the size fits A4 and Letter."""
MOST_FORKS = 12
"""Largest number of forks on one page of the tracing sheet; a longer route continues on the next page."""
SPINE, CLOCK, TEXT = 84.0, 196.0, 226.0
"""Horizontal positions of diagram, clock faces and text from the left edge of the page, in points."""
TOP, NOTES_MM = 62.0, 92.0
SWAY, SWAY_MOST = 26.0, 34.0
MOST_LINES = 7
"""Largest number of lines of text beside a fork."""
TUBE = 10.0
SMALL = 9.0
"""Font size in points of the text below a name."""


def tracing_drawings(sheet: PlanSheet) -> tuple[Drawing, ...]:
    """Return the tracing sheet on as few pages as possible; empty if the plan has no route."""
    if sheet.route is None:
        return ()
    num_pages = max(math.ceil(len(sheet.forks) / MOST_FORKS), 1)
    size = math.ceil(len(sheet.forks) / num_pages)
    pages = [sheet.forks[n * size : (n + 1) * size] for n in range(num_pages)]
    return tuple(_page(sheet, forks, is_last=n == num_pages - 1) for n, forks in enumerate(pages))


def _page(sheet: PlanSheet, forks: tuple[Fork, ...], *, is_last: bool) -> Drawing:
    width, height = TRACING_SIZE
    notes_top = height - NOTES_MM
    step = min((notes_top - TOP - 14.0) / (len(forks) + is_last), 74.0)
    shapes: list[Shape] = [*_head(sheet), *_diagram(sheet, forks, step, is_last=is_last)]
    for n, fork in enumerate(forks):
        y = TOP + (n + 0.5) * step
        if n:
            shapes.append(Stroke(((CLOCK - 22, y - 0.5 * step), (width, y - 0.5 * step)), LineStyle(PALE, 0.6)))
        shapes += _clock_face(fork, sheet, y, min(16.0, 0.38 * step))
        shapes += _fork_words(fork, sheet, y, step)
    if is_last:
        shapes += _end_words(sheet, TOP + (len(forks) + 0.5) * step)
    shapes += _notes(sheet, notes_top)
    return Drawing(
        width, height, tuple(shapes), "Tracing sheet: the route fork by fork, from the trachea to the target"
    )


def _head(sheet: PlanSheet) -> list[Shape]:
    width, _ = TRACING_SIZE
    plan, place = sheet.plan, sheet.place
    where = " ".join(
        part for part in (place.lobe, f"near {place.nearest_branch}" if place.nearest_branch else "") if part
    )
    seen = {
        "head": "operator at the patient's head: anterior at 12, patient's right at 3",
        "facing": "operator facing the patient: posterior at 12, patient's left at 3",
    }
    return [
        Label((0, 14), f"{plan.nodule.words[0].upper()}{plan.nodule.words[1:]}", 12.0, LEG, bold=True),
        Label((0, 29), where or "lobe not known", 9.5, INK),
        Label((width, 14), f"{plan.scope.title} + {plan.tool.title}", 9.5, INK, "end", bold=True),
        Label((width, 29), "distances along the route; zero at the main carina", 8.5, QUIET, "end"),
        Label((0, 45), f"Clock hours: {seen[sheet.operator]}", 8.5, ACCENT),
        Stroke(((0, 52), (width, 52)), LineStyle(INK, 0.8)),
    ]


def _diagram(sheet: PlanSheet, forks: tuple[Fork, ...], step: float, *, is_last: bool) -> list[Shape]:
    """Return the shapes of the bronchial diagram; each tube leans to the side of the opening in the picture."""
    places: list[Place] = [(SPINE, TOP - 6.0)]
    x = SPINE
    leans = [_lean(fork, sheet) for fork in forks]
    for n in range(len(forks) + is_last):
        if n:
            x = SPINE + max(-SWAY_MOST, min(SWAY_MOST, 0.5 * (x - SPINE) + SWAY * leans[n - 1]))
        places.append((x, TOP + (n + 0.5) * step))
    if not is_last:
        places.append((x, TOP + len(forks) * step))
    stubs, names = [], []
    for n, fork in enumerate(forks):
        (fx, fy), side = places[n + 1], -1.0 if leans[n] > 0.0 else 1.0
        for k, name in enumerate(fork.others[:2]):
            end = (fx + side * 30.0, fy + 0.30 * step - 11.0 * k)
            stubs.append(((fx, fy), end))
            anchor = "start" if side > 0 else "end"
            names.append(Label((end[0] + side * 8.0, end[1] + 3.0), _short(name), 7.5, QUIET, anchor))  # type: ignore[arg-type]
    way = tuple(places[: len(forks) + 1 + is_last] if is_last else places)
    shapes: list[Shape] = []
    for colour, extra in ((QUIET, 2.0), ("#ffffff", 0.0)):
        shapes += [Stroke(stub, LineStyle(colour, 0.6 * TUBE + extra)) for stub in stubs]
        shapes.append(Stroke(way, LineStyle(colour, TUBE + extra)))
    # From each fork the route leads into the branch that is named there, so the fork's warnings colour the next piece.
    for n, piece in enumerate(itertools.pairwise(way)):
        warned = n > 0 and bool(forks[n - 1].warnings)
        shapes.append(Stroke(piece, LineStyle(WARNING, 2.2, dash=(4.0, 3.5)) if warned else LineStyle(ACCENT, 2.2)))
    shapes += names
    for n, fork in enumerate(forks):
        drawn = bool(fork.warnings)
        shapes.append(Disc(places[n + 1], 8.0, LineStyle(WARNING if drawn else ACCENT, 1.4, fill="#ffffff")))
        x, y = places[n + 1]
        shapes.append(Label((x, y + 3.3), str(fork.number), 9.0, WARNING if drawn else ACCENT, "middle", bold=True))
    if is_last:
        shapes += _target(places[-1], step)
    if forks:
        shapes.append(Label((SPINE - 14.0, TOP), _short(forks[0].from_name), 7.5, QUIET, "end"))
    return shapes


def _target(at: Place, step: float) -> list[Shape]:
    x, y = at
    tip = (x, y - 0.22 * step)
    middle = (x + 30.0, y + 4.0)
    return [
        Disc(middle, 13.0, LineStyle(LEG, 1.6, fill="#fbe3d3")),
        Stroke((tip, middle), LineStyle(LEG, 2.0, dash=(4.0, 3.0))),
        Disc(tip, 3.6, LineStyle(INK, 0.8, fill=ACCENT)),
        Disc(middle, 1.8, LineStyle(None, fill=LEG)),
    ]


def _lean(fork: Fork, sheet: PlanSheet) -> float:
    """Return the side of a fork's opening in the picture, -1 (left) to 1 (right); 0 if straight ahead or unknown."""
    hours = None if fork.turn is None else fork.turn.clock(sheet.operator)
    return 0.0 if hours is None else math.sin(math.radians(30.0 * hours))


def _clock_face(fork: Fork, sheet: PlanSheet, y: float, radius: float) -> list[Shape]:
    """Return a clock face with the openings of a fork at their hours."""
    shapes: list[Shape] = [Disc((CLOCK, y), radius, LineStyle(INK, 1.0, fill="#ffffff"))]
    for hour in range(12):
        long = 0.2 if hour % 3 == 0 else 0.1
        shapes.append(
            Stroke((_on_face(y, radius, hour, 1.0 - long), _on_face(y, radius, hour, 1.0)), LineStyle(INK, 0.6))
        )
    turn = fork.turn
    if turn is None:
        shapes.append(Label((CLOCK, y + 3.5), "?", 10.0, QUIET, "middle"))
        return shapes
    for other in turn.others:
        if not other.in_view:
            continue
        seen = other.hour(sheet.operator)
        at = (CLOCK, y) if seen is None else _on_face(y, radius, seen, 0.55)
        shapes.append(Disc(at, 0.24 * radius, LineStyle(QUIET, 0.7, fill="#ffffff")))
    hours = turn.clock(sheet.operator)
    if hours is None:
        if turn.straight_ahead:
            shapes.append(Disc((CLOCK, y), 0.3 * radius, LineStyle(ACCENT, 0.8, fill=ACCENT)))
        else:
            shapes.append(Label((CLOCK, y + 3.5), "?", 10.0, WARNING, "middle"))
        return shapes
    shapes.append(Stroke((_on_face(y, radius, hours, 0.55), _on_face(y, radius, hours, 1.22)), LineStyle(ACCENT, 1.6)))
    shapes.append(Disc(_on_face(y, radius, hours, 0.55), 0.3 * radius, LineStyle(ACCENT, 0.8, fill=ACCENT)))
    return shapes


def _on_face(y: float, radius: float, hours: float, share: float) -> Place:
    angle = math.radians(30.0 * hours)
    return CLOCK + share * radius * math.sin(angle), y - share * radius * math.cos(angle)


def _fork_words(fork: Fork, sheet: PlanSheet, y: float, step: float) -> list[Shape]:
    width, _ = TRACING_SIZE
    turn = fork.turn
    facts = [_from_carina(fork.carina_mm)]
    if turn is not None:
        facts += [
            f"{turn.from_fork_mm:.0f} mm past {'the last fork' if fork.number > 1 else 'the start'}",
            f"{turn.diameter_mm:.1f} mm passes",
        ]
        if turn.sides:
            facts.append(f"opens {' and '.join(turn.sides)}")
        if turn.through:
            facts.append(f"just past {joined(turn.through)}")
    said = [(line, INK) for line in lines_of(", ".join(facts), SMALL, width - TEXT)]
    if turn is not None and turn.moves is not None:
        said += [(line, QUIET) for line in lines_of(moves_words(turn.moves), SMALL, width - TEXT)]
    warned = [(line, WARNING) for words in fork.warnings for line in lines_of(words, SMALL, width - TEXT)]
    room = max(int((step - 18.0) / 11.0), 1)
    # If the text is too long, other lines are omitted, but never warnings.
    said = said[: max(room - len(warned), 1)] + warned
    top = y - 0.5 * (14.0 + 11.0 * len(said)) + 11.0
    shapes: list[Shape] = [Label((TEXT, top), fork.to_name, 12.5, INK, bold=True)]
    if turn is not None:
        hour = turn.direction(sheet.operator)
        shapes.append(Label((width, top), hour, 12.5, ACCENT, "end", bold=True))
    shapes += [Label((TEXT, top + 12.0 + 11.0 * n), text, SMALL, colour) for n, (text, colour) in enumerate(said)]
    return shapes


def _end_words(sheet: PlanSheet, y: float) -> list[Shape]:
    width, _ = TRACING_SIZE
    route = sheet.route
    assert route is not None
    leg = route.leg
    vessel = "no vessel seen nearby" if leg.vessel_mm is None else f"nearest vessel {leg.vessel_mm:.1f} mm"
    text = (
        f"{sheet.plan.tool.title}: {leg.to_target_mm:.0f} mm to the target at {leg.angle_deg:.0f}\u00b0 to the airway, "
        f"{leg.in_target_mm:.0f} mm within it; {vessel}"
    )
    lines = lines_of(text, SMALL, width - TEXT)
    top = y - 8.0
    shapes: list[Shape] = [
        Stroke(((CLOCK - 22, top - 16.0), (width, top - 16.0)), LineStyle(PALE, 0.6)),
        Label((CLOCK, top + 4.0), "stop", 9.0, LEG, "middle", bold=True),
        Label((TEXT, top), f"Tip in {route.branch_name}", 12.5, INK, bold=True),
        Label((width, top), route.place_words, 12.5, LEG, "end", bold=True),
    ]
    return shapes + [Label((TEXT, top + 12.0 + 11.0 * n), line, SMALL, INK) for n, line in enumerate(lines)]


def _notes(sheet: PlanSheet, top: float) -> list[Shape]:
    width, height = TRACING_SIZE
    shapes: list[Shape] = [
        Stroke(((0, top), (width, top), (width, height - 1), (0, height - 1)), LineStyle(INK, 0.8), closed=True),
        Label((6, top + 12), "Notes", 8.5, QUIET, bold=True),
    ]
    lines = [line for note in sheet.notes for line in lines_of(note, 8.5, width - 50.0)]
    if len(lines) > MOST_LINES:
        lines = [*lines[: MOST_LINES - 1], "\u2026 all notes are in the report"]
    shapes += [Label((44, top + 12 + 11.0 * n), line, 8.5, INK) for n, line in enumerate(lines)]
    first = top + 18.0 + 11.0 * len(lines)
    while first < height - 14.0:
        first += 16.0
        if first < height - 6.0:
            shapes.append(Stroke(((6, first), (width - 6, first)), LineStyle(PALE, 0.5)))
    return shapes


def _from_carina(mm: float | None) -> str:
    return "distance from the main carina not known" if mm is None else carina_words(mm)


def _short(name: str) -> str:
    return name if len(name) <= 14 else name[:13] + "\u2026"
