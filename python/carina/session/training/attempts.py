"""Commands of the training: attempts at tasks, and the scores of recorded flights."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from carina import commands as c
from carina.case.document import Document
from carina.case.scope_choice import document_with_scope
from carina.errors import CancelledError, NoResultError, UsageError
from carina.navigate import FlightPath
from carina.navigate.moves import LayScope
from carina.navigate.recording import Recording, TaskOutcome, read_recording
from carina.scopes import DEFAULT_SCOPE, WallField, scope_preset
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.derived.derived_value import Cached
from carina.session.flights.recorded_flights import needed_flight, running_flight
from carina.session.flights.recording import FlightRecorder
from carina.session.flights.tip_commands import place_pose
from carina.session.jobs.background_jobs import STARTED_AGAIN, Job
from carina.session.open_case.open_case import OpenCase, as_point
from carina.session.state.snapshot import UserMessage
from carina.session.state.training import RunningTask, TaskInfo, TrainingInfo
from carina.session.training.course import CourseHandlers
from carina.session.training.live_attempt import LiveAttempt
from carina.session.training.planned_tasks import planned_task
from carina.session.training.quizzes import QuizHandlers
from carina.session.training.scores import flight_score, references, task_infos, verdict_words
from carina.track import Airways, AirwayTree
from carina.training import (
    CaseSegment,
    FlightComparison,
    FolderTasks,
    Score,
    Task,
    TaskFolder,
    find_task,
    flight_frames,
    score_flight,
    segments_of_case,
    task_of_flight,
    task_to_json,
)
from carina.training.flight_frames import FlightOptics

if TYPE_CHECKING:
    from carina.session.core import SessionCore

SAMPLE_S = 0.05
"""Time in s between two samples of the tip's pose that the score of a running attempt uses."""
SCORE_S = 1.0
"""Minimum time in s between two computations of the score of a running attempt."""
PAUSE_SHARE = 10.0
"""Minimum time between two scores of the running attempt, as a multiple of the time that one score takes."""
ENTRY_MM = 5.0
"""Insertion in mm of the scope at which an attempt begins, so that the trachea's cut end is not in the picture."""
NOT_STORED = "this case is not stored on this machine, so the flight of a task cannot be recorded: save the case first"
AIRWAYS_CHANGED = "the airways have changed"
SCOPE_REMOVED = "the scope was taken out of the airways"
SCOPE_CHANGED = "the instrument was changed"
RECORDING_STOPPED = "the recording was stopped"
DEVICE_LOST = (
    "{device} was disconnected: the task continues, and the clock runs. Connect the device again, use another one, or "
    "choose End the task"
)
CASE_CLOSED = (
    "the task ended early, because the case was closed: its flight is stored in the case; open the case again and "
    "choose Score it. The attempt does not count"
)
NOT_SCORED = "the score of {flight} is not stored yet, because its computation was stopped: {remedy}choose Score it"

REFUSED_COMMANDS = (
    # Commands that take the scope out of the airways, or select another scope.
    c.SetMode, c.ToggleMode, c.GoTo, c.NextFork, c.PreviousFork, c.Place, c.PlacePose, c.ShowPlace, c.SetScope,
    c.FlyFlight, c.FlyKeyFrames, c.ShowKeyFrame, c.SeeTurn, c.StartQuiz,
    # Command that stops the recording, from which the attempt is scored.
    c.StopRecording,
    # Commands that change the airways or the instrument, or restore former ones, so that the score would not be valid.
    c.EditTree, c.SetRoot, c.SetLumenThreshold, c.TakeMask, c.AnswerMask, c.Undo, c.Redo, c.GoToStep,
    # These commands close the case. The end of the session closes it without a command, so windows can be closed.
    c.OpenPath, c.OpenSeries, c.OpenCaseFile, c.OpenDemo, c.OpenRecent, c.OpenFiles, c.OpenVolume, c.BeginAnew,
    c.CloseCase,
)  # fmt: skip
"""Commands that would end a running attempt, which are refused until the user ends the attempt."""
TASK_RUNS = "a task is running, and this would end the attempt: choose End the task first"


@dataclass(slots=True)
class _CaseTraining:
    """Attempt and scores of the open case."""

    case: OpenCase
    attempt: LiveAttempt | None = None
    scores: dict[int, Score] = field(default_factory=dict)
    """Score of each flight that was scored since the case was opened, by its number."""
    comparisons: dict[int, FlightComparison] = field(default_factory=dict)
    """Comparison of each scored flight with the expert's, by the flight's number."""


class TrainingHandlers(CommandHandlers):
    """Attempts at tasks, and the scores of recorded flights.

    Parameters
    ----------
    core
        Core of the session.
    recorder
        Recorder of flights.
    quizzes
        The quiz on the open case, which an attempt ends.
    course
        The learners, to whom scored attempts are stored.
    text
        Returns the lines of a flight by its number; the call may wait for the disk.
    tasks
        Folder of the tasks of teachers; None for the built-in tasks only.
    """

    def __init__(
        self,
        core: SessionCore,
        recorder: FlightRecorder,
        quizzes: QuizHandlers,
        course: CourseHandlers,
        text: Callable[[int], str],
        *,
        tasks: TaskFolder | None,
    ) -> None:
        super().__init__(core)
        core.device_lost = self._device_lost
        self._tasks = tasks
        self._tasks_read: FolderTasks | None = FolderTasks() if tasks is None else None
        """Tasks of teachers; None before the first reading."""
        self._course = course
        self._quizzes = quizzes
        self._recorder = recorder
        self._text = text
        self._state: _CaseTraining | None = None
        self._segments: Cached[Airways | None, tuple[CaseSegment, ...]] = Cached(
            lambda airways: () if airways is None else segments_of_case(airways.tree)
        )
        self._suitable: Cached[tuple[Document, FolderTasks], tuple[TaskInfo, ...]] = Cached(
            lambda state: task_infos(*state), same=_same_tasks
        )

    def _user_tasks(self) -> FolderTasks:
        """Return the tasks of teachers, without reading the disk again."""
        if self._tasks_read is None and self._tasks is not None:
            self._tasks_read = self._tasks.read()
        return self._tasks_read or FolderTasks()

    def _find_task(self, name: str) -> Task:
        return find_task(name) if self._tasks is None else self._tasks.find(name)

    @does(c.ReadTrainingFiles)
    def read_files(self, _command: c.ReadTrainingFiles) -> None:
        """Read the tasks of teachers and the learners again; the disk is read without the session's lock."""
        if self._tasks is not None:
            self._tasks_read = self._tasks.read()
        self._course.read_files()
        self.core.changed("training")

    def _of(self, case: OpenCase) -> _CaseTraining:
        """Return the attempt and the scores of a case; the caller holds the session's lock."""
        if self._state is None or self._state.case is not case:
            self._state = _CaseTraining(case)
        return self._state

    # ------------------------------------------------------------ the attempt

    def refuse(self, command: c.Command) -> None:
        """Refuse a command that would end the running attempt; the caller holds the session's lock.

        Raises
        ------
        UsageError
            ``training.running``: while an attempt is running.
        """
        case = self.core.case
        if case is None or self._of(case).attempt is None or not isinstance(command, REFUSED_COMMANDS):
            return
        if isinstance(command, c.SetMode) and command.mode == "scope":
            return
        raise UsageError(TASK_RUNS, code="training.running")

    @does(c.StartTask)
    def start(self, command: c.StartTask) -> None:
        """Begin an attempt at a task, once the wall of the airways is computed.

        Raises
        ------
        NoResultError
            ``training.no-airways``: without airways. ``training.no-branch``, ``training.turns``,
            ``training.no-segments``, ``training.no-plan``: if the case is unsuitable for the task.
        UsageError
            ``session.recording``: if a recording is running, or if the case is not stored.
        """
        case, task = self.core.needed_case(), self._find_task(command.task)
        with self.core.lock:
            task = planned_task(task, case.document)
            airways = case.document.airways
            if airways is None:
                raise NoResultError("a task needs the airways: wait for the search", code="training.no-airways")
            task.check_case(airways.tree)
            if self._recorder.name is not None:
                raise UsageError("a recording is running; stop it first", code="session.recording")
            if not self.core.saving().keeps:
                raise UsageError(NOT_STORED, code="session.recording")
            learner = self._course.chosen_key()
            case.wall.again()
            case.wall.want(airways, then=lambda _: self._begin(case, airways, task, learner))

    def _begin(self, case: OpenCase, airways: Airways, task: Task, learner: str | None) -> None:
        """Insert the scope into the trachea and start the recording; the caller holds the session's lock.

        Parameters
        ----------
        case, airways, task
            The case, its airways and the task.
        learner
            Key of the learner who started the task; a later choice of another learner does not change the owner.
        """
        wall = case.wall.of(airways)
        if self.core.case is not case or case.document.airways is not airways or wall is None:
            return
        if self._of(case).attempt is not None or self._recorder.name is not None:
            return
        self._quizzes.stop(c.StopQuiz())
        scope = scope_preset(task.scope or case.document.look.scope or DEFAULT_SCOPE)
        changed = document_with_scope(case.document, scope.name, resets_view=True)
        if changed is not case.document:
            self.core.change(case, f"scope: {scope.title}", changed)
        # The recording begins with a free tip at the entry, because a replay can only start from a scope that the
        # recording inserts.
        way = entry_way(airways.tree)
        self.core.fly(place_pose(FlightPath(way).pose_at(ENTRY_MM)))
        # Each attempt begins at the same state of breath.
        case.flights.breathing.restart(self.core.clock())
        number = 1 + sum(one.name.startswith(f"{task.title}, attempt ") for one in case.flights.listed)
        self._recorder.start(c.RecordFlight(name=f"{task.title}, attempt {number}"))
        case.pilot.wall, case.pilot.wall_made_from = wall.field, wall.made_from
        self.core.fly(LayScope(scope.name, way, ENTRY_MM))
        case.scope.inserted = scope.name
        self._recorder.note_task(task_to_json(task), learner)
        flight = self._recorder.flight_number
        assert flight is not None
        look = case.document.look
        optics = FlightOptics(scope, False, float(look.fov_deg), look.operator == "facing")
        self._of(case).attempt = attempt = LiveAttempt(
            task,
            airways,
            wall.field,
            optics=optics,
            flight=flight,
            begun_s=self.core.clock(),
            pose=case.navigator.pose,
            learner=learner,
        )
        attempt.note_breathing(case.flights.breathing.motion(airways.tree), self.core.clock())
        self.core.changed("training", "flights", "state", "pose", "views")
        threading.Thread(target=self._watch, args=(case, attempt), name="carina-attempt", daemon=True).start()

    @does(c.PauseTask)
    def pause(self, command: c.PauseTask) -> None:
        """Pause the attempt, or continue it; do nothing without an attempt."""
        with self.core.lock:
            case = self.core.needed_case()
            attempt = self._of(case).attempt
            if attempt is None or attempt.is_paused == command.paused:
                return
            if command.paused:
                # The pause stops the clock, so the time since the last sample must be recorded before it.
                attempt.sample(case.navigator.pose, self.core.clock())
                attempt.pause(self.core.clock())
                self._recorder.pause()
                case.flights.breathing.pause(self.core.clock())
                self.core.tip_held = True
            else:
                attempt.resume(self.core.clock())
                self._release_tip(case)
            self._note_running(attempt)
            self.core.changed("training")

    def note_breathing(self, case: OpenCase) -> None:
        """Pass a change of the simulated breathing to the running attempt; the caller holds the session's lock."""
        attempt, airways = self._of(case).attempt, case.document.airways
        if attempt is not None and airways is not None:
            attempt.note_breathing(case.flights.breathing.motion(airways.tree), self.core.clock())

    def _device_lost(self, device: str) -> None:
        """Report that the device of a running attempt was disconnected; the caller holds the session's lock."""
        case = self.core.case
        if case is not None and self._of(case).attempt is not None:
            self.core.emit(UserMessage(DEVICE_LOST.format(device=device)))

    def _release_tip(self, case: OpenCase) -> None:
        """Let the tip move again after a pause; the caller holds the session's lock."""
        if self.core.tip_held:
            self._recorder.resume()
            case.flights.breathing.resume(self.core.clock())
            self.core.tip_held = False
            # A device that has moved during the pause continues from its new position, without a jump of the tip.
            for device in case.pilot.devices():
                case.pilot.apply(c.DeviceGone(device.device))

    @does(c.StopTask)
    def stop(self, _command: c.StopTask) -> None:
        """End the attempt and score its flight; do nothing without an attempt."""
        with self.core.lock:
            case = self.core.needed_case()
            attempt = self._of(case).attempt
            if attempt is not None:
                self._end(case, attempt, "stopped")

    def _watch(self, case: OpenCase, attempt: LiveAttempt) -> None:
        """Follow an attempt until it ends; runs in a thread of the attempt."""
        while self.follow_attempt(case, attempt) and not attempt.ended.wait(SAMPLE_S):
            pass

    def follow_attempt(self, case: OpenCase, attempt: LiveAttempt) -> bool:
        """Sample the tip, update the score once a second, and end an attempt that is over.

        Returns whether the attempt continues. The score is computed without the session's lock.
        """
        with self.core.lock:
            if not self._sample(case, attempt):
                return False
            now_s = self.core.clock()
        if now_s - attempt.scored_s >= max(SCORE_S, attempt.pause_s):
            attempt.update_score(now_s)
            # The score of a long flight takes seconds; the views and the samples of the tip need this time, too.
            attempt.pause_s = PAUSE_SHARE * (self.core.clock() - now_s)
            with self.core.lock:
                if self.core.case is not case or self._of(case).attempt is not attempt:
                    return False
                self._note_running(attempt)
                self.core.changed("training")
        return True

    def _note_running(self, attempt: LiveAttempt) -> None:
        """Send the state of an attempt to teachers; the caller holds the session's lock.

        With the lock, a state is never passed on after the end of its attempt.
        """
        self._course.note_running(attempt.learner, attempt.info(self.core.clock()), attempt.task.title)

    def _sample(self, case: OpenCase, attempt: LiveAttempt) -> bool:
        """Add the present pose to an attempt, and end it where it is over; return whether it continues.

        The caller holds the session's lock.
        """
        if self.core.case is not case or self._of(case).attempt is not attempt:
            return False
        now_s = self.core.clock()
        attempt.sample(case.navigator.pose, now_s)
        if self._recorder.flight_number != attempt.flight:
            self._end(case, attempt, "interrupted", RECORDING_STOPPED)
        elif case.document.airways is not attempt.airways:
            self._end(case, attempt, "interrupted", AIRWAYS_CHANGED)
        elif case.navigator.mode != "scope":
            self._end(case, attempt, "interrupted", SCOPE_REMOVED)
        elif case.document.look.scope != attempt.scope_name:
            self._end(case, attempt, "interrupted", SCOPE_CHANGED)
        elif attempt.is_completed:
            self._end(case, attempt, "completed")
        elif attempt.is_over(now_s):
            self._end(case, attempt, "time-limit")
        else:
            return True
        return False

    def _end(self, case: OpenCase, attempt: LiveAttempt, outcome: TaskOutcome, reason: str | None = None) -> None:
        """End an attempt, and score its flight; the caller holds the session's lock."""
        self._of(case).attempt = None
        attempt.ended.set()
        self._course.note_running(attempt.learner, None)
        self._release_tip(case)
        if self._recorder.flight_number == attempt.flight:
            self._recorder.note_task_end(outcome)
            self._recorder.stop()
        self._end_breathing(case)
        if reason is not None:
            self.core.emit(UserMessage(f"the task ended early, and the attempt does not count: {reason}"))
        self.core.changed("training", "flights", "state")
        self._start_scoring(case, attempt.flight, attempt.task)

    def _end_breathing(self, case: OpenCase) -> None:
        """End the simulated breathing, which belongs to the task that ends; the caller holds the session's lock.

        Otherwise the chest would move on unnoticed: every movement renders a picture, and the next attempt would not
        count for mastery.
        """
        if case.flights.breathing.breathing is not None:
            case.flights.breathing.begin(None, self.core.clock())
            for step in self.core.after_breathing:
                step(case)
            self.core.changed("state", "pose", "views")

    def follow(self, case: OpenCase) -> None:
        """End the attempt after a change of the airways; the caller holds the session's lock."""
        attempt = self._of(case).attempt
        if attempt is not None and case.document.airways is not attempt.airways:
            self._end(case, attempt, "interrupted", AIRWAYS_CHANGED)

    def discard(self) -> None:
        """Release attempt and scores, because their case is being closed; the caller holds the session's lock."""
        if self._state is not None and self._state.attempt is not None:
            self._state.attempt.ended.set()
            self._course.note_running(self._state.attempt.learner, None)
            self.core.emit(UserMessage(CASE_CLOSED))
        self._state = None
        self.core.tip_held = False

    # ------------------------------------------------------------ scores

    @does(c.ScoreFlight)
    def score(self, command: c.ScoreFlight) -> str:
        """Score a recorded flight by a job.

        Raises
        ------
        UsageError
            ``session.flights``: if there is no such flight, or if it is being recorded. ``training.task``: if there is
            no such task.
        NoResultError
            ``training.no-airways``: without airways.
        """
        case = self.core.needed_case()
        task = None if command.task is None else self._find_task(command.task)
        with self.core.lock:
            task = None if task is None else planned_task(task, case.document)
            flight = needed_flight(case, command.number)
            if running_flight(case) == command.number:
                raise UsageError(f"{flight.name} is still being recorded; stop it first", code="session.flights")
            if case.document.airways is None:
                raise NoResultError("a score needs the airways: wait for the search", code="training.no-airways")
            return self._start_scoring(case, command.number, task)

    def _start_scoring(self, case: OpenCase, number: int, task: Task | None) -> str:
        """Start the job that scores a flight, and stores it for the learner who flew; the caller holds the lock."""
        airways = case.document.airways
        name = next((one.name for one in case.flights.listed if one.recording_id == number), "the flight")

        def work(job: Job) -> None:
            if airways is None:
                raise NoResultError("a score needs the airways: wait for the search", code="training.no-airways")
            try:
                recording, found = self.scored(case, airways, number, task, job)
            except CancelledError:
                self._report_unscored(case, name, job)
                raise
            # The recording states the learner who flew, and the task of the attempt.
            if recording.learner is not None and recording.task == task_to_json(found.task):
                self._course.record(recording.learner, found)
            with self.core.lock:
                job.check()
                if self.core.case is not case:
                    return
                self._of(case).scores[number] = found
                self._of(case).comparisons.pop(number, None)
                self.core.changed("training")

        # The score of another flight is another kind, because a new job stops a running job of its kind.
        return self.core.jobs.start(f"score-{number}", "scoring the flight", work)

    def _report_unscored(self, case: OpenCase, flight: str, job: Job) -> None:
        """Report that the job of a score was stopped, unless a newer job computes the score of the same flight."""
        if job.stop_reason == STARTED_AGAIN:
            return
        with self.core.lock:
            is_open = self.core.case is case and job.stop_reason is None
            remedy = "" if is_open else "open the case again and "
            self.core.emit(UserMessage(NOT_SCORED.format(flight=flight, remedy=remedy)))

    def scored(
        self, case: OpenCase, airways: Airways, number: int, task: Task | None, job: Job
    ) -> tuple[Recording, Score]:
        """Return the recording of a flight, and its score; called in a job, without the session's lock.

        Parameters
        ----------
        case, airways
            The case and its airways.
        number
            Number of the flight.
        task
            Task of the score; None takes the task that the flight states.
        job
            The job.
        """
        with self.core.lock:
            waiting = [one.unsaved_part() for one in case.flights.unwritten if one.number == number]
            wall = case.wall.of(airways)
        text = waiting[0][1] if waiting and waiting[0][0] == 0 else self._text(number)
        recording = read_recording(io.StringIO(text), Path(f"flight {number}"))
        wall_mm: WallField
        if wall is None:
            wall_mm = self.core.parts.wall_field(case.info.volume, airways, progress=job.progress, cancel=job.cancel)
        else:
            wall_mm = wall.field
        chosen = task_of_flight(recording) if task is None else task
        return recording, score_flight(airways.tree, wall_mm, flight_frames(recording), chosen, progress=job.progress)

    def note_comparison(self, case: OpenCase, number: int, comparison: FlightComparison) -> None:
        """Store the comparison of a flight with the expert's; the caller holds the session's lock."""
        self._of(case).comparisons[number] = comparison

    def forget_comparisons(self, case: OpenCase) -> None:
        """Delete the comparisons, because the expert's flight has changed; the caller holds the session's lock."""
        self._of(case).comparisons.clear()

    @answers(c.ScoreOf)
    def score_of(self, question: c.ScoreOf) -> Score:
        """Return the score of a flight."""
        case = self.core.needed_case()
        with self.core.lock:
            found = self._of(case).scores.get(question.number)
        if found is None:
            raise UsageError("this flight has no score yet: score it first", code="session.flights")
        return found

    @answers(c.TrainingOf)
    def training_of(self, _question: c.TrainingOf) -> TrainingInfo:
        """Return the tasks, the running attempt and the scores."""
        case = self.core.case
        if case is None:
            with self.core.lock:
                return TrainingInfo(course=self._course.info())
        user_tasks = self._user_tasks()
        with self.core.lock:
            state = self._of(case)
            tasks = self._suitable.of((case.document, user_tasks))
            numbers = [one.recording_id for one in case.flights.listed]
            listed = [(number, state.scores[number]) for number in numbers if number in state.scores]
            quiz = self._quizzes.info_of(case)
            running = None if state.attempt is None else self._running(state.attempt)
            course = self._course.info()
            compared = dict(state.comparisons)
            segments = self._segments.of(case.document.airways)
        return TrainingInfo(
            tasks=tasks,
            task_folder=None if self._tasks is None else str(self._tasks.folder),
            task_problems=user_tasks.problems,
            running=running,
            quiz=quiz,
            scores=tuple(flight_score(number, one, segments, compared.get(number)) for number, one in listed),
            verdict=verdict_words([one for _, one in listed]),
            references=references(),
            course=course,
        )

    def _running(self, attempt: LiveAttempt) -> RunningTask:
        """Return the running attempt for the windows; the caller holds the session's lock."""
        info = attempt.info(self.core.clock())
        return msgspec.structs.replace(info, learner=self._course.name_of(attempt.learner))


def entry_way(tree: AirwayTree) -> tuple[tuple[float, float, float], ...]:
    """Return the points (LPS mm) from the trachea's start into a main bronchus, along which the scope is inserted."""
    children = [one for one in tree.branches if one.parent == tree.root.id]
    end = max(children, key=lambda one: one.length_mm, default=tree.root).id
    return tuple(as_point(point) for point in tree.route_to(end).points_lps)


def _same_tasks(one: tuple[Document, FolderTasks], other: tuple[Document, FolderTasks]) -> bool:
    """Return whether two documents suit the same tasks."""
    a, b = one[0], other[0]
    return one[1] is other[1] and a.airways is b.airways and a.route is b.route and a.targets is b.targets
