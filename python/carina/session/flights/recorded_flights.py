"""Commands for recorded flights: name, description, order, deletion and playback.

Flights belong to the case and not to its document, so undo does not change them. A command changes the list in memory
at once; the case file is updated like all other content of the case.
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
from carina.session.command_registry import CommandHandlers, does
from carina.session.flights.tip_commands import place_pose
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import LoadedFlight, OpenCase
from carina.session.state.snapshot import FlightPlace

if TYPE_CHECKING:
    from carina.session.core import SessionCore


class FlightHandlers(CommandHandlers):
    """The list of the recorded flights of a case, and their playback.

    Parameters
    ----------
    core
        Core of the session.
    text
        Returns the lines of a flight by its number; the call may wait for the disk.
    """

    def __init__(self, core: SessionCore, text: Callable[[int], str]) -> None:
        super().__init__(core)
        self._text = text

    @does(c.RenameFlight)
    def rename(self, command: c.RenameFlight) -> None:
        """Rename a flight, also while it is being recorded."""
        name = command.name.strip()
        if not name:
            raise UsageError("a flight needs a name", code="session.flights")
        self._changed_flight(command.number, name=name)

    @does(c.DescribeFlight)
    def describe(self, command: c.DescribeFlight) -> None:
        """Set the description of a flight, also while it is being recorded."""
        self._changed_flight(command.number, words=command.words.strip())

    @does(c.MoveFlight)
    def move(self, command: c.MoveFlight) -> None:
        """Move a flight in the order of the list, at most to either end."""
        case = self.core.needed_case()
        with self.core.lock:
            flights = list(case.flights.listed)
            at = flights.index(needed_flight(case, command.number))
            to = min(max(at + command.by, 0), len(flights) - 1)
            if to != at:
                flights.insert(to, flights.pop(at))
                self._set_flights(case, flights)

    @does(c.RemoveFlight)
    def remove(self, command: c.RemoveFlight) -> None:
        """Delete a flight; UsageError while it is being recorded."""
        case = self.core.needed_case()
        with self.core.lock:
            flight = needed_flight(case, command.number)
            if running_flight(case) == command.number:
                raise UsageError(
                    f"{flight.name} is still being recorded; stop the recording first", code="session.flights"
                )
            case.flights.removed |= {command.number}
            case.flights.unwritten = tuple(one for one in case.flights.unwritten if one.number != command.number)
            self._set_flights(case, [one for one in case.flights.listed if one is not flight])

    @does(c.FlyFlight)
    def fly(self, command: c.FlyFlight) -> str | None:
        """Play a flight: place the tip at a time of the flight, which a job reads first if necessary.

        The job does not place the tip if the user has moved it since the command.
        """
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
                self._show_flight_pose(case, case.flights.flown, command.time_s)
                return None
            before = case.last_move
            # A flight that is only in memory is played without the disk.
            waiting = [one.unsaved_part() for one in case.flights.unwritten if one.number == number]

        def work(job: Job) -> None:
            text = waiting[0][1] if waiting and waiting[0][0] == 0 else self._text(number)
            recording = read_recording(io.StringIO(text), Path(f"flight {number}"))
            job.check()
            flown = LoadedFlight(number, *recording.recorded_poses(), recording.motions)
            with self.core.lock:
                job.check()
                case.flights.flown = flown
                if case.last_move is before:
                    self._show_flight_pose(case, flown, command.time_s)

        return self.core.jobs.start("flight", "reading the flight", work)

    def _show_flight_pose(self, case: OpenCase, flown: LoadedFlight, time_s: float) -> None:
        """Place the tip at a time of a flight in memory; the caller holds the session's lock."""
        place_s = min(time_s, needed_flight(case, flown.number).length_s)
        self.core.fly(place_pose(flown.pose_at(place_s)))
        case.last_move = replace(case.last_move, by="flight", flight=FlightPlace(flown.number, place_s))

    def _changed_flight(self, number: int, **values: str) -> None:
        case = self.core.needed_case()
        with self.core.lock:
            flight = needed_flight(case, number)
            changed = replace(flight, **values)  # type: ignore[arg-type]
            if changed != flight:
                self._set_flights(case, [changed if one is flight else one for one in case.flights.listed])

    def _set_flights(self, case: OpenCase, flights: list[RecordingFacts]) -> None:
        case.flights.listed = tuple(flights)
        self.core.changed("flights")


def needed_flight(case: OpenCase, number: int) -> RecordingFacts:
    """Return the flight with a number; the caller holds the session's lock.

    Raises
    ------
    UsageError
        ``session.flights``: if there is no such flight.
    """
    for flight in case.flights.listed:
        if flight.recording_id == number:
            return flight
    raise UsageError("this flight has been removed", code="session.flights")


def running_flight(case: OpenCase) -> int | None:
    """Return the number of the flight that is being recorded into the case; the caller holds the session's lock."""
    return next((one.number for one in case.flights.unwritten if not one.closed), None)
