"""Choice, from measured times, of the lanes (connections to renderers) in use and of the number of open frames.

Each strip costs the console a fixed time, so that more lanes make a fast frame slower. The choice measures the time of
a frame with the lanes in use, tries another number of lanes for a few frames, and uses the better number. The choice
has no clock: every event contains its time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

Lane = Hashable

SETTLING_FRAMES = 5
"""Number of frames after a change of the lanes whose times are ignored, because the lanes' shares still change."""
MEASURED_FRAMES = 10
"""Number of frames with each selection of lanes over which the mean time is computed."""
GAIN_OF_MORE_LANES = 0.05
"""Minimum share of a frame's time that more lanes must save to be used."""
LOSS_BY_FEWER_LANES = 0.01
"""Maximum share of a frame's time that fewer lanes may add; its difference to :data:`GAIN_OF_MORE_LANES` is a
hysteresis."""
LOSS_BY_FEWER_FRAMES = 0.05
"""Maximum share of a frame's time that fewer open frames may add; fewer open frames shorten the response time."""
GAIN_OF_MORE_FRAMES = 0.07
"""Minimum share of a frame's time that more open frames must save to be used."""
RETRY_S = 4.0
"""Time in seconds after which a rejected number of lanes or frames is tried again; it doubles with each rejection."""
MAX_RETRY_S = 120.0
FULLY_BUSY_S, FULLY_BUSY_RETRY_S = 10.0, 60.0
"""Times in seconds before fewer lanes are tried for the first time, and again, while all lanes are busy.

Lanes that share a processor are busy all the time and render no more than one of them.
"""
MAX_FULLY_BUSY_RETRY_S = 960.0
ABORT_FRAMES = 3
ABORT_LOSS = 0.25
"""Increase of a frame's time, as a share, that ends a trial early if each of its first :data:`ABORT_FRAMES` frames
shows it."""
SLOW_S = 0.05
"""Rendering time of a frame in seconds from which the number of open frames is the minimum."""
FAST_S = 0.04
"""Rendering time of a frame in seconds below which frames that were slow count as normal again."""
CHANGED_WORK = 1.5
"""Ratio of the present to the former rendering time of a frame from which former results are discarded."""


@dataclass(frozen=True, slots=True)
class LanePlan:
    """Number of lanes that render a frame, and of frames that are open at once."""

    num_lanes: int
    open_frames: int


@dataclass(slots=True)
class _Rejection:
    """Plan that was slower in a trial than the plan in use, and the time of its next trial."""

    expires_s: float
    retry_s: float


class LaneChoice:
    """Selected lanes and number of open frames for all frames of one kind.

    Parameters
    ----------
    max_open_frames
        Largest number of open frames.
    """

    def __init__(self, max_open_frames: int) -> None:
        self._max_open = max_open_frames
        self.number = 0
        """Number of the present plan; a frame is measured only if it was opened with the present plan."""
        self._able: tuple[Lane, ...] = ()
        self._used: list[Lane] = []
        self._plan = LanePlan(1, max_open_frames)
        self._num_tried = 0
        self._min_tried_s = math.inf
        """Number of frames of the trial, including those whose time is ignored, and their shortest time in seconds."""
        self._before: tuple[LanePlan, list[Lane], float] | None = None
        """During a trial: the plan, the lanes and the time of a frame before the trial."""
        self._skip = SETTLING_FRAMES
        self._intervals: deque[float] = deque(maxlen=MEASURED_FRAMES)
        self._works: deque[float] = deque(maxlen=MEASURED_FRAMES)
        self._work_s: float | None = None
        self._known_work_s: float | None = None
        self._slow = False
        self._rejected: dict[LanePlan, _Rejection] = {}
        self._since_s = -math.inf
        """Instant in seconds from which the present plan has been in use; trials of other plans move it on by their
        duration."""
        self._is_doubtful = False
        """Whether the trial has fewer lanes than the average number of busy lanes."""

    @property
    def open_frames(self) -> int:
        """Largest number of open frames."""
        if not self._slow:
            return self._max_open
        # A second frame would only wait in a single slow lane and become outdated.
        return 1 if len(self._able) == 1 or self._plan.num_lanes == 1 else self._plan.open_frames

    @property
    def used(self) -> tuple[Lane, ...]:
        """Lanes that are used at present."""
        return tuple(self._used)

    @property
    def is_trial(self) -> bool:
        """Whether the present plan is a trial, in use for a few frames only."""
        return self._before is not None

    def choose(self, able: Sequence[Lane], seconds: Mapping[Lane, float], now_s: float) -> tuple[Lane, ...]:
        """Return those of the lanes ``able`` that render the next frame, in the same order.

        Parameters
        ----------
        able
            Lanes that can render the frame, at least one.
        seconds
            Time in seconds in which each measured lane would render the frame alone; the fastest lanes are used.
        now_s
            Current time in seconds.
        """
        if set(able) != set(self._able):
            self._update_lanes(able, now_s)
        self._able = tuple(able)
        num = self._plan.num_lanes
        while len(self._used) > num:
            self._used.remove(max(self._used, key=lambda lane: seconds.get(lane, 0.0)))
        unused = [lane for lane in able if lane not in self._used]
        while len(self._used) < num:
            # A lane without a measurement comes first, so that it is measured.
            lane = min(unused, key=lambda lane: seconds.get(lane, -1.0))
            unused.remove(lane)
            self._used.append(lane)
        return tuple(lane for lane in able if lane in self._used)

    def record_frame(self, number: int, interval_s: float, work_s: float, now_s: float) -> None:
        """Record the times of a complete frame; the plan of lanes may change for the next frame.

        Parameters
        ----------
        number
            Value of :attr:`number` when the frame was opened.
        interval_s
            Time in seconds since the frame was opened, or since the frame before it was complete, if that was later.
        work_s
            Sum of the rendering times of the frame's strips in seconds.
        now_s
            Current time in seconds.
        """
        self._update_work(work_s, now_s)
        if number != self.number:
            return
        if self._before is not None:
            self._num_tried += 1
            self._min_tried_s = min(self._min_tried_s, interval_s)
            if self._is_clearly_slower(self._before[0], self._before[2]):
                self._reject_trial(now_s)
                return
        if self._skip > 0:
            self._skip -= 1
            return
        self._intervals.append(interval_s)
        self._works.append(work_s)
        if len(self._intervals) < MEASURED_FRAMES:
            return
        if self._before is not None:
            self._end_trial(now_s)
        else:
            self._forget_other_work(sum(self._works) / len(self._works))
            trial = self._next_trial(now_s)
            if trial is not None:
                self._start_trial(trial, now_s)

    def _update_work(self, work_s: float, now_s: float) -> None:
        """Update the smoothed rendering time of a frame, and whether frames are slow."""
        self._work_s = work_s if self._work_s is None else self._work_s + 0.3 * (work_s - self._work_s)
        slow = self._work_s >= (FAST_S if self._slow else SLOW_S)
        if slow != self._slow:
            self._slow = slow
            self._cancel_trial(now_s)
            self._rejected.clear()
            self._set_plan(LanePlan(self._plan.num_lanes, min(2, self._max_open) if slow else self._max_open), now_s)

    def _forget_other_work(self, work_s: float) -> None:
        """Discard former results if frames have become slower or faster by more than :data:`CHANGED_WORK`."""
        known_s = self._known_work_s
        if known_s is None:
            self._known_work_s = work_s
        elif not known_s / CHANGED_WORK <= work_s <= known_s * CHANGED_WORK:
            self._known_work_s = work_s
            self._rejected.clear()

    def _update_lanes(self, able: Sequence[Lane], now_s: float) -> None:
        """Adapt the plan to lanes that have joined or left."""
        new = [lane for lane in able if lane not in self._able]
        self._cancel_trial(now_s)
        self._used = [lane for lane in self._used if lane in able]
        num = self._plan.num_lanes
        measured = len(self._intervals) == MEASURED_FRAMES and len(self._used) == num
        used_all = num >= len(self._able)
        if new:
            self._rejected = {plan: found for plan, found in self._rejected.items() if plan.num_lanes < num}
        if new and measured:
            self._start_trial(LanePlan(min(len(able), num + len(new)), self._plan.open_frames), now_s)
        elif new and used_all:
            self._set_plan(LanePlan(len(able), self._plan.open_frames), now_s)
        else:
            self._set_plan(LanePlan(min(num, len(able)), self._plan.open_frames), now_s)

    def _next_trial(self, now_s: float) -> LanePlan | None:
        """Return the next plan to try; None if no other plan is due for a trial."""
        plan, num = self._plan, self._plan.num_lanes
        options = [
            LanePlan(count, plan.open_frames) for count in (self._fewer_lanes(now_s), self._more_lanes(now_s)) if count
        ]
        if self._slow and num > 1:
            if plan.open_frames > 1:
                options.insert(0, LanePlan(num, plan.open_frames - 1))
            if plan.open_frames < self._max_open:
                options.append(LanePlan(num, plan.open_frames + 1))
        return next((option for option in options if not self._is_rejected(option, now_s)), None)

    def _fewer_lanes(self, now_s: float) -> int | None:
        """Return the next smaller number of lanes to try."""
        num = self._plan.num_lanes
        if num == 1:
            return None
        busy = sum(self._works) / max(sum(self._intervals), 1e-9)
        # Fewer lanes than are busy on average cannot do the same work.
        least = max(1, math.ceil(busy * (1.0 - LOSS_BY_FEWER_LANES)))
        too_few = max((n for n in self._rejected_counts(now_s) if n < num), default=0)
        count = (too_few + num) // 2 if too_few else min(num // 2, math.ceil(2.0 * busy))
        count = max(count, least)
        if too_few < count < num:
            return count
        if too_few < num - 1 and now_s >= self._since_s + FULLY_BUSY_S:
            return num - 1
        return None

    def _more_lanes(self, now_s: float) -> int | None:
        """Return the next larger number of lanes to try."""
        num, most = self._plan.num_lanes, len(self._able)
        too_many = min((n for n in self._rejected_counts(now_s) if n > num), default=None)
        if too_many is not None:
            count = (num + too_many) // 2
        else:
            busy = sum(self._works) / max(sum(self._intervals), 1e-9)
            count = min(most, 2 * num) if busy > 0.8 * num else num + 1
        return count if num < count <= most else None

    def _rejected_counts(self, now_s: float) -> list[int]:
        return [
            plan.num_lanes
            for plan, found in self._rejected.items()
            if plan.open_frames == self._plan.open_frames and now_s < found.expires_s
        ]

    def _is_rejected(self, plan: LanePlan, now_s: float) -> bool:
        found = self._rejected.get(plan)
        return found is not None and now_s < found.expires_s

    def _start_trial(self, plan: LanePlan, now_s: float) -> None:
        busy = sum(self._works) / max(sum(self._intervals), 1e-9)
        self._is_doubtful = plan.num_lanes < min(busy, self._plan.num_lanes)
        self._before = (self._plan, list(self._used), _typical(self._intervals))
        self._num_tried, self._min_tried_s = 0, math.inf
        self._set_plan(plan, now_s)

    def _end_trial(self, now_s: float) -> None:
        """Use the plan of the trial if it is better, else the plan before the trial."""
        assert self._before is not None
        before, used, before_s = self._before
        tried, tried_s = self._plan, _typical(self._intervals)
        self._before = None
        if tried.num_lanes > before.num_lanes:
            limit = 1.0 - GAIN_OF_MORE_LANES
        elif tried.num_lanes < before.num_lanes:
            limit = 1.0 + LOSS_BY_FEWER_LANES
        elif tried.open_frames > before.open_frames:
            limit = 1.0 - GAIN_OF_MORE_FRAMES
        else:
            limit = 1.0 + LOSS_BY_FEWER_FRAMES
        if tried_s <= limit * before_s:
            self._rejected.pop(tried, None)
            self._reject(before, now_s)
            self._since_s = now_s
            self._known_work_s = sum(self._works) / len(self._works)
            self._is_doubtful = False
            return
        self._before = (before, used, before_s)
        self._reject_trial(now_s)

    def _is_clearly_slower(self, before: LanePlan, before_s: float) -> bool:
        """Return whether the trial of fewer lanes or open frames is slow enough to end early."""
        fewer = self._plan.num_lanes < before.num_lanes or self._plan.open_frames < before.open_frames
        return fewer and self._num_tried >= ABORT_FRAMES and self._min_tried_s > (1.0 + ABORT_LOSS) * before_s

    def _reject_trial(self, now_s: float) -> None:
        """Return to the plan before the trial."""
        assert self._before is not None
        before, self._used, _ = self._before
        self._before = None
        self._reject(self._plan, now_s)
        self._set_plan(before, now_s, new=False)

    def _reject(self, plan: LanePlan, now_s: float) -> None:
        former = self._rejected.get(plan)
        first_s, max_s = (FULLY_BUSY_RETRY_S, MAX_FULLY_BUSY_RETRY_S) if self._is_doubtful else (RETRY_S, MAX_RETRY_S)
        retry_s = first_s if former is None else min(max(first_s, 2.0 * former.retry_s), max_s)
        self._rejected[plan] = _Rejection(now_s + retry_s, retry_s)
        self._is_doubtful = False

    def _cancel_trial(self, now_s: float) -> None:
        if self._before is not None:
            plan, used, _ = self._before
            self._before = None
            self._used = used
            self._set_plan(plan, now_s)

    def _set_plan(self, plan: LanePlan, now_s: float, *, new: bool = True) -> None:
        """Set the plan of the next frames and start its measurements."""
        self._plan = plan
        self.number += 1
        self._skip = SETTLING_FRAMES
        self._intervals.clear()
        self._works.clear()
        if new and self._before is None:
            self._since_s = now_s


def _typical(intervals: Sequence[float] | deque[float]) -> float:
    """Return the mean of intervals without the largest one, which is often caused by another program."""
    return (sum(intervals) - max(intervals)) / (len(intervals) - 1)
