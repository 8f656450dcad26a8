"""How the case is shown: what undo takes back, and ways of looking, which it does not."""

from __future__ import annotations

from typing import Any

from carina import commands as c
from carina.errors import UsageError
from carina.render import VIEWS, Slab, view_row
from carina.scopes import scope_preset
from carina.session.case import HISTOGRAM_PRESET
from carina.session.scene import Carm, FlatPlace, Orbit, Reformation
from carina.session.subject import Subject, does

__all__ = ["Looking"]

PINHOLE_FOV_DEG = 90.0


class Looking(Subject):
    """Lens, transfer function, light and windows; orbits, zooms and the crosshair."""

    # ------------------------------------------------------------ with a step of undo

    @does(c.SetWindow)
    def set_window(self, command: c.SetWindow) -> None:
        """A drag is one step."""
        window = {"window_width_hu": command.width_hu, "window_level_hu": command.level_hu}
        self.core.edit(command.undo_label, "window", **window)

    @does(c.SetFov)
    def set_fov(self, command: c.SetFov) -> None:
        """A drag is one step."""
        self.core.edit(command.undo_label, "fov", fov_deg=command.fov_deg)

    @does(c.SetScope)
    def set_scope(self, command: c.SetScope) -> None:
        """With its field of view and outline. A full frame stays full, since a person chose it."""
        mask = self.core.needed_case().document.mask
        if command.scope is None:
            self.core.edit("no scope", None, scope=None, fov_deg=PINHOLE_FOV_DEG)
            return
        scope = scope_preset(command.scope)
        changed: dict[str, Any] = {"fov_deg": scope.usual_fov_deg, "mask": "none" if mask == "none" else scope.mask}
        self.core.edit(f"scope: {scope.title}", None, scope=command.scope, **changed)

    @does(c.SetMask)
    def set_mask(self, command: c.SetMask) -> None:
        """Round, octagonal or the full frame."""
        self.core.edit(command.undo_label, None, mask=command.mask)

    @does(c.SetShading)
    def set_shading(self, command: c.SetShading) -> None:
        """On or off."""
        self.core.edit(command.undo_label, None, shading=command.on)

    @does(c.SetTexture)
    def set_texture(self, command: c.SetTexture) -> None:
        """On or off."""
        self.core.edit(command.undo_label, None, texture=command.on)

    @does(c.SetMethod)
    def set_method(self, command: c.SetMethod) -> None:
        """The picture is the same."""
        self.core.edit(command.undo_label, None, method=command.method)

    @does(c.SetOperator)
    def set_operator(self, command: c.SetOperator) -> None:
        """The tip follows the document."""
        self.core.edit(command.undo_label, None, operator=command.position)

    @does(c.SetTransfer)
    def set_transfer(self, command: c.SetTransfer) -> None:
        """A drag is one step; what is in another unit than the volume is refused."""
        preset, document = command.preset, command.document
        case = self.core.needed_case()
        if preset is not None:
            if preset not in case.presets:
                known = ", ".join(case.presets)
                raise UsageError(f"no transfer function is called {preset!r} for this volume; there are: {known}")
            if preset == HISTOGRAM_PRESET:
                transfer = self.core.parts.transfer_from_histogram(case.info.volume)[0]
            else:
                transfer = self.core.parts.transfer_preset(preset)
        else:
            assert document is not None
            transfer = self.core.parts.transfer_from_json(document)
            if (transfer.unit == "HU") != case.info.volume.is_hu:
                unit = "HU" if case.info.volume.is_hu else "raw: its numbers are not HU"
                raise UsageError(f"this transfer function is in {transfer.unit}; the volume needs {unit}")
        self.core.edit(command.undo_label, "transfer", transfer=transfer)

    # ------------------------------------------------------------ without

    @does(c.SetCrosshair)
    def set_crosshair(self, command: c.SetCrosshair) -> None:
        """None follows the tip."""
        case = self.core.needed_case()
        if command.lps is not None:
            case.check_inside(command.lps)
            self.core.look(case, crosshair_lps=command.lps)
        else:
            self.core.look(case, crosshair_lps=None, zoom=case.zoom.following)

    @does(c.SetOrbit)
    def set_orbit(self, command: c.SetOrbit) -> None:
        """Camera of an outside view."""
        orbit = Orbit(command.azimuth_deg, command.elevation_deg, command.distance_mm)
        self.core.look(self.core.needed_case(), **{f"orbit_{VIEWS[command.view].field}": orbit})

    @does(c.SetZoom)
    def set_zoom(self, command: c.SetZoom) -> None:
        """The picture stays round its centre until the tip moves."""
        case = self.core.needed_case()
        row = view_row(command.view)
        place = FlatPlace(command.extent_mm if row.zoom == "extent" else command.mm_per_px, command.center_lps)
        self.core.look(case, zoom=case.zoom.placed(command.view, place))

    @does(c.SetCarm)
    def set_carm(self, command: c.SetCarm) -> None:
        """Where the C-arm stands."""
        carm = Carm(command.primary_deg, command.secondary_deg, command.mm_per_px, command.tone)
        self.core.look(self.core.needed_case(), carm=carm)

    @does(c.SetReformation)
    def set_reformation(self, command: c.SetReformation) -> None:
        """Turn and scale."""
        self.core.look(self.core.needed_case(), reformation=Reformation(command.turn_deg, command.mm_per_px))

    @does(c.SetSlab)
    def set_slab(self, command: c.SetSlab) -> None:
        """Thin slices have none."""
        slab = Slab(command.thickness_mm, command.kind) if command.thickness_mm > 0.0 else None
        self.core.look(self.core.needed_case(), slab=slab)
