"""Messages about key frames, both ways."""

from __future__ import annotations

from carina.commands.fields import BranchId, Key, Through, Words
from carina.commands.value import FrozenValue
from carina.server.wire_codec import ClientMessage, ServerMessage


class OpenKeys(ClientMessage, frozen=True):
    """Take the key frames of the file sent to ``/api/upload``; undoable."""

    upload_id: Key


class KeyFrame(FrozenValue, frozen=True):
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


class Keys(ServerMessage, frozen=True):
    """The key frames, when they changed."""

    keys: tuple[KeyFrame, ...]
    speed_mm_s: float
    through: Through
    duration_s: float
    """0 while there are fewer than two."""
    problem: Words | None
    """Why they cannot be flown."""
