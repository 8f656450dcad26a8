"""Queue of the messages that the server has not yet sent to one window."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

from carina.server.wire import messages as wire
from carina.server.wire.codec import type_name

MAX_TEXTS = 2000
"""Maximum number of queued text messages; the server disconnects a window that exceeds it."""
MAX_PICTURES = 200
"""Maximum number of queued pictures; the queue grows if unacknowledged pictures count as lost."""
TOPICS = (
    "start",
    "opening",
    "state",
    "tree",
    "route",
    "plan",
    "training",
    "lungs",
    "key_frames",
    "flights",
    "history",
    "pose",
    "watching",
    "processor",
    "handled",
)
"""Topics in the order of sending: ``handled``, which reports finished commands, follows the results of the commands.
The session's topic ``views`` is absent, because it requests pictures instead of a message."""
NEWEST_ONLY = (
    wire.Value,
    wire.LivePathMessage,
    wire.BranchDetail,
    wire.EditPreviewMessage,
    wire.TargetMark,
    wire.DevicesMessage,
    wire.Pen,
    wire.Cluster,
)
"""Types of messages of which only the latest is sent: answers that follow the cursor, and repeated status messages."""


class Outbox:
    """Queue of unsent messages for one window; used from the event loop only.

    Of each topic only the latest message is sent.
    """

    def __init__(self) -> None:
        self._topics: set[str] = set()
        self._texts: deque[str] = deque()
        self._newest: dict[str, str] = {}
        self._pictures: deque[bytes] = deque()
        self._filled = asyncio.Event()
        self._sent: dict[str, str] = {}

    @property
    def overflowed(self) -> bool:
        """Whether the queue is over its limit, because the window reads too slowly or not at all."""
        return len(self._texts) > MAX_TEXTS or len(self._pictures) > MAX_PICTURES

    def record_if_changed(self, topic: str, text: str) -> bool:
        """Return whether the message of the topic differs from the last one sent, and record the message as sent."""
        if self._sent.get(topic) == text:
            return False
        self._sent[topic] = text
        return True

    def mark(self, *topics: str) -> None:
        """Mark topics whose message must be sent again; names outside :data:`TOPICS` are ignored."""
        self._topics.update(t for t in topics if t in TOPICS)
        self._filled.set()

    def push(self, message: Any) -> None:
        """Queue a message in order; of progress and of the types in :data:`NEWEST_ONLY` only the latest is sent."""
        if isinstance(message, wire.Progress):
            self._newest[f"job {message.job_id}"] = wire.encode_message(message)
        elif isinstance(message, NEWEST_ONLY):
            self._newest[str(type_name(type(message)))] = wire.encode_message(message)
        else:
            if isinstance(message, wire.Done):
                self._newest.pop(f"job {message.job_id}", None)
            self._texts.append(wire.encode_message(message))
        self._filled.set()

    def push_picture(self, data: bytes) -> None:
        """Queue an encoded picture; the acknowledgements of the client bound the number of pictures."""
        self._pictures.append(data)
        self._filled.set()

    async def wait_until_filled(self) -> None:
        """Wait until at least one message, topic or picture is queued."""
        await self._filled.wait()

    def take_all(self) -> tuple[list[str], list[str], list[bytes]]:
        """Remove and return the changed topics (in their order), the text messages and the pictures."""
        self._filled.clear()
        topics = [t for t in TOPICS if t in self._topics]
        texts = [*self._newest.values(), *self._texts]
        pictures = list(self._pictures)
        self._topics.clear()
        self._texts.clear()
        self._newest.clear()
        self._pictures.clear()
        return topics, texts, pictures
