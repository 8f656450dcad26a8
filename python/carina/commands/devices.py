"""Commands for input devices and recordings."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from msgspec import Meta

from carina.commands.fields import Clutch, Control, DeviceName, PointLps, Three
from carina.commands.tree import AskedPath
from carina.commands.value import Command, FrozenValue, LocalCommand

Cutoff = Annotated[float, Meta(ge=0.1, le=1000.0)]
Beta = Annotated[float, Meta(ge=0.0, le=100.0)]
Gain = Annotated[float, Meta(ge=0.01, le=100.0)]


class DeviceGone(Command, frozen=True):
    """Remove a device that was disconnected from the list of devices."""

    device: DeviceName


class TakeDevice(Command, frozen=True):
    """Let a device move the tip from now on."""

    device: DeviceName


class SetControl(Command, frozen=True):
    """Set how a device moves the tip: absolute (registered position), relative (hand movement), or along the path."""

    control: Control


class CycleControl(LocalCommand, frozen=True):
    """Select the next available control of absolute, relative and path, as a device's first button does."""


class DeviceControls(FrozenValue, frozen=True):
    """Mapping from the movement of a device to the movement of the tip.

    Examples
    --------
    >>> DeviceControls(gain_mm=0.5, clutch="hold")
    DeviceControls(gain_mm=0.5, clutch='hold')
    """

    gain_mm: Gain = 1.0
    """Movement of the tip per movement of the hand; *relative* and *path* only."""
    gain_turn: Gain = 1.0
    """Rotation of the tip per rotation of the hand; *relative* and *path* only."""
    clutch: Clutch = "always"
    """``always``: the hand moves the tip, except while button 1 is held. ``hold``: only while button 1 is held."""
    speed_mm_s: Annotated[float, Meta(ge=0.1, le=500.0)] = 25.0
    """Speed at full deflection of a stick."""
    turn_rad_s: Annotated[float, Meta(ge=0.01, le=10.0)] = 1.0
    """Rotation speed at full deflection of a stick."""
    lever_inverted: bool = False
    """Whether lever down bends the tip down; False follows a real lever: lever down bends the tip up."""
    lever_rad: Annotated[float, Meta(ge=0.01, le=2.0 * math.pi)] = math.pi / 3.0
    """Pitch of the tip with the lever fully down, where no scope is simulated."""
    filter_on: bool = True
    """Whether the hand's tremor is smoothed (:class:`carina.navigate.SampleFilter`)."""
    min_cutoff_hz: Cutoff = 20.0
    """Cut-off frequency at rest; a lower value smooths more and delays more."""
    beta_per_mm: Beta = 0.1
    """Increase of the cut-off frequency with speed: Hz per mm/s."""
    beta_per_rad: Beta = 4.0
    """Increase of the cut-off frequency with rotation speed: Hz per rad/s."""
    derivative_cutoff_hz: Cutoff = 10.0
    """Cut-off frequency of the filter of the speed."""


class SetControls(Command, frozen=True):
    """Set gains, clutch, speeds and filter of the input devices."""

    controls: DeviceControls


class Calibrate(Command, frozen=True):
    """Register a tracker to the patient by pairs of points (3 or more); no pairs remove the registration."""

    device: DeviceName
    tracker_mm: Annotated[tuple[Three, ...], Meta(max_length=100)]
    patient_lps: Annotated[tuple[PointLps, ...], Meta(max_length=100)]


class ArmPen(AskedPath, Command, frozen=True):
    """Set which kind of point the pen's first button marks at the pen's tip (``pen``); null lets it cycle the control.

    ``start`` is the start of paths of the costs ``walls`` and ``paper``: windows receive the message ``start_marked``.
    """

    tool: Literal["root", "start", "target"] | None


class JoinPen(Command, frozen=True):
    """Move the tip to the registered pen at once in absolute control, instead of gradually."""


class RecordFlight(LocalCommand, frozen=True):
    """Record every move of the tip until :class:`StopRecording`, or until the case is closed."""

    path: Any = None
    """Path of a new file, a :class:`pathlib.Path`; None records into the case."""
    name: Any = None
    """Name of the flight in the case; None names it by its number."""


class StopRecording(Command, frozen=True):
    """End the recording of the flight."""
