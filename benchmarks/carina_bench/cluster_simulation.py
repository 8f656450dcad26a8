"""Simulation of a cluster: the scheduler of Carina on a simulated clock, with renderers of given speed.

``carina bench cluster`` calibrates the simulation with measured costs of strips and calls; tests use given costs.
"""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from carina.cluster.scheduler import FrameDone, Issue, StripScheduler
from carina.cluster.settings import ClusterSettings

__all__ = ["Job", "SimulatedCluster", "SimulatedRenderer", "SimulationResult"]


@dataclass(frozen=True, slots=True)
class SimulatedRenderer:
    """Speed of one simulated machine, and times of its connection to the console."""

    row_seconds: float
    call_seconds: float = 0.001
    call_jitter_seconds: float = 0.0005
    strip_seconds: float = 0.0
    """Constant time per strip, added to the time of its rows, s."""


@dataclass(frozen=True, slots=True)
class Job:
    """Strip (rows of a picture) that a simulated machine rendered: machine, frame, start and end."""

    lane: int
    frame_id: int
    began_s: float
    ended_s: float
    rows: int


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """Times of the frames of a simulated run, and busy times and work shares of the machines."""

    seconds: float
    settled_s: float
    """Instant at which the measured frames began, s from the start of the run; no frame was in progress then."""
    frame_s: tuple[float, ...]
    """Instant at which each measured frame was complete, s from the start of the run."""
    response_s: tuple[float, ...]
    """Time in s from the start of each measured frame until its last strip arrived."""
    busy: tuple[float, ...]
    """Share of the simulated time in which each machine rendered, 0 to 1."""
    shares: tuple[dict[int, float], ...]
    """Share of the rows that the scheduler gave to each machine, by its number, after each frame."""
    num_lanes: tuple[int, ...]
    """Number of machines that rendered each measured frame."""
    jobs: tuple[Job, ...] = field(repr=False, default=())

    @property
    def fps(self) -> float:
        """Frames per second from the start of the first measured frame until the last was complete.

        All work of the measured frames is done in this time, so that the rate cannot exceed that of the machines.
        """
        seconds = (max(self.frame_s) - self.settled_s) if self.frame_s else 0.0
        return len(self.frame_s) / seconds if seconds > 0.0 else 0.0


class SimulatedCluster:
    """Simulated cluster: the real scheduler with simulated machines and a simulated clock.

    Parameters
    ----------
    renderers
        Speeds of the machines.
    settings
        Settings of the scheduler.
    console_seconds, console_row_seconds
        Time of the console and its connection for each answer and for each row of an answer; answers do not overlap.
    row_cost
        Cost of each row as a multiple of the mean cost.
    seed
        Seed of the jitter.
    """

    def __init__(
        self,
        renderers: list[SimulatedRenderer],
        settings: ClusterSettings | None = None,
        *,
        console_seconds: float = 0.0,
        console_row_seconds: float = 0.0,
        row_cost: Callable[[int], float] | None = None,
        seed: int = 1,
    ) -> None:
        self._renderers = renderers
        self._scheduler = StripScheduler(settings)
        self._console_s = console_seconds
        self._console_row_s = console_row_seconds
        self._row_cost = row_cost
        self._random = random.Random(seed)
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._order = itertools.count()

    def run(self, num_frames: int, num_rows: int, *, period_s: float = 0.0, settle: int = 0) -> SimulationResult:
        """Simulate frames and return their times.

        Parameters
        ----------
        num_frames
            Number of measured frames.
        num_rows
            Height of the frames.
        period_s
            Time between the starts of two measured frames, s; 0 starts a frame as soon as a buffer is free.
        settle
            Number of frames before the measured ones. The measured frames start when these are complete.
        """
        scheduler = self._scheduler
        free_s = [0.0] * len(self._renderers)
        busy_s = [0.0] * len(self._renderers)
        # The answers of a machine arrive in the order of its strips, as on one connection.
        last_answer_s = [0.0] * len(self._renderers)
        wanted: list[int] = []
        opened: dict[int, float] = {}
        done: list[float] = []
        response: list[float] = []
        shares: list[dict[int, float]] = []
        jobs: list[Job] = []
        console_free_s = 0.0
        next_frame = 0
        num_done = 0
        settled_s = 0.0 if settle == 0 else float("inf")
        lanes_of: dict[int, set[int]] = {}
        num_lanes: list[int] = []

        def half_call_s(renderer: SimulatedRenderer) -> float:
            jitter = renderer.call_jitter_seconds
            return max(0.0, renderer.call_seconds + self._random.uniform(-jitter, jitter)) / 2

        def request(now_s: float) -> None:
            nonlocal next_frame, settled_s
            while next_frame < settle + num_frames and scheduler.num_open + scheduler.num_waiting < (
                scheduler.max_open_frames
            ):
                if next_frame >= settle:
                    if num_done < settle:
                        return
                    settled_s = min(settled_s, now_s)
                    if period_s and now_s < settled_s + (next_frame - settle) * period_s - 1e-12:
                        self._at(settled_s + (next_frame - settle) * period_s, lambda _: None)
                        return
                wanted.append(next_frame)
                scheduler.request(next_frame, num_rows, now_s)
                next_frame += 1
                act(now_s)

        def act(now_s: float) -> None:
            nonlocal num_done
            for frame in [n for n in wanted if scheduler.rows(n, 0) is not None]:
                wanted.remove(frame)
                opened[frame] = now_s
            for action in scheduler.take_actions():
                if isinstance(action, FrameDone):
                    num_done += 1
                    began_s = opened.pop(action.frame_id)
                    lanes = lanes_of.pop(action.frame_id)
                    if action.frame_id < settle:
                        continue
                    done.append(now_s)
                    response.append(now_s - began_s)
                    num_lanes.append(len(lanes))
                    shares.append({int(str(view.lane)): view.share for view in scheduler.lanes()})
                elif isinstance(action, Issue):
                    issue(action, now_s)

        def issue(task: Issue, now_s: float) -> None:
            lane = int(str(task.lane))
            lanes_of.setdefault(task.frame_id, set()).add(lane)
            renderer = self._renderers[lane]
            rows = range(task.first_row, task.end_row)
            cost = float(len(rows)) if self._row_cost is None else sum(self._row_cost(row) for row in rows)
            seconds = renderer.strip_seconds + renderer.row_seconds * cost
            began_s = max(now_s + half_call_s(renderer), free_s[lane])
            free_s[lane] = began_s + seconds
            busy_s[lane] += seconds
            jobs.append(Job(lane, task.frame_id, began_s, free_s[lane], len(rows)))
            last_answer_s[lane] = max(last_answer_s[lane], free_s[lane] + half_call_s(renderer))
            self._at(last_answer_s[lane], lambda at_s: arrive(task, seconds, at_s))

        def arrive(task: Issue, seconds: float, now_s: float) -> None:
            nonlocal console_free_s
            rows = task.end_row - task.first_row
            console_free_s = max(console_free_s, now_s) + self._console_s + rows * self._console_row_s
            self._at(console_free_s, lambda at_s: answer(task, seconds, at_s))

        def answer(task: Issue, seconds: float, now_s: float) -> None:
            scheduler.answered(task.lane, task.task_id, seconds, now_s)

        for lane in range(len(self._renderers)):
            scheduler.join(lane, 0.0)
        now_s = 0.0
        request(now_s)
        while self._events:
            due_s = scheduler.deadline_s
            if due_s is not None and due_s < self._events[0][0]:
                now_s = due_s
                scheduler.mark_late_lanes(now_s)
            else:
                now_s, _, happen = heapq.heappop(self._events)
                happen(now_s)
            act(now_s)
            request(now_s)
        total = max(now_s, 1e-12)
        return SimulationResult(
            total,
            settled_s,
            tuple(done),
            tuple(response),
            tuple(b / total for b in busy_s),
            tuple(shares),
            tuple(num_lanes),
            tuple(jobs),
        )

    def _at(self, when_s: float, happen: Callable[[float], None]) -> None:
        heapq.heappush(self._events, (when_s, next(self._order), happen))
