"""The session, which owns the state of a case: commands that can be undone, jobs, and the pose.

The window, the command line, notebooks and tests drive the same session. It knows neither a server nor Ray: the
renderer comes by argument, and whoever wants to know about changes subscribes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar, cast

from carina.commands import Command, Question, all_commands, checked
from carina.errors import UsageError
from carina.session.case_list import CaseList
from carina.session.core import Event, SessionCore
from carina.session.devices import Devices
from carina.session.editing import TreeEditing
from carina.session.finding import AirwayFinding
from carina.session.flights import Flights
from carina.session.flying import STRAIGHT_TO_THE_PILOT, Flying
from carina.session.following import Following
from carina.session.holding import ScopeHolding
from carina.session.jobs import JobRunner
from carina.session.kept_drives import KeptDrives
from carina.session.key_framing import KeyFraming
from carina.session.looking import Looking
from carina.session.measuring import TreeMeasuring
from carina.session.opening import Opening
from carina.session.parts import Parts, RendererFactory
from carina.session.planning import Planning
from carina.session.questions import CaseQuestions
from carina.session.recent import LocalStore
from carina.session.recording import FlightRecording
from carina.session.records import CaseRecords
from carina.session.routing import Routing
from carina.session.saving import CLOSING_S, KeptFiles, Saving
from carina.session.scene import ShownCase
from carina.session.snapshot import KeyFramesInfo, PoseInfo, Snapshot
from carina.session.subject import handlers_of
from carina.session.target_editing import TargetEditing

__all__ = ["Session"]

A = TypeVar("A")


class Session:
    """State and jobs of one workstation, with one door for commands and one for questions.

    Parameters
    ----------
    renderer_factory
        Makes the renderer of a volume.
    parts
        The functions it drives; the real ones unless told.
    store
        Recent cases and the safety notice; None keeps nothing.
    submit
        Runs a function in the background; a thread pool of its own unless told.
    clock
        Seconds, monotonic.
    today
        The date, ISO, for the list of recent cases.
    records, files
        Where cases are kept, and how their files are made and opened; without both nothing is kept.

    Notes
    -----
    All methods may be called from any thread. Listeners are called in the order of the events, from the thread that
    caused them and while the session is locked: they must hand the event on and return. Commands raise CarinaError;
    long ones are jobs, return their id, and report trouble as events.
    """

    def __init__(
        self,
        renderer_factory: RendererFactory,
        *,
        parts: Parts | None = None,
        store: LocalStore | None = None,
        submit: Callable[[Callable[[], None]], object] | None = None,
        clock: Callable[[], float] = time.monotonic,
        today: Callable[[], str] = lambda: time.strftime("%Y-%m-%d"),
        records: CaseRecords | None = None,
        files: KeptFiles | None = None,
    ) -> None:
        core = SessionCore(renderer_factory, parts=parts, store=store, submit=submit, clock=clock, today=today)
        holding, finding, editing = ScopeHolding(core), AirwayFinding(core), TreeEditing(core)
        measuring, keys, planning = TreeMeasuring(core), KeyFraming(core), Planning(core)
        recording = FlightRecording(core, holding)
        self._core, self._keys, self._recording = core, keys, recording
        self._devices = Devices(core, recording, self.do)
        self._saving = Saving(core, records, files)
        self._cases = CaseList(core, self._saving, recording.stop)
        core.saving = lambda: self._saving.info
        opening = Opening(core, finding, recording, holding, self._saving)
        # In this order: a recording's time before what follows, an edit's airways before who reads them.
        core.before_document += [recording.tick, editing.unfold]
        core.after_document += [
            editing.fold, measuring.follow, recording.note_view, holding.follow, keys.follow, finding.follow,
            planning.follow,
        ]  # fmt: skip
        core.after_sight += [recording.note_view]
        looking = Looking(core)
        subjects = (
            opening, Flying(core, holding), looking, Routing(core), planning, TargetEditing(core),
            finding, editing, keys, recording,
            Flights(core, self._saving.flight_text), KeptDrives(core),
            self._devices, holding, self._saving, self._cases, CaseQuestions(core),
            Following(core, finding, holding, self._saving),
        )  # fmt: skip
        self._handlers: dict[type[Any], Callable[[Any], Any]] = {
            cls: looking.set_field for cls in all_commands() if cls.sets is not None
        }
        for subject in subjects:
            self._handlers.update(handlers_of(subject))
        self._handlers.update(dict.fromkeys(STRAIGHT_TO_THE_PILOT, core.fly))

    def __repr__(self) -> str:
        case = self._core.case
        return f"Session({'no case' if case is None else case.neutral_title})"

    # ------------------------------------------------------------ the two doors

    def do(self, command: Command, *, window: int | None = None) -> str | None:
        """Do a command of :mod:`carina.commands`.

        Parameters
        ----------
        command
            What is asked.
        window
            Who asks: what only sets the sight changes that window's, and it alone is told what goes wrong later. None
            asks for all of them.

        Returns
        -------
        str or None
            The id of the job that goes on with it, or of the key frame that is new.

        Raises
        ------
        UsageError
            If a field is out of its bounds, no case is open, or what it names is not there. Nothing is changed then.
        NoResultError
            If the case has no answer to it, such as a path where there is none.
        """
        handler = self._handlers.get(type(command))
        if handler is None or not isinstance(command, Command):
            raise UsageError(f"expected a command from carina.commands; found {type(command).__name__}")
        with self._core.lock:
            self._core.refuse_watcher(command, window)
        command = checked(command)
        with self._core.doing(command, window):
            return cast("str | None", handler(command))

    def ask(self, question: Question[A]) -> A:
        """Answer a question of :mod:`carina.commands.questions`; nothing changes.

        Raises
        ------
        UsageError, NoResultError
            As :meth:`do`.
        """
        handler = self._handlers.get(type(question))
        if handler is None or not isinstance(question, Question):
            raise UsageError(f"expected a question from carina.commands; found {type(question).__name__}")
        return cast(A, handler(checked(question)))

    # ------------------------------------------------------------ undo

    def undo(self) -> None:
        """Take back the last change."""
        self._core.undo()

    def redo(self) -> None:
        """Do the last change taken back again."""
        self._core.redo()

    def history(self) -> tuple[str, ...]:
        """Return the labels of the changes that can be undone, the oldest first."""
        return self._core.history()

    # ------------------------------------------------------------ what others read

    def snapshot(self, window: int | None = None) -> Snapshot:
        """All but the pose, as a window sees it; unless told, the one that was looked through last."""
        return self._core.snapshot(window)

    def pose_info(self) -> PoseInfo | None:
        """Return the newest pose and where it is; None without a case."""
        return self._core.pose_info()

    def key_frames_info(self) -> KeyFramesInfo:
        """Return the key frames as the windows show them."""
        return self._keys.info()

    def scene(self, window: int | None = None) -> ShownCase | None:
        """Return the scene that a window's views show, for its render thread; None without a case."""
        return self._core.scene(window)

    @property
    def devices(self) -> Devices:
        """What devices say, and the frames in which the tip follows them."""
        return self._devices

    # ------------------------------------------------------------ life

    def subscribe(
        self, listener: Callable[[Event], None], *, window: int | None = None, watches: bool = False
    ) -> Callable[[], None]:
        """Be told of every event; returns the function that ends it.

        A window, which names itself by a number, has a sight of its own until then, and is not told what concerns
        another one alone. One that only ``watches`` may do nothing but set its own sight, for ever, and sees the case
        that is open now and no other; UsageError if none is.
        """
        return self._core.subscribe(listener, window, watches=watches)

    @property
    def jobs(self) -> JobRunner:
        """Running jobs."""
        return self._core.jobs

    @property
    def cases(self) -> CaseList:
        """The cases of this person, and what is kept beside them."""
        return self._cases

    @property
    def store(self) -> LocalStore | None:
        """Recent cases and the safety notice."""
        return self._core.store

    def close(self, within_s: float = CLOSING_S) -> None:
        """End a recording, stop all jobs and end the threads.

        The call waits up to ``within_s`` for a disk that does not respond; :meth:`unsaved` then returns the lost work.
        """
        self._recording.stop()
        self._saving.close(within_s)
        self._core.close()
