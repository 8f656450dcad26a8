"""Messages about key frames, from the client and from the server."""

from __future__ import annotations

from carina.commands.fields import Identifier
from carina.server.wire.codec import ClientMessage, ServerMessage
from carina.session import KeyFramesInfo


class OpenKeyFrames(ClientMessage, frozen=True):
    """Request to load key frames from the file sent to ``/api/upload``; undoable."""

    upload_id: Identifier


class KeyFramesMessage(KeyFramesInfo, ServerMessage, frozen=True):
    """The key frames; sent after each change."""
