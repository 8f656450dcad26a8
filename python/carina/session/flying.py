"""Commands that move the tip. Every one goes through the case's :class:`carina.navigate.Pilot`."""

from __future__ import annotations

from typing import Any

from carina import commands as c
from carina.navigate import moves
from carina.scopes import Pose
from carina.session.core import SessionCore
from carina.session.document import Document
from carina.session.holding import ScopeHolding
from carina.session.start_pose import pose_before_place
from carina.session.subject import Subject, does

# A hand that rests at the wall is counted so long, until it moves again.
MAX_CONTACT_S = 10.0

__all__ = ["Flying", "place_move", "view_words"]


def place_move(pose: Pose) -> moves.PlacePose:
    """The move to a pose."""
    return moves.PlacePose(tuple(float(v) for v in pose.lps_from_camera.ravel()))


def view_words(document: Document) -> dict[str, Any]:
    """How the airway view is shown, as a recording keeps it."""
    return {
        "scope": document.scope,
        "mask": document.mask,
        "fov_deg": float(document.fov_deg),
        "shading": document.shading,
        "texture": document.texture,
        "operator": document.operator,
        "transfer": document.transfer.to_json(),
    }


class Flying(Subject):
    """Keys, clicks and programs."""

    def __init__(self, core: SessionCore, holding: ScopeHolding) -> None:
        super().__init__(core)
        self._holding = holding
        self._steered_s = 0.0

    @does(c.Steer)
    def steer(self, command: c.Steer) -> None:
        """See :meth:`carina.navigate.Navigator.steer`."""
        now_s = self.core.clock()
        dt_s, self._steered_s = min(max(now_s - self._steered_s, 0.0), MAX_CONTACT_S), now_s
        self.core.fly(moves.Steer(command.advance_mm, command.yaw_rad, command.pitch_rad, command.roll_rad, dt_s))

    @does(c.GoTo)
    def go_to(self, command: c.GoTo) -> None:
        """Enters path mode."""
        self.core.fly(command)

    @does(c.NextFork)
    def next_fork(self, command: c.NextFork) -> None:
        """To the look-out in front of it."""
        self.core.fly(command)

    @does(c.PreviousFork)
    def previous_fork(self, command: c.PreviousFork) -> None:
        """To the look-out before."""
        self.core.fly(command)

    @does(c.SetMode)
    def set_mode(self, command: c.SetMode) -> None:
        """A scope in the lumen is laid once the wall is known (a job)."""
        case = self.core.needed_case()
        if command.mode != "scope":
            self.core.fly(command)
        elif case.navigator.mode != "scope":
            self._holding.enter(case)

    @does(c.ToggleMode)
    def toggle_mode(self, command: c.ToggleMode) -> None:
        """With a device in the hand the next of absolute, relative and path."""
        pilot = self.core.needed_case().pilot
        self.core.fly(command if pilot.holder is None else c.CycleControl())

    @does(c.Place)
    def place(self, command: c.Place) -> None:
        """Inside the volume only."""
        self.core.needed_case().check_inside(command.lps)
        self.core.fly(command)

    @does(c.PlacePose)
    def place_pose(self, command: c.PlacePose) -> None:
        """Anywhere."""
        self.core.fly(command)

    @does(c.ShowPlace)
    def show_place(self, command: c.ShowPlace) -> None:
        """Without airways only the crosshair moves."""
        lps = command.lps
        case = self.core.needed_case()
        case.check_inside(lps)
        airways = case.document.airways
        pose = None if airways is None else pose_before_place(airways, case.info.volume, lps, command.branch_id)
        if pose is not None:
            self.core.fly(place_move(pose))
            # As the operator stands.
            self.core.fly(c.LevelHorizon())
        self.core.look(case, crosshair_lps=lps)

    @does(c.LevelHorizon)
    def level_horizon(self, command: c.LevelHorizon) -> None:
        """Roll only."""
        self.core.fly(command)

    @does(c.ResetLook)
    def reset_look(self, command: c.ResetLook) -> None:
        """The place stays."""
        self.core.fly(command)
