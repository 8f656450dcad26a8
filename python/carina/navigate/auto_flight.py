"""Flights that nobody steers: along a route with a stop at each fork, and through key frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError
from carina.navigate.flight_path import FlightPath
from carina.navigate.rotation import orthonormal, rotation_from_vector, vector_from_rotation
from carina.scopes import Pose

__all__ = ["AutoFlight", "KeyFrame", "KeyFrameFlight", "frame_times_s"]

MAX_DURATION_S = 86_400.0
"""Of a flight, a day: a longer one is a slip of the pen, and its frames need more memory than there is."""


class AutoFlight:
    """Along a path at one speed, with a pause at each look-out.

    Parameters
    ----------
    path
        The way; it stops at its look-outs.
    speed_mm_s
        0.1 to 500.
    pause_s
        At each look-out and at the end, 0 to 60.

    Raises
    ------
    UsageError
        If a number is out of range.

    Examples
    --------
    >>> flight = AutoFlight(FlightPath([[0.0, 0, 100], [0, 0, 0]], forks_mm=[50.0]), speed_mm_s=10, pause_s=1)
    >>> flight.duration_s, flight.path_mm(5.5), flight.path_mm(7.0)
    (12.0, 50.0, 60.0)
    """

    def __init__(self, path: FlightPath, *, speed_mm_s: float = 20.0, pause_s: float = 1.0) -> None:
        if not (0.1 <= speed_mm_s <= 500.0 and 0.0 <= pause_s <= 60.0):
            raise UsageError(
                f"a flight has a speed of 0.1 to 500 mm/s and pauses of 0 to 60 s; found {speed_mm_s:g} and {pause_s:g}"
            )
        self._path = path
        stops = [mm for mm in path.lookouts_mm if 0.0 < mm < path.length_mm]
        # Times and places between which it moves evenly.
        times, places, now_s = [0.0], [0.0], 0.0
        for stop_mm in [*stops, path.length_mm]:
            now_s += (stop_mm - places[-1]) / speed_mm_s
            times.append(now_s)
            places.append(stop_mm)
            now_s += pause_s
            times.append(now_s)
            places.append(stop_mm)
        self._times, self._places = np.array(times), np.array(places)

    @property
    def duration_s(self) -> float:
        """From the start of the path to the end of the last pause."""
        return float(self._times[-1])

    def path_mm(self, time_s: float) -> float:
        """The place at a time; clamped to the ends."""
        return float(np.interp(time_s, self._times, self._places))

    def pose_at(self, time_s: float) -> Pose:
        """The pose at a time."""
        return self._path.pose_at(self.path_mm(time_s))


@dataclass(frozen=True, slots=True)
class KeyFrame:
    """A pose at a time."""

    time_s: float
    pose: Pose


class KeyFrameFlight:
    """Through poses at times, without corners: positions on a Catmull-Rom curve, directions by slerp, eased.

    Parameters
    ----------
    frames
        Two or more, by increasing time.

    Raises
    ------
    UsageError
        If they are fewer, their times do not increase, or more than a day lies between them.

    Notes
    -----
    Positions are a cubic Hermite curve with the slopes of the neighbours' differences, over unequal times. Between two
    directions the turn is the shortest (Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985), at a
    speed that begins and ends at rest, so that no key frame is a jerk.
    """

    def __init__(self, frames: Sequence[KeyFrame]) -> None:
        times = np.array([frame.time_s for frame in frames], dtype=np.float64)
        if len(times) < 2 or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise UsageError("a flight through key frames needs two or more, at increasing times")
        _check_duration(float(times[-1]) - float(times[0]))
        self._times = times
        self._matrices = [frame.pose.lps_from_camera for frame in frames]
        at = np.array([matrix[:3, 3] for matrix in self._matrices])
        self._at, self._slopes = at, np.gradient(at, times, axis=0)

    @property
    def duration_s(self) -> float:
        """From the first to the last."""
        return float(self._times[-1] - self._times[0])

    def pose_at(self, time_s: float) -> Pose:
        """The pose at a time after the first; clamped to the ends, the key frames themselves to the last bit."""
        wanted = min(max(time_s + float(self._times[0]), float(self._times[0])), float(self._times[-1]))
        n = min(int(np.searchsorted(self._times, wanted, side="right")) - 1, len(self._times) - 2)
        length = float(self._times[n + 1] - self._times[n])
        t = (wanted - float(self._times[n])) / length
        if t <= 0.0 or t >= 1.0:
            return Pose(self._matrices[n if t <= 0.0 else n + 1])
        matrix = np.eye(4)
        matrix[:3, 3] = self._position(n, t, length)
        a, b = self._matrices[n][:3, :3], self._matrices[n + 1][:3, :3]
        eased = t * t * (3.0 - 2.0 * t)
        matrix[:3, :3] = orthonormal(a @ rotation_from_vector(eased * vector_from_rotation(orthonormal(a.T @ b))))
        return Pose(matrix)

    def _position(self, n: int, t: float, length: float) -> NDArray[np.float64]:
        t2, t3 = t * t, t * t * t
        return np.asarray(
            (2 * t3 - 3 * t2 + 1) * self._at[n]
            + (t3 - 2 * t2 + t) * length * self._slopes[n]
            + (3 * t2 - 2 * t3) * self._at[n + 1]
            + (t3 - t2) * length * self._slopes[n + 1]
        )


def frame_times_s(duration_s: float, rate_hz: float) -> NDArray[np.float64]:
    """Times of a video's frames: the first at 0, so many that they last as long as the flight, one at least.

    Raises
    ------
    UsageError
        If the flight lasts longer than a day.
    """
    _check_duration(duration_s)
    return np.arange(max(1, math.floor(duration_s * rate_hz + 0.5))) / rate_hz


def _check_duration(duration_s: float) -> None:
    if not duration_s <= MAX_DURATION_S:
        raise UsageError(
            f"a flight lasts at most 24 hours ({MAX_DURATION_S:.0f} s); found {duration_s:g} s: times are in seconds"
        )
