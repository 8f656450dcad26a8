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
from carina.render.sight import Carm, FlatPlace, GreyWindow, Method, Orbit, Reformation, Slab
from carina.scopes import DEFAULT_SCOPE, scope_preset
from carina.value import FrozenValue, PointLps


class Look(FrozenValue, frozen=True):
    """What the airway view is seen through, and from where: chosen by a person, and undone."""

    scope: Identifier | None = DEFAULT_SCOPE
    """Name of the instrument; null is a pinhole."""
    outline: Outline = "round"
    """Outline of the picture."""
    fov_deg: float = scope_preset(DEFAULT_SCOPE).usual_fov_deg
    """Field of view; the scope's, unless the user chose another."""
    operator: Operator = "head"


# ------------------------------------------------------------------ with a step of undo


class SetFov(Command, frozen=True):
    """Full angle of the airway view over the shorter side."""

    sets = "fov_deg"
    undo_label = "field of view"
    fov_deg: Annotated[float, Meta(ge=60.0, le=170.0)]


class SetOutline(Command, frozen=True):
    """Outline of the airway picture: round, octagonal or the full frame."""

    sets = "outline"
    undo_label = "image outline"
    outline: Outline


class SetScope(Command, frozen=True):
    """Look through an instrument of the library, with its field of view and outline; null is a pinhole."""

    scope: Identifier | None


class SetTransfer(Command, frozen=True):
    """A preset by name, or a ``carina-transfer`` document; exactly one."""

    undo_label = "transfer function"
    preset: Identifier | None = None
    document: dict[str, Any] | None = None

    def choice_problem(self) -> str | None:
        """Return an error text unless exactly one of both fields is set."""
        if (self.preset is None) == (self.document is None):
            return "set_transfer: expected exactly one of preset and document"
        return None


# ------------------------------------------------------------------ without a step of undo


class SetCrosshair(Command, frozen=True):
    """The point that slices and tri-plane show; null follows the tip."""

    sets = "crosshair_lps"
    lps: PointLps | None


class SetWindow(GreyWindow, Command, frozen=True):
    """Grey window of all slice views; numbers of the file where the volume is not HU."""

    sets = "window"


class SetSlab(Slab, Command, frozen=True):
    """Thickness of slices and views along the route, and what they show of it; 0 mm are thin slices."""

    sets = "slab"


class SetZoom(FlatPlace, Command, frozen=True, kw_only=True):
    """Scale of a slice (mm_per_px) or width of the cut-plane (extent_mm); null fits."""

    sets = "zoom"
    view: FlatView


class SetOrbit(Orbit, Command, frozen=True, kw_only=True):
    """Where an outside view is seen from; distance null fits."""

    sets = "orbits"
    view: OrbitView


class SetCarm(Carm, Command, frozen=True):
    """Where the radiograph's C-arm stands: LAO and cranial above 0; mm_per_px counts at its centre, null fits."""

    sets = "carm"


class SetReformation(Reformation, Command, frozen=True):
    """Turn of the cutting plane of the views along the route, and their scale; null fits the route."""

    sets = "reformation"


class SetShading(Command, frozen=True):
    """Light at the tip on or off."""

    sets = "shading"
    on: bool


class SetTexture(Command, frozen=True):
    """Decoration of the wall, which is not the patient's: texture, vessels, rings and the like, on or off."""

    sets = "texture"
    on: bool


class SetMethod(Command, frozen=True):
    """Leaping, or the brute-force reference; the picture is the same."""

    sets = "method"
    method: Method
