"""Commands on recorded flights of a case: name, description, order, replay, deletion."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import FlightNumber, OwnName, Words
from carina.commands.value import Command


class RenameFlight(Command, frozen=True):
    """Call a recorded flight by another name."""

    number: FlightNumber
    name: OwnName


class DescribeFlight(Command, frozen=True):
    """Say something about a recorded flight; no words take the description away."""

    number: FlightNumber
    words: Words


class MoveFlight(Command, frozen=True):
    """Earlier (below 0) or later in the list of recorded flights."""

    number: FlightNumber
    by: Annotated[int, Meta(ge=-100_000, le=100_000)]


class FlyFlight(Command, frozen=True):
    """Tip to where it was at a time of a recorded flight; free mode afterwards. A job where it is read first."""

    number: FlightNumber
    time_s: Annotated[float, Meta(ge=0.0, le=86_400.0)]
    goes_on: bool = False
    """Whether the command continues a running flight: it is ignored if another command has moved the tip meanwhile."""


class RemoveFlight(Command, frozen=True):
    """Delete a recorded flight. It is no step of the history: undo does not bring it back."""

    number: FlightNumber
