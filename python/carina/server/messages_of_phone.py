"""Messages between the server and the page for a phone, on a socket of their own (``phone_page.py``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from carina.server.wire_codec import Length, Range
from carina.server.wire_fields import Words

__all__ = ["PhoneAct", "PhoneHello", "PhoneSample", "PhoneState"]

# Wide, as of every device: what a phone says too much is ignored and counted, and does not end the connection.
Wide = Annotated[float, Range(-1e300, 1e300)]
Four = Annotated[tuple[Wide, ...], Length(4, 4)]


@dataclass(frozen=True, slots=True)
class PhoneHello:
    """The first message of the page: the token of its link."""

    wire_type: ClassVar[str] = "phone_hello"
    wire_version: Annotated[int, Range(0, 2**31)]
    token: Annotated[str, Length(1, 200)]


@dataclass(frozen=True, slots=True)
class PhoneSample:
    """How the phone is turned and what is held on it; sent while something is held, and once after."""

    wire_type: ClassVar[str] = "phone_sample"
    time_s: Wide
    """The phone's clock."""
    orientation_wxyz: Four | None
    """``earth_from_pen``: right, down, forward, which is where the phone's upper edge points. Null without a sensor."""
    held: bool
    """The tip turns with the phone."""
    advance: Wide
    """-1 (back) to 1 (forward)."""


@dataclass(frozen=True, slots=True)
class PhoneAct:
    """A button of the page: look along the path again, or the next way to move."""

    wire_type: ClassVar[str] = "phone_act"
    action: Literal["recenter", "next_control"]


@dataclass(frozen=True, slots=True)
class PhoneState:
    """What the page shows; when it changes. Nothing of the patient is in it."""

    wire_type: ClassVar[str] = "phone_state"
    case_open: bool
    control: Literal["absolute", "relative", "path"]
    scope_held: bool
    holds: bool
    """The phone moves the tip."""
    words: Words
    """Why something was refused; empty where nothing was."""
