"""Kinds of fields that the messages share, with their bounds."""

from __future__ import annotations

from typing import Annotated, Literal

from carina.render import FlatViewName as FlatView
from carina.render import OrbitViewName as OrbitView
from carina.render import ViewName
from carina.server.wire_codec import Length, Range

__all__ = [
    "Angle",
    "BranchId",
    "Coordinate",
    "Count",
    "DemoName",
    "FlatView",
    "Key",
    "Mask",
    "Matrix4",
    "MaybeNumbers",
    "Method",
    "Mode",
    "Numbers",
    "Operator",
    "OrbitView",
    "Part",
    "PathText",
    "Pixels",
    "PointLps",
    "PointsLps",
    "SlabKind",
    "Tone",
    "ViewName",
    "Words",
]

Coordinate = Annotated[float, Range(-1e5, 1e5)]
PointLps = Annotated[tuple[Coordinate, ...], Length(3, 3)]
Numbers = Annotated[tuple[float, ...], Length(0, 2_000_000)]
MaybeNumbers = Annotated[tuple[float | None, ...], Length(0, 2_000_000)]
PointsLps = Annotated[tuple[PointLps, ...], Length(0, 1_000_000)]
Matrix4 = Annotated[tuple[float, ...], Length(16, 16)]
"""4x4, row-major."""
Key = Annotated[str, Length(1, 64)]
Words = Annotated[str, Length(0, 4000)]
PathText = Annotated[str, Length(1, 4096)]
Count = Annotated[int, Range(0, 2**53 - 1)]
Part = Annotated[float, Range(0.0, 1.0)]
BranchId = Annotated[int, Range(0, 2**31)]
Pixels = Annotated[int, Range(16, 4096)]
Angle = Annotated[float, Range(-3600.0, 3600.0)]
Tone = Literal["radiograph", "fluoroscopy"]
SlabKind = Literal["max", "min", "mean"]
Mask = Literal["none", "round", "octagon"]
Mode = Literal["free", "path", "scope"]
Operator = Literal["head", "facing"]
Method = Literal["leap", "brute"]
DemoName = Literal["phantom", "patient"]
