"""Samples of input devices, and the gate that decides which samples move the scope's tip."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from msgspec.structs import replace

from carina.commands.value import FrozenValue
from carina.display import as_words

Vec3 = tuple[float, float, float]
Wxyz = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]

Refusal = Literal[
    "non-finite numbers",
    "an orientation of length 0",
    "numbers out of range",
    "timestamps that run backwards",
    "too many samples",
    "another device is moving the scope",
    "too many devices",
]

MAX_MM = 1e5
MAX_BUTTONS = 32
MAX_DEVICES = 64
"""Maximum number of devices that are tracked at once, because other programs choose device names."""
MAX_NAMED = 3
OTHERS = "other devices"
# Deflection below which a stick counts as released: tremor of a finger and offset of a stick.
REST = 1e-3


class DeviceSample(FrozenValue, frozen=True, tag_field="kind"):
    """Sample of an input device at a moment.

    Parameters
    ----------
    time_s
        Time of the device's clock, or the time of arrival if it has none; monotonic.
    """

    time_s: float


class PoseSample(DeviceSample, frozen=True, tag="pose"):
    """Pose of a tracked pen, in the tracker's own space.

    Parameters
    ----------
    position_mm
        mm in tracker space; None for a device that knows only its orientation (a phone).
    orientation_wxyz
        ``tracker_from_pen``, wxyz, any length but 0. The pen's axes are the camera's: +x right, +y down, +z forward.
    buttons
        Bit n is button n.
    advance
        Deflection of the forward key or stick, -1 (back) to 1 of full speed, of devices that cannot be moved along an
        airway, such as a phone.
    """

    position_mm: Vec3 | None
    orientation_wxyz: Wxyz
    buttons: int = 0
    advance: float = 0.0


class AxesSample(DeviceSample, frozen=True, tag="axes"):
    """Sample of a device with sticks or caps: their deflections.

    Parameters
    ----------
    axes
        Forward, to the right, up, then yaw to the right, pitch up, roll clockwise; each -1 to 1 of full speed.
    buttons
        Bit n is button n.
    """

    axes: Six
    buttons: int = 0


class HandleSample(DeviceSample, frozen=True, tag="handle"):
    """Controls of a scope handle (``docs/scope-handle.md``).

    Parameters
    ----------
    insertion_mm
        Insertion of the shaft from the device's own origin.
    roll_rad
        Clockwise as the operator sees it.
    lever
        -1 to 1 of its range; 1 is fully down, which bends the tip up.
    buttons
        Bit n is button n.
    """

    insertion_mm: float
    roll_rad: float
    lever: float
    buttons: int = 0


Sample: TypeAlias = PoseSample | AxesSample | HandleSample


def _numbers(sample: Sample) -> tuple[float, ...]:
    match sample:
        case PoseSample():
            return (sample.time_s, *(sample.position_mm or ()), *sample.orientation_wxyz, sample.advance)
        case AxesSample():
            return (sample.time_s, *sample.axes)
        case HandleSample():
            return (sample.time_s, sample.insertion_mm, sample.roll_rad, sample.lever)


def _checked(sample: Sample) -> Sample | Refusal:
    """Return a sample with its quaternion scaled to unit length, or the reason why the sample is invalid."""
    if not all(math.isfinite(v) for v in _numbers(sample)):
        return "non-finite numbers"
    if not 0 <= sample.buttons < 1 << MAX_BUTTONS:
        return "numbers out of range"
    match sample:
        case PoseSample():
            if sample.position_mm is not None and max(abs(v) for v in sample.position_mm) > MAX_MM:
                return "numbers out of range"
            if abs(sample.advance) > 1.0 + REST:
                return "numbers out of range"
            # Division by the largest component first: squares of 1e200 overflow, and squares of 1e-200 vanish.
            largest = max(abs(v) for v in sample.orientation_wxyz)
            if largest < 1e-6:
                return "an orientation of length 0"
            scaled = [v / largest for v in sample.orientation_wxyz]
            length = math.sqrt(sum(v * v for v in scaled))
            w, x, y, z = (v / length for v in scaled)
            return replace(sample, orientation_wxyz=(w, x, y, z))
        case AxesSample():
            if len(sample.axes) != 6 or max(abs(v) for v in sample.axes) > 1.0 + REST:
                return "numbers out of range"
        case HandleSample():
            if abs(sample.insertion_mm) > MAX_MM or abs(sample.roll_rad) > 1e4 or abs(sample.lever) > 1.0 + REST:
                return "numbers out of range"
    return sample


def _is_at_rest(sample: Sample) -> bool:
    return isinstance(sample, AxesSample) and sample.buttons == 0 and max(abs(v) for v in sample.axes) < REST


@dataclass(slots=True)
class _DeviceRecord:
    """State of one device, from which the next sample of the device is accepted or rejected."""

    last_s: float | None = None
    """Time in the device's clock of its last accepted sample, s; None before the first."""
    backwards_since_s: float | None = None
    arrived_s: float = -math.inf
    rests: bool = True
    """Whether the last accepted sample requested no movement."""
    num_used: int = 0
    ignored: Counter[Refusal] = field(default_factory=Counter)


class SampleGate:
    """Gate that admits valid samples in order, at a limited rate, and from one device at a time.

    Invalid samples are ignored and counted; one message in ten seconds at most reports all of them. The gate reads no
    clock: the time of arrival is an argument.

    Parameters
    ----------
    min_interval_s
        Shortest time between two admitted samples; a sample that follows sooner is ignored. At 2,000 samples a
        second the next sample adds no information.
    silence_s
        Time without samples after which a device no longer holds the scope, after which another device may replace it
        if all :data:`MAX_DEVICES` places are taken, and after which a clock that runs behind counts as set back.
    message_every_s
        Shortest time between two messages.
    """

    def __init__(
        self, *, min_interval_s: float = 0.0005, silence_s: float = 0.5, message_every_s: float = 10.0
    ) -> None:
        self._min_interval_s = min_interval_s
        self._silence_s = silence_s
        self._message_every_s = message_every_s
        self._seen: dict[str, _DeviceRecord] = {}
        self._holder: str | None = None
        self._message_s = -math.inf
        self._unreported: Counter[tuple[str, Refusal]] = Counter()

    def __repr__(self) -> str:
        """Return a one-line description of this `SampleGate` for the Python interpreter."""
        held = "free" if self._holder is None else f"held by {as_words(self._holder)}"
        return f"SampleGate({len(self._seen)} devices, {held})"

    @property
    def holder(self) -> str | None:
        """Name of the device whose samples move the tip; None if no device does."""
        return self._holder

    def admit(self, device: str, sample: Sample, now_s: float) -> Sample | None:
        """Return the sample in valid form (its quaternion of unit length), or None if the sample is ignored.

        Parameters
        ----------
        device
            Name that identifies the device.
        sample
            Sample of the device.
        now_s
            Time of arrival, monotonic.
        """
        holder = self._holder
        if holder is not None and self._seen[holder].arrived_s == math.inf:
            self._seen[holder].arrived_s = now_s
        seen = self._seen.get(device)
        if seen is None:
            if not self._drop_silent_device(now_s):
                self._count_ignored(OTHERS, "too many devices")
                return None
            seen = self._seen[device] = _DeviceRecord()
        checked = _checked(sample)
        refusal = checked if isinstance(checked, str) else self._refusal(device, seen, checked, now_s)
        if refusal is not None:
            seen.ignored[refusal] += 1
            self._count_ignored(device, refusal)
            return None
        assert not isinstance(checked, str)
        seen.last_s, seen.backwards_since_s, seen.arrived_s = checked.time_s, None, now_s
        seen.num_used += 1
        seen.rests = _is_at_rest(checked)
        if not seen.rests:
            self._holder = device
        elif self._holder == device:
            self._holder = None
        return checked

    def take(self, device: str) -> None:
        """Select the device that may move the scope.

        If the device stays silent, it keeps the scope as long as any other holder would.
        """
        if device not in self._seen:
            self._drop_silent_device(math.inf)
            self._seen[device] = _DeviceRecord()
        before = self._holder
        if before is not None and self._seen[before].arrived_s == math.inf:
            self._seen[before].arrived_s = -math.inf  # A device that has sent no sample counts as silent.
        self._holder = device
        # The arrival time is set by the next sample of any device: a recorded move contains no time.
        self._seen[device].arrived_s = math.inf

    def has_device(self, device: str) -> bool:
        """Return whether the gate stores a state for the device."""
        return device in self._seen

    def reset_device(self, device: str) -> None:
        """Reset the state of a disconnected device, which may return with any clock, and release the scope from it."""
        seen = self._seen.get(device)
        if seen is not None:
            seen.last_s = seen.backwards_since_s = None
            seen.arrived_s = -math.inf
        if self._holder == device:
            self._holder = None

    def num_used(self, device: str) -> int:
        """Return the number of admitted samples of a device."""
        return self._seen[device].num_used if device in self._seen else 0

    def num_ignored(self, device: str) -> dict[Refusal, int]:
        """Return the number of ignored samples of a device, by reason."""
        return dict(self._seen[device].ignored) if device in self._seen else {}

    def take_message(self, now_s: float) -> str | None:
        """Return one sentence about all samples that were ignored since the last message.

        None if there is nothing to report.
        """
        if not self._unreported or now_s - self._message_s < self._message_every_s:
            return None
        self._message_s = now_s
        whys: Counter[Refusal] = Counter()
        for (_, why), num in self._unreported.items():
            whys[why] += num
        words = [f"{why} ({num})" for why, num in whys.most_common(3)]
        names = sorted({device for device, _ in self._unreported})
        devices = ", ".join(names[:MAX_NAMED]) + (f" and {len(names) - MAX_NAMED} more" if names[MAX_NAMED:] else "")
        total = self._unreported.total()
        self._unreported.clear()
        samples, were = ("sample", "was") if total == 1 else ("samples", "were")
        return f"{total} {samples} from {devices} {were} ignored: {', '.join(words)}"

    def _count_ignored(self, device: str, why: Refusal) -> None:
        # The number of entries is bounded, because devices can come and go many times between two messages.
        if (device, why) not in self._unreported and len(self._unreported) >= MAX_DEVICES:
            device = OTHERS
        self._unreported[device, why] += 1

    def _drop_silent_device(self, now_s: float) -> bool:
        """Remove the device that has been silent the longest and return True; return False if no device was silent."""
        if len(self._seen) < MAX_DEVICES:
            return True
        longest = min((d for d in self._seen if d != self._holder), key=lambda d: self._seen[d].arrived_s)
        if now_s - self._seen[longest].arrived_s < self._silence_s:
            return False
        del self._seen[longest]
        return True

    def _refusal(self, device: str, seen: _DeviceRecord, sample: Sample, now_s: float) -> Refusal | None:
        if seen.last_s is not None:
            passed_s = sample.time_s - seen.last_s
            if passed_s < 0.0:
                if seen.backwards_since_s is None:
                    seen.backwards_since_s = now_s
                if now_s - seen.backwards_since_s < self._silence_s:
                    return "timestamps that run backwards"
            # The first sample of a released stick is admitted at any rate, or the tip would fly on.
            elif passed_s < self._min_interval_s and (seen.rests or not _is_at_rest(sample)):
                return "too many samples"
        holder = self._holder
        if holder is not None and holder != device and now_s - self._seen[holder].arrived_s < self._silence_s:
            # A released stick requests no movement, so its sample is admitted.
            return None if _is_at_rest(sample) else "another device is moving the scope"
        return None
