"""Navigator: the pose of the scope's tip in free movement, along a path, or as a scope in the lumen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import (
    COORDINATE_MM,
    array_of,
    bounded,
    check_arguments,
    choice,
    instance,
    number_from,
    numbers_within,
)
from carina.errors import UsageError
from carina.navigate.flight_path import FlightPath
from carina.navigate.rotation import orthonormal, rotation_from_vector, vector_from_rotation, yaw_pitch_roll
from carina.scopes import Pose, ScopeDrive, ScopeState, upright
from carina.volume import Volume

Mode = Literal["free", "path", "scope"]
OperatorPosition = Literal["head", "facing"]
Limit = Literal["none", "volume", "path start", "path end"]

# Maximum distance in mm at which the tip joins the path gradually. The trachea's radius is about 9 mm; from farther
# away the transition would pass through tissue.
JOIN_MM = 10.0
MM = bounded(COORDINATE_MM, unit="mm")
RAD = bounded(1e6, unit="rad")
SECONDS = number_from(-86_400.0, 86_400.0, unit="s")
AN_OPERATOR = choice("head", "facing")
A_POSE = instance(Pose, "get one from a carina.FlightPath or from carina.Pose.looking")
A_PATH = instance(FlightPath, "create a carina.FlightPath from a route", optional=True)
A_VOLUME = instance(Volume, "open a volume with carina.open_volume", optional=True)
# Decrease of the offset per mm of advance: at most 4 degrees and half a millimetre, exponential for small offsets.
EASE_RAD_PER_MM = math.radians(4.0)
EASE_MM_PER_MM = 0.5
EASE_LENGTH_MM = 8.0


class Navigator:
    """Pose of the scope's tip, and the rules by which it moves.

    A navigator reads no clock: every amount is an argument.

    In mode *free* the tip advances along its viewing direction and turns about its own axes; it stays in the volume. In
    mode *path* it advances along the path; turning changes only the direction of view, not the path.

    In mode *scope* the lumen's wall constrains a bronchoscope: advancing inserts it, pitching bends its tip, and
    rolling or yawing rolls it, since its tip bends in one plane only (paper 7; :class:`carina.scopes.ScopeDrive`). For
    :meth:`steer`, up is the picture's up, whatever the operator's position; for :meth:`hold_scope`, up is the
    instrument's.

    Leaving the path keeps the pose exactly. Entering the path within 10 mm also keeps the pose; the offset in position
    and direction then decreases while the tip advances, so the picture never jumps. From farther away the tip moves to
    the nearest position on the path and looks along it.

    Parameters
    ----------
    pose
        Initial pose of the tip.
    volume
        Volume whose box (half a voxel beyond the outer centres) limits the tip in mode *free*; None sets no limit.
    operator
        ``"head"``: anterior at 12 o'clock. ``"facing"``: the picture is turned by 180 degrees. The value is only the
        initial state of :meth:`set_operator` and :meth:`level_horizon`; ``pose`` is not changed.

    Examples
    --------
    >>> tip = Navigator(Pose.looking([0, 0, 0], [0, 0, -1]))
    >>> tip.steer(advance_mm=5.0)
    >>> tip.pose.position_lps.tolist()
    [0.0, 0.0, -5.0]
    """

    @check_arguments(pose=A_POSE, volume=A_VOLUME, operator=AN_OPERATOR)
    def __init__(self, pose: Pose, *, volume: Volume | None = None, operator: OperatorPosition = "head") -> None:
        self._volume = volume
        self._operator: OperatorPosition = _checked_operator(operator)
        self._mode: Mode = "free"
        self._limit: Limit = "none"
        self._path: FlightPath | None = None
        self._path_mm = 0.0
        # In mode path: pose = frame(path_mm) * base roll * entry * look, and the position is offset by `shift`.
        self._base_roll_rad = 0.0
        self._entry = np.eye(3)
        self._look = np.eye(3)
        self._shift_lps = np.zeros(3)
        self._drive: ScopeDrive | None = None
        self._pose = pose
        self.place(pose)

    def __repr__(self) -> str:
        """Return a one-line description of this `Navigator` for the Python interpreter."""
        at = ", ".join(f"{v:.1f}" for v in self._pose.position_lps)
        along = f", path_mm={self._path_mm:.1f}" if self._mode == "path" else ""
        return f"Navigator(mode={self._mode!r}, at_lps=({at}){along}, operator={self._operator!r})"

    # Properties for views, sliders and the status line.

    @property
    def pose(self) -> Pose:
        """Pose of the scope's tip."""
        return self._pose

    @property
    def mode(self) -> Mode:
        """Mode of movement: ``"free"``, ``"path"`` (along a path) or ``"scope"`` (in the lumen)."""
        return self._mode

    @property
    def operator(self) -> OperatorPosition:
        """Position of the operator: at the patient's head, or facing the patient."""
        return self._operator

    @property
    def path(self) -> FlightPath | None:
        """Path to fly on, or None; it may be set in any mode."""
        return self._path

    @property
    def path_mm(self) -> float | None:
        """Position along the path in mm in mode *path*; None in the other modes."""
        return self._path_mm if self._mode == "path" else None

    @property
    def look_offset_rad(self) -> tuple[float, float, float]:
        """View direction relative to the path, rad: yaw right, pitch up, roll clockwise; zeros in mode *free*."""
        r = self._look
        pitch = math.asin(max(-1.0, min(1.0, -float(r[1, 2]))))
        return math.atan2(r[0, 2], r[2, 2]), pitch, math.atan2(r[1, 0], r[1, 1])

    @property
    def limit(self) -> Limit:
        """Limit that stopped the last movement early: the volume's edge or an end of the path; else ``none``."""
        return self._limit

    @property
    def scope_state(self) -> ScopeState | None:
        """State of the scope in the lumen in mode *scope*; None in the other modes."""
        return self._drive.state if self._mode == "scope" and self._drive is not None else None

    @property
    def scope_tip_mm(self) -> float | None:
        """Diameter of the scope's tip in mm in mode *scope*; None in the other modes."""
        return self._drive.scope.tip_mm if self._mode == "scope" and self._drive is not None else None

    @property
    def flexion_range_rad(self) -> tuple[float, float] | None:
        """Limits of the scope's flexion in radians, down (below 0) and up, in mode *scope*; None in other modes."""
        return self._drive.flexion_range_rad if self._mode == "scope" and self._drive is not None else None

    @property
    def picture_turned(self) -> bool:
        """Whether the picture is turned by 180 degrees, for an operator who faces the patient.

        The value does not depend on the mode, so a forward-oblique lens shows the same before and after a change of
        mode.
        """
        return self._operator == "facing"

    # Movement.

    @check_arguments(advance_mm=MM, yaw_rad=RAD, pitch_rad=RAD, roll_rad=RAD, dt_s=SECONDS)
    def steer(
        self,
        advance_mm: float = 0.0,
        yaw_rad: float = 0.0,
        pitch_rad: float = 0.0,
        roll_rad: float = 0.0,
        *,
        dt_s: float = 0.0,
    ) -> None:
        """Turn the scope's tip, then advance it.

        Parameters
        ----------
        advance_mm
            Distance forward, or back if negative: along the viewing direction (*free*), along the path (*path*), or as
            insertion (*scope*).
        yaw_rad, pitch_rad, roll_rad
            Right, up, and clockwise as the operator sees it, about the camera's own axes. In mode *path* they change
            the direction of view relative to the path, which stays until :meth:`reset_look`.
        dt_s
            Time since the last move; mode *scope* adds it to the time of contact.

        Raises
        ------
        UsageError
            If an amount is not finite.
        """
        amounts = (advance_mm, yaw_rad, pitch_rad, roll_rad)
        if not all(math.isfinite(v) for v in amounts):
            raise UsageError(f"steering amounts must be finite; found {amounts}")
        if self._mode == "scope":
            self._drive_by(advance_mm, roll_rad + yaw_rad, pitch_rad, dt_s)
            return
        turn = yaw_pitch_roll(yaw_rad, pitch_rad, roll_rad)
        if self._mode == "path":
            self._look = orthonormal(self._look @ turn)
            self._advance_on_path(self._path_mm + advance_mm)
            return
        rotation = orthonormal(self._pose.lps_from_camera[:3, :3] @ turn)
        at = self._pose.position_lps
        self._set_free_pose(rotation, self._cut_at_box(at, at + advance_mm * rotation[:, 2]))

    @check_arguments(offset_mm=array_of(3), turn=array_of(3, 3, largest=2.0), dt_s=SECONDS)
    def move_by(self, offset_mm: tuple[float, float, float], turn: NDArray[np.float64], *, dt_s: float = 0.0) -> None:
        """Translate and rotate the tip at once, as a rigid hand movement does.

        Parameters
        ----------
        offset_mm
            To the right, down and forward, in the camera's axes before the rotation. In mode *path* only forward has an
            effect.
        turn
            3x3 rotation about the camera's own axes; in mode *path* it changes the direction of view relative to the
            path.
        dt_s
            As in :meth:`steer`.

        Raises
        ------
        UsageError
            If a number is not finite.
        """
        if not (np.isfinite(turn).all() and all(math.isfinite(v) for v in offset_mm)):
            raise UsageError(f"a movement must be finite; found {offset_mm}")
        if self._mode == "scope":
            pitch, yaw, roll = (float(v) for v in vector_from_rotation(turn))
            self._drive_by(offset_mm[2], roll + yaw, pitch, dt_s)
            return
        if self._mode == "path":
            self._look = orthonormal(self._look @ turn)
            self._advance_on_path(self._path_mm + offset_mm[2])
            return
        before = self._pose.lps_from_camera
        wanted = before[:3, 3] + before[:3, :3] @ np.array(offset_mm)
        self._set_free_pose(orthonormal(before[:3, :3] @ turn), self._cut_at_box(before[:3, 3], wanted))

    @check_arguments(insertion_mm=MM, roll_rad=RAD, flexion_rad=RAD, dt_s=SECONDS)
    def hold_scope(self, insertion_mm: float, roll_rad: float, flexion_rad: float, *, dt_s: float = 0.0) -> None:
        """Set the scope's three controls, in mode *scope* only; see :meth:`carina.scopes.ScopeDrive.drive`."""
        drive = self._needed_drive()
        self._pose = drive.drive(insertion_mm, roll_rad, flexion_rad, max(dt_s, 0.0)).pose

    @check_arguments(drive=instance(ScopeDrive, "create a carina.ScopeDrive"))
    def enter_scope(self, drive: ScopeDrive) -> None:
        """Enter mode *scope* with a scope that lies in the lumen; the navigator's tip becomes the scope's tip.

        The scope's picture is turned for the position of the operator.
        """
        drive.set_operator(self._operator)
        self._drive = drive
        self._mode, self._limit = "scope", "none"
        self._look, self._entry = np.eye(3), np.eye(3)
        self._pose = drive.state.pose

    @check_arguments(path_mm=MM)
    def go_to(self, path_mm: float) -> None:
        """Go to a position along the path (mm, clamped to its ends) and enter mode *path*.

        From modes *free* and *scope* the tip then looks along the path; in mode *path* the direction of view stays.
        """
        if not math.isfinite(path_mm):
            raise UsageError(f"a position on the path must be finite; found {path_mm}")
        path = self._needed_path()
        if self._mode != "path":
            self._enter_path_at(min(max(path_mm, 0.0), path.length_mm), keep_view=False)
        self._advance_on_path(path_mm)

    def next_fork(self) -> float:
        """Move the tip to the next stop before a fork, or the path's end; return the position in mm."""
        self.go_to(self._needed_path().next_fork_mm(self._nearest_mm()))
        return self._path_mm

    def previous_fork(self) -> float:
        """Move the tip back to the previous look-out or the start of the path; return the position in mm."""
        self.go_to(self._needed_path().previous_fork_mm(self._nearest_mm()))
        return self._path_mm

    @check_arguments(pose=A_POSE)
    def place(self, pose: Pose) -> None:
        """Put the tip anywhere in the volume and enter mode *free*.

        Outside, the tip stops at the edge (:attr:`limit`).
        """
        self._mode = "free"
        self._look = np.eye(3)
        self._entry = np.eye(3)
        at = self._clamped_to_box(pose.position_lps)
        self._limit = "none" if np.array_equal(at, pose.position_lps) else "volume"
        if self._limit == "none":
            self._pose = pose
        else:
            self._set_pose(pose.lps_from_camera[:3, :3], at)

    @check_arguments(point_lps=numbers_within())
    def place_at(self, point_lps: Sequence[float] | NDArray[np.float64]) -> None:
        """Move the tip to a point (LPS mm), keep its direction of view, and enter mode *free*."""
        point = np.asarray(point_lps, dtype=np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise UsageError("a tip position needs three finite numbers (LPS mm)")
        matrix = self._pose.lps_from_camera.copy()
        matrix[:3, 3] = point
        self.place(Pose(matrix))

    # Modes.

    @check_arguments(path=A_PATH)
    def set_path(self, path: FlightPath | None) -> None:
        """Set the path to fly on, or None.

        In mode *path* the tip joins the new path at the nearest position; with None it enters mode *free*.
        """
        self._path = path
        if self._mode == "path":
            self._mode = "free"
            if path is not None:
                self._enter_path()
            else:
                self._look = np.eye(3)

    @check_arguments(mode=choice("free", "path", "scope"))
    def set_mode(self, mode: Mode) -> None:
        """Enter a movement mode; the picture jumps only if the tip is far from the path (see the class).

        Raises
        ------
        UsageError
            If the mode is unknown, or *path* is requested and there is no path.
        """
        if mode not in {"free", "path", "scope"}:
            raise UsageError(f"expected mode 'free', 'path' or 'scope'; found {mode!r}")
        if mode == self._mode:
            return
        if mode == "scope":
            raise UsageError("insert a scope into the lumen first", code="navigate.no-scope")
        if mode == "path":
            self._enter_path()
        else:
            self._mode = "free"
            self._limit = "none"
            self._look = np.eye(3)

    def toggle_mode(self) -> Mode:
        """Change between the modes *free* and *path*; return the new mode."""
        self.set_mode("free" if self._mode == "path" else "path")
        return self._mode

    # Orientation.

    def reset_look(self) -> None:
        """Turn the view back to the direction of the path; no effect in mode *free*."""
        if self._mode == "path":
            self._look = np.eye(3)
            self._entry = np.eye(3)
            self._update_path_pose()

    def level_horizon(self) -> None:
        """Roll until anterior (superior in an antero-posterior view) is up, or down for a facing operator."""
        level = upright(self._pose.forward_lps)
        if self._operator == "facing":
            level = -level
        rotation = self._pose.lps_from_camera[:3, :3]
        # In mode scope the whole instrument is rolled.
        # The level direction is perpendicular to the view; the camera's own up is -y.
        self._roll(math.atan2(float(level @ rotation[:, 0]), float(level @ -rotation[:, 1])))

    @check_arguments(position=AN_OPERATOR)
    def set_operator(self, position: OperatorPosition) -> None:
        """Set the operator's position, at the patient's head or facing the patient: the picture turns by 180 degrees.

        Mode *scope* also turns only the picture: a roll of the instrument would move a bent tip to the opposite wall.
        """
        if _checked_operator(position) == self._operator:
            return
        self._operator = position
        if self._mode == "scope":
            self._pose = self._needed_drive().set_operator(position).pose
        else:
            self._roll(math.pi)

    # State for recordings.

    def state(self) -> dict[str, Any]:
        """Return the state without volume, path and scope, as exact JSON values; a scope must be inserted again."""
        return {
            "operator": self._operator,
            "mode": "free" if self._mode == "scope" else self._mode,
            "path_mm": self._path_mm,
            "base_roll_rad": self._base_roll_rad,
            "entry": self._entry.tolist(),
            "look": self._look.tolist(),
            "shift_lps": self._shift_lps.tolist(),
            "lps_from_camera": self._pose.lps_from_camera.tolist(),
        }

    @check_arguments(state=instance(dict, "take one from Navigator.state"), path=A_PATH)
    def restore(self, state: dict[str, Any], path: FlightPath | None) -> None:
        """Restore a state of the navigator that :meth:`state` returned.

        Raises
        ------
        UsageError
            If ``state`` is not such a state.
        """
        try:
            arrays = {name: np.array(state[name], dtype=np.float64) for name in ("entry", "look", "shift_lps")}
            numbers = (float(state["path_mm"]), float(state["base_roll_rad"]))
            pose, operator = Pose(np.array(state["lps_from_camera"], dtype=np.float64)), state["operator"]
            mode = state["mode"]
        except (KeyError, TypeError, ValueError) as error:
            raise UsageError(f"not a valid navigator state: {error}", code="navigate.recording") from error
        shapes = [array.shape for array in arrays.values()]
        finite = all(np.isfinite(array).all() for array in arrays.values()) and all(map(math.isfinite, numbers))
        if shapes != [(3, 3), (3, 3), (3,)] or not finite or mode not in {"free", "path"}:
            raise UsageError(
                f"not a valid navigator state: mode {mode!r}, arrays of shape {shapes}", code="navigate.recording"
            )
        if mode == "path" and path is None:
            raise UsageError("path mode needs a path", code="navigate.recording")
        self._operator = _checked_operator(operator)
        self._path, self._mode = path, mode
        self._path_mm, self._base_roll_rad = numbers
        self._entry, self._look, self._shift_lps = arrays["entry"], arrays["look"], arrays["shift_lps"]
        self._limit = "none"
        self._pose = pose

    # Private methods.

    def _roll(self, angle_rad: float) -> None:
        """Roll the picture clockwise about its centre, in mode *path* for the whole path."""
        if self._mode == "scope":
            self._drive_by(0.0, angle_rad, 0.0, 0.0)
            return
        roll = rotation_from_vector(np.array([0.0, 0.0, angle_rad]))
        if self._mode == "free":
            self._set_pose(orthonormal(self._pose.lps_from_camera[:3, :3] @ roll), self._pose.position_lps)
            return
        # frame * base * entry * look * roll = frame * (base * roll) * (roll^T entry roll) * (roll^T look roll): the
        # roll stays along the path, and the offsets keep their effect on the picture.
        self._base_roll_rad = math.remainder(self._base_roll_rad + angle_rad, math.tau)
        self._entry = roll.T @ self._entry @ roll
        self._look = roll.T @ self._look @ roll
        self._update_path_pose()

    def _needed_drive(self) -> ScopeDrive:
        if self._mode != "scope" or self._drive is None:
            raise UsageError("no scope has been inserted", code="navigate.no-scope")
        return self._drive

    def _drive_by(self, advance_mm: float, roll_rad: float, pitch_rad: float, dt_s: float) -> None:
        """Move the scope by an advance, roll and flexion relative to its present state.

        The amounts are not added to the last commanded values, so a hand that pushed against a wall need not first draw
        back.
        """
        drive = self._needed_drive()
        state = drive.state
        down, up = drive.flexion_range_rad
        bend = -pitch_rad if self.picture_turned else pitch_rad
        flexion = min(max(state.flexion_rad + bend, down), up)
        self.hold_scope(state.insertion_mm + advance_mm, state.roll_rad + roll_rad, flexion, dt_s=dt_s)

    def _needed_path(self) -> FlightPath:
        if self._path is None:
            raise UsageError(
                "there is no path to fly along; choose a target or a branch first", code="navigate.no-path"
            )
        return self._path

    def _nearest_mm(self) -> float:
        """Return the tip's position along the path in mm; outside mode *path*, the nearest position."""
        if self._mode == "path":
            return self._path_mm
        return self._needed_path().nearest_mm(self._pose.position_lps)

    def _enter_path(self) -> None:
        path_mm, distance_mm = self._needed_path().nearest(self._pose.position_lps)
        self._enter_path_at(path_mm, keep_view=distance_mm <= JOIN_MM)

    def _enter_path_at(self, path_mm: float, *, keep_view: bool) -> None:
        before = self._pose.lps_from_camera
        self._mode = "path"
        self._limit = "none"
        self._path_mm = path_mm
        self._look = np.eye(3)
        self._entry = np.eye(3)
        self._shift_lps = np.zeros(3)
        self._base_roll_rad = math.pi if self._operator == "facing" else 0.0
        if not keep_view:
            self._update_path_pose()
            return
        on_path = self._needed_path().pose_at(path_mm).lps_from_camera
        self._entry = orthonormal((on_path[:3, :3] @ self._path_pose()).T @ before[:3, :3])
        self._shift_lps = before[:3, 3] - on_path[:3, 3]
        # The pose is stored instead of computed again from the offsets, because rounding would change the pose.

    def _advance_on_path(self, path_mm: float) -> None:
        length_mm = self._needed_path().length_mm
        there = min(max(path_mm, 0.0), length_mm)
        self._limit = "path start" if path_mm < 0.0 else "path end" if path_mm > length_mm else "none"
        moved_mm = abs(there - self._path_mm)
        vector = vector_from_rotation(self._entry)
        self._entry = rotation_from_vector(vector * eased(float(np.linalg.norm(vector)), moved_mm, EASE_RAD_PER_MM))
        self._shift_lps = self._shift_lps * eased(float(np.linalg.norm(self._shift_lps)), moved_mm, EASE_MM_PER_MM)
        self._path_mm = there
        self._update_path_pose()

    def _path_pose(self) -> NDArray[np.float64]:
        return rotation_from_vector(np.array([0.0, 0.0, self._base_roll_rad]))

    def _update_path_pose(self) -> None:
        """Compute the pose in mode *path* from the position along the path and the offsets."""
        on_path = self._needed_path().pose_at(self._path_mm).lps_from_camera
        rotation = orthonormal(on_path[:3, :3] @ self._path_pose() @ self._entry @ self._look)
        self._set_pose(rotation, on_path[:3, 3] + self._shift_lps)

    def _set_pose(self, rotation: NDArray[np.float64], at_lps: NDArray[np.float64]) -> None:
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = at_lps
        self._pose = Pose(matrix)

    def _set_free_pose(self, rotation: NDArray[np.float64], wanted: tuple[NDArray[np.float64], bool]) -> None:
        at, held = wanted
        self._limit = "volume" if held else "none"
        self._set_pose(rotation, at)

    def _reduced_box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the volume's box in voxel coordinates, reduced by more than rounding errors."""
        if self._volume is None:
            return None
        nz, ny, nx = self._volume.shape_zyx
        hair = 1e-6
        return np.full(3, -0.5 + hair), np.array([nx, ny, nz]) - 0.5 - hair

    def _clamped_to_box(self, point_lps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a point, or the nearest point of the volume's box if the point lies outside, LPS mm."""
        box = self._reduced_box()
        if box is None or self._volume is None:
            return point_lps
        ijk = self._volume.to_ijk(point_lps)
        inside = np.clip(ijk, *box)
        return point_lps if np.array_equal(inside, ijk) else self._volume.to_lps(inside)

    def _cut_at_box(
        self, start_lps: NDArray[np.float64], end_lps: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], bool]:
        """Return the end of a move (cut where the move leaves the volume's box), and whether the move was cut."""
        box = self._reduced_box()
        if box is None or self._volume is None:
            return end_lps, False
        start, end = self._volume.to_ijk(start_lps), self._volume.to_ijk(end_lps)
        if np.array_equal(np.clip(end, *box), end):
            return end_lps, False
        share = 1.0
        for axis in range(3):
            step = end[axis] - start[axis]
            face = box[1][axis] if step > 0 else box[0][axis]
            if abs(step) > 0.0 and (end[axis] - face) * step > 0.0:
                share = min(share, max(0.0, (face - start[axis]) / step))
        return self._volume.to_lps(np.clip(start + share * (end - start), *box)), True


def eased(amount: float, moved_mm: float, rate_per_mm: float) -> float:
    """Return the fraction of a lateral or angular offset that remains after an advance.

    The offset decreases by ``rate_per_mm``, and exponentially once that is slower. The formula is closed, so ten steps
    of 1 mm give the same result as one of 10 mm.
    """
    if amount == 0.0 or moved_mm == 0.0:
        return 1.0
    knee = rate_per_mm * EASE_LENGTH_MM
    linear_mm = max(0.0, (amount - knee) / rate_per_mm)
    if moved_mm <= linear_mm:
        return (amount - rate_per_mm * moved_mm) / amount
    return min(amount, knee) * math.exp(-(moved_mm - linear_mm) / EASE_LENGTH_MM) / amount


def _checked_operator(position: OperatorPosition) -> OperatorPosition:
    if position not in {"head", "facing"}:
        raise UsageError(f"expected operator position 'head' or 'facing'; found {position!r}")
    return position
