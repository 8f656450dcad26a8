"""The scheduler that assigns strips to lanes and reassigns late strips (paper 5); it is driven by events.

The scheduler has no clock, thread or socket: every event contains its time, and the resulting actions are collected by
:meth:`StripScheduler.take_actions`. So the same scheduler runs a cluster, a simulation and the property tests.

Guarantees for any order of events: each row of a complete frame was answered exactly once; a lane never has more than
``in_flight`` strips; at most ``open_frames`` frames are open; a requested frame is completed, dropped on request, or
waits for a lane.
"""

from __future__ import annotations

import itertools
import statistics
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Literal

from carina.cluster.renderer_selection import LaneChoice
from carina.cluster.settings import ClusterSettings
from carina.cluster.shares import Shares
from carina.cluster.strips import cut_rows
from carina.errors import UsageError

Lane = Hashable
LaneState = Literal["ready", "late", "away"]


@dataclass(frozen=True, slots=True)
class Issue:
    """Action that the scheduler requests from the console: send a strip to a lane."""

    task_id: int
    lane: Lane
    frame_id: int
    strip: int
    first_row: int
    end_row: int
    again: bool
    """Whether the strip was sent to another lane before."""


@dataclass(frozen=True, slots=True)
class FrameDone:
    """Action that reports a complete frame: all of its rows have been accepted."""

    frame_id: int


@dataclass(frozen=True, slots=True)
class FrameDropped:
    """Action that reports a dropped frame, which will not be completed."""

    frame_id: int


@dataclass(frozen=True, slots=True)
class LaneLate:
    """Action that reports a late lane, whose strips were assigned to other lanes."""

    lane: Lane


@dataclass(frozen=True, slots=True)
class LaneBack:
    """Action that reports that a late lane has answered."""

    lane: Lane


Action = Issue | FrameDone | FrameDropped | LaneLate | LaneBack


@dataclass(frozen=True, slots=True)
class LaneView:
    """State of a lane that the user sees."""

    lane: Lane
    state: LaneState
    reserve: bool
    share: float
    """Share of the lane in the next frame, 0 to 1."""
    num_in_flight: int
    num_answers: int
    num_late: int
    row_seconds: float | None


@dataclass(slots=True)
class _Task:
    """A strip that was sent to a lane and not answered yet."""

    task_id: int
    frame_id: int
    strip: int
    num_rows: int
    cost: Hashable
    issued_s: float


@dataclass(slots=True)
class _Lane:
    """State of one lane in the scheduler."""

    reserve: bool
    content: Hashable
    order: int
    state: LaneState = "ready"
    in_flight: deque[_Task] = field(default_factory=deque)
    queue: list[tuple[int, int]] = field(default_factory=list)
    """Strips that are assigned to the lane and not sent yet, as (frame id, strip), the oldest frame first."""
    answered_s: float = float("-inf")
    pace: dict[Hashable, float] = field(default_factory=dict)
    """Smoothed rendering time per row in seconds, by the frame's ``cost``; deadlines are estimated from it."""
    render_pace: dict[Hashable, float] = field(default_factory=dict)
    """Smoothed rendering time per row in seconds that the renderer reported, by the frame's ``cost``."""
    transport_s: float = 0.0
    """Minimum, over the last strips, of the time in seconds from order to answer without the rendering."""
    measured: dict[Hashable, tuple[float, int]] = field(default_factory=dict)
    """Rendering time in seconds and number of rows since the last update of the shares, by the frame's ``cost``."""
    last_m: dict[Hashable, float] = field(default_factory=dict)
    num_answers: int = 0
    num_late: int = 0


@dataclass(slots=True)
class _Frame:
    """State of one frame that waits or is being rendered."""

    frame_id: int
    num_rows: int
    content: Hashable
    cost: Hashable
    stream: Hashable | None
    whole: bool
    max_rows: int | None
    strips: list[tuple[int, int]] = field(default_factory=list)
    missing: set[int] = field(default_factory=set)
    holders: dict[int, set[Lane]] = field(default_factory=dict)
    """Lanes to which each strip is sent or assigned, including late lanes."""
    opened_s: float = 0.0
    choice: LaneChoice | None = None
    """Selection of lanes that this frame's time updates; None if the time must not count."""
    plan_number: int = 0
    """Number of the lane plan in use when the frame was opened."""
    work_s: float = 0.0
    """Sum of the rendering times of the accepted strips in seconds."""


# Weight of a new time in the smoothed time per row: near a wall, the cost of a row changes within a few frames.
PACE_WEIGHT = 0.3
KINDS_REMEMBERED = 32
TRANSPORT_GROWTH, TRANSPORT_STEP_S = 1.05, 0.0001
"""Maximum increase of a lane's estimated transport time per strip: a factor, and seconds in addition.

A slow link is therefore noticed after some strips.
"""
SLOW_TRANSPORT = 2.0
"""Multiple of the lanes' median transport time above which a lane counts as slow."""


class StripScheduler:
    """Scheduler that divides frames into strips (rows) for the lanes (connections to renderers).

    Every method is an event; the time ``now_s`` must not decrease. Actions are collected for :meth:`take_actions`.
    """

    def __init__(self, settings: ClusterSettings | None = None) -> None:
        self.settings = settings or ClusterSettings()
        self._shares = Shares(self.settings)
        self._lanes: dict[Lane, _Lane] = {}
        self._frames: dict[int, _Frame] = {}
        self._waiting: deque[_Frame] = deque()
        self._task_ids = itertools.count(1)
        self._orders = itertools.count()
        self._actions: list[Action] = []
        self._choices: dict[Hashable, LaneChoice] = {}
        """Selection of lanes by the frame's ``cost`` and by whether reserve lanes are used; the last used entry is
        the last."""
        self._done_s = float("-inf")

    def take_actions(self) -> list[Action]:
        """Return the actions that were collected since the last call, in order, and clear them."""
        actions, self._actions = self._actions, []
        return actions

    @property
    def deadline_s(self) -> float | None:
        """Time of the next call of :meth:`mark_late_lanes` if no other event happens; None if no deadline is set."""
        due = (self._due_s(lane) for lane in self._lanes.values())
        return min((due_s for due_s in due if due_s is not None), default=None)

    @property
    def num_open(self) -> int:
        """Number of frames that are opened and not complete."""
        return len(self._frames)

    @property
    def max_open_frames(self) -> int:
        """Maximum number of open frames of the latest kind; further requested frames wait.

        A caller that requests frames as fast as possible has the shortest response time with this number of requests.
        """
        choice = next(reversed(self._choices.values()), None)
        return self.settings.open_frames if choice is None else choice.open_frames

    @property
    def num_waiting(self) -> int:
        """Number of requested frames that wait until an image buffer is free."""
        return len(self._waiting)

    def rows(self, frame_id: int, strip: int) -> tuple[int, int] | None:
        """Return the first row and the row after the last of a strip; None after its frame is complete or dropped."""
        frame = self._frames.get(frame_id)
        return None if frame is None else frame.strips[strip]

    def lanes(self) -> list[LaneView]:
        """Return the states of all lanes, in the order in which they joined; unused lanes have the share 0."""
        able = [name for name, lane in self._lanes.items() if lane.state == "ready" and not lane.reserve]
        choice = next(reversed(self._choices.values()), None)
        if choice is not None and any(name in choice.used for name in able):
            able = [name for name in able if name in choice.used]
        shares = self._shares.of(able)
        if not able:
            able = [name for name, lane in self._lanes.items() if lane.state == "ready"]
            shares = {name: 1.0 / len(able) for name in able}
        return [
            LaneView(
                lane=name,
                state=lane.state,
                reserve=lane.reserve,
                share=shares.get(name, 0.0),
                num_in_flight=len(lane.in_flight),
                num_answers=lane.num_answers,
                num_late=lane.num_late,
                row_seconds=next(reversed(lane.pace.values()), None),
            )
            for name, lane in self._lanes.items()
        ]

    def join(self, lane: Lane, now_s: float, *, content: Hashable = None, reserve: bool = False) -> None:
        """Add a lane that has loaded ``content``; measurements of an absent or late lane start again.

        A ``reserve`` lane renders any content, but only strips that no other lane can render. The lane of the console
        is a reserve lane.

        Parameters
        ----------
        lane
            Name of the lane.
        now_s
            Current time in seconds.
        content
            Content that the lane has loaded.
        reserve
            Whether the lane is used only if no other can render.
        """
        if lane in self._lanes:
            self.leave(lane, now_s)
        self._lanes[lane] = _Lane(reserve=reserve, content=content, order=next(self._orders))
        if not reserve:
            self._shares.join(lane)
        self._assign_and_issue(now_s)

    def leave(self, lane: Lane, now_s: float) -> None:
        """Remove a lane and assign its strips to others."""
        state = self._lanes.pop(lane, None)
        if state is None:
            return
        self._shares.leave(lane)
        self._reassign_strips(lane, state, is_removed=True)
        self._assign_and_issue(now_s)

    def load(self, lane: Lane, content: Hashable, now_s: float) -> None:
        """Set the content of a lane's later strips; the strips already sent are rendered from the former content."""
        state = self._lanes.get(lane)
        if state is None or state.content == content:
            return
        state.content = content
        # Strips that were not sent yet would arrive after the new content.
        stale = [(f, s) for f, s in state.queue if self._frames[f].content != content]
        state.queue = [item for item in state.queue if item not in stale]
        for frame_id, strip in stale:
            self._release_strip(lane, frame_id, strip)
        self._assign_and_issue(now_s)

    def request(
        self,
        frame_id: int,
        num_rows: int,
        now_s: float,
        *,
        content: Hashable = None,
        cost: Hashable = None,
        stream: Hashable | None = None,
        whole: bool = False,
        max_rows: int | None = None,
    ) -> None:
        """Request a frame, which is rendered as soon as a buffer is available.

        Parameters
        ----------
        frame_id
            Number of the frame; must not be used twice.
        num_rows
            Height of the frame.
        now_s
            Current time in seconds.
        content
            Content of the frame; only lanes that have loaded it take part.
        cost
            Frames with equal ``cost`` take about the same time per row: the same view in the same width.
        stream
            Of the frames of one stream that wait for a buffer, only the newest stays, and a complete frame drops the
            older ones, because the camera has moved on. None for frames that are all needed.
        whole
            Render the frame on one lane and do not divide it into strips, for jobs of many pictures. The number of open
            frames is then limited only by the lanes.
        max_rows
            Largest height of a strip.
        """
        if num_rows < 1:
            raise UsageError(f"a frame must have at least one row; found {num_rows}", code="usage.cluster")
        if frame_id in self._frames or any(frame.frame_id == frame_id for frame in self._waiting):
            raise UsageError(f"the frame {frame_id} is already being rendered", code="usage.cluster")
        if stream is not None:
            for older in [frame for frame in self._waiting if frame.stream == stream]:
                self._waiting.remove(older)
                self._actions.append(FrameDropped(older.frame_id))
        self._waiting.append(_Frame(frame_id, num_rows, content, cost, stream, whole, max_rows))
        self._assign_and_issue(now_s)

    def drop(self, frame_id: int, now_s: float) -> None:
        """Drop a frame; answers that arrive later are discarded."""
        for frame in self._waiting:
            if frame.frame_id == frame_id:
                self._waiting.remove(frame)
                self._actions.append(FrameDropped(frame_id))
                break
        else:
            if frame_id not in self._frames:
                return
            self._delete_frame(frame_id)
            self._actions.append(FrameDropped(frame_id))
        self._assign_and_issue(now_s)

    def expects(self, lane: Lane, task_id: int) -> bool:
        """Return whether :meth:`answered` would accept a lane's answer to this task; the state does not change."""
        state = self._lanes.get(lane)
        task = None if state is None else next((t for t in state.in_flight if t.task_id == task_id), None)
        frame = None if task is None else self._frames.get(task.frame_id)
        return task is not None and frame is not None and task.strip in frame.missing

    def answered(self, lane: Lane, task_id: int, seconds: float, now_s: float) -> bool:
        """Record that a lane has rendered a strip.

        Parameters
        ----------
        lane, task_id
            Values of the :class:`Issue`.
        seconds
            Rendering time that the renderer reported.
        now_s
            Time at which the answer arrived.

        Returns
        -------
        bool
            Whether the rows are needed: True for the first answer of each strip of an open frame. The caller copies
            them before :meth:`take_actions`, which may report that the frame is done.
        """
        state = self._lanes.get(lane)
        task = None if state is None else next((t for t in state.in_flight if t.task_id == task_id), None)
        if state is None or task is None:
            return False
        # A strip waits in the lane for the one before. The measured time is the console's waiting time, which includes
        # the network, as in the paper; ``seconds`` is its minimum in case two answers are read at once.
        service_s = max(now_s - max(task.issued_s, state.answered_s), seconds, 1e-9)
        state.in_flight.remove(task)
        state.answered_s = now_s
        state.num_answers += 1
        frame = self._frames.get(task.frame_id)
        # Measured also if other lanes completed the frame earlier; otherwise the slowest lane would never count as
        # slow.
        self._update_pace(state, task, service_s, seconds)
        if state.state == "late":
            state.state = "ready"
            self._shares.use_small_inertia()
            self._actions.append(LaneBack(lane))
        accepted = frame is not None and task.strip in frame.missing
        if accepted:
            assert frame is not None
            frame.missing.discard(task.strip)
            frame.work_s += seconds
            for holder in frame.holders.pop(task.strip, set()):
                other = self._lanes.get(holder)
                if other is not None and (task.frame_id, task.strip) in other.queue:
                    other.queue.remove((task.frame_id, task.strip))
            if not frame.missing:
                self._complete_frame(frame, now_s)
        self._assign_and_issue(now_s)
        return accepted

    def failed(self, lane: Lane, task_id: int, now_s: float) -> None:
        """Record that a lane could not render a strip or answered wrongly; it gets no strips until it joins again."""
        state = self._lanes.get(lane)
        if state is None:
            return
        for task in [t for t in state.in_flight if t.task_id == task_id]:
            state.in_flight.remove(task)
            self._release_strip(lane, task.frame_id, task.strip)
        if state.state != "away":
            state.state = "away"
            self._reassign_strips(lane, state, is_removed=False)
        self._assign_and_issue(now_s)

    def mark_late_lanes(self, now_s: float) -> None:
        """Mark lanes whose oldest strip is overdue as late, and assign their strips to others."""
        for name, state in list(self._lanes.items()):
            due_s = self._due_s(state)
            if due_s is not None and now_s >= due_s:
                state.state = "late"
                state.num_late += 1
                self._actions.append(LaneLate(name))
                self._reassign_strips(name, state, is_removed=False)
        self._assign_and_issue(now_s)

    def _due_s(self, lane: _Lane) -> float | None:
        """Return the instant at which the oldest strip of a lane is late; None if the lane has no deadline."""
        # The console's own lane has no deadline, because no other lane is left for its strips.
        if lane.state != "ready" or lane.reserve or not lane.in_flight:
            return None
        task = lane.in_flight[0]
        pace = lane.pace.get(task.cost)
        if pace is not None:
            limit_s = max(self.settings.late_factor * pace * task.num_rows, self.settings.late_floor_s)
        else:
            limit_s = self._first_answer_s(task)
        return max(task.issued_s, lane.answered_s) + limit_s

    def _first_answer_s(self, task: _Task) -> float:
        """Return the deadline, in seconds after the order, of a lane of unknown speed, from the other lanes' speeds.

        A new lane may be many times slower than the others or may have to prepare, but must not delay the picture much.
        """
        settings = self.settings
        paces = [lane.pace[task.cost] for lane in self._lanes.values() if task.cost in lane.pace and not lane.reserve]
        if not paces:
            return settings.first_answer_s
        guess_s = settings.late_factor**2 * max(paces) * task.num_rows
        return min(settings.first_answer_s, max(guess_s, 4.0 * settings.late_floor_s))

    def _update_pace(self, lane: _Lane, task: _Task, service_s: float, seconds: float) -> None:
        """Update the smoothed time per row of a lane with the measured time of a strip."""
        rendered = lane.render_pace.pop(task.cost, seconds / task.num_rows)
        lane.render_pace[task.cost] = rendered + PACE_WEIGHT * (seconds / task.num_rows - rendered)
        # The smallest value excludes the time in which the console was busy with other answers.
        transport_s = max(0.0, service_s - seconds)
        if lane.num_answers > 1:
            transport_s = min(transport_s, TRANSPORT_GROWTH * lane.transport_s + TRANSPORT_STEP_S)
        lane.transport_s = transport_s
        row_s = service_s / task.num_rows
        old = lane.pace.pop(task.cost, None)
        # A larger time has more weight than a smaller one: otherwise a lane that became slow would be late again and
        # again.
        weight = 1.0 if old is None else 0.7 if row_s > 2.0 * old else PACE_WEIGHT
        lane.pace[task.cost] = row_s if old is None else old + weight * (row_s - old)
        seconds, rows = lane.measured.get(task.cost, (0.0, 0))
        lane.measured[task.cost] = (seconds + service_s, rows + task.num_rows)
        for series in (lane.pace, lane.render_pace, lane.measured, lane.last_m):
            while len(series) > KINDS_REMEMBERED:
                series.pop(next(iter(series)))

    def _complete_frame(self, frame: _Frame, now_s: float) -> None:
        """Complete a frame, drop older frames of its stream, and update the shares and the choice of lanes."""
        self._delete_frame(frame.frame_id)
        self._actions.append(FrameDone(frame.frame_id))
        if frame.stream is not None:
            for older in [f for f in self._frames.values() if f.stream == frame.stream]:
                if older.frame_id < frame.frame_id:
                    self._delete_frame(older.frame_id)
                    self._actions.append(FrameDropped(older.frame_id))
        for lane in self._lanes.values():
            seconds, rows = lane.measured.pop(frame.cost, (0.0, 0))
            if rows:
                lane.last_m[frame.cost] = seconds / rows
        self._shares.update(
            {
                name: lane.last_m[frame.cost]
                for name, lane in self._lanes.items()
                if not lane.reserve and lane.state == "ready" and frame.cost in lane.last_m
            }
        )
        choice = frame.choice
        if choice is not None:
            former = choice.number
            choice.record_frame(frame.plan_number, now_s - max(frame.opened_s, self._done_s), frame.work_s, now_s)
            if choice.number != former:
                self._shares.use_small_inertia()
        self._done_s = now_s

    def _delete_frame(self, frame_id: int) -> None:
        del self._frames[frame_id]
        for lane in self._lanes.values():
            lane.queue = [item for item in lane.queue if item[0] != frame_id]

    def _release_strip(self, lane: Lane, frame_id: int, strip: int) -> None:
        """Remove a lane from the set of lanes that have a strip."""
        frame = self._frames.get(frame_id)
        if frame is not None and strip in frame.holders:
            frame.holders[strip].discard(lane)

    def _reassign_strips(self, name: Lane, lane: _Lane, *, is_removed: bool) -> None:
        """Unassign a lane's queued strips, and its sent strips only if the lane is removed or away."""
        queued, lane.queue = lane.queue, []
        for frame_id, strip in queued:
            self._release_strip(name, frame_id, strip)
        if is_removed or lane.state == "away":
            for task in lane.in_flight:
                self._release_strip(name, task.frame_id, task.strip)

    def _able_lanes(self, frame: _Frame) -> list[Lane]:
        """Return the lanes that can take strips of a frame now."""
        ready = [(name, lane) for name, lane in self._lanes.items() if lane.state == "ready"]
        able = [name for name, lane in ready if not lane.reserve and lane.content == frame.content]
        return able or [name for name, lane in ready if lane.reserve]

    def _assign_and_issue(self, now_s: float) -> None:
        self._adopt_orphans()
        self._open_frames(now_s)
        self._issue_strips(now_s)

    def _adopt_orphans(self) -> None:
        """Assign strips that no ready lane has to a ready lane; the first answer to a strip is accepted."""
        for frame in self._frames.values():
            for strip in sorted(frame.missing):
                if any(name in self._lanes and self._lanes[name].state == "ready" for name in frame.holders[strip]):
                    continue
                able = self._able_lanes(frame)
                if not able:
                    return
                # The time of this frame depends on a lane that failed, so it does not count for the choice of lanes.
                frame.choice = None
                self._queue_strip(self._quickest_lane(able, frame), frame, strip)

    def _quickest_lane(self, able: list[Lane], frame: _Frame) -> Lane:
        return min(able, key=lambda name: (self._busy_s(name, frame), self._lanes[name].order))

    def _busy_s(self, name: Lane, frame: _Frame) -> float:
        """Return the time in seconds in which a lane would render its assigned strips and one more row."""
        lane = self._lanes[name]
        paces = [other.pace[frame.cost] for other in self._lanes.values() if frame.cost in other.pace]
        pace = lane.pace.get(frame.cost, sum(paces) / len(paces) if paces else 1.0)
        rows = sum(task.num_rows for task in lane.in_flight)
        for frame_id, strip in lane.queue:
            first, end = self._frames[frame_id].strips[strip]
            rows += end - first
        return pace * (rows + 1)

    def _queue_strip(self, name: Lane, frame: _Frame, strip: int) -> None:
        lane = self._lanes[name]
        lane.queue.append((frame.frame_id, strip))
        lane.queue.sort()
        frame.holders[strip].add(name)

    def _choose_lanes(self, frame: _Frame, able: list[Lane], now_s: float) -> tuple[list[Lane], LaneChoice | None]:
        """Return the lanes that render a divided frame, and their `LaneChoice`; None if all lanes render it."""
        if frame.whole or not self.settings.chooses_lanes:
            return able, None
        kind = (frame.cost, self._lanes[able[0]].reserve)
        choice = self._choices.pop(kind, None) or LaneChoice(self.settings.open_frames)
        self._choices[kind] = choice
        while len(self._choices) > KINDS_REMEMBERED:
            self._choices.pop(next(iter(self._choices)))
        return list(choice.choose(able, self._frame_seconds(frame, able), now_s)), choice

    def _frame_seconds(self, frame: _Frame, able: list[Lane]) -> dict[Lane, float]:
        """Return the time in seconds in which each measured lane would render a frame alone.

        The transport counts only for lanes with a slow link: with many lanes it consists mostly of waiting for the
        console, which is not a property of the lane.
        """
        lanes = {name: self._lanes[name] for name in able if frame.cost in self._lanes[name].render_pace}
        if not lanes:
            return {}
        usual_s = SLOW_TRANSPORT * statistics.median(lane.transport_s for lane in lanes.values())
        return {
            name: lane.render_pace[frame.cost] * frame.num_rows + max(0.0, lane.transport_s - usual_s)
            for name, lane in lanes.items()
        }

    def _open_frames(self, now_s: float) -> None:
        """Open waiting frames while buffers are free, and divide them into strips."""
        for frame in list(self._waiting):
            able = self._able_lanes(frame)
            alike = sum(1 for other in self._frames.values() if other.whole == frame.whole)
            if frame.whole:
                limit, choice = self.settings.in_flight * len(able), None
            else:
                able, choice = self._choose_lanes(frame, able, now_s) if able else (able, None)
                limit = self.settings.open_frames if choice is None else choice.open_frames
            if not able or alike >= limit:
                # Frames of one kind start in order: a frame that cannot start blocks the later ones.
                if all(other.whole == frame.whole for other in self._waiting):
                    return
                continue
            self._waiting.remove(frame)
            shares = {self._quickest_lane(able, frame): 1.0} if frame.whole else self._shares.of(able)
            pieces = cut_rows(frame.num_rows, shares, min_rows=self.settings.min_rows, max_rows=frame.max_rows)
            frame.strips = [(first, end) for _, first, end in pieces]
            frame.missing = set(range(len(pieces)))
            frame.holders = {strip: set() for strip in frame.missing}
            frame.opened_s = now_s
            frame.choice, frame.plan_number = choice, 0 if choice is None else choice.number
            self._frames[frame.frame_id] = frame
            for strip, (name, _, _) in enumerate(pieces):
                self._queue_strip(name, frame, strip)

    def _issue_strips(self, now_s: float) -> None:
        """Send queued strips to ready lanes, up to ``in_flight`` unanswered strips per lane."""
        for name, lane in self._lanes.items():
            while lane.state == "ready" and lane.queue and len(lane.in_flight) < self.settings.in_flight:
                frame_id, strip = lane.queue.pop(0)
                frame = self._frames[frame_id]
                first, end = frame.strips[strip]
                task = _Task(next(self._task_ids), frame_id, strip, end - first, frame.cost, now_s)
                lane.in_flight.append(task)
                again = len(frame.holders[strip]) > 1
                self._actions.append(Issue(task.task_id, name, frame_id, strip, first, end, again))
