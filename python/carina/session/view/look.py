"""Commands that set how the case is shown: the look, whose changes can be undone, and the sight, without undo."""

from __future__ import annotations

from collections.abc import Hashable
from functools import partial
from typing import Any

import msgspec

from carina import commands as c
from carina.case.scope_choice import document_with_scope
from carina.errors import UsageError
from carina.render import Sight
from carina.scopes import scope_preset
from carina.session.command_registry import CommandHandlers, does
from carina.session.open_case.open_case import HISTOGRAM_PRESET, OpenCase

PINHOLE_FOV_DEG = 90.0


class LookHandlers(CommandHandlers):
    """Commands for lens, transfer function, light, grey-scale windows, orbit, zoom and crosshair.

    :meth:`set_field` runs every command that only sets one field of the look or of the sight.
    """

    def set_field(self, command: c.Command) -> None:
        """Set one field of the look or the sight; the changes of a number during a drag form one undo step."""
        case = self.core.needed_case()
        assert command.sets is not None
        view, value = command.setting()
        with self.core.lock:
            if command.sets in c.Look.__struct_fields__:
                gesture = command.sets if isinstance(value, float) else None
                self._change_look(case, command.undo_label, gesture, **{command.sets: value})
                return
            self.core.see(case, partial(_sight_with_field, name=command.sets, view=view, value=value))

    def _change_look(self, case: OpenCase, label: str | None, gesture: Hashable, **values: Any) -> None:
        self.core.edit(label, gesture, look=msgspec.structs.replace(case.document.look, **values))

    @does(c.SetScope)
    def set_scope(self, command: c.SetScope) -> None:
        """Set the scope of the airway view and of all plans, which are made again; None is a pinhole camera."""
        case = self.core.needed_case()
        if command.scope is None:
            self._change_look(case, "no scope", None, scope=None, fov_deg=PINHOLE_FOV_DEG)
            return
        scope = scope_preset(command.scope)
        with self.core.lock:
            changed = document_with_scope(case.document, command.scope, resets_view=True)
            if changed is not case.document:
                self.core.change(case, f"scope: {scope.title}", changed)

    @does(c.SetTransfer)
    def set_transfer(self, command: c.SetTransfer) -> None:
        """Set the transfer function, which must have the unit of the volume; one drag forms one undo step."""
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
        """Move the crosshair to a point inside the volume; None makes it follow the tip."""
        case = self.core.needed_case()
        if command.lps is not None:
            case.check_inside(command.lps)
            self.set_field(command)
        else:
            self.core.see(case, lambda sight: _sight_with_field(sight.centred(sight.zoom), "crosshair_lps", None, None))


def _sight_with_field(sight: Sight, name: str, view: str | None, value: Any) -> Sight:
    """Return a copy of a sight with a new value in one field, or for one view in a field with a value per view."""
    if view is not None:
        value = {**getattr(sight, name), view: value}
    return msgspec.structs.replace(sight, **{name: value})
