"""Commands that move the tip; every move goes through the :class:`carina.navigate.Pilot` of the case."""

from __future__ import annotations

from typing import Any

import msgspec

from carina import commands as c
from carina.case.document import Document
from carina.render import Sight
from carina.scopes import Pose
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import SessionCore
from carina.session.flights.scope_contact import ScopeContactHandlers
from carina.session.open_case.start_pose import pose_before_place


def place_pose(pose: Pose) -> c.PlacePose:
    """Return the command that moves the tip to a pose."""
    return c.PlacePose(tuple(float(v) for v in pose.lps_from_camera.ravel()))


def view_words(document: Document, sight: Sight) -> dict[str, Any]:
    """Return the settings of the airway view as a dictionary with the keys of the recording format."""
    look = document.look
    return {
        "scope": look.scope,
        # "mask" is the name in the file format.
        "mask": look.outline,
        "fov_deg": float(look.fov_deg),
        "shading": sight.shading,
        "texture": sight.texture,
        "operator": look.operator,
        "transfer": document.transfer.to_json(),
    }


class TipHandlers(CommandHandlers):
    """Commands that move the tip and also need the airways, their wall or the volume of the case."""

    def __init__(self, core: SessionCore, holding: ScopeContactHandlers) -> None:
        super().__init__(core)
        self._holding = holding

    @does(c.SetMode)
    def set_mode(self, command: c.SetMode) -> None:
        """Set the mode of movement; a job computes the wall before a scope is inserted into the lumen."""
        case = self.core.needed_case()
        if command.mode != "scope":
            self.core.fly(command)
        elif case.navigator.mode != "scope":
            self._holding.enter(case)

    @does(c.ToggleMode)
    def toggle_mode(self, command: c.ToggleMode) -> None:
        """Switch the mode of movement; with a device in use, cycle through absolute, relative and path control."""
        pilot = self.core.needed_case().pilot
        self.core.fly(command if pilot.holder is None else c.CycleControl())

    @does(c.Place)
    def place(self, command: c.Place) -> None:
        """Move the tip to a point inside the volume."""
        self.core.needed_case().check_inside(command.lps)
        self.core.fly(command)

    @does(c.ShowPlace)
    def show_place(self, command: c.ShowPlace) -> None:
        """Move the crosshair to a point and place the tip before it; without airways only the crosshair moves."""
        lps = command.lps
        case = self.core.needed_case()
        case.check_inside(lps)
        airways = case.document.airways
        pose = None if airways is None else pose_before_place(airways, case.info.volume, lps, command.branch_id)
        if pose is not None:
            self.core.fly(place_pose(pose))
            # The horizon is levelled for the position of the operator.
            self.core.fly(c.LevelHorizon())
        self.core.see(case, lambda sight: msgspec.structs.replace(sight, crosshair_lps=lps))
