"""Commands on key frames: the list, the flight through it, and its file."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from msgspec import Meta

from carina.commands.fields import Identifier, OwnName, Through
from carina.commands.value import Command, FrozenValue, LocalCommand

MIN_SPEED_MM_S, MAX_SPEED_MM_S = 0.1, 500.0
Speed = Annotated[float, Meta(ge=MIN_SPEED_MM_S, le=MAX_SPEED_MM_S)]
Seconds = Annotated[float, Meta(ge=0.0, le=86_400.0)]


def _kind(name: str) -> str:
    """Return the wire name of an edit: ``KeyFrameAdd`` gives ``add``."""
    return name.removeprefix("KeyFrame").lower()


class KeyFrameEdit(FrozenValue, frozen=True, tag_field="kind", tag=_kind):
    """One change to the list of key frames."""


class KeyFrameAdd(KeyFrameEdit, frozen=True):
    """The present pose becomes the last key frame."""


class KeyFrameUpdate(KeyFrameEdit, frozen=True):
    """The present pose takes a key frame's place."""

    key_id: Identifier


class KeyFrameMove(KeyFrameEdit, frozen=True):
    """Earlier (below 0) or later in the order."""

    key_id: Identifier
    by: Annotated[int, Meta(ge=-200, le=200)]


class KeyFrameRename(KeyFrameEdit, frozen=True):
    """A name of one's own; null calls it by its branch."""

    key_id: Identifier
    name: OwnName | None


class KeyFrameSpeed(KeyFrameEdit, frozen=True):
    """The speed on the way to a key frame; null takes that of all."""

    key_id: Identifier
    speed_mm_s: Speed | None


class KeyFrameRemove(KeyFrameEdit, frozen=True):
    """Take a key frame away."""

    key_id: Identifier


AnyKeyFrameEdit: TypeAlias = (
    KeyFrameAdd | KeyFrameUpdate | KeyFrameMove | KeyFrameRename | KeyFrameSpeed | KeyFrameRemove
)


class EditKeyFrames(Command, frozen=True):
    """One change to the list of key frames, and one step of undo."""

    edit: AnyKeyFrameEdit


class KeyFrameFlying(FrozenValue, frozen=True):
    """Settings of the flight through the key frames."""

    speed_mm_s: Speed
    """Speed on legs without their own speed."""
    through: Through


class SetKeyFrameFlight(Command, frozen=True):
    """How the key frames are flown through; null keeps what there is. Undoable."""

    speed_mm_s: Speed | None = None
    through: Through | None = None


class ShowKeyFrame(Command, frozen=True):
    """Tip to a key frame; free mode afterwards."""

    key_id: Identifier


class FlyKeyFrames(Command, frozen=True):
    """Tip to a time of the flight through the key frames; free mode afterwards."""

    time_s: Seconds
    goes_on: bool = False
    """Whether the command continues a running flight: it is ignored if another command has moved the tip meanwhile."""


class TakeKeyFrameFile(LocalCommand, frozen=True):
    """Replace the key frames by those of a file; undoable. Key frames of another case are rejected."""

    path: Any
    """Path of the file, text or :class:`pathlib.Path`."""
