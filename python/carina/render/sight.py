"""How a case is looked at: the values that the window's views, a call's and the wire share.

None of it is what a person made of the case, so none of it is a step of undo.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from carina.argument_checks import any_number, check_fields, text_of
from carina.errors import RenderError
from carina.value import FrozenValue, PointLps

__all__ = [
    "THIN",
    "Angle",
    "Carm",
    "FlatPlace",
    "GreyWindow",
    "Method",
    "MmPerPixel",
    "Orbit",
    "Reformation",
    "Sight",
    "Slab",
    "SlabKind",
    "Tone",
]

Angle = Annotated[float, Meta(ge=-3600.0, le=3600.0)]
MmPerPixel = Annotated[float, Meta(ge=0.01, le=20.0)]
Tone = Literal["radiograph", "fluoroscopy"]
SlabKind = Literal["max", "min", "mean"]
Method = Literal["leap", "brute"]


class GreyWindow(FrozenValue, frozen=True):
    """Grey window of all slice views; numbers of the file where the volume is not HU."""

    width_hu: Annotated[float, Meta(ge=1.0, le=65_536.0)]
    level_hu: Annotated[float, Meta(ge=-32_768.0, le=32_768.0)]


class Slab(FrozenValue, frozen=True):
    """A thick slice: the largest, smallest or mean value over its thickness; ``min`` shows airways, 0 mm are thin."""

    thickness_mm: Annotated[float, Meta(ge=0.0, le=100.0)]
    kind: SlabKind

    def __post_init__(self) -> None:
        check_fields(self, RenderError, "render.setting", thickness_mm=any_number(), kind=text_of())
        if not 0.0 <= self.thickness_mm <= 100.0:
            raise RenderError(
                f"slab thickness must be from 0 to 100 mm; found {self.thickness_mm}", code="render.setting"
            )
        if self.kind not in {"max", "min", "mean"}:
            raise RenderError(f"a slab must show max, min or mean; found {self.kind!r}", code="render.setting")


class Orbit(FrozenValue, frozen=True):
    """Camera of an outside view: azimuth 0 is from anterior, distance null fits."""

    azimuth_deg: Angle
    elevation_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    distance_mm: Annotated[float, Meta(ge=1.0, le=5000.0)] | None = None


class FlatPlace(FrozenValue, frozen=True):
    """Where a planar view was zoomed or panned to: scale of a slice, or width of the cut-plane; null fits."""

    mm_per_px: MmPerPixel | None = None
    extent_mm: Annotated[float, Meta(ge=2.0, le=1000.0)] | None = None
    centre_lps: PointLps | None = None
    """Middle of a zoomed picture until the tip moves; null is the point that is shown, and in the cut-plane the tip."""


class Carm(FrozenValue, frozen=True):
    """Where the radiograph's C-arm stands: LAO and cranial above 0; mm_per_px counts at its centre, null fits."""

    primary_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    secondary_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    mm_per_px: MmPerPixel | None
    tone: Tone


class Reformation(FrozenValue, frozen=True):
    """Turn and scale of the views along the route: null fits the route, else the tip is in the middle."""

    turn_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    mm_per_px: MmPerPixel | None


FITS = FlatPlace()
THIN = Slab(0.0, "min")


class Sight(FrozenValue, frozen=True):
    """How a case is looked at, which is no step of undo."""

    crosshair_lps: PointLps | None = None
    """The point that slices and tri-plane show; null follows the tip."""
    window: GreyWindow | None = None
    """Null is each view's own."""
    slab: Slab = THIN
    """Thickness of slices and views along the route."""
    zoom: dict[str, FlatPlace] = msgspec.field(default_factory=dict)
    """By view; those that are not here fit."""
    orbits: dict[str, Orbit] = msgspec.field(default_factory=dict)
    """By view; those that are not here stand where they begin."""
    carm: Carm = Carm(0.0, 0.0, None, "radiograph")
    reformation: Reformation = Reformation(0.0, None)
    shading: bool = True
    """Light at the tip."""
    texture: bool = True
    """Mottling and micro relief laid on the mucosa, which are not the patient's."""
    method: Method = "leap"
    """Leaping, or the brute-force reference; the picture is the same."""

    def place(self, view: str) -> FlatPlace:
        """Where a planar view was zoomed or panned to."""
        return self.zoom.get(view, FITS)

    def centred(self, views: Collection[str]) -> Sight:
        """Return a sight with these views centred on the shown point again, at their scales; itself if they are."""
        panned = [view for view in views if self.place(view).centre_lps is not None]
        if not panned:
            return self
        places = {view: msgspec.structs.replace(self.zoom[view], centre_lps=None) for view in panned}
        return msgspec.structs.replace(self, zoom={**self.zoom, **places})
