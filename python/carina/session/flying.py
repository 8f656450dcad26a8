"""Commands that move the tip, and the devices that do."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from carina.disk import disk_trouble, make_folder
from carina.errors import CarinaError, NoResultError, UsageError
from carina.navigate import Controls, Move, PenState, Recorder, Sample, case_key, fit_registration, moves
from carina.scopes import DEFAULT_SCOPE, ForceLaw, Pose, WallField, local_contact, scope_preset
from carina.session.case import OpenCase, as_point
from carina.session.core import SessionCore
from carina.session.document import Document, Point
from carina.session.jobs import Job
from carina.session.routes import leaf_below, route_to_branch
from carina.session.snapshot import DevicesInfo, NearWall, Said, Trouble
from carina.session.start_pose import pose_before_place
from carina.track import edits_to_json

# A hand that rests at the wall is counted so long, until it moves again.
MAX_CONTACT_S = 10.0

__all__ = ["Flying", "PenTool", "place_move", "view_words"]

PenTool = Literal["root", "target"]


def place_move(pose: Pose) -> moves.PlacePose:
    """The move to a pose."""
    return moves.PlacePose(tuple(float(v) for v in pose.lps_from_camera.ravel()))


def view_words(document: Document) -> dict[str, Any]:
    """How the airway view is shown, as a recording keeps it."""
    return {
        "scope": document.scope,
        "mask": document.mask,
        "fov_deg": float(document.fov_deg),
        "shading": document.shading,
        "texture": document.texture,
        "operator": document.operator,
        "transfer": document.transfer.to_json(),
    }


class Flying(SessionCore):
    """Moves of the tip. Every one goes through the case's :class:`carina.navigate.Pilot`."""

    _pen_tool: PenTool | None = None
    _steered_s = 0.0
    _recorder: Recorder | None = None
    _recording_path: Path | None = None
    _recorded_case: OpenCase | None = None

    def steer(self, advance_mm: float, yaw_rad: float, pitch_rad: float, roll_rad: float) -> None:
        """Move the tip; see :meth:`carina.navigate.Navigator.steer`."""
        now_s = self._clock()
        dt_s, self._steered_s = min(max(now_s - self._steered_s, 0.0), MAX_CONTACT_S), now_s
        self._fly(moves.Steer(advance_mm, yaw_rad, pitch_rad, roll_rad, dt_s))

    def go_to(self, path_mm: float) -> None:
        """To a place on the path; enters path mode."""
        self._fly(moves.GoTo(path_mm))

    def next_fork(self) -> None:
        """To the look-out in front of the next fork along the path."""
        self._fly(moves.NextFork())

    def previous_fork(self) -> None:
        """To the look-out of the fork before."""
        self._fly(moves.PreviousFork())

    def set_mode(self, mode: Literal["free", "path", "scope"]) -> None:
        """Free movement, along the path, or a scope in the lumen, whose wall is computed first (a job)."""
        case = self._needed_case()
        if mode != "scope":
            self._fly(moves.SetMode(mode))
        elif case.navigator.mode != "scope":
            self._enter_scope(case)

    def _enter_scope(self, case: OpenCase) -> None:
        airways, route = case.document.airways, case.document.route
        if airways is None or route is None:
            msg = "a scope is laid along a route: wait for the airways and choose a branch or a target"
            raise NoResultError(msg, code="navigate.no-path")
        if case.wall_of is airways:
            self._lay_scope(case)
            return
        with self._lock:
            case.lays_scope = True
            self._find_wall(case)

    def _find_wall(self, case: OpenCase) -> None:
        """Start the job that measures the wall, unless it runs; with the session locked."""
        airways = case.document.airways
        if airways is None or case.walling_of is airways:
            return

        def work(job: Job) -> None:
            try:
                wall = self._parts.wall_field(case.info.volume, airways, progress=job.progress, cancel=job.cancel)
                made_from = _made_from(wall, airways)
                with self._lock:
                    job.check()
                    case.pilot.wall, case.wall_of = wall, airways
                    case.pilot.wall_made_from = made_from
                    if self._case is case and case.document.airways is airways and case.lays_scope:
                        self._lay_scope(case)
            except BaseException:
                with self._lock:
                    # A job that a newer one replaced was stopped by nobody.
                    if case.walling_job == job.job_id:
                        case.unwalled = airways
                raise
            finally:
                with self._lock:
                    if case.walling_job == job.job_id:
                        case.walling_of, case.lays_scope = None, False

        case.walling_of = airways
        case.walling_job = self._jobs.start("scope", "finding the wall that holds the scope", work)

    def want_wall_again(self) -> None:
        """Forget that measuring the wall was stopped: whoever asks for it now may start it."""
        with self._lock:
            if self._case is not None:
                self._case.unwalled = None

    def local_contact(self, lps: Point | None = None) -> NearWall:
        """The wall near a place, as a plane, for a bridge to a force device; the first question starts measuring it.

        Parameters
        ----------
        lps
            The middle of the tip that feels; None for the tip of this session.
        """
        with self._lock:
            case = self._case
            airways = None if case is None else case.document.airways
            if case is None or airways is None:
                return NearWall("none")
            wall = case.pilot.wall
            if case.wall_of is not airways or wall is None:
                if case.unwalled is airways:
                    return NearWall("none")
                self._find_wall(case)
                return NearWall("finding")
            at = as_point(case.navigator.pose.position_lps) if lps is None else lps
            tip_mm = scope_preset(case.document.scope or DEFAULT_SCOPE).tip_mm
        return NearWall("ready", at, local_contact(wall, at, ForceLaw(tip_radius_mm=tip_mm / 2.0)))

    def _lay_scope(self, case: OpenCase, insertion_mm: float | None = None) -> None:
        """Along the route, to where the tip is, or the place of the route that is nearest to it."""
        route = case.document.route
        if route is None:
            return
        if insertion_mm is None:
            insertion_mm = case.navigator.path_mm
        if insertion_mm is None:
            insertion_mm = route.path.nearest_mm(case.navigator.pose.position_lps)
        name = case.document.scope or DEFAULT_SCOPE
        points = tuple(as_point(point) for point in route.points_lps)
        self._fly(moves.SetScope(name, points, float(insertion_mm)))
        case.laid_scope = name

    def _follow_scope(self, case: OpenCase) -> None:
        """After a change of the document: another scope is laid where the old one was; another lumen ends it."""
        state = case.navigator.scope_state
        if state is None:
            return
        if case.wall_of is not case.document.airways:
            self._fly(moves.SetMode("free"))
            self._emit(Said("the airways have changed: hold the scope again to feel the new wall"))
        elif (case.document.scope or DEFAULT_SCOPE) != case.laid_scope:
            self._lay_scope(case, state.insertion_mm)

    def toggle_mode(self) -> None:
        """The other mode; with a device in the hand the next of absolute, relative and path."""
        pilot = self._needed_case().pilot
        self._fly(moves.ToggleMode() if pilot.holder is None else moves.CycleControl())

    def place(self, lps: Point) -> None:
        """Tip to a point, keeping the look; free mode afterwards."""
        self._needed_case().check_inside(lps)
        self._fly(moves.PlaceAt(as_point(lps)))

    def place_pose(self, pose: Pose) -> None:
        """Tip to a pose; free mode afterwards."""
        self._fly(place_move(pose))

    def show_place(self, lps: Point, branch_id: int | None = None) -> None:
        """Look at a place of the airways: the tip before it and looking at it, free; the crosshair on it.

        Without airways only the crosshair moves.

        Raises
        ------
        UsageError
            ``session.outside``: the point lies outside the scan.
        """
        case = self._needed_case()
        case.check_inside(lps)
        airways = case.document.airways
        pose = None if airways is None else pose_before_place(airways, case.info.volume, lps, branch_id)
        if pose is not None:
            self._fly(place_move(pose))
            # As the operator stands.
            self._fly(moves.LevelHorizon())
        with self._lock:
            case.crosshair_lps = lps
            self._changed("state", "views")

    def level_horizon(self) -> None:
        """Roll until the operator's up is up."""
        self._fly(moves.LevelHorizon())

    def reset_look(self) -> None:
        """Look along the path again."""
        self._fly(moves.ResetLook())

    def cycle_control(self) -> None:
        """The next of absolute, relative and path that there is, as a device's first button does."""
        self._fly(moves.CycleControl())

    # ------------------------------------------------------------ recordings

    @property
    def recording_path(self) -> Path | None:
        """The file that is being recorded to."""
        return self._recording_path if self._recorder is not None else None

    def start_recording(self, path: Path) -> None:
        """Record every move of the tip to a file until :meth:`stop_recording`, or until the case is closed.

        Raises
        ------
        UsageError
            ``session.recording``: if one is being made.
        CarinaError
            ``machine``: if the file cannot be written.
        """
        import carina

        case = self._needed_case()
        if self._recorder is not None:
            raise UsageError("a recording is being made already; stop it first", code="session.recording")
        key = case_key(case.info.volume)
        try:
            make_folder(path.parent, what="the recording")
            file = path.open("x", encoding="utf-8")
        except OSError as trouble:
            raise disk_trouble(trouble, "cannot write the recording", path) from trouble
        with self._lock:
            try:
                self._recorder = Recorder(
                    case.pilot,
                    file,
                    case=key,
                    carina=carina.__version__,
                    now_s=self._clock(),
                    view=view_words(case.document),
                    on_end=self._recording_ended,
                )
            except OSError as trouble:
                with contextlib.suppress(OSError):
                    path.unlink()
                raise disk_trouble(trouble, "cannot write the recording", path) from trouble
            self._recording_path, self._recorded_case = path, case
            if case.navigator.scope_state is not None:
                # A replay begins with the scope laid anew, so that it can begin at all.
                self._lay_scope(case, case.navigator.scope_state.insertion_mm)
            self._changed("state")

    def stop_recording(self) -> Path | None:
        """End the recording; returns where it is, None where there is none."""
        with self._lock:
            recorder, self._recorder = self._recorder, None
            if recorder is None:
                return None
            recorder.tick(self._clock())
            recorder.close()
            if recorder.trouble is None:
                self._emit(Said(f"{recorder.length_s:.0f} s were recorded to {self._recording_path}"))
                self._changed("state")
            return self._recording_path

    def _recording_ended(self, trouble: OSError) -> None:
        """The file cannot be written any more, with the session locked; the flight goes on."""
        self._recorder = None
        kept = f"what was recorded before is in {self._recording_path}"
        told = disk_trouble(trouble, "the recording ended: cannot write", self._recording_path, unchanged=kept)
        self._emit(Trouble(told.code, str(told)))
        self._changed("state")

    def close(self) -> None:
        """End a recording, and stop all jobs."""
        self.stop_recording()
        super().close()

    def _tick_recording(self) -> None:
        """Before a move, with the session locked: the time of what follows."""
        if self._recorder is not None:
            self._recorder.tick(self._clock())

    def _follow_document(self, case: OpenCase) -> None:
        self._tick_recording()
        super()._follow_document(case)
        if self._recorder is not None and self._recorded_case is case:
            self._recorder.note_view(view_words(case.document), self._clock())
        self._follow_scope(case)

    # ------------------------------------------------------------ devices

    @property
    def device_woken(self) -> threading.Event:
        """Set when a device said something that the tip has not followed yet."""
        return self._device_woken

    def device_said(self, device: str, sample: Sample) -> None:
        """A sample of a device; from any thread, as often as the device likes. Ignored while no case is open."""
        with self._lock:
            case = self._case
            if case is None:
                return
            before = case.pilot.control
            now_s = self._clock()
            case.pilot.apply(moves.DeviceSaid(device, sample, now_s))
            for pen in case.pilot.take_marks():
                self._mark(case, pen)
            words = case.pilot.take_message(now_s)
            if words is not None:
                self._emit(Said(words))
            if case.pilot.control != before:
                self._changed("state", "pose", "views")
        self._device_woken.set()

    def device_gone(self, device: str) -> None:
        """A device was unplugged."""
        with self._lock:
            if self._case is not None:
                self._case.pilot.apply(moves.DeviceGone(device))

    def device_frame(self) -> bool:
        """Let the tip follow the newest sample; True while it moves without another one."""
        with self._lock:
            self._device_woken.clear()
            case = self._case
            if case is None:
                return False
            before, mode = case.navigator.pose, case.navigator.mode
            case.pilot.apply(moves.Frame(self._clock()))
            # A hand that rests goes on speaking: a pose of the same numbers is no news, and the picture gets fine.
            if case.navigator.mode != mode or not np.array_equal(
                case.navigator.pose.lps_from_camera, before.lps_from_camera
            ):
                self._after_move(case, mode)
                case.by_device = True
            way = case.pilot.take_wanted_way()
            if way is not None:
                self._take_way(case, way)
            return case.pilot.is_moving

    def take_device(self, device: str) -> None:
        """Give the scope to a device."""
        self._fly(moves.TakeDevice(device))

    def set_control(self, control: Literal["absolute", "relative", "path"]) -> None:
        """How a device moves the tip."""
        self._fly(moves.SetControl(control))

    def set_controls(self, controls: Controls) -> None:
        """Gains, clutch, speeds and filter of devices."""
        self._fly(moves.SetControls(controls))

    def calibrate(self, device: str, tracker_mm: Sequence[Point], patient_lps: Sequence[Point]) -> float:
        """Register a tracker to the patient by pairs of points; returns the residual (RMS, mm). No pairs forget it."""
        case = self._needed_case()
        if not tracker_mm and not patient_lps:
            self._fly(moves.Calibrate(device, ()))
            return 0.0
        fit = fit_registration(tracker_mm, patient_lps)
        with self._lock:
            case.pilot.set_registration(device, fit)
            self._changed("state")
        return fit.rms_mm or 0.0

    def join_pen(self) -> None:
        """In absolute movement: the tip comes to the registered pen at once, instead of easing over."""
        self._fly(moves.JoinPen())

    def arm_pen(self, tool: PenTool | None) -> None:
        """What the pen's first button sets; None lets it change the way to move.

        It is set at the pen's own tip where the pen is registered to the patient, in whatever way it moves the scope;
        at the tip of the scope where it is not.
        """
        if tool not in {"root", "target", None}:
            raise UsageError(f"a pen sets root or target; found {tool!r}")
        case = self._needed_case()
        with self._lock:
            self._pen_tool = tool
            case.pilot.apply(moves.ArmPen(tool is not None))

    def devices_info(self) -> DevicesInfo | None:
        """Devices that said something and how they move the tip; None without a case."""
        with self._lock:
            if self._case is None:
                return None
            pilot = self._case.pilot
            return DevicesInfo(pilot.control, pilot.controls, pilot.devices())

    def pen_state(self) -> PenState | None:
        """The pen that moves the tip and the point that its button marks; None where none does."""
        with self._lock:
            return None if self._case is None else self._case.pilot.pen()

    def _mark(self, case: OpenCase, pen: str) -> None:
        """The armed pen's button, with the session locked."""
        own = case.pilot.pen_lps(pen)
        place = as_point(case.navigator.pose.position_lps if own is None else own)
        try:
            if self._pen_tool == "root":
                self.set_root(place)
            else:
                self.add_target(place)
        except CarinaError as trouble:
            self._emit(Trouble(trouble.code, str(trouble)))

    def set_root(self, root_lps: Point) -> str:
        """See :class:`carina.session.Session`."""
        raise NotImplementedError

    def add_target(self, lps: Point) -> str:
        """See :class:`carina.session.Session`."""
        raise NotImplementedError

    def _take_way(self, case: OpenCase, branch_id: int) -> None:
        """The route goes on through another branch, as the hand on a device asked for at a fork."""
        airways = case.document.airways
        if airways is None or all(branch.id != branch_id for branch in airways.tree.branches):
            return
        route = route_to_branch(airways.tree, leaf_below(airways.tree, branch_id))
        case.follow_route(route)
        self._follow_document(case)
        self._changed("route", "state", "pose", "views")

    def _fly(self, move: Move) -> None:
        case = self._needed_case()
        with self._lock:
            mode = case.navigator.mode
            self._tick_recording()
            case.pilot.apply(move)
            self._after_move(case, mode)

    def _after_move(self, case: OpenCase, mode: str) -> None:
        case.person_moved = True
        following = case.zoom.following if case.crosshair_lps is None else case.zoom.at_tip
        if case.zoom != following:
            # Slices follow the tip again; the cut-plane does in any case.
            case.zoom = following
        self._moved()
        if case.navigator.mode != mode:
            self._changed("state", "pose", "views")
        else:
            self._changed("pose", "views")


def _made_from(wall: WallField, airways: Any) -> dict[str, Any]:
    """What a replay makes a wall from again: search, edits, and how to tell that it is the same."""
    found = getattr(airways, "base", None) or airways
    edits = getattr(airways, "edits", ())
    return {
        "digest": wall.digest(),
        "root_lps": [float(v) for v in found.root_lps],
        "lumen_threshold": float(getattr(found, "threshold", math.nan)) if _has_threshold(found) else None,
        "edits": edits_to_json(edits) if edits else None,
    }


def _has_threshold(airways: Any) -> bool:
    return math.isfinite(float(getattr(airways, "threshold", math.nan)))
