"""Messages about key frames, both ways."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from carina.navigate import MAX_SPEED_MM_S, MIN_SPEED_MM_S
from carina.server.wire_codec import Length, Range
from carina.server.wire_fields import BranchId, Key, Words

__all__ = [
    "EditKeys",
    "FlyKeys",
    "KeyAdd",
    "KeyFrame",
    "KeyMove",
    "KeyRemove",
    "KeyRename",
    "KeySpeed",
    "KeyUpdate",
    "Keys",
    "OpenKeys",
    "SetKeyFlight",
    "ShowKey",
]

Speed = Annotated[float, Range(MIN_SPEED_MM_S, MAX_SPEED_MM_S)]
Seconds = Annotated[float, Range(0.0, 86_400.0)]
Through = Literal["airways", "space"]


@dataclass(frozen=True, slots=True)
class KeyAdd:
    """The present pose becomes the last key frame."""

    kind: Literal["add"]


@dataclass(frozen=True, slots=True)
class KeyUpdate:
    """The present pose takes a key frame's place."""

    kind: Literal["update"]
    key_id: Key


@dataclass(frozen=True, slots=True)
class KeyMove:
    """Earlier (below 0) or later in the order."""

    kind: Literal["move"]
    key_id: Key
    by: Annotated[int, Range(-200, 200)]


@dataclass(frozen=True, slots=True)
class KeyRename:
    """A name of one's own; null calls it by its branch."""

    kind: Literal["rename"]
    key_id: Key
    name: Annotated[str, Length(1, 80)] | None


@dataclass(frozen=True, slots=True)
class KeySpeed:
    """The speed on the way to a key frame; null takes that of all."""

    kind: Literal["speed"]
    key_id: Key
    speed_mm_s: Speed | None


@dataclass(frozen=True, slots=True)
class KeyRemove:
    """Take a key frame away."""

    kind: Literal["remove"]
    key_id: Key


@dataclass(frozen=True, slots=True)
class EditKeys:
    """One change to the list of key frames, and one step of undo."""

    wire_type: ClassVar[str] = "edit_keys"
    edit: KeyAdd | KeyUpdate | KeyMove | KeyRename | KeySpeed | KeyRemove


@dataclass(frozen=True, slots=True)
class SetKeyFlight:
    """How the key frames are flown through; null keeps what there is. Undoable."""

    wire_type: ClassVar[str] = "set_key_flight"
    speed_mm_s: Speed | None
    through: Through | None


@dataclass(frozen=True, slots=True)
class ShowKey:
    """Tip to a key frame; free mode afterwards."""

    wire_type: ClassVar[str] = "show_key"
    key_id: Key


@dataclass(frozen=True, slots=True)
class FlyKeys:
    """Tip to a time of the flight through the key frames; free mode afterwards."""

    wire_type: ClassVar[str] = "fly_keys"
    time_s: Seconds
    goes_on: bool
    """A flight under way: ignored if anything else has moved the tip since the last of these."""


@dataclass(frozen=True, slots=True)
class OpenKeys:
    """Take the key frames of the file sent to ``/api/upload``; undoable."""

    wire_type: ClassVar[str] = "open_keys"
    upload_id: Key


@dataclass(frozen=True, slots=True)
class KeyFrame:
    """A pose to fly through."""

    key_id: Key
    name: Words
    """As a person called it, or its branch."""
    own_name: bool
    branch_id: BranchId | None
    """The branch that it lies in."""
    speed_mm_s: float | None
    """On the way here; null takes that of all."""
    time_s: float
    """When the flight passes it."""
    leg_mm: float | None
    """Length of the way here; null for the first."""
    through_airways: bool
    """Whether that way follows the airways."""


@dataclass(frozen=True, slots=True)
class Keys:
    """The key frames, when they changed."""

    wire_type: ClassVar[str] = "keys"
    keys: tuple[KeyFrame, ...]
    speed_mm_s: float
    through: Through
    duration_s: float
    """0 while there are fewer than two."""
    problem: Words | None
    """Why they cannot be flown."""
