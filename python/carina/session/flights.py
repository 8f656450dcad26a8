"""Commands about recorded flights: what they are called, their order, and which there are.

They belong to the case and not to its document: no undo takes a flight away or brings one back. The list is changed
in memory, at once; the case file follows it as it follows all else.
"""

from __future__ import annotations

from dataclasses import replace

from carina import commands as c
from carina.case.recordings import RecordingFacts
from carina.errors import UsageError
from carina.session.case import OpenCase
from carina.session.subject import Subject, does

__all__ = ["Flights", "needed_flight", "running_flight"]


class Flights(Subject):
    """The list of the case's recorded flights."""

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
            flights = list(case.flights)
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
            case.removed_flights |= {command.number}
            case.recorded = tuple(one for one in case.recorded if one.number != command.number)
            self._become(case, [one for one in case.flights if one is not flight])

    def _change(self, number: int, **values: str) -> None:
        case = self.core.needed_case()
        with self.core.lock:
            flight = needed_flight(case, number)
            changed = replace(flight, **values)  # type: ignore[arg-type]
            if changed != flight:
                self._become(case, [changed if one is flight else one for one in case.flights])

    def _become(self, case: OpenCase, flights: list[RecordingFacts]) -> None:
        case.flights = tuple(flights)
        self.core.changed("flights")


def needed_flight(case: OpenCase, number: int) -> RecordingFacts:
    """The flight with a number; with the session locked.

    Raises
    ------
    UsageError
        ``session.flights``: if there is none.
    """
    for flight in case.flights:
        if flight.recording_id == number:
            return flight
    raise UsageError("this flight has been removed", code="session.flights")


def running_flight(case: OpenCase) -> int | None:
    """The number of the flight that is being recorded into the case; with the session locked."""
    return next((one.number for one in case.recorded if not one.closed), None)
