"""Commands that change the display of the case.

A command that only sets a field of the look (undoable) or of the sight (:class:`carina.render.Sight`, not undoable)
names this field in ``sets`` and needs no other code: the session sets the field, and the window shows the new value
until the server has responded.
"""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from carina.commands.fields import FlatView, Identifier, Operator, OrbitView, Outline
from carina.commands.value import Command
from carina.render.view_values import Carm, FlatPlace, GreyWindow, Method, Orbit, Reformation, Slab
from carina.scopes import DEFAULT_SCOPE, scope_preset
from carina.value import FrozenValue, PointLps


class Look(FrozenValue, frozen=True):
    """Settings of the airway view that the user chose and that undo restores: instrument, outline and field of view."""

    scope: Identifier | None = DEFAULT_SCOPE
    """Name of the instrument whose lens the airway view has; null is a pinhole camera."""
    outline: Outline = "round"
    """Outline of the airway picture: round, octagonal or the full frame."""
    fov_deg: float = scope_preset(DEFAULT_SCOPE).usual_fov_deg
    """Field of view; the scope's, unless the user chose another."""
    operator: Operator = "head"


# ------------------------------------------------------------------ with a step of undo


class SetFov(Command, frozen=True):
    """Set the field of view of the airway view: the full angle across the shorter side of its picture."""

    sets = "fov_deg"
    undo_label = "field of view"
    fov_deg: Annotated[float, Meta(ge=60.0, le=170.0)]


class SetOutline(Command, frozen=True):
    """Set the outline of the airway picture: round, octagonal or the full frame."""

    sets = "outline"
    undo_label = "image outline"
    outline: Outline


class SetScope(Command, frozen=True):
    """Use an instrument of the library for the airway view, with its field of view and outline, and for all plans.

    Null is a pinhole camera; the plans then keep their instrument.
    """

    scope: Identifier | None


class SetTransfer(Command, frozen=True):
    """Set the transfer function: exactly one of a preset's name and a ``carina-transfer`` document."""

    undo_label = "transfer function"
    preset: Identifier | None = None
    document: dict[str, Any] | None = None

    def choice_problem(self) -> str | None:
        """Return an error text unless exactly one of the two fields is set."""
        if (self.preset is None) == (self.document is None):
            return "set_transfer: expected exactly one of preset and document"
        return None


# ------------------------------------------------------------------ without a step of undo


class SetCrosshair(Command, frozen=True):
    """Set the point that slices and the tri-plane view show; null follows the tip."""

    sets = "crosshair_lps"
    lps: PointLps | None


class SetWindow(GreyWindow, Command, frozen=True):
    """Set the grey window of all slice views; raw values where the volume is not in HU."""

    sets = "window"


class SetSlab(Slab, Command, frozen=True):
    """Set thickness and kind of the slab of slices and views along the route; 0 mm are thin slices."""

    sets = "slab"


class SetZoom(FlatPlace, Command, frozen=True, kw_only=True):
    """Set the scale of a slice (mm_per_px) or the width of the cut-plane (extent_mm); null shows the whole area."""

    sets = "zoom"
    view: FlatView


class SetOrbit(Orbit, Command, frozen=True, kw_only=True):
    """Set the camera of an external view; null as distance fits the view to its content."""

    sets = "orbits"
    view: OrbitView


class SetCarm(Carm, Command, frozen=True):
    """Set the angles of the radiograph's C-arm (LAO and cranial above 0) and the scale at its centre; null fits."""

    sets = "carm"


class SetReformation(Reformation, Command, frozen=True):
    """Set the angle of the cutting plane of the views along the route, and their scale; null fits the whole route."""

    sets = "reformation"


class SetShading(Command, frozen=True):
    """Switch the light at the tip on or off."""

    sets = "shading"
    on: bool


class SetTexture(Command, frozen=True):
    """Switch the decoration of the wall on or off: texture, vessels, rings and others, which no CT shows."""

    sets = "texture"
    on: bool


class SetMethod(Command, frozen=True):
    """Set the casting method, leaping or the brute-force reference; the pictures are the same."""

    sets = "method"
    method: Method
