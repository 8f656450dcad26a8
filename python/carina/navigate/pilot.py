"""Pilot: the single owner of the tip's pose, which applies every move by hand, key, device or program."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, assert_never

import numpy as np
from numpy.typing import NDArray

from carina import commands as c
from carina.commands import DeviceControls, checked
from carina.commands.fields import Control
from carina.display import as_words, one_line
from carina.errors import UsageError
from carina.navigate import moves as m
from carina.navigate.flight_path import FlightPath
from carina.navigate.navigator import EASE_MM_PER_MM, EASE_RAD_PER_MM, Navigator, eased
from carina.navigate.one_euro import MAX_GAP_S, SampleFilter
from carina.navigate.registration import Registration, as_registration
from carina.navigate.rotation import (
    orthonormal,
    rotation_from_vector,
    rotation_from_wxyz,
    vector_from_rotation,
    yaw_pitch_roll,
)
from carina.navigate.samples import MAX_DEVICES, AxesSample, HandleSample, PoseSample, Sample, SampleGate
from carina.scopes import Pose, ScopeDrive, WallField, lever_flexion

CYCLE_BUTTON = 0
CLUTCH_BUTTON = 1
# Time without samples after which a stick counts as released, also after a pause of the program.
STALE_S = 0.25
MAX_FRAME_S = 0.1
# A branch other than the route's is chosen only if it is nearer to the aim by this angle.
FORK_MARGIN_RAD = math.radians(10.0)
# Hand movement in mm that counts as equal to a rotation by one radian, about the length of a pen.
HAND_MM_PER_RAD = 100.0
MM3 = NDArray[np.float64]
Tool = Literal["root", "start", "target"]


@one_line
@dataclass(frozen=True, slots=True)
class DeviceState:
    """State of an input device, for display."""

    device: str
    holds: bool
    sample: Sample | None
    """Latest sample of the device, filtered; None before the first sample."""
    latency_ms: float
    num_used: int
    num_ignored: dict[str, int]
    rms_mm: float | None
    registered: bool


@one_line
@dataclass(frozen=True, slots=True)
class PenState:
    """State of the tracked pen (stylus) that moves the tip, and the point that its button marks."""

    device: str
    is_tracked: bool
    """Whether the pen (stylus) reports its position, not only its orientation."""
    lps: tuple[float, float, float] | None
    """Position of the pen's (stylus's) tip in the patient, LPS mm; None unless its tracker is registered to the
    patient."""
    off_mm: float | None
    """Distance in mm between the scope's tip and the pen while the pen positions the tip absolutely; else None."""
    off_rad: float | None
    """Angle in radians between the scope's tip and the pen while the pen positions the tip absolutely; else None."""
    is_armed: bool
    """Whether the next press of the pen's (stylus's) first button marks a point for an edit."""


@dataclass(slots=True)
class _Device:
    filter: SampleFilter
    measured: Sample | None = None
    """Latest sample as the device measured it, unfiltered."""
    newest: Sample | None = None
    """Latest sample of the device after the smoothing filter."""
    arrived_s: float = -math.inf
    buttons: int = 0
    registration: Registration | None = None


class Pilot:
    """Object that applies every move to a :class:`Navigator` and filters the samples of devices.

    A pilot reads no clock: times are arguments. Samples of devices may arrive at any time (:class:`moves.DeviceSaid`);
    the tip follows the latest sample when a frame is due (:class:`moves.Frame`). So a device with a high sample rate
    does not slow the pictures, and a device that stalls does not stop them.

    A device can control the tip in three ways (paper 3.2), cycled by button 0 or :class:`carina.commands.CycleControl`:

    *absolute*: the tip follows the pen's position in the patient, by the registration of its tracker. *relative*: the
    tip repeats the hand's movement, times a gain, from its present pose; a clutch lets the hand return without moving
    the tip. *path*: forward moves along the path, rotations change the direction of view; at a fork the branch nearest
    to the direction of view (for a stick: to the deflection) is requested.

    A change of control does not move the picture: in *absolute* the offset between tip and pen decreases while the hand
    moves.

    Parameters
    ----------
    navigator
        Navigator to move. No other object should move it.

    Examples
    --------
    >>> pilot = Pilot(Navigator(Pose.looking([0, 0, 0], [0, 0, -1])))
    >>> pilot.apply(c.Steer(5.0, 0.0, 0.0, 0.0))
    >>> pilot.navigator.pose.position_lps.tolist()
    [0.0, 0.0, -5.0]
    """

    def __init__(self, navigator: Navigator) -> None:
        self.navigator = navigator
        self.on_move: Callable[[m.Move, float], None] | None = None
        """Function that receives every applied move and the time since the hand's last move (s), for recordings."""
        self.wall: WallField | None = None
        """Distance field of the airway wall, which confines the scope to the lumen; None without airways."""
        self.wall_made_from: dict[str, Any] | None = None
        """JSON values from which a replay computes the same wall; recorded with each inserted scope."""
        self._gate = SampleGate()
        self._devices: dict[str, _Device] = {}
        self._controls = DeviceControls()
        self._free: Control = "relative"
        self._forks: tuple[m.PathFork, ...] = ()
        self._path_move = m.SetPath(())
        self._wanted_way: int | None = None
        self._pen_tool: Tool | None = None
        self._marks: list[tuple[str, Tool]] = []
        self._frame_s: float | None = None
        self._passed_s = 0.0
        # Sample that the tip followed in the last frame. After None the tip starts from the next sample without a jump.
        self._followed: tuple[str, Sample] | None = None
        # In absolute mode, the pose of the tip is the registered pose of the pen, rotated and shifted by these offsets.
        self._off_turn = np.eye(3)
        self._off_lps: MM3 = np.zeros(3)

    def __repr__(self) -> str:
        """Return a one-line description of this `Pilot` for the Python interpreter."""
        held = "" if self.holder is None else f", held by {as_words(self.holder)}"
        return f"Pilot({self.navigator!r}{held})"

    # ------------------------------------------------------------ state for other parts

    @property
    def control(self) -> Control:
        """Way in which a device moves the tip at present."""
        mode = self.navigator.mode
        # The wall constrains a scope, so a pen cannot set its position (no *absolute*).
        return "path" if mode == "path" else "relative" if mode == "scope" else self._free

    @property
    def controls(self) -> DeviceControls:
        """Settings of the devices: gains, clutch, speeds, filter."""
        return self._controls

    @property
    def holder(self) -> str | None:
        """Name of the device that moves the tip, or None."""
        return self._gate.holder

    @property
    def scope_flexion_range_rad(self) -> tuple[float, float] | None:
        """Flexion limits of the scope in the lumen, radians: down (below 0) and up, or None."""
        return self.navigator.flexion_range_rad

    @property
    def is_moving(self) -> bool:
        """Whether frames move the tip without another sample, as while a stick is deflected."""
        newest = self._latest_device()
        if isinstance(newest, PoseSample):
            return newest.advance != 0.0
        return isinstance(newest, AxesSample) and any(abs(v) > 0.0 for v in newest.axes)

    def devices(self) -> tuple[DeviceState, ...]:
        """States of all devices that have sent samples."""
        return tuple(
            DeviceState(
                name,
                name == self._gate.holder,
                device.newest,
                device.filter.latency_ms,
                self._gate.num_used(name),
                {str(k): v for k, v in self._gate.num_ignored(name).items()},
                None if device.registration is None else device.registration.rms_mm,
                device.registration is not None,
            )
            for name, device in sorted(self._devices.items())
        )

    def pen_pose(self, device: str) -> Pose | None:
        """Return the pose of a registered pen in the patient; None without registration or position."""
        known = self._devices.get(device)
        if known is None or known.registration is None or not isinstance(known.newest, PoseSample):
            return None
        return None if known.newest.position_mm is None else self._registered_pose(known.registration, known.newest)

    def pen_lps(self, device: str) -> NDArray[np.float64] | None:
        """Return the last measured tip of a registered pen, (3,) LPS mm; None without registration or position.

        The position is the measured one, not the filtered one: the filter lags behind a moving hand, and the user
        points with the pen's real tip.
        """
        known = self._devices.get(device)
        if known is None or known.registration is None or not isinstance(known.measured, PoseSample):
            return None
        if known.measured.position_mm is None:
            return None
        return self._registered_pose(known.registration, known.measured).position_lps

    def pen(self) -> PenState | None:
        """Return the state of the pen that moves the tip; None if no device, a stick or a handle moves the tip."""
        holder = self._gate.holder
        device = None if holder is None else self._devices.get(holder)
        if holder is None or device is None or not isinstance(device.measured, PoseSample):
            return None
        lps, off_mm, off_rad = self.pen_lps(holder), None, None
        pen = self.pen_pose(holder)
        if pen is not None and self.control == "absolute":
            tip = self.navigator.pose
            off_mm = float(np.linalg.norm(tip.position_lps - pen.position_lps))
            turn = pen.lps_from_camera[:3, :3].T @ tip.lps_from_camera[:3, :3]
            off_rad = float(np.linalg.norm(vector_from_rotation(orthonormal(turn))))
        place = None if lps is None else (float(lps[0]), float(lps[1]), float(lps[2]))
        is_tracked = device.measured.position_mm is not None
        return PenState(holder, is_tracked, place, off_mm, off_rad, self._pen_tool is not None)

    def take_message(self, now_s: float) -> str | None:
        """Return one sentence about samples that were ignored, at most one in ten seconds, or None."""
        return self._gate.take_message(now_s)

    def take_wanted_way(self) -> int | None:
        """Return the branch that a device requested at a fork that the tip has reached, and clear the request.

        None for none.
        """
        wanted, self._wanted_way = self._wanted_way, None
        return wanted

    def take_marks(self) -> tuple[tuple[str, Tool], ...]:
        """Return the presses of the first button of pens with a tool since the last call, as (device, tool) pairs."""
        marks, self._marks = tuple(self._marks), []
        return marks

    # ------------------------------------------------------------ recordings

    def forget_devices(self) -> None:
        """Reset every device to its state after connecting; registrations and the pose of the tip do not change."""
        self._gate = SampleGate()
        registrations = {
            name: device.registration for name, device in self._devices.items() if device.registration is not None
        }
        self._devices = {}
        for name, registration in registrations.items():
            self._device(name).registration = registration
        self._followed = self._frame_s = self._wanted_way = None

    def setting_up(self) -> list[m.Move]:
        """Return the moves that give a new pilot this pilot's state, without the tip's pose and device samples."""
        registered = [
            m.Register(name, tuple(float(v) for v in device.registration.lps_from_tracker.ravel()))
            for name, device in self._devices.items()
            if device.registration is not None
        ]
        found: list[m.Move] = [c.SetControls(self._controls), c.ArmPen(self._pen_tool), *registered, self._path_move]
        if self._free == "absolute":
            found.append(c.SetControl("absolute"))
        return found

    # ------------------------------------------------------------ moves

    def apply(self, move: m.Move, *, dt_s: float = 0.0) -> None:
        """Apply a move of the hand, a key, a device or a program to the tip.

        Parameters
        ----------
        move
            Move to apply.
        dt_s
            Time since the last move of the hand, which counts as time of contact in mode *scope*.

        Raises
        ------
        UsageError
            If a number is not finite, or the move is impossible (no path, no registration). Then the tip has not moved.
        """
        self._apply_move(move, dt_s)
        if self.on_move is not None:
            self.on_move(move, dt_s)

    def set_registration(self, device: str, registration: Registration) -> None:
        """Apply :class:`moves.Register` and keep the residuals of the registration."""
        numbers = tuple(float(v) for v in registration.lps_from_tracker.ravel())
        self.apply(m.Register(device, numbers))
        self._device(device).registration = registration

    def _apply_move(self, move: m.Move, dt_s: float) -> None:
        tip = self.navigator
        match move:
            case m.Frame():
                self._follow_samples(move.now_s)
            case m.DeviceSaid():
                self._process_sample(move.device, move.sample, move.now_s)
            case c.Steer():
                tip.steer(move.advance_mm, move.yaw_rad, move.pitch_rad, move.roll_rad, dt_s=dt_s)
            case c.GoTo():
                tip.go_to(move.path_mm)
            case c.NextFork():
                tip.next_fork()
            case c.PreviousFork():
                tip.previous_fork()
            case c.Place():
                tip.place_at(move.lps)
            case c.PlacePose():
                tip.place(Pose(np.asarray(move.lps_from_camera, dtype=np.float64).reshape(4, 4)))
            case c.LevelHorizon():
                tip.level_horizon()
            case c.ResetLook():
                tip.reset_look()
            case c.SetMode():
                tip.set_mode(move.mode)
            case c.ToggleMode():
                tip.toggle_mode()
            case c.SetOperator():
                tip.set_operator(move.position)
            case m.SetPath():
                self._forks, self._path_move = move.ways, move
                tip.set_path(_flight_path(move))
            case c.DeviceGone():
                self._gate.reset_device(move.device)
                if move.device in self._devices:
                    registration = self._devices.pop(move.device).registration
                    if registration is not None:
                        # The registration of a tracker stays valid after the tracker was disconnected.
                        self._device(move.device).registration = registration
            case c.TakeDevice():
                self._gate.take(move.device)
            case m.Register():
                if move.device not in self._devices and len(self._devices) >= 2 * MAX_DEVICES:
                    raise UsageError(
                        f"at most {2 * MAX_DEVICES} devices can be registered at once; discard a registration first",
                        code="navigate.registration",
                    )
                device = self._device(move.device)
                device.registration = as_registration(move.lps_from_tracker) if move.lps_from_tracker else None
                if device.registration is None and self._free == "absolute":
                    self._free = "relative"
            case c.SetControl():
                self._set_control(move.control)
            case c.CycleControl():
                self._cycle_control()
            case m.LayScope():
                self._lay_scope(move)
            case c.ArmPen():
                self._pen_tool = move.tool
            case c.JoinPen():
                self._join_pen()
            case c.SetControls():
                self._controls = checked(move.controls)
                for device in self._devices.values():
                    device.filter = SampleFilter(self._controls)
            case _:
                assert_never(move)
        if not isinstance(move, m.Frame | m.DeviceSaid | c.ArmPen | c.JoinPen):
            # Another move changed the tip, so the hand's movement continues from the new pose.
            self._followed = None

    def _lay_scope(self, move: m.LayScope) -> None:
        if self.wall is None:
            raise UsageError(
                "inserting a scope needs the airway wall, which is not ready yet", code="navigate.no-scope"
            )
        drive = ScopeDrive(self.wall, move.scope, move.points_lps, up_lps=move.up_lps)
        drive.place(move.points_lps, move.insertion_mm)
        self.navigator.enter_scope(drive)

    # ------------------------------------------------------------ devices

    def _device(self, name: str) -> _Device:
        if name not in self._devices and len(self._devices) >= MAX_DEVICES:
            # Devices that the gate has removed are removed here too, unless they have a registration.
            lost = [
                d for d, state in self._devices.items() if state.registration is None and not self._gate.has_device(d)
            ]
            for other in lost:
                del self._devices[other]
        return self._devices.setdefault(name, _Device(SampleFilter(self._controls)))

    def _process_sample(self, name: str, sample: Sample, now_s: float) -> None:
        admitted = self._gate.admit(name, sample, now_s)
        if admitted is None:
            return
        device = self._device(name)
        device.measured, device.newest, device.arrived_s = admitted, device.filter.apply(admitted), now_s
        pressed = admitted.buttons & ~device.buttons
        device.buttons = admitted.buttons
        for number in range(pressed.bit_length()):
            if pressed >> number & 1:
                self._handle_press(name, number)

    def _handle_press(self, name: str, number: int) -> None:
        if number != CYCLE_BUTTON:
            return
        if self._pen_tool is not None:
            self._marks.append((name, self._pen_tool))
        else:
            self._cycle_control()
            self._followed = None

    def _latest_device(self) -> Sample | None:
        holder = self._gate.holder
        return self._devices[holder].newest if holder in self._devices else None

    def _cycle_control(self) -> None:
        order: tuple[Control, ...] = ("absolute", "relative", "path")
        at = order.index(self.control)
        for n in (1, 2):
            wanted = order[(at + n) % 3]
            if (
                (wanted == "path" and self.navigator.path is not None)
                or wanted == "relative"
                or (wanted == "absolute" and self._can_be_absolute())
            ):
                self._set_control(wanted)
                return

    def _can_be_absolute(self) -> bool:
        holder = self._gate.holder
        candidates = self._devices.values() if holder is None else [self._device(holder)]
        return any(device.registration is not None for device in candidates)

    def _set_control(self, control: Control) -> None:
        if control == "absolute" and not self._can_be_absolute():
            raise UsageError(
                "absolute mode needs a tracked pen that is registered to the patient; register the pen first",
                code="navigate.not-registered",
            )
        if control == "path":
            self.navigator.set_mode("path")
        else:
            self._free = control
            self.navigator.set_mode("free")
        self._followed = None

    def _join_pen(self) -> None:
        holder = self._gate.holder
        if holder is None or self.pen_lps(holder) is None or self.control != "absolute":
            raise UsageError(
                "the tip can follow a registered pen only in absolute mode; select absolute mode first",
                code="navigate.not-absolute",
            )
        device = self._devices[holder]
        # The tip moves to the measured pen, so the filter starts again without its lag.
        assert device.measured is not None
        device.filter = SampleFilter(self._controls)
        device.newest = newest = device.filter.apply(device.measured)
        pen = self.pen_pose(holder)
        assert pen is not None
        self.navigator.place(pen)
        # From this sample on the tip repeats the hand's movement exactly, so there is no offset to decrease.
        self._off_turn, self._off_lps = np.eye(3), np.zeros(3)
        self._followed = (holder, newest)

    # ------------------------------------------------------------ steps of one frame

    def _follow_samples(self, now_s: float) -> None:
        if not math.isfinite(now_s):
            raise UsageError(f"the time of a frame must be finite; found {now_s}")
        passed_s = 0.0 if self._frame_s is None else min(max(now_s - self._frame_s, 0.0), MAX_FRAME_S)
        self._passed_s = passed_s
        self._frame_s = now_s
        holder = self._gate.holder
        device = self._devices.get(holder) if holder is not None else None
        if holder is None or device is None or device.newest is None:
            self._followed = None
            return
        newest = device.newest
        last = self._followed[1] if self._followed is not None and self._followed[0] == holder else None
        if last is not None and not 0.0 <= newest.time_s - last.time_s <= MAX_GAP_S:
            # A restarted handle counts from another origin, and after a gap the hand is elsewhere: neither is a
            # movement.
            last = None
        self._followed = (holder, newest)
        match newest:
            case AxesSample():
                if now_s - device.arrived_s <= STALE_S:
                    self._store_sample(newest, passed_s)
            case PoseSample() if self.control == "absolute" and device.registration is not None:
                self._follow_pen(device.registration, newest, last if isinstance(last, PoseSample) else None)
            case PoseSample():
                if isinstance(last, PoseSample) and self._is_clutch_engaged(newest.buttons):
                    self._follow_hand(newest, last)
                if newest.advance != 0.0 and now_s - device.arrived_s <= STALE_S:
                    along_mm = newest.advance * self._controls.speed_mm_s * passed_s
                    self._move_by(np.array([0.0, 0.0, along_mm]), np.eye(3), np.zeros(3))
            case HandleSample():
                if isinstance(last, HandleSample) and self._is_clutch_engaged(newest.buttons):
                    self._follow_handle(newest, last)

    def _is_clutch_engaged(self, buttons: int) -> bool:
        held = bool(buttons >> CLUTCH_BUTTON & 1)
        return held if self._controls.clutch == "hold" else not held

    def _store_sample(self, sample: AxesSample, passed_s: float) -> None:
        forward, right, up, yaw, pitch, roll = sample.axes
        mm, rad = self._controls.speed_mm_s * passed_s, self._controls.turn_rad_s * passed_s
        self._move_by(
            np.array([right * mm, -up * mm, forward * mm]),
            yaw_pitch_roll(yaw * rad, pitch * rad, roll * rad),
            # The deflection of a stick gives the aim at a fork: full deflection is 45 degrees from straight ahead.
            np.array([yaw + right, -(pitch + up), 0.0]),
        )

    def _follow_hand(self, sample: PoseSample, last: PoseSample) -> None:
        before, after = rotation_from_wxyz(last.orientation_wxyz), rotation_from_wxyz(sample.orientation_wxyz)
        turn = rotation_from_vector(self._controls.gain_turn * vector_from_rotation(before.T @ after))
        offset = np.zeros(3)
        if sample.position_mm is not None and last.position_mm is not None:
            offset = before.T @ (np.array(sample.position_mm) - np.array(last.position_mm)) * self._controls.gain_mm
        self._move_by(offset, turn, np.zeros(3))

    def _follow_handle(self, sample: HandleSample, last: HandleSample) -> None:
        state = self.navigator.scope_state
        if state is not None and self.scope_flexion_range_rad is not None:
            # The handle mimics the scope's, so its lever sets the flexion directly.
            self.navigator.hold_scope(
                state.insertion_mm + sample.insertion_mm - last.insertion_mm,
                state.roll_rad + sample.roll_rad - last.roll_rad,
                lever_flexion(sample.lever, self.scope_flexion_range_rad, invert=self._controls.lever_inverted),
                dt_s=self._passed_s,
            )
            return
        lever = (sample.lever - last.lever) * (-1.0 if self._controls.lever_inverted else 1.0)
        turn = yaw_pitch_roll(0.0, lever * self._controls.lever_rad, sample.roll_rad - last.roll_rad)
        self._move_by(np.array([0.0, 0.0, sample.insertion_mm - last.insertion_mm]), turn, np.zeros(3))

    def _follow_pen(self, registration: Registration, sample: PoseSample, last: PoseSample | None) -> None:
        if sample.position_mm is None:
            return
        pen = self._registered_pose(registration, sample).lps_from_camera
        if last is None or last.position_mm is None:
            tip = self.navigator.pose.lps_from_camera
            self._off_turn = orthonormal(pen[:3, :3].T @ tip[:3, :3])
            self._off_lps = tip[:3, 3] - pen[:3, 3]
            # The pose does not change by any rounding until the hand moves.
            return
        before = rotation_from_wxyz(last.orientation_wxyz)
        turned = float(np.linalg.norm(vector_from_rotation(before.T @ rotation_from_wxyz(sample.orientation_wxyz))))
        moved_mm = math.dist(sample.position_mm, last.position_mm) + HAND_MM_PER_RAD * turned
        vector = vector_from_rotation(self._off_turn)
        share = eased(float(np.linalg.norm(vector)), moved_mm, EASE_RAD_PER_MM)
        self._off_turn = rotation_from_vector(vector * share)
        self._off_lps = self._off_lps * eased(float(np.linalg.norm(self._off_lps)), moved_mm, EASE_MM_PER_MM)
        matrix = np.eye(4)
        matrix[:3, :3] = orthonormal(pen[:3, :3] @ self._off_turn)
        matrix[:3, 3] = pen[:3, 3] + self._off_lps
        self.navigator.place(Pose(matrix))

    def _registered_pose(self, registration: Registration, sample: PoseSample) -> Pose:
        assert sample.position_mm is not None
        tracker = registration.lps_from_tracker
        matrix = np.eye(4)
        matrix[:3, :3] = orthonormal(tracker[:3, :3] @ rotation_from_wxyz(sample.orientation_wxyz))
        matrix[:3, 3] = tracker[:3, :3] @ np.array(sample.position_mm) + tracker[:3, 3]
        return Pose(matrix)

    def _move_by(self, offset_mm: MM3, turn: NDArray[np.float64], held: MM3) -> None:
        """Move the tip in the camera's axes; stop at a fork if the direction of view requests another branch.

        ``held`` is the deflection of a stick, added to the direction of view.
        """
        tip = self.navigator
        if tip.mode == "path" and offset_mm[2] > 0.0 and tip.path_mm is not None:
            here_mm, there_mm = tip.path_mm, tip.path_mm + float(offset_mm[2])
            for fork in self._forks:
                if here_mm < fork.path_mm <= there_mm:
                    way = self._chosen_branch(fork, tip.pose, held)
                    if way != fork.taken:
                        self._wanted_way = way
                        offset_mm = np.array([0.0, 0.0, fork.path_mm - here_mm])
                        break
        tip.move_by((float(offset_mm[0]), float(offset_mm[1]), float(offset_mm[2])), turn, dt_s=self._passed_s)

    @staticmethod
    def _chosen_branch(fork: m.PathFork, pose: Pose, held: MM3) -> int:
        aim = pose.forward_lps + pose.lps_from_camera[:3, :3] @ held
        length = float(np.linalg.norm(aim))
        if length < 1e-9:
            return fork.taken
        away = {
            way.way_id: math.acos(max(-1.0, min(1.0, float(np.dot(aim, way.dir_lps)) / length))) for way in fork.ways
        }
        nearest = min(away, key=lambda way_id: (away[way_id], way_id), default=fork.taken)
        return nearest if away.get(fork.taken, math.inf) - away.get(nearest, 0.0) > FORK_MARGIN_RAD else fork.taken


def _flight_path(move: m.SetPath) -> FlightPath | None:
    if not move.points_lps:
        return None
    return FlightPath(
        move.points_lps,
        up_lps=move.up_lps,
        forks_mm=move.forks_mm,
        lookouts_mm=move.lookouts_mm,
        max_deviation_mm=move.max_deviation_mm,
    )
