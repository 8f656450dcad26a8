"""The window of an observer, who cannot change the case and receives no private data."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from msgspec.structs import replace

from carina.commands import Command
from carina.errors import ProtocolError, UsageError
from carina.server.sockets.rate_limits import FLOOD, FLOOD_WORDS, RateLimit
from carina.server.windows.window import Host, Window
from carina.server.wire import messages as wire
from carina.session import Changed, ChestMoved, Event
from carina.session.state.snapshot import SavingInfo
from carina.volume.note_privacy import words_without_names

ERRORS_WITHOUT_NAMES = frozenset({"session.watching", "session.pick", "session.no-case"})


def observer_notes(notes: Sequence[wire.CaseNote]) -> tuple[wire.CaseNote, ...]:
    """Return the permanent notes of the case, without file names in their texts."""
    return tuple(replace(note, words=_note_text(note)) for note in notes if note.badge)


def _note_text(note: wire.CaseNote) -> str:
    request = f"the scan check found a problem ({note.code}): ask the person at the workstation for the details"
    return words_without_names(note.code, note.words) or request


def observer_error(error: wire.Error) -> wire.Error:
    """Return an error for an observer: its code, and its text only if the text cannot contain a file name."""
    if error.code in ERRORS_WITHOUT_NAMES:
        return error
    return replace(error, message=f"this is not available to observers ({error.code})", action=None)


WATCHERS_RATE_HZ = 30.0
"""Frame rate of observers; it is limited to leave processor time to the windows that navigate."""
MAX_SIDE_PX = 1600
NOT_FOR_THIS_VOLUME = "not available for this volume"
FAILED_SEARCH = "no airways were found"
MESSAGES_PER_S = 600.0
"""Sustained message limit. With a moving crosshair a 240 Hz page sends 240 positions, 240 probes and 90 acks per s."""
MESSAGES_AT_ONCE = 1200.0
INBOX_SHARE = 0.05
"""Maximum share of the event loop's time for messages of an observer; one message takes up to a millisecond."""
READ_ONLY = (wire.Ack, wire.Layout, wire.Probe, wire.Pick, wire.AskBranchDetail)
"""Types of messages, besides commands, that an observer may send; the session refuses commands on other views."""


class WatchingWindow(Window):
    """Window of an observer: it shows only the case that was open when the observer connected."""

    watches = True

    inbox_share = INBOX_SHARE

    layers = ()

    def __init__(self, number: int, host: Host) -> None:
        super().__init__(number, host, rate_hz=WATCHERS_RATE_HZ)
        self._sent_away: str | None = None
        self._limit = RateLimit(MESSAGES_PER_S, MESSAGES_AT_ONCE, host.clock)

    async def admit(self) -> None:
        """Count a message, and yield to other tasks of the event loop before the next message is parsed.

        Raises
        ------
        ProtocolError
            With code ``protocol.flood`` above the message limit; the queued messages are then dropped.
        """
        if not self._limit.allow():
            self.inbox.clear()
            raise ProtocolError(FLOOD_WORDS, code=FLOOD)
        await asyncio.sleep(0)

    def disconnect(self, words: str) -> None:
        """Disconnect the observer, and send the reason ``words``; call this method in the event loop."""
        self._sent_away = words
        self.outbox.mark("state")

    @property
    def end_reason(self) -> str | None:
        """Reason why nothing more may be sent; None while the observed case is open.

        The sender reads this property after it has read a message and before it sends the message, so that no message
        about another case is sent.
        """
        if self._sent_away is None and self._session.snapshot(self.number).case is None:
            return "the case that you were watching was closed"
        return self._sent_away

    def with_original_names(self, text: str) -> str:
        """Return the text unchanged, because original file names are not sent to observers."""
        return text

    def topic_text(self, topic: str) -> str | None:
        """Return the newest message of a topic as JSON; None for private topics.

        Recorded flights, the list of observers and a CT that is being opened are private. The start message omits the
        cases of the user. The training omits the learners, unless the user shares their pseudonyms and scores with a
        teacher.
        """
        match topic:
            case "start":
                return self._host.texts.watchers_start()
            case "training":
                return self._host.texts.observed_training(with_learners=self._host.shares_learners)
            case "watching" | "flights" | "processor" | "opening":
                return None
        return super().topic_text(topic)

    def _state(self) -> wire.State:
        """Return the state message without folders, file names, series texts and the user's name of the case.

        The user may have named the case after the patient, so the observer receives the neutral alias of the case.
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
                statement=None,
                other_series=(),
                series=None,
                # The original reason quotes DICOM tags of the file.
                off=tuple(replace(one, why=NOT_FOR_THIS_VOLUME) for one in case.off),
                ct_name=None,
            )
        # The original error text of a failed airway search may contain a file name.
        airways_words = FAILED_SEARCH if state.airways == "failed" else state.airways_words
        return replace(
            state,
            case=case,
            badges=observer_notes(state.badges),
            airways_words=airways_words,
            saving=SavingInfo(),
            mask_question=None,
        )

    def _handle_event(self, event: Event) -> None:
        """Process session events about changes and movements only.

        Messages and errors may name files and are not sent to observers.
        """
        if isinstance(event, Changed | ChestMoved):
            super()._handle_event(event)

    def push_error(self, error: wire.Error) -> None:
        """Send an error without its text where the text may name a file."""
        super().push_error(observer_error(error))

    def _do(self, message: Any) -> None:
        if not isinstance(message, (Command, *READ_ONLY)):
            raise UsageError(
                "you are watching; only the person at the workstation can do this", code="session.watching"
            )
        super()._do(_limited_layout(message) if isinstance(message, wire.Layout) else message)


def _limited_layout(layout: wire.Layout) -> wire.Layout:
    """Return the layout with each picture limited to 1600 pixels per side; the page enlarges the pictures."""
    views = []
    for view in layout.views:
        scale = min(1.0, MAX_SIDE_PX / max(view.width, view.height))
        width, height = (max(16, round(side * scale)) for side in (view.width, view.height))
        views.append(replace(view, width=width, height=height))
    return replace(layout, views=tuple(views))
