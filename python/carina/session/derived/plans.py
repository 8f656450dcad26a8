"""Values computed from targets with a size: the plan of each target, and the verdicts on the chosen route."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from carina.case.document import Document, Lesion, Target
from carina.case.route_distances import scale_of_route
from carina.case.routes import ChosenRoute, place_on_tree_mm
from carina.commands.plan import PlanOptions
from carina.commands.tree import PathCost
from carina.display import one_line
from carina.errors import CancelledError, CarinaError, NoResultError, UnconfirmedTargetError, without_options
from carina.plan.routes.main_carina import ROOT, DistanceOrigin, RouteScale, origins_of_branches
from carina.session.derived.derived_value import Attempt, Cached, Derived, Standing
from carina.session.derived.measurement_cache import MeasuredAirways
from carina.session.engines import Parts
from carina.session.jobs.background_jobs import JobRunner
from carina.track import Mesh, TreeMeasures, mask_mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.plan import (
        CArmAngles,
        Nodule,
        Plan,
        PlannedRoute,
        PlanTarget,
        RouteStation,
        TargetDoubt,
        TargetMovement,
        TurnList,
        Verdict,
    )
    from carina.plan.carm import ShadowParts
    from carina.scopes import WallField
    from carina.session.derived.lungs import CaseLungs
    from carina.track import Airways
    from carina.volume import Volume
    from carina.volume.dicom_references import References

MAX_SHOWN = 36
"""Maximum number of voxels along a side of a nodule's displayed surface; finer detail is not visible."""
SAME_PLACE_MM = 0.05
PAIRS_PER_MESSAGE = 6
"""Number of verdicts on pairs (route, instrument) after which windows are notified even if none reaches the target."""


class PlanTask(NamedTuple):
    """Inputs of a plan besides the airways; names and notes of a target change no plan."""

    nodule: Nodule
    aims: tuple[tuple[float, float, float], ...]
    options: PlanOptions
    confirmed: tuple[str, ...]
    """Codes of the target's doubts that the user has confirmed."""
    clicked_lps: tuple[float, float, float] | None
    """Clicked point, LPS mm, of a segmented boundary, which may be an airway's wall; None for another boundary."""


def task_of(lesion: Lesion) -> PlanTask:
    """Return the inputs of a lesion's plan, which with the airways determine the plan."""
    target = lesion.target
    clicked = target.seed_lps if target.source == "click" else None
    return PlanTask(lesion.nodule, target.aims, lesion.options, target.confirmed, clicked)


@dataclass(frozen=True, slots=True, eq=False)
class PlanOutcome:
    """Result of planning for one target."""

    task: PlanTask
    plan: Plan | None
    problem: str | None
    """Reason, for the user, why the target has no plan; None if it has one."""
    doubts: tuple[TargetDoubt, ...] = ()
    """Doubts whether the target is a nodule, confirmed or not."""
    stations: tuple[tuple[RouteStation, ...], ...] = ()
    """Lymph node stations of each route of the plan, in the order of the routes."""


@dataclass(frozen=True, slots=True, eq=False)
class MadePlans:
    """Plans of all targets in the same airways."""

    airways: Airways
    wall: Any
    measures: TreeMeasures | None
    """Measurements of the airways.

    None if the case does not measure them, so that each plan measures its own branches.
    """
    plans: tuple[PlanOutcome, ...]

    def of(self, task: PlanTask) -> PlanOutcome | None:
        """Return the planning result for a task; None if these plans do not include the task."""
        return next((one for one in self.plans if one.task == task), None)


@one_line
@dataclass(frozen=True, slots=True)
class PlannedTarget:
    """A target with a size, and its plan once the plan is available."""

    target: Target
    planned: PlanOutcome | None


@one_line
@dataclass(frozen=True, slots=True)
class PlanningInfo:
    """Plans of a case's targets, and the verdicts on the chosen route."""

    targets: tuple[PlannedTarget, ...]
    standing: Standing
    verdicts: tuple[Verdict, ...]
    verdicts_standing: Standing
    document: Document
    pairs: tuple[Verdict, ...] = ()
    """Verdicts on pairs of the best routes and all instruments for the target of the chosen route, the best first."""
    pairs_standing: Standing = "unwanted"
    available: tuple[str, ...] | None = None
    """Names of the scopes that are available here; None: all of the library."""
    turns: TurnList | None = None
    """List of the turns of the chosen route at its forks; None without a chosen planned route."""
    carm: CArmAngles | None = None
    """Positions of a C-arm for the chosen route; None without a chosen planned route."""
    carm_standing: Standing = "unwanted"
    dicom_problem: str | None = None
    """Reason why an exported DICOM file cannot refer to the CT; None if it can."""


PlanInputs = tuple[Any, ...]
"""Inputs of all plans: the airways, followed by the plan task of each target."""
VerdictInputs = tuple[Any, ...]
"""Inputs of the verdicts: plan, number of a route in the plan (from 1), airway wall, and plan options."""
PairInputs = tuple[Any, ...]
"""Inputs of the verdicts on all pairs of an instrument and a route: plan, airway wall, and plan options."""
TurnInputs = tuple[Any, ...]
"""Inputs of the list of turns: plan, number of a route in the plan (from 1), and plan options."""
CArmInputs = tuple[Any, ...]
"""Inputs of the positions of a C-arm: plan, and number of a route in the plan (from 1)."""


@one_line
@dataclass(frozen=True, slots=True)
class CtOrigin:
    """Path or DICOM references from which the CT of a case was read."""

    place: str | None = None
    """File or folder on this machine from which the CT was opened; None if it was dropped or generated."""
    references: References | None = None
    """References to the DICOM files of a dropped CT; never stored."""
    dropped: str | None = None
    """Temporary path of dropped files that contain other series, too; never stored."""

    @property
    def series_files(self) -> str | None:
        """Path of the files with all series that were found beside the CT; None if it is not known."""
        return self.place or self.dropped


class EarlyVerdicts:
    """Verdicts that a running job has computed so far; windows show them until the job ends.

    Parameters
    ----------
    lock, changed
        The lock of the session, and the function that is called with the lock held when there are verdicts to show.
    per_message
        Number of verdicts after which `changed` is called, unless an instrument reaches the target before.
    """

    def __init__(self, lock: AbstractContextManager[Any], changed: Callable[[], None], *, per_message: int = 1) -> None:
        self._lock = lock
        self._changed = changed
        self._per_message = per_message
        self._found: tuple[VerdictInputs, tuple[Verdict, ...]] | None = None

    def of(self, inputs: VerdictInputs) -> tuple[Verdict, ...]:
        """Return the verdicts that were collected for these inputs."""
        with self._lock:
            found = self._found
            return found[1] if found is not None and _same(found[0], inputs) else ()

    def collector(self, inputs: VerdictInputs) -> Callable[[Verdict], None]:
        """Return a function that adds one verdict of a job with these inputs."""
        found: list[Verdict] = []

        def add(verdict: Verdict) -> None:
            found.append(verdict)
            if verdict.outcome == "reaches" or len(found) % self._per_message == 0:
                with self._lock:
                    self._found = (inputs, tuple(found))
                    self._changed()

        return add

    def forget(self) -> None:
        """Delete the verdicts that were collected so far."""
        self._found = None


class CasePlanning:
    """The plans of a case's targets, and the verdicts on the chosen route.

    Parameters
    ----------
    volume, parts, jobs, lock
        The CT, and the processing functions, job runner and lock of the session
        (`carina.session.derived.derived_value`).
    changed
        Called when a plan or a verdict has changed.
    measured
        Measurements of the airways in the history, which the window also shows.
    """

    lungs: CaseLungs
    """The maps of the lungs around the targets."""

    def __init__(
        self,
        volume: Volume,
        parts: Parts,
        *,
        jobs: JobRunner,
        lock: AbstractContextManager[Any],
        changed: Callable[[], None],
        measured: MeasuredAirways | None = None,
    ) -> None:
        self._volume = volume
        self._measured = measured
        self._parts = parts
        self._lock = lock
        self._changed = changed
        self._plans: Derived[PlanInputs, MadePlans] = Derived(
            jobs,
            lock,
            kind="plan",
            title="planning the routes",
            make=self._make_plans,
            same=_same_inputs,
            settled=self._settled,
        )
        self._verdicts: Derived[VerdictInputs, tuple[Verdict, ...]] = Derived(
            jobs,
            lock,
            kind="verdicts",
            title="simulating the instruments",
            make=self._make_verdicts,
            same=_same,
            settled=self._judged,
        )
        self._early = EarlyVerdicts(lock, changed)
        self._pairs: Derived[PairInputs, tuple[Verdict, ...]] = Derived(
            jobs,
            lock,
            kind="pairs",
            title="comparing the instruments on the best routes",
            make=self._make_pairs,
            same=_same,
            settled=changed,
        )
        # A message carries all pairs, so not every verdict is sent at once.
        self._early_pairs = EarlyVerdicts(lock, changed, per_message=PAIRS_PER_MESSAGE)
        self._ordered: Cached[tuple[Any, ...], tuple[Verdict, ...]] = Cached(_in_order, same=_same)
        self._available: tuple[str, ...] | None = None
        self._document: Document | None = None
        self.origin = CtOrigin()
        self._turns: Derived[TurnInputs, TurnList] = Derived(
            jobs,
            lock,
            kind="turns",
            title="locating the openings of the route",
            make=self._make_turns,
            same=_same,
            settled=changed,
        )
        self._with_moves: Cached[tuple[Any, ...], TurnList] = Cached(_with_moves)
        self._carm: Derived[CArmInputs, CArmAngles] = Derived(
            jobs,
            lock,
            kind="carm",
            title="searching C-arm angles",
            make=self._make_carm,
            same=_same,
            settled=changed,
        )
        self._shadows: Cached[Airways, ShadowParts | None] = Cached(self._find_shadows)
        self._num_marks = 0
        self._wall: Cached[Airways, WallField] = Cached(partial(parts.wall_field, volume), same=_same_lumen)
        self._scales: Cached[tuple[Airways | None, ChosenRoute, PathCost], RouteScale] = Cached(
            self._make_scale, same=_same_scale
        )
        self._tree_origin: Cached[Airways, DistanceOrigin] = Cached(self._make_tree_origin)
        self._origins: Cached[Airways, dict[int, DistanceOrigin]] = Cached(self._make_origins)
        self._target_places: Cached[tuple[Airways, tuple[Target, ...]], dict[str, float]] = Cached(
            self._make_target_places, same=_same_objects
        )

    # ------------------------------------------------------------ state

    def of(self, lesion: Lesion) -> PlanOutcome | None:
        """Return the planning result for a target's lesion; None if it has not been computed."""
        made = self.made
        return None if made is None else made.of(task_of(lesion))

    def standing(self) -> Standing:
        """Return whether the plans of all targets are computed, in progress, failed or stopped."""
        return self._plans.standing(self._inputs(self._document))

    def verdicts(self) -> tuple[Verdict, ...]:
        """Return the available verdicts on the chosen route."""
        inputs = self._verdict_inputs()
        if inputs is None:
            return ()
        made = self._verdicts.of(inputs)
        return self._early.of(inputs) if made is None else made

    def verdicts_standing(self) -> Standing:
        """Return whether the verdicts on the chosen route are computed, in progress, failed or stopped."""
        return self._verdicts.standing(self._verdict_inputs())

    def pairs(self, available: tuple[str, ...] | None) -> tuple[Verdict, ...]:
        """Return the available verdicts on pairs of route and instrument for the target of the chosen route.

        Parameters
        ----------
        available
            Names of the instruments whose pairs are listed first; None: all.
        """
        inputs = self._pair_inputs()
        if inputs is None:
            return ()
        found = self._pairs.of(inputs)
        return self._ordered.of((inputs[0], self._early_pairs.of(inputs) if found is None else found, available))

    def same_available(self, available: tuple[str, ...] | None) -> tuple[str, ...] | None:
        """Return the earlier tuple of available instruments if it is equal, so that unchanged messages are not sent."""
        if available != self._available:
            self._available = available
        return self._available

    def pairs_standing(self) -> Standing:
        """Return the state of the job that computes the verdicts on all pairs of an instrument and a route."""
        return self._pairs.standing(self._pair_inputs())

    def turns(self) -> TurnList | None:
        """Return the turns of the chosen route; None without one, or while their openings are being located.

        Hand movements are added once the scope's drive is simulated.
        """
        inputs, made = self._turn_inputs(), self.made
        turns = self._turns.of(inputs)
        if inputs is None or made is None or turns is None:
            return None
        plan, number, _ = inputs
        driven = next((v.driven for v in self.verdicts() if v.scope.name == plan.scope.name), None)
        if driven is None:
            return turns
        return self._with_moves.of((made.airways.tree, plan.routes[number - 1], turns, driven))

    def carm(self) -> CArmAngles | None:
        """Return the positions of a C-arm for the chosen route; None without one, or while they are being searched."""
        return self._carm.of(self._carm_inputs())

    def carm_standing(self) -> Standing:
        """Return whether the C-arm positions are computed, in progress, failed or stopped."""
        return self._carm.standing(self._carm_inputs())

    def begin_mark(self) -> Callable[[], bool]:
        """Count a search for the target under a cursor; return a function that states whether it is the newest one."""
        with self._lock:
            self._num_marks += 1
            number = self._num_marks
        return lambda: number == self._num_marks

    def wall_for_marks(self, airways: Airways) -> WallField:
        """Return the wall field of airways for previews of targets; computed once, which takes seconds."""
        known = self.wall_of(airways)
        return self._wall.of(airways) if known is None else known

    def route_scale(self, document: Document) -> RouteScale | None:
        """Return the distances along the route of a document, as its plan states them; None without a route."""
        airways, route = document.airways, document.route
        if route is None:
            return None
        return self._scales.of((airways, route, document.cost_of(route)))

    def _make_scale(self, inputs: tuple[Airways | None, ChosenRoute, PathCost]) -> RouteScale:
        airways, route, cost = inputs
        origin = ROOT if airways is None or not route.lumen_known else self._tree_origin.of(airways)
        return scale_of_route(airways, route, cost=cost, origin=origin)

    def _make_tree_origin(self, airways: Airways) -> DistanceOrigin:
        return self._parts.distance_origin(self._volume, airways)

    def _make_origins(self, airways: Airways) -> dict[int, DistanceOrigin]:
        return origins_of_branches(airways.tree, self._tree_origin.of(airways))

    def target_places_mm(self, document: Document) -> dict[str, float]:
        """Return the distance in mm of each target from the main carina, by target ID.

        The distance is that of the end of the target's route (`route_scale`). Targets whose path does not pass the main
        carina are left out.
        """
        airways = document.airways
        return {} if airways is None else self._target_places.of((airways, document.targets))

    def _make_target_places(self, inputs: tuple[Airways, tuple[Target, ...]]) -> dict[str, float]:
        airways, targets = inputs
        found = {}
        for target in targets:
            route = target.route
            if route is not None and route.lumen_known:
                scale = self._make_scale((airways, route, target.cost))
                past_mm = scale.origin.from_carina_mm(float(scale.along_mm[-1]))
                if past_mm is not None:
                    found[target.target_id] = past_mm
        return found

    def place_from_carina_mm(
        self, airways: Airways, branch_id: int, point: NDArray[np.float64], beyond_mm: float
    ) -> float | None:
        """Return the distance in mm of a place from the main carina along the centrelines.

        Parameters
        ----------
        airways
            The airways.
        branch_id, point
            A branch, and a point near its centreline, LPS mm.
        beyond_mm
            Distance of the place beyond the point.

        Returns
        -------
        float | None
            None if the way to the branch does not pass the main carina, or the tree has no such branch.
        """
        origin = self._origins.of(airways).get(branch_id)
        if origin is None:
            return None
        return origin.from_carina_mm(place_on_tree_mm(airways.tree, branch_id, point) + beyond_mm)

    def again(self) -> None:
        """Repeat planning and verdicts that were stopped or failed, because the user requested the repetition."""
        self._plans.again()
        self._verdicts.again()
        self._pairs.again()
        self._turns.again()
        self._carm.again()
        if self._document is not None:
            self.follow(self._document)

    # ------------------------------------------------------------ requests

    def follow(self, document: Document) -> None:
        """Request plans and verdicts for the present document; the caller holds the session's lock."""
        self._document = document
        self._plans.want(self._inputs(document))
        self._want_of_route()

    def discard(self) -> None:
        """Stop planning and release all plans, because the case is being closed."""
        self._plans.discard()
        self._verdicts.discard()
        self._pairs.discard()
        self._turns.discard()
        self._wall.forget()
        self._carm.discard()
        self._shadows.forget()
        self._early.forget()
        self._early_pairs.forget()
        self._document = None

    # ------------------------------------------------------------ computation

    def _settled(self) -> None:
        if self._document is not None:
            self._want_of_route()
        self._changed()

    def _judged(self) -> None:
        self._want_after_verdicts()
        self._changed()

    def _want_of_route(self) -> None:
        """Request turns and verdicts of the chosen route; the caller holds the session's lock."""
        self._turns.want(self._turn_inputs())
        self._verdicts.want(self._verdict_inputs())
        self._want_after_verdicts()

    def _want_after_verdicts(self) -> None:
        """Request C-arm angles and verdicts on pairs after the verdicts on the chosen route, for which the user waits.

        The caller holds the session's lock.
        """
        verdicts = self._verdict_inputs()
        ended = self._verdicts.standing(verdicts) in {"had", "failed"}
        derived: tuple[tuple[Derived[Any, Any], tuple[Any, ...] | None], ...] = (
            (self._carm, self._carm_inputs()),
            (self._pairs, self._pair_inputs()),
        )
        for value, inputs in derived:
            if inputs is None or ended or value.standing(inputs) != "unwanted":
                value.want(inputs)

    def _inputs(self, document: Document | None) -> PlanInputs | None:
        if document is None or document.airways is None:
            return None
        tasks = tuple(task_of(target.lesion) for target in document.targets if target.lesion is not None)
        return (document.airways, *tasks) if tasks else None

    @property
    def made(self) -> MadePlans | None:
        """Plans of all targets of the present document; None if they have not been computed."""
        return self._plans.of(self._inputs(self._document))

    def wall_of(self, airways: Airways) -> WallField | None:
        """Return the wall field of airways if it was computed for plans or previews; None otherwise."""
        made = self.made
        if made is not None and made.airways.lumen_zyx is airways.lumen_zyx:
            wall: WallField = made.wall
            return wall
        return self._wall.known(airways)

    def _verdict_inputs(self) -> VerdictInputs | None:
        document, made = self._document, self.made
        if document is None or made is None or document.route is None:
            return None
        target = next((t for t in document.targets if t.target_id == document.route.target_id), None)
        if target is None or target.lesion is None:
            return None
        planned = made.of(task_of(target.lesion))
        number = None if planned is None or planned.plan is None else chosen_number(document, planned.plan)
        return None if number is None or planned is None else (planned.plan, number, made.wall, target.lesion.options)

    def _pair_inputs(self) -> PairInputs | None:
        inputs = self._verdict_inputs()
        return None if inputs is None else (inputs[0], *inputs[2:])

    def _turn_inputs(self) -> TurnInputs | None:
        inputs = self._verdict_inputs()
        return None if inputs is None else (*inputs[:2], inputs[3])

    def _carm_inputs(self) -> CArmInputs | None:
        inputs = self._verdict_inputs()
        return None if inputs is None else inputs[:2]

    def _make_plans(self, inputs: PlanInputs, attempt: Attempt[MadePlans]) -> MadePlans:
        from carina.plan.route_stations import route_stations

        airways, *tasks = inputs
        before = attempt.before
        same = before is not None and before.airways.lumen_zyx is airways.lumen_zyx
        wall = before.wall if before is not None and same else None
        if wall is None:
            attempt.progress("measuring the airway wall", None)
            wall = self._parts.wall_field(self._volume, airways, cancel=attempt.cancel)
        measures = self._measures_of(airways, attempt)
        plans: list[PlanOutcome] = []
        for n, task in enumerate(tasks):
            known = None if before is None or before.airways is not airways else before.of(task)
            if known is not None:
                plans.append(known)
                continue
            what = "looking at every place from which the target can be reached"

            def say(_step: str, share: float | None, n: int = n, what: str = what) -> None:
                attempt.progress(what, (n + (share or 0.0)) / len(tasks))

            options = task.options
            place = options.place
            try:
                plan = self._parts.plan_route(
                    self._volume,
                    airways,
                    _target_of(task),
                    scope=options.scope,
                    tool=options.tool,
                    vessel_margin_mm=options.vessel_margin_mm,
                    moved_mm=options.moved_mm,
                    movement=_movement_of(options),
                    aims=task.aims,
                    wall=wall,
                    measures=measures,
                    place=None if place is None else (place.branch_id, place.along_mm, place.aim),
                    progress=say,
                    cancel=attempt.cancel,
                )
                stations = tuple(route_stations(airways.tree, plan, route) for route in plan.routes)
                plans.append(PlanOutcome(task, plan, plan.why, plan.doubts, stations))
            except CancelledError:
                raise
            except UnconfirmedTargetError as error:
                plans.append(PlanOutcome(task, None, without_options(str(error)), error.doubts))
            except CarinaError as error:
                plans.append(PlanOutcome(task, None, str(error)))
        return MadePlans(airways, wall, measures, tuple(plans))

    def _measures_of(self, airways: Airways, attempt: Attempt[MadePlans]) -> TreeMeasures | None:
        """Return the measurements of airways from the earlier plans or the case, else measure them.

        None without a measurer.
        """
        before = attempt.before
        if before is not None and before.airways is airways:
            return before.measures
        with self._lock:
            known = None if self._measured is None else self._measured.of(airways)
        if isinstance(known, TreeMeasures) and not any(one.is_by_earlier_method for one in known.branches):
            return known
        if self._parts.measure_tree is None:
            return None
        attempt.progress("measuring the airways", None)
        return self._parts.measure_tree(self._volume, airways, cancel=attempt.cancel)

    def _make_turns(self, inputs: TurnInputs, attempt: Attempt[TurnList]) -> TurnList:
        from carina.plan import turn_list
        from carina.render import Renderer

        plan, number, options = inputs
        airways = self._planned_airways()
        # The renderer of the windows is unsuitable, because the user can change its transfer function.
        renderer = Renderer(self._volume)
        renderer.set_lumen(airways.lumen_zyx)
        attempt.check()
        route = plan.routes[number - 1]
        depth_mm = carina_depth_mm(options, route)
        return turn_list(airways.tree, route, carina_depth_mm=depth_mm, renderer=renderer)

    def _make_carm(self, inputs: CArmInputs, attempt: Attempt[CArmAngles]) -> CArmAngles:
        plan, number = inputs
        airways = self._planned_airways()
        shadows = self._shadows.of(airways)
        attempt.check()
        return self._parts.carm_angles(
            self._volume, airways, plan, route_number=number, shadows=shadows, cancel=attempt.cancel
        )

    def _find_shadows(self, airways: Airways) -> ShadowParts | None:
        from carina.plan.carm import shadow_parts

        try:
            return shadow_parts(self._volume, airways.tree)
        except NoResultError:
            # carm_angles repeats the search and states the reason.
            return None

    def _planned_airways(self) -> Airways:
        """Return the airways of the present plans; raise CancelledError if they have changed."""
        with self._lock:
            made = self.made
        if made is None:
            raise CancelledError("the airways have changed")
        return made.airways

    def _make_pairs(self, inputs: PairInputs, attempt: Attempt[tuple[Verdict, ...]]) -> tuple[Verdict, ...]:
        plan, wall, options = inputs
        return self._parts.judge_pairs(
            self._planned_airways().tree,
            plan,
            wall,
            scopes=self._parts.scope_presets(),
            origin_depth_mm=origin_depth_mm(options, plan.routes[0].origin),
            found=self._early_pairs.collector(inputs),
            progress=attempt.progress,
            cancel=attempt.cancel,
        )

    def _make_verdicts(self, inputs: VerdictInputs, attempt: Attempt[tuple[Verdict, ...]]) -> tuple[Verdict, ...]:
        plan, number, wall, options = inputs
        # The planned instrument comes first, because the user waits for its verdict.
        presets = sorted(self._parts.scope_presets(), key=lambda preset: preset.name != plan.scope.name)
        return self._parts.judge_scopes(
            self._planned_airways().tree,
            plan,
            wall,
            route=plan.routes[number - 1],
            scopes=presets,
            origin_depth_mm=origin_depth_mm(options, plan.routes[number - 1].origin),
            found=self._early.collector(inputs),
            progress=attempt.progress,
            cancel=attempt.cancel,
        )


def _movement_of(options: PlanOptions) -> TargetMovement | None:
    """Return the measured movement of the options for the planner; None without a measurement."""
    from carina.plan import TargetMovement

    known = options.movement
    return None if known is None else TargetMovement.measured(known.shift_lps, known.error_mm, known.notes)


def origin_depth_mm(options: PlanOptions, origin: DistanceOrigin) -> float | None:
    """Return the insertion depth in mm at nose or mouth when the tip is at the origin of a route's distances, or None.

    Parameters
    ----------
    options
        Options with the depth of the main carina, or, in a case of an earlier version, that of the tree's start.
    origin
        Origin of the route's distances.
    """
    if options.carina_depth_mm is not None and origin.is_carina:
        return options.carina_depth_mm
    return None if options.entry_mm is None else options.entry_mm + origin.along_mm


def carina_depth_mm(options: PlanOptions, route: PlannedRoute) -> float | None:
    """Return the insertion depth in mm at nose or mouth when the tip is at the main carina of a route, or None."""
    return origin_depth_mm(options, route.origin) if route.origin.is_carina else None


def _target_of(task: PlanTask) -> PlanTarget:
    """Return the target of a plan task, without its name and other parts on which the plan does not depend."""
    from carina.plan import PlanTarget

    return PlanTarget(
        target_id="target",
        name="",
        nodule=task.nodule,
        seed_lps=task.clicked_lps or task.nodule.middle_lps,
        source="edited" if task.clicked_lps is None else "click",
        where="lung",
        aims=task.aims,
        confirmed=task.confirmed,
    )


def _in_order(inputs: tuple[Any, ...]) -> tuple[Verdict, ...]:
    from carina.plan import pairs_in_order

    plan, found, available = inputs
    return pairs_in_order(plan, found, available=available)


def _with_moves(inputs: tuple[Any, ...]) -> TurnList:
    from carina.plan.turns.from_route import turns_with_moves

    tree, planned, turns, driven = inputs
    return turns_with_moves(tree, planned, turns, driven.moves, driven.ends_along_mm)


def _same_lumen(a: Airways, b: Airways) -> bool:
    return a.lumen_zyx is b.lumen_zyx


def _same_objects(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    return all(x is y for x, y in zip(a, b, strict=True))


def _same_scale(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    return a[0] is b[0] and a[1] is b[1] and a[2] == b[2]


def _same_inputs(a: PlanInputs, b: PlanInputs) -> bool:
    return a[0] is b[0] and a[1:] == b[1:]


def _same(a: VerdictInputs, b: VerdictInputs) -> bool:
    return len(a) == len(b) and all(x is y or x == y for x, y in zip(a, b, strict=True))


def chosen_number(document: Document, plan: Plan) -> int | None:
    """Return the number, from 1, of the plan's route that the document has chosen; None if it is none of them."""
    needle = None if document.route is None else document.route.needle
    if needle is None:
        return None
    for number, route in enumerate(plan.routes, 1):
        away = np.subtract((route.leg.tip_lps, route.leg.aim_lps), needle.ends_lps)
        if float(np.abs(away).max()) < SAME_PLACE_MM:
            return number
    return None


def shown_surface(nodule: Nodule) -> Mesh:
    """Return the boundary of a nodule as a mesh in LPS mm, reduced to a displayable resolution."""
    inside, lps_from_ijk = nodule.inside_zyx, np.array(nodule.lps_from_ijk, dtype=np.float64)
    step = -(-max(inside.shape) // MAX_SHOWN)
    if step > 1:
        padded_shape = [-(-size // step) * step for size in inside.shape]
        padded = np.pad(inside, [(0, after - size) for after, size in zip(padded_shape, inside.shape, strict=True)])
        nz, ny, nx = (size // step for size in padded_shape)
        inside = padded.reshape(nz, step, ny, step, nx, step).mean(axis=(1, 3, 5)) >= 0.5
        lps_from_ijk[:3, 3] += lps_from_ijk[:3, :3] @ np.full(3, 0.5 * (step - 1))
        lps_from_ijk[:3, :3] *= step
    return mask_mesh(inside, lps_from_ijk)
