"""The session of a case: its commands with undo, its background jobs and the pose of the scope tip.

The web server, the command line, notebooks and tests use the same session class. The session depends neither on the
server nor on Ray: the caller passes a renderer factory, and objects that need events subscribe to the session.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar, cast, get_args

from carina.commands import Command, Query, all_commands, checked
from carina.errors import UsageError
from carina.navigate import Move
from carina.session.airways.editing import TreeEditHandlers
from carina.session.airways.finding import AirwayHandlers
from carina.session.airways.measuring import MeasurementHandlers
from carina.session.cases.case_list import CaseList
from carina.session.cases.observer import ObserverHandlers
from carina.session.cases.opening import CaseOpener
from carina.session.cases.second_ct import SecondCtHandlers
from carina.session.command_registry import handlers_of
from carina.session.core import Event, SessionCore
from carina.session.engines import Parts, RendererFactory
from carina.session.flights.breathing import BreathingHandlers
from carina.session.flights.devices import DeviceHandlers
from carina.session.flights.film_flights import FilmHandlers
from carina.session.flights.key_frames import KeyFrameHandlers
from carina.session.flights.recorded_flights import FlightHandlers
from carina.session.flights.recording import FlightRecorder
from carina.session.flights.scope_contact import ScopeContactHandlers
from carina.session.flights.store_simulated_drive import VerdictDriveHandlers
from carina.session.flights.tip_commands import TipHandlers
from carina.session.jobs.background_jobs import JobRunner
from carina.session.saving.autosave import CLOSING_S, Autosave, CaseFileFunctions
from carina.session.scene.shown_case import ShownCase
from carina.session.state.snapshot import KeyFramesInfo, PoseInfo, Snapshot
from carina.session.store.local_settings import LocalStore
from carina.session.store.registry import CaseRecords
from carina.session.targets.planning import PlanHandlers
from carina.session.targets.routing import RouteHandlers
from carina.session.targets.target_edits import TargetHandlers
from carina.session.training.attempts import TrainingHandlers
from carina.session.training.course import CourseHandlers
from carina.session.training.expert_flights import ExpertHandlers
from carina.session.training.quizzes import QuizHandlers
from carina.session.view.look import LookHandlers
from carina.session.view.questions import CaseQuestions
from carina.training import Course, TaskFolder

A = TypeVar("A")


class Session:
    """State and jobs of one workstation; :meth:`do` runs commands and :meth:`ask` answers questions.

    Parameters
    ----------
    renderer_factory
        Creates the renderer of a volume, for the views of the windows.
    job_renderer_factory
        Creates the renderer of a background job on this machine; None uses ``renderer_factory``. Two renderers of one
        cluster would replace each other's content on its machines.
    parts
        The processing functions that the session calls; by default those of Carina.
    store
        Storage of the recent cases and of the accepted safety notice; None stores nothing.
    submit
        Runs a function in the background; by default a thread pool of the session.
    clock
        Returns monotonic time in seconds.
    today
        Returns the date in ISO format, for the list of recent cases.
    records, files
        Registry of the stored cases, and the functions that create and open their files; if either is None, the
        session stores no case.
    course
        Files of the learners of the training; None stores no learners.
    tasks
        Folder of the tasks of teachers; None lists the built-in tasks only.

    Notes
    -----
    All methods may be called from any thread. The session calls its listeners in the order of the events, from the
    thread that caused the event and with the session locked, so a listener must only forward the event and return.
    Commands raise CarinaError. Long commands start a job, return its ID, and report errors as events.
    """

    def __init__(
        self,
        renderer_factory: RendererFactory,
        *,
        job_renderer_factory: RendererFactory | None = None,
        parts: Parts | None = None,
        store: LocalStore | None = None,
        submit: Callable[[Callable[[], None]], object] | None = None,
        clock: Callable[[], float] = time.monotonic,
        today: Callable[[], str] = lambda: time.strftime("%Y-%m-%d"),
        records: CaseRecords | None = None,
        files: CaseFileFunctions | None = None,
        course: Course | None = None,
        tasks: TaskFolder | None = None,
    ) -> None:
        core = SessionCore(
            renderer_factory,
            job_renderer_factory=job_renderer_factory,
            parts=parts,
            store=store,
            submit=submit,
            clock=clock,
            today=today,
        )
        holding, finding, editing = ScopeContactHandlers(core), AirwayHandlers(core), TreeEditHandlers(core)
        measuring, keys, planning = MeasurementHandlers(core), KeyFrameHandlers(core), PlanHandlers(core)
        recording = FlightRecorder(core, holding)
        self._core, self._keys, self._recording = core, keys, recording
        self._devices = DeviceHandlers(core, recording, self.do)
        self._saving = Autosave(core, records, files)
        self._cases = CaseList(core, self._saving, recording.stop)
        core.saving = lambda: self._saving.info
        quizzes = QuizHandlers(core)
        self._course = CourseHandlers(core, course)
        training = TrainingHandlers(core, recording, quizzes, self._course, self._saving.flight_text, tasks=tasks)
        self._training, drives = training, VerdictDriveHandlers(core)
        opening = CaseOpener(core, finding, recording, holding, self._saving)
        # Order: a recording stores its time before other updates; packed airways are unpacked before other code reads
        # them.
        core.before_document += [recording.tick, editing.unfold]
        core.after_document += [
            editing.fold, measuring.follow, recording.note_view, holding.follow, keys.follow, finding.follow,
            planning.follow, training.follow, quizzes.follow,
        ]  # fmt: skip
        core.after_sight += [recording.note_view]
        core.after_breathing += [recording.note_breathing, training.note_breathing]
        core.after_case += [training.discard, quizzes.discard]
        looking, self._breathing = LookHandlers(core), BreathingHandlers(core)
        subjects = (
            opening, TipHandlers(core, holding), looking, RouteHandlers(core), planning, TargetHandlers(core),
            SecondCtHandlers(core, self._saving),
            finding, editing, keys, recording, self._breathing,
            FlightHandlers(core, self._saving.flight_text), FilmHandlers(core, self._saving.flight_text),
            training, quizzes, self._course, ExpertHandlers(core, training, drives), drives,
            self._devices, holding, self._saving, self._cases, CaseQuestions(core),
            ObserverHandlers(core, finding, holding, self._saving),
        )  # fmt: skip
        self._handlers: dict[type[Any], Callable[[Any], Any]] = {
            cls: looking.set_field for cls in all_commands() if cls.sets is not None
        }
        for subject in subjects:
            self._handlers.update(handlers_of(subject))
        # The pilot executes each command that is a move, unless a handler prepares the move.
        for command in {*all_commands()} & {*get_args(Move)}:
            self._handlers.setdefault(command, core.fly)

    def __repr__(self) -> str:
        """Describe the session by the neutral title of its case."""
        case = self._core.case
        return f"Session({'no case' if case is None else case.neutral_title})"

    # ------------------------------------------------------------ commands and questions

    def do(self, command: Command, *, window: int | None = None) -> str | None:
        """Run a command of :mod:`carina.commands`.

        Parameters
        ----------
        command
            The command to run.
        window
            Number of the window that sends the command. A command that changes only the sight changes the sight of this
            window, and later errors of the command are reported only to this window. None changes the sight of all
            windows.

        Returns
        -------
        str or None
            ID of the job that continues the command, or of the new key frame.

        Raises
        ------
        UsageError
            If a field is out of its bounds, no case is open, or the command names an object that does not exist. The
            session is unchanged then. ``training.running``: if the command would end the running attempt at a task.
        NoResultError
            If the case has no result for the command, such as a path where there is none.
        """
        handler = self._handlers.get(type(command))
        if handler is None or not isinstance(command, Command):
            raise UsageError(f"expected a command from carina.commands; found {type(command).__name__}")
        with self._core.lock:
            self._core.refuse_watcher(command, window)
            self._training.refuse(command)
        command = checked(command)
        with self._core.doing(command, window):
            return cast("str | None", handler(command))

    def ask(self, question: Query[A]) -> A:
        """Answer a question of :mod:`carina.commands.questions` without changing the session.

        Raises
        ------
        UsageError
            If a field is out of its bounds, no case is open, or the question names an object that does not exist.
        NoResultError
            If the case has no result for the question.
        """
        handler = self._handlers.get(type(question))
        if handler is None or not isinstance(question, Query):
            raise UsageError(f"expected a question from carina.commands; found {type(question).__name__}")
        return cast(A, handler(checked(question)))

    # ------------------------------------------------------------ undo

    def undo(self) -> None:
        """Undo the case's last change that was not undone."""
        self._core.undo()

    def redo(self) -> None:
        """Redo the last change that was undone."""
        self._core.redo()

    def history(self) -> tuple[str, ...]:
        """Return the labels of the changes that can be undone, the oldest first."""
        return self._core.history()

    # ------------------------------------------------------------ state for other objects

    def snapshot(self, window: int | None = None) -> Snapshot:
        """Return the state without the pose, as one window shows it; by default, the window that was used last."""
        return self._core.snapshot(window)

    def pose_info(self) -> PoseInfo | None:
        """Return the newest pose and its position in the airways; None without a case."""
        return self._core.pose_info()

    def key_frames_info(self) -> KeyFramesInfo:
        """Return the key frames in the form that the windows show."""
        return self._keys.info()

    def scene(self, window: int | None = None) -> ShownCase | None:
        """Return the scene that a window's views show, for its render thread; None without a case."""
        return self._core.scene(window)

    @property
    def devices(self) -> DeviceHandlers:
        """Receiver of device samples; it computes the motion of the tip from these samples."""
        return self._devices

    # ------------------------------------------------------------ listeners and shutdown

    def subscribe(
        self, listener: Callable[[Event], None], *, window: int | None = None, watches: bool = False
    ) -> Callable[[], None]:
        """Add a listener for all events, and return the function that removes it.

        Parameters
        ----------
        listener
            Function that is called with each event.
        window
            Number of the window that receives the events. Until the window is removed it has its own sight, and it does
            not receive events that concern only another window.
        watches
            Whether the window is a permanent observer: it may change only its own sight, and it sees only the case that
            is open now.

        Raises
        ------
        UsageError
            If an observer subscribes while no case is open.
        """
        return self._core.subscribe(listener, window, watches=watches)

    @property
    def jobs(self) -> JobRunner:
        """The runner of background jobs."""
        return self._core.jobs

    @property
    def cases(self) -> CaseList:
        """The list of the user's cases, and the cache of CTs."""
        return self._cases

    @property
    def store(self) -> LocalStore | None:
        """Storage of the recent cases and of the accepted safety notice; None if nothing is stored."""
        return self._core.store

    def close(self, within_s: float = CLOSING_S) -> None:
        """Stop a recording and all jobs, and end the threads.

        The call waits up to ``within_s`` seconds for a disk that does not respond; ``cases.unsaved()`` then returns the
        lost work.
        """
        self._recording.stop()
        self._breathing.close()
        self._course.close()
        self._saving.close(within_s)
        self._core.close()
