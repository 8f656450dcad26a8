"""What an input device says, and which of it is let through to the tip of the scope."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from msgspec.structs import replace

from carina.commands.value import FrozenValue
from carina.display import as_words

__all__ = ["AxesSample", "HandleSample", "PoseSample", "Refusal", "Sample", "SampleGate"]

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
"""That are told apart at once; nobody has so many, but names come from outside."""
MAX_NAMED = 3
OTHERS = "other devices"
# A finger's tremor and a stick's rest: below it a stick is let go.
REST = 1e-3


class DeviceSample(FrozenValue, frozen=True, tag_field="kind"):
    """What a device says at a moment.

    Parameters
    ----------
    time_s
        The device's clock, or the moment of arrival where it has none; monotonic.
    """

    time_s: float


class PoseSample(DeviceSample, frozen=True, tag="pose"):
    """Where a tracked pen is, in the tracker's own space.

    Parameters
    ----------
    position_mm
        mm in tracker space; None for a device that knows only how it is turned (a phone).
    orientation_wxyz
        ``tracker_from_pen``, wxyz, any length but 0. The pen's axes are the camera's: +x right, +y down, +z forward.
    buttons
        Bit n is button n.
    advance
        How far its forward key or stick is pushed, -1 (back) to 1 of full speed; of devices that cannot be carried
        along an airway, such as a phone.
    """

    position_mm: Vec3 | None
    orientation_wxyz: Wxyz
    buttons: int = 0
    advance: float = 0.0


class AxesSample(DeviceSample, frozen=True, tag="axes"):
    """How far sticks and caps are pushed.

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
    """The three controls of a scope handle (``docs/scope-handle.md``).

    Parameters
    ----------
    insertion_mm
        How far the shaft is in, from an origin of the device's own.
    roll_rad
        Clockwise as the operator sees it.
    lever
        -1 to 1 of its way; 1 is fully down, which bends the tip up.
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
    """The sample with a quaternion of unit length, or why it cannot be used."""
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
            # Largest first: squares of 1e200 are not finite, and of 1e-200 vanish.
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


def _at_rest(sample: Sample) -> bool:
    return isinstance(sample, AxesSample) and sample.buttons == 0 and max(abs(v) for v in sample.axes) < REST


@dataclass(slots=True)
class _Seen:
    """What the gate knows of one device."""

    last_s: float | None = None
    """Device clock of the last sample let through."""
    backwards_since_s: float | None = None
    arrived_s: float = -math.inf
    rests: bool = True
    """Whether the last sample let through asked for nothing."""
    num_used: int = 0
    ignored: Counter[Refusal] = field(default_factory=Counter)


class SampleGate:
    """Lets through samples that are numbers, in order, not too many, and of one device at a time.

    Bad samples are ignored and counted; about all of them together there is one message in ten seconds at most. Pure:
    the moment of arrival is passed in.

    Parameters
    ----------
    min_interval_s
        Samples nearer in time to the last one used are too many: at 2,000 a second each next one says nothing new.
    silence_s
        A device that was silent for so long lets go of the scope, and its place to another one where all
        :data:`MAX_DEVICES` are taken; a clock that is behind for so long has been set back.
    message_every_s
        The least time between two messages.
    """

    def __init__(
        self, *, min_interval_s: float = 0.0005, silence_s: float = 0.5, message_every_s: float = 10.0
    ) -> None:
        self._min_interval_s = min_interval_s
        self._silence_s = silence_s
        self._message_every_s = message_every_s
        self._seen: dict[str, _Seen] = {}
        self._holder: str | None = None
        self._message_s = -math.inf
        self._unsaid: Counter[tuple[str, Refusal]] = Counter()

    def __repr__(self) -> str:
        held = "free" if self._holder is None else f"held by {as_words(self._holder)}"
        return f"SampleGate({len(self._seen)} devices, {held})"

    @property
    def holder(self) -> str | None:
        """The device whose samples move the tip."""
        return self._holder

    def admit(self, device: str, sample: Sample, now_s: float) -> Sample | None:
        """The sample as it may be used (its quaternion of unit length), or None where it is ignored.

        Parameters
        ----------
        device
            Any name that tells devices apart.
        sample
            What it says.
        now_s
            When it arrived, monotonic.
        """
        holder = self._holder
        if holder is not None and self._seen[holder].arrived_s == math.inf:
            self._seen[holder].arrived_s = now_s
        seen = self._seen.get(device)
        if seen is None:
            if not self._make_room(now_s):
                self._note(OTHERS, "too many devices")
                return None
            seen = self._seen[device] = _Seen()
        checked = _checked(sample)
        refusal = checked if isinstance(checked, str) else self._refusal(device, seen, checked, now_s)
        if refusal is not None:
            seen.ignored[refusal] += 1
            self._note(device, refusal)
            return None
        assert not isinstance(checked, str)
        seen.last_s, seen.backwards_since_s, seen.arrived_s = checked.time_s, None, now_s
        seen.num_used += 1
        seen.rests = _at_rest(checked)
        if not seen.rests:
            self._holder = device
        elif self._holder == device:
            self._holder = None
        return checked

    def take(self, device: str) -> None:
        """Give the scope to a device, whoever holds it; if it stays silent, for as long as any other holds it."""
        if device not in self._seen:
            self._make_room(math.inf)
            self._seen[device] = _Seen()
        before = self._holder
        if before is not None and self._seen[before].arrived_s == math.inf:
            self._seen[before].arrived_s = -math.inf  # it said nothing
        self._holder = device
        # Of now, which the next sample says, be it another device's: a move that is recorded holds no time of its own.
        self._seen[device].arrived_s = math.inf

    def knows(self, device: str) -> bool:
        """Whether the device is one of those told apart."""
        return device in self._seen

    def gone(self, device: str) -> None:
        """A device was unplugged; it may come back with any clock."""
        seen = self._seen.get(device)
        if seen is not None:
            seen.last_s = seen.backwards_since_s = None
            seen.arrived_s = -math.inf
        if self._holder == device:
            self._holder = None

    def num_used(self, device: str) -> int:
        """Samples of a device that were let through."""
        return self._seen[device].num_used if device in self._seen else 0

    def num_ignored(self, device: str) -> dict[Refusal, int]:
        """Samples of a device that were ignored, by reason."""
        return dict(self._seen[device].ignored) if device in self._seen else {}

    def take_message(self, now_s: float) -> str | None:
        """One sentence about all that was ignored since the last one, or None."""
        if not self._unsaid or now_s - self._message_s < self._message_every_s:
            return None
        self._message_s = now_s
        whys: Counter[Refusal] = Counter()
        for (_, why), num in self._unsaid.items():
            whys[why] += num
        words = [f"{why} ({num})" for why, num in whys.most_common(3)]
        names = sorted({device for device, _ in self._unsaid})
        devices = ", ".join(names[:MAX_NAMED]) + (f" and {len(names) - MAX_NAMED} more" if names[MAX_NAMED:] else "")
        total = self._unsaid.total()
        self._unsaid.clear()
        samples, were = ("sample", "was") if total == 1 else ("samples", "were")
        return f"{total} {samples} from {devices} {were} ignored: {', '.join(words)}"

    def _note(self, device: str, why: Refusal) -> None:
        # Devices may come and go many times between two messages.
        if (device, why) not in self._unsaid and len(self._unsaid) >= MAX_DEVICES:
            device = OTHERS
        self._unsaid[device, why] += 1

    def _make_room(self, now_s: float) -> bool:
        """For one more device: the one that was silent the longest goes, if it is silent at all."""
        if len(self._seen) < MAX_DEVICES:
            return True
        longest = min((d for d in self._seen if d != self._holder), key=lambda d: self._seen[d].arrived_s)
        if now_s - self._seen[longest].arrived_s < self._silence_s:
            return False
        del self._seen[longest]
        return True

    def _refusal(self, device: str, seen: _Seen, sample: Sample, now_s: float) -> Refusal | None:
        if seen.last_s is not None:
            passed_s = sample.time_s - seen.last_s
            if passed_s < 0.0:
                if seen.backwards_since_s is None:
                    seen.backwards_since_s = now_s
                if now_s - seen.backwards_since_s < self._silence_s:
                    return "timestamps that run backwards"
            # A stick that is let go says so once: it must not fly on. What follows it as fast is too much again.
            elif passed_s < self._min_interval_s and (seen.rests or not _at_rest(sample)):
                return "too many samples"
        holder = self._holder
        if holder is not None and holder != device and now_s - self._seen[holder].arrived_s < self._silence_s:
            # A stick that is let go asks for nothing.
            return None if _at_rest(sample) else "another device is moving the scope"
        return None
