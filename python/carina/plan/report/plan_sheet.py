"""Contents of a report as one value, from which the HTML page, the PDF and the JSON file are made."""

from __future__ import annotations

import datetime
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import UsageError, check_type
from carina.plan.carm import CArmAngles
from carina.plan.lungs.tissue_near_needle import NearbyTissue, surroundings
from carina.plan.reasons import Reason, reasons_against
from carina.plan.report.slices import SlicePicture, needle_slice, place_slices, target_slices
from carina.plan.report.tree_shape import TreeShape, tree_shape
from carina.plan.report.uncertainty import by_hand, uncertain
from carina.plan.route_stations import STATION_NOTE, RouteStation, route_stations
from carina.plan.routes.plan_route import CancellableProgress, Plan, PlannedRoute
from carina.plan.routes.standing_points import branch_doubts, branch_title
from carina.plan.targets.grow_nodule import Nodule
from carina.plan.turns.clips import TurnClip
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.pictures import TurnPicture
from carina.plan.turns.turn_list import Turn, TurnList
from carina.plan.verdict.verdict import Verdict
from carina.render import Renderer
from carina.scopes import WallField
from carina.track import (
    Airways,
    CalibratedShares,
    CtAssessment,
    LumenOutline,
    assess_ct,
    branch_side_and_lobe,
    wall_field,
)
from carina.version import VERSION
from carina.volume import Volume, ct_digest

AROUND_MM = 30.0
"""Maximum distance in mm from the target's edge at which pleura is searched; beyond it the text is *more than*."""
TOUCHES_MM = 2.0
"""Distance in mm below which tissue cannot be distinguished from the blurred edge of a nodule."""


@one_line
@dataclass(frozen=True, slots=True)
class TargetPlace:
    """Location of a target in the lungs."""

    lobe: str | None
    """Lobe of the nearest airway; None if it is not known."""
    nearest_branch: str
    """Name of the nearest airway, or its number such as ``branch 17``."""
    pleura_mm: float | None
    """Distance in mm from the target's edge to the nearest tissue thicker than a vessel (pleura or mediastinum).

    None if there is none within ``looked_mm``, or if the CT ends before it.
    """
    looked_mm: float
    """Largest distance in mm from the target's edge that was searched for thick tissue."""
    is_cut: bool
    """Whether the CT ends nearer to the target than any thick tissue, within ``looked_mm``."""

    @property
    def pleura_words(self) -> str:
        """Distance to the pleura in words, such as *12 mm*."""
        if self.is_cut:
            return "not known: the CT ends close to the target"
        if self.pleura_mm is None:
            return f"more than {self.looked_mm:.0f} mm"
        return "in contact" if self.pleura_mm <= TOUCHES_MM else f"{self.pleura_mm:.0f} mm"

    def to_json(self) -> dict[str, Any]:
        """Return the location as plain JSON types."""
        return {
            "lobe": self.lobe,
            "nearest_branch": self.nearest_branch,
            "pleura_mm": self.pleura_mm,
            "looked_mm": self.looked_mm,
            "ct_ends_nearby": self.is_cut,
        }


@one_line
@dataclass(frozen=True, slots=True)
class Provenance:
    """Scan and program from which a report was made, without data that identify a patient."""

    version: str
    made_on: str
    """Date of the report in ISO format."""
    scan_format: str
    series: str | None
    """Modality and number of the series in the study; never its description, which may contain a patient's name."""
    ct_digest: str
    """Digest of the voxels; equal CTs have equal digests."""
    shape_zyx: tuple[int, int, int]
    spacing_mm: tuple[float, float, float]

    def to_json(self) -> dict[str, Any]:
        """Return the provenance as plain JSON types."""
        return {
            "carina": self.version,
            "made_on": self.made_on,
            "format": self.scan_format,
            "series": self.series,
            "ct_digest": self.ct_digest,
            "shape_zyx": list(self.shape_zyx),
            "spacing_mm": list(self.spacing_mm),
        }


@one_line
@dataclass(frozen=True, slots=True)
class Fork:
    """Fork of the route, with the branches that are not entered there."""

    number: int
    """Number of the fork, counted along the route from the trachea, from 1."""
    from_name: str
    to_name: str
    to_branch_id: int
    place_lps: tuple[float, float, float]
    carina_mm: float | None
    """Distance in mm of the fork from the main carina along the route.

    Below 0 before the carina, None if it is not known.
    """
    others: tuple[str, ...]
    warnings: tuple[str, ...]
    turn: Turn | None
    """Turn at the fork with clock hours and moves; None if no list of turns was made."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PlanSheet:
    """Contents of a report: a plan, the details of one of its routes, and pictures (`make_sheet`)."""

    plan: Plan
    route_number: int | None
    """Number of the route that is described in detail, from 1; None if the plan has no route."""
    verdicts: tuple[Verdict, ...]
    turns: TurnList | None
    turn_pictures: tuple[TurnPicture, ...] = field(repr=False)
    """Picture of each turn of the route; empty if no pictures were made."""
    turn_clips: tuple[TurnClip | None, ...] = field(repr=False)
    """Clip of the flight to each turn, or empty; None for a turn at the place of the turn before it."""
    forks: tuple[Fork, ...]
    operator: Operator
    place: TargetPlace
    slices: tuple[SlicePicture, ...]
    needle_slice: SlicePicture | None
    sign_slices: tuple[SlicePicture, ...]
    """Slices that show the bronchus sign; empty without the sign."""
    shape: TreeShape
    uncertain: tuple[str, ...]
    by_hand: tuple[str, ...]
    """Sentences about parts that were drawn by hand, shown in red."""
    notes: tuple[str, ...]
    """Notes on the plan that its planner wrote, shown unchanged."""
    patient: str | None
    provenance: Provenance
    carm: CArmAngles | None
    """Positions of a C-arm for the route; None if they were not computed."""
    stations: tuple[RouteStation, ...]
    """Lymph node stations for EBUS that the route passes or that are next to the target."""
    calibrated_shares: CalibratedShares | None
    """Shares of airways that the search finds in slices of this CT's thickness; None for thin slices."""
    assessment: CtAssessment | None
    """What limits the airways that can be seen in the CT; None if its values are not HU."""

    @property
    def route(self) -> PlannedRoute | None:
        """Route that the report describes in detail; None if the plan has no route."""
        return None if self.route_number is None else self.plan.routes[self.route_number - 1]

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Everything against the plan, in the order in which every output lists it."""
        return reasons_against(self.plan, route=self.route, verdicts=self.verdicts, turns=self.turns)

    def _further_uncertain(self) -> list[str]:
        """Return the uncertainties that are neither notes of the plan nor reasons against it, for JSON."""
        known = [words.rstrip(".").casefold() for words in (*self.plan.notes, *(one.words for one in self.reasons))]
        return [words for words in self.uncertain if words.rstrip(".").casefold() not in known]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON types: the plan as ``carina plan`` writes it, and the other contents under ``report``."""
        return self.plan.to_json() | {
            "verdicts": [verdict.to_json() for verdict in self.verdicts],
            "turns": None if self.turns is None else self.turns.to_json(),
            "c_arm": None if self.carm is None else self.carm.to_json(),
            "ebus": {"stations": [one.to_json() for one in self.stations], "note": STATION_NOTE},
            "calibrated_shares": None if self.calibrated_shares is None else self.calibrated_shares.to_json(),
            "assessment": None if self.assessment is None else self.assessment.to_json(),
            "report": {
                "route": self.route_number,
                "operator": self.operator,
                "place": self.place.to_json(),
                "turn_pictures": [one.words for one in self.turn_pictures],
                "reasons": [reason.to_json() for reason in self.reasons],
                "uncertain": self._further_uncertain(),
                "by_hand": list(self.by_hand),
                "notes": list(self.notes),
                "patient": self.patient,
                "provenance": self.provenance.to_json(),
            },
        }


@shows_progress
def make_sheet(
    volume: Volume,
    airways: Airways,
    plan: Plan,
    *,
    route_number: int = 1,
    verdicts: Sequence[Verdict] = (),
    turns: TurnList | None = None,
    turn_pictures: Sequence[TurnPicture] = (),
    turn_clips: Sequence[TurnClip | None] = (),
    notes: Sequence[str] = (),
    patient: str | None = None,
    operator: Operator = "head",
    made_on: datetime.date | None = None,
    wall: WallField | None = None,
    carm: CArmAngles | None = None,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> PlanSheet:
    """Render the pictures of a plan and collect the contents of its report.

    Parameters
    ----------
    volume, airways, plan
        The CT, its airways, and the plan of `plan_route` for them.
    route_number
        Number of the route that is described in detail, from 1.
    verdicts
        Verdicts of instruments on that route (`judge_scopes`).
    turns, turn_pictures
        List of turns (`carina.plan.turn_list`) and a picture of each turn (`carina.plan.turn_pictures`), or none.
    turn_clips
        Clip of the flight to each turn (`carina.plan.turn_clips`), played over its picture, or none.
    notes
        The planner's own notes, shown unchanged.
    patient
        Name or number to be printed. Without it the report contains nothing that identifies the patient.
    operator
        Position of the operator; clock hours for this position come first.
    made_on
        Date of the report; today if None.
    wall
        Wall of the airways; computed if None.
    carm
        Positions of a C-arm for the route (`carina.plan.carm_angles`), or none.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    PlanSheet
        Contents for `write_report`.

    Raises
    ------
    UsageError
        If there is no such route, or turns or pictures belong to another route.
    CancelledError
        If ``cancel()`` returned True.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> found = carina.find_airways(made.volume)
    >>> plan = carina.plan_route(made.volume, found, made.truth["nodule"]["centre_lps"])
    >>> from carina.plan import make_sheet
    >>> sheet = make_sheet(made.volume, found, plan)
    >>> sheet.place.lobe is not None, sheet.patient
    (True, None)
    """
    check_type("make_sheet", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("make_sheet", "airways", airways, Airways, "get airways from carina.find_airways")
    check_type("make_sheet", "plan", plan, Plan, "get a plan from carina.plan_route")
    route = _chosen(plan, route_number)
    _check_pictures(turns, turn_pictures, operator)
    _check_clips(turn_pictures, turn_clips)
    _check_turns(airways, route, turns)
    on_progress = fraction_callback(progress_function(progress), "rendering the pictures")
    report = CancellableProgress(on_progress, cancel, "the report was cancelled")
    report(0.0)
    wall = wall_field(volume, airways, cancel=cancel) if wall is None else wall
    report(0.4)
    place = _place(volume, airways, plan.nodule, wall)
    report(0.6)
    renderer, outline = Renderer(volume), LumenOutline(volume, airways)
    leg = None if route is None else route.leg
    slices = target_slices(renderer, plan.nodule, leg, outline)
    report(0.8)
    along = None if route is None else needle_slice(renderer, plan.nodule, route.leg, route.forward, outline)
    proof = () if plan.sign_lps is None else place_slices(renderer, plan.sign_lps, plan.nodule, outline)
    report(0.95)
    sheet = PlanSheet(
        plan=plan,
        route_number=None if route is None else route_number,
        verdicts=tuple(verdicts),
        turns=turns,
        turn_pictures=tuple(turn_pictures),
        turn_clips=tuple(turn_clips),
        forks=() if route is None else _forks(airways, route, turns),
        operator=operator,
        place=place,
        slices=slices,
        needle_slice=along,
        sign_slices=proof,
        shape=tree_shape(airways.tree, plan.nodule, route),
        uncertain=uncertain(volume, airways, plan, route=route, turns=turns, verdicts=tuple(verdicts)),
        by_hand=by_hand(airways, plan, route),
        notes=tuple(notes),
        patient=patient,
        provenance=_provenance(volume, made_on),
        carm=carm,
        stations=() if not plan.routes else route_stations(airways.tree, plan, plan.routes[route_number - 1]),
        calibrated_shares=airways.calibrated_shares,
        assessment=assess_ct(volume, airways) if volume.is_hu else None,
    )
    report(1.0)
    return sheet


def target_words(sheet: PlanSheet) -> str:
    """Return kind, size and lobe of the target, such as *solid nodule, 12.4 x 10.1 mm, 0.74 ml, RUL*."""
    return sheet.plan.nodule.words + (f", {sheet.place.lobe}" if sheet.place.lobe else "")


def _chosen(plan: Plan, number: int) -> PlannedRoute | None:
    if not plan.routes:
        return None
    if not 1 <= number <= len(plan.routes):
        raise UsageError(
            f"route_number: expected 1 to {len(plan.routes)}, the routes of this plan; found {number}",
            code="plan.route-number",
        )
    return plan.routes[number - 1]


def _place(volume: Volume, airways: Airways, nodule: Nodule, wall: WallField) -> TargetPlace:
    centre = np.array(nodule.centre_lps)
    branch, _, _ = airways.tree.nearest_branch(centre)
    lobe = branch_side_and_lobe(airways.tree)[branch.id]
    around = surroundings(volume, centre, 0.5 * nodule.long_mm + AROUND_MM, nodule, wall)
    rim = np.argwhere(nodule.inside_zyx)[:, ::-1] @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3]
    nearest = float(around.read(around.thick_mm, rim).min())
    if "pleura" in nodule.touches:
        nearest = 0.0
    # The corners of the box are farther away than its faces, up to which the search is complete.
    nearest = nearest if nearest <= AROUND_MM else math.inf
    is_cut = _to_edge_mm(around, nodule) < min(nearest, AROUND_MM)
    return TargetPlace(
        lobe=lobe,
        nearest_branch=branch_title(branch),
        pleura_mm=nearest if math.isfinite(nearest) and not is_cut else None,
        looked_mm=AROUND_MM,
        is_cut=is_cut,
    )


def _to_edge_mm(around: NearbyTissue, nodule: Nodule) -> float:
    """Return the distance in mm from a nodule to the edge of the CT inside the box round the nodule.

    Infinite if none.
    """
    unknown = np.argwhere(~around.box.known)
    if not len(unknown):
        return math.inf
    step = around.box.step_mm
    points = unknown[:, ::-1] * step + around.box.lps_from_ijk[:3, 3]
    return float(np.linalg.norm(points - np.array(nodule.centre_lps), axis=1).min()) - 0.5 * nodule.long_mm


def _check_pictures(turns: TurnList | None, pictures: Sequence[TurnPicture], operator: Operator) -> None:
    """Raise an error for pictures of other turns, or for another position of the operator."""
    if not pictures:
        return
    expected = () if turns is None else turns.turns
    if tuple(one.turn for one in pictures) != expected:
        raise UsageError(
            f"report: expected a picture for each of {len(expected)} turns, in their order; found {len(pictures)}",
            code="plan.pictures",
        )
    other = next((one.operator for one in pictures if one.operator != operator), None)
    if other is not None:
        raise UsageError(
            f"report: the pictures of the turns are for an operator at {other!r}, the report for one at {operator!r}",
            code="plan.pictures",
        )


def _check_clips(pictures: Sequence[TurnPicture], clips: Sequence[TurnClip | None]) -> None:
    """Raise an error for clips that do not belong to the pictures over which they are played."""
    if not clips:
        return
    ends = [(one.turn, one.operator) for one in pictures]
    if len(clips) != len(ends) or any(
        clip is not None and (clip.turn, clip.operator) != end for clip, end in zip(clips, ends, strict=True)
    ):
        raise UsageError(
            f"report: expected a clip, or None, for each of {len(ends)} pictures of turns, in their order and for the "
            f"same position of the operator; found {len(clips)} clips, or others",
            code="plan.pictures",
        )


def _check_turns(airways: Airways, route: PlannedRoute | None, turns: TurnList | None) -> None:
    """Raise an error for a list of turns that belongs to another route."""
    if turns is None:
        return
    lineage = set() if route is None else {branch.id for branch in airways.tree.lineage(route.branch_id)}
    wrong = next((turn for turn in turns.turns if turn.to_branch_id not in lineage), None)
    if wrong is not None or route is None:
        where = (
            "the plan has no route" if wrong is None else f"it turns into {wrong.to_branch}, which is not on the route"
        )
        raise UsageError(f"report: the list of turns is that of another route: {where}", code="plan.turns")


def _forks(airways: Airways, route: PlannedRoute, turns: TurnList | None) -> tuple[Fork, ...]:
    tree = airways.tree
    if turns is not None:
        return tuple(
            Fork(
                number=number,
                from_name=turn.from_branch,
                to_name=turn.to_branch,
                to_branch_id=turn.to_branch_id,
                place_lps=turn.fork_lps,
                carina_mm=turn.from_carina_mm,
                others=tuple(other.name for other in turn.others),
                warnings=turn.cautions,
                turn=turn,
            )
            for number, turn in enumerate(turns.turns, 1)
        )
    found: list[Fork] = []
    along = 0.0
    for before, branch in itertools.pairwise(tree.lineage(route.branch_id)):
        along += before.length_mm
        others = [tree.branch(child) for child in before.children if child != branch.id]
        if not others:
            continue
        x, y, z = (float(v) for v in branch.points[0])
        found.append(
            Fork(
                number=len(found) + 1,
                from_name=branch_title(before),
                to_name=branch_title(branch),
                to_branch_id=branch.id,
                place_lps=(x, y, z),
                carina_mm=route.origin.fork_mm(along) if route.origin.is_carina else None,
                others=tuple(branch_title(one) for one in others),
                warnings=branch_doubts(branch),
                turn=None,
            )
        )
    return tuple(found)


def _provenance(volume: Volume, made_on: datetime.date | None) -> Provenance:
    series = volume.source.series
    day = datetime.datetime.now(tz=datetime.UTC).astimezone().date() if made_on is None else made_on
    return Provenance(
        version=VERSION,
        made_on=day.isoformat(),
        scan_format=volume.source.format,
        series=None if series is None else f"{series.modality} series {series.key}, {series.num_slices} slices",
        ct_digest=ct_digest(volume)[:16],
        shape_zyx=volume.shape_zyx,
        spacing_mm=volume.spacing_mm,
    )
