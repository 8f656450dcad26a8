"""Automatic flight along a route with a stop at each fork."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import any_number, check_arguments, instance, number_from
from carina.errors import UsageError
from carina.navigate.flight_path import FlightPath
from carina.scopes import Pose

MAX_DURATION_S = 86_400.0
"""Maximum duration of a flight, one day; a longer one is an input error, and its frames do not fit in memory."""


class AutoFlight:
    """Flight along a path at constant speed, with a pause at each stop before a fork.

    Parameters
    ----------
    path
        Flight path; the flight stops at its look-outs.
    speed_mm_s
        Speed, 0.1 to 500 mm/s.
    pause_s
        Pause at each look-out and at the end, 0 to 60 s.

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

    @check_arguments(
        path=instance(FlightPath, "create a carina.FlightPath from a route"),
        speed_mm_s=any_number(),
        pause_s=any_number(),
    )
    def __init__(self, path: FlightPath, *, speed_mm_s: float = 20.0, pause_s: float = 1.0) -> None:
        if not (0.1 <= speed_mm_s <= 500.0 and 0.0 <= pause_s <= 60.0):
            raise UsageError(
                f"a flight must have a speed of 0.1 to 500 mm/s and pauses of 0 to 60 s; found {speed_mm_s:g} mm/s "
                f"and {pause_s:g} s"
            )
        self._path = path
        stops = [mm for mm in path.lookouts_mm if 0.0 < mm < path.length_mm]
        # Knots of the flight: it moves at constant speed from each time and position to the next.
        times, places, now_s = [0.0], [0.0], 0.0
        for stop_mm in [*stops, path.length_mm]:
            now_s += (stop_mm - places[-1]) / speed_mm_s
            times.append(now_s)
            places.append(stop_mm)
            now_s += pause_s
            times.append(now_s)
            places.append(stop_mm)
        self._times, self._places = np.array(times), np.array(places)

    def __repr__(self) -> str:
        """Return a one-line description of this `AutoFlight` for the Python interpreter."""
        return f"AutoFlight({self._path!r}, {self.duration_s:.1f} s)"

    @property
    def duration_s(self) -> float:
        """Time from the start of the path to the end of the last pause, s."""
        return float(self._times[-1])

    @check_arguments(time_s=number_from(-1e9, 1e9, unit="s"))
    def path_mm(self, time_s: float) -> float:
        """Return the position along the path (mm) at a time; clamped to the ends."""
        return float(np.interp(time_s, self._times, self._places))

    @check_arguments(time_s=number_from(-1e9, 1e9, unit="s"))
    def pose_at(self, time_s: float) -> Pose:
        """Return the pose of the camera at a time of the flight, in seconds from its start."""
        return self._path.pose_at(self.path_mm(time_s))


def frame_times_s(duration_s: float, rate_hz: float) -> NDArray[np.float64]:
    """Return the times of a video's frames: at least one, the first at 0, together as long as the flight.

    Raises
    ------
    UsageError
        If the flight lasts longer than a day.
    """
    return np.arange(num_frames(duration_s, rate_hz)) / rate_hz


def num_frames(duration_s: float, rate_hz: float) -> int:
    """Return the number of frames of a video of a flight, at least one.

    Raises
    ------
    UsageError
        If the flight lasts longer than a day.
    """
    check_duration(duration_s)
    return max(1, math.floor(duration_s * rate_hz + 0.5))


def check_duration(duration_s: float) -> None:
    """Raise an error if a flight lasts more than a day, because the frames of such a flight do not fit in memory."""
    if not duration_s <= MAX_DURATION_S:
        raise UsageError(
            f"a flight can last at most 24 hours ({MAX_DURATION_S:.0f} s); found {duration_s:g} s; check that the "
            "times are in seconds"
        )
