"""How the case is shown: look, which undo takes back, and sight, which it does not."""

from __future__ import annotations

from collections.abc import Hashable
from functools import partial
from typing import Any

import msgspec

from carina import commands as c
from carina.errors import UsageError
from carina.render import Sight
from carina.scopes import scope_preset
from carina.session.case import HISTOGRAM_PRESET, OpenCase
from carina.session.subject import Subject, does

__all__ = ["Looking"]

PINHOLE_FOV_DEG = 90.0


class Looking(Subject):
    """Lens, transfer function, light and windows; orbits, zooms and the crosshair.

    Most commands only set a field of one of the two: :meth:`set_field` does all of these.
    """

    def set_field(self, command: c.Command) -> None:
        """What only sets a field of look or sight. A number that is dragged is one step of undo."""
        case = self.core.needed_case()
        assert command.sets is not None
        view, value = command.setting()
        with self.core.lock:
            if command.sets in c.Look.__struct_fields__:
                gesture = command.sets if isinstance(value, float) else None
                self._change_look(case, command.undo_label, gesture, **{command.sets: value})
                return
            self.core.see(case, partial(_with_field, name=command.sets, view=view, value=value))

    def _change_look(self, case: OpenCase, label: str | None, gesture: Hashable, **values: Any) -> None:
        self.core.edit(label, gesture, look=msgspec.structs.replace(case.document.look, **values))

    @does(c.SetScope)
    def set_scope(self, command: c.SetScope) -> None:
        """With its field of view and outline. A full frame stays full, since a person chose it."""
        case = self.core.needed_case()
        if command.scope is None:
            self._change_look(case, "no scope", None, scope=None, fov_deg=PINHOLE_FOV_DEG)
            return
        scope = scope_preset(command.scope)
        outline = "none" if case.document.look.outline == "none" else scope.outline
        self._change_look(
            case, f"scope: {scope.title}", None, scope=command.scope, fov_deg=scope.usual_fov_deg, outline=outline
        )

    @does(c.SetTransfer)
    def set_transfer(self, command: c.SetTransfer) -> None:
        """A drag is one step; what is in another unit than the volume is refused."""
        preset, document = command.preset, command.document
        case = self.core.needed_case()
        if preset is not None:
            if preset not in case.info.scale.presets:
                known = ", ".join(case.info.scale.presets)
                raise UsageError(f"this volume has no transfer function {preset!r}; choose one of {known}")
            if preset == HISTOGRAM_PRESET:
                transfer = self.core.parts.transfer_from_histogram(case.info.volume)[0]
            else:
                transfer = self.core.parts.transfer_preset(preset)
        else:
            assert document is not None
            transfer = self.core.parts.transfer_from_json(document)
            if (transfer.unit == "HU") != case.info.volume.is_hu:
                unit = "HU" if case.info.volume.is_hu else "raw values, because it is not in HU"
                raise UsageError(f"this transfer function is in {transfer.unit}; the volume needs one in {unit}")
        self.core.edit(command.undo_label, "transfer", transfer=transfer)

    @does(c.SetCrosshair)
    def set_crosshair(self, command: c.SetCrosshair) -> None:
        """None follows the tip."""
        case = self.core.needed_case()
        if command.lps is not None:
            case.check_inside(command.lps)
            self.set_field(command)
        else:
            self.core.see(case, lambda sight: _with_field(sight.centred(sight.zoom), "crosshair_lps", None, None))


def _with_field(sight: Sight, name: str, view: str | None, value: Any) -> Sight:
    """The same with another value of a field, or of one view in it."""
    if view is not None:
        value = {**getattr(sight, name), view: value}
    return msgspec.structs.replace(sight, **{name: value})
