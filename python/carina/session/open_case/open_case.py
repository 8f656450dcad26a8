"""The open case: its document, and the state that is not part of the document."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.breathing import ChestDeformation, ChestMotion
from carina.case.document import Document, KeyFrames, Point
from carina.case.history import History
from carina.case.recordings import RecordingFacts, RecordingWriter
from carina.case.routes import AirwayIndex, ChosenRoute, back_to_route_mm, path_move
from carina.case.stored_state import Moment
from carina.commands import ArmPen, TakeMask
from carina.errors import CarinaError
from carina.navigate import Navigator, Pilot
from carina.render import Sight
from carina.scopes import Pose, ScopeHold, ScopeState, scope_in_moved_patient
from carina.session.derived.airways import LumenWall, derived_measures, derived_wall
from carina.session.derived.derived_value import Cached, Derived
from carina.session.derived.lungs import CaseLungs
from carina.session.derived.measurement_cache import MeasuredAirways
from carina.session.derived.plans import CasePlanning
from carina.session.derived.render_content import ShownContent
from carina.session.engines import Parts, RendererFactory
from carina.session.jobs.background_jobs import JobRunner
from carina.session.open_case.key_frame_flight import KeyFlight, key_flight
from carina.session.open_case.live_breathing import TICK_S, LiveBreathing
from carina.session.open_case.point_in_airways import in_lumen
from carina.session.open_case.start_pose import pose_before_airways
from carina.session.scene.window_views import Sights
from carina.session.state.grey_scale import HISTOGRAM_PRESET, grey_scale
from carina.session.state.snapshot import AirwayStatus, CaseSnapshot, FlightPlace, MaskQuestion, PoseInfo
from carina.session.store.case_names import neutral_alias, new_case_id
from carina.track import LumenOutline
from carina.volume import Volume
from carina.volume.point_check import check_in_volume

if TYPE_CHECKING:
    from carina.track import Airways, AirwayTree, Branch, TreeMeasures

__all__ = [
    "HISTOGRAM_PRESET",
    "AirwaySearch",
    "LastMove",
    "OpenCase",
    "PendingMask",
    "PendingScope",
    "as_point",
    "moment_of",
    "new_case",
    "pose_info",
    "restore",
    "shown_deformation",
]

EXPERT = "expert"
"""Key of the expert flight's number among the numbers stored with a case; 0 for no expert flight."""


@dataclass(frozen=True, slots=True)
class PendingMask:
    """An imported segmentation mask that waits for the user's answer to a question."""

    command: TakeMask
    """Import command of the mask, with the user's answers so far."""
    question: MaskQuestion


@dataclass(frozen=True, slots=True)
class AirwaySearch:
    """Status of the search for the airways, as the airway panel shows it."""

    status: AirwayStatus = "waiting"
    words: str | None = None


@dataclass(frozen=True, slots=True)
class LastMove:
    """Cause of the last move of the tip: a program or the user's hand."""

    by: Literal["program", "hand", "device", "key_frames", "flight"] = "program"
    """*hand* is a user at mouse or keyboard; *key_frames* is the flight through the key frames; *flight* is a recorded
    flight."""
    key_frames_s: float | None = None
    """Time in s of the tip's position in the flight through the key frames; None if the tip is not on this flight."""
    flight: FlightPlace | None = None
    """Recorded flight that is being replayed and the time in it; None if no flight is being replayed."""
    person_moved: bool = False
    """Whether a user has ever moved the tip; a finished airway search then does not move the tip to the root."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedFlight:
    """A recorded flight in memory, for playback."""

    number: int
    times_s: NDArray[np.float64]
    """(n,) ascending times in s; the first is 0."""
    lps_from_camera: NDArray[np.float64]
    """(n, 4, 4) camera poses in LPS, mm."""
    motions: tuple[tuple[float, ChestMotion | None], ...] = ()
    """Changes of the simulated breathing (`carina.navigate.Recording.motions`)."""

    def pose_at(self, time_s: float) -> Pose:
        """Return the last recorded pose at or before ``time_s``."""
        n = int(np.searchsorted(self.times_s, time_s, side="right")) - 1
        return Pose(self.lps_from_camera[max(n, 0)])

    def deformation_at(self, time_s: float) -> ChestDeformation | None:
        """Return the deformation of the chest at ``time_s``; None if the flight has no breathing then."""
        motion = next((one for at_s, one in reversed(self.motions) if at_s <= time_s), None)
        return None if motion is None else motion.at(time_s)


@dataclass(frozen=True, slots=True)
class PendingScope:
    """A scope that was in the lumen when the case was closed, to be restored once the airway wall is computed."""

    scope: ScopeHold
    airways: Any
    mode: str
    pose: Pose

    def is_due(self, case: OpenCase) -> bool:
        """Return whether the case still has the stored airways, mode and pose, so that the scope may be restored."""
        tip = case.navigator
        is_still = tip.mode == self.mode and np.array_equal(tip.pose.lps_from_camera, self.pose.lps_from_camera)
        return is_still and case.document.airways is self.airways


@dataclass(slots=True)
class ScopeInLumen:
    """The scope in the lumen, or the scope that waits for the airway wall."""

    inserted: str | None = None
    """Name of the scope preset that was last inserted into the lumen; None before the first one."""
    pending: PendingScope | None = None
    """Scope that is inserted into the lumen as soon as the airway wall is computed."""


@dataclass(slots=True)
class CaseFlights:
    """The recorded flights of a case in memory, from which the case file is updated, and the simulated breathing."""

    listed: tuple[RecordingFacts, ...] = ()
    """All flights in the order of the list, including the one that is being recorded."""
    unwritten: tuple[RecordingWriter, ...] = ()
    """Recordings that are not yet completely in the file."""
    removed: frozenset[int] = frozenset()
    """Numbers of the flights that the user deleted in this session."""
    flown: LoadedFlight | None = None
    """The flight that was played last."""
    breathing: LiveBreathing = field(default_factory=LiveBreathing)


@dataclass(slots=True)
class OpenCase:
    """All state of the open case; the session's lock guards every field."""

    number: int
    info: CaseSnapshot
    content: ShownContent
    pilot: Pilot
    history: History[Document]
    planning: CasePlanning
    wall: Derived[Airways, LumenWall]
    """Wall field of the document's airways, which constrains a scope in the lumen."""
    measures: Derived[Airways, TreeMeasures]
    """Measurements of the airways of the document."""
    measured: MeasuredAirways
    """Measurements of all measured airways in the history."""
    outlined: Cached[Airways, LumenOutline]
    """Outline of the newest lumen for which an outline was requested."""
    indexed: Cached[AirwayTree, AirwayIndex]
    key_flight: Cached[tuple[KeyFrames, Airways | None], KeyFlight]
    """Flight through the newest key frames for which a flight was requested."""
    sights: Sights
    search: AirwaySearch = AirwaySearch()
    last_move: LastMove = LastMove()
    scope: ScopeInLumen = field(default_factory=ScopeInLumen)
    flown_route: ChosenRoute | None = None
    """The route whose path was last passed to the pilot."""
    pending_mask: PendingMask | None = None
    armed_pen: ArmPen = field(default_factory=lambda: ArmPen(None))
    """Kind of point (root, start, target) that the pen's first button marks; None lets it change the control."""
    begun_s: float = 0.0
    """Session time in s of the first work on the case; below 0 for a stored case that was begun earlier."""
    numbers: dict[str, int] = field(default_factory=dict)
    """The last number that was given to an object of each kind; targets and key frames count from 1 in each case."""
    flights: CaseFlights = field(default_factory=CaseFlights)

    def next_number(self, what: str) -> int:
        """Return the next number for objects of a kind (target, key frame, flight), which no such object had before."""
        self.numbers[what] = self.numbers.get(what, 0) + 1
        return self.numbers[what]

    @property
    def expert_flight(self) -> int | None:
        """Number of the flight that is marked as the expert's; None without one, or if it was deleted."""
        number = self.numbers.get(EXPERT, 0)
        return number if any(one.recording_id == number for one in self.flights.listed) else None

    @expert_flight.setter
    def expert_flight(self, number: int | None) -> None:
        self.numbers[EXPERT] = number or 0

    @property
    def case_id(self) -> str:
        """Random id of the case, equal to the id of its record once the case is stored."""
        return self.info.case_id

    @case_id.setter
    def case_id(self, case_id: str) -> None:
        self.info = replace(self.info, case_id=case_id)

    @property
    def neutral_title(self) -> str:
        """Name of the case without information about its CT or its patient."""
        return neutral_alias(self.case_id)

    @property
    def outline(self) -> LumenOutline | None:
        """Outline of the lumen of the document; None without airways."""
        airways = self.document.airways
        return None if airways is None else self.outlined.of(airways)

    @property
    def index(self) -> AirwayIndex | None:
        """Centreline points of the tree of the document; None without airways."""
        airways = self.document.airways
        return None if airways is None else self.indexed.of(airways.tree)

    @property
    def sight(self) -> Sight:
        """Display settings (sight) of the window that was used last."""
        return self.sights.latest

    def discard(self) -> None:
        """Stop computing values for the case and release large data, because the case is being closed."""
        for derived in (self.content, self.wall, self.measures, self.planning, self.planning.lungs):
            derived.discard()

    @property
    def navigator(self) -> Navigator:
        """The navigator of the tip, for reading; moves must go through the pilot."""
        return self.pilot.navigator

    @property
    def document(self) -> Document:
        """The current document of the history."""
        return self.history.current

    def follow_route(self, route: ChosenRoute) -> None:
        """Set another route without an undo step, because the user chose it while flying."""
        self.history.amend_current(lambda document: replace(document, route=route))

    def check_inside(self, lps: Point) -> None:
        """Refuse a point outside the volume.

        Parameters
        ----------
        lps
            The point in LPS, mm.

        Raises
        ------
        UsageError
            ``session.outside``: if the point is outside the volume.
        """
        check_in_volume(self.info.volume, lps, "the point", code="session.outside")


def new_case(
    volume: Volume,
    number: int,
    *,
    parts: Parts,
    renderer_factory: RendererFactory,
    jobs: JobRunner,
    lock: AbstractContextManager[Any],
    changed: Callable[..., None],
    say: Callable[[str], None] = lambda _words: None,
    stored: Moment | None = None,
) -> OpenCase:
    """Create the case of a volume, either from its stored state or without airways.

    Parameters
    ----------
    volume
        The CT.
    number
        Number of the case in this session.
    parts, renderer_factory, jobs, lock
        Processing functions, renderer factory, job runner and lock of the session.
    changed
        Called by jobs of the case with the topics that have changed.
    say
        Called with messages for the user.
    stored
        The stored state; None for a new case.

    Returns
    -------
    OpenCase
        The case.
    """

    def report_lost(trouble: CarinaError) -> None:
        say(f"the saved measurements of the airways cannot be read, so the airways will be measured again: {trouble}")

    scale = grey_scale(volume, parts)
    document = Document(transfer=scale.transfer, lumen_threshold=scale.threshold)
    history = History(document) if stored is None else stored.history()
    measured = MeasuredAirways(() if stored is None else stored.measures)
    transfer = history.current.transfer
    planning = CasePlanning(volume, parts, jobs=jobs, lock=lock, changed=partial(changed, "plan"), measured=measured)
    planning.lungs = CaseLungs(
        volume, parts, jobs=jobs, lock=lock, wall=planning.wall_of, changed=partial(changed, "lungs", "views")
    )
    case = OpenCase(
        number=number,
        info=CaseSnapshot(volume, parts.quality_words(volume), scale, volume.value_range, new_case_id()),
        content=ShownContent(
            renderer_factory(volume, transfer), transfer, jobs=jobs, lock=lock, changed=partial(changed, "views")
        ),
        pilot=Pilot(Navigator(pose_before_airways(volume), volume=volume)),
        history=history,
        planning=planning,
        wall=derived_wall(volume, parts, jobs=jobs, lock=lock),
        measures=derived_measures(
            volume,
            parts,
            jobs=jobs,
            lock=lock,
            changed=partial(changed, "state", "tree", "pose"),
            measured=measured,
            lost=report_lost,
        ),
        measured=measured,
        # Edits that do not change the lumen (a name, a smoother centreline) reuse its outline.
        outlined=Cached(partial(LumenOutline, volume), same=lambda a, b: a.lumen_zyx is b.lumen_zyx),
        indexed=Cached(AirwayIndex),
        key_flight=Cached(lambda keys_and_airways: key_flight(volume, *keys_and_airways)),
        sights=Sights(Sight(window=scale.window) if stored is None else stored.sight),
    )
    if stored is not None:
        restore(case, stored)
    return case


def restore(case: OpenCase, stored: Moment) -> None:
    """Restore tip, search status and numbers of a stored case; a scope is inserted once the wall is computed."""
    document = case.document
    case.flown_route = document.route
    case.pilot.apply(path_move(None if document.airways is None else document.airways.tree, document.route))
    if stored.tip:  # The stored tip of a repaired case may be missing.
        case.navigator.restore(stored.tip, case.navigator.path)
    status: AirwayStatus = "found" if document.airways is not None else "waiting"
    if document.airways is None and stored.search_status == "failed":
        status = "failed"
    case.search = AirwaySearch(status, stored.search_words)
    case.last_move = LastMove(person_moved=stored.person_moved)
    case.numbers = dict(stored.numbers)
    if stored.scope is not None and document.airways is not None and document.route is not None:
        tip = case.navigator
        case.scope.pending = PendingScope(stored.scope, document.airways, tip.mode, tip.pose)


def moment_of(case: OpenCase) -> Moment:
    """Return all state of a case that is stored; immutable parts are shared. The caller holds the session's lock."""
    history, held, pending = case.history, case.navigator.scope_state, case.scope.pending
    scope = None if held is None else held.hold
    if scope is None and pending is not None and pending.is_due(case):
        # The scope must also be restored if Carina is killed before the wall is computed.
        scope = pending.scope
    return Moment(
        first=history.first,
        steps=history.steps,
        position=history.position,
        sight=case.sight,
        tip=case.navigator.state(),
        scope=scope,
        search_status=case.search.status,
        search_words=case.search.words,
        person_moved=case.last_move.person_moved,
        numbers=dict(case.numbers),
        measures=case.measured.retain_only(document.airways for document in history.documents()),
    )


def shown_deformation(case: OpenCase, now_s: float) -> ChestDeformation | None:
    """Return the deformation of the chest in the airway view, while a breathing is simulated, else None.

    A recorded flight that is played shows its own breathing. The caller holds the session's lock.
    """
    flight, flown = case.last_move.flight, case.flights.flown
    if flight is not None and flown is not None and flown.number == flight.number:
        return flown.deformation_at(flight.time_s)
    airways = case.document.airways
    motion = None if airways is None else case.flights.breathing.motion(airways.tree)
    if motion is None:
        return None
    # In steps, because every new deformation is a new picture.
    return motion.at(math.floor(case.flights.breathing.clock_s(now_s) / TICK_S) * TICK_S)


def _scope_state(case: OpenCase, now_s: float) -> ScopeState | None:
    """Return the state of the scope in the lumen, with contact and red-out in the moved patient."""
    tip, airways = case.navigator, case.document.airways
    deformation = shown_deformation(case, now_s)
    wall = None if airways is None else case.wall.of(airways)
    if tip.scope_state is None or deformation is None or wall is None or tip.scope_tip_mm is None:
        return tip.scope_state
    return scope_in_moved_patient(tip.scope_state, wall.field, deformation, tip.scope_tip_mm)


def pose_info(case: OpenCase, pose_id: int, now_s: float) -> PoseInfo:
    """Return the pose of the tip with its branch, its distance along the route and the diameter of the lumen."""
    tip, index, document = case.navigator, case.index, case.document
    at = tip.pose.position_lps
    airways, route, path_mm = document.airways, document.route, tip.path_mm
    inside = case.info.volume.contains_lps(at)
    if airways is not None:
        inside = inside and in_lumen(case.info.volume, airways.lumen_zyx, at)
    branch: Branch | None = None
    if path_mm is not None and route is not None:
        n = int(np.argmin(np.abs(route.cumulative_mm - path_mm)))
        branch = None if index is None or not route.lumen_known else index.branch(int(route.branch_ids[n]))
    elif index is not None and inside:
        branch, _, _ = index.nearest(at)
    measures = None if branch is None or airways is None else case.measures.of(airways)
    lumen_mm = None if measures is None or branch is None else measures.of(branch.id).diameter_near(at)
    return PoseInfo(
        pose_id=pose_id,
        pose=tip.pose,
        mode=tip.mode,
        path_mm=path_mm,
        branch=branch,
        lumen_mm=lumen_mm,
        inside=inside,
        scope=_scope_state(case, now_s),
        scope_tip_mm=tip.scope_tip_mm,
        key_frames_s=case.last_move.key_frames_s,
        flight=case.last_move.flight,
        by_device=case.last_move.by == "device",
        back_to_route_mm=_back_to_route_mm(case, branch),
    )


def _back_to_route_mm(case: OpenCase, branch: Branch | None) -> float | None:
    """Return the distance in mm back to the route, in mode *scope* in a wrong branch; else None."""
    airways, route, tip = case.document.airways, case.document.route, case.navigator
    if tip.mode != "scope" or branch is None or airways is None or route is None or not route.lumen_known:
        return None
    return back_to_route_mm(airways.tree, route, branch.id, tip.pose.position_lps)


def as_point(values: Iterable[Any]) -> Point:
    """Return a point, given as three numbers of any type, as a tuple of Python floats."""
    x, y, z = (float(v) for v in values)
    return x, y, z
