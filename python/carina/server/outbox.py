"""What waits to be sent to one window."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

from carina.server import messages as wire
from carina.server.wire_codec import type_name

__all__ = ["Outbox"]

MAX_TEXTS = 2000
"""Text messages waiting for a window that does not read; beyond it is cut off."""
MAX_PICTURES = 200
"""The same of pictures: those that are not acknowledged count as lost after a while, and others follow."""
TOPICS = (
    "start",
    "state",
    "tree",
    "route",
    "plan",
    "lungs",
    "key_frames",
    "flights",
    "history",
    "pose",
    "watching",
    "handled",
)
"""In the order in which they are sent: what was done is said after what came of it. The session's ``views`` is not
among them: it asks for pictures."""
NEWEST_ONLY = (wire.Value, wire.LivePath, wire.BranchDetail, wire.EditPreview, wire.Devices, wire.Pen, wire.Cluster)
"""Messages of which only the newest matters: answers to a cursor, and what is told again and again."""


class Outbox:
    """What waits to be sent to one window; event loop only. Topics coalesce: only their newest message is ever sent."""

    def __init__(self) -> None:
        self._topics: set[str] = set()
        self._texts: deque[str] = deque()
        self._newest: dict[str, str] = {}
        self._pictures: deque[bytes] = deque()
        self._filled = asyncio.Event()
        self._sent: dict[str, str] = {}

    @property
    def overflowed(self) -> bool:
        """The window reads too slowly, or not at all."""
        return len(self._texts) > MAX_TEXTS or len(self._pictures) > MAX_PICTURES

    def is_news(self, topic: str, text: str) -> bool:
        """Whether the topic's message differs from the last one sent; notes it as sent."""
        if self._sent.get(topic) == text:
            return False
        self._sent[topic] = text
        return True

    def mark(self, *topics: str) -> None:
        """The topic's message must be sent anew."""
        self._topics.update(t for t in topics if t in TOPICS)
        self._filled.set()

    def push(self, message: Any) -> None:
        """A message that must arrive as it is, in order; of progress and answers to a cursor only the newest."""
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
        """A picture; their number is bounded by the acknowledgements."""
        self._pictures.append(data)
        self._filled.set()

    async def filled(self) -> None:
        """Wait until there is something to take."""
        await self._filled.wait()

    def take(self) -> tuple[list[str], list[str], list[bytes]]:
        """The changed topics (in their order), the texts and the pictures."""
        self._filled.clear()
        topics = [t for t in TOPICS if t in self._topics]
        texts = [*self._newest.values(), *self._texts]
        pictures = list(self._pictures)
        self._topics.clear()
        self._texts.clear()
        self._newest.clear()
        self._pictures.clear()
        return topics, texts, pictures
