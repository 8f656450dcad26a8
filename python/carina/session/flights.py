"""Commands about recorded flights: what they are called, their order, and which there are.

They belong to the case and not to its document: no undo takes a flight away or brings one back. The list is changed
in memory, at once; the case file follows it as it follows all else.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from carina import commands as c
from carina.case.recordings import RecordingFacts
from carina.errors import UsageError
from carina.navigate.recording import read_recording
from carina.session.case import FlownFlight, OpenCase
from carina.session.flying import place_pose
from carina.session.jobs import Job
from carina.session.snapshot import FlightPlace
from carina.session.subject import Subject, does

if TYPE_CHECKING:
    from carina.session.core import SessionCore

__all__ = ["Flights", "needed_flight", "running_flight"]


class Flights(Subject):
    """The list of the case's recorded flights, and flying one again.

    Parameters
    ----------
    core
        Of the session.
    text
        The lines of a flight, by its number; it may wait for the disk.
    """

    def __init__(self, core: SessionCore, text: Callable[[int], str]) -> None:
        super().__init__(core)
        self._text = text

    @does(c.RenameFlight)
    def rename(self, command: c.RenameFlight) -> None:
        """Also while it is being recorded."""
        name = command.name.strip()
        if not name:
            raise UsageError("a flight needs a name", code="session.flights")
        self._change(command.number, name=name)

    @does(c.DescribeFlight)
    def describe(self, command: c.DescribeFlight) -> None:
        """Also while it is being recorded."""
        self._change(command.number, words=command.words.strip())

    @does(c.MoveFlight)
    def move(self, command: c.MoveFlight) -> None:
        """Nothing beyond the ends of the list."""
        case = self.core.needed_case()
        with self.core.lock:
            flights = list(case.flights.listed)
            at = flights.index(needed_flight(case, command.number))
            to = min(max(at + command.by, 0), len(flights) - 1)
            if to != at:
                flights.insert(to, flights.pop(at))
                self._become(case, flights)

    @does(c.RemoveFlight)
    def remove(self, command: c.RemoveFlight) -> None:
        """UsageError while it is being recorded."""
        case = self.core.needed_case()
        with self.core.lock:
            flight = needed_flight(case, command.number)
            if running_flight(case) == command.number:
                raise UsageError(
                    f"{flight.name} is still being recorded; stop the recording first", code="session.flights"
                )
            case.flights.removed |= {command.number}
            case.flights.unwritten = tuple(one for one in case.flights.unwritten if one.number != command.number)
            self._become(case, [one for one in case.flights.listed if one is not flight])

    @does(c.FlyFlight)
    def fly(self, command: c.FlyFlight) -> str | None:
        """As a job where it has to be read; a hand that moves the tip meanwhile is not thrown back."""
        number, case = command.number, self.core.needed_case()
        with self.core.lock:
            flight = needed_flight(case, number)
            at = case.last_move.flight
            if command.goes_on and (at is None or at.number != number):
                return None
            if running_flight(case) == number:
                raise UsageError(
                    f"{flight.name} is still being recorded; stop the recording first", code="session.flights"
                )
            if case.flights.flown is not None and case.flights.flown.number == number:
                self._fly(case, case.flights.flown, command.time_s)
                return None
            before = case.last_move
            # What no file has yet needs no disk.
            waiting = [one.waiting() for one in case.flights.unwritten if one.number == number]

        def work(job: Job) -> None:
            text = waiting[0][1] if waiting and waiting[0][0] == 0 else self._text(number)
            recording = read_recording(io.StringIO(text), Path(f"flight {number}"))
            job.check()
            flown = FlownFlight(number, *recording.recorded_poses())
            with self.core.lock:
                job.check()
                case.flights.flown = flown
                if case.last_move is before:
                    self._fly(case, flown, command.time_s)

        return self.core.jobs.start("flight", "reading the flight", work)

    def _fly(self, case: OpenCase, flown: FlownFlight, time_s: float) -> None:
        """With the session locked."""
        place_s = min(time_s, needed_flight(case, flown.number).length_s)
        self.core.fly(place_pose(flown.pose_at(place_s)))
        case.last_move = replace(case.last_move, by="flight", flight=FlightPlace(flown.number, place_s))

    def _change(self, number: int, **values: str) -> None:
        case = self.core.needed_case()
        with self.core.lock:
            flight = needed_flight(case, number)
            changed = replace(flight, **values)  # type: ignore[arg-type]
            if changed != flight:
                self._become(case, [changed if one is flight else one for one in case.flights.listed])

    def _become(self, case: OpenCase, flights: list[RecordingFacts]) -> None:
        case.flights.listed = tuple(flights)
        self.core.changed("flights")


def needed_flight(case: OpenCase, number: int) -> RecordingFacts:
    """The flight with a number; with the session locked.

    Raises
    ------
    UsageError
        ``session.flights``: if there is none.
    """
    for flight in case.flights.listed:
        if flight.recording_id == number:
            return flight
    raise UsageError("this flight has been removed", code="session.flights")


def running_flight(case: OpenCase) -> int | None:
    """The number of the flight that is being recorded into the case; with the session locked."""
    return next((one.number for one in case.flights.unwritten if not one.closed), None)
