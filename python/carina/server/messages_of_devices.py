"""Messages about input devices and recordings, both ways."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from carina.navigate import CONTROL_RANGES
from carina.server.wire_codec import Length, Range
from carina.server.wire_fields import Count, PointLps, Words

__all__ = [
    "ArmPen",
    "AskContact",
    "Calibrate",
    "ConnectDevice",
    "DeviceControls",
    "DeviceGone",
    "DeviceInfo",
    "DeviceSample",
    "DeviceSource",
    "Devices",
    "DisconnectDevice",
    "ForcePlane",
    "JoinPen",
    "LocalContact",
    "Pen",
    "PhoneInfo",
    "PublishTip",
    "SetControl",
    "SetControls",
    "SetPhone",
    "StartRecording",
    "StopRecording",
    "TakeDevice",
    "WatchDevices",
]

DeviceName = Annotated[str, Length(1, 200)]
Control = Literal["absolute", "relative", "path"]
# Wide: what a device says too much is ignored and counted, and does not end the connection.
Wide = Annotated[float, Range(-1e300, 1e300)]
Three = Annotated[tuple[Wide, ...], Length(3, 3)]
Four = Annotated[tuple[Wide, ...], Length(4, 4)]
Six = Annotated[tuple[Wide, ...], Length(6, 6)]
Buttons = Annotated[int, Range(0, 2**32 - 1)]


@dataclass(frozen=True, slots=True)
class DeviceSample:
    """What a device of the window says.

    Second check: an orientation (with a position or without), axes, or a scope handle's controls.
    """

    wire_type: ClassVar[str] = "device_sample"
    device: DeviceName
    time_s: Wide
    """The device's clock, or the page's."""
    position_mm: Three | None
    """In the device's own space; null for a device that knows only how it is turned."""
    orientation_wxyz: Four | None
    """``device_from_pen``; the pen's axes are right, down, forward."""
    axes: Six | None
    """Forward, right, up, yaw right, pitch up, roll clockwise, -1 to 1 of full speed."""
    buttons: Buttons
    handle: Three | None = None
    """Insertion in mm, roll in rad, lever -1 to 1 (1 is fully down, which bends the tip up)."""
    advance: Wide = 0.0
    """Beside an orientation: how far a forward key or stick is pushed, -1 to 1 of full speed."""


@dataclass(frozen=True, slots=True)
class DeviceGone:
    """A device of the window was unplugged."""

    wire_type: ClassVar[str] = "device_gone"
    device: DeviceName


@dataclass(frozen=True, slots=True)
class TakeDevice:
    """This device moves the tip from now on."""

    wire_type: ClassVar[str] = "take_device"
    device: DeviceName


@dataclass(frozen=True, slots=True)
class SetControl:
    """How a device moves the tip: its place (registered), what the hand does, or along the path."""

    wire_type: ClassVar[str] = "set_control"
    control: Control


@dataclass(frozen=True, slots=True)
class DeviceControls:
    """Gains, clutch, speeds and filter of devices."""

    gain_mm: Annotated[float, Range(*CONTROL_RANGES["gain_mm"])]
    gain_turn: Annotated[float, Range(*CONTROL_RANGES["gain_turn"])]
    clutch: Literal["always", "hold"]
    speed_mm_s: Annotated[float, Range(*CONTROL_RANGES["speed_mm_s"])]
    turn_rad_s: Annotated[float, Range(*CONTROL_RANGES["turn_rad_s"])]
    lever_inverted: bool
    filter_on: bool
    min_cutoff_hz: Annotated[float, Range(0.1, 1000.0)]


@dataclass(frozen=True, slots=True)
class SetControls:
    """How a device's movement becomes that of the tip."""

    wire_type: ClassVar[str] = "set_controls"
    controls: DeviceControls


@dataclass(frozen=True, slots=True)
class Calibrate:
    """Register a tracker to the patient by pairs of points (3 or more); no pairs forget it."""

    wire_type: ClassVar[str] = "calibrate"
    device: DeviceName
    tracker_mm: Annotated[tuple[Three, ...], Length(0, 100)]
    patient_lps: Annotated[tuple[PointLps, ...], Length(0, 100)]


@dataclass(frozen=True, slots=True)
class ArmPen:
    """What the pen's first button sets, at the pen's own tip (``pen``); null lets it change the way to move."""

    wire_type: ClassVar[str] = "arm_pen"
    tool: Literal["root", "target"] | None


@dataclass(frozen=True, slots=True)
class JoinPen:
    """In absolute movement the tip comes to the registered pen at once, instead of easing over."""

    wire_type: ClassVar[str] = "join_pen"


@dataclass(frozen=True, slots=True)
class ConnectDevice:
    """Connect to a device of this machine: fastrak:PORT, handle:PORT, openigtlink:HOST:PORT."""

    wire_type: ClassVar[str] = "connect_device"
    address: DeviceName


@dataclass(frozen=True, slots=True)
class DisconnectDevice:
    """End that connection."""

    wire_type: ClassVar[str] = "disconnect_device"
    address: DeviceName


@dataclass(frozen=True, slots=True)
class PublishTip:
    """Publish the tip by OpenIGTLink on this port of this machine (0: a free one); null ends it."""

    wire_type: ClassVar[str] = "publish_tip"
    port: Annotated[int, Range(0, 65_535)] | None


@dataclass(frozen=True, slots=True)
class SetPhone:
    """Open the page for a phone to this machine's network, with a new certificate and link, or close it."""

    wire_type: ClassVar[str] = "set_phone"
    on: bool


@dataclass(frozen=True, slots=True)
class AskContact:
    """On ``/force`` only: the wall near a place as a plane; answered by ``local_contact``, the newest alone."""

    wire_type: ClassVar[str] = "ask_contact"
    number: Count
    lps: PointLps | None
    """The middle of the tip that feels; null for Carina's own tip."""


@dataclass(frozen=True, slots=True)
class WatchDevices:
    """Send ``devices`` a few times a second, or only when something changes."""

    wire_type: ClassVar[str] = "watch_devices"
    on: bool


@dataclass(frozen=True, slots=True)
class StartRecording:
    """Record the flight to a file of this machine."""

    wire_type: ClassVar[str] = "start_recording"


@dataclass(frozen=True, slots=True)
class StopRecording:
    """End the recording."""

    wire_type: ClassVar[str] = "stop_recording"


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """A device that said something."""

    device: DeviceName
    holds: bool
    """It moves the tip."""
    registered: bool
    residual_mm: float | None
    """Of the registration, root mean square."""
    latency_ms: float
    """Of the filter, for the newest sample."""
    num_used: Count
    num_ignored: Count
    ignored_words: Words
    position_mm: Three | None
    """Filtered, in the device's own space."""
    orientation_wxyz: Four | None
    axes: Annotated[tuple[Wide, ...], Length(0, 6)]
    """Of sticks; insertion in mm, roll in rad and lever of a handle."""
    buttons: Buttons


@dataclass(frozen=True, slots=True)
class DeviceSource:
    """A connection of this machine to a device."""

    address: DeviceName
    title: Words
    state: Literal["connecting", "live", "lost", "stopped"]
    words: Words
    rate_hz: float
    num_bad: Count


@dataclass(frozen=True, slots=True)
class PhoneInfo:
    """The page for a phone while it is open to the network."""

    url: Words
    """With the token: whoever has it may move the tip."""
    address: Words
    sha256: Words
    """Of the certificate, as browsers show it."""
    qr: Annotated[tuple[Words, ...], Length(0, 200)]
    """The link as a QR code: rows of 0 (light) and 1 (dark)."""
    connected: bool
    rate_hz: float
    num_bad: Count
    bad_words: Words
    num_refused: Count
    """Connections with a wrong token."""


@dataclass(frozen=True, slots=True)
class Devices:
    """Input devices, how they move the tip, and what is recorded."""

    wire_type: ClassVar[str] = "devices"
    control: Control
    filter_latency_ms: float
    """At rest: the most that the filter delays."""
    controls: DeviceControls
    devices: Annotated[tuple[DeviceInfo, ...], Length(0, 200)]
    sources: Annotated[tuple[DeviceSource, ...], Length(0, 50)]
    serial_ports: Annotated[tuple[Words, ...], Length(0, 200)]
    serial_problem: Words | None
    """Why devices at serial ports cannot be used."""
    published_port: Annotated[int, Range(0, 65_535)] | None
    recording: Words | None
    """The file that is being recorded to."""
    phone: PhoneInfo | None
    """Null while the page for a phone is closed."""
    phone_problem: Words | None
    """Why it cannot be opened on this machine."""


@dataclass(frozen=True, slots=True)
class Pen:
    """The tracked pen that moves the tip, and the point that its button marks; whenever one of them changed."""

    wire_type: ClassVar[str] = "pen"
    device: DeviceName | None
    """Null: no pen moves the tip."""
    tracked: bool
    """It tells its position, not only how it is turned."""
    lps: Three | None
    """Its own tip in the patient; null where it is not registered: then its button marks the scope's tip.

    Kept up to date while a pen is armed, and in absolute movement.
    """
    off_mm: float | None
    """In absolute movement: how far the scope's tip still is from the pen."""
    off_deg: float | None
    """And by how much it is still turned against it."""


@dataclass(frozen=True, slots=True)
class ForcePlane:
    """The wall near a place.

    The force is ``stiffness * max(0, -dot(p - point, normal))`` along the normal, less damping times the speed across
    it, within the limits of ``docs/haptics.md``, which are the bridge's to hold.
    """

    point_lps: PointLps
    normal_lps: PointLps
    """Unit length, away from the wall."""
    stiffness_n_per_mm: float
    damping_ns_per_mm: float
    friction: float
    valid_mm: float
    """It stands for the wall so far round the place that was asked for."""


@dataclass(frozen=True, slots=True)
class LocalContact:
    """Answer to ``ask_contact``."""

    wire_type: ClassVar[str] = "local_contact"
    number: Count
    """Of the question."""
    state: Literal["ready", "finding", "none"]
    """``finding``: the wall is being measured; ``none``: no case, no airways, or a person stopped that."""
    lps: PointLps | None
    """The place that it is about."""
    plane: ForcePlane | None
    """Null where no wall is near enough to matter, and while it is not ready: no force then."""
