"""Tracing sheet for the procedure: the route as a bronchial diagram with a clock face at each fork."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from carina.plan.report.colours import ACCENT, INK, LEG, PALE, QUIET, WARNING
from carina.plan.report.drawing import Disc, Drawing, Label, LineStyle, Place, Shape, Stroke
from carina.plan.report.plan_sheet import Fork, PlanSheet
from carina.plan.report.wording import AGAINST, BOLD, lines_of, text_width
from carina.plan.routes.main_carina import carina_words
from carina.plan.turns.texts import joined, moves_sum_words, moves_words

TRACING_SIZE = (520.0, 640.0)
"""Width and height of a page of the tracing sheet, in points; the size fits A4 and Letter without a change of scale."""
SMALL, LINE = 9.0, 11.0
"""Minimum font size of the sheet, and the distance between lines of this size, in points.

The PDF reduces the sizes of labels by a tenth, so that the smallest text on paper has at least 8 points.
"""
NAME, NAME_LINE = 12.0, 14.0
"""Font size of names of branches, and the height of their line, in points."""
LABELS, GAP = 46.0, 6.0
"""Heights in points of the box with the lines to fill in, and of the space between two parts."""
MAX_LINES = 7
"""Maximum number of lines of the planner's notes."""
SUMS = "The moves of the hand are sums up to each fork; the report lists every move."
NO_MOVES = "The moves of the hand are in the report."
FREE_NOTES = 36.0
"""Height in points that is left for handwritten notes if the page has room."""
MAX_ROW = 78.0
SWAY, SWAY_MAX = 22.0, 28.0
TUBE = 10.0


@dataclass(frozen=True, slots=True)
class _SheetLayout:
    """Horizontal positions of diagram, clock faces and text from the left edge of the page, in points."""

    spine: float | None
    clock: float
    text: float
    least_row: float
    """Least height of a row, so that clock faces and the parts of the diagram do not overlap."""
    gap: float
    """Space between two rows."""
    face: float
    """Maximum radius of a clock face; its arrow is longer by a quarter."""
    is_short: bool = False
    """Whether a row omits facts that follow from others: distance from the last fork, sides, openings not entered."""
    sums_moves: bool = False
    """Whether a row states the sum of the hand's moves instead of each move."""
    is_list: bool = False
    """Whether a row is one line without moves of the hand."""


DIAGRAM = _SheetLayout(spine=78.0, clock=170.0, text=196.0, least_row=36.0, gap=6.0, face=15.0)
COMPACT = _SheetLayout(spine=None, clock=17.0, text=40.0, least_row=30.0, gap=4.0, face=13.5)
TIGHT = _SheetLayout(spine=None, clock=14.0, text=32.0, least_row=25.0, gap=3.0, face=11.5, is_short=True)
SUMMED = replace(TIGHT, sums_moves=True)
LISTED = _SheetLayout(spine=None, clock=14.0, text=32.0, least_row=19.0, gap=3.0, face=7.5, is_short=True, is_list=True)
"""Page layouts, tried in this order: with a diagram; without; without derived facts; with sums of moves; as a list.

The last layouts are for long routes.
"""


@dataclass(frozen=True, slots=True)
class _Row:
    """Row of the sheet: a fork of the route, or the place where the scope stops if ``fork`` is None."""

    fork: Fork | None
    title: str
    right: str
    """Text at the right edge of the line of the title: clock hour, or place of the tip."""
    lines: tuple[tuple[str, str], ...]
    """Lines of text with their colours."""
    beside: str = ""
    """Text after the title, in the same line."""

    @property
    def text_height(self) -> float:
        return NAME_LINE + LINE * len(self.lines)

    def height(self, layout: _SheetLayout) -> float:
        """Return the least height of the row, with the space below it."""
        return max(self.text_height + layout.gap, layout.least_row)


def tracing_drawings(sheet: PlanSheet) -> tuple[Drawing, ...]:
    """Return the tracing sheet on one page; empty if the plan has no route.

    The diagram is left out if the text needs its room, then facts that follow from others, then the moves of the hand,
    which the report lists. Only text that still does not fit continues on further pages: no text is cut or reduced.
    """
    if sheet.route is None:
        return ()
    against = _against_lines(sheet)
    for layout in (DIAGRAM, COMPACT, TIGHT, SUMMED, LISTED):
        rows = _rows(sheet, layout)
        used = sum(row.height(layout) for row in rows)
        if used + _against_height(against) <= _body_height(sheet):
            return (_page(sheet, layout, against, rows),)
    return tuple(_page(sheet, COMPACT, *part) for part in _pages(sheet, against, _rows(sheet, COMPACT)))


def _body_height(sheet: PlanSheet) -> float:
    """Return the height in points between the head of a page and its notes."""
    notes = len(_note_lines(sheet))
    return TRACING_SIZE[1] - _head_height(sheet) - LABELS - GAP - (LINE * notes + GAP if notes else 0.0)


def _pages(
    sheet: PlanSheet, against: tuple[tuple[str, str], ...], rows: tuple[_Row, ...]
) -> list[tuple[tuple[tuple[str, str], ...], tuple[_Row, ...]]]:
    """Return the lines of reasons and the rows of each page."""
    pages: list[tuple[list[tuple[str, str]], list[_Row]]] = [([], [])]
    body_height = _body_height(sheet)
    left = body_height - _against_height(against[:1])
    for line in against:
        if left < LINE:
            pages.append(([], []))
            left = body_height - _against_height(against[:1])
        pages[-1][0].append(line)
        left -= LINE
    for row in rows:
        height = row.height(COMPACT)
        if left < height and (pages[-1][0] or pages[-1][1]):
            pages.append(([], []))
            left = body_height
        pages[-1][1].append(row)
        left -= height
    return [(tuple(lines), tuple(some)) for lines, some in pages]


def _page(
    sheet: PlanSheet, layout: _SheetLayout, against: tuple[tuple[str, str], ...], rows: tuple[_Row, ...]
) -> Drawing:
    width, height = TRACING_SIZE
    natural = [row.height(layout) for row in rows]
    head = _head_height(sheet)
    top = head + _against_height(against)
    # The rows share the free height up to a limit; handwritten notes get the rest.
    spare = head + _body_height(sheet) - top - sum(natural) - FREE_NOTES
    heights = [max(one, min(MAX_ROW, one + max(spare, 0.0) / len(rows))) for one in natural]
    tops = [top, *(top + sum(heights[: n + 1]) for n in range(len(heights)))]
    middles = [0.5 * (a + b) for a, b in itertools.pairwise(tops)]
    shapes: list[Shape] = [*_head(sheet), *_against(against, head)]
    if layout.spine is not None:
        shapes += _diagram(sheet, rows, layout.spine, tops, middles)
    for n, row in enumerate(rows):
        y = middles[n]
        if n:
            left = 0.0 if layout.spine is None else layout.clock - 20.0
            shapes.append(Stroke(((left, tops[n]), (width, tops[n])), LineStyle(PALE, 0.6)))
        if row.fork is None:
            shapes.append(Label((layout.clock, y + 3.0), "stop", SMALL, LEG, "middle", bold=True))
        else:
            shapes += _clock_face(row.fork, sheet, (layout.clock, y), min(layout.face, 0.38 * heights[n]))
        shapes += _row_words(row, layout, y)
    shapes += _notes(sheet, tops[-1] + GAP)
    shapes += _labels(height - LABELS)
    return Drawing(
        width, height, tuple(shapes), "Tracing sheet: the route fork by fork, from the trachea to the target"
    )


def _head_lines(sheet: PlanSheet) -> tuple[tuple[str, str], ...]:
    """Return the small lines of the head with their colours."""
    plan = sheet.plan
    seen = {
        "head": "operator at the patient's head: anterior at 12, patient's right at 3",
        "facing": "operator facing the patient: posterior at 12, patient's left at 3",
    }
    texts = (
        (f"{plan.scope.title} + {plan.tool.title}. Bronchus sign: {plan.sign_words}.", INK),
        (f"Clock hours: {seen[sheet.operator]}. Distances: from the main carina.", ACCENT),
    )
    return tuple((line, colour) for text, colour in texts for line in lines_of(text, SMALL, TRACING_SIZE[0]))


def _title_lines(sheet: PlanSheet) -> list[str]:
    place = sheet.place
    words = sheet.plan.nodule.words
    title = f"{words[0].upper()}{words[1:]}, {place.lobe or 'lobe not known'}, near {place.nearest_branch}"
    return lines_of(title, BOLD * NAME, TRACING_SIZE[0])


def _head_height(sheet: PlanSheet) -> float:
    return NAME_LINE * len(_title_lines(sheet)) + LINE * len(_head_lines(sheet)) + 2.0 * GAP


def _head(sheet: PlanSheet) -> list[Shape]:
    width, _ = TRACING_SIZE
    titles = _title_lines(sheet)
    under = NAME_LINE * len(titles)
    shapes: list[Shape] = [
        Label((0, NAME_LINE * (n + 1) - 2.0), line, NAME, LEG, bold=True) for n, line in enumerate(titles)
    ]
    shapes += [
        Label((0, under + LINE * (n + 1)), line, SMALL, colour) for n, (line, colour) in enumerate(_head_lines(sheet))
    ]
    bottom = _head_height(sheet) - GAP
    return [*shapes, Stroke(((0, bottom), (width, bottom)), LineStyle(INK, 0.8))]


def _against_lines(sheet: PlanSheet) -> tuple[tuple[str, str], ...]:
    """Return the lines of the reasons against the plan, with their colours."""
    found = []
    for reason in sheet.reasons:
        colour = WARNING if reason.severity == "stop" else INK
        for n, line in enumerate(lines_of(reason.words, SMALL, TRACING_SIZE[0] - 12.0)):
            found.append((f"\u2022 {line}" if n == 0 else f"\u2007{line}", colour))
    return tuple(found)


def _against_height(against: tuple[tuple[str, str], ...]) -> float:
    return NAME_LINE + LINE * len(against) + GAP if against else 0.0


def _against(against: tuple[tuple[str, str], ...], head: float) -> list[Shape]:
    if not against:
        return []
    colour = WARNING if any(one == WARNING for _, one in against) else INK
    shapes: list[Shape] = [Label((0, head + 9.0), AGAINST, 10.0, colour, bold=True)]
    for n, (line, shade) in enumerate(against):
        is_first = line.startswith("\u2022 ")
        text = line.removeprefix("\u2022 ").removeprefix("\u2007")
        y = head + NAME_LINE + 8.0 + LINE * n
        if is_first:
            shapes.append(Disc((3.0, y - 3.0), 1.5, LineStyle(None, fill=shade)))
        shapes.append(Label((10.0, y), text, SMALL, shade))
    bottom = head + _against_height(against) - 2.0
    return [*shapes, Stroke(((0, bottom), (TRACING_SIZE[0], bottom)), LineStyle(INK, 0.8))]


def _rows(sheet: PlanSheet, layout: _SheetLayout) -> tuple[_Row, ...]:
    """Return the rows of all forks and of the place where the scope stops."""
    return (*(_fork_row(fork, sheet, layout) for fork in sheet.forks), _end_row(sheet, layout))


def _diagram(
    sheet: PlanSheet, rows: tuple[_Row, ...], spine: float, tops: list[float], middles: list[float]
) -> list[Shape]:
    """Return the shapes of the bronchial diagram; each tube leans to the side of the opening in the picture."""
    forks = [row.fork for row in rows if row.fork is not None]
    places: list[Place] = [(spine, tops[0] + 7.0)]
    x = spine
    leans = [_lean(fork, sheet) for fork in forks]
    for n in range(len(rows)):
        if n:
            x = spine + max(-SWAY_MAX, min(SWAY_MAX, 0.5 * (x - spine) + SWAY * leans[n - 1]))
        places.append((x, middles[n]))
    stubs, names = [], []
    for n in range(len(forks)):
        (fx, fy), side = places[n + 1], -1.0 if leans[n] > 0.0 else 1.0
        step = tops[n + 1] - tops[n]
        for k, name in enumerate(forks[n].others[:2]):
            end = (fx + side * 24.0, fy + 0.30 * step - 11.0 * k)
            stubs.append(((fx, fy), end))
            names.append(_stub_name(end, side, name, below=k == 0))
    shapes: list[Shape] = []
    for colour, extra in ((QUIET, 2.0), ("#ffffff", 0.0)):
        shapes += [Stroke(stub, LineStyle(colour, 0.6 * TUBE + extra)) for stub in stubs]
        shapes.append(Stroke(tuple(places), LineStyle(colour, TUBE + extra)))
    # From each fork the route leads into the branch that is named there, so the fork's warnings colour the next piece.
    for n, piece in enumerate(itertools.pairwise(places)):
        warned = n > 0 and bool(forks[n - 1].warnings)
        warned |= n == len(forks) and bool(_end_warnings(sheet))
        shapes.append(Stroke(piece, LineStyle(WARNING, 2.2, dash=(4.0, 3.5)) if warned else LineStyle(ACCENT, 2.2)))
    shapes += names
    for n, fork in enumerate(forks):
        drawn = bool(fork.warnings)
        shapes.append(Disc(places[n + 1], 8.0, LineStyle(WARNING if drawn else ACCENT, 1.4, fill="#ffffff")))
        x, y = places[n + 1]
        shapes.append(Label((x, y + 3.3), str(fork.number), SMALL, WARNING if drawn else ACCENT, "middle", bold=True))
    shapes += _target(places[-1], tops[-1] - tops[-2])
    if forks:
        shapes.append(Label((spine - 12.0, tops[0] + 12.0), _short(forks[0].from_name), SMALL, QUIET, "end"))
    return shapes


def _stub_name(end: Place, side: float, name: str, *, below: bool) -> Label:
    """Return the name of a branch that is not entered, beside the end of its stub.

    A name that would reach the clock face or the edge of the page is placed below or above the end of the stub.
    """
    text, x = _short(name), end[0] + side * 7.0
    if side < 0 and x < text_width(text, SMALL):
        return Label((0.0, end[1] + (13.0 if below else -6.0)), text, SMALL, QUIET)
    most = DIAGRAM.clock - 1.3 * DIAGRAM.face
    if side > 0 and x + text_width(text, SMALL) > most:
        return Label((most, end[1] + (13.0 if below else -6.0)), text, SMALL, QUIET, "end")
    return Label((x, end[1] + 3.0), text, SMALL, QUIET, "start" if side > 0 else "end")


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


def _clock_face(fork: Fork, sheet: PlanSheet, at: Place, radius: float) -> list[Shape]:
    """Return a clock face with the openings of a fork at their hours."""
    x, y = at
    shapes: list[Shape] = [Disc(at, radius, LineStyle(INK, 1.0, fill="#ffffff"))]
    for hour in range(12):
        long = 0.2 if hour % 3 == 0 else 0.1
        shapes.append(
            Stroke((_on_face(at, radius, hour, 1.0 - long), _on_face(at, radius, hour, 1.0)), LineStyle(INK, 0.6))
        )
    turn = fork.turn
    if turn is None:
        shapes.append(Label((x, y + 3.5), "?", 10.0, QUIET, "middle"))
        return shapes
    for other in turn.others:
        if not other.in_view:
            continue
        seen = other.hour(sheet.operator)
        middle = at if seen is None else _on_face(at, radius, seen, 0.55)
        shapes.append(Disc(middle, 0.24 * radius, LineStyle(QUIET, 0.7, fill="#ffffff")))
    hours = turn.clock(sheet.operator)
    if hours is None:
        if turn.straight_ahead:
            shapes.append(Disc(at, 0.3 * radius, LineStyle(ACCENT, 0.8, fill=ACCENT)))
        else:
            shapes.append(Label((x, y + 3.5), "?", 10.0, WARNING, "middle"))
        return shapes
    ends = _on_face(at, radius, hours, 0.55), _on_face(at, radius, hours, 1.22)
    shapes.append(Stroke(ends, LineStyle(ACCENT, 1.6)))
    shapes.append(Disc(ends[0], 0.3 * radius, LineStyle(ACCENT, 0.8, fill=ACCENT)))
    return shapes


def _on_face(at: Place, radius: float, hours: float, share: float) -> Place:
    angle = math.radians(30.0 * hours)
    return at[0] + share * radius * math.sin(angle), at[1] - share * radius * math.cos(angle)


def _fork_row(fork: Fork, sheet: PlanSheet, layout: _SheetLayout) -> _Row:
    turn = fork.turn
    facts = [_from_carina(fork.carina_mm)]
    if turn is not None:
        if not layout.is_short:
            facts.append(f"{turn.from_fork_mm:.0f} mm past {'the last fork' if fork.number > 1 else 'the start'}")
        facts.append(turn.opening.words)
        if turn.sides and not layout.is_short:
            facts.append(f"opens {' and '.join(turn.sides)}")
        if turn.through:
            facts.append(f"just past {joined(turn.through)}")
        if turn.others and not layout.is_short:
            facts.append(f"not {joined([f'{one.name} ({one.direction(sheet.operator)})' for one in turn.others])}")
    moves = "" if turn is None or turn.moves is None else _moves(layout)(turn.moves)
    if layout.is_list:
        right = "" if turn is None else turn.direction(sheet.operator)
        return _listed_row(fork, right, ", ".join(facts), layout)
    texts = _with_moves(", ".join(facts), moves, layout)
    texts += [(words, WARNING) for words in fork.warnings]
    title = fork.to_name if layout.spine is not None else f"{fork.number}. {fork.to_name}"
    return _row(fork, title, "" if turn is None else turn.direction(sheet.operator), texts, layout)


def _moves(layout: _SheetLayout) -> Callable[..., str]:
    """Return the function that converts moves of the hand to the text of a layout."""
    if layout.is_list:
        return lambda _moves: ""
    return moves_sum_words if layout.sums_moves else moves_words


def _listed_row(fork: Fork, right: str, facts: str, layout: _SheetLayout) -> _Row:
    """Return the row of a fork with its facts behind the title, or below the title if the line is too short."""
    title = f"{fork.number}. {fork.to_name}"
    texts = [(words, WARNING) for words in fork.warnings]
    used = text_width(title, NAME, is_bold=True) + text_width(right, NAME, is_bold=True) + text_width(facts, SMALL)
    if used + 20.0 > TRACING_SIZE[0] - layout.text:
        return _row(fork, title, right, [(facts, INK), *texts], layout)
    return replace(_row(fork, title, right, texts, layout), beside=facts)


def _with_moves(text: str, moves: str, layout: _SheetLayout) -> list[tuple[str, str]]:
    """Return a text and the moves of the hand with their colours: in one paragraph if there is no diagram."""
    if layout.spine is None:
        return [(f"{text}. {moves[0].upper()}{moves[1:]}" if moves else text, INK)]
    return [(text, INK), *([(moves, QUIET)] if moves else [])]


def _end_warnings(sheet: PlanSheet) -> list[str]:
    """Return doubts about the route's airways that belong to none of its forks: a drawn branch may extend a tip."""
    assert sheet.route is not None
    stated = {words for fork in sheet.forks for words in fork.warnings}
    return [words for words in sheet.route.doubts if words not in stated]


def _end_row(sheet: PlanSheet, layout: _SheetLayout) -> _Row:
    route = sheet.route
    assert route is not None
    leg = route.leg
    text = (
        f"{sheet.plan.tool.title}: {leg.to_target_mm:.0f} mm to the target at {leg.angle_deg:.0f}\u00b0 to the airway, "
        f"{leg.in_target_mm:.0f} mm within it; {leg.vessel_words}"
    )
    parking = () if sheet.turns is None else sheet.turns.park_moves or ()
    texts = _with_moves(text, _moves(layout)(parking), layout)
    texts += [(words, WARNING) for words in _end_warnings(sheet)]
    has_moves = bool(parking) or any(fork.turn is not None and fork.turn.moves for fork in sheet.forks)
    if has_moves and (layout.sums_moves or layout.is_list):
        texts.append((SUMS if layout.sums_moves else NO_MOVES, WARNING))
    return _row(None, f"Tip in {route.branch_name}", route.place_words, texts, layout)


def _row(fork: Fork | None, title: str, right: str, texts: list[tuple[str, str]], layout: _SheetLayout) -> _Row:
    """Return a row with its texts in lines; a title that leaves no room for the text at its right is also wrapped.

    The place of the tip is then below its title, so that the name of the branch stays in one line.
    """
    width = TRACING_SIZE[0] - layout.text
    for_title = width - text_width(right, NAME, is_bold=True) - 8.0
    if fork is None and len(lines_of(title, BOLD * NAME, for_title)) > 1:
        texts, right, for_title = [(right, LEG), *texts], "", width
    name, *more = lines_of(title, BOLD * NAME, for_title) or [""]
    lines = [(line, INK) for line in more]
    lines += [(line, colour) for text, colour in texts for line in lines_of(text, SMALL, width)]
    return _Row(fork, name, right, tuple(lines))


def _row_words(row: _Row, layout: _SheetLayout, y: float) -> list[Shape]:
    width, _ = TRACING_SIZE
    top = y - 0.5 * row.text_height + 11.0
    colour = LEG if row.fork is None else ACCENT
    shapes: list[Shape] = [Label((layout.text, top), row.title, NAME, INK, bold=True)]
    if row.beside:
        after = layout.text + text_width(row.title, NAME, is_bold=True) + 8.0
        shapes.append(Label((after, top), row.beside, SMALL, INK))
    if row.right:
        shapes.append(Label((width, top), row.right, NAME, colour, "end", bold=True))
    shapes += [
        Label((layout.text, top + 12.0 + LINE * n), text, SMALL, shade) for n, (text, shade) in enumerate(row.lines)
    ]
    return shapes


def _note_lines(sheet: PlanSheet) -> list[str]:
    lines = [line for note in sheet.notes for line in lines_of(note, SMALL, TRACING_SIZE[0] - 52.0)]
    if len(lines) > MAX_LINES:
        lines = [*lines[: MAX_LINES - 1], "\u2026 all notes are in the report"]
    return lines


def _notes(sheet: PlanSheet, top: float) -> list[Shape]:
    """Return the planner's notes from ``top`` on, and lines for handwritten notes in the free room below them."""
    width, height = TRACING_SIZE
    bottom = height - LABELS - GAP
    lines = _note_lines(sheet)
    if bottom - top < LINE:
        return []
    shapes: list[Shape] = [
        Stroke(((0, top), (width, top)), LineStyle(INK, 0.8)),
        Label((0, top + LINE), "Notes", SMALL, QUIET, bold=True),
    ]
    shapes += [Label((40, top + LINE * (n + 1)), line, SMALL, INK) for n, line in enumerate(lines)]
    first = top + LINE * max(len(lines), 1) + 4.0 + 16.0
    while first < bottom - 4.0:
        shapes.append(Stroke(((0, first), (width, first)), LineStyle(PALE, 0.5)))
        first += 16.0
    return shapes


def _labels(top: float) -> list[Shape]:
    """Return the box with the places to write patient label, instrument and date."""
    width, height = TRACING_SIZE
    bottom = height - 1.0
    shapes: list[Shape] = [
        Stroke(((0, top), (width, top), (width, bottom), (0, bottom)), LineStyle(INK, 0.8), closed=True)
    ]
    for left, name in ((0.0, "Patient label"), (0.46 * width, "Bronchoscope, serial number"), (0.8 * width, "Date")):
        if left:
            shapes.append(Stroke(((left, top), (left, bottom)), LineStyle(INK, 0.8)))
        shapes.append(Label((left + 5.0, top + LINE), name, SMALL, QUIET, bold=True))
    return shapes


def _from_carina(mm: float | None) -> str:
    return "distance from the main carina not known" if mm is None else carina_words(mm)


def _short(name: str) -> str:
    return name if len(name) <= 10 else name[:9] + "\u2026"
