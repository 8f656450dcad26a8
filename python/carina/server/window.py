"""One window that is connected: its own pictures, sight and questions, and what it is told of the session."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, assert_never

from carina.commands import Command, VoxelAt, WallAt
from carina.disk import disk_trouble, is_disk_trouble
from carina.errors import CarinaError, UsageError
from carina.server import messages as wire
from carina.server.inbox import Inbox
from carina.server.outbox import Outbox
from carina.server.pointing import Pointing, no_evidence_message
from carina.server.presenter import history_message, picked_message, pose_message, state_message
from carina.server.pump import FramePump
from carina.server.shared_texts import SharedTexts
from carina.session import (
    Changed,
    Event,
    JobEnded,
    JobProgress,
    NotEvident,
    Said,
    Session,
    Snapshot,
    Trouble,
    log_fault,
)

__all__ = ["Machine", "Window"]

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Machine:
    """What all windows of a server have in common beside the session."""

    clock: Callable[[], float]
    """Seconds, monotonic; the session's."""
    threads: int
    simd: str
    in_loop: Callable[..., None]
    """Calls a function with arguments in the event loop; from any thread."""


class Window:
    """What belongs to one connection. Another window that stalls, asks or looks elsewhere is not felt here.

    Parameters
    ----------
    number
        The name by which the session knows this window's sight.
    session
        What is driven.
    machine
        What pictures are made with.
    texts
        The messages that all windows share.
    do
        Does what is not about this window alone, for this window.
    rate_hz
        Airway pictures per second that are asked for at first.
    """

    def __init__(
        self,
        number: int,
        session: Session,
        machine: Machine,
        texts: SharedTexts,
        do: Callable[[Any, Window], None],
        *,
        rate_hz: float,
    ) -> None:
        self.number = number
        self._session = session
        self._texts = texts
        self._do_for = do
        self._in_loop = machine.in_loop
        self.outbox = Outbox()
        self.inbox = Inbox(self.handle)
        self.pump = FramePump(
            partial(session.scene, number),
            lambda data: self._in_loop(self.outbox.push_picture, data),
            self._tell_from_pump,
            clock=machine.clock,
            threads=machine.threads,
            simd=machine.simd,
        )
        self.pump.set_rate(rate_hz)
        self._pictures = threading.Thread(target=self.pump.run, name=f"carina-frames-{number}", daemon=True)
        self._pointing = Pointing(session, self.pump.shown, self.tell)
        self._unsubscribe: Callable[[], None] = lambda: None
        self._history_known: tuple[int, tuple[str, ...]] | None = None

    # ------------------------------------------------------------ life

    def start(self) -> None:
        """Begin, and be told everything; from the event loop."""
        self._unsubscribe = self._session.subscribe(self._on_event, window=self.number)
        self._pictures.start()
        self._pointing.start()
        topics = ["start", "state"]
        if self._session.snapshot().case is not None:
            topics += ["tree", "route", "keys", "history", "pose"]
        self.mark(*topics)
        for job in self._session.jobs.running:
            if job.latest is not None:
                self.outbox.push(_progress(job.latest))

    def end(self) -> None:
        """Its place is free at once; a picture or an answer under way is finished for nobody."""
        self._unsubscribe()
        self.pump.stop()
        self._pointing.end()

    @property
    def threads(self) -> tuple[threading.Thread, ...]:
        """They end soon after :meth:`end`."""
        return self._pictures, self._pointing.thread

    # ------------------------------------------------------------ out

    def mark(self, *topics: str) -> None:
        """Send these topics anew; event loop only."""
        self._texts.mark(self.outbox, *topics)

    def tell(self, message: Any) -> None:
        """Send a message; from any thread."""
        self._in_loop(self.outbox.push, message)

    def topic_text(self, topic: str) -> str | None:
        """The newest message of a topic, or None where there is none."""
        match topic:
            case "start":
                return self._texts.start()
            case "state":
                snapshot = self._session.snapshot(self.number)
                return wire.encode_message(state_message(snapshot, frame_rate_hz=self.pump.rate_hz))
            case "tree":
                return self._texts.tree()
            case "route":
                return self._texts.route()
            case "keys":
                return self._texts.keys()
            case "history":
                return self._history_text(self._session.snapshot())
            case "handled":
                return wire.encode_message(wire.Handled(self.inbox.num_handled))
        info = self._session.pose_info()
        return None if info is None else wire.encode_message(pose_message(info))

    def _history_text(self, snapshot: Snapshot) -> str | None:
        """None where this window knows it already: a field of view that is dragged is one step all the time."""
        known = (snapshot.position, tuple(step.label for step in snapshot.steps))
        if known == self._history_known:
            return None
        self._history_known = known
        return wire.encode_message(history_message(snapshot))

    def _tell_from_pump(self, message: wire.Status | tuple[str, str]) -> None:
        self.tell(wire.Error(*message, action=None) if isinstance(message, tuple) else message)

    def _on_event(self, event: Event) -> None:
        """From any thread, with the session locked: hand on and return."""
        if isinstance(event, Changed) and event.topics & {"views", "pose"}:
            self.pump.content_changed()
        self._in_loop(self._note, event)

    def _note(self, event: Event) -> None:
        match event:
            case Changed():
                self.mark(*event.topics)
            case JobProgress():
                self.outbox.push(_progress(event))
            case JobEnded():
                self.outbox.push(wire.Done(event.job_id, event.outcome))
            case Trouble():
                self.outbox.push(wire.Error(event.code, event.message, event.action))
            case NotEvident():
                self.outbox.push(no_evidence_message(event))
            case Said():
                self.outbox.push(wire.Notice(event.message))
            case _:
                assert_never(event)

    # ------------------------------------------------------------ in

    def handle(self, message: Any) -> None:
        """Do what the window asks; trouble is answered with an ``error`` message."""
        try:
            self._do(message)
        except CarinaError as trouble:
            self.outbox.push(wire.Error(trouble.code, str(trouble), None))
        except Exception as trouble:
            if isinstance(trouble, OSError) and is_disk_trouble(trouble):
                told = disk_trouble(trouble, "the command failed", None)
                self.outbox.push(wire.Error(told.code, str(told), None))
            else:
                log_fault(logger, f"a command failed: {type(message).__name__}", trouble)
                words = f"the command failed: internal error in Carina ({type(trouble).__name__})"
                self.outbox.push(wire.Error("carina.fault", words, None))
        if isinstance(message, Command):
            self.outbox.mark("handled")

    def _do(self, message: Any) -> None:
        match message:
            case wire.Ack():
                self.pump.acknowledge(message.frame_id)
            case wire.Layout():
                self.pump.set_layout({v.view: (v.width, v.height) for v in message.views})
            case wire.SetFrameRate():
                self.pump.set_rate(message.rate_hz)
                self.mark("state")
            case wire.Probe():
                self.outbox.push(wire.Value(message.lps, self._session.ask(VoxelAt(message.lps))))
            case wire.Pick():
                self._pick(message)
            case wire.AskLivePath():
                self._pointing.ask_live_path(message)
            case wire.AskEditPreview():
                self._pointing.ask_edit_preview(message)
            case wire.AskBranchDetail():
                self._pointing.ask_branch_detail(message)
            case _:
                self._do_for(message, self)

    def _pick(self, message: wire.Pick) -> None:
        """The wall under a click, in the picture that was clicked in and not in a newer one."""
        shown = self.pump.shown(message.frame_id)
        if shown is None:
            raise UsageError("the view has changed since you clicked; click again", code="session.pick")
        hit = shown.wall_at(message.column, message.row)
        wall = None if hit is None else self._session.ask(WallAt(_three(hit.position_lps)))
        depth_mm = None if hit is None else round(float(hit.depth_mm), 2)
        self.outbox.push(picked_message(message.pick_id, wall, depth_mm))


def _progress(event: JobProgress) -> wire.Progress:
    left_s = None if event.seconds_left is None else round(event.seconds_left, 1)
    return wire.Progress(event.job_id, event.title, event.what, event.fraction, left_s)


def _three(values: Iterable[float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
