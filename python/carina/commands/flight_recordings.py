"""Commands on recorded flights of a case: name, description, order, replay, deletion."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import FlightNumber, OwnName, Words
from carina.commands.value import Command


class RenameFlight(Command, frozen=True):
    """Rename a recorded flight."""

    number: FlightNumber
    name: OwnName


class DescribeFlight(Command, frozen=True):
    """Set the description of a recorded flight; an empty text removes it."""

    number: FlightNumber
    words: Words


class MoveFlight(Command, frozen=True):
    """Move a recorded flight earlier (below 0) or later in the list."""

    number: FlightNumber
    by: Annotated[int, Meta(ge=-100_000, le=100_000)]


class FlyFlight(Command, frozen=True):
    """Set the tip to its pose at a time of a recorded flight and enter free mode.

    The command is a job if the flight must be read first.
    """

    number: FlightNumber
    time_s: Annotated[float, Meta(ge=0.0, le=86_400.0)]
    goes_on: bool = False
    """Whether the command continues a running flight: it is ignored if another command has moved the tip meanwhile."""


class RemoveFlight(Command, frozen=True):
    """Delete a recorded flight. The deletion is not a step of the history, so undo does not restore the flight."""

    number: FlightNumber
