"""Moves of the tip as values: commands (:mod:`carina.commands`), and moves that only a pilot creates.

Every source of movement uses the same kind of value. So one object owns the pose, and a recording of a session's moves
gives the same poses when a :class:`carina.navigate.Pilot` applies the moves again.
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

Vec3 = tuple[float, float, float]
Sixteen = tuple[float, ...]


class PilotMove(FrozenValue, frozen=True, tag_field="move", tag=True):
    """Movement of the tip that a command, a device or the clock caused."""


class PathWay(FrozenValue, frozen=True):
    """Branch that leads on from a fork: an ID that the caller assigns, and the direction (unit vector, LPS)."""

    way_id: int
    dir_lps: Vec3


class PathFork(FrozenValue, frozen=True):
    """Fork of the path: its position, the branches that lead on from it, and the branch that the path takes."""

    path_mm: float
    ways: tuple[PathWay, ...]
    taken: int


class SetPath(PilotMove, frozen=True):
    """Replace the path to fly on, by the arguments of :class:`carina.navigate.FlightPath`; no points mean no path."""

    points_lps: tuple[Vec3, ...]
    up_lps: Vec3 | None = None
    forks_mm: tuple[float, ...] = ()
    lookouts_mm: tuple[float, ...] | None = None
    max_deviation_mm: float = 0.5
    ways: tuple[PathFork, ...] = ()


class DeviceSaid(PilotMove, frozen=True):
    """Sample of a device, with its time of arrival in seconds (monotonic clock)."""

    device: str
    sample: Sample
    now_s: float


class Frame(PilotMove, frozen=True):
    """Frame at which the tip follows the latest sample (s, monotonic)."""

    now_s: float


class Register(PilotMove, frozen=True, tag="Calibrate"):
    """Registration of a tracker to the patient, 16 numbers row by row; an empty value removes it.

    The registration is the result of :class:`carina.commands.Calibrate`, whose fit may differ in the last bits on
    another machine.
    """

    device: str
    lps_from_tracker: Sixteen


class LayScope(PilotMove, frozen=True, tag="SetScope"):
    """Insert a scope into the lumen along a path and enter mode *scope*.

    The move does not contain the wall field, which the pilot must already have.

    Parameters
    ----------
    scope
        Name in the library.
    points_lps
        Path from the scope's entry to beyond its tip, LPS mm.
    insertion_mm
        Requested position of the tip, in mm along the points.
    up_lps
        Direction of upward flexion at roll 0; default anterior.
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


# Names of the moves in recordings, which stay the same if a class is renamed.
NAMES: dict[type[Any], str] = {cls: _name(cls) for cls in get_args(Move)}
MOVES = {name: cls for cls, name in NAMES.items()}
FILTER = ("min_cutoff_hz", "beta_per_mm", "beta_per_rad", "derivative_cutoff_hz")


def move_to_json(move: Move, dt_s: float = 0.0) -> dict[str, Any]:
    """Return a move as stored in a recording.

    Floats keep every bit: JSON's shortest digits are read back as the same number.

    Parameters
    ----------
    move
        Move that was applied.
    dt_s
        Time since the last move of the hand, stored with :class:`carina.commands.Steer`.
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
    """Return the move of a recording, and the time since the last move of the hand (s).

    Raises
    ------
    UsageError
        ``navigate.recording``: if the value is not a move.
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
            # Any kind of point is valid here: the kind that the button marks does not affect the movement.
            fields["tool"] = "target" if fields.pop("armed") else None
        elif cls is SetControls:
            controls = dict(fields["controls"])
            smoothing = dict(controls.pop("filter"))
            fields["controls"] = {**controls, "filter_on": smoothing.pop("on"), **smoothing}
        move: Move = read_plain(fields, cls)
    except (TypeError, KeyError, AttributeError, ValueError) as error:
        raise UsageError(f"the movement command {name} cannot be read: {error}", code="navigate.recording") from error
    return move, dt_s
