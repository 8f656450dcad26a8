"""The console (paper 5, Figure 7), a thread that distributes strips, monitors deadlines and assembles pictures."""

from __future__ import annotations

import itertools
import logging
import pickle
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial

from carina.cluster.frame_rate import RateMeter
from carina.cluster.frames import Content, PendingFrame, find_mismatch, set_failure
from carina.cluster.lanes import Lane, LaneFacts, LocalLane, StripAnswer, StripOrder
from carina.cluster.scene_data import Parcel, Parcels
from carina.cluster.scheduler import FrameDone, FrameDropped, Issue, LaneBack, LaneLate, StripScheduler
from carina.cluster.settings import ClusterSettings
from carina.errors import CancelledError, CarinaError, ClusterError
from carina.render import CancelToken, ClusterStatus, MemberStatus, Picture, View

__all__ = ["Console", "Content", "StripTiming"]

logger = logging.getLogger(__name__)

RETRY_S = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Waiting times in seconds before a renderer that could not load the content loads it again; the last one repeats."""
NOTIFY_AFTER_LOADS = 5
"""Number of failed loads of a renderer from which the user is notified; a restart can cause one or two."""
NOTIFY_AFTER_S = 0.5
"""Duration in seconds, of a load or of a missing answer, from which the user is notified."""
MAX_FAULTS = 5
"""Maximum number of wrong answers of a renderer; with more, the console stops using the renderer."""


@dataclass(frozen=True, slots=True)
class StripTiming:
    """One strip (rows of a picture) with the times of its order and answer, for timelines (paper, Figure 11)."""

    lane: str
    frame_id: int
    rows: tuple[int, int]
    issued_s: float
    answered_s: float
    seconds: float
    """Rendering time in seconds, as the renderer reported it."""
    accepted: bool


@dataclass(slots=True)
class _Member:
    """State of one renderer, as the console records it."""

    lane: Lane
    reserve: bool
    loading: bool = True
    """Whether the renderer is loading the content of the scene, or waits before it tries again."""
    attempts: int = 0
    faults: int = 0
    loaded: int = 0
    generation: int = 0
    """Number of the latest load; answers to earlier loads are ignored."""
    latency: RateMeter = field(default_factory=RateMeter)


class Console:
    """Thread that distributes the strips of pictures to lanes (connections to renderers) and assembles the answers.

    Parameters
    ----------
    settings
        Settings of the scheduler.
    clock
        Returns the current time in seconds, monotonic.
    keep_jobs
        Store a :class:`StripTiming` for each strip, for timelines.
    """

    def __init__(
        self,
        settings: ClusterSettings | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        keep_jobs: bool = False,
    ) -> None:
        self._settings = settings or ClusterSettings()
        self._clock = clock
        self._scheduler = StripScheduler(self._settings)
        self._inbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._members: dict[str, _Member] = {}
        self._frames: dict[int, PendingFrame] = {}
        self._tasks: dict[int, tuple[StripOrder, float]] = {}
        self._parcel: Parcel | None = None
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._frame_ids = itertools.count(1)
        self._notices: list[str] = []
        self._reported: set[str] = set()
        self._meter = RateMeter()
        self._status: ClusterStatus | None = None
        self.jobs: list[StripTiming] | None = [] if keep_jobs else None
        self.parcels = Parcels()
        """Source of content numbers, which stay unique when another case is opened."""
        self.address = "local"
        self.mixed = False
        self.max_open_frames = self._settings.open_frames
        """Maximum number of pictures that are rendered at the same time; see `StripScheduler.max_open_frames`."""
        self._closed = False
        self._closing = threading.Lock()
        # The local renderer takes over when all other machines fail, so the loss of a machine is not an error.
        self.add_lane(LocalLane(), reserve=True)
        self._thread = threading.Thread(target=self._run, name="carina-console", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        """Return a one-line description with the number of renderers."""
        return f"Console({len(self._members)} renderers)"

    def add_lane(self, lane: Lane, *, reserve: bool = False) -> None:
        """Add a renderer; it renders as soon as it has loaded the current content. A closed console closes the lane.

        Parameters
        ----------
        lane
            Connection to the renderer.
        reserve
            Use the lane only for strips that no other lane can render.
        """
        with self._closing:
            if not self._closed:
                self._inbox.put(lambda: self._add_member(lane, reserve))
                return
        lane.close()

    def remove_lane(self, name: str) -> None:
        """Remove the renderer with this name permanently and close its lane."""
        self._inbox.put(lambda: self._remove_member(name))

    def notice(self, words: str) -> None:
        """Add a message for the user; a repeated message is shown once."""
        self._inbox.put(lambda: self._add_notice(words))

    def set_content(self, parcel: Parcel) -> None:
        """Set the content (volume and scene) that renderers load; each later frame states the number of its content.

        Parameters
        ----------
        parcel
            The packed content; content with a smaller number than the present one is ignored.
        """
        self._inbox.put(lambda: self._set_content(parcel))

    def render(
        self, view: View, content: Content, *, whole: bool = False, stream: str | None = None
    ) -> tuple[int, Future[Picture]]:
        """Request the picture of a view, which the cluster renders.

        Parameters
        ----------
        view
            The view to render.
        content
            What the view shows.
        whole
            Render the picture on one machine, without dividing it.
        stream
            Name of a series of pictures of which only the newest matters.

        Returns
        -------
        int
            Number of the frame, for :meth:`drop`.
        Future
            The picture. The future fails with the error of an invalid view, or with CancelledError if the frame was
            dropped.
        """
        future: Future[Picture] = Future()
        frame_id = next(self._frame_ids)
        frame = PendingFrame(
            view, content, future, CancelToken(), self._clock(), view_bytes=pickle.dumps(view, protocol=5)
        )
        self._inbox.put(lambda: self._request_frame(frame_id, frame, whole, stream))
        return frame_id, future

    def drop(self, frame_id: int) -> None:
        """Cancel the rendering of a requested picture."""
        self._inbox.put(lambda: self._drop_frame(frame_id))

    def status(self) -> ClusterStatus:
        """Return the state of the cluster and its machines.

        Raises
        ------
        ClusterError
            ``cluster.closed``: if the console is closed.
        """
        answer: Future[ClusterStatus] = Future()
        with self._closing:
            if self._closed:
                raise ClusterError("the cluster is closed", code="cluster.closed")
            self._inbox.put(lambda: answer.set_result(self._make_status()))
        return answer.result(timeout=10.0)

    @property
    def has_renderers(self) -> bool:
        """Whether a machine other than that of the console can render now."""
        return any(not m.reserve and not m.loading for m in list(self._members.values()))

    def facts(self, name: str) -> LaneFacts:
        """Return host, processor, memory and versions of the machine of a lane."""
        return self._members[name].lane.facts

    def lane(self, name: str) -> Lane:
        """Return the lane with this name, for tests and benchmarks."""
        return self._members[name].lane

    @property
    def num_ready(self) -> int:
        """Number of lanes that can render now. The console's own lane counts only if it is the only one."""
        return max(1, sum(not m.reserve and not m.loading for m in list(self._members.values())))

    def close(self) -> None:
        """Cancel all pictures and close the lanes."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
            self._inbox.put(None)
        self._thread.join(timeout=30.0)

    def _run(self) -> None:
        """Handle events, deadlines and delayed retries until the console is closed."""
        while True:
            try:
                happen = self._inbox.get(timeout=self._wait_s())
            except queue.Empty:
                happen = _do_nothing
            # All queued events are handled before lanes are declared late, because answers may wait in the queue.
            while happen is not None:
                _run_and_log_errors(happen)
                try:
                    happen = self._inbox.get_nowait()
                except queue.Empty:
                    break
            if happen is None:
                break
            now_s = self._clock()
            due_s = self._scheduler.deadline_s
            if due_s is not None and now_s >= due_s:
                _run_and_log_errors(partial(self._handle_time, now_s))
            for item in [item for item in self._later if item[0] <= now_s]:
                self._later.remove(item)
                _run_and_log_errors(item[1])
        for frame in self._frames.values():
            set_failure(frame.future, CancelledError("the cluster was closed"))
        for member in self._members.values():
            _run_and_log_errors(member.lane.close)

    def _handle_time(self, now_s: float) -> None:
        self._scheduler.mark_late_lanes(now_s)
        self._run_actions()

    def _wait_s(self) -> float | None:
        """Return the time in seconds until the next deadline or retry; None if there is none."""
        due = [at_s for at_s, _ in self._later]
        deadline_s = self._scheduler.deadline_s
        if deadline_s is not None:
            due.append(deadline_s)
        # 0.2 ms longer, so that rounding does not end the wait just before the deadline.
        return max(0.0, min(due) - self._clock()) + 0.0002 if due else None

    def _add_member(self, lane: Lane, reserve: bool) -> None:
        if lane.name in self._members:
            self._remove_member(lane.name)
        self._members[lane.name] = _Member(lane, reserve)
        self._load_content(lane.name)

    def _remove_member(self, name: str) -> None:
        member = self._members.pop(name, None)
        if member is None:
            return
        self._scheduler.leave(name, self._clock())
        self._run_actions()
        member.lane.close()
        self._notify_without_renderers()

    def _set_content(self, parcel: Parcel) -> None:
        """Set the content and load it on all renderers, unless it is older than the current content."""
        if self._parcel is not None and parcel.content <= self._parcel.content:
            return
        self._parcel = parcel
        for name, member in list(self._members.items()):
            if not member.loading or member.loaded == 0:
                self._load_content(name)

    def _load_content(self, name: str) -> None:
        """Send the current content to a renderer, which renders strips after it has loaded the content."""
        member = self._members.get(name)
        if member is None:
            return
        parcel = self._parcel
        if parcel is None:
            # No content was set yet, so there is nothing to load.
            if member.reserve:
                member.loading = False
                self._scheduler.join(name, self._clock(), reserve=True)
            return
        member.generation += 1
        generation = member.generation
        was_loading = member.loading

        def done(trouble: BaseException | None) -> None:
            self._inbox.put(lambda: self._handle_load_end(name, generation, parcel, trouble))

        try:
            light = member.lane.load(parcel, done)
        except Exception as trouble:
            # Handled as a failed load: other renderers still get the content, and this one is tried again.
            done(trouble)
            return
        if light and not was_loading:
            self._scheduler.load(name, parcel.content, self._clock())
            self._run_actions()

    def _handle_load_end(self, name: str, generation: int, parcel: Parcel, trouble: BaseException | None) -> None:
        """Handle the end of a renderer's load: start to use it, load newer content, or schedule another attempt."""
        member = self._members.get(name)
        if member is None or generation != member.generation:
            return
        if trouble is None:
            member.attempts = 0
            member.loaded = parcel.content
            now_s = self._clock()
            if member.loading:
                member.loading = False
                self._scheduler.join(name, now_s, content=parcel.content, reserve=member.reserve)
            else:
                self._scheduler.load(name, parcel.content, now_s)
            self._run_actions()
            if self._parcel is not parcel:
                self._load_content(name)
            return
        if isinstance(trouble, ClusterError) and trouble.code in {"cluster.memory", "cluster.version"}:
            self._add_notice(str(trouble))
            self._remove_member(name)
            return
        self._schedule_retry(name, trouble)

    def _schedule_retry(self, name: str, trouble: BaseException) -> None:
        """Take a renderer out of use and schedule its next attempt to load."""
        member = self._members[name]
        if not member.loading:
            member.loading = True
            self._scheduler.leave(name, self._clock())
            self._run_actions()
        logger.info("renderer %s: %s; it is retried", name, type(trouble).__name__)
        wait_s = RETRY_S[min(member.attempts, len(RETRY_S) - 1)]
        member.attempts += 1
        if member.attempts == NOTIFY_AFTER_LOADS:
            why = str(trouble) if isinstance(trouble, ClusterError) else type(trouble).__name__
            self._add_notice(f"the renderer {name} cannot load the case ({why}); Carina keeps trying")
        self._later.append((self._clock() + wait_s, lambda: self._load_content(name)))
        self._notify_without_renderers()

    def _request_frame(self, frame_id: int, frame: PendingFrame, whole: bool, stream: str | None) -> None:
        """Pass a requested picture to the scheduler."""
        self._frames[frame_id] = frame
        view = frame.view
        # The limit in bytes is converted to rows; an answer has three bytes per pixel.
        max_rows = None if whole else max(1, self._settings.max_strip_bytes // (3 * view.width))
        self._scheduler.request(
            frame_id,
            view.height,
            self._clock(),
            content=frame.content.number,
            cost=(type(view).__name__, view.width, view.height),
            whole=whole,
            stream=stream,
            max_rows=max_rows,
        )
        self._run_actions()

    def _drop_frame(self, frame_id: int) -> None:
        frame = self._frames.get(frame_id)
        if frame is not None:
            frame.stop.cancel()
            self._scheduler.drop(frame_id, self._clock())
            self._run_actions()

    def _run_actions(self) -> None:
        """Carry out the actions that the scheduler has collected."""
        for action in self._scheduler.take_actions():
            match action:
                case Issue():
                    self._send_strip(action)
                case FrameDone(frame_id):
                    self._deliver_frame(self._frames.pop(frame_id))
                case FrameDropped(frame_id):
                    # The frame is missing if its future already failed with the error of an invalid view.
                    frame = self._frames.pop(frame_id, None)
                    if frame is not None:
                        frame.stop.cancel()
                        set_failure(frame.future, CancelledError("the image was superseded by a newer one"))
                case LaneLate(lane):
                    # The user is notified only of a delay that lasts; the cluster panel shows each delay.
                    self._later.append((self._clock() + NOTIFY_AFTER_S, partial(self._notify_if_late, str(lane))))
                case LaneBack():
                    pass
        self.max_open_frames = self._scheduler.max_open_frames

    def _notify_if_late(self, name: str) -> None:
        if any(view.lane == name and view.state == "late" for view in self._scheduler.lanes()):
            self._add_notice(f"the renderer {name} is late; the other machines render its part until it responds")

    def _send_strip(self, task: Issue) -> None:
        """Send a strip order to the lane that the scheduler chose."""
        frame = self._frames[task.frame_id]
        member = self._members[str(task.lane)]
        whole = (task.first_row, task.end_row) == (0, frame.view.height)
        rows = None if whole else (task.first_row, task.end_row)
        content = frame.content
        order = StripOrder(
            task.task_id,
            task.frame_id,
            content.number,
            frame.view,
            rows,
            view_bytes=frame.view_bytes,
            renderer=content.renderer,
            scene=content.scene,
            stop=frame.stop,
        )
        self._tasks[task.task_id] = (order, self._clock())
        name = str(task.lane)

        def done(answer: StripAnswer | BaseException) -> None:
            at_s = self._clock()
            self._inbox.put(lambda: self._handle_answer(name, order, answer, at_s))

        try:
            member.lane.submit(order, done)
        except Exception as error:
            # Every order needs an answer: the console's own lane has no deadline that would detect a missing one.
            done(error)

    def _handle_answer(self, name: str, order: StripOrder, answer: StripAnswer | BaseException, at_s: float) -> None:
        """Handle a lane's answer: check it, copy its rows into the frame, and report it to the scheduler."""
        _, issued_s = self._tasks.pop(order.task_id, (order, None))
        if issued_s is None:
            # A second answer of a lane to the same order is ignored.
            return
        frame = self._frames.get(order.frame_id)
        if isinstance(answer, BaseException):
            self._handle_refusal(name, order, frame, answer)
            return
        rows = order.rows or (0, order.view.height)
        try:
            wrong = find_mismatch(answer, order)
            if wrong is None and frame is not None and self._scheduler.expects(name, order.task_id):
                # Copied before the scheduler counts the rows as done: if the copy fails, another lane must render them.
                frame.copy_rows(answer, rows)
        except Exception as error:
            wrong = f"an unusable strip ({type(error).__name__}: {error})"
        if wrong is not None:
            self._handle_fault(name, order, wrong)
            return
        member = self._members.get(name)
        if member is not None:
            member.latency.note(at_s, at_s - issued_s)
        # The current time, not the time of the answer: the scheduler's clock must not run backwards.
        accepted = self._scheduler.answered(name, order.task_id, answer.seconds, self._clock())
        if self.jobs is not None:
            self.jobs.append(StripTiming(name, order.frame_id, rows, issued_s, at_s, answer.seconds, accepted))
        self._run_actions()

    def _handle_refusal(self, name: str, order: StripOrder, frame: PendingFrame | None, trouble: BaseException) -> None:
        """Handle an error of a lane: the view is invalid, the frame was cancelled, or the renderer failed."""
        now_s = self._clock()
        if isinstance(trouble, ClusterError) and trouble.code == "cluster.fault":
            self._handle_fault(name, order, str(trouble))
            return
        if isinstance(trouble, CancelledError):
            if frame is not None:
                self._drop_frame(order.frame_id)
            self._scheduler.answered(name, order.task_id, 1e-9, now_s)
            self._run_actions()
            return
        if isinstance(trouble, CarinaError) and not isinstance(trouble, ClusterError):
            # The view itself is invalid, so every renderer would refuse it.
            self._frames.pop(order.frame_id, None)
            if frame is not None:
                set_failure(frame.future, trouble)
                self._scheduler.drop(order.frame_id, now_s)
            self._scheduler.answered(name, order.task_id, 1e-9, now_s)
            self._run_actions()
            return
        member = self._members.get(name)
        self._scheduler.failed(name, order.task_id, now_s)
        if member is not None and member.reserve:
            # The console's own lane failed, and no other lane can render the strip.
            self._scheduler.join(name, now_s, reserve=True)
            self._frames.pop(order.frame_id, None)
            if frame is not None:
                set_failure(frame.future, trouble)
                self._scheduler.drop(order.frame_id, now_s)
            self._run_actions()
            return
        self._run_actions()
        if member is not None and not member.loading:
            self._add_notice(
                f"the renderer {name} is not responding; the other machines render its part until it is back"
            )
            self._schedule_retry(name, trouble)

    def _handle_fault(self, name: str, order: StripOrder, wrong: str) -> None:
        """Count a wrong answer of a renderer; with :data:`MAX_FAULTS` wrong answers the renderer is removed."""
        self._scheduler.failed(name, order.task_id, self._clock())
        self._run_actions()
        member = self._members.get(name)
        if member is None or member.loading:
            return
        member.faults += 1
        if member.faults >= MAX_FAULTS:
            self._add_notice(f"the renderer {name} keeps returning invalid replies ({wrong}) and is no longer used")
            self._remove_member(name)
            return
        self._add_notice(f"the renderer {name} returned an invalid reply: {wrong}; another machine rendered its part")
        self._schedule_retry(name, ClusterError(wrong, code="cluster.fault"))

    def _deliver_frame(self, frame: PendingFrame) -> None:
        now_s = self._clock()
        self._meter.note(now_s, now_s - frame.requested_s)
        frame.complete(now_s)

    def _add_notice(self, words: str) -> None:
        if words not in self._reported:
            self._reported.add(words)
            self._notices.append(words)
            del self._notices[:-50]
            logger.warning("%s", words)

    def _notify_without_renderers(self) -> None:
        if not self._closed and any(m.reserve for m in self._members.values()) and not self.has_renderers:
            logger.info("no renderer is left; this machine renders alone")

    def _make_status(self) -> ClusterStatus:
        """Return the state of all renderers, for :meth:`status`."""
        now_s = self._clock()
        views = {str(view.lane): view for view in self._scheduler.lanes()}
        members = []
        for name, member in self._members.items():
            view = views.get(name)
            facts = member.lane.facts
            latency_s = member.latency.median_s
            members.append(
                MemberStatus(
                    name=name,
                    host=facts.host,
                    threads=facts.threads,
                    simd=facts.simd,
                    state="loading" if view is None else view.state,
                    share=0.0 if view is None else view.share,
                    latency_ms=None if latency_s is None else latency_s * 1e3,
                    num_late=0 if view is None else view.num_late,
                    num_strips=0 if view is None else view.num_answers,
                )
            )
        frame_s = self._meter.median_s
        return ClusterStatus(
            address=self.address,
            members=tuple(members),
            alone=not self.has_renderers,
            mixed=self.mixed,
            fps=self._meter.rate_hz(now_s),
            frame_ms=None if frame_s is None else frame_s * 1e3,
            notices=tuple(self._notices),
        )


def _run_and_log_errors(step: Callable[[], object]) -> None:
    """Run an event handler and log any error, because an error in the console's thread would stop all pictures."""
    try:
        step()
    except Exception:
        logger.exception("the console could not render an image")


def _do_nothing() -> None:
    """Do nothing; this is the event handler for a wait that timed out."""
