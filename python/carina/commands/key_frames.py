"""Commands on key frames: the list, the flight through it, and its file."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from msgspec import Meta

from carina.commands.fields import Identifier, OwnName, Through
from carina.commands.value import Command, FrozenValue, LocalCommand

MIN_SPEED_MM_S, MAX_SPEED_MM_S = 0.1, 500.0
Speed = Annotated[float, Meta(ge=MIN_SPEED_MM_S, le=MAX_SPEED_MM_S)]
Seconds = Annotated[float, Meta(ge=0.0, le=86_400.0)]


def _edit_kind(name: str) -> str:
    """Return the wire name of an edit: ``KeyFrameAdd`` gives ``add``."""
    return name.removeprefix("KeyFrame").lower()


class KeyFrameEdit(FrozenValue, frozen=True, tag_field="kind", tag=_edit_kind):
    """One change to the list of key frames."""


class KeyFrameAdd(KeyFrameEdit, frozen=True):
    """Append the present pose as the last key frame."""


class KeyFrameUpdate(KeyFrameEdit, frozen=True):
    """Replace the pose of a key frame by the present pose."""

    key_id: Identifier


class KeyFrameMove(KeyFrameEdit, frozen=True):
    """Move a key frame earlier (below 0) or later in the order."""

    key_id: Identifier
    by: Annotated[int, Meta(ge=-200, le=200)]


class KeyFrameRename(KeyFrameEdit, frozen=True):
    """Rename a key frame; null uses the name of its branch."""

    key_id: Identifier
    name: OwnName | None


class KeyFrameSpeed(KeyFrameEdit, frozen=True):
    """Set the speed of the leg to a key frame; null uses the speed of the flight."""

    key_id: Identifier
    speed_mm_s: Speed | None


class KeyFrameRemove(KeyFrameEdit, frozen=True):
    """Delete a key frame from the flight."""

    key_id: Identifier


AnyKeyFrameEdit: TypeAlias = (
    KeyFrameAdd | KeyFrameUpdate | KeyFrameMove | KeyFrameRename | KeyFrameSpeed | KeyFrameRemove
)


class EditKeyFrames(Command, frozen=True):
    """Change the list of key frames; each command is one step of undo."""

    edit: AnyKeyFrameEdit


class KeyFrameFlying(FrozenValue, frozen=True):
    """Settings of the flight through the key frames."""

    speed_mm_s: Speed
    """Speed on legs without their own speed."""
    through: Through


class SetKeyFrameFlight(Command, frozen=True):
    """Set how the flight passes through the key frames; null keeps a setting. Undoable."""

    speed_mm_s: Speed | None = None
    through: Through | None = None


class ShowKeyFrame(Command, frozen=True):
    """Set the tip to the pose of a key frame and enter free mode."""

    key_id: Identifier


class FlyKeyFrames(Command, frozen=True):
    """Set the tip to its pose at a time of the flight through the key frames and enter free mode."""

    time_s: Seconds
    goes_on: bool = False
    """Whether the command continues a running flight: it is ignored if another command has moved the tip meanwhile."""


class TakeKeyFrameFile(LocalCommand, frozen=True):
    """Replace the key frames by those of a file; undoable. Key frames of another case are rejected."""

    path: Any
    """Path of the file, text or :class:`pathlib.Path`."""
