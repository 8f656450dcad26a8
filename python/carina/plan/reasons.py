"""Reasons against a plan: one ordered list, which card, report, sheet, command line and plan.json show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from carina.display import one_line
from carina.plan.routes.plan_route import Plan, PlannedRoute
from carina.plan.routes.ranking import MEDIASTINUM_MM
from carina.plan.targets.edits import BRUSHED, RESIZED, SPHERE
from carina.plan.turns.turn_list import TurnList
from carina.plan.verdict.verdict import Verdict
from carina.volume.inserted_structures import INSERTED_BEGINNING
from carina.volume.model import Remark

Severity = Literal["stop", "caution"]
"""Severity of a reason against a plan.

A ``stop`` alone speaks against the plan and is shown in red; a ``caution`` is a limitation of the plan.
"""

BY_HAND = (BRUSHED, RESIZED, SPHERE)
"""Notes of a target whose boundary was drawn by hand."""
ARRIVES = "if it fits: arrives"
"""Beginning of the text of a verdict whose drive arrives only with a thinner substitute, so that width is the
reason."""
TOUCHED = {
    "pleura": "the pleura or mediastinum (the CT does not tell them apart)",
    "vessel": "a vessel",
    "edge of the CT": "the edge of the scan",
}


@one_line
@dataclass(frozen=True, slots=True)
class Reason(Remark):
    """Reason against a plan; its words are a sentence with a capital letter and a full stop.

    The codes are ``plan.no-route``, ``plan.verdict``, ``plan.limit``, ``plan.lost``, ``plan.note``,
    ``plan.movement``, ``needle.vessel``, ``needle.near-vessel``, ``needle.fissure``, ``needle.mediastinum``,
    ``needle.unexamined``, ``target.note``, ``target.touches``, ``route.narrowest``, ``route.doubt``,
    ``route.withdrawn``, ``route.origin``, ``turn.hour``
    and those of the target's doubts.
    """

    severity: Severity

    def to_json(self) -> dict[str, Any]:
        """Return the reason as plain JSON types."""
        return {"code": self.code, "words": self.words, "severity": self.severity}


def reasons_against(
    plan: Plan,
    *,
    route: PlannedRoute | None = None,
    verdicts: Sequence[Verdict] = (),
    turns: TurnList | None = None,
) -> tuple[Reason, ...]:
    """Return everything that speaks against a plan, in the order in which every output lists it.

    The order is: no route; the verdict on the planned scope, the limits of the route and a withdrawn tip; vessels and
    other tissue on the needle's way; doubts and notes of the target; the narrowest diameter with its error; doubtful
    and drawn branches; the place where the tree is lost; other notes; notes on a measured movement; turns without a
    clock hour.
    A reason whose text is part of an earlier one is left out.

    Parameters
    ----------
    plan
        The plan.
    route
        Route that is followed; the first one of the plan if None.
    verdicts
        Verdicts on that route, of which the one on the planned scope is used.
    turns
        Turns of that route.

    Returns
    -------
    tuple[Reason, ...]
        The reasons.
    """
    return _distinct(_reasons(plan, route or (plan.routes[0] if plan.routes else None), verdicts, turns))


def target_reasons(plan: Plan) -> tuple[Reason, ...]:
    """Return the reasons of `reasons_against` that concern the target: doubts, notes, and what the target touches."""
    return _distinct(_of_target(plan))


def route_reasons(plan: Plan, route: PlannedRoute) -> tuple[Reason, ...]:
    """Return the reasons of `reasons_against` that concern one route: limits, the needle's way, and the airways."""
    return _distinct((*_of_reach(plan, route, ()), *_of_needle(plan, route), *_of_airways(route)))


def plan_reasons(plan: Plan) -> tuple[Reason, ...]:
    """Return the reasons of `reasons_against` that concern neither the target nor a single route."""
    return _distinct((*(() if plan.routes else _of_no_route(plan)), *_of_tree(plan), *_of_movement(plan)))


def _distinct(reasons: Iterable[tuple[str, str, Severity]]) -> tuple[Reason, ...]:
    """Return the reasons without each whose text is contained in the text of an earlier reason."""
    found: list[Reason] = []
    seen: list[str] = []
    for code, words, severity in reasons:
        key = words.rstrip(".").casefold()
        if not any(key in one for one in seen):
            seen.append(key)
            found.append(Reason(code, _sentence(words), severity))
    return tuple(found)


_Parts = Iterator[tuple[str, str, Severity]]
"""Codes, texts and severities of reasons."""


def _reasons(plan: Plan, route: PlannedRoute | None, verdicts: Sequence[Verdict], turns: TurnList | None) -> _Parts:
    if route is None:
        yield from _of_no_route(plan)
    else:
        yield from _of_reach(plan, route, verdicts)
        yield from _of_needle(plan, route)
    yield from _of_target(plan)
    if route is not None:
        yield from _of_airways(route)
    yield from _of_tree(plan)
    yield from _of_movement(plan)
    yield from _of_hours(turns)


def _of_no_route(plan: Plan) -> _Parts:
    yield "plan.no-route", plan.why or "no route was found", "stop"


def _of_target(plan: Plan) -> _Parts:
    for doubt in plan.doubts:
        yield doubt.code, f"the target may not be a nodule: {doubt.words}", "stop"
    for note in plan.nodule.notes:
        yield "target.note", f"target: {note}", "stop" if note in BY_HAND else "caution"
    if plan.nodule.touches:
        touched = " and ".join(TOUCHED.get(what, what) for what in plan.nodule.touches)
        yield "target.touches", f"the target touches {touched}: its boundary there is an estimate", "caution"


def _of_airways(route: PlannedRoute) -> _Parts:
    """Yield the reasons of the airways: narrowest diameter, doubtful and drawn branches, doubtful origin."""
    yield "route.narrowest", route.width.place_words, "caution"
    if route.width.why is not None:
        yield "route.narrowest", route.width.why, "stop"
    for words in route.doubts:
        yield "route.doubt", words, "stop"
    if route.origin.note is not None:
        yield "route.origin", route.origin.note, "caution"


def _of_tree(plan: Plan) -> _Parts:
    """Yield the reasons about an airway near the target that the search lost, and the notes of CT and plan."""
    if plan.lost is not None:
        yield "plan.lost", plan.lost.words, "caution"
    for note in plan.notes:
        if note not in plan.movement.notes:
            yield "plan.note", note, "stop" if note.startswith(INSERTED_BEGINNING) else "caution"


def _of_movement(plan: Plan) -> _Parts:
    """Yield the warnings about the movement of the target."""
    origin = "movement from the second CT" if plan.movement.origin == "measured" else "movement"
    for note in plan.movement.notes:
        yield "plan.movement", f"{origin}: {note}", "stop" if note.startswith(INSERTED_BEGINNING) else "caution"


def _of_hours(turns: TurnList | None) -> _Parts:
    for turn in () if turns is None else turns.turns:
        if turn.hour_doubt is not None:
            why = turn.hour_doubt.words.removeprefix("no clock hour: ")
            yield "turn.hour", f"no clock hour for {turn.to_branch}: {why}", "caution"


def _of_reach(plan: Plan, route: PlannedRoute, verdicts: Sequence[Verdict]) -> _Parts:
    """Yield the reasons why the planned scope does not, or may not, reach the end of the route."""
    verdict = next((one for one in verdicts if one.scope.name == plan.scope.name), None)
    if verdict is not None:
        if verdict.outcome != "reaches":
            yield "plan.verdict", f"{verdict.scope.title} {_continued(verdict.words)}", "stop"
        for check in verdict.checks:
            if check.answer == "yes" or check.words.startswith(ARRIVES):
                continue
            # The text of some checks continues a sentence that begins with the instrument's name.
            is_part = check.words.startswith("needs ") and check.words not in verdict.words
            words = f"{verdict.scope.title} {check.words}" if is_part else check.words
            yield "plan.verdict", words, "stop" if check.answer == "no" else "caution"
    for words in route.limits:
        if not words.startswith(ARRIVES):
            yield "plan.limit", words, "stop"
    withdrawn_mm = route.withdrawn_mm if verdict is None else verdict.withdrawn_mm
    if withdrawn_mm > 0.0:
        yield "route.withdrawn", route.withdrawn_words(withdrawn_mm), "caution"


def _of_needle(plan: Plan, route: PlannedRoute) -> _Parts:
    """Yield the reasons about the needle: tissue that it crosses or passes closely up to the far edge of the target."""
    leg = route.leg
    # A needle that misses the target is examined up to the target's near edge.
    far_mm = max((one.end_mm for one in leg.crossed if one.tissue == "target"), default=leg.to_target_mm)
    for tissue in ("vessel", "fissure"):
        met = next((one for one in leg.crossed if one.tissue == tissue and one.start_mm < far_mm), None)
        if met is not None:
            words = f"the needle's way crosses a {tissue} {met.start_mm:.0f} mm from the scope's tip"
            yield f"needle.{tissue}", words, "stop"
    if leg.vessel_mm is not None and 0.0 < leg.vessel_mm < plan.vessel_margin_mm:
        words = f"a vessel is {leg.vessel_mm:.1f} mm from the needle's line; the margin is {plan.vessel_margin_mm:g} mm"
        yield "needle.near-vessel", words, "stop"
    if leg.mediastinum_mm > MEDIASTINUM_MM:
        words = (
            f"the needle crosses {leg.mediastinum_mm:.0f} mm of mediastinum or chest wall, whose vessels the CT does "
            "not show without contrast"
        )
        yield "needle.mediastinum", words, "stop"
    if any(one.tissue == "not examined" for one in leg.crossed):
        yield "needle.unexamined", "part of the needle's way lies beyond the scan and was not examined", "stop"


def _continued(words: str) -> str:
    """Return the text of a verdict as the continuation of a sentence that begins with the instrument's name."""
    return words.replace("cannot say: ", "cannot be judged: ", 1)


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] + ("" if words.endswith(".") else ".")
