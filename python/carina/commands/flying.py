"""Commands that move the tip."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import AirwayPlace, Matrix4, Mode, Operator, PathMm, PointLps
from carina.commands.value import Command, LocalCommand

Turn = Annotated[float, Meta(ge=-7.0, le=7.0)]


class Steer(Command, frozen=True):
    """Movement since the last one, in the camera's axes: forward, to the right, up, clockwise as seen by the camera."""

    advance_mm: Annotated[float, Meta(ge=-1000.0, le=1000.0)]
    yaw_rad: Turn
    pitch_rad: Turn
    roll_rad: Turn


class SetMode(Command, frozen=True):
    """Free movement, or along the path."""

    mode: Mode


class ToggleMode(Command, frozen=True):
    """The other mode, without a jump."""


class GoTo(Command, frozen=True):
    """To a place on the path; path mode only."""

    path_mm: PathMm


class NextFork(Command, frozen=True):
    """To the next fork along the path."""


class PreviousFork(Command, frozen=True):
    """To the fork before."""


class Place(Command, frozen=True):
    """Tip to this point, keeping the look; free mode afterwards."""

    lps: PointLps


class PlacePose(LocalCommand, frozen=True):
    """Set the pose of the tip and enter free mode."""

    lps_from_camera: Matrix4


class ShowPlace(AirwayPlace, Command, frozen=True):
    """Tip before a place of the airways, looking at it, and the crosshair on it; free mode afterwards.

    Without a branch the nearest counts.
    """


class LevelHorizon(Command, frozen=True):
    """Roll so that the operator's up is up."""


class ResetLook(Command, frozen=True):
    """Look along the path again."""


class SetOperator(Command, frozen=True):
    """Where the operator stands."""

    sets = "operator"
    undo_label = "operator position"
    position: Operator
