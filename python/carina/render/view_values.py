"""Display settings of a case, shared by the window, calls of the renderer and the wire.

These settings describe how the user looks at the case. They do not change the case, so undo does not cover them.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from carina.argument_checks import any_number, check_fields, text_of
from carina.errors import RenderError
from carina.value import FrozenValue, PointLps

Angle = Annotated[float, Meta(ge=-3600.0, le=3600.0)]
MmPerPixel = Annotated[float, Meta(ge=0.01, le=20.0)]
Tone = Literal["radiograph", "fluoroscopy"]
SlabKind = Literal["max", "min", "mean"]
Method = Literal["leap", "brute"]


class GreyWindow(FrozenValue, frozen=True):
    """Window and level of all slice views, in HU, or in stored values if the volume is not in HU."""

    width_hu: Annotated[float, Meta(ge=1.0, le=65_536.0)]
    level_hu: Annotated[float, Meta(ge=-32_768.0, le=32_768.0)]


class Slab(FrozenValue, frozen=True):
    """Thick slice that shows the largest, smallest or mean value over its thickness.

    ``min`` shows airways; 0 mm is a thin slice.
    """

    thickness_mm: Annotated[float, Meta(ge=0.0, le=100.0)]
    kind: SlabKind

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Slab` has an invalid value."""
        check_fields(self, RenderError, "render.setting", thickness_mm=any_number(), kind=text_of())
        if not 0.0 <= self.thickness_mm <= 100.0:
            raise RenderError(
                f"slab thickness must be from 0 to 100 mm; found {self.thickness_mm}", code="render.setting"
            )
        if self.kind not in {"max", "min", "mean"}:
            raise RenderError(f"a slab must show max, min or mean; found {self.kind!r}", code="render.setting")


class Orbit(FrozenValue, frozen=True):
    """Camera of an external view: azimuth 0 looks from anterior; null as distance fits the view to its content."""

    azimuth_deg: Angle
    elevation_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    distance_mm: Annotated[float, Meta(ge=1.0, le=5000.0)] | None = None


class FlatPlace(FrozenValue, frozen=True):
    """Zoom and centre of a planar view: scale of a slice, or width of the cut-plane; null shows the whole area."""

    mm_per_px: MmPerPixel | None = None
    extent_mm: Annotated[float, Meta(ge=2.0, le=1000.0)] | None = None
    centre_lps: PointLps | None = None
    """Centre of a zoomed picture until the tip moves; null is the displayed point, or the tip in the cut-plane."""


class Carm(FrozenValue, frozen=True):
    """Angles of the radiograph's C-arm (LAO and cranial above 0), tone, and scale at the centre; null fits."""

    primary_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    secondary_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    mm_per_px: MmPerPixel | None
    tone: Tone


class Reformation(FrozenValue, frozen=True):
    """Angle of the cutting plane and scale of the views along the route; null as scale fits the whole route."""

    turn_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    mm_per_px: MmPerPixel | None


FITS = FlatPlace()
THIN = Slab(0.0, "min")


class Sight(FrozenValue, frozen=True):
    """Display settings of a case (window, slab, crosshair, zoom, orbits), which undo does not change."""

    crosshair_lps: PointLps | None = None
    """Point that slices and the tri-plane view show; null follows the tip."""
    window: GreyWindow | None = None
    """Grey window of all views: width and level; null selects each view's default."""
    slab: Slab = THIN
    """Slab thickness of slices and of views along the route."""
    zoom: dict[str, FlatPlace] = msgspec.field(default_factory=dict)
    """Zoom and centre by view name; a view without an entry shows its whole area."""
    orbits: dict[str, Orbit] = msgspec.field(default_factory=dict)
    """Orbit camera by view name; a view whose name is missing uses its initial camera."""
    carm: Carm = Carm(0.0, 0.0, None, "radiograph")
    reformation: Reformation = Reformation(0.0, None)
    shading: bool = True
    """Whether the headlight at the tip shades the airway view."""
    texture: bool = True
    """Whether mottling and micro relief, which do not come from the CT, are drawn on the mucosa."""
    method: Method = "leap"
    """Casting method of the airway view: leaping, or the brute-force reference; the pictures are the same."""

    def place(self, view: str) -> FlatPlace:
        """Return the zoom and the centre of a planar view; without an entry, those of the whole area."""
        return self.zoom.get(view, FITS)

    def centred(self, views: Collection[str]) -> Sight:
        """Return a copy in which the named planar views are centred on the displayed point, with unchanged scales.

        Returns
        -------
        Sight
            ``self`` if no view is panned.
        """
        panned = [view for view in views if self.place(view).centre_lps is not None]
        if not panned:
            return self
        places = {view: msgspec.structs.replace(self.zoom[view], centre_lps=None) for view in panned}
        return msgspec.structs.replace(self, zoom={**self.zoom, **places})
