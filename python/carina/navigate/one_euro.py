"""One-euro filter of a hand's movement: strong smoothing at rest, short delay during movement."""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from carina.commands import DeviceControls, checked
from carina.navigate.rotation import rotation_from_vector, rotation_from_wxyz, vector_from_rotation, wxyz_from_rotation
from carina.navigate.samples import HandleSample, PoseSample, Sample

# Gap between two samples, in seconds, after which the filter starts again.
MAX_GAP_S = 0.25
# Weight of a radian of roll and of half the lever's range, in mm of shaft, so that hand movements have similar size.
HANDLE_MM = 50.0


def filter_latency_ms(controls: DeviceControls) -> float:
    """Return the filter's maximum delay in ms, which is the delay at rest.

    A low-pass of cut-off frequency fc delays slow movements by 1 / (2 pi fc), and by less while the hand moves, since
    fc grows with speed.

    Examples
    --------
    >>> round(filter_latency_ms(DeviceControls()), 1)
    8.0
    """
    return 1000.0 * _time_constant_s(controls.min_cutoff_hz) if controls.filter_on else 0.0


class SampleFilter:
    """One-euro filter of one device: position and orientation of a pen, or the controls of a handle.

    Samples of sticks are not changed.

    Parameters
    ----------
    settings
        Cut-off frequencies and betas of the device; without ``filter_on`` samples are not changed.

    Raises
    ------
    UsageError
        ``command.bounds``: if a number is out of range.

    References
    ----------
    Casiez, Roussel, Vogel, "1 euro filter: a simple speed-based low-pass filter for noisy input", CHI 2012.
    """

    def __init__(self, settings: DeviceControls) -> None:
        self._settings = checked(settings)
        self._last: Sample | None = None
        self._raw: NDArray[np.float64] = np.zeros(0)
        self._raw_turn = np.eye(3)
        self._filtered: NDArray[np.float64] = np.zeros(0)
        self._speed: NDArray[np.float64] = np.zeros(0)
        self._turn = np.eye(3)
        self._turning: NDArray[np.float64] = np.zeros(3)
        self._latency_s = 0.0

    def __repr__(self) -> str:
        """Return a one-line description of this `SampleFilter` for the Python interpreter."""
        return f"SampleFilter({self._settings!r})"

    @property
    def latency_ms(self) -> float:
        """Delay of the last sample in ms: the longer of the delays of position and orientation."""
        return 1000.0 * self._latency_s

    def apply(self, sample: Sample) -> Sample:
        """Return the smoothed sample; the first sample, and the first after a gap, is returned unchanged."""
        last, self._last = self._last, sample
        values = _values(sample)
        if not self._settings.filter_on or values is None:
            self._latency_s = 0.0
            return sample
        turn = rotation_from_wxyz(sample.orientation_wxyz) if isinstance(sample, PoseSample) else None
        passed_s = math.inf if last is None else sample.time_s - last.time_s
        if not 0.0 <= passed_s <= MAX_GAP_S or len(values) != len(self._filtered):
            self._filtered, self._speed, self._turning = values, np.zeros(len(values)), np.zeros(3)
            self._turn = np.eye(3) if turn is None else turn
            self._raw, self._raw_turn = self._filtered, self._turn
            self._latency_s = 0.0
            return sample
        if passed_s == 0.0:
            return self._filtered_sample(sample)
        self._latency_s = max(
            self._filter_values(values, passed_s), 0.0 if turn is None else self._filter_rotation(turn, passed_s)
        )
        return self._filtered_sample(sample)

    def _filter_values(self, values: NDArray[np.float64], passed_s: float) -> float:
        if len(values) == 0:
            return 0.0
        s = self._settings
        # Speed of the raw samples: relative to the smoothed values, the lag would count as speed.
        speed, self._raw = (values - self._raw) / passed_s, values
        self._speed = self._speed + _share(s.derivative_cutoff_hz, passed_s) * (speed - self._speed)
        cutoff_hz = s.min_cutoff_hz + s.beta_per_mm * float(np.linalg.norm(self._speed))
        self._filtered = self._filtered + _share(cutoff_hz, passed_s) * (values - self._filtered)
        return _time_constant_s(cutoff_hz)

    def _filter_rotation(self, turn: NDArray[np.float64], passed_s: float) -> float:
        s = self._settings
        turning, self._raw_turn = vector_from_rotation(self._raw_turn.T @ turn) / passed_s, turn
        self._turning = self._turning + _share(s.derivative_cutoff_hz, passed_s) * (turning - self._turning)
        away = vector_from_rotation(self._turn.T @ turn)
        cutoff_hz = s.min_cutoff_hz + s.beta_per_rad * float(np.linalg.norm(self._turning))
        # A fraction of the rotation between both orientations, which equals slerp.
        self._turn = self._turn @ rotation_from_vector(_share(cutoff_hz, passed_s) * away)
        return _time_constant_s(cutoff_hz)

    def _filtered_sample(self, sample: Sample) -> Sample:
        filtered = [float(v) for v in self._filtered]
        match sample:
            case PoseSample():
                self._turn = rotation_from_wxyz(wxyz_from_rotation(self._turn))
                at = None if sample.position_mm is None else (filtered[0], filtered[1], filtered[2])
                return replace(sample, position_mm=at, orientation_wxyz=wxyz_from_rotation(self._turn))
            case HandleSample():
                return replace(
                    sample, insertion_mm=filtered[0], roll_rad=filtered[1] / HANDLE_MM, lever=filtered[2] / HANDLE_MM
                )
            case _:
                return sample


def _values(sample: Sample) -> NDArray[np.float64] | None:
    """Return the quantities of a sample that the filter smooths, scaled to mm.

    None for sticks, which need no smoothing.
    """
    match sample:
        case PoseSample():
            return np.zeros(0) if sample.position_mm is None else np.array(sample.position_mm, dtype=np.float64)
        case HandleSample():
            return np.array([sample.insertion_mm, HANDLE_MM * sample.roll_rad, HANDLE_MM * sample.lever])
        case _:
            return None


def _time_constant_s(cutoff_hz: float) -> float:
    return 1.0 / (2.0 * math.pi * cutoff_hz)


def _share(cutoff_hz: float, passed_s: float) -> float:
    """Return the weight of the newest value in exponential smoothing with this cut-off frequency and time step."""
    return 1.0 / (1.0 + _time_constant_s(cutoff_hz) / passed_s)
