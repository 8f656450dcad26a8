"""Judgement of instruments on one route: checks without a simulation, then a simulated drive.

The checks come first (`carina.plan.verdict.checks`). For an instrument that passes them, a drive along the route is
simulated in the wall of the airways, from the trachea to the end of the route, where the tip is pointed at the target.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from carina.errors import CancelledError, UsageError
from carina.plan.instruments.tools import ONLY_BRUSH, Tool, passing_needle, tools
from carina.plan.routes.last_leg import as_point, edge_on_needle_mm
from carina.plan.routes.needle_hits import NeedleErrors, hit_share
from carina.plan.routes.plan_route import Plan, PlannedRoute
from carina.plan.routes.ranking import BARELY, POINTS, depth_rank, depth_words
from carina.plan.routes.route_width import SURE
from carina.plan.targets.grow_nodule import Nodule
from carina.plan.verdict.checks import (
    Answer,
    Check,
    bend_check,
    channel_check,
    diameter_check,
    length_check,
)
from carina.plan.verdict.drive import DrivenRoute, MoveRecorder
from carina.plan.verdict.drive_aim import ENOUGH, WITHDRAWALS_MM, aim_drive
from carina.plan.verdict.drive_route import DriveWay
from carina.plan.verdict.drive_search import EFFORT, condense_drive, place_at_start, search_drive
from carina.plan.verdict.lever import lever_check
from carina.plan.verdict.verdict import Outcome, Verdict
from carina.scopes import ScopeDrive, ScopeHold, ScopePreset, WallField
from carina.track import AirwayTree

__all__ = ["RouteJudge"]

Points = NDArray[np.float64]
NEAR_MM = 1.5
"""Maximum distance in mm of the tip from the end of the route at which the tip counts as arrived."""
SLIMMER_MM, THINNEST_MM, SPARE_MM = 0.8, 1.5, 0.2
"""Sizes in mm that choose a thinner substitute for an instrument that may not fit into the airway.

In a lumen that was not measured, a substitute is also used if the lumen is wider than the instrument by less than
the third size. It is thinner than the airway by the first size, but not thinner than the second size. A drive of
a substitute shows that the route is possible if the instrument fits, so its verdict is never better than *may reach*.
"""
BEFORE_MM = 2.0
"""Minimum distance in mm between tip and end of the route at which the tip counts as withdrawn."""
FIELD_LACK_MM = 0.5
"""Amount in mm by which the sampled wall field narrows a narrow lumen, compared with its largest ball."""
UNFOUND = 0.5
"""Probability to report if a scope fits the route but the search found no drive (which may exist).

The value is common knowledge, not measured.
"""
EFFORT_PER_TRY = 1000.0
"""Saved search effort per shorter drive that is tried."""
LEVER_EFFORT = 0.3
"""Effort of each search with a reduced lever range, as a share of the effort of the first search.

A small share suffices, because the moves of the drive that arrived are tried first.
"""
ERROR_SHARE = NormalDist().inv_cdf(SURE) / NormalDist().inv_cdf(0.95)
"""Factor that converts the 90 % error of a diameter to the error that 10 % of true diameters exceed downwards."""
MIN_SCALE = 0.1
NARROW_EFFORT = 0.15
"""Effort of the search for a drive in the narrowest lumen within the errors, as a share of the first search's effort.

A small share suffices, because the moves of the drive that arrived are tried first.
"""
SHALLOW = 0.99 * POINTS
"""Factor of the share of needles that hit if the tool may be too short, so that the product is below `POINTS`."""
IF_IT_FITS = "if it fits: "
NOT_NARROW = "no such drive was found in an airway as narrow as the error of its diameter allows"
NOT_RIDGED = "no such drive was found if the ridges between the branches are as long as the blur of the CT may hide"
MECHANICS = "the scope's mechanics in the airways' wall; rigid tip and bending section are common knowledge (k)"


def tool_for(scope: ScopePreset, wanted: Tool) -> Tool:
    """Return the tool with which a scope is judged: the requested one, or a needle that passes the scope's channel."""
    if scope.channel_mm is None or not wanted.pierces or wanted.passes(scope.channel_mm):
        return wanted
    return passing_needle(scope, wanted) or wanted


@dataclass(frozen=True, slots=True)
class InstrumentChecks:
    """Results of the checks of one instrument that need no simulated drive."""

    checks: tuple[Check, ...]
    driven_as: ScopePreset | None
    """Instrument whose drive is simulated, or a thinner substitute; None if no drive is needed or possible."""
    is_substitute: bool = False
    """Whether the driven instrument ``driven_as`` is a thinner substitute, which proves nothing for the real width."""

    @property
    def drive_key(self) -> tuple[Any, ...]:
        """Key of the simulated drive, which is equal for instruments that share a drive."""
        assert self.driven_as is not None
        return self.is_substitute, *mechanical_sizes(self.driven_as)


@dataclass(frozen=True, slots=True)
class SimulatedDrive:
    """Results of a simulated drive of one instrument along one route."""

    route: DrivenRoute | None
    checks: tuple[Check, ...]
    bend: Check | None = None
    """Check of the bend by drives, which replaces the check by angles; None if the drive missed its end or its aim."""
    lps_from_tip: NDArray[np.float64] | None = None
    """(4, 4) final pose of the tip; None if the drive did not arrive."""
    longer: tuple[Tool, ...] = ()
    """Needles with a longer throw that hit from the final pose, if the needle of the plan does not hit."""
    withdrawn_mm: float = 0.0
    """Distance in mm by which the tip is withdrawn from the end of the route (`Verdict.withdrawn_mm`)."""


_DRIVES: WeakKeyDictionary[PlannedRoute, dict[tuple[Any, ...], tuple[Any, SimulatedDrive]]] = WeakKeyDictionary()
"""Cache of completed drives of each route: key of the inputs, the input objects, and the result.

A plan and the verdicts on its routes share their drives through this cache.
"""


class RouteJudge:
    """Judgement of instruments on one route: checks without a simulation, then a simulated drive.

    Parameters
    ----------
    tree, plan, wall, route, entry_mm, errors, effort, cancel
        As for `judge_scopes`.
    """

    def __init__(
        self,
        tree: AirwayTree,
        plan: Plan,
        wall: WallField,
        *,
        route: PlannedRoute | None = None,
        origin_depth_mm: float | None = None,
        errors: bool = True,
        effort: float = EFFORT,
        cancel: Callable[[], bool] | None = None,
    ) -> None:
        if route is None and not plan.routes:
            raise UsageError("the plan has no route to judge", code="plan.no-route")
        planned = plan.routes[0] if route is None else route
        self._aim = np.array(plan.aims[planned.aim]) if plan.aims else np.array(planned.leg.aim_lps)
        lumen = planned.lumen
        self._drive_wall = wall if lumen is None else lumen.widened(wall)
        self._way = self._way_in(tree, planned, self._drive_wall)
        self._tree, self._route, self._key = tree, planned, planned.key
        self._plan, self._wall = plan, wall
        self._least_nodule = _smaller(plan.nodule) if errors else plan.nodule
        self._origin_depth_mm, self._errors = origin_depth_mm, errors
        self._effort, self._cancel = effort, cancel
        self.stopped = False

    @property
    def aim(self) -> Points:
        """Point in the target that the drive is aimed at, (3,) LPS mm."""
        return self._aim

    def with_tool(self, tool: Tool) -> RouteJudge:
        """Return a judge of the same route for instruments with another tool, which shares the route and its wall."""
        other = copy(self)
        other._plan = replace(self._plan, tool=tool)
        return other

    def _way_in(self, tree: AirwayTree, planned: PlannedRoute, wall: WallField) -> DriveWay:
        way = DriveWay(tree, planned, wall)
        way.aim = self._aim
        return way

    def verdict(self, scope: ScopePreset) -> Verdict:
        """Return the verdict on an instrument."""
        figures = self.figures(scope)
        if figures.driven_as is None:
            return self.undriven(scope, figures)
        return self.driven(scope, figures, self.drive(figures))

    def tip_of(self, scope: ScopePreset) -> NDArray[np.float64] | None:
        """Return the pose (4, 4), LPS mm, of an instrument's tip after its drive; None if no drive is cached."""
        figures = self.figures(scope)
        known = None if figures.driven_as is None else _DRIVES.get(self._route, {}).get(self._inputs(figures))
        return None if known is None else known[1].lps_from_tip

    def pass_on(self, route: PlannedRoute) -> None:
        """Copy the cached drives along this route to another version of the route."""
        _DRIVES[route] = dict(_DRIVES.get(self._route, {}))

    def drive(self, figures: InstrumentChecks) -> SimulatedDrive:
        """Return the simulated drive of an instrument or its substitute, computed once for the same inputs."""
        assert figures.driven_as is not None
        inputs, known = self._inputs(figures), _DRIVES.setdefault(self._route, {})
        if inputs not in known:
            # The cache entry refers to airways, wall and nodule, so that their identities in the key stay valid.
            known[inputs] = (
                (self._tree, self._wall, self._plan.nodule),
                self._drive(figures.driven_as, is_substitute=figures.is_substitute),
            )
        return known[inputs][1]

    def _inputs(self, figures: InstrumentChecks) -> tuple[Any, ...]:
        return (
            id(self._tree),
            id(self._wall),
            id(self._plan.nodule),
            tuple(self._aim.tolist()),
            self._plan.tool,
            self._plan.errors if self._errors else None,
            self._effort,
            figures.drive_key,
        )

    def stop_if_cancelled(self) -> None:
        """Raise `CancelledError` if cancellation is requested."""
        if self._is_cancelled():
            raise CancelledError("the verdicts were cancelled")

    def figures(self, scope: ScopePreset) -> InstrumentChecks:
        """Return the results of the checks that need no drive, and the instrument whose drive is simulated."""
        checks = (
            diameter_check(self._way.width, scope, errors=self._errors),
            bend_check(self._way, scope, errors=self._errors),
            length_check(self._way, scope, self._origin_depth_mm),
            channel_check(scope, self._plan.tool),
        )
        driven_as: ScopePreset | None = scope
        if any(check.answer == "no" for check in checks[:3]) or checks[1].answer == "unknown":
            driven_as = None
        elif self._errors:
            is_measured = self._route.lumen is not None
            diameter_mm = self._way.width.mm if is_measured else float(self._way.ball_diameter_mm.min()) - FIELD_LACK_MM
            is_tight = not is_measured and max(scope.tip_mm, scope.tube_mm or 0.0) > diameter_mm - SPARE_MM
            if checks[0].answer == "perhaps" or is_tight:
                slim = min(max(diameter_mm - SLIMMER_MM, THINNEST_MM), scope.tip_mm)
                driven_as = replace(scope, tip_mm=slim, tube_mm=None)
        return InstrumentChecks(checks, driven_as, driven_as is not None and driven_as is not scope)

    def undriven(self, scope: ScopePreset, figures: InstrumentChecks) -> Verdict:
        """Return the verdict on an instrument without a simulated drive."""
        reached_mm: float | None = None
        if figures.checks[1].answer != "unknown":
            # A scope that is too wide to enter stops at the start of the tree.
            reached_mm = self._way.from_origin_mm(0.0)
            with contextlib.suppress(UsageError):
                reached_mm = self._way.from_origin_mm(min(self._laid_mm(scope), self._way.park_mm))
        return self._verdict_of(scope, figures.checks, reached_mm, None)

    def driven(self, scope: ScopePreset, figures: InstrumentChecks, drive: SimulatedDrive) -> Verdict:
        """Return the verdict on an instrument from its checks and its simulated drive."""
        checks = drive.checks
        if figures.is_substitute:
            assert figures.driven_as is not None
            thinner = f"; driven as a scope of {figures.driven_as.tip_mm:.1f} mm, not with its own width"
            checks = tuple(
                replace(one, answer="perhaps", words=f"{IF_IT_FITS}{one.words}", basis=f"{one.basis}{thinner}")
                if one.answer == "yes"
                else one
                for one in checks
            )
        route = None if drive.route is None else replace(drive.route, scope_name=scope.name)
        reached_mm = self._way.from_origin_mm(0.0) if route is None else route.stopped_mm
        diameter, bend, *others = figures.checks
        size_checks = (diameter, bend if drive.bend is None else drive.bend, *others)
        return self._verdict_of(scope, (*size_checks, *checks), reached_mm, route, drive)

    def _verdict_of(
        self,
        scope: ScopePreset,
        checks: tuple[Check, ...],
        reached_mm: float | None,
        route: DrivenRoute | None,
        drive: SimulatedDrive | None = None,
    ) -> Verdict:
        tool = self._plan.tool
        found = _verdict(scope, checks, reached_mm, route, would=_would(scope, tool, checks, drive))
        needle_lps = None if drive is None else self._needle_lps(drive)
        return replace(
            found,
            origin=self._way.origin,
            route_key=self._key,
            tool=tool.name,
            needle_lps=needle_lps,
            withdrawn_mm=0.0 if drive is None else drive.withdrawn_mm,
        )

    def _needle_lps(
        self, drive: SimulatedDrive
    ) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
        pointing = next((check for check in drive.checks if check.name == "pointing"), None)
        if drive.lps_from_tip is None or pointing is None or not pointing.share:
            return None
        tip, forward = drive.lps_from_tip[:3, 3], drive.lps_from_tip[:3, 2]
        end = tip + float(np.linalg.norm(self._way.aim - tip)) * forward
        return as_point(tip), as_point(end)

    def _drive(self, scope: ScopePreset, *, is_substitute: bool) -> SimulatedDrive:
        """Simulate the drive of an instrument, and point its tip at the target if it arrives.

        A substitute is not driven in the narrowest lumen: its verdict states only what follows if the instrument fits.
        """
        try:
            route = search_drive(self._way, self._drive_wall, scope, effort=self._effort, cancel=self._is_cancelled)
        except UsageError as error:
            check = Check("drive", "no", 0.0, f"the scope does not enter the airway: {error}", MECHANICS)
            return SimulatedDrive(None, (check,))
        if not route.arrived:
            lacks_mm = self._way.from_origin_mm(self._way.park_mm) - route.stopped_mm
            words = f"the drive stops {lacks_mm:.0f} mm before the end of the route: {route.why}"
            if self._laid_mm(scope) < self._way.park_mm - NEAR_MM:
                return SimulatedDrive(route, (Check("drive", "no", 0.0, words, MECHANICS),))
            words += "; the scope fits along the whole route, and another way of driving it may get there"
            return SimulatedDrive(route, (Check("drive", "perhaps", UNFOUND, words, MECHANICS),))
        aimed = aim_drive(self._way, self._drive_wall, scope, route, self._aimed_share)
        bend = None
        if aimed.share >= BARELY:
            # Only a drive that points at the target is shortened, because shortening takes most of the time.
            self.stop_if_cancelled()
            tries = round(self._effort / EFFORT_PER_TRY)
            route = condense_drive(self._way, self._drive_wall, scope, route, tries=tries, cancel=self._is_cancelled)
            self.stop_if_cancelled()
            bend = lever_check(
                self._way,
                self._drive_wall,
                scope,
                bend_check(self._way, scope, errors=self._errors),
                route,
                effort=LEVER_EFFORT * self._effort,
                cancel=self._is_cancelled,
            )
            shorter = aim_drive(self._way, self._drive_wall, scope, route, self._aimed_share)
            aimed = shorter if shorter.share >= min(aimed.share, ENOUGH) else aimed
        words = f"arrives at the end of the route by {len(route.moves)} moves"
        arrives = Check("drive", "yes", 1.0, words, MECHANICS)
        unsure = None if is_substitute or aimed.share < POINTS else self._unsure_lumen(scope, aimed.driven)
        if unsure is not None:
            arrives = Check("drive", "perhaps", UNFOUND, f"{words}; {unsure}", MECHANICS)
        tip = aimed.lps_from_tip
        share = self._hit_share(tip[:3, 3], tip[:3, 2])
        answer: Answer = "yes" if aimed.share >= POINTS else "perhaps" if share >= BARELY else "no"
        loss_deg, basis = self._plan.tool.flexion_loss_deg, MECHANICS
        if loss_deg is None:
            basis += f"; how much flexion is lost with {self._plan.tool.title} in the channel is not known"
        elif answer == "yes" and not self._flexes_with_tool(scope, aimed.driven, loss_deg):
            answer = "perhaps"
            basis += f"; {self._plan.tool.title} in the channel takes {loss_deg:g} degrees of the flexion that it needs"
        withdrawn_mm = aimed.before_mm if aimed.before_mm >= BEFORE_MM else 0.0
        place = f", {withdrawn_mm:.0f} mm before the standing place" if withdrawn_mm else ""
        hits = f"{100 * share:.0f} % of needle passes hit"
        words = f"points {aimed.off_deg:.0f} degrees from the target centre{place}; {hits}"
        if self._sure_share(tip[:3, 3], tip[:3, 2]) < POINTS <= share:
            words += ", but fewer than half if the target is as small as its error allows"
        if aimed.share < POINTS and share >= BARELY and not self._is_deep(tip[:3, 3], tip[:3, 2]):
            words += f"; {depth_words(self._spare_mm(tip[:3, 3], tip[:3, 2]))}"
        pointing = Check("pointing", answer, share, words, basis)
        longer: tuple[Tool, ...] = ()
        if answer != "yes" and self._plan.tool.pierces:
            reach_mm = self._plan.tool.reach_mm
            longer = tuple(
                one
                for one in tools()
                if one.pierces
                and one.reach_mm > reach_mm
                and self._aimed_share(tip[:3, 3], tip[:3, 2], reach_mm=one.reach_mm) >= POINTS
            )
        return SimulatedDrive(aimed.driven, (arrives, pointing), bend, aimed.lps_from_tip, longer, withdrawn_mm)

    def _unsure_lumen(self, scope: ScopePreset, driven: DrivenRoute) -> str | None:
        """Return the error of the lumen with which no drive points at the target, as text; None if there is none.

        The errors are those of the diameters and of the ridges between branches. Both are tried together first, because
        a drive that points in this lumen needs no other; that both occur is too unlikely to be required. A lumen that
        was not measured (`PlannedRoute.lumen` is None) has no error of its diameters, but its ridges.
        """
        if not self._errors:
            return None
        lumen, ridges = self._route.lumen, self._route.ridges
        narrow = self._drive_wall if lumen is None else lumen.narrowest(self._wall, error_share=ERROR_SHARE)
        both = ridges.lengthened(narrow)
        if both is self._drive_wall or self._points_in(both, scope, driven):
            return None
        if both is narrow:
            return NOT_NARROW
        if narrow is self._drive_wall:
            return NOT_RIDGED
        if not self._points_in(narrow, scope, driven):
            return NOT_NARROW
        return None if self._points_in(ridges.lengthened(self._drive_wall), scope, driven) else NOT_RIDGED

    def _points_in(self, wall: WallField, scope: ScopePreset, driven: DrivenRoute) -> bool:
        """Return whether the moves of a drive, or another drive, point at the target in another lumen."""
        self.stop_if_cancelled()
        way = self._way_in(self._tree, self._route, wall)
        try:
            recorder = MoveRecorder(place_at_start(way, wall, scope))
            recorder.repeat(driven.moves)
            if self._points_from(way, recorder.state.pose.lps_from_camera):
                return True
            effort = NARROW_EFFORT * self._effort
            found = search_drive(way, wall, scope, effort=effort, cancel=self._is_cancelled)
        except UsageError:
            return False
        # A drive that stops just before the end of the route suffices if it points at the target.
        if self._way.from_origin_mm(self._way.park_mm) - found.stopped_mm > max(WITHDRAWALS_MM):
            return False
        return self._points_from(way, aim_drive(way, wall, scope, found, self._hit_share).lps_from_tip)

    def _points_from(self, way: DriveWay, lps_from_tip: NDArray[np.float64]) -> bool:
        """Return whether a tip is in the lumen of a route and at least half of its needles hit the target.

        The target has its measured size: that the lumen is at its narrowest and the target at its smallest is too
        unlikely to be required together.
        """
        tip, forward = lps_from_tip[:3, 3], lps_from_tip[:3, 2]
        along_mm = float(way.cumulative_mm[int(np.argmin(np.linalg.norm(way.points - tip, axis=1)))])
        return way.holds(tip, along_mm) and self._hit_share(tip, forward) >= POINTS

    @staticmethod
    def _flexes_with_tool(scope: ScopePreset, driven: DrivenRoute, loss_deg: float) -> bool:
        flexion_deg = math.degrees(float(driven.samples[-1, 2]))
        up_deg, down_deg = scope.flexion_deg or (0.0, 0.0)
        return -(down_deg - loss_deg) <= flexion_deg <= up_deg - loss_deg

    def _laid_mm(self, scope: ScopePreset) -> float:
        drive = ScopeDrive(self._drive_wall, scope, self._way.points)
        state = drive.place(self._way.points, self._way.park_mm)
        return self._way.nearest(state.pose.position_lps, state.insertion_mm)[0]

    def _aimed_share(self, tip: Points, forward: Points, *, reach_mm: float | None = None) -> float:
        """Return the share of needles that aiming increases: `_sure_share`, below half if the tool may be too short.

        Without the second criterion, aiming would stop at a pose whose needle only just reaches the target.
        """
        share = self._sure_share(tip, forward, reach_mm=reach_mm)
        return share if share < POINTS or self._is_deep(tip, forward, reach_mm=reach_mm) else SHALLOW * share

    def _is_deep(self, tip: Points, forward: Points, *, reach_mm: float | None = None) -> bool:
        """Return whether the tool surely reaches the edge of the target (`ranking.depth_rank`)."""
        return not self._errors or int(depth_rank(self._spare_mm(tip, forward, reach_mm=reach_mm))) == 0

    def _spare_mm(self, tip: Points, forward: Points, *, reach_mm: float | None = None) -> float:
        """Return the length in mm of the tool beyond the edge of the target; negative if the tool ends before it."""
        throw_mm = self._plan.tool.reach_mm if reach_mm is None else reach_mm
        aimed_at = tip + forward * float(np.linalg.norm(self._aim - tip))
        return throw_mm - edge_on_needle_mm(self._plan.nodule, tip, aimed_at, throw_mm)

    def _sure_share(self, tip: Points, forward: Points, *, reach_mm: float | None = None) -> float:
        """Return the share of needles that hit a target reduced by the error of its boundary."""
        return self._hit_share(tip, forward, reach_mm=reach_mm, nodule=self._least_nodule)

    def _hit_share(
        self, tip: Points, forward: Points, *, reach_mm: float | None = None, nodule: Nodule | None = None
    ) -> float:
        needle = self._plan.errors if self._errors else NeedleErrors(0.0, 0.0)
        aimed_at = tip + forward * float(np.linalg.norm(self._way.aim - tip))
        throw_mm = self._plan.tool.reach_mm if reach_mm is None else reach_mm
        return hit_share(self._plan.nodule if nodule is None else nodule, tip, aimed_at, throw_mm, needle)

    def _is_cancelled(self) -> bool:
        return self.stopped or (self._cancel is not None and self._cancel())


def _smaller(nodule: Nodule) -> Nodule:
    """Return a nodule that is scaled down about its middle by the error of its boundary."""
    diameter_mm = 0.5 * (nodule.long_mm + nodule.short_mm)
    scale = max(1.0 - ERROR_SHARE * nodule.diameter_error_mm / max(diameter_mm, 1e-6), MIN_SCALE)
    centre = np.array(nodule.centre_lps)
    matrix = nodule.lps_from_ijk.copy()
    matrix[:3, :3] *= scale
    matrix[:3, 3] = centre + scale * (matrix[:3, 3] - centre)
    return replace(nodule, lps_from_ijk=matrix)


def mechanical_sizes(scope: ScopePreset) -> tuple[Any, ...]:
    """Return the sizes of an instrument that determine its mechanics, as a key for shared drives."""
    return (
        scope.tip_mm,
        scope.tube_mm or scope.tip_mm,
        scope.rigid_tip_mm,
        scope.bending_mm,
        scope.flexion_deg,
        scope.length_mm,
        scope.view_up_deg,
    )


def _verdict(
    scope: ScopePreset,
    checks: tuple[Check, ...],
    reached_mm: float | None,
    route: DrivenRoute | None,
    *,
    would: str | None,
) -> Verdict:
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
    hold = None
    if route is not None and route.arrived:
        insertion_mm, roll_rad, flexion_rad = (float(v) for v in route.samples[-1])
        hold = ScopeHold(insertion_mm, roll_rad, flexion_rad)
    return Verdict(
        scope=scope,
        outcome=outcome,
        share=min(shares) if shares else None,
        checks=checks,
        reached_mm=reached_mm,
        hold=hold,
        driven=route,
        would=would,
    )


def _would(scope: ScopePreset, tool: Tool, checks: tuple[Check, ...], drive: SimulatedDrive | None) -> str | None:
    """Return the changes with which an instrument would reach the target, as text.

    *Would reach* is stated only of another tool, and only after a drive that arrives and points at the target.
    """
    lacking = [check for check in checks if check.answer in {"no", "unknown"}]
    missed = next((check for check in checks if check.name == "pointing" and check.answer != "yes"), None)
    if missed is not None and not missed.words.startswith(IF_IT_FITS) and all(check is missed for check in lacking):
        # The planner has already tried other positions, so only a tool with a longer reach is named.
        takes = None if drive is None or scope.channel_mm is None else scope.channel_mm
        longer = [one for one in (drive.longer if drive is not None else ()) if takes is not None and one.passes(takes)]
        return f"would reach if {longer[0].title} were used" if longer else None
    if not lacking or any(check.name == "pointing" for check in lacking):
        return None
    thinner = passing_needle(scope, tool)
    if thinner is None and any((check.name, check.answer) == ("channel", "no") for check in lacking):
        return ONLY_BRUSH if tool.pierces else None
    ways = {
        ("diameter", "no"): "the airway were wider or the scope thinner",
        ("bend", "no"): "it could flex further",
        ("bend", "unknown"): "it can flex far enough",
        ("length", "no"): "it were longer",
        ("length", "unknown"): "it is long enough",
        ("channel", "no"): f"{'' if thinner is None else thinner.title} were used",
        ("channel", "unknown"): "its channel takes the tool",
        ("drive", "no"): "it could be steered past that place",
    }
    pointed = any((check.name, check.answer) == ("pointing", "yes") for check in checks)
    start = "could reach only if "
    if pointed:
        start = "might reach if " if any(check.answer == "perhaps" for check in checks) else "would reach if "
    return start + ", and if ".join(ways[check.name, check.answer] for check in lacking)
