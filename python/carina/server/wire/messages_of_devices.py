"""Messages about input devices and recordings, from the client and from the server."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.devices import DeviceControls
from carina.commands.fields import Control, Count, DeviceName, Three, Wide, Words
from carina.commands.value import FrozenValue
from carina.server.wire.codec import ClientMessage, ServerMessage
from carina.session import FlightInfo

Four = tuple[Wide, Wide, Wide, Wide]
Six = Annotated[tuple[Wide, ...], Meta(min_length=6, max_length=6)]
Buttons = Annotated[int, Meta(ge=0, le=2**32 - 1)]


class DeviceReading(FrozenValue, frozen=True):
    """Pose that a device reports, and its pressed buttons."""

    device: DeviceName
    position_mm: Three | None
    """Position of the pen's tip in device space, mm; null for a device that reports only an orientation."""
    orientation_wxyz: Four | None
    """Rotation from the axes of the pen (right, down, forward) to device space, as a unit quaternion (w, x, y, z).

    Null for a device without an orientation.
    """
    buttons: Buttons


class DeviceSampleMessage(DeviceReading, ClientMessage, frozen=True):
    """Sample of an input device that is connected to the window.

    A sample contains exactly one of: an orientation (with or without a position), axes, or the controls of a scope
    handle.
    """

    time_s: Wide
    """Time stamp of the clock of the device or of the page."""
    axes: Six | None
    """Forward, right, up, yaw right, pitch up, roll clockwise, -1 to 1 of full speed."""
    handle: Three | None
    """Insertion in mm, roll in rad, lever -1 to 1 (1 is fully down, which bends the tip up)."""
    advance: Wide
    """Deflection of a forward key or stick of a device with an orientation, -1 to 1 of full speed."""

    def choice_problem(self) -> str | None:
        """Require exactly one of the three kinds of sample, and a position only with an orientation."""
        kinds = (self.orientation_wxyz, self.axes, self.handle)
        if sum(kind is not None for kind in kinds) != 1:
            return "device_sample needs an orientation, axes or a handle"
        if self.position_mm is not None and self.orientation_wxyz is None:
            return "device_sample has a position without an orientation"
        return None


class ConnectDevice(ClientMessage, frozen=True):
    """Request to connect to a device by kind and address, such as fastrak:PORT or openigtlink:HOST:PORT."""

    address: DeviceName


class DisconnectDevice(ClientMessage, frozen=True):
    """Request to close the connection to a device."""

    address: DeviceName


class PublishTip(ClientMessage, frozen=True):
    """Request to publish the tip by OpenIGTLink on a port of this machine (0: any free port); null stops publishing."""

    port: Annotated[int, Meta(ge=0, le=65_535)] | None


class SetPhone(ClientMessage, frozen=True):
    """Request to open the phone page to the local network, with a new certificate and link, or to close the page."""

    on: bool


class WatchDevices(ClientMessage, frozen=True):
    """Request for device values: a few times a second (``on``), or only after changes."""

    on: bool


class StartRecording(ClientMessage, frozen=True):
    """Request to record the flight into the case, or into a file on this machine if the case is not stored."""


class FlightsMessage(ServerMessage, frozen=True):
    """Recordings of the case in order; sent after each change."""

    flights: Annotated[tuple[FlightInfo, ...], Meta(max_length=100_000)]


class DeviceInfo(DeviceReading, frozen=True):
    """A device that has sent samples; its position is filtered."""

    holds: bool
    """Whether the device moves the tip."""
    registered: bool
    residual_mm: float | None
    """Root-mean-square error of the registration."""
    latency_ms: float
    """Delay of the filter for the newest sample."""
    num_used: Count
    num_ignored: Count
    ignored_words: Words
    axes: Annotated[tuple[Wide, ...], Meta(max_length=6)]
    """Axes of a stick, or insertion in mm, roll in rad and lever of a scope handle."""


class DeviceSource(FrozenValue, frozen=True):
    """A connection between this machine and a device."""

    address: DeviceName
    title: Words
    state: Literal["connecting", "live", "lost", "stopped"]
    words: Words
    """Description of the state for the user."""
    rate_hz: float
    """Number of samples of the device per second."""
    num_bad: Count
    """Number of malformed messages from the device."""


class NetworkPage(FrozenValue, frozen=True, kw_only=True):
    """A page that is open to the local network."""

    url: Words
    """Link with the token; anyone who has the link can use the page."""
    address: Words
    sha256: Words
    """SHA-256 fingerprint of the certificate, as browsers show it."""
    num_refused: Count
    """Number of connections with a wrong token."""


class PhoneInfo(NetworkPage, frozen=True, kw_only=True):
    """The page for a phone while it is open to the network; it moves the tip."""

    qr: Annotated[tuple[Words, ...], Meta(max_length=200)]
    """The link as a QR code: rows of 0 (light) and 1 (dark)."""
    connected: bool
    rate_hz: float
    num_bad: Count
    bad_words: Words


class DevicesMessage(ServerMessage, frozen=True):
    """Input devices, how they move the tip, and what is recorded."""

    control: Control
    filter_latency_ms: float
    """Delay in ms of the smoothing filter at rest, which is its maximum delay."""
    controls: DeviceControls
    devices: Annotated[tuple[DeviceInfo, ...], Meta(max_length=200)]
    sources: Annotated[tuple[DeviceSource, ...], Meta(max_length=50)]
    serial_ports: Annotated[tuple[Words, ...], Meta(max_length=200)]
    serial_problem: Words | None
    """Reason why devices at serial ports cannot be used."""
    published_port: Annotated[int, Meta(ge=0, le=65_535)] | None
    recording: Words | None
    """Name of the flight that is being recorded, or its file."""
    phone: PhoneInfo | None
    """State of the phone page; null while the page is closed."""
    phone_problem: Words | None
    """Reason why the page cannot be opened on this machine."""


class StartMarkedMessage(ServerMessage, frozen=True):
    """Report that the pen's button marked the start of a path that needs no airways (``arm_pen``, ``add_target``)."""

    lps: Three
    """Point that the pen's button marked, LPS mm."""


class Pen(ServerMessage, frozen=True):
    """State of the tracked pen that moves the tip, and the point that its button marks; sent after each change."""

    device: DeviceName | None
    """Pen (stylus) that moves the tip; null if no pen does."""
    tracked: bool
    """Whether the pen (stylus) reports its position and not only its orientation."""
    lps: Three | None
    """Position of the pen's tip in the patient, LPS mm; null if the pen is not registered to the patient.

    The button of a pen that is not registered marks the scope's tip. The position is updated while a pen is armed, and
    in absolute movement.
    """
    off_mm: float | None
    """Distance in mm between scope tip and pen while the pen positions the tip absolutely; else null."""
    off_deg: float | None
    """Angle in degrees between scope tip and pen while the pen positions the tip absolutely; else null."""
