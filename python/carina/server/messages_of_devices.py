"""Messages about input devices and recordings, both ways."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.devices import DeviceControls
from carina.commands.fields import Control, Count, DeviceName, Three, Wide, Words
from carina.commands.value import FrozenValue
from carina.server.wire_codec import ClientMessage, ServerMessage
from carina.session import FlightInfo

Four = tuple[Wide, Wide, Wide, Wide]
Six = Annotated[tuple[Wide, ...], Meta(min_length=6, max_length=6)]
Buttons = Annotated[int, Meta(ge=0, le=2**32 - 1)]


class DeviceReading(FrozenValue, frozen=True):
    """Where a device says that it is, and which of its buttons are held."""

    device: DeviceName
    position_mm: Three | None
    """In the device's own space; null for a device that knows only how it is turned."""
    orientation_wxyz: Four | None
    """``device_from_pen``; the pen's axes are right, down, forward."""
    buttons: Buttons


class DeviceSample(DeviceReading, ClientMessage, frozen=True):
    """What a device of the window says.

    Second check: an orientation (with a position or without), axes, or a scope handle's controls.
    """

    time_s: Wide
    """The device's clock, or the page's."""
    axes: Six | None
    """Forward, right, up, yaw right, pitch up, roll clockwise, -1 to 1 of full speed."""
    handle: Three | None
    """Insertion in mm, roll in rad, lever -1 to 1 (1 is fully down, which bends the tip up)."""
    advance: Wide
    """Beside an orientation: how far a forward key or stick is pushed, -1 to 1 of full speed."""

    def choice_problem(self) -> str | None:
        """One of three kinds, and a position only with an orientation."""
        kinds = (self.orientation_wxyz, self.axes, self.handle)
        if sum(kind is not None for kind in kinds) != 1:
            return "device_sample needs an orientation, axes or a handle"
        if self.position_mm is not None and self.orientation_wxyz is None:
            return "device_sample has a position without an orientation"
        return None


class ConnectDevice(ClientMessage, frozen=True):
    """Connect to a device of this machine by kind and place, such as fastrak:PORT or openigtlink:HOST:PORT."""

    address: DeviceName


class DisconnectDevice(ClientMessage, frozen=True):
    """End that connection."""

    address: DeviceName


class PublishTip(ClientMessage, frozen=True):
    """Publish the tip by OpenIGTLink on this port of this machine (0: a free one); null ends it."""

    port: Annotated[int, Meta(ge=0, le=65_535)] | None


class SetPhone(ClientMessage, frozen=True):
    """Open the page for a phone to this machine's network, with a new certificate and link, or close it."""

    on: bool


class WatchDevices(ClientMessage, frozen=True):
    """Send ``devices`` a few times a second, or only when something changes."""

    on: bool


class StartRecording(ClientMessage, frozen=True):
    """Record the flight into the case; to a file of this machine where the case is not kept."""


class Flights(ServerMessage, frozen=True):
    """What was recorded into the case, in its order; when it changed."""

    flights: Annotated[tuple[FlightInfo, ...], Meta(max_length=100_000)]


class DeviceInfo(DeviceReading, frozen=True):
    """A device that said something; its position is filtered."""

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
    axes: Annotated[tuple[Wide, ...], Meta(max_length=6)]
    """Of sticks; insertion in mm, roll in rad and lever of a handle."""


class DeviceSource(FrozenValue, frozen=True):
    """A connection of this machine to a device."""

    address: DeviceName
    title: Words
    state: Literal["connecting", "live", "lost", "stopped"]
    words: Words
    rate_hz: float
    num_bad: Count


class NetworkPage(FrozenValue, frozen=True, kw_only=True):
    """A page that is open to the local network."""

    url: Words
    """With the token: whoever has it may do what the page is for."""
    address: Words
    sha256: Words
    """Of the certificate, as browsers show it."""
    num_refused: Count
    """Connections with a wrong token."""


class PhoneInfo(NetworkPage, frozen=True, kw_only=True):
    """The page for a phone while it is open to the network; it moves the tip."""

    qr: Annotated[tuple[Words, ...], Meta(max_length=200)]
    """The link as a QR code: rows of 0 (light) and 1 (dark)."""
    connected: bool
    rate_hz: float
    num_bad: Count
    bad_words: Words


class Devices(ServerMessage, frozen=True):
    """Input devices, how they move the tip, and what is recorded."""

    control: Control
    filter_latency_ms: float
    """At rest: the most that the filter delays."""
    controls: DeviceControls
    devices: Annotated[tuple[DeviceInfo, ...], Meta(max_length=200)]
    sources: Annotated[tuple[DeviceSource, ...], Meta(max_length=50)]
    serial_ports: Annotated[tuple[Words, ...], Meta(max_length=200)]
    serial_problem: Words | None
    """Why devices at serial ports cannot be used."""
    published_port: Annotated[int, Meta(ge=0, le=65_535)] | None
    recording: Words | None
    """What is being recorded: the flight's name, or the file that it goes to."""
    phone: PhoneInfo | None
    """Null while the page for a phone is closed."""
    phone_problem: Words | None
    """Why it cannot be opened on this machine."""


class StartMarked(ServerMessage, frozen=True):
    """The pen's button marked where paths begin that need no airways (``arm_pen``, ``add_target``)."""

    lps: Three


class Pen(ServerMessage, frozen=True):
    """The tracked pen that moves the tip, and the point that its button marks; whenever one of them changed."""

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
