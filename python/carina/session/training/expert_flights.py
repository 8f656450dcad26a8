"""The expert's flight of a case: its mark, and the comparison of flights with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carina import commands as c
from carina.errors import NoResultError, UsageError
from carina.session.command_registry import CommandHandlers, does
from carina.session.flights.recorded_flights import needed_flight, running_flight
from carina.session.flights.store_simulated_drive import VerdictDriveHandlers
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import OpenCase
from carina.session.training.attempts import TrainingHandlers
from carina.training import compare_flights

if TYPE_CHECKING:
    from carina.session.core import SessionCore

NO_EXPERT = (
    "no flight is marked as the expert's, and no simulated drive exists: mark a flight, or choose a planned route and "
    "wait for the verdict on the instrument"
)


class ExpertHandlers(CommandHandlers):
    """The expert's flight of the open case.

    Parameters
    ----------
    core
        Core of the session.
    training
        Scores of flights.
    drives
        Storage of simulated drives, which replace a person's flight where none is marked.
    """

    def __init__(self, core: SessionCore, training: TrainingHandlers, drives: VerdictDriveHandlers) -> None:
        super().__init__(core)
        self._training, self._drives = training, drives

    @does(c.MarkExpert)
    def mark(self, command: c.MarkExpert) -> None:
        """Mark a recorded flight as the expert's; None removes the mark.

        Raises
        ------
        UsageError
            ``session.flights``: if there is no such flight, or if it is being recorded.
        """
        case = self.core.needed_case()
        with self.core.lock:
            if command.number is not None:
                flight = needed_flight(case, command.number)
                if running_flight(case) == command.number:
                    raise UsageError(f"{flight.name} is still being recorded; stop it first", code="session.flights")
            self._set(case, command.number)

    def _set(self, case: OpenCase, number: int | None) -> None:
        case.expert_flight = number
        self._training.forget_comparisons(case)
        self.core.changed("training", "flights")

    @does(c.CompareFlight)
    def compare(self, command: c.CompareFlight) -> str:
        """Compare a scored flight with the expert's, by a job.

        Without a marked flight, the simulated drive of the instrument's verdict is stored as a flight and marked.

        Raises
        ------
        UsageError
            ``session.flights``: if the flight has no score, or is the expert's.
        NoResultError
            ``training.expert``: without an expert's flight and without a simulated drive. ``training.no-airways``:
            without airways.
        """
        case, number = self.core.needed_case(), command.number
        with self.core.lock:
            airways = case.document.airways
            if airways is None:
                raise NoResultError("a score needs the airways: wait for the search", code="training.no-airways")
            own = self._training.score_of(c.ScoreOf(number))
            expert = case.expert_flight
            if expert is None:
                expert = self._store_drive(case)
            if expert == number:
                raise UsageError("this flight is the expert's; choose another flight", code="session.flights")

        def work(job: Job) -> None:
            _, other = self._training.scored(case, airways, expert, own.task, job)
            found = compare_flights(airways.tree, own, other)
            with self.core.lock:
                job.check()
                if self.core.case is case and case.expert_flight == expert:
                    self._training.note_comparison(case, number, found)
                    self.core.changed("training")

        return self.core.jobs.start(f"compare-{number}", "comparing the flights", work)

    def _store_drive(self, case: OpenCase) -> int:
        """Store the simulated drive of the present instrument as the expert's flight, and return its number."""
        scope = case.document.look.scope
        try:
            if scope is None:
                raise NoResultError(NO_EXPERT, code="training.expert")
            self._drives.keep(c.KeepDrive(scope))
        except NoResultError:
            raise NoResultError(NO_EXPERT, code="training.expert") from None
        number = case.flights.listed[-1].recording_id
        self._set(case, number)
        return number
