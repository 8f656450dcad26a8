"""The running attempt at a task: the flight up to now, and its score."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.breathing import ChestMotion
from carina.errors import NoResultError
from carina.scopes import Pose, WallField
from carina.session.state.training import RunningTask
from carina.track import Airways, AirwayTree
from carina.training import LANDMARKS, FlightEvent, FlightFrames, FlightScorer, Score, Task, segments_of_case
from carina.training.flight_frames import FRAME_HZ, FlightOptics, KnownFrames
from carina.training.segments import branches_named
from carina.training.task import landmarks_of

MESSAGE_S = 3.0
"""Time in s for which the window shows an event of the flight, such as a contact with the wall."""
WARNINGS = frozenset({"wrong-branch", "wrong-segment", "contact", "revisit"})
"""Kinds of events that report a fault of the learner."""


class LiveAttempt:
    """An attempt at a task while it is flown.

    The score is computed by the code that scores the recording afterwards, on frames that are sampled from the tip.
    The score of the recording replaces it: a move between two samples counts there at its exact time.

    Parameters
    ----------
    task, airways, wall
        The task, and the airways of the case with their wall.
    optics
        Instrument and field of view.
    flight
        Number of the flight that is being recorded.
    begun_s
        Time of the beginning on the session's clock.
    pose
        Pose of the tip at the beginning.
    learner
        Key of the learner to whom the score is stored; None stores no score.
    """

    def __init__(
        self,
        task: Task,
        airways: Airways,
        wall: WallField,
        *,
        optics: FlightOptics,
        flight: int,
        begun_s: float,
        pose: Pose,
        learner: str | None = None,
    ) -> None:
        self.learner = learner
        self.task, self.airways, self.flight, self.begun_s = task, airways, flight, begun_s
        self._optics = optics
        self._scorer = FlightScorer(airways.tree, wall, task)
        self._goals = _goal_branches(task, airways.tree) if "arrow" in task.hints else {}
        self._poses: list[NDArray[np.float64]] = [pose.lps_from_camera]
        self._numbers = [0]
        self._latest = pose
        self.ended = threading.Event()
        """Set when the attempt has ended."""
        self.scored_s = begun_s
        """Time of the latest computation of the score, on the session's clock."""
        self.pause_s = 0.0
        """Least time in s from the latest computation of the score to the next one; it grows if scoring is slow."""
        self._score: Score | None = None
        self._score_before_s = self._newest_score_s = 0.0
        """Time of the score before the newest one, and of the newest one, since the beginning of the attempt."""
        self._paused_s: float | None = None
        self._motions: list[tuple[float, ChestMotion | None]] = []
        self._known = KnownFrames()

    @property
    def is_paused(self) -> bool:
        """Whether the attempt is paused."""
        return self._paused_s is not None

    def pause(self, now_s: float) -> None:
        """Stop the clock of the attempt."""
        if self._paused_s is None:
            self._paused_s = now_s

    def resume(self, now_s: float) -> None:
        """Continue the clock of the attempt after a pause."""
        if self._paused_s is not None:
            self.begun_s += max(now_s - self._paused_s, 0.0)
            self._paused_s = None

    def note_breathing(self, motion: ChestMotion | None, now_s: float) -> None:
        """Use a simulated breathing on the session's clock from now on; None ends it."""
        if motion is not None or self._motions:
            own = None if motion is None else replace(motion, began_s=motion.began_s - self.begun_s)
            self._motions.append((self.elapsed_s(now_s), own))

    @property
    def score(self) -> Score | None:
        """The newest score; None while the tip has not been in the airways."""
        return self._score

    @property
    def scope_name(self) -> str:
        """Name of the instrument with which the attempt began."""
        return self._optics.scope.name

    def elapsed_s(self, now_s: float) -> float:
        """Return the time since the beginning of the attempt, without its pauses."""
        at_s = now_s if self._paused_s is None else self._paused_s
        return max(at_s - self.begun_s, 0.0)

    def is_over(self, now_s: float) -> bool:
        """Return whether the time limit has passed."""
        limit_s = self.task.time_limit_s
        start_s = 0.0 if self._score is None else self._score.clock_start_s
        return limit_s is not None and self.elapsed_s(now_s) - start_s > limit_s

    @property
    def is_completed(self) -> bool:
        """Whether the task was completed; an inspection continues until the user ends it."""
        score = self._score
        return score is not None and score.result.completed and self.task.kind != "inspect"

    def sample(self, pose: Pose, now_s: float) -> None:
        """Add the samples since the last call, with the present pose of the tip."""
        num = math.floor(self.elapsed_s(now_s) * FRAME_HZ + 1e-6) + 1
        is_new = pose is not self._latest
        self._latest = pose
        for _ in range(num - len(self._poses)):
            self._poses.append(pose.lps_from_camera)
            self._numbers.append(self._numbers[-1] + int(is_new))
            is_new = False

    def update_score(self, now_s: float) -> None:
        """Compute the score of the attempt from the frames that were sampled so far."""
        self.scored_s = now_s
        self._score_before_s, self._newest_score_s = self._newest_score_s, self.elapsed_s(now_s)
        poses, numbers = np.stack(self._poses), np.array(self._numbers)
        frames = FlightFrames(
            poses,
            numbers,
            np.zeros(len(poses), dtype=np.int64),
            (self._optics,),
            True,
            poses,
            np.arange(len(poses)) / FRAME_HZ,
            motions=tuple(self._motions),
            known=self._known,
        )
        try:
            self._score = self._scorer.score(frames)
        except NoResultError:
            self._score = None

    def info(self, now_s: float) -> RunningTask:
        """Return the state of the attempt for the windows."""
        task, score = self.task, self._score
        elapsed_s = self.elapsed_s(now_s)
        base = RunningTask(
            task=task.name, flight=self.flight, elapsed_s=round(elapsed_s, 1), num_steps=0, paused=self.is_paused
        )
        if score is None:
            return base
        latest = self._latest_event(score, elapsed_s)
        return msgspec.structs.replace(
            base,
            num_steps=score.result.num_steps,
            steps_done=score.result.steps_done,
            next_step=self._next_step(score),
            arrow_branches=self._goals.get(self._goal_step(score) or "", ()),
            message=None if latest is None else self._event_words(latest),
            is_warning=latest is not None and latest.kind in WARNINGS,
        )

    def _next_step(self, score: Score) -> str | None:
        """Return the next step in the order of the task, unless it would name what the trainee must recognise."""
        task, done = self.task, score.result.steps_done
        if task.kind in {"sequence", "find"}:
            # The title of the task names these segments.
            return next((name for name in task.segments if name not in done), None)
        if task.kind in {"turns", "pass"}:
            return next((name for name in task.branches if name not in done), None)
        if task.kind == "stations":
            return next((f"station {name}" for name in task.stations if name not in done), None)
        if task.kind == "inspect":
            steps = [*([title for title, _ in LANDMARKS] if task.order == "landmarks" else []), *score.case_segments]
            return next((name for name in steps if name not in done), None)
        return None

    def _goal_step(self, score: Score) -> str | None:
        """Return the step to which the arrow leads: the next step, or the only place of a task without an order."""
        if score.result.completed:
            return None
        if self.task.kind == "stations":
            return next((name for name in self.task.stations if name not in score.result.steps_done), None)
        return self._next_step(score) or self.task.structure or ("place" if self.task.kind == "reach" else None)

    def _latest_event(self, score: Score, elapsed_s: float) -> FlightEvent | None:
        # On a slow machine an event is scored late, and is shown until the next score.
        since_s = min(elapsed_s - MESSAGE_S, self._score_before_s)
        recent = [one for one in score.events if one.kind in _EVENT_WORDS and since_s <= one.time_s <= elapsed_s]
        # Of simultaneous events a fault is shown.
        return max(recent, key=lambda one: (one.time_s, one.kind in WARNINGS), default=None)

    def _event_words(self, event: FlightEvent) -> str:
        words = _EVENT_WORDS[event.kind]
        if event.kind == "contact":
            return f"{words} at {event.detail}"
        named = self.task.names_shown or event.kind in _STEPS or (event.kind in _VISITS and self.task.kind == "inspect")
        return f"{words}: {event.name}" if named else words


def _goal_branches(task: Task, tree: AirwayTree) -> dict[str, tuple[int, ...]]:
    """Return, for each step of a task, the branches to which the arrow in the window points."""
    found = {one.name: one.branch_ids for one in segments_of_case(tree)}
    names = (*task.segments, *task.branches, *(() if task.structure is None else (task.structure,)))
    found |= {name: tuple(one.id for one in branches_named(tree, name)) for name in names}
    if task.kind == "inspect":
        # A landmark is located in front of its openings, to the first of which the arrow leads.
        found |= {title: tuple(one.id for one in branches_named(tree, names[0])) for title, names in LANDMARKS}
    if task.kind == "stations":
        for station, marks in landmarks_of(tree, task).items():
            points = [np.array(one.point_lps) for one in marks if one.point_lps is not None]
            found[station] = tuple(tree.nearest_branch(point)[0].id for point in points)
    if task.kind == "reach" and task.place_lps:
        found["place"] = (tree.nearest_branch(np.array(task.place_lps))[0].id,)
    return found


_EVENT_WORDS = {
    "wrong-branch": "wrong branch",
    "wrong-segment": "another segment",
    "contact": "touching the wall",
    "visit": "visited",
    "revisit": "visited again",
    "seen": "seen",
    "landmark": "landmark",
    "entered": "entered",
    "held": "held",
    "station": "station located",
    "reached": "reached",
}
_STEPS = frozenset({"landmark", "entered", "held", "station", "reached"})
"""Kinds of events whose name the task states."""
_VISITS = frozenset({"visit", "revisit"})
"""Kinds of events that name a segment of an inspection after its visit."""
