"""Routes to a target outside the airways: the position of the scope, and the last leg through the wall.

Every centreline point from which the tool may reach the target is evaluated, and the best one of each branch is
returned. Routes that the planned scope reaches come first, then those that it may reach; the score ranks routes of the
same class (docs/decisions/0122).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import (
    check_fields,
    choice,
    each,
    instance,
    lps_point,
    number_from,
    text_of,
)
from carina.display import one_line
from carina.display.tables import ColumnKind, Columns, Tabular, columns_of
from carina.errors import CancelledError, UsageError
from carina.plan.instruments.tools import Tool, tools
from carina.plan.lungs.tissue_near_needle import surroundings
from carina.plan.movement.target_movement import TargetMovement
from carina.plan.routes.attainable_directions import StandingPlace, TipDirections
from carina.plan.routes.ct_notes import ct_notes
from carina.plan.routes.fork_ridges import RouteRidges, fork_ridges
from carina.plan.routes.last_leg import LastLeg, NeedleScene, leg_as_aimed, where_it_may_have_moved, with_errors
from carina.plan.routes.main_carina import DistanceOrigin, distance_origin
from carina.plan.routes.measured_lumen import MeasuredLumen, measured_lumen
from carina.plan.routes.needle_hits import NeedleErrors
from carina.plan.routes.no_route_reasons import (
    LostAirway,
    check_target,
    lost_airway,
    notes_of_target,
    notes_of_tools,
    why_none,
)
from carina.plan.routes.predictors import RoutePredictors, route_predictors
from carina.plan.routes.ranking import Judge, Outlook, PathRequirements, ScoreWeights, bending_mm, order
from carina.plan.routes.route_width import (
    Fit,
    RouteOpening,
    RouteWidth,
    measures_of,
    openings_of_route,
)
from carina.plan.routes.standing_points import BronchusSign, NearestPlace, ScopePositions, branch_title
from carina.plan.targets.doubts import Confirmed, TargetDoubt, check_confirmed, confirmed_codes, target_doubts
from carina.plan.targets.from_click import target_from_click
from carina.plan.targets.nodule import Nodule
from carina.plan.targets.target import PlanTarget
from carina.scopes import ScopeHold, ScopePreset, WallField
from carina.track import Airways, TreeMeasures, wall_field
from carina.volume import Volume

__all__ = [
    "PLANNED_SCOPE",
    "BronchusSign",
    "CancellableProgress",
    "DraftPlan",
    "NearestPlace",
    "Outlook",
    "Plan",
    "PlanRequest",
    "PlannedRoute",
    "RoutePlace",
    "ScoreWeights",
    "check_target_type",
    "draft_plan",
    "is_at",
]

Points = NDArray[np.float64]
RoutePlace = tuple[int, float, int]
"""ID of the branch that contains a tip, the tip's distance from the root in mm, and the index of the aim."""

PLANNED_SCOPE = "thin"
"""Scope of a plan if the caller states none: the thinnest whose channel lets a needle of 1.8 mm pass."""
MAX_ANGLE_DEG = 100.0
"""Maximum angle in degrees between needle and airway's axis; a needle at a larger angle would hit the scope."""
MAX_ROUTES = 5
MAX_AIMS = 3
SAME_PLACE_MM = 0.01
"""Maximum difference in mm along a branch between two positions that count as the same position."""
APART_MM = 4.0
"""Minimum distance in mm between the scope positions of two routes to one aim."""
BEYOND_MM, MIN_MARGIN_MM, ROUND_MM = 10.0, 3.0, 6.0
"""Margins in mm of the examined box: beyond the target, beside the needle, and for the reach of image filters."""
MAX_BOX_MM = 60.0


@one_line
@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class PlannedRoute:
    """Route along the airways to the position of the scope, and from there into the target."""

    branch_id: int
    """ID of the branch that contains the final tip of the scope."""
    branch_name: str
    along_mm: float
    """Distance of the tip from the root along the airways, mm."""
    origin: DistanceOrigin
    """Origin of all distances along the route: the ridge of the main carina, or a substitute."""
    forward: tuple[float, float, float]
    """Direction of the airway at the tip, unit vector, LPS."""
    width: RouteWidth
    """Narrowest diameter of the route, with its error."""
    fit: Fit
    """Whether the scope with its margin fits through the route, may fit within the errors, or does not fit."""
    leg: LastLeg
    parts: dict[str, float]
    """Contributions to the route's score by name (see `ScoreWeights`), each 0 (best) to 1."""
    score: float
    """Score of the route, 0 to 1 (best)."""
    doubts: tuple[str, ...]
    """Warnings that every view of the route shows: drawn branches, bridges, doubtful branches."""
    aim: int = 0
    """Index of the aim among the plan's aims, from 0."""
    outlook: Outlook = "may reach"
    """Whether scope and tool reach the target, as the simulated drive of `carina.plan_route` shows.

    Without drives (``drives=0``) it is estimated from width, bend, doubts, reach and attainable directions.
    """
    chance: float = 1.0
    """Probability, 0 to 1, that scope and tool reach the target by the checks that determine ``outlook``."""
    limits: tuple[str, ...] = ()
    """Reasons why the scope or the tool does not, or may not, reach the target."""
    bend_deg: float = 0.0
    """Sharpest turn of the route in degrees, over the length of the scope's rigid tip and bending section."""
    tools: tuple[str, ...] = ()
    """Names of the tools that pass the scope's channel and reach the target from its tip."""
    hold: ScopeHold | None = None
    """Insertion, roll and lever with which the drive points at the target; None without a drive that arrives."""
    withdrawn_mm: float = 0.0
    """Distance in mm by which the drive withdraws the tip from the route's end to aim at the target."""
    predictors: RoutePredictors | None = None
    """Published predictors of a failed navigation; None for a route that was not made by `plan_route`."""
    openings: dict[int, RouteOpening] = field(default_factory=dict)
    """Openings at the forks of the route, by the ID of the branch that begins there.

    No opening of the route is narrower than ``width``. Empty for a route that was not made by `plan_route`.
    """
    lumen: MeasuredLumen | None = None
    """Measured lumen along the route, in which drives are simulated; None drives in the segmented lumen."""
    ridges: RouteRidges = field(default_factory=RouteRidges)
    """Ridges at the forks of the route; none for a route that was not made by `plan_route`."""

    @property
    def key(self) -> str:
        """Identifier of scope position and aim, independent of the rank: "17-204.5", or "17-204.5-2" for aim 2."""
        return f"{self.branch_id}-{self.along_mm:.1f}" + (f"-{self.aim + 1}" if self.aim else "")

    @property
    def from_carina_mm(self) -> float | None:
        """Distance of the tip from the ridge of the main carina along the airways, mm; None without a main carina."""
        return self.origin.from_carina_mm(self.along_mm)

    @property
    def place_words(self) -> str:
        """Place of the tip as text, such as *42 mm past the main carina*."""
        return self.origin.words(self.origin.past_mm(self.along_mm))

    def withdrawn_words(self, withdrawn_mm: float) -> str:
        """Return as text that a drive withdraws the tip, and the place from which it aims at the target.

        The text does not state whether the tip points at the target; the check of the pointing does.
        """
        place = self.origin.words(self.origin.past_mm(self.along_mm) - withdrawn_mm)
        return (
            f"the drive withdraws the tip by {withdrawn_mm:.0f} mm from the end of the route, and aims at the target "
            f"{place}, not {self.place_words}"
        )

    @property
    def narrowest_mm(self) -> float:
        """Narrowest diameter of the route in mm, without its error."""
        return self.width.mm

    @property
    def hit_share(self) -> float | None:
        """Share of needles that hit at the end of the simulated drive; None if no drive of the scope has arrived.

        All outputs state this share. Before a drive, `LastLeg.hit_share` of ``leg`` is an estimate that only ranks
        routes.
        """
        return None if self.hold is None else self.leg.hit_share

    @property
    def hit_share_moved(self) -> float | None:
        """`hit_share` if the target may have moved; None also if it was not computed."""
        return None if self.hold is None else self.leg.hit_share_moved

    @property
    def hit_words(self) -> str:
        """Shares of needles that hit as text, such as *expected hits 92 %, 40 % if the target has moved*."""
        if self.hit_share is None:
            return "expected hits not known, because no simulated drive has arrived"
        moved = "" if self.hit_share_moved is None else f", {100 * self.hit_share_moved:.0f} % if the target has moved"
        return f"expected hits {100 * self.hit_share:.0f} %{moved}"

    @property
    def fits(self) -> bool:
        """Whether the scope with its margin fits with high probability."""
        return self.fit == "fits"

    def to_json(self) -> dict[str, Any]:
        """Return the route as plain JSON types."""
        return {
            "key": self.key,
            "branch_id": self.branch_id,
            "branch_name": self.branch_name,
            "along_mm": self.along_mm,
            "origin": self.origin.to_json(),
            "from_carina_mm": self.from_carina_mm,
            "past_carina_mm": self.from_carina_mm,
            "aim": self.aim,
            "parking": {
                "place_lps": list(self.leg.tip_lps),
                "roll_rad": None if self.hold is None else self.hold.roll_rad,
                "flexion_rad": None if self.hold is None else self.hold.flexion_rad,
                "withdrawn_mm": self.withdrawn_mm,
            },
            "forward": list(self.forward),
            **self.width.to_json(),
            "fit": self.fit,
            "fits": self.fits,
            "bend_deg": self.bend_deg,
            "outlook": self.outlook,
            "chance": self.chance,
            "limits": list(self.limits),
            "tools": list(self.tools),
            "predictors": None if self.predictors is None else self.predictors.to_json(),
            "leg": self.leg.to_json() | {"hit_share": self.hit_share, "hit_share_moved": self.hit_share_moved},
            "parts": self.parts,
            "score": self.score,
            "doubts": list(self.doubts),
        }


def check_target_type(where: str, name: str, value: object) -> None:
    """Raise an error unless a value is a target, a nodule or a point."""
    if not isinstance(value, PlanTarget | Nodule):
        lps_point()(where, name, value)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Plan(Tabular):
    """Target and the routes to it, the best one first.

    As a table (``to_pandas``, ``to_arrow``, ``to_columns``) it has a row for each route: its number from 1, fields of
    `PlannedRoute`, ``from_carina_mm``, and of its last leg ``to_target_mm``, ``in_target_mm``, ``vessel_mm`` and
    ``hit_share``.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> plan = carina.plan_route(made.volume, carina.find_airways(made.volume), made.truth["nodule"]["centre_lps"])
    >>> plan.why is None, plan.to_json()["format"]
    (True, 'carina-plan')
    """

    nodule: Nodule
    scope: ScopePreset
    tool: Tool
    bronchus_sign: BronchusSign
    sign_branch: str | None
    """Name of the airway that shows the bronchus sign; None if no airway does."""
    sign_lps: tuple[float, float, float] | None
    """Place of the bronchus sign, LPS mm, for slices that show the sign; None without the sign."""
    movement: TargetMovement
    """Movement of the target since the CT: assumed by its lobe, given, or measured from a second CT."""
    routes: tuple[PlannedRoute, ...]
    why: str | None
    """Reason why there is no route, and what would help; None if there is a route."""
    notes: tuple[str, ...] = field(default=())
    """Notes on the airways, the target and the tool."""
    aims: tuple[tuple[float, float, float], ...] = ()
    """Points in the target that the needle is aimed at, LPS mm."""
    vessel_margin_mm: float = 3.0
    weights: ScoreWeights = field(default_factory=ScoreWeights)
    nearest: NearestPlace | None = None
    """Place in the airways nearest to the target, independent of the routes; None if there is none."""
    errors: NeedleErrors = field(default_factory=NeedleErrors)
    """Errors of the needle that the shares of hits assume."""
    carina_ridge_mm: float | None = None
    """Distance in mm of the main carina's ridge beyond the point where the axes of the main bronchi meet.

    All distances along the routes are measured from the ridge. None if no ridge was found.
    """
    doubts: tuple[TargetDoubt, ...] = ()
    """Reasons for which the target may not be a nodule; the caller has confirmed all of them."""
    lost: LostAirway | None = None
    """Place near the target at which the search lost an airway; None if there is none."""

    @property
    def sign_words(self) -> str:
        """Bronchus sign as text, such as *an airway leads into the target (RB4a)*."""
        if self.bronchus_sign == "none":
            return "no airway found" + ("" if self.lost is None else f"; {self.lost.short_words}")
        named = "" if self.sign_branch is None else f" ({self.sign_branch})"
        where = {"into": "leads into", "beside": "lies against"}[self.bronchus_sign]
        return f"an airway {where} the target{named}"

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Plan` has an invalid value."""
        check_fields(
            self,
            nodule=instance(Nodule, "get one from carina.grow_nodule"),
            scope=instance(ScopePreset, "get one from carina.scopes.scope_preset"),
            tool=instance(Tool, "get one from carina.plan.tool"),
            bronchus_sign=choice(*get_args(BronchusSign)),
            sign_branch=text_of(optional=True),
            sign_lps=lps_point(optional=True),
            movement=instance(TargetMovement, "get one from carina.plan.measure_movement"),
            routes=each(instance(PlannedRoute, "get routes from carina.plan_route")),
            why=text_of(20_000, optional=True),
            notes=each(text_of(20_000)),
            aims=each(lps_point()),
            vessel_margin_mm=number_from(0.0, 50.0, unit="mm"),
            weights=instance(ScoreWeights, "create a carina.plan.ScoreWeights"),
            nearest=instance(NearestPlace, "get one from carina.plan_route", optional=True),
            errors=instance(NeedleErrors, "create a carina.plan.NeedleErrors"),
            carina_ridge_mm=number_from(-1000.0, 1000.0, optional=True, unit="mm"),
            doubts=each(instance(TargetDoubt, "get them from carina.plan.target_doubts")),
            lost=instance(LostAirway, "get one from carina.plan_route", optional=True),
        )

    @property
    def moved_mm(self) -> float:
        """Largest distance in mm of the target from its position in the CT that the plan considers."""
        return self.movement.most_mm

    def _columns(self) -> Columns:
        own: dict[str, ColumnKind] = {
            "branch_id": "int",
            "branch_name": "text",
            "along_mm": "float",
            "aim": "int",
            "outlook": "text",
            "chance": "float",
            "score": "float",
            "narrowest_mm": "float",
            "fits": "flag",
            "bend_deg": "float",
        }
        leg: dict[str, ColumnKind] = dict.fromkeys(("to_target_mm", "in_target_mm", "vessel_mm"), "float")
        return columns_of(
            (
                {
                    "route": number,
                    **{name: getattr(route, name) for name in own},
                    "from_carina_mm": route.from_carina_mm,
                    **{name: getattr(route.leg, name) for name in leg},
                    "hit_share": route.hit_share,
                }
                for number, route in enumerate(self.routes, start=1)
            ),
            {"route": "int", **own, "from_carina_mm": "float", **leg, "hit_share": "float"},
        )

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain JSON types."""
        return {
            "format": "carina-plan",
            "version": 1,
            "space": "LPS",
            "unit": "mm",
            "target": self.nodule.to_json() | {"doubts": [doubt.to_json() for doubt in self.doubts]},
            "scope": self.scope.name,
            "tool": self.tool.name,
            "aims": [list(aim) for aim in self.aims],
            "vessel_margin_mm": self.vessel_margin_mm,
            "weights": self.weights.to_json(),
            "bronchus_sign": self.bronchus_sign,
            "sign_branch": self.sign_branch,
            "sign_words": self.sign_words,
            "sign_lps": None if self.sign_lps is None else list(self.sign_lps),
            "moved_mm": self.moved_mm,
            "movement": self.movement.to_json(),
            "carina_ridge_mm": self.carina_ridge_mm,
            "routes": [route.to_json() for route in self.routes],
            "why": self.why,
            "nearest": None if self.nearest is None else self.nearest.to_json(),
            "lost": None if self.lost is None else self.lost.to_json(),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, slots=True, eq=False)
class DraftPlan:
    """Plan whose routes were not driven, with the data to compute their needle paths again after a drive."""

    plan: Plan
    judge: Judge
    wall: WallField
    scene: NeedleScene | None
    """Target, tissues and needle; None if no position of the scope is near enough to the target."""
    spares: tuple[PlannedRoute, ...]
    """Routes to second-best scope positions in the branches of the plan's routes.

    They are driven if the drive to the best position of the branch fails.
    """

    def leg_of(self, tip_lps: Points, forward: Points, needle: Points, aim: Points) -> LastLeg:
        """Return the needle path from a tip in a direction, with the needle's errors and the target's movement.

        Parameters
        ----------
        tip_lps, forward, needle
            (3,) position of the tip, LPS mm; directions of the airway and of the needle.
        aim
            (3,) LPS mm; the path ends at the same distance from the tip.
        """
        assert self.scene is not None
        distance = float(np.linalg.norm(aim - tip_lps))
        leg = with_errors(self.scene, leg_as_aimed(self.scene, tip_lps, forward, tip_lps + distance * needle))
        return _moved_leg(self.scene, leg, self.plan.movement)


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """Arguments of `carina.plan_route` that determine the routes; ``plan_route`` describes each of them."""

    volume: Volume
    airways: Airways
    target: PlanTarget | Nodule | ArrayLike
    scope: ScopePreset
    tool: Tool
    aims: ArrayLike | None = None
    vessel_margin_mm: float = 3.0
    movement: TargetMovement | None = None
    errors: NeedleErrors | None = None
    weights: ScoreWeights | None = None
    wall: WallField | None = None
    measures: TreeMeasures | None = None
    place: RoutePlace | None = None
    confirmed: Confirmed = False


def draft_plan(
    request: PlanRequest, *, report: Callable[[float], None], cancel: Callable[[], bool] | None = None
) -> DraftPlan:
    """Plan the routes to a target without driving them.

    Parameters
    ----------
    request
        Volume, airways, target and options.
    report
        Receives the completed fraction, 0 to 1; it may raise an error to stop the work.
    cancel
        As for `carina.plan_route`.
    """
    volume, airways, target, aims, wall = request.volume, request.airways, request.target, request.aims, request.wall
    vessel_margin_mm, movement, errors = request.vessel_margin_mm, request.movement, request.errors
    measures, weights, confirmed = request.measures, request.weights, request.confirmed
    preset, used = request.scope, request.tool
    accepted = confirmed_codes(confirmed)
    if not isinstance(target, PlanTarget | Nodule):
        # The wall lets the segmentation recognise a lesion in an airway.
        wall = wall_field(volume, airways, cancel=cancel) if wall is None else wall
        target = target_from_click(volume, target, airways=airways, wall=wall, progress=False)
    clicked: tuple[float, float, float] | None = None
    if isinstance(target, PlanTarget):
        aims = target.aims if aims is None else aims
        accepted = (*accepted, *target.confirmed)
        clicked = target.seed_lps if target.source == "click" else None
        target = target.nodule
    nodule = target
    check_target(volume, airways, nodule)
    aims_lps = _aims(nodule, aims)
    report(0.1)
    wall = wall_field(volume, airways, cancel=cancel) if wall is None else wall
    doubts = target_doubts(volume, nodule, airways=airways, wall=wall, clicked_lps=clicked)
    check_confirmed(doubts, accepted)
    report(0.5)
    measures = measures_of(volume, airways, measures, cancel=cancel)
    origin = distance_origin(volume, airways)
    positions = ScopePositions(
        airways.tree, nodule, wall, measures=measures, spacing_mm=max(volume.spacing_mm), origin=origin
    )
    judge = Judge(preset, vessel_margin_mm, weights or ScoreWeights(), used.reach_mm, used)
    moved = positions.default_movement() if movement is None else movement
    sign, sign_branch, sign_lps = positions.bronchus_sign()
    nearest = positions.nearest()
    candidates = [
        (n, aim) for aim in range(len(aims_lps)) for n in positions.within_reach(used, aims_lps[aim], MAX_ANGLE_DEG)
    ]
    routes: tuple[PlannedRoute, ...] = ()
    spares: tuple[PlannedRoute, ...] = ()
    scene: NeedleScene | None = None
    if candidates:
        # The box extends from the farthest tip to beyond the target, with margins beside the needle.
        farthest = max(float(positions.distance[n]) for n, _ in candidates)
        half = max(farthest, 0.5 * nodule.long_mm + BEYOND_MM) + max(vessel_margin_mm, MIN_MARGIN_MM) + ROUND_MM
        around = surroundings(volume, np.array(nodule.centre_lps), min(half, MAX_BOX_MM), nodule, wall)
        scene = NeedleScene(nodule, wall, around, used, errors or NeedleErrors(), vessel_margin_mm)
        search = _PositionSearch(scene, judge, aims_lps, TipDirections(airways.tree, wall, preset))
        drafts_of = search.drafts(positions, candidates, report)
        best = {key: search.best(drafts) for key, drafts in drafts_of.items()}
        # Each best place is refined, because the best place of a branch may be between two evaluated places.
        for aim, aim_lps in enumerate(aims_lps):
            finer = positions.beside((one.branch_id, one.along_mm) for one in best.values() if one.aim == aim)
            near = [(n, aim) for n in finer.within_reach(used, aim_lps, MAX_ANGLE_DEG, apart_mm=0.0)]
            for key, drafts in search.drafts(finer, near).items():
                best[key] = search.best(drafts, best[key])
        first = None
        if request.place is not None and 0 <= request.place[2] < len(aims_lps):
            # The place that the user has chosen replaces the best place of its branch.
            exact = positions.at(*request.place[:2])
            for key, drafts in search.drafts(exact, [(n, request.place[2]) for n in range(len(exact.points))]).items():
                best[key] = first = search.best(drafts)
        routes = tuple(
            replace(route, leg=_moved_leg(scene, route.leg, moved))
            for route in standing_apart(sorted(best.values(), key=order), first=first)
        )
        spares = tuple(
            search.best(apart)
            for route in routes
            if not is_at(route, request.place)
            and (apart := search.apart_from(route, drafts_of.get((route.branch_id, route.aim), ())))
        )

        def with_figures(route: PlannedRoute) -> PlannedRoute:
            """Return a route with its predictors (angle of its last fork), widths of openings, and measured lumen."""
            at = airways.tree, route.branch_id, route.along_mm
            lineage = airways.tree.lineage(route.branch_id)
            spacing_mm, start = max(volume.spacing_mm), route.origin
            return replace(
                route,
                predictors=route_predictors(*at, wall=wall, measures=measures, spacing_mm=spacing_mm, origin=start),
                openings=openings_of_route(
                    *at, scope=preset, wall=wall, measures=measures, spacing_mm=spacing_mm, origin=start
                ),
                lumen=measured_lumen(lineage, wall, measures),
                ridges=fork_ridges(lineage, airways.tree.branches, wall, spacing_mm=spacing_mm),
            )

        routes = tuple(with_figures(route) for route in routes)
        spares = tuple(with_figures(route) for route in spares)
    report(1.0)
    plan = Plan(
        nodule=nodule,
        scope=preset,
        tool=used,
        bronchus_sign=sign,
        sign_branch=sign_branch,
        sign_lps=sign_lps,
        movement=moved,
        routes=routes,
        why=None if routes else why_none(airways, nodule, nearest, used),
        notes=(
            *ct_notes(volume, airways),
            *notes_of_target(volume, airways, nodule, nearest),
            *notes_of_tools(preset, used),
            *moved.notes,
            *dict.fromkeys(route.origin.note for route in routes if route.origin.note is not None),
        ),
        aims=tuple((float(x), float(y), float(z)) for x, y, z in aims_lps),
        vessel_margin_mm=vessel_margin_mm,
        weights=judge.weights,
        nearest=nearest,
        errors=errors or NeedleErrors(),
        carina_ridge_mm=origin.ridge_beyond_axes_mm,
        lost=lost_airway(airways, nodule, nearest),
        doubts=doubts,
    )
    return DraftPlan(plan, judge, wall, scene, spares)


@dataclass(frozen=True, slots=True)
class _PositionSearch:
    """Search for the best scope position for each pair of branch and aim."""

    scene: NeedleScene
    judge: Judge
    aims_lps: Points
    directions: TipDirections

    def drafts(
        self,
        positions: ScopePositions,
        candidates: Sequence[tuple[Any, int]],
        report: Callable[[float], None] | None = None,
    ) -> dict[tuple[int, int], list[_DraftRoute]]:
        """Return the routes whose needles reach the target, by branch and aim, computed without the needle's errors.

        The needle has the attainable direction nearest to the aim. Without one, it has the direction to the aim, and
        no needle hits.
        """
        found: dict[tuple[int, int], list[_DraftRoute]] = {}
        for step, (n, aim) in enumerate(candidates):
            if report is not None:
                report(0.6 + 0.3 * step / len(candidates))
            leg = self._leg(positions, int(n), self.aims_lps[aim])
            if leg.reaches and (self.scene.tool.pierces or leg.is_open):
                requirements = positions.requirements_at(n, bending_mm(self.judge.scope))
                route = _route(positions, int(n), aim, leg, requirements=requirements, judge=self.judge)
                found.setdefault((route.branch_id, aim), []).append(_DraftRoute(route, requirements))
        return found

    def _leg(self, positions: ScopePositions, n: int, aim: Points) -> LastLeg:
        place, forward = positions.points[n], positions.forward[n]
        if not self.directions.is_known:
            return leg_as_aimed(self.scene, place, forward, aim)
        standing = StandingPlace(int(positions.branch[n]), float(positions.along_mm[n]), place, forward)
        tip = self.directions.towards(standing, aim, 0.5 * self.scene.nodule.short_mm)
        if tip is not None:
            distance = float(np.linalg.norm(aim - tip.tip_lps))
            leg = leg_as_aimed(self.scene, tip.tip_lps, forward, tip.tip_lps + distance * tip.forward)
            if leg.in_target_mm > 0.0:
                return leg
        return replace(leg_as_aimed(self.scene, place, forward, aim), hit_share=0.0)

    def best(self, drafts: Sequence[_DraftRoute], found: PlannedRoute | None = None) -> PlannedRoute:
        """Return the best of several drafts with the needle's errors, or ``found`` if that is better.

        A draft that could not be the best even without a miss is not evaluated.
        """
        for draft in sorted(drafts, key=lambda one: order(one.route)):
            if found is not None and order(found) <= order(draft.route):
                break
            leg = draft.route.leg
            if leg.hit_share > 0.0:
                leg = with_errors(self.scene, leg)
            parts = self.judge.parts(leg, draft.route.narrowest_mm, self.scene.nodule)
            outlook, chance, limits = self.judge.outlook(draft.requirements, leg)
            route = replace(
                draft.route,
                leg=leg,
                parts=parts,
                score=self.judge.score(parts),
                outlook=outlook,
                chance=chance,
                limits=limits,
            )
            if found is None or order(route) < order(found):
                found = route
        assert found is not None
        return found

    @staticmethod
    def apart_from(route: PlannedRoute, drafts: Sequence[_DraftRoute]) -> list[_DraftRoute]:
        """Return the drafts (routes without the needle's errors) that are more than `APART_MM` from a given route.

        The distance is that of both scope positions along the branch. Drafts whose outlook is *does not reach* are
        omitted.
        """
        return [
            one
            for one in drafts
            if one.route.outlook != "does not reach" and abs(one.route.along_mm - route.along_mm) > APART_MM
        ]


@dataclass(frozen=True, slots=True)
class _DraftRoute:
    """Route computed without the needle's errors, and what its path requires of a scope: width, bend, doubts."""

    route: PlannedRoute
    requirements: PathRequirements


def _moved_leg(scene: NeedleScene, leg: LastLeg, movement: TargetMovement) -> LastLeg:
    """Return a leg with the share of hits if the target may have moved; 0 if no attainable direction hits."""
    return where_it_may_have_moved(scene, leg, movement) if leg.hit_share > 0.0 else replace(leg, hit_share_moved=0.0)


def _aims(nodule: Nodule, aims: ArrayLike | None) -> Points:
    """Return the aims as (k, 3) points in the nodule, LPS mm; raise an error for an invalid aim."""
    if aims is None:
        return np.array([nodule.middle_lps], dtype=np.float64)
    try:
        found = np.asarray(aims, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError):
        raise UsageError(f"aims: expected points x,y,z in LPS mm; found {aims!r}", code="plan.aims") from None
    if not (1 <= len(found) <= MAX_AIMS and np.isfinite(found).all()):
        raise UsageError(
            f"aims: expected 1 to {MAX_AIMS} points in LPS mm; found {len(found)}: {found.tolist()}", code="plan.aims"
        )
    off = nodule.distance_mm(found)
    if (off > 0.0).any():
        n = int(np.argmax(off))
        place = ", ".join(f"{v:g}" for v in found[n])
        raise UsageError(
            f"aims: the point {place} lies {off[n]:.1f} mm outside the target; choose points within it",
            code="plan.aims",
        )
    return found


def _route(
    positions: ScopePositions, n: int, aim: int, leg: LastLeg, *, requirements: PathRequirements, judge: Judge
) -> PlannedRoute:
    """Return the route to a scope position, with the needle's path from there and the route's score."""
    branch = positions.of_branch(n)
    parts = judge.parts(leg, requirements.width.mm, positions.nodule)
    outlook, chance, limits = judge.outlook(requirements, leg)
    forward = positions.forward[n]
    return PlannedRoute(
        branch_id=branch.id,
        branch_name=branch_title(branch),
        along_mm=float(positions.along_mm[n]),
        origin=requirements.width.origin,
        forward=(float(forward[0]), float(forward[1]), float(forward[2])),
        width=requirements.width,
        fit=requirements.width.fit(judge.scope),
        leg=leg,
        parts=parts,
        score=judge.score(parts),
        doubts=requirements.doubts,
        aim=aim,
        outlook=outlook,
        chance=chance,
        limits=limits,
        bend_deg=requirements.bend_deg.value,
        tools=tuple(
            one.name
            for one in tools()
            if judge.scope.channel_mm is not None
            and one.passes(judge.scope.channel_mm)
            and leg.to_target_mm <= one.reach_mm
            and (one.pierces or leg.is_open)
        ),
    )


class CancellableProgress:
    """Callable that reports the completed fraction, and stops the computation at a request to cancel.

    Parameters
    ----------
    on_progress
        Receives the completed fraction, 0 to 1; None reports nothing.
    cancel
        Returns True to stop; None never stops.
    stopped
        Text of the error that stops the computation.
    """

    def __init__(
        self, on_progress: Callable[[float], None] | None, cancel: Callable[[], bool] | None, stopped: str
    ) -> None:
        self._on_progress, self._cancel, self._stopped = on_progress, cancel, stopped

    def __call__(self, fraction: float) -> None:
        """Report the completed fraction; raise :class:`carina.errors.CancelledError` at a request to cancel."""
        if self._cancel is not None and self._cancel():
            raise CancelledError(self._stopped)
        if self._on_progress is not None:
            self._on_progress(fraction)


def is_at(route: PlannedRoute, place: RoutePlace | None) -> bool:
    """Return whether a route ends at a place with the same aim; False without a place."""
    if place is None or (route.branch_id, route.aim) != (place[0], place[2]):
        return False
    return abs(route.along_mm - place[1]) <= SAME_PLACE_MM


def standing_apart(routes: Sequence[PlannedRoute], *, first: PlannedRoute | None = None) -> tuple[PlannedRoute, ...]:
    """Return the best routes of a ranked list, without routes near a better one to the same aim.

    The best route to each aim is always returned, and a route ``first``, which no other one replaces.
    """
    selected: list[PlannedRoute] = [] if first is None else [first]
    for route in routes:
        place = np.array(route.leg.tip_lps)
        if all(
            one.aim != route.aim or float(np.linalg.norm(place - np.array(one.leg.tip_lps))) > APART_MM
            for one in selected
        ):
            selected.append(route)
    firsts = {next(n for n, one in enumerate(selected) if one.aim == aim) for aim in {one.aim for one in selected}}
    others = [n for n in range(len(selected)) if n not in firsts]
    chosen = sorted([*firsts, *others[: MAX_ROUTES - len(firsts)]])
    return tuple(sorted((selected[n] for n in chosen), key=order))
