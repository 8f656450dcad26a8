"""Input devices and recordings."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from msgspec import Meta

from carina.commands.fields import Clutch, Control, DeviceName, PointLps, Three
from carina.commands.value import Command, FrozenValue, LocalCommand

CONTROL_RANGES: dict[str, tuple[float, float]] = {
    "gain_mm": (0.01, 100.0),
    "gain_turn": (0.01, 100.0),
    "speed_mm_s": (0.1, 500.0),
    "turn_rad_s": (0.01, 10.0),
    "lever_rad": (0.01, 2.0 * math.pi),
}
"""Least and greatest of the numbers that say how a device's movement becomes that of the tip."""


def _range(name: str) -> Meta:
    low, high = CONTROL_RANGES[name]
    return Meta(ge=low, le=high)


class DeviceGone(Command, frozen=True):
    """A device was unplugged."""

    device: DeviceName


class TakeDevice(Command, frozen=True):
    """This device moves the tip from now on."""

    device: DeviceName


class SetControl(Command, frozen=True):
    """How a device moves the tip: its place (registered), what the hand does, or along the path."""

    control: Control


class CycleControl(LocalCommand, frozen=True):
    """The next of absolute, relative and path that there is, as a device's first button does."""


class DeviceControls(FrozenValue, frozen=True):
    """Gains, clutch, speeds and filter of devices."""

    gain_mm: Annotated[float, _range("gain_mm")]
    gain_turn: Annotated[float, _range("gain_turn")]
    clutch: Clutch
    speed_mm_s: Annotated[float, _range("speed_mm_s")]
    turn_rad_s: Annotated[float, _range("turn_rad_s")]
    lever_inverted: bool
    filter_on: bool
    min_cutoff_hz: Annotated[float, Meta(ge=0.1, le=1000.0)]


class SetControls(Command, frozen=True):
    """How a device's movement becomes that of the tip."""

    controls: DeviceControls


class SetAllControls(LocalCommand, frozen=True):
    """The same with what the window does not show."""

    controls: Any
    """A :class:`carina.navigate.Controls`."""


class Calibrate(Command, frozen=True):
    """Register a tracker to the patient by pairs of points (3 or more); no pairs forget it."""

    device: DeviceName
    tracker_mm: Annotated[tuple[Three, ...], Meta(max_length=100)]
    patient_lps: Annotated[tuple[PointLps, ...], Meta(max_length=100)]


class ArmPen(Command, frozen=True):
    """What the pen's first button sets, at the pen's own tip (``pen``); null lets it change the way to move."""

    tool: Literal["root", "target"] | None


class JoinPen(Command, frozen=True):
    """In absolute movement the tip comes to the registered pen at once, instead of easing over."""


class RecordFlight(LocalCommand, frozen=True):
    """Record every move of the tip to a file until :class:`StopRecording`, or until the case is closed."""

    path: Any
    """A :class:`pathlib.Path` that does not exist yet."""


class StopRecording(Command, frozen=True):
    """End the recording."""
