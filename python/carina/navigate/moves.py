"""All that can move the tip, as values: what is asked for by a hand, a key, a device or a program.

One kind of value for every source makes one owner of the pose possible, and recordings: a session's moves, fed to a
:class:`carina.navigate.Pilot` again, give its poses again.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from carina.commands import (
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
    SetMode,
    SetOperator,
    TakeDevice,
    ToggleMode,
)
from carina.commands.devices import CONTROL_RANGES
from carina.commands.fields import Control
from carina.display import one_line
from carina.errors import UsageError
from carina.navigate.one_euro import FilterSettings
from carina.navigate.samples import AxesSample, HandleSample, PoseSample, Sample

__all__ = [
    "CONTROL_RANGES",
    "MOVES",
    "ArmPen",
    "Calibrate",
    "Control",
    "Controls",
    "CycleControl",
    "DeviceGone",
    "DeviceSaid",
    "Frame",
    "GoTo",
    "JoinPen",
    "LevelHorizon",
    "Move",
    "NextFork",
    "PathFork",
    "PathWay",
    "Place",
    "PlacePose",
    "PreviousFork",
    "ResetLook",
    "SetControl",
    "SetControls",
    "SetMode",
    "SetOperator",
    "SetPath",
    "SetScope",
    "Steer",
    "TakeDevice",
    "ToggleMode",
    "move_from_json",
    "move_to_json",
]

Vec3 = tuple[float, float, float]
Sixteen = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Steer:
    """Turn, then advance; see :meth:`carina.navigate.Navigator.steer`."""

    advance_mm: float
    yaw_rad: float
    pitch_rad: float
    roll_rad: float
    dt_s: float = 0.0
    """Since the move before, for the time of contact in mode *scope*."""


@dataclass(frozen=True, slots=True)
class PathWay:
    """A way on from a fork: an id of the giver's, and where it leads (unit vector, LPS)."""

    way_id: int
    dir_lps: Vec3


@dataclass(frozen=True, slots=True)
class PathFork:
    """A fork of the path: its place, the ways on from it, and which of them the path takes."""

    path_mm: float
    ways: tuple[PathWay, ...]
    taken: int


@dataclass(frozen=True, slots=True)
class SetPath:
    """Another path to fly on, as the arguments of :class:`carina.navigate.FlightPath`; no points mean none."""

    points_lps: tuple[Vec3, ...]
    up_lps: Vec3 | None = None
    forks_mm: tuple[float, ...] = ()
    lookouts_mm: tuple[float, ...] | None = None
    max_deviation_mm: float = 0.5
    ways: tuple[PathFork, ...] = ()


# What devices do.


@one_line
@dataclass(frozen=True, slots=True)
class Controls:
    """How a device's movement becomes that of the tip.

    Parameters
    ----------
    gain_mm, gain_turn
        What the tip moves per movement of the hand, mm and angle; *relative* and *path* only.
    clutch
        ``"always"``: the hand moves the tip, unless button 1 is held (to lift the hand back). ``"hold"``: only while
        it is.
    speed_mm_s, turn_rad_s
        Of a stick pushed all the way.
    lever_inverted
        False follows a real lever: lever down bends the tip up.
    lever_rad
        What the tip looks up at with the lever all the way down, without kinematics.
    filter
        See :class:`FilterSettings`.

    Raises
    ------
    UsageError
        ``navigate.controls``: if a number is out of :data:`CONTROL_RANGES`.
    """

    gain_mm: float = 1.0
    gain_turn: float = 1.0
    clutch: Literal["always", "hold"] = "always"
    speed_mm_s: float = 25.0
    turn_rad_s: float = 1.0
    lever_inverted: bool = False
    lever_rad: float = math.pi / 3.0
    filter: FilterSettings = dataclasses.field(default_factory=FilterSettings)

    def __post_init__(self) -> None:
        for name, (low, high) in CONTROL_RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(
                    f"controls: {name} is expected between {low:g} and {high:g}; found {value!r}",
                    code="navigate.controls",
                )
        if self.clutch not in {"always", "hold"}:
            raise UsageError(
                f"controls: clutch is expected to be always or hold; found {self.clutch!r}", code="navigate.controls"
            )


@dataclass(frozen=True, slots=True)
class DeviceSaid:
    """A sample of a device, and when it arrived (s, monotonic)."""

    device: str
    sample: Sample
    now_s: float


@dataclass(frozen=True, slots=True)
class Frame:
    """Time for the tip to follow the newest sample (s, monotonic)."""

    now_s: float


@dataclass(frozen=True, slots=True)
class Calibrate:
    """Where a tracker's space lies in the patient, 16 numbers row by row; none forgets it."""

    device: str
    lps_from_tracker: Sixteen


@dataclass(frozen=True, slots=True)
class SetScope:
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


@dataclass(frozen=True, slots=True)
class ArmPen:
    """The pen's first button marks a point (``Pilot.pen_lps``) instead of cycling the ways to move, or no longer."""

    armed: bool


@dataclass(frozen=True, slots=True)
class SetControls:
    """Gains, clutch, speeds and filter."""

    controls: Controls


Move = (
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
    | Calibrate
    | SetControl
    | CycleControl
    | ArmPen
    | JoinPen
    | SetScope
    | SetControls
)
MOVES: dict[str, type[Any]] = {"PlaceAt" if cls is Place else cls.__name__: cls for cls in get_args(Move)}
"""By the names that recordings have for them."""
NAMES = {cls: name for name, cls in MOVES.items()}
_SAMPLES: dict[str, type[Any]] = {"pose": PoseSample, "axes": AxesSample, "handle": HandleSample}


def move_to_json(move: Move) -> dict[str, Any]:
    """The move as JSON values. Floats keep every bit: JSON's shortest digits read back as the same number."""
    fields = move.__struct_fields__ if isinstance(move, Command) else [f.name for f in dataclasses.fields(move)]
    return {"move": NAMES[type(move)], **{name: _plain(getattr(move, name)) for name in fields}}


def move_from_json(value: dict[str, Any]) -> Move:
    """The move again.

    Raises
    ------
    UsageError
        ``navigate.recording``: if it is none.
    """
    fields = dict(value)
    name = fields.pop("move", None)
    cls = MOVES.get(name) if isinstance(name, str) else None
    if cls is None:
        raise UsageError(f"no move is called {name!r}", code="navigate.recording")
    try:
        if cls is DeviceSaid:
            kind = dict(fields["sample"])
            fields["sample"] = _SAMPLES[kind.pop("kind")](**{k: _tuples(v) for k, v in kind.items()})
        elif cls is SetControls:
            controls = dict(fields["controls"])
            fields["controls"] = Controls(**{**controls, "filter": FilterSettings(**controls["filter"])})
        elif cls is SetPath:
            fields["ways"] = tuple(
                PathFork(
                    fork["path_mm"],
                    tuple(PathWay(way["way_id"], _tuples(way["dir_lps"])) for way in fork["ways"]),
                    fork["taken"],
                )
                for fork in fields["ways"]
            )
        # Names of fields are checked by the constructors; numbers by whoever applies the move.
        move: Move = cls(**{k: _tuples(v) for k, v in fields.items()})
    except (TypeError, KeyError, AttributeError, ValueError) as trouble:
        raise UsageError(f"the move {name} cannot be read: {trouble}", code="navigate.recording") from trouble
    return move


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    for kind, cls in _SAMPLES.items():
        if isinstance(value, cls):
            return {"kind": kind, **{f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}}
    if dataclasses.is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    return value


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value
