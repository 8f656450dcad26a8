"""All that can move the tip, as values: commands (:mod:`carina.commands`), and what only a pilot knows.

One kind of value for every source makes one owner of the pose possible, and recordings: a session's moves, fed to a
:class:`carina.navigate.Pilot` again, give its poses again.
"""

from __future__ import annotations

from typing import Any, TypeAlias, get_args

import msgspec

from carina.commands import (
    ArmPen,
    Command,
    CycleControl,
    DeviceGone,
    GoTo,
    JoinPen,
    LevelHorizon,
    NextFork,
    Place,
    PlacePose,
    PreviousFork,
    ResetLook,
    SetControl,
    SetControls,
    SetMode,
    SetOperator,
    Steer,
    TakeDevice,
    ToggleMode,
)
from carina.commands.value import FrozenValue, as_plain
from carina.errors import UsageError
from carina.navigate.samples import Sample
from carina.typed_reading import read_plain

__all__ = [
    "DeviceSaid",
    "Frame",
    "LayScope",
    "Move",
    "PathFork",
    "PathWay",
    "Register",
    "SetPath",
    "move_from_json",
    "move_to_json",
]

Vec3 = tuple[float, float, float]
Sixteen = tuple[float, ...]


class PilotMove(FrozenValue, frozen=True, tag_field="move", tag=True):
    """A move that nobody asks a case for by itself: it follows from a command, from a device or from the clock."""


class PathWay(FrozenValue, frozen=True):
    """A way on from a fork: an id of the giver's, and where it leads (unit vector, LPS)."""

    way_id: int
    dir_lps: Vec3


class PathFork(FrozenValue, frozen=True):
    """A fork of the path: its place, the ways on from it, and which of them the path takes."""

    path_mm: float
    ways: tuple[PathWay, ...]
    taken: int


class SetPath(PilotMove, frozen=True):
    """Another path to fly on, as the arguments of :class:`carina.navigate.FlightPath`; no points mean none."""

    points_lps: tuple[Vec3, ...]
    up_lps: Vec3 | None = None
    forks_mm: tuple[float, ...] = ()
    lookouts_mm: tuple[float, ...] | None = None
    max_deviation_mm: float = 0.5
    ways: tuple[PathFork, ...] = ()


class DeviceSaid(PilotMove, frozen=True):
    """A sample of a device, and when it arrived (s, monotonic)."""

    device: str
    sample: Sample
    now_s: float


class Frame(PilotMove, frozen=True):
    """Time for the tip to follow the newest sample (s, monotonic)."""

    now_s: float


class Register(PilotMove, frozen=True, tag="Calibrate"):
    """Where a tracker's space lies in the patient, 16 numbers row by row; none forgets it.

    The result of :class:`carina.commands.Calibrate`, whose fit may differ in the last bits on another machine.
    """

    device: str
    lps_from_tracker: Sixteen


class LayScope(PilotMove, frozen=True, tag="SetScope"):
    """Lay a scope in the lumen along a path and hold it (mode *scope*); the pilot knows the wall.

    Parameters
    ----------
    scope
        Name in the library.
    points_lps
        From where the scope enters to beyond its tip, LPS mm.
    insertion_mm
        Where the tip should be, in mm of the points.
    up_lps
        Where flexion up leads to at roll 0; anterior unless told.
    """

    scope: str
    points_lps: tuple[Vec3, ...]
    insertion_mm: float
    up_lps: Vec3 | None = None


Move: TypeAlias = (
    Steer
    | GoTo
    | NextFork
    | PreviousFork
    | Place
    | PlacePose
    | LevelHorizon
    | ResetLook
    | SetMode
    | ToggleMode
    | SetOperator
    | SetPath
    | DeviceSaid
    | Frame
    | DeviceGone
    | TakeDevice
    | Register
    | SetControl
    | CycleControl
    | ArmPen
    | JoinPen
    | LayScope
    | SetControls
)


def _name(cls: type[Any]) -> str:
    if issubclass(cls, PilotMove):
        return str(cls.__struct_config__.tag)
    return "PlaceAt" if cls is Place else cls.__name__


# What a recording calls each move: a word that files have does not change with the name of a class.
NAMES: dict[type[Any], str] = {cls: _name(cls) for cls in get_args(Move)}
MOVES = {name: cls for cls, name in NAMES.items()}
FILTER = ("min_cutoff_hz", "beta_per_mm", "beta_per_rad", "derivative_cutoff_hz")


def move_to_json(move: Move, dt_s: float = 0.0) -> dict[str, Any]:
    """The move as a recording keeps it. Floats keep every bit: JSON's shortest digits read back as the same number.

    Parameters
    ----------
    move
        What was applied.
    dt_s
        Time since the hand moved before, kept with :class:`carina.commands.Steer`.
    """
    fields = msgspec.to_builtins(move, enc_hook=as_plain)
    if isinstance(move, Command):
        del fields["type"]
    if isinstance(move, Steer):
        fields["dt_s"] = dt_s
    elif isinstance(move, ArmPen):
        fields = {"armed": move.tool is not None}
    elif isinstance(move, SetControls):
        controls = fields["controls"]
        controls["filter"] = {name: controls.pop(name) for name in FILTER} | {"on": controls.pop("filter_on")}
    return {"move": NAMES[type(move)], **fields}


def move_from_json(value: dict[str, Any]) -> tuple[Move, float]:
    """The move again, and the time since the hand moved before (s).

    Raises
    ------
    UsageError
        ``navigate.recording``: if it is none.
    """
    fields = dict(value)
    name, dt_s = fields.pop("move", None), 0.0
    cls = MOVES.get(name) if isinstance(name, str) else None
    if cls is None:
        raise UsageError(f"there is no movement command named {name!r}", code="navigate.recording")
    try:
        if cls is Steer:
            dt_s = float(fields.pop("dt_s"))
        elif cls is ArmPen:
            # Which point its button marks moves nothing.
            fields["tool"] = "target" if fields.pop("armed") else None
        elif cls is SetControls:
            controls = dict(fields["controls"])
            smoothing = dict(controls.pop("filter"))
            fields["controls"] = {**controls, "filter_on": smoothing.pop("on"), **smoothing}
        move: Move = read_plain(fields, cls)
    except (TypeError, KeyError, AttributeError, ValueError) as trouble:
        raise UsageError(
            f"the movement command {name} cannot be read: {trouble}", code="navigate.recording"
        ) from trouble
    return move, dt_s
