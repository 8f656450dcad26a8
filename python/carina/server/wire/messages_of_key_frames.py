"""Messages about key frames, both ways."""

from __future__ import annotations

from carina.commands.fields import Identifier
from carina.server.wire.codec import ClientMessage, ServerMessage
from carina.session import KeyFramesInfo


class OpenKeyFrames(ClientMessage, frozen=True):
    """Take the key frames of the file sent to ``/api/upload``; undoable."""

    upload_id: Identifier


class KeyFrames(KeyFramesInfo, ServerMessage, frozen=True):
    """The key frames, when they changed."""
