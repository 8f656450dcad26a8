"""Commands that move the scope's tip."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import AirwayPlace, Matrix4, Mode, Operator, PathMm, PointLps
from carina.commands.value import Command, LocalCommand

Turn = Annotated[float, Meta(ge=-7.0, le=7.0)]


class Steer(Command, frozen=True):
    """Move the tip in the camera's axes: forward, yaw right, pitch up, roll clockwise as the camera sees it."""

    advance_mm: Annotated[float, Meta(ge=-1000.0, le=1000.0)]
    yaw_rad: Turn
    pitch_rad: Turn
    roll_rad: Turn


class SetMode(Command, frozen=True):
    """Set the mode of movement: free, or along the path."""

    mode: Mode


class ToggleMode(Command, frozen=True):
    """Change between free movement and movement along the path, without a jump of the picture."""


class GoTo(Command, frozen=True):
    """Go to a position on the path and enter path mode."""

    path_mm: PathMm


class NextFork(Command, frozen=True):
    """Go to the next fork along the path."""


class PreviousFork(Command, frozen=True):
    """Go back to the previous fork along the path."""


class Place(Command, frozen=True):
    """Move the tip to a point, keep the direction of view, and enter free mode."""

    lps: PointLps


class PlacePose(LocalCommand, frozen=True):
    """Move the tip to a pose and enter free mode."""

    lps_from_camera: Matrix4


class ShowPlace(AirwayPlace, Command, frozen=True):
    """Move the tip in front of a point of the airways, look at it, set the crosshair to it, and enter free mode.

    Without a branch the nearest branch is used.
    """


class LevelHorizon(Command, frozen=True):
    """Roll the picture so that the operator's up direction is up."""


class ResetLook(Command, frozen=True):
    """Turn the view back to the direction of the path."""


class SetBreathing(Command, frozen=True):
    """Switch the simulated breathing of the airway view on or off, or change it; not a step of undo.

    Positions, slices and radiographs remain those in the CT at rest.
    """

    on: bool
    movement_mm: Annotated[float, Meta(ge=0.0, le=40.0)] = 12.0
    """Movement of the lung bases in mm; 0 shows the CT as it is."""
    period_s: Annotated[float, Meta(ge=1.0, le=20.0)] = 3.6
    """Duration of one breath in s."""


class Cough(Command, frozen=True):
    """Let the patient cough once, now, while the simulated breathing is on."""


class SetOperator(Command, frozen=True):
    """Set the position of the operator: at the patient's head, or facing the patient."""

    sets = "operator"
    undo_label = "operator position"
    position: Operator
