"""Messages from the server about lesions, planned routes, verdicts on instruments, and the lung map."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import BranchId, Count, Identifier, Part, PathMm, PointLps, PointsLps, Words
from carina.commands.plan import Instruments, PlanOptions
from carina.server.wire.codec import ClientMessage, ServerMessage
from carina.session.scene.layer_lines import LayerName
from carina.value import FrozenValue

Making = Literal["unwanted", "making", "had", "failed", "stopped"]


class TargetSurface(FrozenValue, frozen=True):
    """The boundary of a target as a triangle mesh for drawing."""

    vertices_lps: PointsLps
    triangles: Annotated[tuple[Count, ...], Meta(max_length=1_000_000)]
    """Three indices into the vertices for each triangle, counterclockwise seen from outside."""


class NeedleTissue(FrozenValue, frozen=True):
    """A segment of a needle's path inside one tissue; positions are distances in mm from the scope's tip."""

    tissue: Words
    from_mm: PathMm
    to_mm: PathMm


class NeedleLeg(FrozenValue, frozen=True):
    """The path of the needle from the scope's tip into the target; `leg` of a route in plan.json has the same keys."""

    tip_lps: PointLps
    aim_lps: PointLps
    to_target_mm: float
    """Distance in mm from the tip of the scope to the edge of the target."""
    angle_deg: float
    """Angle in degrees between the needle and the airway's axis at the tip."""
    crossed: tuple[NeedleTissue, ...]
    """Tissues along the needle, in order."""
    in_target_mm: float
    """Length in mm of the needle inside the target, without errors of the needle."""
    vessel_mm: float | None
    """Distance in mm from the needle's line to the nearest visible vessel; null if no vessel is visible nearby."""
    hit_share: Part | None
    """Share of the needles within the assumed errors that hit the target at its place in the CT, 0 to 1.

    It is that of the simulated drive, as in the verdict; null if no drive has arrived.
    """
    hit_share_moved: Part | None
    """Share of the needles that hit if the target may have moved since the CT; null if not computed."""


class MarkQuestion(FrozenValue, frozen=True):
    """Point under the cursor; the answer repeats both values."""

    request_id: Count
    lps: PointLps


class AskTargetMark(MarkQuestion, ClientMessage, frozen=True, tag="target_mark"):
    """Request the result of a click with the tool *Mark target*; only the newest is answered, by ``target_mark``."""


class TargetMark(MarkQuestion, ServerMessage, frozen=True, tag="target_mark"):
    """Answer to ``target_mark``."""

    sentences: tuple[Words, ...]
    """Texts: the marked structure, and reasons why it may not be a nodule; empty if the search was stopped."""
    warns: bool
    """Whether the mark has warnings, or neither a route nor a plan can lead to the point."""


class RouteOrigin(FrozenValue, frozen=True):
    """The origin of the distances along a route."""

    kind: Literal["ridge", "axes", "root", "route"]
    """Ridge of the main carina; point where the axes of the main bronchi meet; start of the airway tree; of the route.
    """
    along_mm: float
    """Distance in mm of the origin from the start of the airway tree, along the centrelines.

    For a path that was not searched in the airways: from the start of the path, along the path.
    """


class FailurePredictors(FrozenValue, frozen=True):
    """Published predictors of a failed navigation; `predictors` of a route in plan.json has the same keys."""

    bifurcation_deg: float | None
    """Angle in degrees between the axes of the tip's branch and of its parent; null in the first branch of the tree."""
    least_mm: float
    """Minimum diameter in mm of the lumen in the route's last section."""
    least_error_mm: float
    """Half-width in mm of the interval that should contain the true least diameter in 90 of 100 cases."""
    least_by: Literal["sections", "ball"]
    """Method of the least diameter, as for ``narrowest_by``."""
    curvature_per_mm: float | None
    """Mean curvature of the last section in 1/mm; null if the route is too short."""
    note: Words
    """Text with the source of the predictors and their limits."""


class RouteOffer(FrozenValue, frozen=True):
    """A planned route to a target, with its measurements and its score; a route in plan.json has the same keys."""

    key: Words
    """Identifier of the position of the scope and the aim."""
    branch_id: BranchId
    branch_name: Words
    origin: RouteOrigin
    from_carina_mm: float | None
    """Distance in mm of the scope's tip from the main carina; null if the route does not pass the main carina."""
    narrowest_mm: float
    """Narrowest diameter of the route in mm."""
    narrowest_error_mm: float
    """Half-width in mm of the interval that should contain the true diameter in 90 of 100 cases."""
    narrowest_at_mm: float
    """Distance in mm of the narrowest place from the origin; below 0 if the place is before the origin."""
    narrowest_by: Literal["sections", "ball"]
    """Method of the narrowest diameter.

    ``sections``: measured cross-sections. ``ball``: the largest ball in the lumen, on a segment that could not be
    measured.
    """
    narrowest_why: Words | None
    """Reason why a segment could not be measured, and its position; null if all were measured."""
    fit: Literal["fits", "may fit", "does not fit"]
    """Whether the planned scope fits; *may fit*: it fits only if the errors of measurement are in its favour."""
    outlook: Words
    """Whether the planned scope reaches the target, by its simulated drive along the best routes."""
    limits: tuple[Words, ...]
    """Reasons why the scope or the tool does not, or may not, reach the target."""
    leg: NeedleLeg
    score: Part
    """Score of the route, 0 to 1 (best)."""
    doubts: tuple[Words, ...]
    """Warnings about branches of the route that are drawn by hand, bridged or doubtful."""
    predictors: FailurePredictors | None = None
    """Published predictors of a failed navigation; they have no limits and are not a verdict."""


class ScopeCheck(FrozenValue, frozen=True):
    """One check of an instrument on a route, with its answer."""

    name: Words
    answer: Literal["yes", "perhaps", "no", "unknown"]
    words: Words
    basis: Words
    """Data and measurements on which the answer is based."""


class PairVerdict(Instruments, frozen=True, kw_only=True):
    """Verdict on a pair of a route and an instrument with a tool that passes its channel."""

    title: Words
    """Title of the scope for display."""
    route: Words
    """Key of the route on which the scope was judged (``RouteOffer.key``)."""
    outcome: Words
    """One of *reaches*, *may reach*, *does not reach* and *cannot say*."""
    words: Words
    share: Part | None
    """Smallest probability among the checks; null if it cannot be computed."""
    would: Words | None
    """Changes with which the instrument would reach the target; null if none is needed or known."""


class RoutePair(PairVerdict, frozen=True, kw_only=True):
    """Verdict on one pair of the best routes and all instruments; a pair in plan.json has the same keys."""

    available: bool
    """Whether the instrument is available here; pairs of other instruments follow those of available ones."""


class ScopeVerdict(PairVerdict, frozen=True, kw_only=True):
    """Verdict on one instrument for the chosen route, with its checks; a verdict in plan.json has the same keys."""

    reached_mm: float | None
    """Distance in mm of the place that the tip reaches from the origin of the route; null if it is not known."""
    checks: tuple[ScopeCheck, ...]
    was_driven: bool
    """Whether a simulated drive exists, which the user can store in the case as a flight."""


class StationOnRoute(FrozenValue, frozen=True):
    """A lymph node station that a route passes or that is next to its target, by the landmark of its examination."""

    station: Words
    head: Words
    """Station, place, clock hour and relation to route and target, for an operator at the patient's head."""
    facing: Words
    """Clock hour of the station for an operator who faces the patient, as text."""
    point_lps: PointLps
    """Landmark on the centreline, LPS mm."""
    direction_lps: PointLps
    """Unit vector across the airway, towards the wall behind which the station is."""
    borders: Words
    """Text that describes the anatomical borders of the station."""
    doubts: tuple[Words, ...]


class CArmPosition(FrozenValue, frozen=True):
    """A position of a C-arm for a route; an angle of `c_arm` in plan.json has the same keys."""

    primary_deg: float
    """Rotation of the detector towards the patient's left (LAO, above 0) or right (RAO, below 0), degrees."""
    secondary_deg: float
    """Rotation of the detector towards the head (cranial, above 0) or the feet (caudal, below 0), degrees."""
    name: Words
    """C-arm position by its angles, such as *LAO 30\u00b0, cranial 10\u00b0*."""
    words: Words
    """C-arm position, with the clearances of target and tip and the tilt of the last branch, as text."""


class CArmPositions(FrozenValue, frozen=True):
    """Positions of a C-arm for one route, the best one first; `c_arm` in plan.json has the same keys."""

    angles: tuple[CArmPosition, ...]
    why: Words | None
    """Reason why no position suits; null if one does."""
    limits: Words
    notes: tuple[Words, ...]


class TargetPlan(FrozenValue, frozen=True):
    """A lesion that is a target, and the routes to it."""

    target_id: Identifier
    centre_lps: PointLps
    size: Words
    """Text with kind, diameters, volume and their 90 % errors, such as *solid nodule, 12.3 x 10.1 mm, 0.74 ml*."""
    where: Words | None
    """Region of the target."""
    long_mm: float
    """Longest diameter of the target in mm."""
    num_aims: Count
    """Number of alternative points in the target at which the needle may be aimed."""
    surface: TargetSurface
    options: PlanOptions
    moved_mm: float | None
    """Distance in mm by which the target may have moved since the CT; null without a plan."""
    movement: Words | None
    """Text on the movement since the CT with its origin (assumed, entered or measured); null without a plan."""
    bronchus_sign: Words | None
    """Text of the bronchus sign, such as *an airway leads into the target (RB4a)*; null without a plan."""
    reasons: tuple[tuple[Identifier, Words, Literal["stop", "caution"]], ...]
    """Code, text and severity of everything against the plan by its chosen route, or by its best one if none is chosen.

    Report and sheet list the same in the same order. *stop*: speaks against the plan by itself, shown in red.
    *caution*: limits the plan.
    """
    routes: tuple[RouteOffer, ...]
    problem: Words | None
    """Reason why there is no route, and advice; null if there is one."""
    notes: tuple[Words, ...]
    doubts: tuple[tuple[Identifier, Words], ...]
    """Code and text of each reason for which the target may not be a nodule."""
    unconfirmed: tuple[Identifier, ...]
    """Codes of the doubts that the user has not confirmed; routes are planned once there are none."""
    chosen: Count | None
    """Number of the chosen route in ``routes``, from 1; null if none of them is chosen."""
    stations: tuple[StationOnRoute, ...] = ()
    """Lymph node stations of the chosen route, or of the best one if none is chosen, from the trachea outwards."""


class PlannedTargetRow(FrozenValue, frozen=True):
    """Row of the comparison of targets by the first route of each; a row of ``--compare --json`` has the same keys."""

    target_id: Identifier
    name: Words
    outlook: Words
    """Outlook of the first route (``RouteOffer.outlook``), or *no route*."""
    route: Words | None
    """Key of the first route (``RouteOffer.key``); null without a route, and then also the figures."""
    hit_share: Part | None
    narrowest_mm: float | None
    narrowest_error_mm: float | None
    from_carina_mm: float | None
    to_target_mm: float | None
    vessel_mm: float | None
    doubts: tuple[Words, ...]
    """Doubts about target and route; without a route also the reason."""


class UnplannedTarget(FrozenValue, frozen=True):
    """A target that cannot be compared, because it has no plan."""

    target_id: Identifier
    why: Words
    """Reason why the target has no plan, as text."""


class TargetComparison(FrozenValue, frozen=True):
    """The planned targets of the case in one order, the best first."""

    order: Words
    """Rule of the order, as text."""
    targets: tuple[PlannedTargetRow, ...]
    unplanned: tuple[UnplannedTarget, ...]


class TurnOpening(FrozenValue, frozen=True):
    """An opening at a turn of the chosen route."""

    branch_id: BranchId
    middle_lps: PointLps | None
    """Point in the direction of the middle of the opening's outline from the camera of the turn, LPS mm."""
    in_view: bool
    """Whether the opening is visible from the camera of the turn."""
    straight_ahead: bool
    """Whether the opening is in the middle of the picture of the turn and so has no clock hour."""
    ahead_deg: float = 6.0
    """Largest angle in degrees of the opening to a line of sight at which the opening counts as straight ahead."""


class PlannedTurn(FrozenValue, frozen=True):
    """A turn at a fork of the chosen route."""

    head: Words
    """Instruction of one line for an operator at the patient's head."""
    facing: Words
    """Instruction of one line for an operator who faces the patient."""
    from_carina_mm: float | None
    """Distance in mm of the turn from the main carina; null if the route does not pass the main carina."""
    from_fork_mm: float
    """Distance in mm of the turn from the previous one, or from the start of the airway tree."""
    depth_estimate_mm: float | None
    """Insertion depth in mm at nose or mouth, an estimate; null if the depth of the main carina is not known."""
    doubts: tuple[Words, ...]
    """Reason why no clock hour is given, and warnings about the branch that the scope enters."""
    fork_branch_id: BranchId
    """Branch that ends in the fork."""
    seen_from_lps: PointLps | None
    """Camera position about one diameter before the fork, looking at it, LPS mm (``see_turn``); null if not known."""
    openings: tuple[TurnOpening, ...] = ()
    """Openings of the fork; the first one is the opening that the scope enters."""
    hour_doubt: Words | None = None
    """Reason why no clock hour is given for the opening that the scope enters; null if the hour is reliable."""
    dots_lps: PointsLps = ()
    """Dots of the route inside the opening that the scope enters, LPS mm: its middle, and centreline points beyond."""


class MappedLayer(FrozenValue, frozen=True):
    """A layer of the lung map; images show it as outlines (``PictureLayer``)."""

    layer: LayerName
    words: Words
    """Text with the figures of the layer, such as its volume."""
    limits: tuple[Words, ...]
    """Texts on what the layer does not show, and on its reliability."""
    parts: tuple[Identifier, ...]
    """Names of the lobes (``PictureLayer.part``), each drawn in its own colour; empty for other layers."""


class VesselLine(FrozenValue, frozen=True):
    """A branch of a vessel, for the view from outside."""

    points_lps: PointsLps
    """Centreline of the vessel from its wide end."""
    diameter_mm: float
    sure: bool
    """Whether the vessel is clearly brighter than the noise of the CT."""


class Station(FrozenValue, frozen=True):
    """Place to search for a lymph node station with EBUS, derived from the airways alone."""

    station: Words
    words: Words
    point_lps: PointLps | None
    """Point on the centreline; null if the tree lacks the airways that define the station."""
    direction_lps: PointLps | None
    """Unit vector across the airway, towards the wall behind which the station lies."""
    borders: Words
    """Text that describes the borders of the station."""
    doubts: tuple[Words, ...]


class Lungs(ServerMessage, frozen=True):
    """The lung map: vessels, fissures, lobes, reach and lymph node stations; sent after each change."""

    standing: Making
    """State of the map of vessels, fissures, lobes and stations.

    *unwanted*: not requested. *making*: in progress. *had*: complete.
    """
    reach_standing: Making
    """State of the map of the scope's reach, with the same values."""
    layers: tuple[MappedLayer, ...]
    vessels: tuple[VesselLine, ...]
    """Centrelines of the vessels, without short branches that have no children."""
    stations: tuple[Station, ...]
    station_limits: Words
    problems: tuple[Words, ...]
    """Reasons why parts of the map are missing."""
    outdated: bool
    """Whether the airways have changed since the last map, which is then hidden until the user requests a new one."""


class Plans(ServerMessage, frozen=True):
    """The plans of all lesions; sent after each change."""

    targets: tuple[TargetPlan, ...]
    standing: Making
    """State of the planning: *unwanted* (not requested), *making* (in progress), *had* (complete), or its failure."""
    verdicts: tuple[ScopeVerdict, ...]
    """Verdicts on instruments for the chosen route, as far as they are computed."""
    verdicts_standing: Making
    tools: tuple[tuple[Identifier, Words], ...]
    """Names and titles of the tools in the library."""
    turns: tuple[PlannedTurn, ...] = ()
    """Turns of the chosen route, in order."""
    parking: tuple[Words, Words] | None = None
    """Instruction where to stop, for an operator at the patient's head and for an operator who faces the patient."""
    park_from_carina_mm: float | None = None
    """Distance in mm of the place where to stop from the main carina; null as for a turn."""
    park_depth_estimate_mm: float | None = None
    """Insertion depth in mm at nose or mouth where to stop, an estimate; null as for a turn."""
    dicom_problem: Words | None = None
    """Reason why the plan cannot be exported as DICOM; null if it can."""
    pairs: tuple[RoutePair, ...] = ()
    """Verdicts on all pairs of an instrument and one of the best routes to the chosen target, the best pair first."""
    pairs_standing: Making = "unwanted"
    """Whether the verdicts in `pairs` are complete, are being computed, or are missing, and why."""
    available: tuple[Identifier, ...] | None = None
    """Names of the scopes that are available here; null: all of the library."""
    carm: CArmPositions | None = None
    """Positions of a C-arm for the chosen route; null while they are not known."""
    carm_standing: Making = "unwanted"
    """Whether the positions in `carm` are complete, are being computed, or are missing, and why."""
    comparison: TargetComparison | None = None
    """Comparison of the targets; null in a case with fewer than two targets."""
    station_note: Words = ""
    """Text on the limits of the stations, and the source of their borders."""
