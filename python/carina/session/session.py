"""The one owner of a case's state: commands that can be undone, jobs, and the pose.

The window, the command line, notebooks and tests drive the same session. It knows neither a server nor Ray: the
renderer comes by argument, and whoever wants to know about changes subscribes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from carina.errors import NoResultError, UsageError
from carina.render import VIEWS, OrbitViewName, Slab, view_row
from carina.scopes import MASKS, Mask, scope_preset
from carina.session.case import HISTOGRAM_PRESET, OpenCase, new_case
from carina.session.core import ALL_TOPICS
from carina.session.document import Document, Method, Operator, Point, Target
from carina.session.editing import TreeEditing
from carina.session.finding import AirwayFinding
from carina.session.jobs import Job
from carina.session.key_framing import KeyFraming
from carina.session.measuring import TreeMeasuring
from carina.session.questions import AirwayQuestions
from carina.session.routes import ChosenRoute, route_to_branch
from carina.session.scene import Carm, FlatPlace, Orbit, Reformation
from carina.session.snapshot import Said, WallPoint
from carina.session.targets import tracked_target
from carina.volume import Volume

__all__ = ["Session"]

PINHOLE_FOV_DEG = 90.0


class Session(AirwayFinding, KeyFraming, AirwayQuestions, TreeMeasuring, TreeEditing):
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
    All methods may be called from any thread. Listeners are called in the order of the events, from the thread that
    caused them and while the session is locked: they must hand the event on and return. Commands raise CarinaError;
    long ones are jobs, return their id, and report trouble as events.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._target_numbers = itertools.count(1)

    # ------------------------------------------------------------ opening and closing

    def open_path(self, path: str, *, remember: bool = True) -> str:
        """Open a file or folder as a job; the case on screen stays until the new one has been read. Returns its id."""

        def read(job: Job) -> Volume:
            return self._parts.open_volume(path, job.progress, job.cancel)

        return self._open("opening the case", read, path if remember else None)

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
        raise UsageError("this case is no longer in the list; open its folder again", code="session.recent")

    def close_case(self) -> None:
        """Back to the start page."""
        with self._lock:
            self.stop_recording()
            self._jobs.cancel_kinds()
            self._case = None
            self._changed(*ALL_TOPICS, "start")

    def _open(self, title: str, read: Callable[[Job], Volume], path: str | None) -> str:
        def work(job: Job) -> None:
            job.check()
            volume = read(job)
            job.progress("checking the quality", None)
            case = new_case(
                volume, next(self._case_numbers), parts=self._parts, renderer_factory=self._renderer_factory
            )
            if path is not None and self._store is not None:
                self._store.remember(path, volume.source.title, self._today())
            with self._lock:
                # Here, and not before: a refused or stopped opening leaves the case on screen as it was.
                job.check()
                self.stop_recording()
                self._jobs.cancel_kinds("airways", "display", "mask", "target", "measures")
                self._case = case
                self._moved()
                self._changed(*ALL_TOPICS, "start")
            # A tenth of a second, and pictures come several times faster; the airways take many.
            self._sync_display(case)
            self._start_airways(case, None, case.threshold_from_histogram, label=None)

        return self._jobs.start("open", title, work)

    # ------------------------------------------------------------ targets and routes

    def add_target(self, lps: Point) -> str:
        """Track to a point, as a job, and take it as the route; undoable. Returns the job's id.

        The point is moved to the lumen where that is within 5 mm, which is said; else the target is kept with the
        reason why there is no path.
        """
        case = self._needed_case()
        case.check_inside(lps)
        number = next(self._target_numbers)
        target = Target(target_id=f"target-{number}", name=f"Target {number}", lps=lps)

        def work(job: Job) -> None:
            tracked, tracked_in = target, None
            while True:
                with self._lock:
                    job.check()
                    document = case.document
                    if document.airways is None:
                        msg = f"there is no path to {target.name} without airways; wait for them, or set the root"
                        raise NoResultError(msg)
                    if tracked_in is document.airways:
                        route = tracked.route or document.route
                        changed = replace(document, targets=(*document.targets, tracked), route=route)
                        self._change(case, f"add {target.name}", changed)
                        if tracked.snapped_mm is not None and tracked.snapped_mm > 0.05:
                            words = f"{target.name} was moved {tracked.snapped_mm:.1f} mm to the nearest lumen"
                            self._emit(Said(words))
                        return
                    tracked_in = document.airways
                tracked = tracked_target(tracked_in, target)

        return self._jobs.start(f"target {number}", f"finding the path to {target.name}", work)

    def remove_target(self, target_id: str) -> None:
        """Take a target away; a route to it goes with it."""
        case = self._needed_case()
        with self._lock:
            document = case.document
            target = _needed_target(document, target_id)
            left = tuple(t for t in document.targets if t.target_id != target_id)
            route = document.route
            if route is not None and route.target_id == target_id:
                route = None
            self._change(case, f"remove {target.name}", replace(document, targets=left, route=route))

    def choose_route(self, *, target_id: str | None = None, branch_id: int | None = None) -> None:
        """Take the way to a target or to the end of a branch, or none; undoable."""
        case = self._needed_case()
        with self._lock:
            document = case.document
            route: ChosenRoute | None = None
            if target_id is not None:
                target = _needed_target(document, target_id)
                if target.route is None:
                    raise NoResultError(f"no path to {target.name}: {target.problem}")
                route = target.route
            elif branch_id is not None:
                if document.airways is None or all(b.id != branch_id for b in document.airways.tree.branches):
                    raise UsageError(f"the tree has no branch {branch_id}", code="session.branch")
                route = route_to_branch(document.airways.tree, branch_id)
            label = "take away the route" if route is None else f"route to {route.title}"
            self._change(case, label, replace(document, route=route))

    # ------------------------------------------------------------ how it is shown

    def set_window(self, width_hu: float, level_hu: float) -> None:
        """Grey window of the slice views; undoable, a drag is one step."""
        self._edit("grey window", "window", window_width_hu=width_hu, window_level_hu=level_hu)

    def set_fov(self, fov_deg: float) -> None:
        """Full angle of the airway view; undoable."""
        if not 60.0 <= fov_deg <= 170.0:
            raise UsageError(f"the field of view must lie between 60 and 170 degrees; found {fov_deg:g}")
        self._edit("field of view", "fov", fov_deg=fov_deg)

    def set_scope(self, name: str | None) -> None:
        """Look through an instrument of the library, with its field of view and outline, or None for a pinhole.

        A full frame stays full, since a person chose it. Undoable.
        """
        mask = self._needed_case().document.mask
        if name is None:
            self._edit("no scope", None, scope=None, fov_deg=PINHOLE_FOV_DEG)
            return
        scope = scope_preset(name)
        changed: dict[str, Any] = {"fov_deg": scope.usual_fov_deg, "mask": "none" if mask == "none" else scope.mask}
        self._edit(f"scope: {scope.title}", None, scope=name, **changed)

    def set_mask(self, mask: Mask) -> None:
        """Outline of the airway picture: round, octagonal or the full frame; undoable."""
        if mask not in MASKS:
            raise UsageError(f"a mask is {', '.join(MASKS)}; found {mask!r}")
        self._edit("outline of the picture", None, mask=mask)

    def set_shading(self, on: bool) -> None:
        """Light at the tip on or off; undoable."""
        self._edit("shading", None, shading=on)

    def set_texture(self, on: bool) -> None:
        """Fine texture of the mucosa, which is decoration, on or off; undoable."""
        self._edit("fine texture", None, texture=on)

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
            if preset not in case.presets:
                known = ", ".join(case.presets)
                raise UsageError(f"no transfer function is called {preset!r} for this volume; there are: {known}")
            if preset == HISTOGRAM_PRESET:
                transfer = self._parts.transfer_from_histogram(case.info.volume)[0]
            else:
                transfer = self._parts.transfer_preset(preset)
        elif document is not None:
            transfer = self._parts.transfer_from_json(document)
            if (transfer.unit == "HU") != case.info.volume.is_hu:
                unit = "HU" if case.info.volume.is_hu else "raw: its numbers are not HU"
                raise UsageError(f"this transfer function is in {transfer.unit}; the volume needs {unit}")
        else:
            raise UsageError("name a transfer function or give one")
        self._edit("transfer function", "transfer", transfer=transfer)

    def set_crosshair(self, lps: Point | None) -> None:
        """The point that slices and tri-plane show; None follows the tip. Not undoable: it is a way of looking."""
        case = self._needed_case()
        if lps is not None:
            case.check_inside(lps)
            self._look(case, crosshair_lps=lps)
        else:
            self._look(case, crosshair_lps=None, zoom=case.zoom.following)

    def set_orbit(self, view: OrbitViewName, orbit: Orbit) -> None:
        """Camera of an outside view."""
        self._look(self._needed_case(), **{f"orbit_{VIEWS[view].field}": orbit})

    def set_zoom(
        self,
        view: str,
        *,
        mm_per_px: float | None = None,
        extent_mm: float | None = None,
        center_lps: Point | None = None,
    ) -> None:
        """Scale of a planar view; None fits. The picture stays round its centre until the tip moves."""
        case = self._needed_case()
        row = view_row(view)
        if row.scale_field is None:
            raise UsageError(f"the view {view!r} has no zoom")
        place = FlatPlace(extent_mm if row.zoom == "extent" else mm_per_px, center_lps)
        self._look(case, zoom=case.zoom.placed(view, place))

    def set_carm(self, carm: Carm) -> None:
        """Where the radiograph's C-arm stands."""
        self._look(self._needed_case(), carm=carm)

    def set_reformation(self, reformation: Reformation) -> None:
        """Turn and scale of the views along the route."""
        self._look(self._needed_case(), reformation=reformation)

    def set_slab(self, slab: Slab | None) -> None:
        """Thick slices; None for thin ones."""
        self._look(self._needed_case(), slab=slab)

    def _look(self, case: OpenCase, **values: Any) -> None:
        with self._lock:
            for name, value in values.items():
                setattr(case, name, value)
            self._changed("state", "views")

    def value_at(self, lps: Point) -> int | None:
        """The number of the voxel that a point lies in (HU where the volume is in HU); None outside the volume."""
        volume = self._needed_case().info.volume
        point = np.asarray(lps, dtype=np.float64)
        if not volume.contains_lps(point):
            return None
        nz, ny, nx = volume.shape_zyx
        # Clipped: a point on the volume's outermost face rounds to the voxel beyond it.
        i, j, k = np.clip(np.rint(volume.to_ijk(point)).astype(int), 0, (nx - 1, ny - 1, nz - 1))
        return int(volume.hu_zyx[k, j, i])

    def wall_point(self, lps: Point) -> WallPoint:
        """What the scan and the tree say about a point of the wall (LPS mm)."""
        value = self.value_at(lps)
        with self._lock:
            index = self._needed_case().index
        if index is None:
            return WallPoint(lps, value, None, None, None)
        branch_id, _, _ = index.nearest(np.asarray(lps, dtype=np.float64))
        return WallPoint(lps, value, branch_id, index.name(branch_id), index.generation(branch_id))


def _needed_target(document: Document, target_id: str) -> Target:
    for target in document.targets:
        if target.target_id == target_id:
            return target
    raise UsageError("this target is gone", code="session.target")
