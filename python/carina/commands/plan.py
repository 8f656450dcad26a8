"""Commands on targets with a size, and on the plans of routes to them."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import Identifier, OwnName, PointLps
from carina.commands.tree import MAX_BRUSH_MM
from carina.commands.value import Command, FrozenValue, LocalCommand
from carina.value import TEXT

TargetNote = Annotated[str, Meta(max_length=2000, pattern=TEXT)]

TargetRank = Annotated[int, Meta(ge=1, le=9)]


class Instruments(FrozenValue, frozen=True):
    """Scope, and the tool in its working channel."""

    scope: Identifier = "thin"
    """Name in the library of instruments."""
    tool: Identifier = "needle-21g"


class PlanOptions(Instruments, frozen=True):
    """With what a target is to be reached, and what counts against a route."""

    vessel_margin_mm: Annotated[float, Meta(ge=0.0, le=50.0)] = 3.0
    """Distance between needle and vessel below which the vessel counts against a route."""
    moved_mm: Annotated[float, Meta(ge=0.0, le=60.0)] | None = None
    """Possible displacement of the target since the CT; null uses the default of the target's lobe."""
    entry_mm: Annotated[float, Meta(ge=0.0, le=500.0)] | None = None
    """Distance from nose or mouth to the start of the tree; null leaves depths and working lengths unknown."""


class SetPlanOptions(PlanOptions, Command, frozen=True, kw_only=True):
    """Plan the way to a target anew."""

    target_id: Identifier


class DescribeTarget(Command, frozen=True):
    """Name a target, and say something about it."""

    target_id: Identifier
    called: OwnName
    remark: TargetNote = ""
    rank: TargetRank = 1
    """Rank; 1 is the first."""


class ChoosePlannedRoute(Command, frozen=True):
    """Take one of the routes that were planned to a target: the flight leads to where the scope stands there."""

    target_id: Identifier
    number: Annotated[int, Meta(ge=1, le=100)] = 1
    """Number of the route; 1 is the best."""


class SeeTurn(Command, frozen=True):
    """Put the tip where a turn of the chosen route is seen from, as the list of turns tells its hour."""

    number: Annotated[int, Meta(ge=1, le=100)]
    """Number of the turn in the list, from 1."""


class KeepDrive(Command, frozen=True):
    """Keep the simulated drive of an instrument, on the route that is taken, as a flight of the case."""

    scope: Identifier
    """Name of the instrument whose drive is stored."""


class GrowTarget(Command, frozen=True):
    """What was clicked beside an airway is a nodule, not a place in the airway."""

    target_id: Identifier


class ResizeTarget(Command, frozen=True):
    """Move a target's boundary outward or inward, to a long axial diameter."""

    target_id: Identifier
    diameter_mm: Annotated[float, Meta(ge=1.0, le=150.0)]


class BrushTarget(Command, frozen=True):
    """A stroke of a ball-shaped brush that adds to a target, or takes from it."""

    target_id: Identifier
    stroke_lps: Annotated[tuple[PointLps, ...], Meta(min_length=1, max_length=2000)]
    brush_mm: Annotated[float, Meta(ge=0.5, le=MAX_BRUSH_MM)]
    """Radius of the brush."""
    takes_away: bool = False


class AimTarget(Command, frozen=True):
    """What the needle is meant for: the middle of a target, or its middle and its periphery."""

    target_id: Identifier
    periphery: bool


class MarkSphere(Command, frozen=True):
    """A ball as a target, where the CT shows no boundary."""

    lps: PointLps
    diameter_mm: Annotated[float, Meta(ge=1.0, le=150.0)]


class TakeTarget(LocalCommand, frozen=True):
    """Add a target from a file: a mask, a DICOM SEG or an RTSTRUCT."""

    path: str
    structure: str | None = None
    """Name or number of the structure, if the file has several."""


class MapLungs(Command, frozen=True):
    """Look for what lies round the targets: vessels, fissures and lobes of both lungs, and the stations for EBUS."""


class MapReach(Instruments, Command, frozen=True):
    """Map where in the lungs an instrument's tip and tool get to."""
