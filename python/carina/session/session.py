"""The one owner of a case's state: commands that can be undone, jobs, and the pose.

The window, the command line, notebooks and tests drive the same session. It knows neither a server nor Ray: the renderer comes by
argument, and whoever wants to know about changes subscribes.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from carina.errors import CarinaError, NoResultError, TrackingError, UsageError
from carina.navigate import Navigator
from carina.scopes import Pose
from carina.session.document import Document, Method, Operator, Point, Target
from carina.session.history import History
from carina.session.jobs import Job, JobEnded, JobProgress, JobRunner
from carina.session.parts import Parts, RendererFactory, default_parts
from carina.session.recent import LocalStore
from carina.session.routes import AirwayIndex, ChosenRoute, default_branch_id, route_to_branch, route_to_target
from carina.session.scene import Orbit, Renderer, Scene, Zoom
from carina.session.snapshot import (
    AirwayStatus,
    CaseSnapshot,
    Changed,
    FeatureOff,
    PoseInfo,
    Said,
    Snapshot,
    Topic,
    Trouble,
)
from carina.session.start_pose import pose_at_root, pose_before_airways
from carina.volume import Volume

__all__ = ["Event", "Session"]

Event = Changed | Trouble | Said | JobProgress | JobEnded
SNAP_MM = 5.0
"""A target outside the lumen is moved to it within this distance, and said."""
DEFAULT_ORBIT_TREE = Orbit(azimuth_deg=0.0, elevation_deg=0.0)
DEFAULT_ORBIT_TRI_PLANE = Orbit(azimuth_deg=30.0, elevation_deg=25.0)


@dataclass(slots=True)
class _Case:
    """The open case: what stays while its document changes."""

    number: int
    info: CaseSnapshot
    renderer: Renderer
    navigator: Navigator
    history: History[Document]
    threshold_from_histogram: float | None
    airways_status: AirwayStatus = "waiting"
    airways_words: str | None = None
    index: AirwayIndex | None = None
    person_moved: bool = False
    crosshair_lps: Point | None = None
    orbit_tree: Orbit = DEFAULT_ORBIT_TREE
    orbit_tri_plane: Orbit = DEFAULT_ORBIT_TRI_PLANE
    zoom: Zoom = Zoom()
    shown_transfer: Any = None
    shown_airways: Any = None
    content_number: int = 0


class Session:
    """State, commands and jobs of one workstation.

    Parameters
    ----------
    renderer_factory
        Makes the renderer of a volume.
    parts
        The functions it drives; the real ones unless told.
    store
        Recent cases and the safety notice; None keeps nothing.
    submit
        Runs a function in the background; a thread pool of its own unless told.
    clock
        Seconds, monotonic.
    today
        The date, ISO, for the list of recent cases.

    Notes
    -----
    All methods may be called from any thread. Listeners are called in the order of the events, from the thread that caused them
    and while the session is locked: they must hand the event on and return.
    """

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
        self._track_lock = threading.Lock()
        """The tracker is resumed by one thread at a time."""
        self._pool = None if submit else ThreadPoolExecutor(4, thread_name_prefix="carina-job")
        self._jobs = JobRunner(submit or self._submit_to_pool, self._emit, clock)
        self._listeners: list[Callable[[Event], None]] = []
        self._case: _Case | None = None
        self._case_numbers = itertools.count(1)
        self._target_numbers = itertools.count(1)
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
        self._jobs.cancel_kinds()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def _submit_to_pool(self, work: Callable[[], None]) -> None:
        assert self._pool is not None
        self._pool.submit(work)

    def _emit(self, event: Event) -> None:
        with self._lock:
            listeners = tuple(self._listeners)
            if isinstance(event, JobEnded) and event.error is not None:
                error = event.error
                for listener in listeners:
                    listener(Trouble(error.code, str(error)))
            for listener in listeners:
                listener(event)

    def _changed(self, *topics: Topic) -> None:
        self._emit(Changed(frozenset(topics)))

    # ------------------------------------------------------------ opening and closing

    def open_path(self, path: str, *, title: str | None = None, remember: bool = True) -> str:
        """Open a file or folder as a job; the case on screen stays until the new one has been read. Returns the job's id."""

        def read(job: Job) -> Volume:
            return self._parts.open_volume(path, job.progress, job.cancel)

        return self._open(title or "opening the case", read, path if remember else None)

    def open_demo(self, name: str) -> str:
        """Open a bundled case as a job; returns its id."""
        return self._open("opening the demo", lambda job: self._parts.open_demo(name, job.progress, job.cancel), None)

    def open_volume(self, volume: Volume) -> str:
        """Open a volume that is already in memory (notebooks); returns the job's id."""
        return self._open("opening the volume", lambda _job: volume, None)

    def open_recent(self, recent_id: str) -> str:
        """Open a case of the recent list.

        Raises
        ------
        UsageError
            If the list has no such case.
        """
        for case in self._store.recent() if self._store else ():
            if case.recent_id == recent_id:
                return self.open_path(case.path)
        raise UsageError(
            "this case is no longer in the list of recent cases; open its folder again", code="session.recent"
        )

    def close_case(self) -> None:
        """Back to the start page."""
        with self._lock:
            self._jobs.cancel_kinds()
            self._case = None
            self._changed("state", "tree", "route", "views", "start")

    def _open(self, title: str, read: Callable[[Job], Volume], path: str | None) -> str:
        def work(job: Job) -> None:
            volume = read(job)
            job.check()
            job.progress("checking the quality", None)
            case = self._new_case(volume)
            job.check()
            if path is not None and self._store is not None:
                self._store.remember(path, volume.source.title, self._today())
            with self._lock:
                # Here, and not before: a refused file leaves the case on screen as it was.
                job.check()
                self._jobs.cancel_kinds("airways", "display", "target")
                self._case = case
                self._moved()
                self._changed("state", "tree", "route", "pose", "views", "start")
            self._start_airways(None, case.threshold_from_histogram, by_person=False)

        return self._jobs.start("open", title, work)

    def _new_case(self, volume: Volume) -> _Case:
        off: tuple[FeatureOff, ...] = ()
        threshold: float | None = None
        window = (1500.0, -600.0)
        low, high = int(volume.hu_zyx.min()), int(volume.hu_zyx.max())
        if volume.is_hu:
            transfer = self._parts.transfer_preset("endoscopic")
        else:
            transfer, threshold = self._parts.transfer_from_histogram(volume)
            why = volume.not_hu_reason or "the numbers of this volume are not HU"
            off = (
                FeatureOff("transfer functions in HU", why),
                FeatureOff("the quality check by HU", why),
                FeatureOff(
                    "the automatic threshold of the lumen: it is guessed from the histogram; move it by hand", why
                ),
            )
            window = (float(max(1, high - low)), (high + low) / 2.0)
        document = Document(
            transfer=transfer, window_width_hu=window[0], window_level_hu=window[1], lumen_threshold=threshold
        )
        case = _Case(
            number=next(self._case_numbers),
            info=CaseSnapshot(volume, self._parts.quality_words(volume), off, (low, high)),
            renderer=self._renderer_factory(volume, transfer),
            navigator=Navigator(pose_before_airways(volume), volume=volume),
            history=History(document),
            threshold_from_histogram=threshold,
        )
        case.shown_transfer = transfer
        return case

    # ------------------------------------------------------------ airways

    def set_root(self, root_lps: Point) -> str:
        """Find the airways again from a point, as a job; undoable once found. Returns the job's id."""
        case = self._needed_case()
        self._inside_volume(case, root_lps)
        return self._start_airways(root_lps, case.history.current.lumen_threshold, by_person=True)

    def set_lumen_threshold(self, value: float | None) -> str:
        """Find the airways again with another threshold (None: the tracker's own choice), as a job. Returns its id."""
        case = self._needed_case()
        airways = case.history.current.airways
        root = None if airways is None else _point(airways.root_lps)
        wanted = case.threshold_from_histogram if value is None else value
        return self._start_airways(root, wanted, by_person=True, label="set the lumen threshold")

    def _start_airways(
        self, root_lps: Point | None, threshold: float | None, *, by_person: bool, label: str = "set the root"
    ) -> str:
        case = self._needed_case()
        before: tuple[AirwayStatus, str | None] = (case.airways_status, case.airways_words)

        def work(job: Job) -> None:
            try:
                airways = self._parts.find_airways(
                    case.info.volume,
                    root_lps=root_lps,
                    lumen_threshold=threshold,
                    progress=job.progress,
                    cancel=job.cancel,
                )
                job.progress("building the tree", None)
                self._take_airways(case, airways, threshold, label if by_person else None, job)
            except BaseException as trouble:
                with self._lock:
                    if by_person and case.history.current.airways is not None:
                        # What was there stays; the message says why nothing changed.
                        case.airways_status, case.airways_words = before
                    else:
                        case.airways_status = "failed"
                        case.airways_words = (
                            f"{trouble}" if isinstance(trouble, CarinaError) else "finding the airways failed"
                        ) + ". Click in the trachea on a slice and choose it as the root."
                    if self._case is case:
                        self._changed("state")
                if by_person or not isinstance(trouble, TrackingError):
                    raise
                # Nobody asked: the state says it in the panel, an error on top would say the same thing twice.
                self._sync_display(case)

        with self._lock:
            case.airways_status, case.airways_words = "finding", None
            self._changed("state")
            return self._jobs.start("airways", "finding the airways", work)

    def _take_airways(self, case: _Case, airways: Any, threshold: float | None, label: str | None, job: Job) -> None:
        """Put found airways in place; ``label`` makes it a person's change that can be undone."""
        index = AirwayIndex(airways.tree)
        branch_id = default_branch_id(airways.tree)
        default_route = None if branch_id is None else route_to_branch(airways.tree, branch_id)
        while True:
            asked = case.history.current.targets
            targets = tuple(self._tracked(airways, target) for target in asked)
            with self._lock:
                job.check()
                if case.history.current.targets is not asked:
                    continue
                chosen = case.history.current.route
                route = next(
                    (t.route for t in targets if chosen is not None and t.target_id == chosen.target_id and t.route),
                    default_route,
                )

                def put(document: Document) -> Document:
                    return replace(document, airways=airways, lumen_threshold=threshold, targets=targets, route=route)

                if label is None:
                    # Earlier documents of this case have no airways; targets asked meanwhile are kept as each has them.
                    case.history.amend(
                        lambda d: replace(d, airways=airways, route=route if d.route is None else d.route)
                    )
                    case.history.amend_current(put)
                else:
                    case.history.change(label, put(case.history.current), now_s=self._clock())
                case.index = index
                case.airways_status = "found"
                case.airways_words = "; ".join(str(note) for note in airways.report) or None
                self._follow_document(case)
                if not case.person_moved:
                    self._place_at_root(case)
                self._changed("state", "tree", "route", "pose", "views")
                return

    def _place_at_root(self, case: _Case) -> None:
        document = case.history.current
        if document.route is not None:
            case.navigator.go_to(0.0)
        elif document.airways is not None:
            case.navigator.place(pose_at_root(document.airways))
        self._moved()

    # ------------------------------------------------------------ targets and routes

    def add_target(self, lps: Point) -> str:
        """Track to a point, as a job, and take it as the route; undoable. Returns the job's id.

        The point is moved to the lumen where that is within 5 mm, which is said; else the target is kept with the reason why
        there is no path.
        """
        case = self._needed_case()
        self._inside_volume(case, lps)
        number = next(self._target_numbers)
        target = Target(target_id=f"target-{number}", name=f"Target {number}", lps=lps)

        def work(job: Job) -> None:
            while True:
                airways = case.history.current.airways
                if airways is None:
                    raise NoResultError(
                        "there are no airways yet, so no path can be found; wait until they are, or set the root by a click"
                    )
                tracked = self._tracked(airways, target)
                with self._lock:
                    job.check()
                    document = case.history.current
                    if document.airways is not airways:
                        continue
                    changed = replace(document, targets=(*document.targets, tracked))
                    if tracked.route is not None:
                        changed = replace(changed, route=tracked.route)
                    case.history.change(f"add {target.name}", changed, now_s=self._clock())
                    self._follow_document(case)
                    if tracked.snapped_mm is not None and tracked.snapped_mm > 0.05:
                        self._emit(Said(f"{target.name} was moved {tracked.snapped_mm:.1f} mm to the nearest lumen"))
                    self._changed("state", "route", "pose", "views")
                    return

        return self._jobs.start(f"target {number}", "finding the path to the target", work)

    def remove_target(self, target_id: str) -> None:
        """Take a target away; a route to it goes with it."""
        case = self._needed_case()
        with self._lock:
            document = case.history.current
            target = self._needed_target(document, target_id)
            left = tuple(t for t in document.targets if t.target_id != target_id)
            route = document.route
            if route is not None and route.target_id == target_id:
                route = None
            self._change(case, f"remove {target.name}", replace(document, targets=left, route=route))

    def choose_route(self, *, target_id: str | None = None, branch_id: int | None = None) -> None:
        """Take the way to a target or to the end of a branch, or none; undoable."""
        case = self._needed_case()
        with self._lock:
            document = case.history.current
            route: ChosenRoute | None = None
            if target_id is not None:
                target = self._needed_target(document, target_id)
                if target.route is None:
                    raise NoResultError(f"no path to {target.name}: {target.problem}")
                route = target.route
            elif branch_id is not None:
                if document.airways is None or all(b.id != branch_id for b in document.airways.tree.branches):
                    raise UsageError(f"the tree has no branch {branch_id}", code="session.branch")
                route = route_to_branch(document.airways.tree, branch_id)
            label = "take away the route" if route is None else f"route to {route.title}"
            self._change(case, label, replace(document, route=route))

    def _tracked(self, airways: Any, target: Target) -> Target:
        bare = Target(target_id=target.target_id, name=target.name, lps=target.lps)
        try:
            with self._track_lock:
                path = airways.tracker.path_to(target.lps, snap_mm=SNAP_MM)
            route = route_to_target(airways.tree, path, target.target_id, target.name)
        except TrackingError as trouble:
            return replace(bare, problem=str(trouble))
        used = _point(np.asarray(path.points_lps)[-1])
        snapped_mm = float(np.linalg.norm(np.subtract(used, target.lps)))
        return replace(bare, used_lps=used, snapped_mm=snapped_mm, length_mm=float(path.length_mm), route=route)

    @staticmethod
    def _needed_target(document: Document, target_id: str) -> Target:
        for target in document.targets:
            if target.target_id == target_id:
                return target
        raise UsageError("this target is gone", code="session.target")

    # ------------------------------------------------------------ how it is shown

    def set_window(self, width_hu: float, level_hu: float) -> None:
        """Grey window of the slice views; undoable, a drag is one step."""
        self._edit("grey window", "window", window_width_hu=width_hu, window_level_hu=level_hu)

    def set_fov(self, fov_deg: float) -> None:
        """Full angle of the airway view; undoable."""
        if not 60.0 <= fov_deg <= 170.0:
            raise UsageError(f"the field of view must lie between 60 and 170 degrees; found {fov_deg:g}")
        self._edit("field of view", "fov", fov_deg=fov_deg)

    def set_shading(self, on: bool) -> None:
        """Light at the tip on or off; undoable."""
        self._edit("shading", None, shading=on)

    def set_method(self, method: Method) -> None:
        """Leaping, or the brute-force reference; undoable."""
        self._edit("ray casting method", None, method=method)

    def set_operator(self, position: Operator) -> None:
        """Operator at the patient's head or facing; undoable."""
        self._edit("operator position", None, operator=position)

    def set_transfer(self, *, preset: str | None = None, document: dict[str, Any] | None = None) -> None:
        """Transfer function by preset name or as a ``carina-transfer`` document; undoable."""
        case = self._needed_case()
        if preset is not None:
            if preset == "histogram" and not case.info.volume.is_hu:
                transfer = self._parts.transfer_from_histogram(case.info.volume)[0]
            elif preset not in self._presets(case):
                known = ", ".join(self._presets(case))
                raise UsageError(f"no transfer function is called {preset!r} for this volume; there are: {known}")
            else:
                transfer = self._parts.transfer_preset(preset)
        elif document is not None:
            transfer = self._parts.transfer_from_json(document)
        else:
            raise UsageError("name a transfer function or give one")
        self._edit("transfer function", "transfer", transfer=transfer)

    def set_crosshair(self, lps: Point | None) -> None:
        """The point that slices and tri-plane show; None follows the tip. Not undoable: it is a way of looking."""
        case = self._needed_case()
        if lps is not None:
            self._inside_volume(case, lps)
        self._look(case, crosshair_lps=lps)

    def set_orbit(self, view: Literal["tree", "tri-plane"], orbit: Orbit) -> None:
        """Camera of an outside view."""
        self._look(self._needed_case(), **{"orbit_tree" if view == "tree" else "orbit_tri_plane": orbit})

    def set_zoom(self, view: str, *, mm_per_px: float | None = None, extent_mm: float | None = None) -> None:
        """Scale of a planar view; None fits."""
        case = self._needed_case()
        if view == "cut-plane":
            self._look(case, zoom=replace(case.zoom, cut_plane_extent_mm=extent_mm))
        elif view in {"axial", "coronal", "sagittal"}:
            # mypy cannot follow the name; it is one of three fields.
            self._look(case, zoom=replace(case.zoom, **{f"{view}_mm_per_px": mm_per_px}))  # type: ignore[arg-type]
        else:
            raise UsageError(f"the view {view!r} has no zoom")

    def _presets(self, case: _Case) -> tuple[str, ...]:
        return self._parts.presets if case.info.volume.is_hu else ("histogram",)

    def _look(self, case: _Case, **values: Any) -> None:
        with self._lock:
            for name, value in values.items():
                setattr(case, name, value)
            self._changed("state", "views")

    def _edit(self, label: str, gesture: Hashable, **values: Any) -> None:
        case = self._needed_case()
        with self._lock:
            document = replace(case.history.current, **values)
            if all(getattr(case.history.current, name) == value for name, value in values.items()):
                return
            self._change(case, label, document, gesture=gesture)

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
            self._changed("state", "tree", "route", "pose", "views")

    def _change(self, case: _Case, label: str, document: Document, *, gesture: Hashable = None) -> None:
        case.history.change(label, document, now_s=self._clock(), gesture=gesture)
        self._follow_document(case)
        self._changed("state", "tree", "route", "pose", "views")

    def _follow_document(self, case: _Case) -> None:
        """Bring navigator, index and renderer to where the document is."""
        document = case.history.current
        path = None if document.route is None else document.route.path
        if case.navigator.path is not path:
            case.navigator.set_path(path)
            self._moved()
        if case.navigator.operator != document.operator:
            case.navigator.set_operator(document.operator)
            self._moved()
        airways = document.airways
        if airways is not case.shown_airways:
            case.index = None if airways is None else AirwayIndex(airways.tree)
            if airways is not None:
                case.airways_status = "found"
        if document.transfer != case.shown_transfer or airways is not case.shown_airways:
            self._sync_display(case)

    def _sync_display(self, case: _Case) -> None:
        """Give the renderer the document's transfer function and lumen, then make it fast; a newer sync stops an older."""

        def work(job: Job) -> None:
            with self._lock:
                document = case.history.current
                new_transfer = document.transfer != case.shown_transfer
                new_lumen = document.airways is not case.shown_airways
                case.shown_transfer, case.shown_airways = document.transfer, document.airways
            if new_transfer:
                case.renderer.set_transfer(document.transfer)
            if new_lumen:
                case.renderer.set_lumen(None if document.airways is None else document.airways.lumen_zyx)
            with self._lock:
                case.content_number += 1
                self._changed("views")
            case.renderer.prepare(job.progress, job.cancel)
            self._changed("views")

        self._jobs.start("display", "preparing fast pictures", work)

    # ------------------------------------------------------------ flight

    def steer(self, advance_mm: float, yaw_rad: float, pitch_rad: float, roll_rad: float) -> None:
        """Move the tip; see :meth:`carina.navigate.Navigator.steer`."""
        self._fly(lambda tip: tip.steer(advance_mm, yaw_rad, pitch_rad, roll_rad))

    def go_to(self, path_mm: float) -> None:
        """To a place on the path."""
        self._fly(lambda tip: tip.go_to(path_mm))

    def next_fork(self) -> None:
        """To the next fork along the path."""
        self._fly(lambda tip: tip.next_fork())

    def previous_fork(self) -> None:
        """To the fork before."""
        self._fly(lambda tip: tip.previous_fork())

    def set_mode(self, mode: Literal["free", "path"]) -> None:
        """Free movement, or along the path."""
        self._fly(lambda tip: tip.set_mode(mode), also_state=True)

    def toggle_mode(self) -> None:
        """The other mode."""
        self._fly(lambda tip: tip.toggle_mode(), also_state=True)

    def place(self, lps: Point) -> None:
        """Tip to a point, keeping the look; free mode afterwards."""
        self._fly(lambda tip: tip.place_at(lps), also_state=True)

    def place_pose(self, pose: Pose) -> None:
        """Tip to a pose; free mode afterwards."""
        self._fly(lambda tip: tip.place(pose), also_state=True)

    def level_horizon(self) -> None:
        """Roll until the operator's up is up."""
        self._fly(lambda tip: tip.level_horizon())

    def reset_look(self) -> None:
        """Look along the path again."""
        self._fly(lambda tip: tip.reset_look())

    def _fly(self, move: Callable[[Navigator], object], *, also_state: bool = False) -> None:
        case = self._needed_case()
        with self._lock:
            mode = case.navigator.mode
            move(case.navigator)
            case.person_moved = True
            self._moved()
            if also_state or case.navigator.mode != mode:
                self._changed("state", "pose", "views")
            else:
                self._changed("pose", "views")

    def _moved(self) -> None:
        self._pose_id += 1
        self._pose_s = self._clock()

    # ------------------------------------------------------------ what others read

    def snapshot(self) -> Snapshot:
        """All but the pose."""
        with self._lock:
            case = self._case
            if case is None:
                return Snapshot(
                    None, "empty", "none", None, None, "free", None, DEFAULT_ORBIT_TREE, DEFAULT_ORBIT_TRI_PLANE, Zoom(),
                    None, None, (),
                )  # fmt: skip
            return Snapshot(
                case=case.info,
                stage="opening" if case.airways_status in {"waiting", "finding"} else "ready",
                airways=case.airways_status,
                airways_words=case.airways_words,
                document=case.history.current,
                mode=case.navigator.mode,
                crosshair_lps=case.crosshair_lps,
                orbit_tree=case.orbit_tree,
                orbit_tri_plane=case.orbit_tri_plane,
                zoom=case.zoom,
                undo_label=case.history.undo_label,
                redo_label=case.history.redo_label,
                transfer_presets=self._presets(case),
            )

    def pose_info(self) -> PoseInfo | None:
        """The newest pose and where it is."""
        with self._lock:
            case = self._case
            if case is None:
                return None
            tip = case.navigator
            pose, index, route = tip.pose, case.index, case.history.current.route
            path_mm, mode, pose_id = tip.path_mm, tip.mode, self._pose_id
            airways = case.history.current.airways
            volume = case.info.volume
        inside = volume.contains_lps(pose.position_lps)
        if airways is not None:
            inside = inside and _in_lumen(volume, airways.lumen_zyx, pose.position_lps)
        branch_id: int | None = None
        lumen_mm: float | None = None
        if index is not None:
            if path_mm is not None and route is not None:
                n = int(np.argmin(np.abs(route.cumulative_mm - path_mm)))
                branch_id, lumen_mm = int(route.branch_ids[n]), 2.0 * float(route.radius_mm[n])
            elif inside:
                branch_id, radius_mm, _ = index.nearest(pose.position_lps)
                lumen_mm = 2.0 * radius_mm
        return PoseInfo(
            pose_id=pose_id,
            pose=pose,
            mode=mode,
            path_mm=path_mm,
            branch_id=branch_id,
            branch_name=None if index is None or branch_id is None else index.name(branch_id),
            generation=None if index is None or branch_id is None else index.generation(branch_id),
            lumen_mm=lumen_mm,
            inside=inside,
        )

    def scene(self) -> Scene | None:
        """What the views show now, for the render thread; None without a case."""
        with self._lock:
            case = self._case
            if case is None:
                return None
            document = case.history.current
            return Scene(
                case_number=case.number,
                content_number=case.content_number,
                renderer=case.renderer,
                pose=case.navigator.pose,
                pose_id=self._pose_id,
                pose_s=self._pose_s,
                fov_deg=document.fov_deg,
                shading=document.shading,
                method=document.method,
                window_hu=(document.window_width_hu, document.window_level_hu),
                crosshair_lps=case.crosshair_lps,
                orbit_tree=case.orbit_tree,
                orbit_tri_plane=case.orbit_tri_plane,
                zoom=case.zoom,
                has_lumen=case.shown_airways is not None,
            )

    def _needed_case(self) -> _Case:
        case = self._case
        if case is None:
            raise UsageError("no case is open", code="session.no-case")
        return case

    @staticmethod
    def _inside_volume(case: _Case, lps: Point) -> None:
        if not case.info.volume.contains_lps(np.asarray(lps, dtype=np.float64)):
            raise UsageError("this point lies outside the volume", code="session.outside")


def _point(values: Any) -> Point:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _in_lumen(volume: Volume, lumen_zyx: Any, point_lps: Any) -> bool:
    i, j, k = np.rint(volume.to_ijk(point_lps)).astype(int)
    nz, ny, nx = volume.shape_zyx
    return 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and bool(lumen_zyx[k, j, i])
