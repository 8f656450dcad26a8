"""Frames of a recorded flight at a fixed rate: the pose of the tip and the instrument of each frame."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.breathing import ChestDeformation, ChestMotion
from carina.display import one_line
from carina.errors import NoResultError
from carina.navigate import Recording
from carina.scopes import DEFAULT_SCOPE, Pose, ScopePreset, WallField, scope_preset

FRAME_HZ = 10.0
"""Rate in Hz of the frames on which all scores are computed."""
MAX_FLIGHT_S = 7200.0
"""Maximum duration in s of a flight that is scored."""

REPEATED_SHARE = 0.5
"""Share of poses equal to those of an earlier flight, above which a flight is a replay of it."""

Poses = NDArray[np.float64]


@one_line
@dataclass(frozen=True, slots=True)
class FlightOptics:
    """Instrument and field of view of a part of a flight."""

    scope: ScopePreset
    """Instrument; the generic one if the flight used a free camera."""
    is_free_camera: bool
    """Whether the flight used a free camera without an instrument."""
    fov_deg: float
    """Field of view of the recorded picture, degrees."""
    picture_turned: bool
    """Whether the picture is turned by 180 degrees, for an operator who faces the patient."""

    @property
    def counted_fov_deg(self) -> float:
        """Field of view in degrees for the scores: that of the recorded picture, at most that of the instrument."""
        return min(self.fov_deg, self.scope.usual_fov_deg)

    @property
    def is_wider(self) -> bool:
        """Whether the recorded picture has a wider field of view than the instrument."""
        return self.fov_deg > self.scope.usual_fov_deg + 0.5


@dataclass(slots=True)
class _KnownFrame:
    """Results of one frame for one pose of the tip and one motion of the chest."""

    pose: bytes
    motion: ChestMotion
    deformation: ChestDeformation | None
    """Deformation of the chest; None if the chest is at rest."""
    to_wall_mm: dict[bool, float] = field(default_factory=dict)
    """Distances to the wall that were computed, by the argument ``ball`` of :meth:`FlightFrames.tips_to_wall_mm`."""
    carried: Poses | None = None
    """Pose (4, 4) of the tip in the moved patient, if it was computed."""


class KnownFrames:
    """Results of the frames of one flight with a simulated breathing, which are computed once while the flight grows.

    A result is used only for the same pose, motion and wall, so all results are those without a cache, bit for bit.
    """

    def __init__(self) -> None:
        self._frames: dict[int, _KnownFrame] = {}
        self._wall: WallField | None = None

    def __repr__(self) -> str:
        """Return the number of frames with results."""
        return f"KnownFrames({len(self._frames)})"

    def frame(self, n: int, pose: NDArray[np.float64], motion: ChestMotion) -> _KnownFrame:
        """Return the results of frame ``n`` for a pose (4, 4) and a motion; without results if one of them is new."""
        found, content = self._frames.get(n), pose.tobytes()
        if found is None or found.pose != content or (found.motion is not motion and found.motion != motion):
            deformation = motion.at(n / FRAME_HZ)
            found = _KnownFrame(content, motion, None if deformation.is_rest else deformation)
            self._frames[n] = found
        return found

    def use_wall(self, wall: WallField) -> None:
        """Forget the distances to another wall."""
        if wall is not self._wall:
            self._wall = wall
            for one in self._frames.values():
                one.to_wall_mm.clear()


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class FlightFrames:
    """Frames of a flight: frame k is at k / :data:`FRAME_HZ` s and has the last pose recorded up to then."""

    lps_from_tip: Poses = field(repr=False)
    """(n, 4, 4) pose of the tip at each frame, in the CT at rest, mm; a simulated breathing carries it along."""
    pose_number: NDArray[np.int64] = field(repr=False)
    """(n,) number of the recorded pose of each frame; consecutive frames with one number show the same pose."""
    optics_number: NDArray[np.int64] = field(repr=False)
    """(n,) index into ``optics`` of each frame."""
    optics: tuple[FlightOptics, ...]
    complete: bool
    """Whether the recording was finished and its attempt at a task, if any, was completed, stopped or timed out."""
    recorded_poses: Poses = field(repr=False)
    """(m, 4, 4) all recorded poses, mm."""
    recorded_times_s: NDArray[np.float64] = field(repr=False)
    """(m,) time of each recorded pose from the start of the recording, s."""
    pauses: tuple[tuple[float, float], ...] = ()
    """Pauses: time from the start of the recording, which excludes pauses, and length, both in s."""
    motions: tuple[tuple[float, ChestMotion | None], ...] = ()
    """Changes of the simulated breathing (`carina.navigate.Recording.motions`); empty without breathing."""
    known: KnownFrames = field(default_factory=KnownFrames, repr=False)
    """Results that are already computed, which the frames of one flight share while it grows."""

    @property
    def times_s(self) -> NDArray[np.float64]:
        """(n,) time of each frame from the start of the recording, s."""
        return np.arange(len(self.lps_from_tip)) / FRAME_HZ

    def deformation(self, n: int) -> ChestDeformation | None:
        """Return the deformation of the chest at a frame; None if the chest is at rest."""
        found = self._known_frame(n)
        return None if found is None else found.deformation

    def _known_frame(self, n: int) -> _KnownFrame | None:
        """Return the results of a frame with a simulated breathing; None without breathing."""
        time_s = n / FRAME_HZ
        motion = next((one for at_s, one in reversed(self.motions) if at_s <= time_s + 1e-9), None)
        return None if motion is None else self.known.frame(n, self.lps_from_tip[n], motion)

    def _moved_frames(self) -> Iterator[tuple[int, ChestDeformation, _KnownFrame]]:
        """Yield the frames in which the chest is not at rest, with its deformation and the known results."""
        for n in range(len(self.lps_from_tip) if self.motions else 0):
            found = self._known_frame(n)
            if found is not None and found.deformation is not None:
                yield n, found.deformation, found

    def tips_to_wall_mm(self, wall: WallField, *, ball: bool = False) -> NDArray[np.float64]:
        """Return the distance (n,) in mm from the tip to the wall at each frame, in the moved patient.

        ``ball`` selects the radius of the largest ball that fits (`WallField.ball_mm`), else `WallField.distance_mm`.
        """
        at = self.lps_from_tip[:, :3, 3]
        found = wall.ball_mm(at) if ball else wall.distance_mm(at)
        self.known.use_wall(wall)
        for n, deformation, known in self._moved_frames():
            if ball not in known.to_wall_mm:
                moved, point = wall.deformed(deformation), deformation.points(at[n])
                known.to_wall_mm[ball] = float((moved.ball_mm(point) if ball else moved.distance_mm(point))[0])
            found[n] = known.to_wall_mm[ball]
        return found

    def pose_digest(self) -> str:
        """Return a digest of all recorded poses."""
        return hashlib.blake2b(np.ascontiguousarray(self.recorded_poses, "<f8").tobytes(), digest_size=16).hexdigest()

    def repeats(self, earlier: FlightFrames) -> bool:
        """Return whether most poses of this flight are equal, bit for bit, to poses of an earlier flight.

        A replay of a recording repeats its poses at any speed; a hand never does.
        """
        own, other = ({pose.tobytes() for pose in one.recorded_poses} for one in (self, earlier))
        return len(own) > 1 and len(own & other) > REPEATED_SHARE * len(own)

    def cameras(self) -> Poses:
        """Return the poses (n, 4, 4) of the camera in the moved patient.

        They differ from the tip's for a forward-oblique instrument, and with a simulated breathing.
        """
        found = self.lps_from_tip
        if self.motions:
            found = found.copy()
            for n, deformation, known in self._moved_frames():
                if known.carried is None:
                    known.carried = Pose(found[n]).carried_by(deformation).lps_from_camera
                found[n] = known.carried
        if all(one.scope.view_up_deg == 0.0 for one in self.optics):
            return found
        found = found.copy()
        for n, number in enumerate(self.optics_number):
            one = self.optics[number]
            found[n] = one.scope.camera_pose(Pose(found[n]), picture_turned=one.picture_turned).lps_from_camera
        return found


def flight_frames(recording: Recording) -> FlightFrames:
    """Return the frames of a recorded flight.

    Raises
    ------
    VolumeImportError
        ``navigate.recording``: if a recorded pose is invalid.
    NoResultError
        ``training.too-long``: if the recording is longer than :data:`MAX_FLIGHT_S`.
    UsageError
        ``scope.name``: if the library does not have the recorded instrument.
    """
    if recording.length_s > MAX_FLIGHT_S:
        raise NoResultError(
            f"score: the recording: expected at most {MAX_FLIGHT_S:.0f} s; found {recording.length_s:.0f} s; "
            "record each attempt separately",
            code="training.too-long",
        )
    pose_times_s, poses = recording.recorded_poses()
    # The tolerance includes the frame of a last pose whose time was rounded down.
    num = math.floor(recording.length_s * FRAME_HZ + 1e-6) + 1
    times_s = np.arange(num) / FRAME_HZ
    views = [(float(line["t"]), dict(line["view"])) for line in recording.lines if "view" in line]
    optics = (_optics({}), *(_optics(view) for _, view in views))
    numbers = latest_before(pose_times_s, times_s)
    # A view that is recorded at the start applies to frame 0.
    view_numbers = np.searchsorted(np.array([at for at, _ in views]), times_s + 1e-9, side="right")
    # An attempt at a task counts only if it reached its end; see `carina.navigate.recording.TaskOutcome`.
    ended = recording.task is None or recording.task_outcome in {"completed", "stopped", "time-limit"}
    complete = recording.complete and ended
    return FlightFrames(
        poses[numbers],
        numbers,
        view_numbers,
        optics,
        complete,
        poses,
        pose_times_s,
        recording.pauses,
        recording.motions,
    )


def latest_before(known_s: NDArray[np.float64], times_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return for each time the index of the latest known time that is not after it; 0 if all known times are later."""
    return np.maximum(np.searchsorted(known_s, times_s + 1e-9, side="right") - 1, 0)


def _optics(view: dict[str, Any]) -> FlightOptics:
    name, fov_deg = view.get("scope"), view.get("fov_deg")
    scope = scope_preset(name if isinstance(name, str) else DEFAULT_SCOPE)
    is_number = isinstance(fov_deg, int | float) and 1.0 <= fov_deg <= 170.0
    return FlightOptics(
        scope,
        not isinstance(name, str),
        float(fov_deg) if is_number and fov_deg is not None else scope.usual_fov_deg,
        view.get("operator") == "facing",
    )
