"""What the server sends about targets with a size, the routes to them, and what instruments can do there."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.case.routes import NeedleLine
from carina.commands.fields import BranchId, Count, Identifier, Part, PointLps, PointsLps, Words
from carina.commands.plan import PlanOptions
from carina.server.wire.codec import ServerMessage
from carina.session.scene.layer_lines import LayerName
from carina.value import FrozenValue

Making = Literal["unwanted", "making", "had", "failed", "stopped"]


class TargetSurface(FrozenValue, frozen=True):
    """The boundary of a target, for drawing."""

    vertices_lps: PointsLps
    triangles: Annotated[tuple[Count, ...], Meta(max_length=1_000_000)]
    """Three places in the vertices each, counterclockwise seen from outside."""


class NeedleTissue(FrozenValue, frozen=True):
    """A stretch of one tissue on a needle's way, from the scope's tip."""

    tissue: Words
    ends_mm: tuple[float, float]


class RouteOffer(FrozenValue, frozen=True):
    """A planned route."""

    branch_id: BranchId
    branch_name: Words
    from_carina_mm: float | None
    narrowest_mm: float
    """The narrowest diameter of the way."""
    narrowest_error_mm: float
    """Half of an interval meant to hold the truth in 90 of 100 cases."""
    narrowest_by: Literal["sections", "ball"]
    """``ball`` where the diameter rests on a stretch that could not be measured."""
    narrowest_why: Words | None
    """Why a stretch could not be measured, and where."""
    fit: Literal["fits", "may fit", "does not fit"]
    """Whether the planned scope fits; *may fit* if the errors are in its favour."""
    outlook: Words
    """What diameter, bend and doubts say of the planned scope, before its drive is simulated."""
    limits: tuple[Words, ...]
    """What stands against it, or may."""
    needle: NeedleLine
    angle_deg: float
    in_target_mm: float
    vessel_mm: float | None
    """From the needle's line to the nearest vessel that is seen; null where none is seen nearby."""
    hit_share: Part
    """Of the needle positions that errors of pointing and measuring allow."""
    hit_share_moved: Part | None
    """The same where the target may have moved since the CT."""
    crossed: tuple[NeedleTissue, ...]
    score: Part
    doubts: tuple[Words, ...]
    """Branches on the way that were drawn, bridged, or are doubtful."""


class ScopeCheck(FrozenValue, frozen=True):
    """One thing that an instrument must be able to do."""

    name: Words
    answer: Literal["yes", "perhaps", "no", "unknown"]
    words: Words
    basis: Words


class ScopeVerdict(FrozenValue, frozen=True):
    """What one instrument can do on the route that is chosen."""

    scope: Identifier
    title: Words
    outcome: Words
    """reaches, may reach, does not reach, cannot say"""
    words: Words
    share: Part | None
    would: Words | None
    """What would have to be different."""
    checks: tuple[ScopeCheck, ...]
    was_driven: bool
    """There is a simulated drive, which the case can keep as a flight."""


class TargetPlan(FrozenValue, frozen=True):
    """A target with a size, and the routes to it."""

    target_id: Identifier
    centre_lps: PointLps
    size: Words
    """Solid nodule, 12.3 x 10.1 mm, 0.74 ml, with the errors that hold nine of ten."""
    where: Words | None
    long_mm: float
    num_aims: Count
    """How many places in it the needle is meant for."""
    surface: TargetSurface
    options: PlanOptions
    moved_mm: float | None
    """How far it may have moved; null until there is a plan."""
    bronchus_sign: Words | None
    routes: tuple[RouteOffer, ...]
    problem: Words | None
    """Why there is no route, and what would help."""
    notes: tuple[Words, ...]
    chosen: Count | None
    """Which route is flown, from 1."""


class PlannedTurn(FrozenValue, frozen=True):
    """A turn of the route that is chosen."""

    head: Words
    """One line, for an operator at the patient's head."""
    facing: Words
    """The same for one who faces the patient."""
    doubts: tuple[Words, ...]
    """Of the branch that is entered."""
    fork_branch_id: BranchId
    """The branch that ends in the fork."""
    seen_from_lps: PointLps | None
    """Where the tip is put for it (``see_turn``)."""


class MappedLayer(FrozenValue, frozen=True):
    """A layer that there is, as lines in the pictures (``PictureLayer``)."""

    layer: LayerName
    words: Words
    """What it shows, in figures."""
    limits: tuple[Words, ...]
    """What it does not show, and how sure it is."""
    parts: tuple[Identifier, ...]
    """Of lobes their names, as pictures have them (``PictureLayer.part``): each has a colour of its own."""


class VesselLine(FrozenValue, frozen=True):
    """A piece of a vessel, for pictures from outside."""

    points_lps: PointsLps
    """Its middle line, from the wide end."""
    diameter_mm: float
    sure: bool
    """False where it stands out no better than what may be noise."""


class Station(FrozenValue, frozen=True):
    """Where a lymph node station is looked for with EBUS, by the airways alone."""

    station: Words
    words: Words
    point_lps: PointLps | None
    """On the centreline; null where the tree does not show the airways that define it."""
    direction_lps: PointLps | None
    """Unit vector across the airway, to the wall behind which it lies."""
    borders: Words
    doubts: tuple[Words, ...]


class Lungs(ServerMessage, frozen=True):
    """What was mapped round the targets, when it changed."""

    standing: Making
    """Of vessels, fissures, lobes and stations."""
    reach_standing: Making
    layers: tuple[MappedLayer, ...]
    vessels: tuple[VesselLine, ...]
    """The vessels of the layer as lines; short pieces that nothing leaves are no part of them."""
    stations: tuple[Station, ...]
    station_limits: Words
    problems: tuple[Words, ...]
    """Why something is missing."""
    outdated: bool
    """Something was mapped, and the airways have changed since: it is not shown until a person asks again."""


class Plans(ServerMessage, frozen=True):
    """The plans, when they changed."""

    targets: tuple[TargetPlan, ...]
    standing: Making
    verdicts: tuple[ScopeVerdict, ...]
    """On the route that is chosen, as far as they are made."""
    verdicts_standing: Making
    tools: tuple[tuple[Identifier, Words], ...]
    """Names and titles of the library."""
    turns: tuple[PlannedTurn, ...] = ()
    """Of the route that is chosen, in order."""
    parking: tuple[Words, Words] | None = None
    """Where to stop, for an operator at the head and for one who faces the patient."""
    dicom_problem: Words | None = None
    """Why no DICOM file of the plan can be written; null where one can."""
