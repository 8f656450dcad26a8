"""Flights through key frames: at given times, or at a speed in mm/s."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.commands.key_frames import MAX_SPEED_MM_S, MIN_SPEED_MM_S
from carina.display import one_line
from carina.errors import UsageError
from carina.navigate.auto_flight import check_duration
from carina.navigate.key_legs import ZERO_LENGTH_MM, AirwayWay, Leg, build_legs
from carina.scopes import Pose

__all__ = ["MAX_SPEED_MM_S", "MIN_SPEED_MM_S", "KeyFrame", "KeyFrameFlight"]

# Mean rotation speed of the camera, rad/s: a rotation takes at least this time, even on a short leg.
TURN_RAD_S = math.radians(40.0)
# Time in s in which a flight accelerates from rest to full speed.
RAMP_S = 0.5
MIN_TURN_S = 0.1


@one_line
@dataclass(frozen=True, slots=True)
class KeyFrame:
    """Pose of a flight, with the route and speed from the previous key frame to this one.

    Parameters
    ----------
    time_s
        Time of the key frame; None if speeds define the times.
    pose
        Pose of the camera.
    name
        Name for lists.
    speed_mm_s
        Speed of the leg from the previous key frame, 0.1 to 500; None uses the flight's speed.
    way
        Airways between the previous key frame and this one; None for a curve through space.
    """

    time_s: float | None
    pose: Pose
    name: str = ""
    speed_mm_s: float | None = None
    way: AirwayWay | None = None


class _TimedCurve:
    """Curve of positions through key frames at given times.

    The curve is a cubic Hermite curve over time whose slopes are the differences of the neighbours (Catmull-Rom over
    unequal times).
    """

    def __init__(self, at: NDArray[np.float64], times: NDArray[np.float64]) -> None:
        self._at, self._slopes, self._times = at, np.gradient(at, times, axis=0), times

    def position(self, n: int, t: float) -> NDArray[np.float64]:
        length = float(self._times[n + 1] - self._times[n])
        t2, t3 = t * t, t * t * t
        return np.asarray(
            (2 * t3 - 3 * t2 + 1) * self._at[n]
            + (t3 - 2 * t2 + t) * length * self._slopes[n]
            + (3 * t2 - 2 * t3) * self._at[n + 1]
            + (t3 - t2) * length * self._slopes[n + 1]
        )


class _CruiseMotion:
    """Distance flown on a leg as a function of time: constant acceleration, constant speed, constant deceleration."""

    def __init__(self, length_mm: float, begin_mm_s: float, speed_mm_s: float, end_mm_s: float) -> None:
        self._length_mm, self._speed = length_mm, speed_mm_s
        self._begin, self._end = begin_mm_s, end_mm_s
        self._begin_mm, self._end_mm = self._ramp_mm(begin_mm_s), self._ramp_mm(end_mm_s)
        self._begin_s = 2.0 * self._begin_mm / (begin_mm_s + speed_mm_s)
        self._end_s = 2.0 * self._end_mm / (end_mm_s + speed_mm_s)
        even_mm = length_mm - self._begin_mm - self._end_mm
        self.duration_s = self._begin_s + even_mm / speed_mm_s + self._end_s

    def place_mm(self, time_s: float) -> float:
        if time_s < self._begin_s:
            return time_s * (self._begin + 0.5 * (self._speed - self._begin) * time_s / self._begin_s)
        left_s = self.duration_s - time_s
        if left_s < self._end_s:
            return self._length_mm - left_s * (self._end + 0.5 * (self._speed - self._end) * left_s / self._end_s)
        return self._begin_mm + (time_s - self._begin_s) * self._speed

    def _ramp_mm(self, slow_mm_s: float) -> float:
        """Return the distance in mm over which the speed changes at an end of the leg: at most half of the leg."""
        wanted = 0.5 * (self._speed + slow_mm_s) * (self._speed - slow_mm_s) / self._speed * RAMP_S
        return min(wanted, 0.5 * self._length_mm)


class KeyFrameFlight:
    """Flight through poses, without corners.

    Either all key frames have times, or none has. Without times there is one path, and each leg is flown at its speed
    (mm/s) with half a second of acceleration and deceleration. The flight rests for a moment where the path turns
    sharply back (from one bronchus into its sibling). A rotation of the camera takes at least its own time.

    Parameters
    ----------
    frames
        Two or more; times increase.
    speed_mm_s
        Speed of legs without their own speed, 0.1 to 500.

    Raises
    ------
    UsageError
        ``navigate.keys``: if there are fewer than two key frames, only some have times, times do not increase, a speed
        is out of range, or the flight lasts more than a day.

    Notes
    -----
    With :attr:`KeyFrame.way` the path is the centreline of the airways: the offset of a key frame from the centreline
    decreases smoothly, and the camera turns with the airway. Elsewhere the path is a curve through space. See
    :func:`carina.navigate.key_legs.build_legs`.

    Examples
    --------
    >>> looks = [Pose.looking([0, 0, z], [0, 0, -1]) for z in (100.0, 60.0, 20.0)]
    >>> flight = KeyFrameFlight([KeyFrame(None, pose) for pose in looks], speed_mm_s=20)
    >>> flight.duration_s, flight.key_times_s[1]
    (4.5, 2.25)
    >>> flight.pose_at(2.25).position_lps.tolist()
    [0.0, 0.0, 60.0]
    """

    def __init__(self, frames: Sequence[KeyFrame], *, speed_mm_s: float = 20.0) -> None:
        if len(frames) < 2:
            raise UsageError("a flight needs at least two key frames", code="navigate.keys")
        timed = [frame.time_s for frame in frames if frame.time_s is not None]
        if timed and len(timed) != len(frames):
            raise UsageError("either all key frames must have times, or none", code="navigate.keys")
        for speed in (speed_mm_s, *(frame.speed_mm_s for frame in frames)):
            if speed is not None and not MIN_SPEED_MM_S <= speed <= MAX_SPEED_MM_S:
                raise UsageError(
                    f"a speed must be between {MIN_SPEED_MM_S:g} and {MAX_SPEED_MM_S:g} mm/s; found {speed:g}",
                    code="navigate.keys",
                )
        self._poses = [frame.pose for frame in frames]
        self._legs, rests = build_legs([pose.lps_from_camera for pose in self._poses], [f.way for f in frames[1:]])
        self._timed: _TimedCurve | None = None
        self._laws: list[_Law | None] = [None] * len(self._legs)
        if timed:
            times = np.array(timed, dtype=np.float64)
            if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
                raise UsageError("the times of the key frames must increase", code="navigate.keys")
            if any(frame.way is not None for frame in frames):
                raise UsageError(
                    "key frames with times can only be flown through space, not along airways", code="navigate.keys"
                )
            check_duration(float(times[-1] - times[0]))
            self._times = times - times[0]
            self._timed = _TimedCurve(np.array([pose.position_lps for pose in self._poses]), self._times)
        else:
            speeds = [speed_mm_s if frame.speed_mm_s is None else frame.speed_mm_s for frame in frames[1:]]
            self._laws = _leg_motions(self._legs, rests, speeds)
            turns_s = [max(leg.turn_rad / TURN_RAD_S, MIN_TURN_S) for leg in self._legs]
            durations_s = [s if law is None else law.duration_s for law, s in zip(self._laws, turns_s, strict=True)]
            self._times = np.concatenate([[0.0], np.cumsum(durations_s)])
            check_duration(self.duration_s)

    def __repr__(self) -> str:
        """Return a one-line description of this `KeyFrameFlight` for the Python interpreter."""
        return f"KeyFrameFlight({len(self._poses)} key frames, {self.duration_s:.1f} s)"

    @property
    def duration_s(self) -> float:
        """Time from the first key frame to the last, s."""
        return float(self._times[-1])

    @property
    def key_times_s(self) -> tuple[float, ...]:
        """Time of each key frame since the first, s."""
        return tuple(float(t) for t in self._times)

    @property
    def leg_mm(self) -> tuple[float, ...]:
        """Length of the path to each key frame from the previous one, mm; one value fewer than key frames."""
        return tuple(leg.length_mm for leg in self._legs)

    @property
    def through_airways(self) -> tuple[bool, ...]:
        """Whether the flight follows the airways between each key frame and the next."""
        return tuple(leg.frames is not None for leg in self._legs)

    def pose_at(self, time_s: float) -> Pose:
        """Return the pose at a time after the first key frame; times are clamped, and key frames are exact."""
        wanted = min(max(time_s, 0.0), self.duration_s)
        n = min(int(np.searchsorted(self._times, wanted, side="right")) - 1, len(self._legs) - 1)
        since_s = wanted - float(self._times[n])
        if since_s <= 0.0 or wanted >= self._times[n + 1]:
            return self._poses[n if since_s <= 0.0 else n + 1]
        leg, law = self._legs[n], self._laws[n]
        share = since_s / float(self._times[n + 1] - self._times[n])
        mm = 0.0 if law is None else law.place_mm(since_s)
        matrix = np.eye(4)
        matrix[:3, 3] = leg.position(mm) if self._timed is None else self._timed.position(n, share)
        matrix[:3, :3] = leg.rotation(mm, share)
        return Pose(matrix)


class _InterruptedMotion:
    """Distance flown between two key frames, with a rest, as a function of time."""

    def __init__(self, first: _CruiseMotion, first_mm: float, second: _CruiseMotion) -> None:
        self._first, self._first_mm, self._second = first, first_mm, second
        self.duration_s = first.duration_s + second.duration_s

    def place_mm(self, time_s: float) -> float:
        since_s = time_s - self._first.duration_s
        return self._first.place_mm(time_s) if since_s < 0.0 else self._first_mm + self._second.place_mm(since_s)


_Law = _CruiseMotion | _InterruptedMotion


def _leg_motions(legs: Sequence[Leg], rests: Sequence[bool], speeds_mm_s: Sequence[float]) -> list[_Law | None]:
    """Return the distance flown as a function of time for each leg; None for a leg on which the camera only turns."""
    speeds = []
    for leg, speed in zip(legs, speeds_mm_s, strict=True):
        turn_s = leg.turn_rad / TURN_RAD_S
        speeds.append(min(speed, leg.length_mm / turn_s) if turn_s > 0.0 else speed)
    only_turns = [leg.length_mm <= ZERO_LENGTH_MM for leg in legs]
    knots = [
        0.0,
        *(
            0.0 if rests[n] or only_turns[n - 1] or only_turns[n] else min(speeds[n - 1], speeds[n])
            for n in range(1, len(legs))
        ),
        0.0,
    ]
    laws: list[_Law | None] = []
    for n, leg in enumerate(legs):
        begin, speed, end = knots[n], speeds[n], knots[n + 1]
        if only_turns[n]:
            laws.append(None)
        elif leg.rest_mm is None:
            laws.append(_CruiseMotion(leg.length_mm, begin, speed, end))
        else:
            first = _CruiseMotion(leg.rest_mm, begin, speed, 0.0)
            laws.append(
                _InterruptedMotion(first, leg.rest_mm, _CruiseMotion(leg.length_mm - leg.rest_mm, 0.0, speed, end))
            )
    return laws
