"""Commands on targets with a size, and on the plans of routes to them."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import BranchId, Identifier, OwnName, PathText, PointLps
from carina.commands.tree import MAX_BRUSH_MM
from carina.commands.value import Command, FrozenValue, LocalCommand
from carina.value import TEXT

TargetNote = Annotated[str, Meta(max_length=2000, pattern=TEXT)]

RouteKey = Annotated[str, Meta(min_length=1, max_length=64, pattern=TEXT)]
"""Key of a planned route, such as *17-204.5*."""

TargetRank = Annotated[int, Meta(ge=1, le=9)]


class Instruments(FrozenValue, frozen=True):
    """Scope, and the tool in its working channel."""

    scope: Identifier = "thin"
    """Name of the scope in the library of instruments."""
    tool: Identifier = "needle-21g"


class ChosenPlace(FrozenValue, frozen=True):
    """Place of the scope's tip and the aim, which the user has chosen with a pair of route and instrument."""

    branch_id: BranchId
    along_mm: Annotated[float, Meta(ge=0.0, le=5000.0)]
    """Distance of the tip from the start of the airway tree, mm."""
    aim: Annotated[int, Meta(ge=0, le=100)] = 0
    """Index of the aim, from 0."""


class MeasuredMovement(FrozenValue, frozen=True):
    """Movement of a target that was measured from a second CT."""

    shift_lps: PointLps
    """Shift from this CT to the second CT relative to the main carina, LPS mm."""
    error_mm: Annotated[float, Meta(ge=0.0, le=60.0)]
    """Radius in mm round the measured shift that contains the true shift in 90 % of cases."""
    notes: Annotated[tuple[TargetNote, ...], Meta(max_length=8)] = ()
    """Warnings about the measurement."""


class PlanOptions(Instruments, frozen=True):
    """Instruments that shall reach a target, and conditions that reduce the score of a route."""

    vessel_margin_mm: Annotated[float, Meta(ge=0.0, le=50.0)] = 3.0
    """Distance between needle and vessel below which the vessel counts against a route."""
    moved_mm: Annotated[float, Meta(ge=0.0, le=60.0)] | None = None
    """Possible displacement of the target since the CT; null uses the default of the target's lobe."""
    movement: MeasuredMovement | None = None
    """Movement of the target measured from a second CT (`measure_movement`), instead of `moved_mm`."""
    entry_mm: Annotated[float, Meta(ge=0.0, le=500.0)] | None = None
    """Distance from nose or mouth to the start of the tree, in cases of earlier versions (`carina_depth_mm`)."""
    carina_depth_mm: Annotated[float, Meta(ge=0.0, le=600.0)] | None = None
    """Insertion depth at nose or mouth when the tip is at the main carina.

    Null leaves depths and working lengths unknown, unless a case of an earlier version states `entry_mm`.
    """
    place: ChosenPlace | None = None
    """Place to which a route is planned in any case; null plans only to the best places (``choose_pair``)."""


class SetPlanOptions(PlanOptions, Command, frozen=True, kw_only=True):
    """Plan the routes to a target again with other options; another scope is that of the whole case (``SetScope``)."""

    target_id: Identifier


class MeasureMovement(Command, frozen=True):
    """Measure the movement of a target from a second CT of the patient, a file, folder or case of this machine."""

    target_id: Identifier
    path: PathText


class MeasureMovementFromFiles(LocalCommand, frozen=True):
    """Measure the movement of a target from a second CT in a temporary folder, such as uploaded files."""

    target_id: Identifier
    folder: PathText


class MeasureMovementFromCase(Command, frozen=True):
    """Measure the movement of a target from the CT of a case of ``start.recent``, by its ID."""

    target_id: Identifier
    recent_id: Identifier


class DescribeTarget(Command, frozen=True):
    """Set name, description and rank of a target."""

    target_id: Identifier
    called: OwnName
    remark: TargetNote = ""
    rank: TargetRank = 1
    """Rank of the target; targets are listed by rank, 1 first."""


class ChoosePlannedRoute(Command, frozen=True):
    """Choose one of the routes planned to a target; the flight then leads to the scope's standing point."""

    target_id: Identifier
    number: Annotated[int, Meta(ge=1, le=100)] = 1
    """Number of the route in the list of the plan; 1 is the best route."""


class ChoosePair(Instruments, Command, frozen=True, kw_only=True):
    """Choose a route together with the scope and the tool that reach its end: a pair of ``plans.pairs``."""

    target_id: Identifier
    route: RouteKey
    """Key of the route in the present plan."""


class SetAvailableScopes(Command, frozen=True):
    """Store which scopes of the library are available here; pairs of other scopes are listed separately."""

    scopes: Annotated[tuple[Identifier, ...], Meta(min_length=1, max_length=200)] | None
    """Names of the scopes that are available here; null: all scopes of the library."""


class SeeTurn(Command, frozen=True):
    """Put the tip at the viewpoint of a turn of the chosen route, as in the list of turns with clock positions."""

    number: Annotated[int, Meta(ge=1, le=100)]
    """Number of the turn in the list, from 1."""


class KeepDrive(Command, frozen=True):
    """Store the simulated drive of an instrument on the chosen route as a flight of the case."""

    scope: Identifier
    """Name of the instrument whose drive is stored."""


class GrowTarget(Command, frozen=True):
    """Convert a target beside an airway into a nodule that is segmented from its point."""

    target_id: Identifier


class ConfirmTarget(Command, frozen=True):
    """Confirm that a target is what the user intends, despite doubts; its routes are planned only then."""

    target_id: Identifier
    doubts: Annotated[tuple[Annotated[str, Meta(max_length=64, pattern=TEXT)], ...], Meta(min_length=1, max_length=16)]
    """Codes of the doubts that are confirmed, such as ``target.tube``."""


class ResizeTarget(Command, frozen=True):
    """Move a target's boundary outward or inward, to a long axial diameter."""

    target_id: Identifier
    diameter_mm: Annotated[float, Meta(ge=1.0, le=150.0)]


class BrushTarget(Command, frozen=True):
    """Add to a target, or remove from it, by a stroke of a ball-shaped brush."""

    target_id: Identifier
    stroke_lps: Annotated[tuple[PointLps, ...], Meta(min_length=1, max_length=2000)]
    brush_mm: Annotated[float, Meta(ge=0.5, le=MAX_BRUSH_MM)]
    """Radius of the brush, mm."""
    takes_away: bool = False


class AimTarget(Command, frozen=True):
    """Set the aim of the needle: the centre of a target, or its centre and its periphery."""

    target_id: Identifier
    periphery: bool


class MarkSphere(Command, frozen=True):
    """Mark a ball as a target, where the CT shows no boundary."""

    lps: PointLps
    diameter_mm: Annotated[float, Meta(ge=1.0, le=150.0)]


class TakeTarget(LocalCommand, frozen=True):
    """Add a target from a file: a mask, a DICOM SEG or an RTSTRUCT."""

    path: str
    structure: str | None = None
    """Name or number of the structure that is the target, if the file has several."""


class MapLungs(Command, frozen=True):
    """Map the anatomy around the targets: vessels, fissures and lobes of both lungs, and the stations for EBUS."""


class MapReach(Instruments, Command, frozen=True):
    """Map the parts of the lungs that an instrument's tip and tool can reach."""
