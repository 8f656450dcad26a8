"""Cache of encoded messages that are the same for every window; the airway tree is encoded in a thread."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from carina.commands import ClassroomOf, LungsOf, PlanningOf, TrainingOf
from carina.errors import UsageError
from carina.export.video import video_problem
from carina.server.to_wire.lungs import lungs_message
from carina.server.to_wire.plan import plans_message
from carina.server.to_wire.session import key_frames_message, route_message, start_message
from carina.server.to_wire.tree import tree_message
from carina.server.windows.outbox import Outbox
from carina.server.wire import messages as wire
from carina.session import CourseInfo, Session, TrainingInfo, log_fault
from carina.volume import Citation

logger = logging.getLogger(__name__)


class SharedTexts:
    """Cache of the encoded messages of the topics that do not depend on the window; used from the event loop only.

    Parameters
    ----------
    session
        Session whose state the messages describe.
    patient_citation
        Citation of the bundled patient, for the start page.
    send
        Sends an error message to all windows if a tree cannot be encoded.
    """

    def __init__(self, session: Session, patient_citation: Citation | None, send: Callable[[Any], None]) -> None:
        self._session = session
        self._patient_citation = patient_citation
        self._send = send
        self._known: dict[str, tuple[tuple[object, ...], str]] = {}
        self._observed: tuple[wire.TrainingMessage, str, str] | None = None
        """Latest training for observers: message, encoded learners, and text, which all observers receive."""
        self._writing: asyncio.Task[None] | None = None
        self._waiting: dict[Outbox, set[str]] = {}
        """Topics of each window's outbox that are sent after the tree has been encoded."""
        self._unwritable: tuple[Any, Any] | None = None
        """Airways and measures whose tree could not be encoded; no topic waits for this tree."""

    def mark(self, outbox: Outbox, *topics: str) -> None:
        """Send the given topics to a window again.

        Encoding a tree of some hundred branches takes a third of a second. The topics ``tree`` and ``route`` are
        therefore marked after the encoding in a thread, while poses and pictures are sent without delay.
        """
        waits: set[str] = set()
        if "tree" in topics and (self._writing is not None or not self._is_cached("tree", *self._latest_tree())):
            # The route is included even if it is not marked, because route() returned None while the tree was missing.
            waits = {"tree", "route"}
        elif self._writing is not None:
            waits = {"route"} & set(topics)
        outbox.mark(*(t for t in topics if t not in waits))
        if waits:
            self._waiting.setdefault(outbox, set()).update(waits)
            if self._writing is None:
                self._writing = asyncio.get_running_loop().create_task(self._write_tree())

    def start(self) -> str:
        """Return the encoded content of the start page."""
        store, cases = self._session.store, self._session.cases
        return wire.encode_message(
            start_message(
                notice_accepted=store is not None and store.notice_accepted(),
                recent=cases.listed(),
                patient_citation=self._patient_citation,
                storage=cases.storage(),
                no_video=video_problem(),
                # Without a store nothing could be remembered, and the hints would return in each window.
                hints_read=store is None or store.hints_read(),
            )
        )

    def watchers_start(self) -> str:
        """Return the encoded start page for a watching window, without the user's cases."""
        return wire.encode_message(
            start_message(notice_accepted=True, recent=(), patient_citation=self._patient_citation, storage=None)
        )

    def tree(self) -> str | None:
        """Return the encoded airway tree; None while the latest tree is not encoded, which marks the topic later."""
        return self._tree_text() if self._is_cached("tree", *self._latest_tree()) else None

    def route(self) -> str | None:
        """Return the encoded route of the document; None while the tree of the route is not encoded.

        After the tree is encoded, the topics of both are marked.
        """
        # One snapshot for tree and route: two snapshots could contain a route through another tree.
        snapshot = self._session.snapshot()
        newest, document = _tree_of(snapshot), snapshot.document
        if not self._is_cached("tree", *newest) and not _are_same(newest, self._unwritable):
            return None
        route = None if document is None else document.route
        scale = snapshot.route_scale
        inside = document is None or document.cost_of(route) == "lumen"

        def make() -> wire.RouteMessage:
            return route_message(route, newest[1], scale, follows_airways=inside)

        return self._cached_text("route", make, route, newest[1], scale)

    def key_frames(self) -> str:
        """Return the encoded message of the key frames and their flight."""
        return wire.encode_message(key_frames_message(self._session.key_frames_info()))

    def plans(self) -> str:
        """Return the encoded plans of the open case; an empty message without a case."""
        try:
            info = self._session.ask(PlanningOf())
        except UsageError:
            # No case is open, or it has just been closed.
            return wire.encode_message(wire.Plans((), "unwanted", (), "unwanted", ()))
        planned = (value for one in info.targets for value in (one.target, one.planned))
        shown = (info.document.route, info.standing, info.verdicts_standing, info.verdicts, info.turns)
        carm = (info.carm, info.carm_standing)
        # The comparison also lists the targets without a size.
        named = (info.document.targets, info.document.airways is None)
        pairs = (info.pairs_standing, info.available, *info.pairs)
        state = (*shown, *carm, *named, info.dicom_problem, *pairs)
        return self._cached_text("plan", lambda: plans_message(info), *state, *planned)

    def lungs(self) -> str:
        """Return the encoded lung map of the open case; an empty message without a case."""
        try:
            info = self._session.ask(LungsOf())
        except UsageError:
            return wire.encode_message(wire.Lungs("unwanted", "unwanted", (), (), (), "", (), False))
        made = (info.lungs, info.reach, info.stations, info.outdated)
        standing = (info.standing, info.problem, info.reach_standing, info.reach_problem)
        return self._cached_text("lungs", lambda: lungs_message(info), *made, *standing)

    def training(self) -> str:
        """Return the encoded tasks, running attempt and scores of the open case, and the learners of this machine."""
        return wire.encode_message(_training_message(self._session.ask(TrainingOf())))

    def observed_training(self, *, with_learners: bool) -> str:
        """Return the encoded training for observers: no folders or file names, and learners only if they are shared."""
        info = self._session.ask(TrainingOf())
        running = info.running
        if running is not None and not with_learners:
            running = replace(running, learner=None)
        shown = replace(
            _training_message(info), task_folder=None, task_problems=(), running=running, course=CourseInfo()
        )
        learners = self._session.ask(ClassroomOf()) if with_learners else ()
        # The attempt changes each second, the much longer list of the learners more rarely.
        classroom = self._cached_text("classroom", lambda: learners, *learners)
        if self._observed is None or self._observed[0] != shown or self._observed[1] is not classroom:
            self._observed = shown, classroom, wire.encode_message(shown, classroom=classroom)
        return self._observed[2]

    def flights(self) -> str:
        """Return the encoded list of flights recorded in the case."""
        return wire.encode_message(wire.FlightsMessage(self._session.snapshot().flights))

    def _tree_text(self) -> str:
        """Return the encoded latest tree; may be called from any thread."""
        airways, measures = self._latest_tree()
        return self._cached_text("tree", lambda: tree_message(airways, measures), airways, measures)

    def _latest_tree(self) -> tuple[Any, Any]:
        return _tree_of(self._session.snapshot())

    async def _write_tree(self) -> None:
        is_written = False
        try:
            # Repeat until the text is stable: the tree can change during the encoding.
            known = None
            while known != (known := await asyncio.to_thread(self._tree_text)):
                pass
            is_written = True
        except Exception as error:
            self._unwritable = self._latest_tree()
            log_fault(logger, "the airway tree could not be prepared for the window", error)
            words = f"the airway tree cannot be shown: internal error in Carina ({type(error).__name__})"
            self._send(wire.Error("carina.fault", words, None))
        finally:
            self._writing = None
            waiting, self._waiting = self._waiting, {}
            for outbox, topics in waiting.items():
                if is_written:
                    # mark() checks again for a newer tree, which is encoded before a route through it is sent.
                    self.mark(outbox, *topics)
                else:
                    outbox.mark(*topics)

    def _cached_text(self, topic: str, message: Callable[[], Any], *values: object) -> str:
        """Return the cached text of a topic, and encode it again only if one of ``values`` is another object."""
        if not self._is_cached(topic, *values):
            self._known[topic] = (values, wire.encode_message(message()))
        return self._known[topic][1]

    def _is_cached(self, topic: str, *values: object) -> bool:
        known = self._known.get(topic)
        return known is not None and _are_same(values, known[0])


def _tree_of(snapshot: Any) -> tuple[Any, Any]:
    """Return the current airways and their measures; None for each that is missing."""
    airways = None if snapshot.document is None else snapshot.document.airways
    return airways, getattr(snapshot, "measures", None)


def _are_same(values: tuple[object, ...], others: tuple[object, ...] | None) -> bool:
    """Return whether two tuples contain the same objects (``is``) in the same order."""
    if others is None or len(values) != len(others):
        return False
    return all(a is b for a, b in zip(values, others, strict=True))


def _training_message(info: TrainingInfo) -> wire.TrainingMessage:
    return wire.TrainingMessage(
        tasks=info.tasks,
        task_folder=info.task_folder,
        task_problems=info.task_problems,
        running=info.running,
        quiz=info.quiz,
        scores=info.scores,
        verdict=info.verdict,
        references=info.references,
        course=info.course,
    )
