"""Types of fields that commands and messages share, with their bounds."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.render import FlatViewName as FlatView
from carina.render import OrbitViewName as OrbitView
from carina.render import ViewName
from carina.scopes import Outline
from carina.value import TEXT, Coordinate, Count, FrozenValue, Part, PointLps, Words

__all__ = [
    "AirwayPlace",
    "BranchId",
    "Clutch",
    "Control",
    "Coordinate",
    "Count",
    "DemoName",
    "DeviceName",
    "FlatView",
    "FlightNumber",
    "Identifier",
    "Matrix4",
    "MaybeNumbers",
    "Mode",
    "Numbers",
    "Operator",
    "OrbitView",
    "Outline",
    "OwnName",
    "Part",
    "PathMm",
    "PathText",
    "Pixels",
    "PointLps",
    "PointsLps",
    "ProcessorName",
    "Three",
    "Through",
    "ViewName",
    "Wide",
    "Words",
]

Numbers = Annotated[tuple[float, ...], Meta(max_length=2_000_000)]
MaybeNumbers = Annotated[tuple[float | None, ...], Meta(max_length=2_000_000)]
PointsLps = Annotated[tuple[PointLps, ...], Meta(max_length=1_000_000)]
Matrix4 = Annotated[tuple[Coordinate, ...], Meta(min_length=16, max_length=16)]
"""4x4 matrix as 16 numbers, row by row."""
Identifier = Annotated[str, Meta(min_length=1, max_length=64, pattern=TEXT)]
OwnName = Annotated[str, Meta(min_length=1, max_length=80, pattern=TEXT)]
"""Name that the user gives, such as that of a target or a flight."""
PathText = Annotated[str, Meta(min_length=1, max_length=4096, pattern=TEXT)]
DeviceName = Annotated[str, Meta(min_length=1, max_length=200, pattern=TEXT)]
BranchId = Annotated[int, Meta(ge=0, le=2**31)]
FlightNumber = Annotated[int, Meta(ge=1, le=2**31)]
"""Number of a recorded flight, from 1 in each case; deleted numbers are not used again."""
Pixels = Annotated[int, Meta(ge=16, le=4096)]
PathMm = Annotated[float, Meta(ge=0.0, le=1e5)]
"""Position along a path or a branch, in mm from its start."""
# Wide bounds: an out-of-range value of a device is ignored and counted, and does not close the connection.
Wide = Annotated[float, Meta(ge=-1e300, le=1e300)]
Three = tuple[Wide, Wide, Wide]
Mode = Literal["free", "path", "scope"]
Operator = Literal["head", "facing"]
Control = Literal["absolute", "relative", "path"]
Clutch = Literal["always", "hold"]
Through = Literal["airways", "space"]
DemoName = Literal["phantom", "patient"]
ProcessorName = Literal["auto", "cpu", "gpu"]


class AirwayPlace(FrozenValue, frozen=True):
    """Point of the airways, with its branch."""

    lps: PointLps
    """Point, LPS mm."""
    branch_id: BranchId | None
    """ID of the branch that contains the point, or None."""
