"""Sentences about the uncertainties of a plan and about its parts that were drawn by hand."""

from __future__ import annotations

from carina.plan.movement.target_movement import TargetMovement
from carina.plan.reasons import BY_HAND
from carina.plan.routes.ct_notes import ct_notes
from carina.plan.routes.needle_hits import NeedleErrors
from carina.plan.routes.plan_route import Plan, PlannedRoute
from carina.plan.routes.ranking import MEDIASTINUM_MM
from carina.plan.routes.standing_points import branch_title
from carina.plan.targets.grow_nodule import Nodule
from carina.plan.turns.turn_list import TurnList
from carina.plan.verdict.verdict import Verdict
from carina.track import Airways, Branch, drawn_tree
from carina.volume import Volume


def movement_words(plan: Plan) -> str:
    """Return the sentence on every page about the movement of the target since the CT."""
    return f"{plan.movement.words}."


def uncertain(
    volume: Volume,
    airways: Airways,
    plan: Plan,
    *,
    route: PlannedRoute | None,
    turns: TurnList | None,
    verdicts: tuple[Verdict, ...],
) -> tuple[str, ...]:
    """Return sentences about the uncertainties of a plan, the most important ones first.

    Parameters
    ----------
    volume, airways, plan
        The CT, its airways and the plan.
    route
        Route that the report describes; None if the plan has none.
    turns
        List of turns of the route; None if it was not computed.
    verdicts
        Verdicts of instruments on the route.
    """
    found = [*doubt_words(plan), movement_words(plan) + _aimed_again(route, plan.movement), *_of_target(plan.nodule)]
    if route is not None:
        found += [f"{doubt}." for doubt in _doubts(route)]
        found += _of_leg(route)
    found += [_sentence(note) for note in ct_notes(volume, airways)]
    found += _of_airways(airways, route)
    if verdicts:
        found.append(
            "The probabilities of the instruments follow from the error of the narrowest diameter, which was compared "
            "with painted CTs, and from assumed errors of instrument and needle; they have not been compared with "
            "procedures."
        )
    if turns is None and route is not None:
        found.append("Clock hours and control moves were not calculated for this report.")
    elif turns is not None:
        found += [_sentence(note) for note in turns.notes]
        if any(turn.moves is None for turn in turns.turns):
            found.append("What the hand does at each fork was not calculated: no drive of an instrument is known.")
    found += [_sentence(note) for note in plan.notes]
    return tuple(dict.fromkeys(found))


def by_hand(airways: Airways, plan: Plan, route: PlannedRoute | None) -> tuple[str, ...]:
    """Return sentences about drawn or bridged parts: of the route first, then of other routes and of the whole tree."""
    found = [f"Target: {note}." for note in plan.nodule.notes if note in BY_HAND]
    if route is not None:
        for branch in airways.tree.lineage(route.branch_id):
            if branch.kind != "tracked":
                found.append(f"This route leads through {_drawn(branch)}.")
    for number, other in enumerate(plan.routes, 1):
        names = [branch_title(one) for one in airways.tree.lineage(other.branch_id) if one.kind != "tracked"]
        if names and other is not route:
            found.append(f"Route {number} leads through what the CT does not show: {', '.join(names)}.")
    whole = drawn_tree(airways.tree).words
    if whole is not None:
        found.append(f"Of the airway tree: {whole}.")
    if airways.edits:
        edits = "1 edit" if len(airways.edits) == 1 else f"{len(airways.edits)} edits"
        found.append(f"The airway tree was changed by hand ({edits}).")
    return tuple(found)


def _aimed_again(route: PlannedRoute | None, movement: TargetMovement) -> str:
    if route is None or route.hit_share is None or route.hit_share_moved is None:
        return ""
    return (
        f" Aimed as planned, {100 * route.hit_share:.0f} % of needle passes hit if it has not moved and "
        f"{100 * route.hit_share_moved:.0f} % if it may lie {movement.region_words}; confirm its position "
        "before each pass."
    )


def doubt_words(plan: Plan) -> tuple[str, ...]:
    """Return a warning for each doubt whether the target is a nodule."""
    return tuple(f"The target may not be a nodule: {doubt.words}." for doubt in plan.doubts)


def _of_target(nodule: Nodule) -> list[str]:
    found = [
        f"Volume {nodule.volume_mm3 / 1000:.2f} \u00b1 {nodule.volume_error_mm3 / 1000:.2f} ml and diameters "
        f"\u00b1 {nodule.diameter_error_mm:.1f} mm: intervals that should hold the true value nine times of ten."
    ]
    words = {
        "pleura": "the pleura or mediastinum (the CT does not tell them apart)",
        "vessel": "a vessel",
        "edge of the CT": "the edge of the scan",
    }
    touched = [words.get(what, what) for what in nodule.touches]
    found += [f"Target: {note}." for note in nodule.notes]
    if touched:
        found.append(f"The target touches {' and '.join(touched)}: its boundary there is an estimate.")
    return found


def _doubts(route: PlannedRoute) -> list[str]:
    return [doubt[0].upper() + doubt[1:] for doubt in (*route.doubts, *route.limits)]


def _of_leg(route: PlannedRoute) -> list[str]:
    errors, leg = NeedleErrors(), route.leg
    found = [
        f"Needle passes are calculated with errors of {errors.angle_deg:g}\u00b0 and {errors.tip_mm:g} mm unless the "
        "plan was made with others (assumed, not measured), and with a straight needle.",
        "Vessels narrower than about 1 mm are not visible on CT; arteries and veins are not distinguished, and vessels "
        "in the mediastinum do not stand out without contrast. Fissures are shown only where the CT shows one.",
    ]
    if any(one.tissue == "not examined" for one in leg.crossed):
        found.append("Part of the needle's way lies beyond the scan and was not examined.")
    if leg.mediastinum_mm > MEDIASTINUM_MM:
        found.append(
            f"The needle crosses {leg.mediastinum_mm:.0f} mm of mediastinum or chest wall before the target's far "
            "edge: vessels in it are not visible."
        )
    if route.from_carina_mm is None:
        found.append("The route passes no main carina: distances are measured from the start of the airway tree.")
    return found


def _of_airways(airways: Airways, route: PlannedRoute | None) -> list[str]:
    """Return sentences about doubtful airways of the route, and about doubts that concern the whole tree.

    Airways that were lost near the target are among the plan's notes.
    """
    lineage = {} if route is None else {branch.id: branch for branch in airways.tree.lineage(route.branch_id)}
    found = []
    for place in airways.uncertain:
        if place.branch_id is None:
            found.append(_sentence(place.reason))
        elif place.branch_id in lineage and place.kind in {"filled", "faint"}:
            found.append(_sentence(f"{branch_title(lineage[place.branch_id])}, on the route: {place.reason}"))
    return found


def _drawn(branch: Branch) -> str:
    what = "a bridge across an obstruction" if branch.kind == "bridge" else "a branch drawn by hand"
    return f"{branch_title(branch)}, {what}: {branch.length_mm:.0f} mm that the CT does not show"


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] + ("" if words.endswith(".") else ".")
