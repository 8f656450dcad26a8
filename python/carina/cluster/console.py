"""The console (paper 5, Figure 7): hands strips out, watches deadlines, puts pictures together; a thread of its own."""

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

from carina.cluster.frames import Content, Frame, fail, what_is_wrong
from carina.cluster.lanes import Lane, LaneFacts, LocalLane, StripAnswer, StripOrder
from carina.cluster.parcel import Parcel, Parcels
from carina.cluster.rate import RateMeter
from carina.cluster.scheduler import FrameDone, FrameDropped, Issue, LaneBack, LaneLate, StripScheduler
from carina.cluster.settings import ClusterSettings
from carina.errors import CancelledError, CarinaError, ClusterError
from carina.render import CancelToken, ClusterStatus, MemberStatus, Picture, View

__all__ = ["Console", "Content", "Job"]

logger = logging.getLogger(__name__)

RETRY_S = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""A renderer that cannot be loaded is asked again after these times, then always after the last."""
TELL_AFTER_LOADS = 5
"""A renderer that could not be loaded so often is told of; after a restart it is asked once or twice for nothing."""
TELL_AFTER_S = 0.5
"""A renderer that is late for so long is told of."""
MAX_FAULTS = 5
"""Wrong answers after which a renderer is not used any more."""


@dataclass(frozen=True, slots=True)
class Job:
    """One strip as the console saw it, for timelines (paper, Figure 11)."""

    lane: str
    frame_id: int
    rows: tuple[int, int]
    issued_s: float
    answered_s: float
    seconds: float
    """What the renderer took."""
    accepted: bool


@dataclass(slots=True)
class _Member:
    lane: Lane
    reserve: bool
    loading: bool = True
    """Asked to load, or waiting to be asked again."""
    attempts: int = 0
    faults: int = 0
    loaded: int = 0
    generation: int = 0
    """Answers to loads of an earlier generation do not count."""
    latency: RateMeter = field(default_factory=RateMeter)


class Console:
    """Renders pictures on lanes.

    Parameters
    ----------
    settings
        Of the scheduler.
    clock
        Seconds, monotonic.
    keep_jobs
        Remember what was rendered where, for timelines.
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
        self._frames: dict[int, Frame] = {}
        self._tasks: dict[int, tuple[StripOrder, float]] = {}
        self._parcel: Parcel | None = None
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._frame_ids = itertools.count(1)
        self._notices: list[str] = []
        self._told: set[str] = set()
        self._meter = RateMeter()
        self._status: ClusterStatus | None = None
        self.jobs: list[Job] | None = [] if keep_jobs else None
        self.parcels = Parcels()
        """One series of content numbers, over all cases that are shown one after the other."""
        self.address = "local"
        self.mixed = False
        self._closed = False
        self._closing = threading.Lock()
        # The last resort, and the reason why a lost machine is no error.
        self.add_lane(LocalLane(), reserve=True)
        self._thread = threading.Thread(target=self._run, name="carina-console", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        return f"Console({len(self._members)} renderers)"

    # --- called from anywhere --------------------------------------------------------------------------------------

    def add_lane(self, lane: Lane, *, reserve: bool = False) -> None:
        """A renderer has come; it takes part once it has loaded what is shown. Where all is closed it is let go."""
        with self._closing:
            if not self._closed:
                self._inbox.put(lambda: self._add(lane, reserve))
                return
        lane.close()

    def remove_lane(self, name: str) -> None:
        """A renderer is gone for good."""
        self._inbox.put(lambda: self._remove(name))

    def notice(self, words: str) -> None:
        """Tell the person something, once."""
        self._inbox.put(lambda: self._tell(words))

    def set_content(self, parcel: Parcel) -> None:
        """What frames show from now on; frames before and after name theirs."""
        self._inbox.put(lambda: self._set_content(parcel))

    def render(
        self, view: View, content: Content, *, whole: bool = False, stream: str | None = None
    ) -> tuple[int, Future[Picture]]:
        """Want a picture; the number is for :meth:`drop`.

        The future fails with what the view itself is refused for, or with CancelledError once it was dropped.
        """
        future: Future[Picture] = Future()
        frame_id = next(self._frame_ids)
        frame = Frame(view, content, future, CancelToken(), self._clock(), view_bytes=pickle.dumps(view, protocol=5))
        self._inbox.put(lambda: self._want(frame_id, frame, whole, stream))
        return frame_id, future

    def drop(self, frame_id: int) -> None:
        """Nobody wants this picture any more."""
        self._inbox.put(lambda: self._drop(frame_id))

    def status(self) -> ClusterStatus:
        """How the cluster does."""
        answer: Future[ClusterStatus] = Future()
        with self._closing:
            if self._closed:
                raise ClusterError("the cluster is closed", code="cluster.closed")
            self._inbox.put(lambda: answer.set_result(self._make_status()))
        return answer.result(timeout=10.0)

    @property
    def has_renderers(self) -> bool:
        """Whether any machine but the console's own can render now."""
        return any(not m.reserve and not m.loading for m in list(self._members.values()))

    def facts(self, name: str) -> LaneFacts:
        """The machine behind a lane."""
        return self._members[name].lane.facts

    def lane(self, name: str) -> Lane:
        """A lane, for tests and benchmarks."""
        return self._members[name].lane

    @property
    def num_ready(self) -> int:
        """How many lanes can render now, the console's own only where there is no other."""
        return max(1, sum(not m.reserve and not m.loading for m in list(self._members.values())))

    def close(self) -> None:
        """Give up what is under way and let the lanes go."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
            self._inbox.put(None)
        self._thread.join(timeout=30.0)

    # --- the console's own thread ----------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            try:
                happen = self._inbox.get(timeout=self._wait_s())
            except queue.Empty:
                happen = _nothing
            # Everything that has come, before anyone is called late: answers may have waited for this thread.
            while happen is not None:
                _whatever_happens(happen)
                try:
                    happen = self._inbox.get_nowait()
                except queue.Empty:
                    break
            if happen is None:
                break
            now_s = self._clock()
            due_s = self._scheduler.deadline_s
            if due_s is not None and now_s >= due_s:
                _whatever_happens(partial(self._tick, now_s))
            for item in [item for item in self._later if item[0] <= now_s]:
                self._later.remove(item)
                _whatever_happens(item[1])
        for frame in self._frames.values():
            fail(frame.future, CancelledError("the cluster was closed"))
        for member in self._members.values():
            _whatever_happens(member.lane.close)

    def _tick(self, now_s: float) -> None:
        self._scheduler.tick(now_s)
        self._act()

    def _wait_s(self) -> float | None:
        due = [at_s for at_s, _ in self._later]
        deadline_s = self._scheduler.deadline_s
        if deadline_s is not None:
            due.append(deadline_s)
        # A hair more, so that rounding of the wait does not end it just before.
        return max(0.0, min(due) - self._clock()) + 0.0002 if due else None

    def _add(self, lane: Lane, reserve: bool) -> None:
        if lane.name in self._members:
            self._remove(lane.name)
        self._members[lane.name] = _Member(lane, reserve)
        self._load(lane.name)

    def _remove(self, name: str) -> None:
        member = self._members.pop(name, None)
        if member is None:
            return
        self._scheduler.leave(name, self._clock())
        self._act()
        member.lane.close()
        self._note_alone()

    def _set_content(self, parcel: Parcel) -> None:
        if self._parcel is not None and parcel.content <= self._parcel.content:
            return
        self._parcel = parcel
        for name, member in list(self._members.items()):
            if not member.loading or member.loaded == 0:
                self._load(name)

    def _load(self, name: str) -> None:
        """Give a renderer what is shown now; it takes part when it has it."""
        member = self._members.get(name)
        if member is None:
            return
        parcel = self._parcel
        if parcel is None:
            # Nothing is shown yet.
            if member.reserve:
                member.loading = False
                self._scheduler.join(name, self._clock(), reserve=True)
            return
        member.generation += 1
        generation = member.generation
        was_loading = member.loading

        def done(trouble: BaseException | None) -> None:
            self._inbox.put(lambda: self._loaded(name, generation, parcel, trouble))

        try:
            light = member.lane.load(parcel, done)
        except Exception as trouble:
            # As one that cannot load: the others still get theirs, and this one is asked again.
            done(trouble)
            return
        if light and not was_loading:
            self._scheduler.load(name, parcel.content, self._clock())
            self._act()

    def _loaded(self, name: str, generation: int, parcel: Parcel, trouble: BaseException | None) -> None:
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
            self._act()
            if self._parcel is not parcel:
                self._load(name)
            return
        if isinstance(trouble, ClusterError) and trouble.code in {"cluster.memory", "cluster.version"}:
            self._tell(str(trouble))
            self._remove(name)
            return
        self._retry(name, trouble)

    def _retry(self, name: str, trouble: BaseException) -> None:
        member = self._members[name]
        if not member.loading:
            member.loading = True
            self._scheduler.leave(name, self._clock())
            self._act()
        logger.info("renderer %s: %s; it is retried", name, type(trouble).__name__)
        wait_s = RETRY_S[min(member.attempts, len(RETRY_S) - 1)]
        member.attempts += 1
        if member.attempts == TELL_AFTER_LOADS:
            why = str(trouble) if isinstance(trouble, ClusterError) else type(trouble).__name__
            self._tell(f"the renderer {name} cannot load the case ({why}); Carina keeps trying")
        self._later.append((self._clock() + wait_s, lambda: self._load(name)))
        self._note_alone()

    def _want(self, frame_id: int, frame: Frame, whole: bool, stream: str | None) -> None:
        self._frames[frame_id] = frame
        view = frame.view
        # An answer carries three bytes a pixel.
        max_rows = None if whole else max(1, self._settings.max_strip_bytes // (3 * view.width))
        self._scheduler.want(
            frame_id,
            view.height,
            self._clock(),
            content=frame.content.number,
            cost=(type(view).__name__, view.width, view.height),
            whole=whole,
            stream=stream,
            max_rows=max_rows,
        )
        self._act()

    def _drop(self, frame_id: int) -> None:
        frame = self._frames.get(frame_id)
        if frame is not None:
            frame.stop.cancel()
            self._scheduler.drop(frame_id, self._clock())
            self._act()

    def _act(self) -> None:
        for action in self._scheduler.take():
            match action:
                case Issue():
                    self._issue(action)
                case FrameDone(frame_id):
                    self._deliver(self._frames.pop(frame_id))
                case FrameDropped(frame_id):
                    # Not there: its future has been failed already, with what the view was refused for.
                    frame = self._frames.pop(frame_id, None)
                    if frame is not None:
                        frame.stop.cancel()
                        fail(frame.future, CancelledError("the image was superseded by a newer one"))
                case LaneLate(lane):
                    # A moment's delay is nobody's business but the panel's.
                    self._later.append((self._clock() + TELL_AFTER_S, partial(self._tell_if_late, str(lane))))
                case LaneBack():
                    pass

    def _tell_if_late(self, name: str) -> None:
        if any(view.lane == name and view.state == "late" for view in self._scheduler.lanes()):
            self._tell(f"the renderer {name} is late; the other machines render its part until it responds")

    def _issue(self, task: Issue) -> None:
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
            self._inbox.put(lambda: self._answered(name, order, answer, at_s))

        try:
            member.lane.submit(order, done)
        except Exception as trouble:
            # Never without an answer: the console's own lane has no deadline that would notice.
            done(trouble)

    def _answered(self, name: str, order: StripOrder, answer: StripAnswer | BaseException, at_s: float) -> None:
        _, issued_s = self._tasks.pop(order.task_id, (order, None))
        if issued_s is None:
            # A lane that answers twice.
            return
        frame = self._frames.get(order.frame_id)
        if isinstance(answer, BaseException):
            self._refused(name, order, frame, answer)
            return
        rows = order.rows or (0, order.view.height)
        try:
            wrong = what_is_wrong(answer, order)
            if wrong is None and frame is not None and self._scheduler.wants(name, order.task_id):
                # Before the scheduler counts these rows as done: what cannot be taken has to come from another.
                frame.take(answer, rows)
        except Exception as trouble:
            wrong = f"an unusable strip ({type(trouble).__name__}: {trouble})"
        if wrong is not None:
            self._fault(name, order, wrong)
            return
        member = self._members.get(name)
        if member is not None:
            member.latency.note(at_s, at_s - issued_s)
        # The scheduler's clock never runs backwards, and answers may have waited.
        accepted = self._scheduler.answered(name, order.task_id, answer.seconds, self._clock())
        if self.jobs is not None:
            self.jobs.append(Job(name, order.frame_id, rows, issued_s, at_s, answer.seconds, accepted))
        self._act()

    def _refused(self, name: str, order: StripOrder, frame: Frame | None, trouble: BaseException) -> None:
        now_s = self._clock()
        if isinstance(trouble, ClusterError) and trouble.code == "cluster.fault":
            self._fault(name, order, str(trouble))
            return
        if isinstance(trouble, CancelledError):
            if frame is not None:
                self._drop(order.frame_id)
            self._scheduler.answered(name, order.task_id, 1e-9, now_s)
            self._act()
            return
        if isinstance(trouble, CarinaError) and not isinstance(trouble, ClusterError):
            # The view itself is refused; every renderer would say so.
            self._frames.pop(order.frame_id, None)
            if frame is not None:
                fail(frame.future, trouble)
                self._scheduler.drop(order.frame_id, now_s)
            self._scheduler.answered(name, order.task_id, 1e-9, now_s)
            self._act()
            return
        member = self._members.get(name)
        self._scheduler.failed(name, order.task_id, now_s)
        if member is not None and member.reserve:
            # The console itself cannot: nobody is left to ask.
            self._scheduler.join(name, now_s, reserve=True)
            self._frames.pop(order.frame_id, None)
            if frame is not None:
                fail(frame.future, trouble)
                self._scheduler.drop(order.frame_id, now_s)
            self._act()
            return
        self._act()
        if member is not None and not member.loading:
            self._tell(f"the renderer {name} is not responding; the other machines render its part until it is back")
            self._retry(name, trouble)

    def _fault(self, name: str, order: StripOrder, wrong: str) -> None:
        self._scheduler.failed(name, order.task_id, self._clock())
        self._act()
        member = self._members.get(name)
        if member is None or member.loading:
            return
        member.faults += 1
        if member.faults >= MAX_FAULTS:
            self._tell(f"the renderer {name} keeps returning invalid replies ({wrong}) and is no longer used")
            self._remove(name)
            return
        self._tell(f"the renderer {name} returned an invalid reply: {wrong}; another machine rendered its part")
        self._retry(name, ClusterError(wrong, code="cluster.fault"))

    def _deliver(self, frame: Frame) -> None:
        now_s = self._clock()
        self._meter.note(now_s, now_s - frame.wanted_s)
        frame.deliver(now_s)

    def _tell(self, words: str) -> None:
        if words not in self._told:
            self._told.add(words)
            self._notices.append(words)
            del self._notices[:-50]
            logger.warning("%s", words)

    def _note_alone(self) -> None:
        if not self._closed and any(m.reserve for m in self._members.values()) and not self.has_renderers:
            logger.info("no renderer is left; this machine renders alone")

    def _make_status(self) -> ClusterStatus:
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


def _whatever_happens(step: Callable[[], object]) -> None:
    """Without this thread no picture would ever come again, and nobody would be told."""
    try:
        step()
    except Exception:
        logger.exception("the console could not render an image")


def _nothing() -> None:
    """Only the time has passed."""
