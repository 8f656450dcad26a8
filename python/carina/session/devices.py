"""Input devices: what they say, the frames in which the tip follows them, and how they move it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from carina import commands as c
from carina.case.routes import leaf_below, route_to_branch
from carina.errors import CarinaError
from carina.navigate import PenState, Sample, fit_registration, moves
from carina.session.case import OpenCase, as_point
from carina.session.core import SessionCore
from carina.session.recording import FlightRecording
from carina.session.snapshot import DevicesInfo, Said, StartMarked, Trouble
from carina.session.subject import Subject, does

__all__ = ["Devices"]


class Devices(Subject):
    """What whoever connects devices needs: samples in, frames, and what is shown.

    Parameters
    ----------
    do
        Does a command: a pen's button sets roots and targets.
    """

    def __init__(
        self,
        core: SessionCore,
        recording: FlightRecording,
        do: Callable[[c.Command], str | None],
    ) -> None:
        super().__init__(core)
        self._recording = recording
        self._do = do

    @property
    def woken(self) -> threading.Event:
        """Set when a device said something that the tip has not followed yet."""
        return self.core.device_woken

    @property
    def recording_path(self) -> Path | None:
        """The file that is being recorded to; None while there is none, or where it is the case's."""
        return self._recording.path

    @property
    def recording_name(self) -> str | None:
        """What the recording that runs is called: its file, or its name in the case; None while there is none."""
        return self._recording.name

    def said(self, device: str, sample: Sample) -> None:
        """A sample of a device; from any thread, as often as the device likes. Ignored while no case is open."""
        with self.core.lock:
            case = self.core.case
            if case is None:
                return
            before = case.pilot.control
            now_s = self.core.clock()
            case.pilot.apply(moves.DeviceSaid(device, sample, now_s))
            for pen, tool in case.pilot.take_marks():
                self._mark(case, pen, tool)
            words = case.pilot.take_message(now_s)
            if words is not None:
                self.core.emit(Said(words))
            if case.pilot.control != before:
                self.core.changed("state", "pose", "views")
        self.core.device_woken.set()

    @does(c.DeviceGone)
    def gone(self, command: c.DeviceGone) -> None:
        """Nothing where no case is open."""
        with self.core.lock:
            if self.core.case is not None:
                self.core.case.pilot.apply(command)

    def frame(self) -> bool:
        """Let the tip follow the newest sample; True while it moves without another one."""
        with self.core.lock:
            self.core.device_woken.clear()
            case = self.core.case
            if case is None:
                return False
            before, mode = case.navigator.pose, case.navigator.mode
            case.pilot.apply(moves.Frame(self.core.clock()))
            # A hand that rests goes on speaking: a pose of the same numbers is no news, and the picture gets fine.
            if case.navigator.mode != mode or not np.array_equal(
                case.navigator.pose.lps_from_camera, before.lps_from_camera
            ):
                self.core.after_move(case, mode)
                case.last_move = replace(case.last_move, by="device")
            way = case.pilot.take_wanted_way()
            if way is not None:
                self._take_way(case, way)
            return case.pilot.is_moving

    @does(c.Calibrate)
    def calibrate(self, command: c.Calibrate) -> None:
        """By pairs of points, whose residual is said; no pairs forget it."""
        device, tracker_mm, patient_lps = command.device, command.tracker_mm, command.patient_lps
        case = self.core.needed_case()
        if not tracker_mm and not patient_lps:
            self.core.fly(moves.Register(device, ()))
            return
        fit = fit_registration(tracker_mm, patient_lps)
        with self.core.lock:
            case.pilot.set_registration(device, fit)
            self.core.changed("state")
            self.core.emit(Said(f"{device} is registered with an RMS error of {fit.rms_mm or 0.0:.1f} mm"))

    @does(c.ArmPen)
    def arm_pen(self, command: c.ArmPen) -> None:
        """What the pen's first button sets; None lets it change the way to move.

        It is set at the pen's own tip where the pen is registered to the patient, in whatever way it moves the scope;
        at the tip of the scope where it is not.
        """
        case = self.core.needed_case()
        with self.core.lock:
            case.armed_pen = command
            case.pilot.apply(command)

    def info(self) -> DevicesInfo | None:
        """Devices that said something and how they move the tip; None without a case."""
        with self.core.lock:
            if self.core.case is None:
                return None
            pilot = self.core.case.pilot
            return DevicesInfo(pilot.control, pilot.controls, pilot.devices())

    def pen(self) -> PenState | None:
        """The pen that moves the tip and the point that its button marks; None where none does."""
        with self.core.lock:
            return None if self.core.case is None else self.core.case.pilot.pen()

    def _mark(self, case: OpenCase, pen: str, tool: str) -> None:
        """The armed pen's button, with the session locked."""
        own = case.pilot.pen_lps(pen)
        place = as_point(case.navigator.pose.position_lps if own is None else own)
        try:
            if tool == "root":
                self._do(c.SetRoot(place))
            elif tool == "start":
                self.core.emit(StartMarked(place))
            else:
                self._do(c.AddTarget(place, cost=case.armed_pen.cost, root_lps=case.armed_pen.root_lps))
        except CarinaError as trouble:
            self.core.emit(Trouble(trouble.code, str(trouble)))

    def _take_way(self, case: OpenCase, branch_id: int) -> None:
        """The route goes on through another branch, as the hand on a device asked for at a fork."""
        airways = case.document.airways
        if airways is None or all(branch.id != branch_id for branch in airways.tree.branches):
            return
        route = route_to_branch(airways.tree, leaf_below(airways.tree, branch_id))
        case.follow_route(route)
        self.core.follow(case)
        self.core.changed("route", "state", "pose", "views")
