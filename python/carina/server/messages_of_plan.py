"""What the server sends about targets with a size, the routes to them, and what instruments can do there."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.case.routes import NeedleLine
from carina.commands.fields import BranchId, Count, Identifier, Part, PointLps, PointsLps, Words
from carina.commands.plan import PlanOptions
from carina.server.wire_codec import ServerMessage
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


class Plans(ServerMessage, frozen=True):
    """The plans, when they changed."""

    targets: tuple[TargetPlan, ...]
    standing: Making
    verdicts: tuple[ScopeVerdict, ...]
    """On the route that is chosen, as far as they are made."""
    verdicts_standing: Making
    tools: tuple[tuple[Identifier, Words], ...]
    """Names and titles of the library."""
