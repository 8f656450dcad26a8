"""Messages between the server and the page for a phone, on a socket of their own (``phone_page.py``)."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import Wide, Words
from carina.server.wire.codec import PhoneMessage, ToPhoneMessage

# These bounds are wide, because invalid values of a phone are ignored and counted; they do not end the connection.
Four = tuple[Wide, Wide, Wide, Wide]


class PhoneHello(PhoneMessage, frozen=True):
    """The first message of the page: the token of its link."""

    wire_version: Annotated[int, Meta(ge=0, le=2**31)]
    token: Annotated[str, Meta(min_length=1, max_length=200)]


class PhoneSample(PhoneMessage, frozen=True):
    """Orientation and pressed controls of the phone; sent while a control is pressed, and once after its release."""

    time_s: Wide
    """Time stamp of the phone's clock."""
    orientation_wxyz: Four | None
    """``earth_from_pen``, with the axes right, down and forward (the phone's upper edge); null without a sensor."""
    held: bool
    """Whether the user holds the button with which the phone's rotation turns the tip."""
    advance: Wide
    """Movement along the airway: -1 (full speed back) to 1 (full speed forward)."""


class PhoneAct(PhoneMessage, frozen=True):
    """Action of a button of the page: look along the path again, or change to the next control mode."""

    action: Literal["recenter", "next_control"]


class PhoneState(ToPhoneMessage, frozen=True):
    """State that the page shows, sent after each change; it contains no patient data."""

    case_open: bool
    control: Literal["absolute", "relative", "path"]
    scope_held: bool
    holds: bool
    """Whether the phone moves the tip."""
    words: Words
    """Reason of a refused action; empty if no action was refused."""
