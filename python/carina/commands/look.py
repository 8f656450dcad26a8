"""How the case is shown."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from carina.commands.fields import (
    Angle,
    FlatView,
    Key,
    Mask,
    Method,
    MmPerPixel,
    OrbitView,
    PointLps,
    SlabKind,
    Tone,
)
from carina.commands.value import Command


class SetCrosshair(Command, frozen=True):
    """The point that slices and tri-plane show; null follows the tip."""

    lps: PointLps | None


class SetWindow(Command, frozen=True):
    """Grey window of all slice views; numbers of the file where the volume is not HU."""

    undo_label = "grey window"
    width_hu: Annotated[float, Meta(ge=1.0, le=65_536.0)]
    level_hu: Annotated[float, Meta(ge=-32_768.0, le=32_768.0)]


class SetFov(Command, frozen=True):
    """Full angle of the airway view over the shorter side."""

    undo_label = "field of view"
    fov_deg: Annotated[float, Meta(ge=60.0, le=170.0)]


class SetScope(Command, frozen=True):
    """Look through an instrument of the library, with its field of view and outline; null is a pinhole."""

    scope: Key | None


class SetMask(Command, frozen=True):
    """Outline of the airway picture."""

    undo_label = "outline of the picture"
    mask: Mask


class SetTransfer(Command, frozen=True):
    """A preset by name, or a ``carina-transfer`` document; exactly one."""

    undo_label = "transfer function"
    preset: Key | None = None
    document: dict[str, Any] | None = None

    def choice_problem(self) -> str | None:
        """Exactly one."""
        if (self.preset is None) == (self.document is None):
            return "set_transfer needs either a preset or a document"
        return None


class SetShading(Command, frozen=True):
    """Light at the tip on or off."""

    undo_label = "shading"
    on: bool


class SetTexture(Command, frozen=True):
    """Fine texture of the mucosa, which is decoration and not the patient's, on or off."""

    undo_label = "fine texture"
    on: bool


class SetMethod(Command, frozen=True):
    """Leaping, or the brute-force reference; the picture is the same."""

    undo_label = "ray casting method"
    method: Method


class SetOrbit(Command, frozen=True):
    """Where an outside view is seen from; distance null fits."""

    view: OrbitView
    azimuth_deg: Angle
    elevation_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    distance_mm: Annotated[float, Meta(ge=1.0, le=5000.0)] | None


class SetZoom(Command, frozen=True):
    """Scale of a slice (mm_per_px) or width of the cut-plane (extent_mm); null fits."""

    view: FlatView
    mm_per_px: MmPerPixel | None = None
    extent_mm: Annotated[float, Meta(ge=2.0, le=1000.0)] | None = None
    center_lps: PointLps | None = None
    """Middle of a zoomed picture until the tip moves; null is the point that is shown, and in the cut-plane the tip."""


class SetCarm(Command, frozen=True):
    """Where the radiograph's C-arm stands: LAO and cranial above 0; mm_per_px counts at its centre, null fits."""

    primary_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    secondary_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    mm_per_px: MmPerPixel | None
    tone: Tone


class SetReformation(Command, frozen=True):
    """Turn of the cutting plane of the views along the route, and their scale; null fits the route."""

    turn_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    mm_per_px: MmPerPixel | None


class SetSlab(Command, frozen=True):
    """Thickness of slices and views along the route, and what they show of it; 0 mm are thin slices."""

    thickness_mm: Annotated[float, Meta(ge=0.0, le=100.0)]
    kind: SlabKind
