"""The window of an observer, perhaps on another machine: it changes nothing and receives nothing private."""

from __future__ import annotations

import asyncio
from typing import Any

from msgspec.structs import replace

from carina.commands import Command
from carina.errors import ProtocolError, UsageError
from carina.server import messages as wire
from carina.server.message_limits import FLOOD, FLOOD_WORDS, RateLimit
from carina.server.observer_texts import observer_error, observer_notes
from carina.server.window import Host, Window
from carina.session import Changed, Event
from carina.session.snapshot import SavingInfo

__all__ = ["WATCHERS_RATE_HZ", "WatchingWindow"]

WATCHERS_RATE_HZ = 30.0
"""Whoever flies needs the machine more."""
MAX_SIDE_PX = 1600
NOT_FOR_THIS_VOLUME = "not available for this volume"
FAILED_SEARCH = "no airways were found"
MESSAGES_PER_S = 600.0
"""Sustained. A page at 240 Hz that moves a crosshair sends 240 positions, 240 probes and 90 acknowledgements."""
MESSAGES_AT_ONCE = 1200.0
INBOX_SHARE = 0.05
"""Share of the event loop's time that an observer's messages may take: they cost up to a millisecond each."""
READ_ONLY = (wire.Ack, wire.Layout, wire.Probe, wire.Pick, wire.AskBranchDetail)
"""What it may ask beside commands, which the session itself refuses but for those of its own sight."""


class WatchingWindow(Window):
    """Sees the case that was open when it came, and no other."""

    watches = True

    inbox_share = INBOX_SHARE

    layers = ()

    def __init__(self, number: int, host: Host) -> None:
        super().__init__(number, host, rate_hz=WATCHERS_RATE_HZ)
        self._sent_away: str | None = None
        self._limit = RateLimit(MESSAGES_PER_S, MESSAGES_AT_ONCE, host.clock)

    async def admit(self) -> None:
        """Count a message, and let others have the event loop before the next one is parsed.

        Raises
        ------
        ProtocolError
            ``protocol.flood`` beyond the limit; the messages that wait are dropped.
        """
        if not self._limit.take():
            self.inbox.drop()
            raise ProtocolError(FLOOD_WORDS, code=FLOOD)
        await asyncio.sleep(0)

    def send_away(self, words: str) -> None:
        """End it for a reason; event loop only."""
        self._sent_away = words
        self.outbox.mark("state")

    @property
    def ended(self) -> str | None:
        """Asked when all that is to be sent has been read: it is of the case that may be seen, or is not sent."""
        if self._sent_away is None and self._session.snapshot(self.number).case is None:
            return "the case that you were watching was closed"
        return self._sent_away

    def restored(self, text: str) -> str:
        """Names of files are the person's own."""
        return text

    def topic_text(self, topic: str) -> str | None:
        """None of what is told to nobody else: the person's cases and recordings, and who watches."""
        match topic:
            case "start":
                return self._host.texts.watchers_start()
            case "watching" | "flights":
                return None
        return super().topic_text(topic)

    def _state(self) -> wire.State:
        """Return the state without folders, names of files, texts of series, and the name that the user gave.

        That name is the user's free text, which may be the patient's; the observer reads the neutral alias.
        """
        state = super()._state()
        case = state.case
        if case is not None:
            notes = observer_notes(case.notes)
            case = replace(
                case,
                notes=notes,
                warnings=tuple(note.words for note in notes),
                not_hu_reason=None,
                quality=(),
                other_series=(),
                # The reason quotes tags of the file.
                off=tuple(replace(one, why=NOT_FOR_THIS_VOLUME) for one in case.off),
                ct_name=None,
            )
        # A search that failed says why in the words of its error, which may name a file.
        airways_words = FAILED_SEARCH if state.airways == "failed" else state.airways_words
        return replace(
            state,
            case=case,
            badges=observer_notes(state.badges),
            airways_words=airways_words,
            saving=SavingInfo(),
            mask_question=None,
        )

    def _note(self, event: Event) -> None:
        """Pass changes alone: messages and errors concern the user at the workstation, and may name files."""
        if isinstance(event, Changed):
            super()._note(event)

    def push_error(self, error: wire.Error) -> None:
        """Send an error without its text where the text may name a file."""
        super().push_error(observer_error(error))

    def _do(self, message: Any) -> None:
        if not isinstance(message, (Command, *READ_ONLY)):
            raise UsageError(
                "you are watching; only the person at the workstation can do this", code="session.watching"
            )
        super()._do(_smaller(message) if isinstance(message, wire.Layout) else message)


def _smaller(layout: wire.Layout) -> wire.Layout:
    """Pictures that whoever flies does not feel; the page stretches them."""
    views = []
    for view in layout.views:
        scale = min(1.0, MAX_SIDE_PX / max(view.width, view.height))
        width, height = (max(16, round(side * scale)) for side in (view.width, view.height))
        views.append(replace(view, width=width, height=height))
    return replace(layout, views=tuple(views))
