"""The ground of a session: listeners, jobs, the open case, undo, and bringing tip and renderer to the document."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

from carina.errors import CancelledError, CarinaError, NoEvidenceError, UsageError
from carina.navigate.moves import SetOperator
from carina.scopes import scope_preset
from carina.session.case import OpenCase, pose_info
from carina.session.document import Document
from carina.session.history import History
from carina.session.jobs import Job, JobEnded, JobProgress, JobRunner
from carina.session.parts import Parts, RendererFactory, default_parts
from carina.session.recent import LocalStore
from carina.session.routes import AirwayIndex, path_move
from carina.session.scene import Scene
from carina.session.snapshot import Changed, NotEvident, PoseInfo, Said, Snapshot, Topic, Trouble

__all__ = ["Event", "SessionCore"]

Event = Changed | Trouble | NotEvident | Said | JobProgress | JobEnded
ALL_TOPICS: tuple[Topic, ...] = ("state", "tree", "route", "keys", "pose", "views")


class SessionCore:
    """What every command of :class:`carina.session.Session` stands on."""

    def __init__(
        self,
        renderer_factory: RendererFactory,
        *,
        parts: Parts | None = None,
        store: LocalStore | None = None,
        submit: Callable[[Callable[[], None]], object] | None = None,
        clock: Callable[[], float] = time.monotonic,
        today: Callable[[], str] = lambda: time.strftime("%Y-%m-%d"),
    ) -> None:
        self._renderer_factory = renderer_factory
        self._parts = parts or default_parts()
        self._store = store
        self._clock = clock
        self._today = today
        self._lock = threading.RLock()
        self._pool = None if submit else ThreadPoolExecutor(4, thread_name_prefix="carina-job")
        self._jobs = JobRunner(submit or self._submit_to_pool, self._emit, clock)
        self._listeners: list[Callable[[Event], None]] = []
        self._case: OpenCase | None = None
        self._case_numbers = itertools.count(1)
        self._device_woken = threading.Event()
        self._pose_id = 0
        self._pose_s = clock()

    # ------------------------------------------------------------ listeners, jobs, life

    def subscribe(self, listener: Callable[[Event], None]) -> Callable[[], None]:
        """Be told of every event; returns the function that ends it."""
        with self._lock:
            self._listeners.append(listener)

        def unsubscribe() -> None:
            with self._lock:
                if listener in self._listeners:
                    self._listeners.remove(listener)

        return unsubscribe

    @property
    def jobs(self) -> JobRunner:
        """Running jobs."""
        return self._jobs

    @property
    def store(self) -> LocalStore | None:
        """Recent cases and the safety notice."""
        return self._store

    def cancel(self, job_id: str) -> None:
        """Stop a job; nothing if it has ended."""
        self._jobs.cancel(job_id)

    def close(self) -> None:
        """Stop all jobs and give the threads back."""
        self._jobs.close()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def _submit_to_pool(self, work: Callable[[], None]) -> None:
        assert self._pool is not None
        self._pool.submit(work)

    def _emit(self, event: Event) -> None:
        with self._lock:
            for listener in tuple(self._listeners):
                if isinstance(event, JobEnded) and event.error is not None and not _is_asked(event.error):
                    listener(Trouble(event.error.code, str(event.error)))
                listener(event)

    def _changed(self, *topics: Topic) -> None:
        self._emit(Changed(frozenset(topics)))

    def _needed_case(self) -> OpenCase:
        case = self._case
        if case is None:
            raise UsageError("no case is open", code="session.no-case")
        return case

    # ------------------------------------------------------------ undo

    def undo(self) -> None:
        """Take back the last change."""
        self._step(lambda history: history.undo(), "undone")

    def redo(self) -> None:
        """Do the last change taken back again."""
        self._step(lambda history: history.redo(), "done again")

    def _step(self, move: Callable[[History[Document]], str | None], words: str) -> None:
        case = self._needed_case()
        with self._lock:
            label = move(case.history)
            if label is None:
                self._emit(Said("there is nothing to be " + words))
                return
            self._follow_document(case)
            self._emit(Said(f"{words}: {label}"))
            self._changed(*ALL_TOPICS)

    def _change(self, case: OpenCase, label: str, document: Document, *, gesture: Hashable = None) -> None:
        """A change by a person, with the session locked."""
        case.history.change(label, document, now_s=self._clock(), gesture=gesture)
        self._follow_document(case)
        self._changed(*ALL_TOPICS)

    def _edit(self, label: str, gesture: Hashable, **values: Any) -> None:
        """Change fields of the document; nothing where they are so already."""
        case = self._needed_case()
        with self._lock:
            if any(getattr(case.document, name) != value for name, value in values.items()):
                self._change(case, label, replace(case.document, **values), gesture=gesture)

    # ------------------------------------------------------------ following the document

    def _follow_document(self, case: OpenCase) -> None:
        """Bring tip, index and renderer to where the document is; with the session locked."""
        document = case.document
        airways = document.airways
        if case.flown_route is not document.route:
            case.flown_route = document.route
            case.pilot.apply(path_move(None if airways is None else airways.tree, document.route))
            self._moved()
        if case.navigator.operator != document.operator:
            case.pilot.apply(SetOperator(document.operator))
            self._moved()
        new_airways = airways is not case.shown_airways
        if new_airways:
            case.index = None if airways is None else AirwayIndex(airways.tree)
            if _lumen(airways) is _lumen(case.shown_airways):
                # Another tree or other names in the same lumen: the renderer shows it already.
                case.shown_airways, new_airways = airways, False
        if new_airways or document.transfer is not case.shown_transfer:
            case.content_wanted += 1
            self._sync_display(case)

    def _sync_display(self, case: OpenCase) -> None:
        """Give the renderer the document's transfer function and lumen, then make it fast.

        One job follows the document, however many changes come: a change while it works makes what it builds stale, and
        it begins again with the newest.
        """
        with self._lock:
            case.display_wanted += 1
            if not case.display_followed:
                case.display_followed = True
                self._jobs.start(
                    "display", "preparing fast pictures", partial(self._follow_display, case, case.display_wanted)
                )

    def _follow_display(self, case: OpenCase, wanted: int, job: Job) -> None:
        try:
            while True:
                job.check()
                with self._lock:
                    wanted = case.display_wanted
                try:
                    self._show_document(case, job, partial(self._is_stale, case, job, wanted))
                except CancelledError:
                    # Stopped by a person or by another case, unless it was only the newer change.
                    job.check()
                with self._lock:
                    if case.display_wanted == wanted:
                        case.display_followed = False
                        return
        except BaseException:
            with self._lock:
                case.display_followed = False
                if case.display_wanted != wanted and self._case is case:
                    # What came after the change that this job was stopped at, or failed with.
                    self._sync_display(case)
                elif case.content_shown != case.content_wanted:
                    # Nothing brings the renderer further: what it shows is final.
                    self._content_shown(case, case.content_wanted)
            raise

    @staticmethod
    def _is_stale(case: OpenCase, job: Job, wanted: int) -> bool:
        return job.cancel() or case.display_wanted != wanted

    def _show_document(self, case: OpenCase, job: Job, stale: Callable[[], bool]) -> None:
        with self._lock:
            document, wanted = case.document, case.content_wanted
            new_transfer = document.transfer is not case.shown_transfer
            new_lumen = document.airways is not case.shown_airways
            case.shown_transfer, case.shown_airways = document.transfer, document.airways
        if new_transfer:
            case.renderer.set_transfer(document.transfer)
        if new_lumen:
            case.renderer.set_lumen(None if document.airways is None else document.airways.lumen_zyx)
        with self._lock:
            if new_transfer or new_lumen or case.content_shown != wanted:
                case.has_lumen = document.airways is not None
                self._content_shown(case, wanted)
        case.renderer.prepare(job.progress, stale)

    def _content_shown(self, case: OpenCase, wanted: int) -> None:
        """The renderer has come to a change of content; with the session locked."""
        case.content_shown = wanted
        # Also where it was taken back meanwhile: no picture since was sent as final.
        case.content_number += 1
        self._changed("views")

    def _moved(self) -> None:
        self._pose_id += 1
        self._pose_s = self._clock()
        if self._case is not None:
            # Whoever flies by themselves says so afterwards.
            self._case.keys_s, self._case.by_device = None, False

    # ------------------------------------------------------------ what others read

    def snapshot(self) -> Snapshot:
        """All but the pose."""
        with self._lock:
            case = self._case
            if case is None:
                return Snapshot()
            return Snapshot(
                case=case.info,
                stage="opening"
                if case.airways_status in {"waiting", "finding"} and not case.document.airways
                else "ready",
                airways=case.airways_status,
                airways_words=case.airways_words,
                document=case.document,
                mode=case.navigator.mode,
                crosshair_lps=case.crosshair_lps,
                orbit_tree=case.orbit_tree,
                orbit_tri_plane=case.orbit_tri_plane,
                zoom=case.zoom,
                carm=case.carm,
                reformation=case.reformation,
                slab=case.slab,
                undo_label=case.history.undo_label,
                redo_label=case.history.redo_label,
                transfer_presets=case.presets,
                measures=case.measures if case.measures_of is case.document.airways else None,
                mask_question=None if case.asked_mask is None else case.asked_mask.question,
            )

    def pose_info(self) -> PoseInfo | None:
        """The newest pose and where it is; None without a case."""
        with self._lock:
            return None if self._case is None else pose_info(self._case, self._pose_id)

    def scene(self) -> Scene | None:
        """What the views show now, for the render thread; None without a case."""
        with self._lock:
            case = self._case
            if case is None:
                return None
            document = case.document
            return Scene(
                case_number=case.number,
                content_number=case.content_number,
                content_is_newest=case.content_shown == case.content_wanted,
                renderer=case.renderer,
                pose=case.navigator.pose,
                pose_id=self._pose_id,
                pose_s=self._pose_s,
                scope=None if document.scope is None else scope_preset(document.scope),
                mask=document.mask,
                fov_deg=document.fov_deg,
                shading=document.shading,
                texture=document.texture,
                method=document.method,
                window_hu=(document.window_width_hu, document.window_level_hu),
                crosshair_lps=case.crosshair_lps,
                orbit_tree=case.orbit_tree,
                orbit_tri_plane=case.orbit_tri_plane,
                zoom=case.zoom,
                has_lumen=case.has_lumen,
                carm=case.carm,
                reformation=case.reformation,
                slab=case.slab,
                frames=None if document.route is None else document.route.frames,
                path_mm=case.navigator.path_mm,
                picture_turned=case.navigator.picture_turned,
                lumen=case.outline,
            )


def _lumen(airways: Any) -> Any:
    return None if airways is None else airways.lumen_zyx


def _is_asked(error: CarinaError) -> bool:
    """Whether a job's end is a question and no trouble: :class:`NotEvident` has told of it."""
    return isinstance(error, NoEvidenceError)
