"""The core of a session: listeners, jobs, the open case, undo, and updates of tip and renderer after a change."""

from __future__ import annotations

import contextvars
import itertools
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from carina.case.document import Document
from carina.case.history import History
from carina.case.routes import path_move, position_on_new_route_mm
from carina.commands import Command, CycleControl, GoTo, SetMode, SetOperator, Steer, ToggleMode
from carina.commands.value import LocalCommand
from carina.errors import CarinaError, NoEvidenceError, UsageError
from carina.navigate import Move
from carina.navigate.moves import LayScope
from carina.render import Sight
from carina.session.engines import Parts, RendererFactory, default_parts
from carina.session.jobs.background_jobs import JobEnded, JobProgress, JobRunner
from carina.session.jobs.job_groups import current_group
from carina.session.open_case.open_case import LastMove, OpenCase, pose_info, shown_deformation
from carina.session.scene.picture_state import PictureState
from carina.session.scene.shown_case import ShownCase
from carina.session.scene.window_views import following_tip
from carina.session.state.snapshot import (
    BreathingInfo,
    Changed,
    ChestMoved,
    ErrorEvent,
    EvidenceMissing,
    FlightInfo,
    OpeningInfo,
    PoseInfo,
    SavingInfo,
    Snapshot,
    StartMarked,
    Topic,
    UserMessage,
)
from carina.session.store.local_settings import LocalStore

MAX_SHOWN_CHARS = 4000
"""Maximum shown length of a name or a description, which another program may have written."""


def flight_list(case: OpenCase, saving: SavingInfo) -> tuple[FlightInfo, ...]:
    """Return the recorded flights in their order; the caller holds the session's lock."""
    running = {recording.number for recording in case.flights.unwritten if not recording.closed}
    expert = case.expert_flight
    return tuple(
        FlightInfo(
            number=one.recording_id,
            name=one.name[:MAX_SHOWN_CHARS],
            words=one.words[:MAX_SHOWN_CHARS],
            begun_s=None if saving.begun_s is None else saving.begun_s + one.begun_s,
            length_s=one.length_s,
            is_expert=one.recording_id == expert,
            state="recording" if one.recording_id in running else "complete" if one.complete else "cut-off",
        )
        for one in case.flights.listed
    )


def breathing_info(case: OpenCase) -> BreathingInfo:
    """Return the settings of the simulated breathing; the caller holds the session's lock."""
    live, airways = case.flights.breathing, case.document.airways
    if live.last is None:
        return BreathingInfo()
    is_on = airways is not None and live.motion(airways.tree) is not None
    return BreathingInfo(is_on, live.last.craniocaudal_mm, live.last.period_s)


Event = Changed | ChestMoved | ErrorEvent | EvidenceMissing | UserMessage | StartMarked | JobProgress | JobEnded
# Longest time in s between two moves that is counted as contact with the wall.
MAX_CONTACT_S = 10.0
WATCHING = "session.watching"
ALL_TOPICS: tuple[Topic, ...] = (
    "state", "tree", "route", "plan", "lungs", "key_frames", "history", "pose", "views", "training",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _RunningCommand:
    """A running command, and the number of the window that sent it."""

    command: Command | None = None
    window: int | None = None


_NO_COMMAND = _RunningCommand()
# Jobs inherit this context, so a change by a job is attributed to the command that started the job.
_running_command: contextvars.ContextVar[_RunningCommand] = contextvars.ContextVar(
    "running_command", default=_NO_COMMAND
)


class SessionCore:
    """State and services that all command handlers of a :class:`carina.session.Session` share."""

    def __init__(
        self,
        renderer_factory: RendererFactory,
        *,
        job_renderer_factory: RendererFactory | None = None,
        parts: Parts | None = None,
        store: LocalStore | None = None,
        submit: Callable[[Callable[[], None]], object] | None = None,
        clock: Callable[[], float] = time.monotonic,
        today: Callable[[], str] = lambda: time.strftime("%Y-%m-%d"),
    ) -> None:
        self.renderer_factory = renderer_factory
        self.job_renderer_factory = job_renderer_factory or renderer_factory
        self.parts = parts or default_parts()
        self.store = store
        self.clock = clock
        self.today = today
        self.lock = threading.RLock()
        self._pool = None if submit else ThreadPoolExecutor(4, thread_name_prefix="carina-job")
        self.jobs = JobRunner(submit or self._submit_to_pool, self.emit, clock)
        self._listeners: list[tuple[Callable[[Event], None], int | None]] = []
        """Pairs of an event listener and the number of its window; None for a listener that is not a window."""
        self._watched: dict[int, int] = {}
        """Number of the case that each observer window may see, by window number; entries are never removed."""
        self.case: OpenCase | None = None
        self.opening: OpeningInfo | None = None
        """The CT that is being opened, as far as it may be shown; None before its headers are read."""
        self.case_numbers = itertools.count(1)
        self.device_woken = threading.Event()
        self.saving: Callable[[], SavingInfo] = SavingInfo
        """Function that returns whether and where the open case is saved."""
        self.before_move: Callable[[], None] = lambda: None
        self.device_lost: Callable[[str], None] = lambda _device: None
        """Function called with the session locked when the device that moves the tip was disconnected."""
        self.tip_held = False
        """Whether moves of the tip are ignored, because the attempt at a task is paused."""
        self.before_document: list[Callable[[OpenCase], None]] = []
        """Functions called with the session locked after a document change, before tip and renderer are updated."""
        self.after_document: list[Callable[[OpenCase], None]] = []
        """Functions called with the session locked, after the update of tip and renderer to a changed document."""
        self.after_case: list[Callable[[], None]] = []
        """Functions called with the session locked when the open case is discarded; they release what belongs to it."""
        self.after_breathing: list[Callable[[OpenCase], None]] = []
        """Functions called with the session locked after a change of the simulated breathing."""
        self.after_sight: list[Callable[[OpenCase], None]] = []
        """Functions that are called, with the session locked, after a window's display settings have changed."""
        self._pose_id = 0
        self._pose_s = clock()
        self._steered_s = 0.0

    # ------------------------------------------------------------ listeners, jobs, shutdown

    def subscribe(
        self, listener: Callable[[Event], None], window: int | None = None, *, watches: bool = False
    ) -> Callable[[], None]:
        """Add a listener, with its own sight if it is a window, and return the function that removes it."""
        entry = listener, window
        with self.lock:
            if watches and window is not None:
                self._watched[window] = self.needed_case().number
            self._listeners.append(entry)
            if self.case is not None and window is not None:
                self.case.sights.begin(window)

        def unsubscribe() -> None:
            with self.lock:
                if entry in self._listeners:
                    self._listeners.remove(entry)
                if self.case is not None and window is not None:
                    self.case.sights.end(window)

        return unsubscribe

    def close(self) -> None:
        """Stop all jobs and end the worker threads."""
        self.jobs.close()
        if self._pool is not None:
            # A queued job still starts, and ends at its first check for cancellation. Without a start it would never
            # end, and a thread that waits for the job would wait forever.
            self._pool.shutdown(wait=True)

    def _submit_to_pool(self, work: Callable[[], None]) -> None:
        assert self._pool is not None
        self._pool.submit(work)

    @property
    def windows(self) -> tuple[int, ...]:
        """Numbers of the windows that show the case."""
        return tuple(window for _, window in self._listeners if window is not None)

    def refuse_watcher(self, command: Command, window: int | None) -> None:
        """Refuse a command of an observer window that is not for its own sight; the caller holds the session's lock."""
        if window in self._watched and (
            self._case_shown_to(window) is None or command.sets not in Sight.__struct_fields__
        ):
            raise UsageError("you are watching; you can change only your own slices, zoom and window", code=WATCHING)

    def _case_shown_to(self, window: int | None) -> OpenCase | None:
        """Return the open case; None if none is open, or if the window is an observer of another case."""
        case = self.case
        if case is None or window is None:
            return case
        return case if self._watched.get(window, case.number) == case.number else None

    @contextmanager
    def doing(self, command: Command, window: int | None) -> Iterator[None]:
        """Attribute every change of this block, and of the jobs started in it, to this command of this window."""
        token = _running_command.set(_RunningCommand(command, window))
        try:
            yield
        finally:
            _running_command.reset(token)

    def emit(self, event: Event) -> None:
        """Send an event to all listeners, with the session locked."""
        with self.lock:
            if isinstance(event, JobEnded) and event.error is not None and not _is_reported_by_event(event.error):
                self.answer(ErrorEvent(event.error.code, str(event.error)))
            for listener, _ in tuple(self._listeners):
                listener(event)

    def answer(self, event: Event) -> None:
        """Send an event to the window of the current command and to listeners that are not windows.

        All listeners receive the event if the command has no window, or if its window is closed.
        """
        with self.lock:
            asking = _running_command.get().window
            for listener, window in tuple(self._listeners):
                if window in {None, asking} or asking not in self.windows:
                    listener(event)

    def changed(self, *topics: Topic) -> None:
        """Report to all listeners which parts of the state have changed."""
        self.emit(Changed(frozenset(topics)))

    def needed_case(self) -> OpenCase:
        """Return the open case.

        Raises
        ------
        UsageError
            If no case is open, or the current job group belongs to another case.
        """
        case, job_group = self.case, current_group()
        if case is None:
            raise UsageError("no case is open", code="session.no-case")
        if job_group is not None and job_group.case_number not in {None, case.number}:
            raise UsageError("this case is no longer open here", code="case.closed")
        return case

    # ------------------------------------------------------------ undo

    def undo(self) -> None:
        """Undo the case's last change that was not undone."""
        self._move_in_history(lambda history: history.undo(), "undone")

    def redo(self) -> None:
        """Redo the last change that was undone."""
        self._move_in_history(lambda history: history.redo(), "redone")

    def history(self) -> tuple[str, ...]:
        """Return the labels of the changes that can be undone, the oldest first."""
        with self.lock:
            return self.needed_case().history.labels

    def go_to_step(self, position: int) -> None:
        """Restore the state after the first ``position`` steps of the history.

        Raises
        ------
        UsageError
            If the history has fewer steps.
        """
        case = self.needed_case()
        with self.lock:
            num_steps = len(case.history.steps)
            if position > num_steps:
                raise UsageError(
                    f"the history has {num_steps} steps; there is no step {position}", code="session.history"
                )
            if position == case.history.position:
                return
            case.history.go_to(position)
            label = case.history.undo_label
            which = "before all changes" if label is None else f"after: {label}"
            self._show_history_state(case, f"restored the state {which}")

    def _move_in_history(self, move: Callable[[History[Document]], str | None], words: str) -> None:
        case = self.needed_case()
        with self.lock:
            label = move(case.history)
            if label is None:
                self.answer(UserMessage(f"there is nothing to {'undo' if words == 'undone' else 'redo'}"))
                return
            self._show_history_state(case, f"{words}: {label}")

    def _show_history_state(self, case: OpenCase, words: str) -> None:
        self.follow(case)
        self.emit(UserMessage(words))
        self.changed(*ALL_TOPICS)

    def change(self, case: OpenCase, label: str, document: Document, *, gesture: Hashable = None) -> None:
        """Apply a change by the user; the caller holds the session's lock."""
        self.add_step(case, label, document, gesture=gesture)
        self.follow(case)
        self.changed(*ALL_TOPICS)

    def add_step(self, case: OpenCase, label: str, document: Document, *, gesture: Hashable = None) -> None:
        """Add a step of undo without updating the tip and the renderer; the caller holds the session's lock."""
        command = _running_command.get().command
        now_s = self.clock()
        case.history.change(
            label,
            document,
            now_s=now_s,
            gesture=gesture,
            # A command that names a file of this machine is not stored, because the case may be given to other people.
            command=None if isinstance(command, LocalCommand) else command,
            at_s=max(0.0, now_s - case.begun_s),
        )

    def see(self, case: OpenCase, change: Callable[[Sight], Sight]) -> None:
        """Change the sight of the window of the current command, or of all windows if there is none; not undoable."""
        with self.lock:
            window = _running_command.get().window
            works = window not in self._watched
            case.sights.change(window, change, is_latest=works)
            for step in self.after_sight if works else ():
                step(case)
            self.answer(Changed(frozenset({"state", "views"})))

    def edit(self, label: str | None, gesture: Hashable, **values: Any) -> None:
        """Change fields of the document as one undoable step; do nothing if all values are equal already."""
        case = self.needed_case()
        with self.lock:
            if any(getattr(case.document, name) != value for name, value in values.items()):
                self.change(case, label or "change", replace(case.document, **values), gesture=gesture)

    # ------------------------------------------------------------ updates after a change of the document

    def follow(self, case: OpenCase) -> None:
        """Update the tip, the renderer and all other values that depend on the document; the caller holds the lock."""
        for step in self.before_document:
            step(case)
        self._follow_document(case)
        for step in self.after_document:
            step(case)

    def _follow_document(self, case: OpenCase) -> None:
        """Update the tip and the renderer to the current document."""
        document = case.document
        airways = document.airways
        if case.flown_route is not document.route:
            before, before_mm, case.flown_route = case.flown_route, case.navigator.path_mm, document.route
            case.pilot.apply(path_move(None if airways is None else airways.tree, document.route))
            # A change of the route must not move the tip into another airway.
            if before is not None and before_mm is not None and document.route is not None:
                seat = position_on_new_route_mm(before, before_mm, document.route)
                if seat is not None and case.navigator.mode == "path":
                    case.pilot.apply(GoTo(seat))
            self.moved()
        if case.navigator.operator != document.look.operator:
            case.pilot.apply(SetOperator(document.look.operator))
            self.moved()
        case.content.follow(document)

    def moved(self) -> None:
        """Count a new pose, and record that a program moved the tip last."""
        self._pose_id += 1
        self._pose_s = self.clock()
        if self.case is not None:
            # The callers that move the tip for a hand, a device or a recording set their cause after this call.
            self.case.last_move = LastMove(person_moved=self.case.last_move.person_moved)

    # ------------------------------------------------------------ moving the tip

    def fly(self, move: Move) -> None:
        """Apply a move to the tip, and record that the user's hand moved the tip last.

        While the tip is held, only moves that change the mode of movement are applied, since they end the attempt.
        """
        case = self.needed_case()
        with self.lock:
            if self.tip_held and not isinstance(move, SetMode | ToggleMode | CycleControl | LayScope):
                return
            mode = case.navigator.mode
            self.before_move()
            case.pilot.apply(move, dt_s=self._seconds_since_steering() if isinstance(move, Steer) else 0.0)
            self.after_move(case, mode)

    def _seconds_since_steering(self) -> float:
        now_s = self.clock()
        dt_s, self._steered_s = min(max(now_s - self._steered_s, 0.0), MAX_CONTACT_S), now_s
        return dt_s

    def after_move(self, case: OpenCase, mode: str) -> None:
        """Report a move by hand: re-centre panned views, and notify listeners. The caller holds the session's lock."""
        is_recentred = case.sights.change(None, following_tip)
        self.moved()
        case.last_move = LastMove("hand", person_moved=True)
        if case.navigator.mode != mode or is_recentred:
            self.changed("state", "pose", "views")
        else:
            self.changed("pose", "views")

    # ------------------------------------------------------------ state for other objects

    def snapshot(self, window: int | None = None) -> Snapshot:
        """Return the state without the pose, as one window shows it; by default, the window that was used last."""
        with self.lock:
            case = self._case_shown_to(window)
            if case is None:
                return Snapshot()
            return Snapshot(
                case=case.info,
                case_number=case.number,
                neutral_title=case.neutral_title,
                stage="opening"
                if case.search.status in {"waiting", "finding"} and not case.document.airways
                else "ready",
                airways=case.search.status,
                airways_words=case.search.words,
                assessment=self.parts.assess_ct(case.info.volume, case.document.airways)
                if case.info.is_assessed
                else None,
                document=case.document,
                mode=case.navigator.mode,
                sight=case.sights.of(window),
                undo_label=case.history.undo_label,
                redo_label=case.history.redo_label,
                steps=case.history.steps,
                position=case.history.position,
                transfer_presets=case.info.scale.presets,
                measures=case.measures.of(case.document.airways),
                route_scale=case.planning.route_scale(case.document),
                target_places_mm=case.planning.target_places_mm(case.document),
                mask_question=None if case.pending_mask is None else case.pending_mask.question,
                saving=(saving := self.saving()),
                flights=flight_list(case, saving),
                breathing=breathing_info(case),
            )

    def pose_info(self) -> PoseInfo | None:
        """Return the newest pose and its position in the airways; None without a case."""
        with self.lock:
            return None if self.case is None else pose_info(self.case, self._pose_id, self.clock())

    def scene(self, window: int | None = None) -> ShownCase | None:
        """Return the scene that a window's views show, for its render thread; None without a case."""
        with self.lock:
            case = self._case_shown_to(window)
            if case is None:
                return None
            document = case.document
            return ShownCase(
                case_number=case.number,
                content_number=case.content.number,
                content_is_newest=case.content.is_newest,
                renderer=case.content.renderer,
                pose=case.navigator.pose,
                pose_id=self._pose_id,
                pose_s=self._pose_s,
                look=document.look,
                sight=case.sights.of(window),
                has_lumen=case.content.has_lumen,
                frames=None if document.route is None else document.route.frames,
                path_mm=case.navigator.path_mm,
                picture_turned=case.navigator.picture_turned,
                lumen=case.outline,
                layers=case.planning.lungs.shown(),
                deformation=shown_deformation(case, self.clock()),
            )

    def picture_state(self, window: int | None = None) -> PictureState:
        """Return the state of the open case from which a picture of a window is saved."""
        with self.lock:
            case = self.needed_case()
            return PictureState(case.info.volume, case.document, self.scene(window))


def _is_reported_by_event(error: CarinaError) -> bool:
    """Return whether the error needs no further message, because :class:`EvidenceMissing` has reported it."""
    return isinstance(error, NoEvidenceError)
