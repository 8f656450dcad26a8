"""Messages that are the same for every window: written once, a tree in a thread of its own."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from carina.commands import LungsOf, PlanningOf
from carina.errors import UsageError
from carina.server import messages as wire
from carina.server.lung_words import lungs_message
from carina.server.outbox import Outbox
from carina.server.plan_words import plans_message
from carina.server.presenter import key_frames_message, route_message, start_message
from carina.server.tree_words import tree_message
from carina.session import Session, log_fault
from carina.volume import Citation

__all__ = ["SharedTexts"]

logger = logging.getLogger(__name__)


class SharedTexts:
    """The texts of the topics that do not depend on the window; event loop only.

    Parameters
    ----------
    session
        What they tell of.
    patient_citation
        Of the bundled patient, for the start page.
    tell
        Tells all windows what could not be written.
    """

    def __init__(self, session: Session, patient_citation: Citation | None, tell: Callable[[Any], None]) -> None:
        self._session = session
        self._patient_citation = patient_citation
        self._tell = tell
        self._known: dict[str, tuple[tuple[object, ...], str]] = {}
        self._writing: asyncio.Task[None] | None = None
        self._waiting: dict[Outbox, set[str]] = {}
        """What each window is to be sent once the tree has been written."""
        self._unwritable: tuple[Any, Any] | None = None
        """The tree that could not be written: nothing waits for it."""

    def mark(self, outbox: Outbox, *topics: str) -> None:
        """Send a window these topics anew.

        A tree of some hundred branches takes a third of a second to write: it and the route through it follow, while
        poses and pictures go on.
        """
        waits: set[str] = set()
        if "tree" in topics and (self._writing is not None or not self._is_known("tree", *self._newest_tree())):
            # The route, too, where it was not marked: one that was asked for too early was held back.
            waits = {"tree", "route"}
        elif self._writing is not None:
            waits = {"route"} & set(topics)
        outbox.mark(*(t for t in topics if t not in waits))
        if waits:
            self._waiting.setdefault(outbox, set()).update(waits)
            if self._writing is None:
                self._writing = asyncio.get_running_loop().create_task(self._write_tree())

    def start(self) -> str:
        """What the start page shows."""
        store, cases = self._session.store, self._session.cases
        return wire.encode_message(
            start_message(
                notice_accepted=store is not None and store.notice_accepted(),
                recent=cases.listed(),
                patient_citation=self._patient_citation,
                storage=cases.storage(),
            )
        )

    def watchers_start(self) -> str:
        """The same for who only watches: none of the person's cases."""
        return wire.encode_message(
            start_message(notice_accepted=True, recent=(), patient_citation=self._patient_citation, storage=None)
        )

    def tree(self) -> str | None:
        """None where the newest is still to be written: it is marked then."""
        return self._tree_text() if self._is_known("tree", *self._newest_tree()) else None

    def route(self) -> str | None:
        """The present route; None where it leads through a tree that is still to be written: both are marked then.

        A mark that is older than the tree asks for it, too, and finds the route through the new one.
        """
        # One look for both: a document that comes between two has a route through another tree.
        snapshot = self._session.snapshot()
        newest, document = _tree_of(snapshot), snapshot.document
        if not self._is_known("tree", *newest) and not _are_same(newest, self._unwritable):
            return None
        route = None if document is None else document.route
        return self._cached("route", lambda: route_message(route), route)

    def key_frames(self) -> str:
        """The key frames."""
        return wire.encode_message(key_frames_message(self._session.key_frames_info()))

    def plans(self) -> str:
        """The plans of the open case; none without one, so that those of the next are news."""
        try:
            info = self._session.ask(PlanningOf())
        except UsageError:
            # No case is open, or it has just been closed.
            return wire.encode_message(wire.Plans((), "unwanted", (), "unwanted", ()))
        planned = (value for one in info.targets for value in (one.target, one.planned))
        shown = (info.document.route, info.standing, info.verdicts_standing, info.verdicts, info.turns)
        state = (*shown, info.dicom_problem)
        return self._cached("plan", lambda: plans_message(info), *state, *planned)

    def lungs(self) -> str:
        """What was mapped of the open case's lungs."""
        try:
            info = self._session.ask(LungsOf())
        except UsageError:
            return wire.encode_message(wire.Lungs("unwanted", "unwanted", (), (), (), "", (), False))
        made = (info.lungs, info.reach, info.stations, info.outdated)
        standing = (info.standing, info.problem, info.reach_standing, info.reach_problem)
        return self._cached("lungs", lambda: lungs_message(info), *made, *standing)

    def flights(self) -> str:
        """What was recorded into the case."""
        return wire.encode_message(wire.Flights(self._session.snapshot().flights))

    def _tree_text(self) -> str:
        """From any thread."""
        airways, measures = self._newest_tree()
        return self._cached("tree", lambda: tree_message(airways, measures), airways, measures)

    def _newest_tree(self) -> tuple[Any, Any]:
        return _tree_of(self._session.snapshot())

    async def _write_tree(self) -> None:
        is_written = False
        try:
            # What is marked meanwhile may be of a newer tree.
            known = None
            while known != (known := await asyncio.to_thread(self._tree_text)):
                pass
            is_written = True
        except Exception as trouble:
            self._unwritable = self._newest_tree()
            log_fault(logger, "the airway tree could not be prepared for the window", trouble)
            words = f"the airway tree cannot be shown: internal error in Carina ({type(trouble).__name__})"
            self._tell(wire.Error("carina.fault", words, None))
        finally:
            self._writing = None
            waiting, self._waiting = self._waiting, {}
            for outbox, topics in waiting.items():
                if is_written:
                    # A tree may have come since the last look: it is written, too, before a route through it goes.
                    self.mark(outbox, *topics)
                else:
                    outbox.mark(*topics)

    def _cached(self, topic: str, message: Callable[[], Any], *values: object) -> str:
        """A tree is some hundred kilobytes and changes rarely; every change and every new window asks for it."""
        if not self._is_known(topic, *values):
            self._known[topic] = (values, wire.encode_message(message()))
        return self._known[topic][1]

    def _is_known(self, topic: str, *values: object) -> bool:
        known = self._known.get(topic)
        return known is not None and _are_same(values, known[0])


def _tree_of(snapshot: Any) -> tuple[Any, Any]:
    """The airways that are shown, and their measures."""
    airways = None if snapshot.document is None else snapshot.document.airways
    return airways, getattr(snapshot, "measures", None)


def _are_same(values: tuple[object, ...], others: tuple[object, ...] | None) -> bool:
    """One by one the same objects, not equal ones."""
    if others is None or len(values) != len(others):
        return False
    return all(a is b for a, b in zip(values, others, strict=True))
