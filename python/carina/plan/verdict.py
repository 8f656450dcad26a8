"""Whether an instrument gets to where a route ends and can point its tool at the target.

The scope is laid along the route in the airways' own wall (`carina.ScopeDrive`), and roll and lever are searched there.
Each check lists the figures that it rests on with their basis; an unknown figure gives *cannot say*, never a default.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import CancelledError, UsageError
from carina.plan.needle import NeedleErrors, hit_share
from carina.plan.routes import Plan, PlannedRoute
from carina.plan.tools import Tool
from carina.scopes import FIT_MARGIN_MM, ScopeDrive, ScopeHold, ScopePreset, WallField, scope_presets
from carina.track import AirwayTree, Route

__all__ = ["Check", "Outcome", "Verdict", "judge_scope", "judge_scopes"]

Points = NDArray[np.float64]
Outcome = Literal["reaches", "may reach", "does not reach", "cannot say"]
Answer = Literal["yes", "perhaps", "no", "unknown"]

SURE = 0.9
"""Told *yes* from this share of the errors up, *no* at what is left below its rest."""
EXCESS_SIGMA_MM = 0.15
"""Of the margin: ten scopes exceed their stated tip by 0.19 to 0.66 mm (s; the standard deviation is our estimate)."""
ROOM_SHARE = 0.2
"""Standard deviation of a lumen's width, of the CT's coarsest spacing (k)."""
BEND_SIGMA_DEG = 8.0
"""Of the angle that a route asks of the bending section (k)."""
NEAR_MM = 1.5
"""The tip is where it should be within this."""
SMOOTH_MM = 4.0
"""Half the way over which a direction of the route is taken."""
NUM_ROLLS, NUM_LEVERS = 12, 4
POINTS, BARELY = 0.5, 0.1
"""It can be pointed where this share of needles hits; below the second it cannot: a pass can be repeated."""
MOST_AIMED = 8
"""Of the ways to hold it, those that point nearest to the target are tried with a needle."""
SLIMMER_MM = 0.8
CUT_MM = 10.0
"""So far from where the tree begins widths are not looked at."""
LONGEST_ENTRY_MM = 250.0
"""From the nose to the upper trachea it is hardly farther in an adult (k)."""


@one_line
@dataclass(frozen=True, slots=True)
class Check:
    """One thing that an instrument must be able to do."""

    name: Literal["diameter", "bend", "length", "channel", "pointing"]
    answer: Answer
    share: float | None
    """How likely it is, as far as the errors go; None where that cannot be said."""
    words: str
    basis: str
    """What it rests on: figures of the instrument with ``s`` or ``k``, and what was measured."""


@one_line
@dataclass(frozen=True, slots=True)
class Verdict:
    """What one instrument can do on one route."""

    scope: ScopePreset
    outcome: Outcome
    share: float | None
    """The least of the checks' shares."""
    checks: tuple[Check, ...]
    reached_mm: float
    """How far along the route its tip was laid."""
    hold: ScopeHold | None
    """Roll and lever that point at the target; None where it did not get there."""
    would: str | None
    """What would have to be different, where it does not reach."""

    @property
    def words(self) -> str:
        """reaches the standing place and can point at the target"""
        if self.outcome == "reaches":
            return "reaches the standing place and can point at the target"
        worst = [check for check in self.checks if check.answer in {"no", "unknown", "perhaps"}]
        order = {"no": 0, "unknown": 1, "perhaps": 2}
        worst.sort(key=lambda check: order[check.answer])
        return f"{self.outcome}: {worst[0].words}" if worst else self.outcome

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "scope": self.scope.name,
            "outcome": self.outcome,
            "share": self.share,
            "words": self.words,
            "checks": [
                {"name": c.name, "answer": c.answer, "share": c.share, "words": c.words, "basis": c.basis}
                for c in self.checks
            ],
            "reached_mm": self.reached_mm,
            "hold": None
            if self.hold is None
            else {
                "insertion_mm": self.hold.insertion_mm,
                "roll_rad": self.hold.roll_rad,
                "flexion_rad": self.hold.flexion_rad,
            },
            "would": self.would,
        }


def judge_scopes(
    tree: AirwayTree,
    plan: Plan,
    wall: WallField,
    *,
    route: PlannedRoute | None = None,
    scopes: Iterable[ScopePreset] | None = None,
    spacing_mm: float = 1.0,
    entry_mm: float | None = None,
    errors: bool = True,
    progress: Callable[[float], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> tuple[Verdict, ...]:
    """Verdicts of several instruments on one route, in their order.

    Parameters
    ----------
    tree, plan, wall
        The airways, what `plan_route` found, and the airways' wall.
    route
        One of the plan's; the first unless told.
    scopes
        The whole library unless told.
    spacing_mm
        Coarsest spacing of the CT: how sure a lumen's width is.
    entry_mm
        From nose or mouth to where the tree begins; None leaves the length of the instrument open.
    errors
        False takes all figures as exact.
    progress, cancel
        Told the share done; asked whether to stop.

    Raises
    ------
    UsageError
        If the plan has no route, or a number is out of range.
    CancelledError
        If ``cancel()`` said so.
    """
    listed = list(scope_presets() if scopes is None else scopes)
    found = []
    for n, preset in enumerate(listed):
        if cancel is not None and cancel():
            raise CancelledError("the verdicts were cancelled")
        if progress is not None:
            progress(n / max(len(listed), 1))
        found.append(
            judge_scope(tree, plan, wall, preset, route=route, spacing_mm=spacing_mm, entry_mm=entry_mm, errors=errors)
        )
    if progress is not None:
        progress(1.0)
    return tuple(found)


def judge_scope(
    tree: AirwayTree,
    plan: Plan,
    wall: WallField,
    scope: ScopePreset,
    *,
    route: PlannedRoute | None = None,
    spacing_mm: float = 1.0,
    entry_mm: float | None = None,
    errors: bool = True,
) -> Verdict:
    """The verdict of one instrument; see `judge_scopes`."""
    if route is None and not plan.routes:
        raise UsageError("the plan has no route to judge", code="plan.no-route")
    if not (math.isfinite(spacing_mm) and 0.0 < spacing_mm <= 20.0):
        raise UsageError(f"spacing_mm: expected above 0 up to 20; found {spacing_mm}", code="plan.range")
    planned = plan.routes[0] if route is None else route
    whole = tree.route_to(planned.branch_id)
    way = _Way(tree, whole, planned)
    sigma = ROOM_SHARE * spacing_mm if errors else 0.0
    checks = [
        _diameter(way, scope, sigma, errors=errors),
        _bend(way, scope, errors=errors),
        _length(way, scope, entry_mm),
        _channel(scope, plan.tool),
    ]
    laid = scope
    if checks[0].answer == "perhaps":
        # As wide as the airway, within the errors: how it points where it passes is told of one that does pass.
        laid = replace(scope, tip_mm=max(float(way.room_mm.min()) - SLIMMER_MM, 1.0), tube_mm=None)
    reached_mm, hold, pointing = _pointing(way, wall, laid, plan, errors=errors)
    if checks[0].answer == "perhaps" and pointing.answer == "yes":
        pointing = replace(pointing, answer="perhaps", words=f"if it fits, it {pointing.words}")
    checks.append(pointing)
    answers = {check.answer for check in checks}
    outcome: Outcome = (
        "does not reach"
        if "no" in answers
        else "cannot say"
        if "unknown" in answers
        else "may reach"
        if "perhaps" in answers
        else "reaches"
    )
    shares = [check.share for check in checks if check.share is not None]
    return Verdict(
        scope=scope,
        outcome=outcome,
        share=min(shares) if shares else None,
        checks=tuple(checks),
        reached_mm=reached_mm,
        hold=hold,
        would=_would(checks),
    )


class _Way:
    """The route as far as the tip goes."""

    def __init__(self, tree: AirwayTree, route: Route, planned: PlannedRoute) -> None:
        tip = np.array(planned.leg.tip_lps)
        self.points, self.cumulative_mm = route.points_lps, route.cumulative_mm
        self.park_mm = float(self.cumulative_mm[int(np.argmin(np.linalg.norm(self.points - tip, axis=1)))])
        self.aim = np.array(planned.leg.aim_lps)
        # The ball that fits at each point of the centrelines; at the trachea's upper end the CT may cut it.
        lineage = tree.lineage(planned.branch_id)
        points = np.concatenate([branch.points for branch in lineage])
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        room = 2.0 * np.concatenate([branch.wall_distance for branch in lineage])
        on_the_way = (at >= CUT_MM) & (at <= planned.along_mm + 1e-6)
        self.room_at_mm, self.room_mm = at[on_the_way], room[on_the_way]

    def at(self, mm: float | Points) -> Points:
        """Places along the route, (..., 3)."""
        return np.stack([np.interp(mm, self.cumulative_mm, self.points[:, axis]) for axis in range(3)], axis=-1)

    def direction(self, mm: float) -> Points:
        """Unit vector along it."""
        low, high = max(mm - SMOOTH_MM, 0.0), min(mm + SMOOTH_MM, float(self.cumulative_mm[-1]))
        ahead = self.at(high) - self.at(low)
        found: Points = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        return found


def _answer(share: float) -> Answer:
    return "yes" if share >= SURE else "no" if share <= 1.0 - SURE else "perhaps"


def _passes(spare: float, sigma: float) -> float:
    """How likely it is that what is spare is above 0."""
    if sigma <= 0.0:
        return 1.0 if spare >= 0.0 else 0.0
    return 0.5 * (1.0 + math.erf(spare / sigma / math.sqrt(2.0)))


def _diameter(way: _Way, scope: ScopePreset, sigma_mm: float, *, errors: bool) -> Check:
    n = int(np.argmin(way.room_mm))
    room, where = float(way.room_mm[n]), float(way.room_at_mm[n])
    needs = scope.fit_mm if errors else max(scope.tip_mm, scope.tube_mm or 0.0)
    sigma = math.hypot(sigma_mm, EXCESS_SIGMA_MM) if errors else 0.0
    share = _passes(room - needs, sigma)
    more = f" \u00b1 {1.645 * sigma:.1f}" if sigma > 0.0 else ""
    words = f"needs {needs:.1f} mm; the narrowest place, {where:.0f} mm along the route, is {room:.1f}{more} mm wide"
    margin = f", and {FIT_MARGIN_MM:g} mm measured excess (s)" if errors else ""
    basis = f"tip {scope.tip_mm:g} mm ({_basis(scope)}){margin}; lumen from the CT"
    return Check("diameter", _answer(share), share, words, basis)


def _bend(way: _Way, scope: ScopePreset, *, errors: bool) -> Check:
    if scope.flexion_deg is None or scope.bending_mm is None:
        words = "its flexion or bending section is not known"
        return Check("bend", "unknown", None, words, "flexion and bending section unknown")
    most = max(scope.flexion_deg)
    section = float(np.mean(scope.bending_mm)) + (scope.rigid_tip_mm or 0.0)
    worst, where = 0.0, 0.0
    for mm in np.arange(section, way.park_mm + 1e-6, 1.0):
        cosine = float(np.clip(way.direction(mm) @ way.direction(mm - section), -1.0, 1.0))
        asked = math.degrees(math.acos(cosine))
        if asked > worst:
            worst, where = asked, float(mm)
    share = _passes(most - worst, BEND_SIGMA_DEG if errors else 0.0)
    words = (
        f"the bend {where:.0f} mm along the route requires {worst:.0f} degrees of flexion; this scope has {most:.0f}"
    )
    basis = f"flexion {most:g} degrees, bending section {np.mean(scope.bending_mm):g} mm ({_basis(scope)})"
    return Check("bend", _answer(share), share, words, basis)


def _length(way: _Way, scope: ScopePreset, entry_mm: float | None) -> Check:
    basis = f"working length ({_basis(scope)})"
    if scope.length_mm is None:
        return Check("length", "unknown", None, "its working length is not known", basis)
    spare = scope.length_mm - way.park_mm
    if entry_mm is None:
        words = (
            f"{way.park_mm:.0f} mm from the start of the airway tree; a working length of {scope.length_mm:.0f} mm "
            f"leaves {spare:.0f} mm from nose or mouth to that point"
        )
        # From the nose to the carina there are some 320 mm at most in adults (k).
        return Check(
            "length", "yes" if spare >= LONGEST_ENTRY_MM else "no" if spare < 0 else "perhaps", None, words, basis
        )
    left = spare - entry_mm
    words = f"needs a working length of {way.park_mm + entry_mm:.0f} mm; this scope has {scope.length_mm:.0f}"
    return Check("length", "yes" if left >= 0.0 else "no", None, words, basis)


def _channel(scope: ScopePreset, tool: Tool) -> Check:
    basis = f"channel ({_basis(scope)}), {tool.title} ({tool.basis})"
    if scope.channel_mm is None:
        return Check("channel", "unknown", None, "its working channel is not known", basis)
    words = f"{tool.title} has a diameter of {tool.outer_mm:g} mm; the working channel has {scope.channel_mm:g} mm"
    return Check("channel", "yes" if tool.passes(scope.channel_mm) else "no", None, words, basis)


def _pointing(
    way: _Way, wall: WallField, scope: ScopePreset, plan: Plan, *, errors: bool
) -> tuple[float, ScopeHold | None, Check]:
    basis = "the scope's mechanics in the airways' wall; rigid tip and bending section are common knowledge (k)"
    if scope.flexion_deg is None or scope.bending_mm is None:
        return 0.0, None, Check("pointing", "unknown", None, "its flexion or bending section is not known", basis)
    try:
        drive = ScopeDrive(wall, scope, way.points)
    except UsageError as error:
        return 0.0, None, Check("pointing", "no", 0.0, f"the scope does not enter the airway: {error}", basis)
    state = drive.place(way.points, way.park_mm)
    reached = float(state.insertion_mm)
    if reached < way.park_mm - NEAR_MM or np.linalg.norm(state.pose.position_lps - way.at(way.park_mm)) > 4.0 * NEAR_MM:
        place = f"stops at {reached:.0f} of {way.park_mm:.0f} mm along the route"
        why = f": the airway admits {state.passable_mm:.1f} mm" if state.passable_mm is not None else ""
        return reached, None, Check("pointing", "no", 0.0, place + why, basis)
    needle = NeedleErrors() if errors else NeedleErrors(0.0, 0.0)
    held: list[tuple[float, ScopeHold, Points, Points]] = []
    low, high = drive.flexion_range_rad
    levers = [*np.linspace(0.0, high, NUM_LEVERS + 1)[1:], *np.linspace(0.0, low, NUM_LEVERS + 1)[1:]]
    for roll in 2.0 * np.pi * np.arange(NUM_ROLLS) / NUM_ROLLS:
        for flexion in (0.0, *levers):
            state = drive.drive(reached, float(roll), float(flexion), 0.1)
            tip, forward = state.pose.position_lps, state.pose.lps_from_camera[:3, 2]
            off = way.aim - tip
            angle = math.acos(float(np.clip(forward @ off / max(float(np.linalg.norm(off)), 1e-9), -1.0, 1.0)))
            held.append((angle, ScopeHold(reached, float(roll), float(flexion)), tip, forward))
        drive.drive(reached, float(roll), 0.0, 0.1)
    held.sort(key=lambda one: one[0])
    shares = [
        hit_share(plan.nodule, tip, tip + forward * float(np.linalg.norm(way.aim - tip)), plan.tool.reach_mm, needle)
        for _, _, tip, forward in held[:MOST_AIMED]
    ]
    best = int(np.argmax(shares))
    share, (angle, hold, _, _) = shares[best], held[best]
    words = f"points {math.degrees(angle):.0f} degrees from the target centre; {100 * share:.0f} % of needle passes hit"
    answer: Answer = "yes" if share >= POINTS else "perhaps" if share >= BARELY else "no"
    return reached, hold, Check("pointing", answer, share, words, basis)


def _would(checks: list[Check]) -> str | None:
    lacking = [check for check in checks if check.answer in {"no", "unknown"}]
    if not lacking:
        return None
    ways = {
        "diameter": "the airway were wider or the scope thinner",
        "bend": "it could flex further, or stopped before that bend",
        "length": "it were longer",
        "channel": "a thinner tool were used",
        "pointing": "it could be aimed from another position on the route",
    }
    return "would reach if " + ", and if ".join(ways[check.name] for check in lacking)


def _basis(scope: ScopePreset) -> str:
    return scope.basis if len(scope.basis) == 1 else "partly s, partly k"
