"""One connected window: its rendered frames, its view of the case, its requests, and the messages sent to it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Protocol, assert_never

from carina.commands import OpeningPreviewOf, VoxelAt, WallAt
from carina.disk import disk_trouble, is_disk_trouble
from carina.errors import CarinaError, UsageError
from carina.server.frames.pump import FramePump
from carina.server.to_wire.session import history_message, opening_message, picked_message, pose_message, state_message
from carina.server.windows.broadcast_cache import SharedTexts
from carina.server.windows.inbox import Inbox
from carina.server.windows.outbox import Outbox
from carina.server.windows.pointing import Pointing, no_evidence_message
from carina.server.wire import messages as wire
from carina.session import (
    LAYERS,
    Changed,
    ChestMoved,
    ErrorEvent,
    Event,
    EvidenceMissing,
    JobEnded,
    JobProgress,
    LayerName,
    Session,
    ShownCase,
    Snapshot,
    StartMarked,
    UserMessage,
    log_fault,
)

logger = logging.getLogger(__name__)


class Host(Protocol):
    """Interface of the hub as its windows use it: the shared objects and the commands that affect all windows."""

    session: Session
    clock: Callable[[], float]
    """Monotonic clock of the session, in seconds."""
    threads: int
    simd: str
    texts: SharedTexts

    @property
    def shares_learners(self) -> bool:
        """Whether observers receive the learners of the training."""

    def in_loop(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function in the event loop; callable from any thread."""

    def do(self, message: Any, window: Window) -> None:
        """Execute a message of a window that concerns the session or several windows."""

    def detach(self, window: Window) -> None:
        """Remove a window whose connection was closed."""

    def watching_text(self) -> str:
        """Return the ``Watching`` message as JSON: the state of the viewing page and its observers."""

    def processor_text(self) -> str | None:
        """Return the ``ProcessorChoice`` message as JSON; None if the processor cannot be chosen."""

    def with_original_names(self, text: str) -> str:
        """Return a message in which dropped files have the names that the user knows."""


class Window:
    """State and threads of one connection, independent of the other windows.

    Each window has its own outbox, inbox and rendering thread, so a slow window does not delay the others.

    Parameters
    ----------
    number
        Number that identifies the view of this window in the session.
    host
        The hub.
    rate_hz
        Initial frame rate of the airway view, in frames per second.
    at_machine
        Whether the browser runs on this machine; the name of the CT file is sent only to such a browser.
    """

    watches = False
    """Whether the window belongs to an observer, who cannot change the case."""
    inbox_share = 1.0
    """Largest share of the event loop's time that this window's messages may take."""
    layers: tuple[LayerName, ...] = LAYERS
    """Layers of the lung map that are drawn on the slices of this window."""

    def __init__(self, number: int, host: Host, *, rate_hz: float, at_machine: bool = False) -> None:
        self.number = number
        self.at_machine = at_machine
        self._host = host
        self._session = host.session
        self.outbox = Outbox()
        self.inbox = Inbox(self.handle, lambda number: host.in_loop(self._confirm, number), share=self.inbox_share)
        self._num_handled = 0
        self.pump = FramePump(
            self._current_scene,
            lambda data: host.in_loop(self.outbox.push_picture, data),
            self._send_from_pump,
            clock=host.clock,
            threads=host.threads,
            simd=host.simd,
        )
        self.pump.set_rate(rate_hz)
        self._pictures = threading.Thread(target=self.pump.run, name=f"carina-frames-{number}", daemon=True)
        self._pointing = Pointing(host.session, self.pump.shown, self.send)
        self._unsubscribe: Callable[[], None] = lambda: None
        self._history_known: tuple[int, tuple[str, ...]] | None = None

    # ------------------------------------------------------------ start and end

    def start(self) -> None:
        """Start the threads, and send the complete state to the window; call this method in the event loop."""
        self._unsubscribe = self._session.subscribe(self._on_event, window=self.number, watches=self.watches)
        self._pictures.start()
        self._pointing.start()
        topics = ["start", "state", "watching", "processor"]
        if self._session.ask(OpeningPreviewOf()) is not None:
            topics.append("opening")
        if self._session.snapshot().case is not None:
            topics += ["tree", "route", "plan", "lungs", "key_frames", "flights", "history", "pose", "training"]
        self.mark(*topics)
        for job in self._session.jobs.running:
            if job.latest is not None:
                self._handle_event(job.latest)

    def end(self) -> None:
        """Stop the window without waiting; the threads finish their present frame or answer, which is not sent."""
        self._unsubscribe()
        self.pump.stop()
        self._pointing.stop_soon()

    def leave(self) -> None:
        """Remove the window after its connection was closed; call this method in the event loop."""
        self._host.detach(self)

    @property
    def end_reason(self) -> str | None:
        """Reason, as a sentence, why nothing more may be sent to the window; None while sending is allowed."""
        return None

    @property
    def threads(self) -> tuple[threading.Thread, ...]:
        """The threads of the window, which finish soon after :meth:`end`."""
        return self._pictures, *self._pointing.threads

    def _current_scene(self) -> ShownCase | None:
        scene = self._session.scene(self.number)
        return None if scene is None else replace(scene, wanted_layers=self.layers)

    # ------------------------------------------------------------ messages to the client

    def mark(self, *topics: str) -> None:
        """Schedule the newest message of each topic for sending; call this method in the event loop."""
        self._host.texts.mark(self.outbox, *topics)

    def send(self, message: Any) -> None:
        """Send a message to this window; callable from any thread."""
        if isinstance(message, wire.Error):
            self._host.in_loop(self.push_error, message)
        else:
            self._host.in_loop(self.outbox.push, message)

    def with_original_names(self, text: str) -> str:
        """Return a message with the original names of dropped files, if this window may read these names."""
        return self._host.with_original_names(text)

    def topic_text(self, topic: str) -> str | None:
        """Return the newest message of a topic as JSON; None if there is nothing to send."""
        match topic:
            case "start":
                return self._host.texts.start()
            case "opening":
                opening = self._session.ask(OpeningPreviewOf())
                return wire.encode_message(opening_message(opening, names_ct=self.at_machine))
            case "state":
                return wire.encode_message(self._state())
            case "tree":
                return self._host.texts.tree()
            case "route":
                return self._host.texts.route()
            case "plan":
                return self._host.texts.plans()
            case "lungs":
                return self._host.texts.lungs()
            case "key_frames":
                return self._host.texts.key_frames()
            case "flights":
                return self._host.texts.flights()
            case "training":
                return self._host.texts.training()
            case "watching":
                return self._host.watching_text()
            case "processor":
                return self._host.processor_text()
            case "history":
                return self._history_text(self._session.snapshot())
            case "handled":
                return wire.encode_message(wire.Handled(self._num_handled))
        info = self._session.pose_info()
        return None if info is None else wire.encode_message(pose_message(info))

    def _state(self) -> wire.State:
        return state_message(
            self._session.snapshot(self.number), frame_rate_hz=self.pump.rate_hz, names_ct=self.at_machine
        )

    def _history_text(self, snapshot: Snapshot) -> str | None:
        """Return the history message as JSON; None if the window has received the same history before.

        For example, a field of view that the user drags changes many times but remains one step of the history.
        """
        known = (snapshot.position, tuple(step.label for step in snapshot.steps))
        if known == self._history_known:
            return None
        self._history_known = known
        return wire.encode_message(history_message(snapshot))

    def _send_from_pump(self, message: wire.Status | tuple[str, str]) -> None:
        self.send(wire.Error(*message, action=None) if isinstance(message, tuple) else message)

    def _on_event(self, event: Event) -> None:
        """Forward a session event to the event loop; the session calls this from any thread and holds its lock."""
        if isinstance(event, ChestMoved) or (isinstance(event, Changed) and event.topics & {"views", "pose"}):
            self.pump.content_changed()
        self._host.in_loop(self._handle_event, event)

    def _handle_event(self, event: Event) -> None:
        match event:
            case Changed():
                self.mark(*event.topics)
                if "tree" in event.topics:
                    # The case may have become suitable or unsuitable for a task.
                    self.mark("training")
            case ChestMoved():
                if event.moves_scope:
                    self.mark("pose")
            case JobProgress():
                self.outbox.push(_progress(event))
            case JobEnded():
                self.outbox.push(wire.Done(event.job_id, event.outcome))
            case ErrorEvent():
                self.outbox.push(wire.Error(event.code, event.message, event.action))
            case EvidenceMissing():
                self.outbox.push(no_evidence_message(event))
            case StartMarked():
                self.outbox.push(wire.StartMarkedMessage(event.lps))
            case UserMessage():
                self.outbox.push(wire.Notice(event.message))
            case _:
                assert_never(event)

    # ------------------------------------------------------------ messages from the client

    async def admit(self) -> None:
        """Wait until the client's message limit allows the next message to be parsed.

        Raises
        ------
        ProtocolError
            If the client sent too many messages.
        """

    def handle(self, message: Any) -> None:
        """Execute a message of the window; an exception is sent to the window as an ``error`` message."""
        try:
            self._do(message)
        except CarinaError as exc:
            self.push_error(wire.Error(exc.code, str(exc), None))
        except Exception as exc:
            if isinstance(exc, OSError) and is_disk_trouble(exc):
                error = disk_trouble(exc, "the command failed", None)
                self.push_error(wire.Error(error.code, str(error), None))
            else:
                log_fault(logger, f"a command failed: {type(message).__name__}", exc)
                words = f"the command failed: internal error in Carina ({type(exc).__name__})"
                self.push_error(wire.Error("carina.fault", words, None))

    def push_error(self, error: wire.Error) -> None:
        """Send an error to this window; call this method in the event loop."""
        self.outbox.push(error)

    def _confirm(self, num_handled: int) -> None:
        """Confirm to the client the number of commands that have been handled.

        The inbox calls this method through the event loop, as the session does for its events. The confirmation is
        therefore sent after the state that a command changed. In the other order the page would briefly show the old
        state, and a key that is pressed then would start from the old value.
        """
        self._num_handled = num_handled
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
            case wire.SetLayers():
                self.layers = message.layers
                self.pump.content_changed()
            case wire.Probe():
                self.outbox.push(wire.Value(message.lps, self._session.ask(VoxelAt(message.lps))))
            case wire.Pick():
                self._pick(message)
            case wire.AskLivePath():
                self._pointing.request_live_path(message)
            case wire.AskTargetMark():
                self._pointing.request_target_mark(message)
            case wire.AskEditPreview():
                self._pointing.request_edit_preview(message)
            case wire.AskBranchDetail():
                self._pointing.request_branch_detail(message)
            case _:
                self._host.do(message, self)

    def _pick(self, message: wire.Pick) -> None:
        """Send the wall position under a click, computed in the frame that the user clicked and not in a newer one."""
        shown = self.pump.shown(message.frame_id)
        if shown is None:
            raise UsageError("the view has changed since you clicked; click again", code="session.pick")
        hit = shown.wall_at(message.column, message.row)
        wall = None if hit is None else self._session.ask(WallAt(_three_floats(hit.position_lps)))
        depth_mm = None if hit is None else round(float(hit.depth_mm), 2)
        self.outbox.push(picked_message(message.pick_id, wall, depth_mm))


def _progress(event: JobProgress) -> wire.Progress:
    left_s = None if event.seconds_left is None else round(event.seconds_left, 1)
    return wire.Progress(event.job_id, event.title, event.what, event.fraction, left_s)


def _three_floats(values: Iterable[float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
