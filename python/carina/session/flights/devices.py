"""Input devices: reception of their samples, the motion of the tip after them, and their calibration."""

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
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import SessionCore
from carina.session.flights.recording import FlightRecorder
from carina.session.open_case.open_case import OpenCase, as_point
from carina.session.state.snapshot import DevicesInfo, ErrorEvent, StartMarked, UserMessage


class DeviceHandlers(CommandHandlers):
    """Interface for programs that connect input devices: samples, motion frames, and the state to show.

    Parameters
    ----------
    core
        Core of the session.
    recording
        The recorder of flights.
    do
        Runs a command, because the button of a pen sets roots and targets.
    """

    def __init__(
        self,
        core: SessionCore,
        recording: FlightRecorder,
        do: Callable[[c.Command], str | None],
    ) -> None:
        super().__init__(core)
        self._recording = recording
        self._do = do

    @property
    def woken(self) -> threading.Event:
        """Event that is set while a device sample waits to move the tip."""
        return self.core.device_woken

    @property
    def recording_path(self) -> Path | None:
        """Path of the running recording's file.

        None if no recording runs, or if the recording is stored in the case.
        """
        return self._recording.path

    @property
    def recording_name(self) -> str | None:
        """Path of the running recording's file, or its name in the case; None without a running recording."""
        return self._recording.name

    def receive_sample(self, device: str, sample: Sample) -> None:
        """Accept a sample of a device, from any thread and at any rate; samples are ignored while no case is open."""
        with self.core.lock:
            case = self.core.case
            if case is None or self.core.tip_held:
                return
            before = case.pilot.control
            now_s = self.core.clock()
            case.pilot.apply(moves.DeviceSaid(device, sample, now_s))
            for pen, tool in case.pilot.take_marks():
                self._mark_point(case, pen, tool)
            words = case.pilot.take_message(now_s)
            if words is not None:
                self.core.emit(UserMessage(words))
            if case.pilot.control != before:
                self.core.changed("state", "pose", "views")
        self.core.device_woken.set()

    @does(c.DeviceGone)
    def remove_device(self, command: c.DeviceGone) -> None:
        """Remove a disconnected device from the open case; do nothing while no case is open."""
        with self.core.lock:
            if self.core.case is not None:
                moved_tip = self.core.case.pilot.holder == command.device
                self.core.case.pilot.apply(command)
                if moved_tip:
                    self.core.device_lost(command.device)

    def frame(self) -> bool:
        """Move the tip towards the newest sample; return True while the motion continues without a further sample."""
        with self.core.lock:
            self.core.device_woken.clear()
            case = self.core.case
            if case is None or self.core.tip_held:
                return False
            before, mode = case.navigator.pose, case.navigator.mode
            case.pilot.apply(moves.Frame(self.core.clock()))
            # A resting hand still sends samples; an unchanged pose is not reported, so that the image can be refined.
            if case.navigator.mode != mode or not np.array_equal(
                case.navigator.pose.lps_from_camera, before.lps_from_camera
            ):
                self.core.after_move(case, mode)
                case.last_move = replace(case.last_move, by="device")
            way = case.pilot.take_wanted_way()
            if way is not None:
                self._take_branch(case, way)
            return case.pilot.is_moving

    @does(c.Calibrate)
    def calibrate(self, command: c.Calibrate) -> None:
        """Register a device to the patient by pairs of points, and report the residual.

        Without pairs, delete the registration of the device.
        """
        device, tracker_mm, patient_lps = command.device, command.tracker_mm, command.patient_lps
        case = self.core.needed_case()
        if not tracker_mm and not patient_lps:
            self.core.fly(moves.Register(device, ()))
            return
        fit = fit_registration(tracker_mm, patient_lps)
        with self.core.lock:
            case.pilot.set_registration(device, fit)
            self.core.changed("state")
            self.core.emit(UserMessage(f"{device} is registered with an RMS error of {fit.rms_mm or 0.0:.1f} mm"))

    @does(c.ArmPen)
    def arm_pen(self, command: c.ArmPen) -> None:
        """Set the kind of point (root, start or target) that the pen's (stylus's) first button sets.

        None: the button changes the mode.

        The point is set at the pen's own tip if the pen is registered to the patient, regardless of how the pen moves
        the scope; otherwise it is set at the tip of the scope.
        """
        case = self.core.needed_case()
        with self.core.lock:
            case.armed_pen = command
            case.pilot.apply(command)

    def info(self) -> DevicesInfo | None:
        """Return the connected devices and the control mode in which they move the tip; None if no case is open."""
        with self.core.lock:
            if self.core.case is None:
                return None
            pilot = self.core.case.pilot
            return DevicesInfo(pilot.control, pilot.controls, pilot.devices())

    def pen(self) -> PenState | None:
        """Return the state of the pen that moves the tip; None if no case is open or no pen moves the tip."""
        with self.core.lock:
            return None if self.core.case is None else self.core.case.pilot.pen()

    def _mark_point(self, case: OpenCase, pen: str, tool: str) -> None:
        """Set the root, the path start or a target at the pen's position; the caller holds the session's lock."""
        own = case.pilot.pen_lps(pen)
        place = as_point(case.navigator.pose.position_lps if own is None else own)
        try:
            if tool == "root":
                self._do(c.SetRoot(place))
            elif tool == "start":
                self.core.emit(StartMarked(place))
            else:
                self._do(c.AddTarget(place, cost=case.armed_pen.cost, root_lps=case.armed_pen.root_lps))
        except CarinaError as error:
            self.core.emit(ErrorEvent(error.code, str(error)))

    def _take_branch(self, case: OpenCase, branch_id: int) -> None:
        """Replace the route by one through another branch, which the user chose at a fork with a device."""
        airways = case.document.airways
        if airways is None or all(branch.id != branch_id for branch in airways.tree.branches):
            return
        route = route_to_branch(airways.tree, leaf_below(airways.tree, branch_id))
        case.follow_route(route)
        self.core.follow(case)
        self.core.changed("route", "state", "pose", "views")
