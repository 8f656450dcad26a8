"""Between the session, the frame pump and the one client that is connected: commands in, messages and pictures out."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, assert_never

from carina.commands import Command, MaskFileNeeded, OpenFiles, TakeKeyFile, TakeMask, VoxelAt, WallAt
from carina.disk import disk_trouble, is_disk_trouble
from carina.errors import CarinaError, UsageError
from carina.render import ClusterStatus
from carina.server import messages as wire
from carina.server.cluster_watch import ClusterWatch
from carina.server.device_desk import DeviceDesk, Phone
from carina.server.pointing import Pointing, no_evidence_message
from carina.server.presenter import (
    history_message,
    keys_message,
    picked_message,
    pose_message,
    route_message,
    start_message,
    state_message,
)
from carina.server.pump import FramePump
from carina.server.tree_words import tree_message
from carina.server.uploads import Uploads
from carina.server.wire_codec import type_name
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
from carina.volume import Citation

__all__ = ["Hub", "Outbox"]

logger = logging.getLogger(__name__)

MAX_QUEUED = 2000
"""Text messages waiting for a client that does not read; beyond it is cut off."""
TOPICS = ("start", "state", "tree", "route", "keys", "history", "pose")


NEWEST_ONLY = (wire.Value, wire.LivePath, wire.BranchDetail, wire.EditPreview, wire.Devices, wire.Pen, wire.Cluster)
"""Messages of which only the newest matters: answers to a cursor, and what is told again and again."""


class Outbox:
    """What waits to be sent to one client; event loop only. Topics coalesce: only their newest message is ever sent."""

    def __init__(self) -> None:
        self._topics: set[str] = set()
        self._texts: deque[str] = deque()
        self._newest: dict[str, str] = {}
        self._pictures: deque[bytes] = deque()
        self._filled = asyncio.Event()
        self._sent: dict[str, str] = {}
        self.overflowed = False

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
            self.overflowed = self.overflowed or len(self._texts) > MAX_QUEUED
        self._filled.set()

    def nudge(self) -> None:
        """Wake the one who sends, to find that another client has taken over."""
        self._filled.set()

    def push_picture(self, data: bytes) -> None:
        """A picture; their number is bounded by the acknowledgements."""
        self._pictures.append(data)
        self._filled.set()

    async def take(self) -> tuple[list[str], list[str], list[bytes]]:
        """Wait; then the changed topics (in their order), the texts and the pictures."""
        await self._filled.wait()
        self._filled.clear()
        topics = [t for t in TOPICS if t in self._topics]
        texts = [*self._newest.values(), *self._texts]
        pictures = list(self._pictures)
        self._topics.clear()
        self._texts.clear()
        self._newest.clear()
        self._pictures.clear()
        return topics, texts, pictures


class Hub:
    """Owns the pump's thread and the current client.

    Parameters
    ----------
    session
        What is driven.
    uploads
        Dropped files.
    """

    def __init__(
        self,
        session: Session,
        uploads: Uploads,
        *,
        clock: Callable[[], float] = time.monotonic,
        threads: int = 1,
        simd: str = "",
        patient_citation: Citation | None = None,
        recordings: Path | None = None,
        phone: Phone | None = None,
        cluster_status: Callable[[], ClusterStatus] | None = None,
    ) -> None:
        self.session = session
        self._uploads = uploads
        self._patient_citation = patient_citation
        self._upload_of_job: dict[str, str] = {}
        self._mask_upload: str | None = None
        self._outbox: Outbox | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self.pump = FramePump(
            session.scene, self._deliver, self._tell_from_pump, clock=clock, threads=threads, simd=simd
        )
        self._thread = threading.Thread(target=self.pump.run, name="carina-frames", daemon=True)
        self._pointing = Pointing(session, self.pump.shown, lambda answer: self._in_loop(self._push, answer))
        self.devices = DeviceDesk(
            session, lambda message: self._in_loop(self._push, message), recordings=recordings, phone=phone
        )
        self._watch = None if cluster_status is None else ClusterWatch(cluster_status, self._tell_of_cluster)
        self._unsubscribe: Callable[[], None] = lambda: None
        self._cache: dict[str, tuple[tuple[object, ...], str]] = {}
        self._writing_tree: asyncio.Task[None] | None = None
        self._after_tree: set[str] = set()
        self._history_known: tuple[Outbox | None, int, tuple[str, ...]] = (None, 0, ())

    # ------------------------------------------------------------ life

    def start(self) -> None:
        """Begin; from the event loop."""
        self._loop = asyncio.get_running_loop()
        self._unsubscribe = self.session.subscribe(self._on_event)
        self._thread.start()
        self._pointing.start()
        self.devices.start()
        if self._watch is not None:
            self._watch.start()

    def stop(self) -> None:
        """End the pump's thread and the session's jobs."""
        self._unsubscribe()
        self._pointing.stop()
        self.devices.stop()
        if self._watch is not None:
            self._watch.stop()
        self.pump.stop()
        if self._thread.is_alive():
            self._thread.join()
        self.session.close()
        self._uploads.close()

    def attach(self) -> Outbox:
        """A new client takes over; it gets everything."""
        self.pump.new_client()
        self.devices.forget_client()
        outbox = Outbox()
        if self._outbox is not None:
            self._outbox.nudge()
        self._outbox = outbox
        topics = ["start", "state"]
        if self.session.snapshot().case is not None:
            topics += ["tree", "route", "keys", "history", "pose"]
        self._mark(outbox, *topics)
        for job in self.session.jobs.running:
            if job.latest is not None:
                outbox.push(_progress(job.latest))
        return outbox

    def detach(self, outbox: Outbox) -> None:
        """A client is gone; nothing if another has taken over."""
        if self._outbox is outbox:
            self._outbox = None
            self.pump.new_client()

    def is_current(self, outbox: Outbox) -> bool:
        """Whether no other client has taken over."""
        return self._outbox is outbox

    # ------------------------------------------------------------ out

    def topic_text(self, topic: str) -> str | None:
        """The newest message of a topic, or None where there is none."""
        snapshot = self.session.snapshot()
        document = snapshot.document
        if topic == "start":
            store = self.session.store
            return wire.encode_message(
                start_message(
                    notice_accepted=store is not None and store.notice_accepted(),
                    recent=self.session.cases.listed(),
                    patient_citation=self._patient_citation,
                    storage=self.session.cases.storage(),
                )
            )
        if topic == "state":
            return wire.encode_message(state_message(snapshot, frame_rate_hz=self.pump.rate_hz))
        if topic == "tree":
            # One that is newer than what was written is written by now, and marked then.
            return self._tree_text() if self._is_known("tree", *self._newest_tree()) else None
        if topic == "route":
            route = None if document is None else document.route
            return self._cached("route", lambda: route_message(route), route)
        if topic == "keys":
            return wire.encode_message(keys_message(self.session.keys_info()))
        if topic == "history":
            return self._history_text(snapshot)
        info = self.session.pose_info()
        return None if info is None else wire.encode_message(pose_message(info))

    def with_own_names(self, text: str) -> str:
        """A message in which dropped files have the names by which the person knows them."""
        return self._uploads.names.restored(text)

    def _history_text(self, snapshot: Snapshot) -> str | None:
        """None where this client knows it already: a field of view that is dragged is one step all the time."""
        labels = tuple(step.label for step in snapshot.steps)
        known = (self._outbox, snapshot.position, labels)
        if known == self._history_known:
            return None
        self._history_known = known
        return wire.encode_message(history_message(snapshot))

    def _tree_text(self) -> str:
        """From any thread."""
        airways, measures = self._newest_tree()
        return self._cached("tree", lambda: tree_message(airways, measures), airways, measures)

    def _newest_tree(self) -> tuple[Any, Any]:
        snapshot = self.session.snapshot()
        airways = None if snapshot.document is None else snapshot.document.airways
        return airways, getattr(snapshot, "measures", None)

    def _mark(self, outbox: Outbox, *topics: str) -> None:
        """A tree of some hundred branches takes a third of a second to write, in a thread of its own: it and the route
        through it follow, while poses and pictures go on."""
        waits: set[str] = set()
        if self._writing_tree is not None or ("tree" in topics and not self._is_known("tree", *self._newest_tree())):
            waits = {"tree", "route"} & set(topics)
        self._after_tree |= waits
        outbox.mark(*(t for t in topics if t not in waits))
        if waits and self._writing_tree is None:
            self._writing_tree = asyncio.get_running_loop().create_task(self._write_tree())

    async def _write_tree(self) -> None:
        is_written = False
        try:
            # What is marked meanwhile may be of a newer tree.
            known = None
            while known != (known := await asyncio.to_thread(self._tree_text)):
                pass
            is_written = True
        except Exception as trouble:
            log_fault(logger, "the airway tree could not be prepared for the window", trouble)
            words = f"the airway tree cannot be shown: internal error in Carina ({type(trouble).__name__})"
            self._push(wire.Error("carina.fault", words, None))
        finally:
            self._writing_tree = None
            waits, self._after_tree = self._after_tree, set()
            if self._outbox is not None and is_written:
                # A tree may have come since the last look: it is written, too, before a route through it goes.
                self._mark(self._outbox, *waits)
            elif self._outbox is not None:
                self._outbox.mark(*waits)

    def _cached(self, topic: str, message: Callable[[], Any], *values: object) -> str:
        """A tree is some hundred kilobytes and changes rarely; every change and every reload asks for it."""
        if not self._is_known(topic, *values):
            self._cache[topic] = (values, wire.encode_message(message()))
        return self._cache[topic][1]

    def _is_known(self, topic: str, *values: object) -> bool:
        known = self._cache.get(topic)
        return known is not None and all(a is b for a, b in zip(known[0], values, strict=True))

    def _on_event(self, event: Event) -> None:
        """From any thread, with the session locked: hand on and return."""
        if isinstance(event, Changed) and event.topics & {"views", "pose"}:
            self.pump.content_changed()
        if isinstance(event, Changed) and "tree" in event.topics:
            self._pointing.warm()
        self._in_loop(self._note, event)

    def _deliver(self, data: bytes) -> None:
        self._in_loop(self._note_picture, data)

    def _tell_from_pump(self, message: wire.Status | tuple[str, str]) -> None:
        if isinstance(message, tuple):
            message_out: Any = wire.Error(code=message[0], message=message[1], action=None)
        else:
            message_out = message
        self._in_loop(self._push, message_out)

    def _tell_of_cluster(self, message: wire.Cluster | wire.Notice) -> None:
        self._in_loop(self._push, message)

    def _in_loop(self, function: Callable[..., None], *arguments: Any) -> None:
        loop = self._loop
        if loop is None or loop.is_closed():
            return
        try:
            loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            # The loop closed between the look and the call: the server is ending.
            logger.debug("an event came after the end")

    def _push(self, message: Any) -> None:
        if self._outbox is not None:
            self._outbox.push(message)

    def _note_picture(self, data: bytes) -> None:
        if self._outbox is not None:
            self._outbox.push_picture(data)

    def _note(self, event: Event) -> None:
        if isinstance(event, JobEnded):
            upload_id = self._upload_of_job.pop(event.job_id, None)
            if upload_id is not None:
                self._uploads.discard(upload_id)
        if self._mask_upload is not None and not self.session.ask(MaskFileNeeded()):
            self._uploads.discard(self._mask_upload)
            self._mask_upload = None
        outbox = self._outbox
        if outbox is None:
            return
        match event:
            case Changed():
                self._mark(outbox, *event.topics)
            case JobProgress():
                outbox.push(_progress(event))
            case JobEnded():
                outbox.push(wire.Done(event.job_id, event.outcome))
            case Trouble():
                outbox.push(wire.Error(event.code, event.message, event.action))
            case NotEvident():
                outbox.push(no_evidence_message(event))
            case Said():
                outbox.push(wire.Notice(event.message))
            case _:
                assert_never(event)

    # ------------------------------------------------------------ in

    def handle(self, message: Any) -> None:
        """Do what a client asks; trouble is answered with an ``error`` message."""
        try:
            self._do(message)
        except CarinaError as trouble:
            self._push(wire.Error(trouble.code, str(trouble), None))
        except Exception as trouble:
            if isinstance(trouble, OSError) and is_disk_trouble(trouble):
                told = disk_trouble(trouble, "the command failed", None)
                self._push(wire.Error(told.code, str(told), None))
                return
            log_fault(logger, f"a command failed: {type(message).__name__}", trouble)
            words = f"the command failed: internal error in Carina ({type(trouble).__name__})"
            self._push(wire.Error("carina.fault", words, None))

    def _do(self, message: Any) -> None:
        """A command is the session's; the rest is about the connection, its questions and its files."""
        match message:
            case Command():
                self.session.do(message)
                self.devices.done(message)
            case wire.Ack():
                self.pump.acknowledge(message.frame_id)
            case wire.Layout():
                self.pump.set_layout({v.view: (v.width, v.height) for v in message.views})
            case wire.Probe():
                self._push(wire.Value(message.lps, self.session.ask(VoxelAt(message.lps))))
            case wire.Pick():
                self._pick(message)
            case wire.AskLivePath():
                self._pointing.ask_live_path(message)
            case wire.AskEditPreview():
                self._pointing.ask_edit_preview(message)
            case wire.AskBranchDetail():
                self._pointing.ask_branch_detail(message)
            case wire.OpenUpload():
                self._keep_for(OpenFiles(str(self._uploads.place(message.upload_id))), message.upload_id)
            case wire.OpenKeys():
                self._keep_for(TakeKeyFile(self._uploads.place(message.upload_id)), message.upload_id)
            case wire.ImportMask():
                self._import_mask(message.upload_id)
            case wire.SetFrameRate():
                self.pump.set_rate(message.rate_hz)
                if self._outbox is not None:
                    self._outbox.mark("state")
            case wire.AcceptNotice():
                if self.session.store is not None:
                    self.session.store.accept_notice()
                if self._outbox is not None:
                    self._outbox.mark("start")
            case wire.AskStorage():
                if self._outbox is not None:
                    self._outbox.mark("start")
            case _ if self.devices.handle(message):
                pass
            case _:
                raise UsageError(
                    f"{type(message).__name__} cannot be sent after the first message", code="protocol.order"
                )

    def _keep_for(self, command: Command, upload_id: str) -> None:
        """The dropped files stay until the job that reads them has ended."""
        job_id = self.session.do(command)
        assert job_id is not None
        self._upload_of_job[job_id] = upload_id

    def _pick(self, message: wire.Pick) -> None:
        """The wall under a click, in the picture that was clicked in and not in a newer one."""
        shown = self.pump.shown(message.frame_id)
        if shown is None:
            raise UsageError("the view has changed since you clicked; click again", code="session.pick")
        hit = shown.wall_at(message.column, message.row)
        wall = None if hit is None else self.session.ask(WallAt(_three(hit.position_lps)))
        depth_mm = None if hit is None else round(float(hit.depth_mm), 2)
        self._push(picked_message(message.pick_id, wall, depth_mm))

    def _import_mask(self, upload_id: str) -> None:
        """The file is kept until the mask is read, which may take an answer."""
        place = self._uploads.place(upload_id)
        before, self._mask_upload = self._mask_upload, None
        try:
            self.session.do(TakeMask(str(place)))
        except CarinaError:
            self._uploads.discard(upload_id)
            raise
        finally:
            if before is not None and before != upload_id:
                self._uploads.discard(before)
        self._mask_upload = upload_id


def _progress(event: JobProgress) -> wire.Progress:
    left_s = None if event.seconds_left is None else round(event.seconds_left, 1)
    return wire.Progress(event.job_id, event.title, event.what, event.fraction, left_s)


def _three(values: Iterable[float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
